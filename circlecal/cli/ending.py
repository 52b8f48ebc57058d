"""How the program ends: errors of a user in one line, and an exit code."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

from circlecal.cli.streams import drop_output
from circlecal.errors import CirclecalError, InterruptedCommandError
from circlecal.names import show

_LONGEST_LINE = 2000
"""Characters of an error's line; damaged files may put any length into it."""
_UNREAD = 128 + 13
"""Exit code of what SIGPIPE ends, by which shells know that a reader had enough."""


def exit_after(run: Callable[[], object], *, is_process: bool) -> None:
    """Run a command and exit: 0 all calibrated, 1 some refused, 2 wrong use or input, 130 interrupted by Ctrl-C or
    SIGTERM, 141 where nobody reads the output to its end.

    Parameters
    ----------
    run : callable
        The command.
    is_process : bool
        Whether the process has nothing else to do, so that a second Ctrl-C may end it at once.
    """
    if is_process:
        signal.signal(signal.SIGTERM, _interrupt)
    try:
        _run_to_its_last_line(run)
    except (InterruptedCommandError, KeyboardInterrupt) as interruption:
        if is_process:  # another one ends at once what is still being wound up
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        print("; ".join(("circlecal: interrupted", *map(str, interruption.args))), file=sys.stderr)  # noqa: T201
        sys.exit(130)
    except CirclecalError as error:
        _fail(str(error))
    except BrokenPipeError:
        drop_output()
        sys.exit(_UNREAD)
    except OSError as error:
        drop_output()
        _fail(_describe(error))
    except MemoryError:
        _fail("not enough memory; give smaller pictures or fewer workers")


def _run_to_its_last_line(run: Callable[[], object]) -> None:
    """Run a command and write out what it printed, so that it is here that this fails and not when the process ends."""
    try:
        run()
    except SystemExit as ended:
        if isinstance(ended.__context__, BrokenPipeError):  # typer and rich make it the exit code of refused frames
            raise ended.__context__ from None
        sys.stdout.flush()
        raise


def _describe(error: OSError) -> str:
    """An error of the system with the file it is of; a full disk without a file is that of the standard output."""
    told = str(error.strerror or error)
    if error.filename:
        return f"{os.fsdecode(error.filename)}: {told}"
    return f"standard output: cannot be written: {told.lower()}" if error.errno == errno.ENOSPC else told


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Take SIGTERM, which schedulers and containers send, for a Ctrl-C: nothing is lost, and the user is told how to go
    on; also where the shell made the process deaf to the latter.
    """
    by_keyboard = signal.getsignal(signal.SIGINT)
    if not callable(by_keyboard):
        raise KeyboardInterrupt
    by_keyboard(number, frame)


def _fail(reason: str) -> None:
    line = show(reason)
    cut = line if len(line) <= _LONGEST_LINE else f"{line[:_LONGEST_LINE]}..."
    print(f"circlecal: error: {cut}", file=sys.stderr)  # noqa: T201
    sys.exit(2)
