"""A whole evaluation, ready to be printed: one or several methods against annotations, or against true cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from circlecal.errors import InputError
from circlecal.evaluation.aggregate import MethodComparisons, Summary, compare_frames, summarise_method
from circlecal.evaluation.bootstrap import Interval, bootstrap_mean
from circlecal.evaluation.homography_metrics import HomographyScores, score_homography, template_homography
from circlecal.evaluation.metres import errors_of_annotated_points, ground_errors
from circlecal.evaluation.reading import (
    CENTRAL_CLASS,
    HALFWAY_CLASS,
    Annotated,
    Prediction,
    is_central,
    read_annotated_points,
    read_predictions,
)
from circlecal.evaluation.soccernet_metric import CLASSES
from circlecal.formats.cameras import Size
from circlecal.formats.worldcup import PICTURE
from circlecal.geometry.projective import Array

THRESHOLDS_PX = (5.0, 10.0, 20.0)
SEED = 0


@dataclass(frozen=True, slots=True)
class MethodReport:
    """One method against annotations.

    Attributes
    ----------
    name : str
        As the user named it.
    summary : Summary
        Its figures.
    interval : Interval
        Of its final score at the first threshold.
    behind_first : Interval or None
        Of the first method's final score minus this one's, on the same frames; None of the first itself.
    median_ground_m : float
        Median distance on the ground of the points of circle and halfway line from their element, metres; points of
        unanswered frames are infinitely far.
    """

    name: str
    summary: Summary
    interval: Interval
    behind_first: Interval | None
    median_ground_m: float


@dataclass(frozen=True, slots=True)
class TruthReport:
    """One method against true cameras or homographies: means and medians over the answered frames.

    ``ground_m`` are the median and the 90th percentile over all points near the circle, metres.
    """

    name: str
    frames: int
    answered: int
    mean: HomographyScores
    median: HomographyScores
    ground_m: tuple[float, float]


def evaluate_annotations(
    truth: Path,
    methods: Mapping[str, Path],
    size: Size,
    *,
    threshold_px: float = THRESHOLDS_PX[0],
    given_size: Size | None = None,
    central: bool = False,
    held_out: Sequence[str] = (),
) -> list[MethodReport]:
    """Score folders of cameras against a folder of line annotations.

    Parameters
    ----------
    truth : path
        ``<id>.json`` line annotations.
    methods : mapping of str to path
        Folders of cameras by name; the others are compared with the first.
    size : (int, int)
        At which is evaluated.
    threshold_px : float
        At which labellings are chosen and intervals computed; 5, 10 and 20 px are always reported.
    given_size : (int, int), optional
        For which the cameras were made.
    central : bool
        Only frames that show the circle and fewer than three straight lines.
    held_out : sequence of str
        Classes that the methods did not see.

    Raises
    ------
    InputError
        A folder or file that cannot be used, an unknown class, or no frame left.
    """
    unknown = [name for name in held_out if name.strip() not in CLASSES]
    if unknown:
        raise InputError(f"--held-out {unknown[0]!r}: is no class of SoccerNet; known: {', '.join(CLASSES)}")
    hidden = {name.strip() for name in held_out}
    annotated = read_annotated_points(truth, size)
    if central:
        annotated = {frame: classes for frame, classes in annotated.items() if is_central(classes)}
    if not annotated:
        raise InputError(f"{truth}: no frame shows the circle and fewer than three straight lines")
    predictions = {name: read_predictions(folder, size, given_size) for name, folder in methods.items()}
    return report_methods(annotated, predictions, size, threshold_px, hidden.__contains__)


def report_methods(
    annotated: Mapping[str, Annotated],
    predictions: Mapping[str, Mapping[str, Prediction]],
    size: Size,
    threshold_px: float = THRESHOLDS_PX[0],
    held_out: Callable[[str], bool] = lambda _: False,
) -> list[MethodReport]:
    """Figures of every method on the same frames; the others are compared with the first."""
    thresholds = (threshold_px, *(t for t in THRESHOLDS_PX if t != threshold_px))
    reports: list[MethodReport] = []
    first: Array | None = None
    for name, found in predictions.items():
        method = compare_frames(annotated, found, *size)
        scores = method.per_frame(threshold_px)
        behind = None if first is None else bootstrap_mean(first - scores, np.random.default_rng(SEED))
        first = scores if first is None else first
        reports.append(
            MethodReport(
                name,
                summarise_method(method, thresholds, held_out),
                bootstrap_mean(scores, np.random.default_rng(SEED)),
                behind,
                _median_ground(method, found),
            )
        )
    return reports


def _median_ground(method: MethodComparisons, predictions: Mapping[str, Prediction]) -> float:
    errors = [np.zeros(0)]
    for frame, classes in method.annotated.items():
        if frame in method.answered:
            errors.append(errors_of_annotated_points(classes, predictions[frame].camera))
        else:
            count = sum(len(classes.get(name, ())) for name in (CENTRAL_CLASS, HALFWAY_CLASS))
            errors.append(np.full(count, np.inf))
    joined = np.sort(np.concatenate(errors))
    return float(joined[len(joined) // 2]) if len(joined) else float("nan")


def evaluate_truth(truth: Path, methods: Mapping[str, Path], given_size: Size | None = None) -> list[TruthReport]:
    """Score folders of cameras or homographies against true ones, with the WorldCup metrics and in metres.

    Raises
    ------
    InputError
        A folder or file that cannot be used.
    """
    true = read_predictions(truth, PICTURE, given_size)
    return [
        _truth_report(name, true, read_predictions(folder, PICTURE, given_size)) for name, folder in methods.items()
    ]


def _truth_report(name: str, true: Mapping[str, Prediction], found: Mapping[str, Prediction]) -> TruthReport:
    rng = np.random.default_rng(SEED)
    rows, ground = [], [np.zeros(0)]
    for frame, expected in true.items():
        given = found.get(frame)
        if given is None:
            continue
        first = template_homography(expected.camera, expected.H_image_field)
        second = template_homography(given.camera, given.H_image_field)
        if first is None or second is None:
            continue
        scores = score_homography(first, second, rng)
        rows.append([scores.iou_part, scores.iou_whole, scores.projection, scores.reprojection])
        ground.append(ground_errors(expected.camera, given.camera, *PICTURE))
    return TruthReport(
        name,
        len(true),
        len(rows),
        HomographyScores(*_column_figures(rows, np.mean)),
        HomographyScores(*_column_figures(rows, np.median)),
        _quantiles(np.concatenate(ground)),
    )


def _column_figures(rows: list[list[float]], figure: Callable[[Array], Any]) -> list[float]:
    columns = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    finite = [column[np.isfinite(column)] for column in columns]
    return [float(figure(column)) if len(column) else float("nan") for column in finite]


def _quantiles(errors: Array) -> tuple[float, float]:
    if len(errors) == 0:
        return float("nan"), float("nan")
    low, high = np.quantile(errors, [0.5, 0.9], method="nearest")
    return float(low), float(high)


def as_record(report: MethodReport | TruthReport) -> dict[str, Any]:
    """The figures for machines; numbers that are not finite become null."""
    record = asdict(report)
    if isinstance(report, MethodReport):
        record["summary"]["completeness"] = report.summary.completeness
        for row, found in zip(record["summary"]["classes"], report.summary.classes, strict=True):
            row["accuracy"] = found.accuracy
    return _finite(record)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    return [_finite(inner) for inner in value] if isinstance(value, list | tuple) else value
