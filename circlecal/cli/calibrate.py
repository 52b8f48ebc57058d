"""``circlecal calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from circlecal.cli import options

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from circlecal.batch import BatchProgress
    from circlecal.config import Config
    from circlecal.formats.images import Frame
    from circlecal.formats.summary import FrameSummary


def calibrate(
    inputs: options.Inputs,
    out: options.Out = Path("circlecal-out"),
    mask: options.Mask = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    camera_prior: options.CameraPrior = None,
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
    chosen = options.chosen_config(
        config, settings, field, seed, radar=radar, no_overlay=no_overlay, camera_prior=camera_prior
    )
    frames = options.chosen_frames(inputs, out, mask)
    summaries: list[FrameSummary] = []
    with console.progress_display(quiet=quiet or len(frames) == 1) as show:
        for record in _records(frames, chosen, prepare_folder(out), mask, show):
            summaries.append(summarise(record))
            if json_lines:
                console.print_line(result_line(record))
    if summaries and not json_lines and not quiet:
        console.print_summaries(summaries)
    if len(summaries) < len(frames):
        raise typer.Exit(2)
    if any(summary.status != "calibrated" for summary in summaries):
        raise typer.Exit(1)


def _records(
    frames: Sequence[Frame], config: Config, out: Path, mask: Path | None, show: Callable[[BatchProgress], None]
) -> Iterator[dict[str, Any]]:
    """Calibrate, write and yield each frame; one that cannot be read is one line on stderr and left out."""
    from circlecal.api import calibrate_frame, write_outputs
    from circlecal.batch import BatchProgress
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.formats.summary import summarise

    progress = BatchProgress(total=len(frames))
    show(progress)
    for frame in frames:
        try:
            image, calibration = calibrate_frame(frame, config, mask)
        except InputError as error:
            console.print_error(str(error))
            continue
        record = write_outputs(image, calibration, config, out)
        progress.count(summarise(record))
        show(progress)
        yield record
