"""``circlecal bench annotations`` and ``annotate``: real frames whose markings a person or a program has named."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options
from circlecal.cli.bench.tables import Json, Seed, format_figure, print_record, print_rows, split_names

if TYPE_CHECKING:
    from circlecal.evaluation.bench.annotations import AnnotationRow


def score_annotations(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Folder of sets, each a folder with ground_truth (SoccerNet line annotations) and, where there are "
            "any, <peer>_camera (SoccerNet cameras) and pnlcalib_keypoints (detections).",
        ),
    ],
    sets: Annotated[str, typer.Option(help="Sets separated by commas; all when empty.")] = "",
    config: Annotated[str, typer.Option("--config", "-c", help="YAML file, or a name.")] = "annotations",
    settings: options.Settings = None,
    as_json: Json = False,
) -> None:
    """Score annotated real frames with the official metric at 1920x1080: published peers, then circlecal."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.annotations import run_annotations, set_names

    names = split_names(sets) or set_names(path)
    chosen = options.choose_config(config, settings)
    with count_steps("set", len(names)) as advance:
        found = run_annotations(path, chosen, names, advance)
    if as_json:
        print_record([asdict(r) for r in found])
        return
    _print_annotations(found)


def _print_annotations(rows: list[AnnotationRow]) -> None:
    words = {"circle and halfway line": "frames with circle and halfway line", "all": "frames, all that there are"}
    for name, kind in dict.fromkeys((r.set_name, r.frames_kind) for r in rows):
        chosen = [r for r in rows if (r.set_name, r.frames_kind) == (name, kind)]
        print_rows(
            f"{name}: {chosen[0].frames} {words.get(kind, kind)}, 1920x1080, JaC in %, misses as 0",
            chosen,
            {
                "method": lambda r: r.method,
                "input": lambda r: r.input_name,
                "answered": lambda r: str(r.answered),
                "JaC5": lambda r: f"{100 * r.jac_5:.1f}",
                "JaC10": lambda r: f"{100 * r.jac_10:.1f}",
                "other lines px": lambda r: f"{r.held_out_px:.2f}",
                "JaC5 minus the first (95 %)": _format_lead,
            },
        )


def _format_lead(row: AnnotationRow) -> str:
    if row.ahead is None:
        return "-"
    mean, low, high = (100 * value for value in (row.ahead.mean, row.ahead.low, row.ahead.high))
    return f"{mean:+z.1f} ({low:+z.1f} to {high:+z.1f})"


def click_frames(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FOLDER]",
            help="Real frames: pictures in images, a JSON file with elements for each in truth; rendered ones alone "
            "without.",
        ),
    ] = None,
    rendered: Annotated[int, typer.Option(min=0, help="Rendered frames of each kind.")] = 10,
    seed: Seed = 0,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    as_json: Json = False,
) -> None:
    """Count clicks in the workbench until a refused or doubtful frame is calibrated and good, and time a change."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.clicks import PROFILES, count_clicks, summarise_clicks

    chosen = options.choose_config(config, settings)
    real = 0 if path is None else len(list((path / "truth").glob("*.json")))
    with count_steps("frame", real + len(PROFILES) * rendered) as advance:
        rows = count_clicks(path, rendered, seed, advance, chosen)
    summary = summarise_clicks(rows)
    if as_json:
        print_record({"frames": [asdict(row) for row in rows], "groups": [asdict(group) for group in summary]})
        return
    print_rows(
        "Refused and doubtful frames, clicked until calibrated and good",
        summary,
        {
            "frames of": lambda g: g.name,
            "frames": lambda g: str(g.frames),
            "good already": lambda g: str(g.good_already),
            "clicks: median": lambda g: format_figure(g.median_clicks, "g"),
            "90 %": lambda g: format_figure(g.p90_clicks, "g"),
            "given up": lambda g: str(g.given_up),
            "slowest change ms": lambda g: format_figure(g.slowest_ms, ".0f"),
        },
    )
    print_rows(
        "Frame by frame",
        rows,
        {
            "frame": lambda r: r.frame,
            "before": lambda r: r.state,
            "clicks": lambda r: "given up" if r.clicks is None else str(r.clicks),
            "what was done": lambda r: ", then ".join(r.steps) or "-",
        },
    )
