"""``circlecal debug``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options


def debug(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="The picture.")],
    out: options.Out = Path("circlecal-debug"),
    mask: options.Mask = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    camera_prior: options.CameraPrior = None,
    field: options.FieldName = None,
    seed: options.Seed = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Write one numbered picture per stage and a contact sheet of them all, for a refused picture too."""
    from circlecal.api import calibrate_frame, field_template, prepare_folder, write_stage_pictures
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.formats.result import result_record, write_result
    from circlecal.formats.summary import summarise

    console.configure_logging(quiet=quiet, verbose=verbose)
    chosen = options.chosen_config(config, settings, field, seed, camera_prior=camera_prior)
    if image.is_dir():
        raise InputError(f"{image}: is a folder; debug takes one picture")
    frame = options.chosen_frames([image], out, mask)[0]
    folder = prepare_folder(out) / frame.id
    picture, calibration = calibrate_frame(frame, chosen, mask)
    template = field_template(chosen)
    record = result_record(calibration, template)
    write_result(folder / "result.json", record)
    written = write_stage_pictures(picture, calibration, template, folder, chosen.output.jpeg_quality)
    if not quiet:
        console.print_summaries([summarise(record)])
        for path in written:
            console.print_line(str(path))
    if calibration.status != "calibrated":
        raise typer.Exit(1)
