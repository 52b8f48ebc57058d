"""``circlecal batch``."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options
from circlecal.cli.inputs import note_idle_options, note_late_start, note_run_beside_files
from circlecal.cli.plain_flags import CAMERA_AND_FIELD, OUTPUT
from circlecal.cli.sport_hints import SportHints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from circlecal.batch import BatchProgress
    from circlecal.batch.frames import FrameRun
    from circlecal.batch.inputs import Work
    from circlecal.formats.inputs import FrameOfFile
    from circlecal.pictures.files import PictureFile


_TOLD = 3
"""So many frames are told of a run in which none can be read."""


def batch(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="INPUT",
            help="Pictures, videos, annotations, folders or ZIPs of them, patterns, sequences (x_%04d.png), lists "
            "(x.txt).",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            help="Folder of the run; take another one for results of circlecal calibrate.",
            rich_help_panel=OUTPUT,
        ),
    ] = Path("circlecal-run"),
    workers: options.Workers = None,
    every: options.Every = None,
    start: options.Start = None,
    end: options.End = None,
    scheduler: options.Scheduler = None,
    files: Annotated[
        bool,
        typer.Option(
            "--files",
            help="Also write a result file and pictures per frame, like calibrate.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    restart: options.Restart = False,
    rig: Annotated[
        bool,
        typer.Option(
            "--rig",
            help="Afterwards calibrate all frames again with what the frames of each camera share; results go to "
            "OUT/rig.",
            rich_help_panel=CAMERA_AND_FIELD,
        ),
    ] = False,
    mask: options.Mask = None,
    keypoints: options.Keypoints = None,
    annotations: options.Annotations = None,
    from_format: options.FromFormat = None,
    size: options.Size = None,
    convention: options.PointConvention = None,
    to: options.ToAll = None,
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
    as_json: Annotated[bool, typer.Option("--json", help="Print the counts as JSON.", rich_help_panel=OUTPUT)] = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Calibrate many frames in parallel into results.jsonl and summary.csv; run it again to go on after a stop."""
    from circlecal.batch.frames import FrameRun
    from circlecal.batch.inputs import choose_work
    from circlecal.cli import console
    from circlecal.cli.rig import RIG_FOLDER, estimate_shared_cameras
    from circlecal.config import absolute_files
    from circlecal.formats.annotation import ANNOTATION_FOLDER
    from circlecal.formats.unpacking import annotations_in
    from circlecal.pictures.inputs import absolute_input
    from circlecal.records.log import RESULTS_NAME

    console.configure_logging(quiet=quiet, verbose=verbose)
    if scheduler is not None:  # workers have another working folder
        inputs, out = [absolute_input(name) for name in inputs], out.absolute()
        mask, keypoints, annotations = map(_absolute, (mask, keypoints, annotations))
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
        tells_field=not rig,
    )
    chosen = chosen if scheduler is None else absolute_files(chosen)
    exports = options.choose_exports(to, eval_size)
    options.require_export_field(to, chosen)
    run = FrameRun(
        chosen,
        mask=mask,
        keypoints=keypoints,
        format_name=options.choose_format(from_format),
        size=options.parse_size(size),
        convention=options.convention_of(convention),
    )
    failures: list[Exception] = []
    work = choose_work(
        inputs, run, out, (every, start, end), console.error_reporter(failures), console.print_note, dashes="--"
    )
    note_late_start(work.videos, work.sampling)
    if not quiet:
        note_idle_options(work.frames, size, convention, to, eval_size)
        note_run_beside_files(out, is_run=True)
    out = options.folder_of_run(out, run.digest, ask=console.can_ask() and not quiet, restart=restart)
    if files:
        exports.into(out).require_apart(frame.id for frame in work.frames)
    named = annotations_in(annotations, out) or out / ANNOTATION_FOLDER
    run = replace(run, out=out if files else None, annotations=named)
    counts = _calibrate(work, run, out, workers=workers, scheduler=scheduler, restart=restart, quiet=quiet)
    refused, final = counts.refused, out
    if not quiet and counts.finished == counts.unreadable > 0:
        _note_unreadable(out)
    if files and not quiet and counts.resumed == counts.finished > 0 and not any(out.glob("*.json")):
        console.print_note(f"{out}: its frames were done before, without files of their own; --restart writes them")
    if not rig or not as_json:
        _print_counts(counts, out / RESULTS_NAME, as_json=as_json, quiet=quiet)
    if rig:
        final = out / RIG_FOLDER
        report = estimate_shared_cameras(
            out, run, final, workers=workers, as_json=as_json, quiet=quiet, restart=restart, outdated=True
        )
        refused = report.frames - report.calibrated
    _write_further(exports, run, work.frames, final)
    if not quiet:
        is_chosen = bool(field or config or settings)
        SportHints.of_run(final).print_hint(chosen, is_chosen=is_chosen, camera_prior=camera_prior, venue=venue)
    if failures or counts.finished == 0:
        raise typer.Exit(2)
    if refused:
        raise typer.Exit(1)


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _calibrate(
    work: Work,
    run: FrameRun,
    out: Path,
    *,
    workers: int | None,
    scheduler: str | None,
    restart: bool,
    quiet: bool,
) -> BatchProgress:
    """Calibrate all frames, those of videos after the others, while the progress is shown."""
    from circlecal.batch import run_batch
    from circlecal.batch.frames import label_masks
    from circlecal.batch.inputs import digest_annotations_of
    from circlecal.batch.workers import cpu_count
    from circlecal.cli import console
    from circlecal.records.log import RESULTS_NAME

    is_taken_up = not restart and (out / RESULTS_NAME).is_file()
    with console.resumable(restart=restart), console.progress_display(quiet=quiet, stage="calibrating") as show:
        return run_batch(
            work.all_frames(console.print_note),
            run,
            out,
            workers=workers or cpu_count(),
            scheduler=scheduler,
            total=work.total,
            restart=restart,
            annotations=digest_annotations_of(work, run.annotations, out),
            masks=label_masks(work.frames) if is_taken_up and run.mask is None else None,
            on_progress=show,
            on_again=partial(show.step, "calibrating refused frames again"),
        )


