"""``circlecal calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from circlecal.cli import options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from circlecal.config import Config
    from circlecal.formats.images import Frame


def calibrate(
    inputs: options.Inputs,
    out: options.Out = Path("circlecal-out"),
    mask: options.Mask = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    field: options.FieldName = None,
    seed: options.Seed = None,
    radar: options.Radar = False,
    no_overlay: options.NoOverlay = False,
    json_lines: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Calibrate pictures: write a result file and an overlay picture of each, and print a table."""
    from circlecal.api import prepare_folder
    from circlecal.cli import console
    from circlecal.formats.result import result_line
    from circlecal.formats.summary import summarise

    console.configure_logging(quiet=quiet, verbose=verbose)
    chosen = options.chosen_config(config, settings, field, seed, radar=radar, no_overlay=no_overlay)
    frames = options.chosen_frames(inputs, out, mask)
    records, unreadable = _calibrated(frames, chosen, prepare_folder(out), mask, quiet=quiet)
    if json_lines:
        for record in records:
            console.print_line(result_line(record))
    elif records and not quiet:
        console.print_summaries([summarise(record) for record in records])
    if unreadable:
        raise typer.Exit(2)
    if any(record["status"] != "calibrated" for record in records):
        raise typer.Exit(1)


def _calibrated(
    frames: Sequence[Frame], config: Config, out: Path, mask: Path | None, *, quiet: bool
) -> tuple[list[dict[str, Any]], int]:
    """Records of the frames that could be read, and how many could not; each of those is one line on stderr."""
    from circlecal.api import calibrate_frame, write_outputs
    from circlecal.batch import BatchProgress
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.formats.summary import summarise

    records: list[dict[str, Any]] = []
    unreadable = 0
    progress = BatchProgress(total=len(frames))
    with console.progress_display(quiet=quiet or len(frames) == 1) as show:
        for frame in frames:
            try:
                image, calibration = calibrate_frame(frame, config, mask)
            except InputError as error:
                console.print_error(str(error))
                unreadable += 1
                continue
            records.append(write_outputs(image, calibration, config, out))
            progress.count(summarise(records[-1]))
            show(progress)
    return records, unreadable
