"""The commands, put together."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from circlecal import __version__
from circlecal.cli.audit import audit
from circlecal.cli.batch import batch
from circlecal.cli.calibrate import calibrate
from circlecal.cli.config import config
from circlecal.cli.convert import convert
from circlecal.cli.debug import debug
from circlecal.cli.evaluate import evaluate
from circlecal.cli.fields import fields
from circlecal.cli.project import project
from circlecal.cli.report import report
from circlecal.cli.rig import rig
from circlecal.cli.simulate import simulate
from circlecal.cli.synth import synth


class _Commands(TyperGroup):
    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            print("circlecal: interrupted", file=sys.stderr)  # noqa: T201
            raise typer.Exit(130) from None


app = typer.Typer(
    cls=_Commands,
    help="Calibrate a sports camera from the circle of a field marking.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    epilog="Exit code: 0 all calibrated, 1 some refused, 2 wrong use or input.",
)
app.command()(calibrate)
app.command()(batch)
app.command()(rig)
app.command()(report)
app.command()(debug)
app.command()(convert)
app.command()(evaluate)
app.command()(audit)
app.command(context_settings={"ignore_unknown_options": True})(project)
app.command()(config)
app.command()(fields)
app.command()(synth)
app.command()(simulate)
if importlib.util.find_spec("circlecal.cli.bench"):
    app.add_typer(importlib.import_module("circlecal.cli.bench").app, name="bench")


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
