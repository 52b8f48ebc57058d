"""A command run inside this process, for programs that run many."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence


def run_command(arguments: Sequence[str]) -> tuple[int, str]:
    """Run a command line.

    Parameters
    ----------
    arguments : sequence of str
        Without the name of the program.

    Returns
    -------
    code, said : int, str
        Exit code, and what went to stderr.
    """
    from circlecal.cli import console, main

    out, err = io.StringIO(), io.StringIO()
    console.stderr_console.cache_clear()
    code: object = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main(list(arguments))
    except SystemExit as ended:
        code = ended.code or 0
    finally:
        console.stderr_console.cache_clear()
    return (code if isinstance(code, int) else 1), err.getvalue()
