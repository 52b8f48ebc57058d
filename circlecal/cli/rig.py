"""``circlecal rig``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options
from circlecal.cli.plain_flags import INPUT, OUTPUT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from circlecal.batch.frames import FrameRun
    from circlecal.rig.run import RigReport

RIG_FOLDER = "rig"
"""Where ``circlecal batch --rig`` writes its second pass, in its own folder."""


def rig(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Folder of circlecal batch, or of result files.")],
    out: options.Out = Path("circlecal-rig"),
    cameras: Annotated[
        Path | None,
        typer.Option(
            "--cameras",
            metavar="FILE",
            help="CSV with id,camera. (default: by where the cameras stand)",
            rich_help_panel=INPUT,
        ),
    ] = None,
    mask: options.Mask = None,
    convention: options.PointConvention = None,
    workers: options.Workers = None,
    restart: options.Restart = False,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    field: options.OneFieldName = None,
    seed: options.Seed = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the cameras and counts as JSON.", rich_help_panel=OUTPUT)
    ] = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Estimate what the frames of each camera share, and calibrate every frame again with it."""
    from circlecal.batch.frames import FrameRun
    from circlecal.cli import console
    from circlecal.rig.run import read_cameras

    console.configure_logging(quiet=quiet, verbose=verbose)
    run = FrameRun(
        options.choose_config(config, settings, field, seed), mask=mask, convention=options.convention_of(convention)
    )
    given = None if cameras is None else read_cameras(cameras)
    report = estimate_shared_cameras(
        results, run, out, workers=workers, restart=restart, as_json=as_json, quiet=quiet, cameras=given
    )
    if report.calibrated < report.frames:
        raise typer.Exit(1)


def estimate_shared_cameras(
    results: Path,
    run: FrameRun,
    out: Path,
    *,
    workers: int | None,
    restart: bool,
    as_json: bool,
    quiet: bool,
    cameras: Mapping[str, str] | None = None,
    outdated: bool = False,
) -> RigReport:
    """Run the rig on the results of a run, and print what it brought; ``outdated`` results in its folder may go."""
    from circlecal.batch.workers import cpu_count
    from circlecal.cli import console
    from circlecal.records.log import OtherRunError
    from circlecal.rig.run import run_rig

    def once(anew: bool) -> RigReport:
        with console.resumable(restart=restart), console.progress_display(quiet=quiet) as show:
            return run_rig(
                results,
                run.config,
                out,
                workers=workers or cpu_count(),
                cameras=cameras,
                mask=run.mask,
                convention=run.convention,
                restart=anew,
                on_progress=show,
            )

    try:
        report = once(restart)
    except OtherRunError:
        if not outdated:
            raise
        report = once(True)
    if as_json:
        console.print_json(json.dumps(report.summary(), allow_nan=False))
    elif not quiet:
        print_report(report, out)
    return report


def print_report(report: RigReport, out: Path) -> None:
    """Print the cameras as a table, and the counts."""
    from circlecal.cli import console
    from circlecal.results.numbers import show_with_sigma

    told, shared = report.summary(), ("x", "y", "z", "roll_deg", "kappa_1")
    if told["cameras"]:
        console.print_table(
            "Cameras",
            ["camera", "frames", "found from", "x m", "y m", "z m", "roll deg", "k1"],
            [
                [c["camera"], str(c["frames"]), str(c["used"])]
                + ["-" if c[key] is None else show_with_sigma(*c[key]) for key in shared]
                for c in told["cameras"]
            ],
        )
    else:
        console.print_line(
            "no camera was found that several calibrated frames agree on; the results stay as they were, and no "
            "venue.yaml is written"
        )
    if report.missing:
        more = f" and {len(report.missing) - 1} more" if len(report.missing) > 1 else ""
        why = "not there, so frames that were refused were not looked at again; start it where the run was started"
        console.print_note(f"{report.missing[0]}{more}: {why}")
    console.print_line(
        f"{console.count_of(report.frames, 'frame')}: {report.calibrated_alone} calibrated alone, "
        f"{report.calibrated} now"
        f"{f' ({len(report.gained)} gained)' if report.gained else ''}; see {out}"
    )
