"""The command line: parse, call, print, exit code. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Sequence

from circlecal import ONE_THREAD
from circlecal.errors import CirclecalError, InterruptedCommandError

_SYSTEM_LIMITS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EPERM, errno.EROFS, errno.EMFILE)


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
        if error.errno not in _SYSTEM_LIMITS:
            raise
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error.strerror))


def _fail(reason: str) -> None:
    print(f"circlecal: error: {' '.join(reason.split())}", file=sys.stderr)  # noqa: T201
    sys.exit(2)
