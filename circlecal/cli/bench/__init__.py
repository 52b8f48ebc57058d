"""``circlecal bench NAME``: the tables of the benchmarks' page, one module for each kind of benchmark."""

from __future__ import annotations

import typer

from circlecal.cli.bench.clips import track
from circlecal.cli.bench.endurance import faults, fuzz, soak, time_batch
from circlecal.cli.bench.frames import constants, detect, sports
from circlecal.cli.bench.methods import accuracy, ransac, solvers
from circlecal.cli.bench.named_markings import click_frames, score_annotations
from circlecal.cli.plain_flags import PlainCommand, PlainGroup

app = typer.Typer(
    cls=PlainGroup,
    help="Print accuracy and speed tables, peers and statistical bounds in the same run.",
    no_args_is_help=True,
)
app.command(cls=PlainCommand)(accuracy)
app.command(cls=PlainCommand)(ransac)
app.command(cls=PlainCommand)(solvers)
app.command(cls=PlainCommand)(detect)
app.command(cls=PlainCommand)(constants)
app.command(cls=PlainCommand)(sports)
app.command("annotations", cls=PlainCommand)(score_annotations)
app.command("annotate", cls=PlainCommand)(click_frames)
app.command(cls=PlainCommand)(track)
app.command("batch", cls=PlainCommand)(time_batch)
app.command(cls=PlainCommand)(fuzz)
app.command(cls=PlainCommand)(faults)
app.command(cls=PlainCommand)(soak)
