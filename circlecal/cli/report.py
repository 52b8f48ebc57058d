"""``circlecal report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options


def report(
    results: Annotated[
        Path,
        typer.Argument(
            metavar="RESULTS", help="Folder of a run of batch, track, rig or calibrate; a single result file works too."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the report. (default: RESULTS/circlecal-report)")
    ] = None,
    frames: Annotated[
        Path | None, typer.Option("--frames", metavar="FOLDER", help="Where the pictures are, if they have moved.")
    ] = None,
    width: Annotated[int, typer.Option("--width", min=160, help="Largest width of the pictures, pixels.")] = 1280,
    title: Annotated[
        str | None, typer.Option("--title", help="Title of the page. (default: the folder's name)")
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option("--against", metavar="OTHER", help="Another run of the same frames: what got better, what worse."),
    ] = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Write a folder of static HTML to look through a run: summary, timeline, every frame with its template."""
    from circlecal.cli import console
    from circlecal.report import ReportOptions, read_run, write_report

    console.configure_logging(quiet=quiet, verbose=verbose)
    chosen = ReportOptions(frames=frames, width=width, title=title)
    run = read_run(results)
    other = None if against is None else read_run(against)
    if quiet:
        write_report(run, out, chosen, against=other)
        return
    with console.count_steps("frame", len(run.rows)) as advance:
        written = write_report(run, out, chosen, advance, other)
    missing = written.frames - written.pictures
    without = f", {missing} without a picture (has it moved? --frames FOLDER)" if missing else ""
    console.print_line(f"{written.page}: {console.count_of(written.frames, 'frame')}{without}")
