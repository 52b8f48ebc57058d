"""``circlecal track``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options
from circlecal.cli.inputs import choose_videos, note_idle_options, note_late_start
from circlecal.cli.plain_flags import INPUT, OUTPUT
from circlecal.cli.sport_hints import SportHints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from circlecal.pictures.video import Video
    from circlecal.tracking.run import TrackReport
    from circlecal.tracking.stretches import ClipRun


def track(
    inputs: Annotated[list[str], typer.Argument(metavar="CLIP", help="Videos, folders of them, patterns, lists.")],
    out: options.Out = Path("circlecal-track"),
    workers: options.Workers = None,
    every: Annotated[
        str | None,
        typer.Option(
            "--every",
            metavar="TIME|N",
            help="Answer one frame per TIME (1s, 500ms), or every N-th frame; all are followed. (default: 1, every "
            "frame)",
            rich_help_panel=INPUT,
        ),
    ] = None,
    start: options.Start = None,
    end: options.End = None,
    scheduler: options.Scheduler = None,
    restart: options.Restart = False,
    venue: options.VenueFile = None,
    annotations: options.ClipAnnotations = None,
    video: Annotated[bool, typer.Option("--video", help="Also write overlay.mp4.", rich_help_panel=OUTPUT)] = False,
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="Write covariance matrices, derived points and checks of every frame too.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    to: options.ToAll = None,
    eval_size: options.EvalSize = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    field: options.FieldName = None,
    seed: options.Seed = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the counts and cameras as JSON.", rich_help_panel=OUTPUT)
    ] = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Find the camera of every frame of a clip, from its tripod; run it again to go on after a stop."""
    from circlecal.batch.workers import cpu_count
    from circlecal.cli import console
    from circlecal.config import AUTO, absolute_files, load_config
    from circlecal.formats.annotation import ANNOTATION_FOLDER
    from circlecal.formats.unpacking import annotations_in
    from circlecal.pictures.inputs import absolute_input
    from circlecal.pictures.video import Sampling
    from circlecal.pipeline import field_of
    from circlecal.rig.venue import choose_field, read_venue
    from circlecal.tracking.field_of_clip import name_field
    from circlecal.tracking.run import run_track
    from circlecal.tracking.stretches import DEFAULT_EVERY, ClipRun

    console.configure_logging(quiet=quiet, verbose=verbose)
    if scheduler is not None:  # workers have another working folder
        inputs, out = [absolute_input(name) for name in inputs], out.absolute()
        annotations = None if annotations is None else annotations.absolute()
    if venue is not None:
        field = choose_field(venue, load_config(config, settings or ()).field, field)
    chosen = options.choose_config(config, settings, field, seed, tells_field=venue is None)
    chosen = chosen if scheduler is None else absolute_files(chosen)
    known = None if venue is None else read_venue(venue, field_of(chosen)[0])
    sampling = Sampling.parse(every or DEFAULT_EVERY, start, end, dashes="--")
    exports = options.choose_exports(to, eval_size)
    failures: list[Exception] = []
    videos = choose_videos(inputs, chosen.limits, console.error_reporter(failures))
    note_late_start(videos, sampling)
    if not quiet:
        note_idle_options((), None, None, to, eval_size)
    refused, count = 0, 0
    if videos:
        if chosen.field.template == AUTO:
            chosen = name_field(videos, sampling, chosen)
            if not quiet:
                console.print_note(f"--field auto: {chosen.field.template}")
        run = ClipRun(chosen, sampling, known, full, annotations_in(annotations, out) or out / ANNOTATION_FOLDER)
        ask = console.can_ask() and not quiet
        out = options.folder_of_run(
            out, run.digest, ask=ask, restart=restart, find_hint=lambda: _hint_at_annotations(run)
        )
        with console.resumable(restart=restart), console.progress_display(quiet=quiet, stage="tracking") as show:
            report = run_track(
                videos,
                run,
                out,
                workers=workers or cpu_count(),
                scheduler=scheduler,
                restart=restart,
                on_progress=show,
                on_step=show.step,
                on_survey=lambda name: None if quiet else console.print_note(f"{name}: looking for its cameras"),
                on_note=console.print_note,
                on_error=console.error_reporter(failures),
            )
        refused, count = report.progress.refused, report.progress.finished
        _write_further(videos, run, exports, out, video=video, quiet=quiet)
        _print_report(report, run, out, as_json=as_json, quiet=quiet)
        if not quiet:
            is_chosen = bool(field or config or settings)
            SportHints.of_run(out).print_hint(chosen, is_chosen=is_chosen, camera_prior=None, venue=venue)
    if failures or count == 0:
        raise typer.Exit(2)
    if refused:
        raise typer.Exit(1)


