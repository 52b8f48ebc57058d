"""``circlecal rig``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options
from circlecal.cli.options import Convention

if TYPE_CHECKING:
    from circlecal.rig.run import RigReport


def rig(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Folder of circlecal batch, or of result files.")],
    out: options.Out = Path("circlecal-rig"),
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", metavar="FILE", help="CSV with id,camera. [default: by where the cameras stand]"),
    ] = None,
    mask: options.Mask = None,
    convention: Annotated[
        Convention, typer.Option("--convention", help="Where points of annotation files lie, as in the run.")
    ] = Convention.OFFICIAL,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    field: options.FieldName = None,
    seed: options.Seed = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the cameras and counts as JSON.")] = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Estimate what the frames of each camera share, and calibrate every frame again with it."""
    from circlecal.cli import console
    from circlecal.rig.run import read_cameras, run_rig

    console.configure_logging(quiet=quiet, verbose=verbose)
    chosen = options.chosen_config(config, settings, field, seed)
    given = None if cameras is None else read_cameras(cameras)
    report = run_rig(results, chosen, out, cameras=given, mask=mask, convention=convention.value)
    if as_json:
        console.print_line(json.dumps(report.summary(), allow_nan=False))
    elif not quiet:
        print_report(report, out)
    if report.calibrated < report.frames:
        raise typer.Exit(1)


def print_report(report: RigReport, out: Path) -> None:
    """Print the cameras as a table, and the counts."""
    from circlecal.cli import console

    told = report.summary()
    if told["cameras"]:
        console.print_table(
            "Cameras",
            ["camera", "frames", "together", "x m", "y m", "z m", "roll deg", "k1"],
            [
                [c["camera"], str(c["frames"]), str(c["used"])]
                + ["-" if c[key] is None else "{:.2f} +- {:.2f}".format(*c[key]) for key in ("x", "y", "z", "roll_deg")]
                + ["-" if c["kappa_1"] is None else "{:.4f} +- {:.4f}".format(*c["kappa_1"])]
                for c in told["cameras"]
            ],
        )
    else:
        console.print_line("no camera was found that several calibrated frames agree on; the results stay as they were")
    console.print_line(
        f"{report.frames} frames: {report.calibrated_alone} calibrated alone, {report.calibrated} now"
        f"{f' ({len(report.gained)} gained)' if report.gained else ''}; see {out}"
    )
