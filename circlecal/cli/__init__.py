"""The command line: parse, call, print, exit code. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence

from circlecal import ONE_THREAD
from circlecal.cli.ending import exit_after


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

    def run() -> None:
        from circlecal.cli.app import app

        app(args=arguments, prog_name="circlecal")

    exit_after(run, is_process=arguments is None)