def _hint_at_annotations(run: ClipRun) -> str:
    """That annotations make another run, where there are any: frames without one are tracked by them too."""
    from circlecal.formats.annotation import digest_annotations

    if run.annotations is None or not digest_annotations(run.annotations):
        return ""
    where = f"annotations in {run.annotations} count too"
    return f"; {where}: if some were saved since, --restart takes them, and they are kept"


def _write_further(
    videos: Sequence[Video], run: ClipRun, exports: options.ExportChoice, out: Path, *, video: bool, quiet: bool
) -> None:
    """Write what is made of the finished results: outside formats, and overlay videos."""
    from itertools import groupby

    from circlecal.cli import console
    from circlecal.formats.exports import export_records
    from circlecal.pictures.video import clip_of
    from circlecal.pipeline import field_of
    from circlecal.records.parquet import PARQUET_NAME, write_parquet
    from circlecal.tracking.overlay_video import OVERLAY_NAME, write_overlay_video
    from circlecal.tracking.run import records_in_order

    template, circle = field_of(run.config)
    if exports.targets:
        export_records(records_in_order(out), exports.into(out), template, {}, template)
    if exports.parquet:
        write_parquet(records_in_order(out), out / PARQUET_NAME)
    if not video:
        return
    clips = {clip.name: clip for clip in videos}
    for clip_name, records in groupby(records_in_order(out), key=lambda record: clip_of(record.id)):
        clip = clips.get(clip_name)
        if clip is None:
            continue
        name = OVERLAY_NAME if len(videos) == 1 else f"{clip.name}.{OVERLAY_NAME}"
        count = clip.estimate_count(run.sampling)
        with console.count_steps("frame", count, quiet=quiet, stage=f"drawing {name}") as advance:
            write_overlay_video(out / name, clip, records, template, circle, run.step_s(clip), advance)


def _print_report(report: TrackReport, run: ClipRun, out: Path, *, as_json: bool, quiet: bool) -> None:
    from circlecal.cli import console
    from circlecal.pipeline import field_of
    from circlecal.records.log import RESULTS_NAME
    from circlecal.results.numbers import show_with_sigma
    from circlecal.tracking.run import tripod_facts

    counts, template = report.progress, field_of(run.config)[0]
    cameras = [
        {"clip": name, **facts} for name, venue in report.venues.items() for facts in tripod_facts(venue, template)
    ]
    if as_json:
        console.print_line(json.dumps({**asdict(counts), "results": str(out / RESULTS_NAME), "cameras": cameras}))
        return
    if quiet:
        return
    if cameras:
        console.print_table(
            "Cameras",
            ["clip", "camera", "found from", "x m", "y m", "z m", "pitch m"],
            [
                [c["clip"], c["camera"], str(c["frames"])]
                + [show_with_sigma(*c[axis]) for axis in ("x_m", "y_m", "z_m")]
                + [" x ".join(map(show_with_sigma, c["pitch_m"], c["pitch_sd_m"]))]
                for c in cameras
            ],
        )
    console.print_line(
        f"{console.count_of(counts.total, 'frame')}: {counts.calibrated} calibrated, "
        f"{counts.refused} refused; see {out / RESULTS_NAME}"
    )
