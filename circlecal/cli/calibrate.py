"""``circlecal calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from circlecal.cli import options
from circlecal.cli.inputs import choose_inputs, note_idle_options, note_run_beside_files
from circlecal.cli.sport_hints import SportHints

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from circlecal.batch import BatchProgress
    from circlecal.batch.frames import FrameRun
    from circlecal.config import Config
    from circlecal.formats.inputs import FrameOfFile
    from circlecal.pictures.files import PictureFile
    from circlecal.records.record import ResultRecord
    from circlecal.records.summary import FrameSummary


def calibrate(
    inputs: options.FrameInputs,
    out: options.Out = Path("circlecal-out"),
    mask: options.Mask = None,
    keypoints: options.Keypoints = None,
    annotations: options.Annotations = None,
    from_format: options.FromFormat = None,
    size: options.Size = None,
    convention: options.PointConvention = None,
    to: options.To = None,
    eval_size: options.EvalSize = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    camera_prior: options.CameraPrior = None,
    venue: options.VenueFile = None,
    solver: options.Solver = None,
    field: options.FieldName = None,
    seed: options.Seed = None,
    max_pixels: options.MaxPixels = None,
    max_bytes: options.MaxBytes = None,
    radar: options.Radar = False,
    no_overlay: options.NoOverlay = False,
    json_lines: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Calibrate pictures or annotations: write a result file and an overlay picture of each, and print a table."""
    from circlecal.batch.frames import FrameRun
    from circlecal.batch.inputs import require_frames
    from circlecal.cli import console
    from circlecal.files import prepare_folder
    from circlecal.formats.annotation import ANNOTATION_FOLDER
    from circlecal.formats.exports import Exports
    from circlecal.formats.unpacking import annotations_in
    from circlecal.records.json_text import result_line
    from circlecal.records.summary import summarise

    console.configure_logging(quiet=quiet, verbose=verbose)
    chosen = options.choose_config(
        config,
        settings,
        field,
        seed,
        radar=radar,
        no_overlay=no_overlay,
        camera_prior=camera_prior,
        venue=venue,
        solver=solver,
        max_pixels=max_pixels,
        max_bytes=max_bytes,
        tells_field=True,
    )
    exports = Exports(to or (), out, options.parse_size(eval_size, "--eval-size"))
    options.require_export_field(to, chosen)
    format_name = options.choose_format(from_format)
    written = annotations_in(annotations, out) or out / ANNOTATION_FOLDER
    size_given, points_at = options.parse_size(size), options.convention_of(convention)
    run = FrameRun(chosen, out, exports, mask, keypoints, format_name, size_given, points_at, written)
    failures: list[Exception] = []
    frames = choose_inputs(inputs, run, out, console.error_reporter(failures))
    if not failures:
        require_frames(inputs, frames)
    if not quiet:
        note_idle_options(frames, size, convention, to, eval_size)
        note_run_beside_files(out, is_run=False)
    exports.require_apart(frame.id for frame in frames)
    prepare_folder(out)
    summaries: list[FrameSummary] = []
    hints = SportHints()
    with console.progress_display(quiet=quiet or len(frames) <= 1) as show:
        for record in _records(frames, run, show, console.error_reporter(failures)):
            summaries.append(summarise(record))
            hints.add(record)
            for note in () if quiet else _notes(record, chosen):
                console.print_note(note)
            if json_lines:
                console.print_json(result_line(record))
    exports.finish()
    if summaries and not quiet:
        if not json_lines:
            console.print_summaries(summaries)
        console.print_note(_name_files([summary.id for summary in summaries], out, chosen, exports.written))
        is_chosen = bool(field or config or settings)
        hints.print_hint(chosen, is_chosen=is_chosen, camera_prior=camera_prior, venue=venue)
    if failures:
        raise typer.Exit(2)
    if any(summary.status != "calibrated" for summary in summaries):
        raise typer.Exit(1)