def _write_further(
    exports: options.ExportChoice, run: FrameRun, frames: Sequence[PictureFile | FrameOfFile], out: Path
) -> None:
    """Write the outside formats and the table of everything that the folder holds."""
    from circlecal.config import load_told_field
    from circlecal.formats.exports import export_records
    from circlecal.formats.inputs import FrameOfFile
    from circlecal.pipeline import apply_convention, field_of
    from circlecal.records.log import read_records
    from circlecal.records.parquet import PARQUET_NAME, write_parquet

    if exports.targets:
        template, _ = field_of(run.config)
        annotated = {frame.id: frame for frame in frames if isinstance(frame, FrameOfFile)}
        convention = apply_convention(template, run.convention)
        told = partial(load_told_field, run.config)
        export_records(read_records(out), exports.into(out), template, annotated, convention, told)
    if exports.parquet:
        write_parquet(read_records(out), out / PARQUET_NAME)


def _note_unreadable(out: Path) -> None:
    """Say why the first frames cannot be read, where a run has no other: the results are not worth a look."""
    from itertools import islice

    from circlecal.cli import console
    from circlecal.records.log import read_records
    from circlecal.records.record import ResultRow

    for row in islice(read_records(out, ResultRow), _TOLD):
        console.print_note(str(row.reason))


def _print_counts(counts: BatchProgress, results: Path, *, as_json: bool, quiet: bool) -> None:
    from circlecal.cli import console

    if as_json:
        console.print_json(json.dumps({**asdict(counts), "results": str(results)}))
    elif not quiet:
        console.print_line(
            f"{console.count_of(counts.total, 'frame')}: {counts.calibrated} calibrated"
            f"{f' ({counts.learnt} of them by what the others show)' if counts.learnt else ''}"
            f", {counts.refused} refused"
            f"{f' ({counts.unreadable} of them unreadable)' if counts.unreadable else ''}; see {results}"
        )
