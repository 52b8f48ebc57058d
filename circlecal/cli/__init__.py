"""The command line: parse, call, print, exit code. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import os
from collections.abc import Sequence

from circlecal import ONE_THREAD
from circlecal.cli.ending import exit_after
from circlecal.cli.streams import prepare_streams, show_all_characters


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
    if arguments is None:
        prepare_streams()
    show_all_characters()

    def run() -> None:
        from circlecal.cli.app import app

        app(args=arguments, prog_name="circlecal")

    exit_after(run, is_process=arguments is None)