def _notes(record: ResultRecord, config: Config) -> Iterator[str]:
    """What is said of a frame beside its row in the table."""
    from circlecal.camera.picture_shape import is_cut, is_oblong, list_aspects
    from circlecal.config import find_template

    if record.near_limits:
        yield f"{record.id}: {record.status}, near a limit: {', '.join(record.near_limits)}"
    image = record.image
    if image is not None and config.camera.principal_point_sd_px is None and is_cut(image.width, image.height):
        told = "is the shape of no camera's picture: without bars, it is taken for a part of a larger one"
        yield f"{record.id}: {image.width} x {image.height} {told} (camera.principal_point_sd_px)"
    is_unknown = config.camera.aspect is None and image is not None and image.aspect == 1.0
    if image is not None and is_unknown and is_oblong(image.width, image.height):
        wide, old = list_aspects(image.width, image.height)
        told = "is a size of television, whose pixels are not square: how wide they are is estimated"
        mend = f"set camera.aspect={wide:.3f} if it shows 16:9, {old:.3f} if 4:3"
        yield f"{record.id}: {image.width} x {image.height} {told}; {mend}"
    if record.no_correspondences and config.correspondences.case != "auto":
        asked = f"no correspondences of case {config.correspondences.case}"
        yield f"{record.id}: {asked}: {record.no_correspondences}"
    if record.fields:
        taken, *others = record.fields
        named = find_template(config, taken.template)
        if record.status == "calibrated" and named != config.field.among[0]:
            fitting = [find_template(config, other.template) for other in others if other.status == "calibrated"]
            also = f"; {', '.join(fitting)} would fit, too" if fitting else ""
            yield f"{record.id}: looks like {taken.sport}; --field {named}{also}"
        if record.sport is not None:
            name, share = record.sport.name, record.sport.probability or 0.0
            told = "nothing tells which sport it shows" if name is None else f"looks like {name} ({share:.0%} sure)"
            yield f"{record.id}: refused; {told}"


def _name_files(ids: Sequence[str], out: Path, config: Config, exported: Sequence[Path]) -> str:
    """Which files the results are in, with those of other programs."""
    from circlecal.pictures.files import OVERLAY_SUFFIX, RADAR_SUFFIX

    wanted = {OVERLAY_SUFFIX: config.output.overlay, RADAR_SUFFIX: config.output.radar}
    drawn = (suffix for suffix, chosen in wanted.items() if chosen)
    suffixes = [".json", *(suffix for suffix in drawn if any((out / f"{name}{suffix}").is_file() for name in ids))]
    if len(ids) > 1:
        others = f", and {len(exported)} of other programs" if exported else ""
        return f"{len(ids)} results are in {out} ({', '.join(f'<id>{suffix}' for suffix in suffixes)}{others})"
    files = [path for suffix in suffixes if (path := out / f"{ids[0]}{suffix}").is_file()]
    return f"wrote {', '.join(map(str, [*files, *exported]))}"


def _records(
    frames: Sequence[PictureFile | FrameOfFile],
    run: FrameRun,
    show: Callable[[BatchProgress], None],
    report: Callable[[Exception], None],
) -> Iterator[ResultRecord]:
    """Calibrate, write and yield each frame; one that cannot be read is one line on stderr and left out."""
    from circlecal.batch import BatchProgress
    from circlecal.batch.limits import TimeLimitError, limit_time
    from circlecal.errors import InputError

    progress = BatchProgress(total=len(frames))
    show(progress)
    for frame in frames:
        seconds = run.limits.frame_seconds
        try:
            with limit_time(seconds):
                record = run.record(frame)
        except InputError as error:
            report(error)
            continue
        except TimeLimitError:
            report(InputError(f"{run.source(frame)}: took longer than {seconds:g} s; raise limits.frame_seconds"))
            continue
        progress.count(record.status, record.code)
        show(progress)
        yield record
