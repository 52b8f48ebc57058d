"""``circlecal evaluate``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options

if TYPE_CHECKING:
    from circlecal.evaluation.agreement import Agreement
    from circlecal.evaluation.report import MethodReport, TruthReport

OFFICIAL_SIZE = "960x540"
"""At which SoccerNet evaluates."""


def evaluate(
    truth: Annotated[
        Path,
        typer.Argument(
            metavar="GT",
            help="Folder of SoccerNet line annotations, or of true cameras: all that PRED may be, and truth of synth; "
            "or annotations of circlecal annotate, compared with another person's in PRED.",
        ),
    ],
    predictions: Annotated[
        Path, typer.Argument(metavar="PRED", help="Folder of camera_<id>.json, results of circlecal or homographies.")
    ],
    threshold: Annotated[
        float, typer.Option("--threshold", "-t", min=0.01, help="Pixels at --size; 5, 10 and 20 are always printed.")
    ] = 5.0,
    size: Annotated[
        str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size at which is evaluated; officially 960x540.")
    ] = OFFICIAL_SIZE,
    pred_size: Annotated[
        str | None,
        typer.Option(
            "--pred-size",
            metavar="WIDTHxHEIGHT",
            help="Size for which the cameras were made. (default: what a file says, or twice the principal point)",
        ),
    ] = None,
    central: Annotated[
        bool, typer.Option("--central", help="Only frames with the circle and fewer than three straight lines.")
    ] = False,
    held_out: Annotated[
        list[str] | None,
        typer.Option("--held-out", metavar="CLASS", help="Class that the method did not see; repeatable."),
    ] = None,
    compare: Annotated[
        list[str] | None,
        typer.Option("--compare", metavar="NAME=FOLDER", help="Another method on the same frames; repeatable."),
    ] = None,
    as_json: options.Json = False,
    quiet: options.QuietNotes = False,
    verbose: options.Verbose = False,
) -> None:
    """Score cameras with the official SoccerNet or the WorldCup metrics, or compare what two people annotated."""
    from circlecal.cli import console
    from circlecal.config import load_config
    from circlecal.errors import InputError
    from circlecal.evaluation.agreement import compare_annotations, holds_annotations
    from circlecal.evaluation.reading import holds_cameras
    from circlecal.evaluation.report import as_record, evaluate_annotations, evaluate_truth

    console.configure_logging(quiet=quiet, verbose=verbose)
    if holds_annotations(truth) and holds_annotations(predictions):
        print_agreement(compare_annotations(truth, predictions, load_config()), as_json=as_json)
        return
    methods = _methods(predictions, compare or [])
    chosen, given = options.parse_size(size), options.parse_size(pred_size, "--pred-size")
    if not math.isfinite(threshold):
        raise InputError(f"--threshold {threshold}: is no number of pixels")
    if holds_cameras(truth):
        if size != OFFICIAL_SIZE:
            raise InputError(f"{truth}: holds cameras, which are compared at 1280x720; leave --size out")
        if central or held_out:
            raise InputError(f"{truth}: holds cameras; --central and --held-out need line annotations")
        against_truth = evaluate_truth(truth, methods, given)
        _require_answers({r.name: (r.answered, r.frames) for r in against_truth}, methods, truth, quiet=quiet)
        if as_json:
            console.print_json(json.dumps({"size": "1280x720", "methods": [as_record(r) for r in against_truth]}))
        else:
            print_truth(against_truth)
        return
    reports = evaluate_annotations(
        truth, methods, chosen, threshold_px=threshold, given_size=given, central=central, held_out=held_out or ()
    )
    _require_answers({r.name: (r.summary.answered, r.summary.frames) for r in reports}, methods, truth, quiet=quiet)
    if as_json:
        record = {"size": size, "threshold_px": threshold, "methods": [as_record(r) for r in reports]}
        console.print_json(json.dumps(record))
        return
    print_methods(f"SoccerNet calibration, {size}, JaC, precision and recall in %", reports, threshold)
    for report in reports:
        _print_classes(report, threshold)


def _methods(predictions: Path, compare: Sequence[str]) -> dict[str, Path]:
    from circlecal.errors import InputError

    methods = {predictions.name or str(predictions): predictions}
    for text in compare:
        name, separator, folder = text.partition("=")
        if not (name and separator and folder):
            raise InputError(f"--compare {text!r}: is not NAME=FOLDER")
        if name in methods:
            raise InputError(f"--compare {text!r}: the name {name!r} is given twice")
        methods[name] = Path(folder)
    return methods


def _require_answers(
    answers: Mapping[str, tuple[int, int]], methods: Mapping[str, Path], truth: Path, *, quiet: bool
) -> None:
    """Say of methods that answer no frame how files are told to be of one: mostly these are of other frames.

    Raises
    ------
    InputError
        No method answers any.
    """
    from circlecal.cli import console
    from circlecal.errors import InputError

    silent = [
        f"{methods[name]}: has a camera for none of the {console.count_of(frames, 'frame')} of {truth}; files are of "
        "one frame where their names agree"
        for name, (answered, frames) in answers.items()
        if answered == 0
    ]
    if len(silent) == len(answers):
        raise InputError(silent[0])
    for told in () if quiet else silent:
        console.print_note(told)


def print_agreement(found: Agreement, *, as_json: bool = False) -> None:
    """Print what two people annotated alike and differently: one row per frame, the worst first, and per marking."""
    from circlecal.cli import console
    from circlecal.evaluation.agreement import list_differences
    from circlecal.formats.meaning import REFERENCE_WIDTH_PX

    if as_json:
        console.print_json(json.dumps(found.as_record()))
        return
    columns = ["frame", "first", "second", "markings", "median px", "camera px", "camera, largest", "says differently"]
    rows = []
    for frame in found.frames:
        both, only = len(frame.lines_px), len(frame.only_first) + len(frame.only_second)
        cameras = [_known(frame.camera_px), _known(frame.camera_largest_px)]
        refused = [who for who, good in zip(("first", "second"), frame.calibrated, strict=True) if not good]
        told = [*list_differences(frame), *(f"no camera from the {who}" for who in refused)]
        authors = [author or "-" for author in frame.authors]
        marked = f"{both} of both, {only} of one"
        rows.append([frame.id, *authors, marked, _known(frame.median_px), *cameras, "; ".join(told) or "-"])
    title = f"Agreement in {len(rows)} frames, pixels at {REFERENCE_WIDTH_PX:.0f} px width"
    console.print_table(title, columns, rows)
    lines = [
        [
            row.name.replace("_", " "), str(row.frames), _known(row.median_px), _known(row.largest_px),
            str(row.only_first), str(row.only_second),
        ]
        for row in found.rows()
    ]  # fmt: skip
    columns = ["marking", "frames", "median px", "largest px", "only first", "only second"]
    console.print_table("Markings that were named", columns, lines)
    for who, missing in (("first", found.only_first), ("second", found.only_second)):
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            console.print_note(f"annotated in the {who} folder only: {missing[0]}{more}")


def _known(value: float | None) -> str:
    return "-" if value is None else figure(value)


def print_methods(title: str, reports: Sequence[MethodReport], threshold: float) -> None:
    """Print one row per method."""
    from circlecal.cli import console

    thresholds = sorted(a.threshold_px for a in reports[0].summary.accuracies)
    columns = ["method", "answered", "completeness %"]
    for value in thresholds:
        columns += [f"JaC{value:g}", f"CR x JaC{value:g}", f"strict {value:g}"]
    columns += [f"95 % of CR x JaC{threshold:g}", "first minus this", "precision", "recall", "MRE px", "median px"]
    columns += ["no element %", "held out px", "ground m"]
    console.print_table(title, columns, [_method_row(report, thresholds, threshold) for report in reports])


def _method_row(report: MethodReport, thresholds: Sequence[float], threshold: float) -> list[str]:
    summary = report.summary
    by_threshold = {a.threshold_px: a for a in summary.accuracies}
    row = [report.name, f"{summary.answered} of {summary.frames}", f"{100 * summary.completeness:.1f}"]
    for value in thresholds:
        accuracy = by_threshold[value]
        row += [f"{100 * share:.1f}" for share in (accuracy.answered, accuracy.final, accuracy.strict)]
    behind = report.behind_first
    row.append(f"{100 * report.interval.low:.1f} to {100 * report.interval.high:.1f}")
    row.append(
        "-" if behind is None else f"{100 * behind.mean:+z.1f} ({100 * behind.low:+z.1f} to {100 * behind.high:+z.1f})"
    )
    chosen = by_threshold[threshold]
    row += [f"{100 * chosen.precision:.1f}", f"{100 * chosen.recall:.1f}"]
    row += [figure(summary.mean_error_px), figure(summary.median_error_px), f"{100 * summary.uncovered:.1f}"]
    return [*row, figure(summary.held_out_px), figure(report.median_ground_m, 3)]


def figure(value: float, decimals: int = 2) -> str:
    """Text of a number that may be missing or infinite."""
    return "-" if math.isnan(value) else "inf" if math.isinf(value) else f"{value:.{decimals}f}"


def _print_classes(report: MethodReport, threshold: float) -> None:
    from circlecal.cli import console

    rows = [
        [c.name, str(c.right), str(c.wrong), str(c.missed), f"{100 * c.accuracy:.1f}", figure(c.median_px)]
        for c in report.summary.classes
    ]
    columns = ["class", "right points", "wrong", "missed", "accuracy %", "median px"]
    console.print_table(f"{report.name}, points of each class at {threshold:g} px", columns, rows)


def print_truth(reports: Sequence[TruthReport]) -> None:
    """Print one row per method: means, medians, metres."""
    from circlecal.cli import console

    columns = ["method", "answered", "IoU part %", "IoU whole %", "projection, of 100 x 60", "reprojection, heights"]
    columns += ["ground m median", "ground m 90 %"]
    rows = []
    for report in reports:
        pairs = [
            (report.mean.iou_part, report.median.iou_part, 100.0, 1),
            (report.mean.iou_whole, report.median.iou_whole, 100.0, 1),
            (report.mean.projection, report.median.projection, 1.0, 3),
            (report.mean.reprojection, report.median.reprojection, 1.0, 4),
        ]
        cells = [
            f"{figure(unit * mean, places)} ({figure(unit * median, places)})" for mean, median, unit, places in pairs
        ]
        ground = [figure(value, 3) for value in report.ground_m]
        rows.append([report.name, f"{report.answered} of {report.frames}", *cells, *ground])
    console.print_table("WorldCup metrics, mean (median), 1280x720", columns, rows)
