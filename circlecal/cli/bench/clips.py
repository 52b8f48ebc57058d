"""``circlecal bench track``: every frame of rendered clips."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options
from circlecal.cli.bench.tables import Json, Seed, format_figure, print_record, print_rows, split_names
from circlecal.cli.synth import Profile

if TYPE_CHECKING:
    from circlecal.evaluation.bench.track import TrackRow
    from circlecal.tracking.clock import Stage


def track(
    path: Annotated[
        Path | None,
        typer.Argument(metavar="PATH", help="Folder of circlecal synth --video. (default: clips are rendered)"),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="Clips to render.")] = 5,
    kinds: Annotated[str, typer.Option(help="Kinds of clips separated by commas; all when empty.")] = "",
    seconds: Annotated[float, typer.Option(min=0.2, max=60.0, help="Length of a clip.")] = 10.0,
    rate: Annotated[float, typer.Option(min=1.0, max=120.0, help="Frames per second.")] = 25.0,
    width: Annotated[int, typer.Option(min=320, max=3840, help="Width of the frames, 16:9.")] = 1280,
    profile: Annotated[
        Profile,
        typer.Option(
            metavar="NAME", help="Look of the clips, as of circlecal synth; rink, court, ice, wood: other sports."
        ),
    ] = Profile.BROADCAST,
    seed: Seed = 0,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    as_json: Json = False,
) -> None:
    """Track rendered clips: frames answered and right, errors, jitter, cuts, tripods, and time beside decoding."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.track import clips_of, render_and_track, spec_of, track_folder
    from circlecal.synthetic.video import CLIP_KINDS

    wanted = split_names(kinds, "--kinds", CLIP_KINDS)
    chosen = options.choose_config(config, settings)
    known = [name for name in CLIP_KINDS if name in wanted]
    with count_steps("clip", count if path is None else len(clips_of(path))) as advance:
        if path is None:
            found = render_and_track(known, count, seed, spec_of(width, seconds, rate, profile.value), chosen, advance)
        else:
            found = track_folder(path, chosen, advance)
    if as_json:
        print_record([asdict(row) for row in found])
        return
    _print_answers(found)
    _print_times(found)


def _print_answers(rows: list[TrackRow]) -> None:
    print_rows(
        "Rendered clips: main camera, mean error over the pitch in view, px at 1920",
        rows,
        {
            "clip": lambda r: r.clip,
            "frames": lambda r: str(r.frames),
            "answered": lambda r: f"{r.answered:.1%}",
            "good": lambda r: f"{r.good:.1%}",
            "wrong": lambda r: f"{r.wrong:.1%}",
            "in cuts": lambda r: str(r.in_cuts),
            "in replays": lambda r: str(r.in_replays),
            "median px": lambda r: format_figure(r.median_px, ".2f"),
            "p90 px": lambda r: format_figure(r.p90_px, ".2f"),
            "jitter px": lambda r: format_figure(r.jitter_median_px, ".3f"),
            "p90 jitter px": lambda r: format_figure(r.jitter_p90_px, ".3f"),
            "in 90 % region": lambda r: format_figure(r.coverage, ".0%"),
            "tripods": lambda r: str(r.tripods),
            "frames until found again": lambda r: ", ".join(map(str, r.found_again)) or "-",
        },
    )


def _print_times(rows: list[TrackRow]) -> None:
    from circlecal.tracking.clock import STAGES

    print_rows(
        "Time on one thread, ms a frame; the survey once a clip",
        rows,
        {
            "clip": lambda r: r.clip,
            "width": lambda r: str(r.width),
            "survey s": lambda r: f"{r.time.survey_s:.1f}",
            "decoding": lambda r: f"{r.time.decoding_ms:.1f}",
            "tracking": lambda r: f"{r.time.tracking_ms:.1f}",
            **{f"- {stage}": partial(_format_stage, stage) for stage in STAGES},
            "record": lambda r: f"{r.time.record_ms:.1f}",
            "x decoding": lambda r: f"{r.time.times_decoding:.1f}",
        },
    )


def _format_stage(stage: Stage, row: TrackRow) -> str:
    return f"{row.time.stages_ms.get(stage, 0.0):.1f}"
