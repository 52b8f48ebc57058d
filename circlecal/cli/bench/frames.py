"""``circlecal bench detect``, ``constants`` and ``sports``: the whole chain on single frames, rendered and real."""

from __future__ import annotations

from functools import partial
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli.bench.tables import Json, Seed, format_figure, print_record, print_rows, split_names

if TYPE_CHECKING:
    from circlecal.evaluation.bench.detect import ProfileRow
    from circlecal.evaluation.bench.sports import SportFrame, SportRow
    from circlecal.synthetic.sampling import SceneProfile

Profiles = Annotated[str, typer.Option(help="Profiles separated by commas; all when empty.")]
Width = Annotated[
    int, typer.Option(min=320, max=7680, help="Width of the rendered frames, 16:9; archive frames have their own.")
]


def detect(
    count: Annotated[int, typer.Option(min=1, help="Rendered frames per profile.")] = 20,
    seed: Seed = 0,
    profiles: Profiles = "",
    width: Width = 1920,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="JPEG", help="Only time the chain on this frame, e.g. samples/full_circle.jpg."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Run the whole chain on rendered frames: completeness, errors, predicted against true error, time by stage."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.detect import run_profiles

    if picture is not None:
        _time_picture(picture, as_json)
        return
    names = _split_profiles(profiles)
    with count_steps("frame", len(names) * count) as advance:
        found = run_profiles(names, count, seed, advance, width)
    if as_json:
        print_record([asdict(r) for r in found])
        return
    _print_profiles(found)


def _split_profiles(text: str) -> list[SceneProfile]:
    """Profiles of a list that is separated by commas; all where it is empty."""
    from circlecal.synthetic.sampling import PROFILE_BY_NAME

    names = split_names(text, "--profiles", PROFILE_BY_NAME)
    return [PROFILE_BY_NAME[name] for name in names or PROFILE_BY_NAME]


def _print_profiles(rows: list[ProfileRow]) -> None:
    print_rows(
        "Rendered frames, picture alone (mean reprojection error near the circle, px at 1920)",
        rows,
        {
            "profile": lambda r: r.profile,
            "frames": lambda r: str(r.frames),
            "calibrated": lambda r: f"{r.calibrated:.0%}",
            "good": lambda r: f"{r.good:.0%}",
            "wrong": lambda r: f"{r.wrong:.1%}",
            "right": lambda r: f"{r.right:.0%}",
            "median px": lambda r: format_figure(r.median_px, ".2f"),
            "p90 px": lambda r: format_figure(r.p90_px, ".2f"),
            "predicted px": lambda r: format_figure(r.predicted_median_px, ".2f"),
            "in 90 % region": lambda r: format_figure(r.coverage, ".0%"),
            "x decoding": lambda r: f"{r.times_decoding:.1f}",
        },
    )
    print_rows(
        "What the markings in view allow at best (Cramer-Rao bound from the truth, lines named right)",
        rows,
        {
            "profile": lambda r: r.profile,
            "bound px": lambda r: format_figure(r.bound_median_px, ".2f"),
            "bound good": lambda r: f"{r.bound_good:.0%}",
            "good": lambda r: f"{r.good:.0%}",
        },
    )
    stages = dict.fromkeys(name for r in rows for name in r.stage_ms)
    print_rows(
        "Median ms of each stage, one thread",
        rows,
        {
            "profile": lambda r: r.profile,
            "decoding": lambda r: f"{r.decoding_ms:.1f}",
            **{stage: partial(_format_stage, stage) for stage in stages},
        },
    )


def _format_stage(stage: str, row: ProfileRow) -> str:
    return format_figure(row.stage_ms.get(stage), ".1f")


def _time_picture(path: Path, as_json: bool) -> None:
    from dataclasses import asdict

    from circlecal.config import Config
    from circlecal.evaluation.bench.chain_time import time_file

    found = time_file(path, Config())
    if as_json:
        print_record({**asdict(found), "times_decoding": found.times_decoding})
        return
    named = {
        "decoding": found.decoding_ms,
        "decoding, between chains": found.decoding_in_turn_ms,
        "chain": found.chain_ms,
    }
    print_rows(
        f"{found.frame}, {found.width}x{found.height}, {found.status}: best of several runs, one thread",
        list({**named, **found.stage_ms}.items()),
        {
            "what": lambda part: part[0],
            "ms": lambda part: f"{part[1]:.2f}",
            "x decoding": lambda part: f"{part[1] / found.decoding_ms:.2f}",
        },
    )


def constants(
    count: Annotated[int, typer.Option(min=1, help="Rendered frames per profile.")] = 10,
    seed: Seed = 0,
    profiles: Profiles = "",
    width: Width = 1920,
    as_json: Json = False,
) -> None:
    """Show what each limit of the verdict separates: its check on right and on wrong answers to rendered frames."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.constants import collect_answers, summarise_gates

    names = _split_profiles(profiles)
    with count_steps("frame", len(names) * count) as advance:
        answers = collect_answers(names, count, seed, advance, width)
    rows = summarise_gates(answers)
    if as_json:
        print_record([asdict(row) for row in rows])
        return
    right, wrong = sum(a.is_right for a in answers), sum(a.is_wrong for a in answers)
    print_rows(
        f"Checks of the verdict on {right} right (<= 5 px) and {wrong} wrong (> 20 px) answers; values at 5, 50, 95 %",
        rows,
        {
            "check": lambda r: r.name,
            "limit": lambda r: f"{r.limit:.3g}",
            "right": lambda r: _format_quantiles(r.right_quantiles),
            "passed": lambda r: format_figure(r.right_passed, ".1%"),
            "wrong": lambda r: _format_quantiles(r.wrong_quantiles),
            "stopped": lambda r: format_figure(r.wrong_stopped, ".1%"),
            "by it alone": lambda r: str(r.stopped_alone),
        },
    )


def _format_quantiles(values: tuple[float, float, float]) -> str:
    return "-" if isnan(values[1]) else " ".join(f"{value:.3g}" for value in values)


def sports(
    pictures: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Pictures of any sports.")],
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="A JSON file for each, with its sport. (default: truth beside each of the folders)"
        ),
    ] = None,
    per_frame: Annotated[bool, typer.Option("--per-frame", help="Also what was tried for each frame.")] = False,
    as_json: Json = False,
) -> None:
    """Calibrate real frames with --field auto: whether the sport is recognised, and soccer loses nothing."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.sports import run_frames, summarise_sports
    from circlecal.pictures.files import find_frames

    with count_steps("frame", len(find_frames(pictures))) as advance:
        frames = [
            frame for folder in pictures for frame in run_frames(folder, truth or folder.parent / "truth", advance)
        ]
    rows = summarise_sports(frames)
    if as_json:
        print_record({"frames": [asdict(f) for f in frames], "sports": [asdict(r) for r in rows]})
        return
    if per_frame:
        _print_sport_frames(frames)
    _print_sports(rows)


def _print_sport_frames(frames: list[SportFrame]) -> None:
    print_rows(
        "Frame by frame: template, verdict, evidence in picture widths, share found, share explained",
        frames,
        {
            "frame": lambda f: f.id,
            "sport": lambda f: f.sport,
            "answer": lambda f: f.template if f.is_answered else str(f.code),
            "sport told": lambda f: f.told or "unknown",
            "error px": lambda f: format_figure(f.error_px, ".1f"),
            "s": lambda f: f"{f.seconds:.1f}",
            "tried": lambda f: "; ".join(f.tried),
        },
    )


def _print_sports(rows: list[SportRow]) -> None:
    print_rows(
        "Fields told by the picture (--field auto)",
        rows,
        {
            "sport": lambda r: r.sport,
            "frames": lambda r: str(r.frames),
            "answered": lambda r: str(r.answered),
            "right sport": lambda r: f"{r.right_sport} ({r.right_sport / max(r.answered, 1):.0%})",
            "sport told": lambda r: f"{r.sport_told} of {r.frames}",
            "good": lambda r: f"{r.good} of {r.with_reference}",
            "wrong": lambda r: str(r.wrong),
            "as if named": lambda r: f"{r.kept} of {r.frames}",
            "median s": lambda r: f"{r.median_s:.1f}",
            "worst s": lambda r: f"{r.worst_s:.1f}",
        },
    )
