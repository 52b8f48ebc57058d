"""``circlecal debug``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options
from circlecal.cli.inputs import leave_to_batch


def debug(
    images: Annotated[list[str], typer.Argument(metavar="IMAGE", help="Pictures, quoted patterns, lists.")],
    out: options.Out = Path("circlecal-debug"),
    mask: options.Mask = None,
    keypoints: options.Keypoints = None,
    annotations: options.Annotations = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    camera_prior: options.CameraPrior = None,
    venue: options.VenueFile = None,
    field: options.FieldName = None,
    seed: options.Seed = None,
    max_pixels: options.MaxPixels = None,
    max_bytes: options.MaxBytes = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Write one numbered picture per stage and a contact sheet of them all, for a refused picture too."""
    from circlecal.batch.frames import examine_frame, write_stage_pictures
    from circlecal.batch.inputs import choose_frames
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.files import is_folder, prepare_folder
    from circlecal.formats.annotation import ANNOTATION_FOLDER
    from circlecal.formats.unpacking import annotations_in, is_archive
    from circlecal.pictures.inputs import expand_inputs
    from circlecal.pipeline import field_of
    from circlecal.records.json_text import write_result
    from circlecal.records.summary import summarise
    from circlecal.records.writing import result_record

    console.configure_logging(quiet=quiet, verbose=verbose)
    chosen = options.choose_config(
        config,
        settings,
        field,
        seed,
        camera_prior=camera_prior,
        venue=venue,
        max_pixels=max_pixels,
        max_bytes=max_bytes,
        tells_field=True,
    )
    named = expand_inputs(images)
    failures: list[Exception] = []
    report = console.error_reporter(failures)
    leave_to_batch(named, report, " --files --set output.debug=true")
    for path in named.paths:
        if is_folder(path) or is_archive(path):
            raise InputError(f"{path}: is a {'folder' if is_folder(path) else 'ZIP'}; debug takes pictures")
    frames = choose_frames(named.paths, out, mask)
    prepare_folder(out)
    template, _ = field_of(chosen)
    told = annotations_in(annotations, out) or out / ANNOTATION_FOLDER
    summaries, written = [], []
    for frame in frames:
        try:
            picture, calibration = examine_frame(frame, chosen, mask, keypoints, told)
        except InputError as error:
            report(error)
            continue
        shown = calibration.template or template
        record = result_record(calibration, shown)
        write_result(out / frame.id / "result.json", record)
        written += write_stage_pictures(picture, calibration, shown, out / frame.id, chosen.output.jpeg_quality)
        summaries.append(summarise(record))
    if summaries and not quiet:
        console.print_summaries(summaries)
        for path in written:
            console.print_line(str(path))
    if failures:
        raise typer.Exit(2)
    if any(summary.status != "calibrated" for summary in summaries):
        raise typer.Exit(1)
