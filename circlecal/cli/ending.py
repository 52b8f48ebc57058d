"""How the program ends: errors of a user in one line, and an exit code."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

from circlecal.errors import CirclecalError, InterruptedCommandError
from circlecal.names import show

_LONGEST_LINE = 2000
"""Characters of an error's line; damaged files may put any length into it."""


def exit_after(run: Callable[[], object], *, is_process: bool) -> None:
    """Run a command and exit: 0 all calibrated, 1 some refused, 2 wrong use or input, 130 interrupted by Ctrl-C or
    SIGTERM.

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
        run()
    except (InterruptedCommandError, KeyboardInterrupt) as interruption:
        if is_process:  # another one ends at once what is still being wound up
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        print("; ".join(("circlecal: interrupted", *map(str, interruption.args))), file=sys.stderr)  # noqa: T201
        sys.exit(130)
    except CirclecalError as error:
        _fail(str(error))
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise
        _fail(_describe(error))
    except MemoryError:
        _fail("not enough memory; give smaller pictures or fewer workers")


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
