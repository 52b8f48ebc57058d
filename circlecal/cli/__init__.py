"""The command line: parse, call, print, exit code. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
from collections.abc import Sequence

from circlecal import ONE_THREAD
from circlecal.errors import CirclecalError, InterruptedCommandError
from circlecal.names import show

_LONGEST_LINE = 2000
"""Characters of an error's line; damaged files may put any length into it."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit: 0 all calibrated, 1 some refused, 2 wrong use or input, 130 interrupted.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process when None.
    """
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # a damaged picture is one line of ours
    for name, count in ONE_THREAD.items():
        os.environ.setdefault(name, count)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without a character gets its escape instead
            stream.reconfigure(errors="backslashreplace")
    try:
        from circlecal.cli.app import app

        app(args=arguments, prog_name="circlecal")
    except (InterruptedCommandError, KeyboardInterrupt):
        if arguments is None:  # another one ends at once what is still being wound up
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        print("circlecal: interrupted", file=sys.stderr)  # noqa: T201
        sys.exit(130)
    except CirclecalError as error:
        _fail(str(error))
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise
        _fail(f"{os.fsdecode(error.filename)}: {error.strerror}" if error.filename else str(error.strerror or error))
    except MemoryError:
        _fail("not enough memory; give smaller pictures or fewer workers")


def _fail(reason: str) -> None:
    line = show(reason)
    cut = line if len(line) <= _LONGEST_LINE else f"{line[:_LONGEST_LINE]}..."
    print(f"circlecal: error: {cut}", file=sys.stderr)  # noqa: T201
    sys.exit(2)
