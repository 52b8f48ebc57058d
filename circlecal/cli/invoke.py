"""A command run inside this process, for programs that run many."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence

from circlecal.cli.ending import exit_after


def run_command(command: Callable[..., object], arguments: Sequence[str]) -> tuple[int, str]:
    """Run a command line.

    Parameters
    ----------
    command : callable
        The program: :data:`circlecal.cli.app.app`, or the command at the root of a typer context.
    arguments : sequence of str
        Without the name of the program.

    Returns
    -------
    code, said : int, str
        Exit code, and what went to stderr.
    """
    from circlecal.cli.console import stderr_console

    out, err = io.StringIO(), io.StringIO()
    stderr_console.cache_clear()
    code: object = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            exit_after(lambda: command(args=list(arguments), prog_name="circlecal"), is_process=False)
    except SystemExit as ended:
        code = ended.code or 0
    finally:
        stderr_console.cache_clear()
    return (code if isinstance(code, int) else 1), err.getvalue()
