"""``circlecal bench NAME``: the tables of the benchmarks' page, one module for each kind of benchmark."""

from __future__ import annotations

from circlecal.cli.bench.clips import track
from circlecal.cli.bench.endurance import faults, fuzz, soak, time_batch
from circlecal.cli.bench.frames import constants, detect, sports
from circlecal.cli.bench.methods import accuracy, ransac, solvers
from circlecal.cli.bench.named_markings import click_frames, score_annotations
from circlecal.cli.plain_flags import PlainGroup, PlainTyper

app = PlainTyper(
    cls=PlainGroup,
    help="Print accuracy and speed tables, peers and statistical bounds in the same run.",
    no_args_is_help=True,
)
app.command()(accuracy)
app.command()(ransac)
app.command()(solvers)
app.command()(detect)
app.command()(constants)
app.command()(sports)
app.command("annotations")(score_annotations)
app.command("annotate")(click_frames)
app.command()(track)
app.command("batch")(time_batch)
app.command()(fuzz)
app.command()(faults)
app.command()(soak)
