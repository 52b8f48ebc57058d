"""``circlecal audit``."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options

if TYPE_CHECKING:
    from circlecal.evaluation.audit import AuditedFrame, PairRow


class CenterChoice(StrEnum):
    """Whose imaged centre the lines should pass through."""

    OURS = "ours"
    KP = "kp"


def audit(
    keypoints: Annotated[Path, typer.Argument(metavar="KEYPOINTS", help="Keypoint file of PnLCalib, or a folder.")],
    center: Annotated[
        CenterChoice, typer.Option("--center", help="kp: keypoint 51; ours: derived from all keypoints and lines.")
    ] = CenterChoice.KP,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Write the distributions as .png or .svg.")
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size of the pictures.")] = "1920x1080",
    config: Annotated[
        str,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE|NAME",
            help="YAML file, or a name such as broadcast.",
            autocompletion=options.complete_config,
        ),
    ] = "annotations",
    settings: options.Settings = None,
    as_json: options.Json = False,
    no_frames: Annotated[bool, typer.Option("--no-frames", help="Leave out the table of the frames.")] = False,
    quiet: options.QuietNotes = False,
    verbose: options.Verbose = False,
) -> None:
    """Measure how far the imaged centre is from the lines through opposed keypoints of the circle."""
    from circlecal.cli import console
    from circlecal.evaluation.audit import audit_frames, distances_by_pair, pair_rows, read_keypoints
    from circlecal.evaluation.audit_plot import check_plot, plot_distances

    console.configure_logging(quiet=quiet, verbose=verbose)
    if plot is not None:
        check_plot(plot)
    chosen = options.parse_size(size)
    frames = audit_frames(read_keypoints(keypoints, chosen), center.value, options.choose_config(config, settings))
    by_pair = distances_by_pair(frames)
    told = f"centre: {center.value}, {chosen[0]}x{chosen[1]}"
    if plot is not None:
        plot_distances(by_pair, plot, f"Opposed keypoints of the circle, {told}")
    if as_json:
        for frame in frames:
            distances = {f"{a}-{b}": round(d, 4) for (a, b), d in frame.distances_px.items()}
            console.print_json(json.dumps({"id": frame.id, "distances_px": distances, "reason": frame.reason}))
        return
    if not no_frames:
        _print_frames(frames, told)
    _print_pairs(pair_rows(by_pair), told)


def _print_frames(frames: list[AuditedFrame], told: str) -> None:
    """Distances of every frame, under whose centre it is and the size of picture whose pixels they are."""
    from circlecal.cli import console
    from circlecal.evaluation.audit import OPPOSED

    rows = []
    for frame in frames:
        cells = [console.number(frame.distances_px.get(pair), 1) for pair in OPPOSED]
        rows.append([frame.id, *cells, frame.reason or ""])
    console.print_table(f"Distance of the centre, px ({told})", ["id", *(f"{a}-{b}" for a, b in OPPOSED), ""], rows)


def _print_pairs(pairs: list[PairRow], told: str) -> None:
    """Figures of every opposed pair; the row of all counts a frame once for each pair that it shows."""
    from circlecal.cli import console

    columns = ["keypoints", "distances", "mean px", "median px", "90 % px", "largest px"]
    rows = [
        [p.pair, str(p.count), *(f"{v:.2f}" for v in (p.mean_px, p.median_px, p.p90_px, p.largest_px))] for p in pairs
    ]
    console.print_table(f"Distance of the centre from the line through opposed keypoints ({told})", columns, rows)
