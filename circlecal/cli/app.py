"""The commands, put together."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer

from circlecal import __version__
from circlecal.cli import bench
from circlecal.cli.annotate import annotate
from circlecal.cli.audit import audit
from circlecal.cli.batch import batch
from circlecal.cli.calibrate import calibrate
from circlecal.cli.config import config
from circlecal.cli.convert import convert
from circlecal.cli.debug import debug
from circlecal.cli.evaluate import evaluate
from circlecal.cli.fields import fields
from circlecal.cli.plain_flags import PlainGroup, PlainTyper
from circlecal.cli.project import project
from circlecal.cli.report import report
from circlecal.cli.rig import rig
from circlecal.cli.simulate import simulate
from circlecal.cli.synth import synth
from circlecal.cli.track import track
from circlecal.errors import InputError, InterruptedCommandError

_TAKES_EMPTY_LISTS = "bench"
_KNOW_URLS = ("annotate", "batch", "calibrate", "debug", "track", "bench")
"""Commands that fetch URLs, or say themselves what to do; as a path to any other one a URL would lose a slash."""
_UsageError: Any = typer.BadParameter.__base__  # typer has no public name for it


@contextlib.contextmanager
def _report_in_one_line() -> Iterator[None]:
    """Wrong use and Ctrl-C are told as every other error is; typer would draw a box, and end without a word."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedCommandError from None
    except _UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            raise
        command = error.ctx.command_path if error.ctx else "circlecal"
        wrong = " ".join(error.format_message().split()).rstrip(".").replace("Value error, ", "")
        raise InputError(f"{wrong}; see {command} --help") from None


def _refuse_urls(args: Sequence[str]) -> None:
    for text in args:
        if "://" in text:
            from circlecal.pictures.remote import PROTOCOLS

            if text.partition("://")[0].lower() in PROTOCOLS:
                raise InputError(f"{text}: is a URL; save what it names, and give the file")


class _Commands(PlainGroup):
    def make_context(self, info_name: str | None, args: list[str], *arguments: Any, **named: Any) -> Any:
        if "" in args and args[0] != _TAKES_EMPTY_LISTS:  # as a path it would be the working folder
            raise InputError("an argument is empty; name a file or folder, or leave it out")
        if args and args[0] not in _KNOW_URLS:
            _refuse_urls(args)
        with _report_in_one_line():
            return super().make_context(info_name, args, *arguments, **named)

    def invoke(self, ctx: Any) -> Any:
        with _report_in_one_line():
            return super().invoke(ctx)


app = PlainTyper(
    cls=_Commands,
    help="Calibrate a sports camera from circular field markings.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="To begin: circlecal calibrate PICTURE; circlecal calibrate -h shows its options.\n\n"
    "Exit code: 0 all calibrated, 1 some refused, 2 wrong use or input, 130 interrupted.",
)
app.command()(calibrate)
app.command()(batch)
app.command()(track)
app.command()(rig)
app.command()(report)
app.command()(annotate)
app.command()(debug)
app.command()(convert)
app.command()(evaluate)
app.command()(audit)
app.command(context_settings={"ignore_unknown_options": True})(project)
app.command()(config)
app.command()(fields)
app.command()(synth)
app.command()(simulate)
app.add_typer(bench.app, name="bench")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"circlecal {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass
