"""Figures of a whole set of frames from the comparisons of each.

All shares are 0 to 1, distances in pixels at the size at which was compared. A frame without an answer counts 0 in the
product of completeness and mean accuracy, which is therefore also the accuracy with misses as 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from circlecal.evaluation.reading import Annotated, Prediction
from circlecal.evaluation.soccernet_metric import Comparison, FrameComparison, compare_frame
from circlecal.geometry.projective import Array


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Accuracy at one threshold.

    Attributes
    ----------
    threshold_px : float
        Of the distance.
    answered : float
        Mean Jaccard index (JaC) over the frames with an answer: the official accuracy.
    final : float
        Completeness times that, i.e. JaC with misses as 0: the official final score.
    strict : float
        Completeness times accuracy without allowing the field to be turned.
    precision, recall : float
        Means over the frames where they are defined.
    """

    threshold_px: float
    answered: float
    final: float
    strict: float
    precision: float
    recall: float


@dataclass(frozen=True, slots=True)
class ClassRow:
    """One class over all answered frames: right, wrong and missed points, and the median distance of its points."""

    name: str
    right: int
    wrong: int
    missed: int
    median_px: float

    @property
    def accuracy(self) -> float:
        """Right points over all."""
        total = self.right + self.wrong + self.missed
        return self.right / total if total else 0.0


@dataclass(frozen=True, slots=True)
class Summary:
    """One method on a set of frames.

    Attributes
    ----------
    frames, answered : int
        How many there are, and how many have a camera.
    accuracies : tuple of Accuracy
        By threshold.
    mean_error_px, median_error_px : float
        Distance of the annotated points from the predicted element of their class; nan where there is none.
    uncovered : float
        Share of the annotated points, over all frames, for which there is no such element.
    held_out_px : float
        Median distance of the points of the elements that were not input; points without a predicted element, also of
        unanswered frames, count as infinitely far.
    classes : tuple of ClassRow
        By class, at the first threshold.
    """

    frames: int
    answered: int
    accuracies: tuple[Accuracy, ...]
    mean_error_px: float
    median_error_px: float
    uncovered: float
    held_out_px: float
    classes: tuple[ClassRow, ...]

    @property
    def completeness(self) -> float:
        """Share of the frames that have a camera."""
        return self.answered / self.frames if self.frames else 0.0


@dataclass(frozen=True, slots=True)
class MethodComparisons:
    """The comparisons of one method: those of its answered frames, and the annotation of all."""

    annotated: Mapping[str, Annotated]
    answered: Mapping[str, FrameComparison]

    def per_frame(self, threshold_px: float, strict: bool = False) -> Array:
        """JaC of every frame (N,), in the order of the annotations, 0 for misses."""
        return np.array([self._jaccard(frame, threshold_px, strict) for frame in self.annotated])

    def _jaccard(self, frame: str, threshold_px: float, strict: bool) -> float:
        found = self.answered.get(frame)
        if found is None:
            return 0.0
        return (found.direct if strict else found.official(threshold_px)).jaccard(threshold_px)


def compare_frames(
    annotated: Mapping[str, Annotated], predictions: Mapping[str, Prediction], width: int, height: int
) -> MethodComparisons:
    """Compare every annotated frame that has a camera."""
    compared = {
        frame: compare_frame(classes, predictions[frame].camera, width, height)
        for frame, classes in annotated.items()
        if frame in predictions
    }
    return MethodComparisons(annotated, compared)


def summarise_method(
    method: MethodComparisons, thresholds_px: Sequence[float], held_out: Callable[[str], bool] = lambda _: False
) -> Summary:
    """Figures of one method.

    Parameters
    ----------
    method : MethodComparisons
        Its comparisons.
    thresholds_px : sequence of float
        The first is that at which the labelling of each frame is chosen for distances and classes.
    held_out : callable
        Whether a class was kept from the method.
    """
    first = thresholds_px[0]
    official = {frame: found.official(first) for frame, found in method.answered.items()}
    errors = _join(d for found in official.values() for d in found.distances_px.values())
    points = sum(len(p) for classes in method.annotated.values() for p in classes.values())
    return Summary(
        frames=len(method.annotated),
        answered=len(method.answered),
        accuracies=tuple(_accuracy(method, threshold) for threshold in thresholds_px),
        mean_error_px=float(errors.mean()) if len(errors) else float("nan"),
        median_error_px=float(np.median(errors)) if len(errors) else float("nan"),
        uncovered=1.0 - len(errors) / points if points else 0.0,
        held_out_px=median_of_held_out_points(method, official, held_out),
        classes=_class_rows(list(official.values()), first),
    )


def median_of_held_out_points(
    method: MethodComparisons, official: Mapping[str, Comparison], held_out: Callable[[str], bool]
) -> float:
    """Median distance of the held-out points, those without a predicted element infinitely far; nan without any."""
    seen = _join(d for found in official.values() for name, d in found.distances_px.items() if held_out(name))
    total = sum(len(p) for classes in method.annotated.values() for name, p in classes.items() if held_out(name))
    if total == 0:
        return float("nan")
    everything = np.sort(np.concatenate([seen, np.full(max(total - len(seen), 0), np.inf)]))
    middle = everything[[(len(everything) - 1) // 2, len(everything) // 2]]
    return float(middle[1] if np.isinf(middle).any() else middle.mean())


def _accuracy(method: MethodComparisons, threshold: float) -> Accuracy:
    found = list(method.answered.values())
    official = [frame.official(threshold) for frame in found]
    precision = [p for c in official if (p := c.precision(threshold)) is not None]
    recall = [r for c in official if (r := c.recall(threshold)) is not None]
    return Accuracy(
        threshold_px=threshold,
        answered=_mean([c.jaccard(threshold) for c in official]),
        final=_mean(list(method.per_frame(threshold))),
        strict=_mean(list(method.per_frame(threshold, strict=True))),
        precision=_mean(precision),
        recall=_mean(recall),
    )


def _class_rows(official: list[Comparison], threshold: float) -> tuple[ClassRow, ...]:
    counts: dict[str, Array] = {}
    for found in official:
        for name, counted in found.class_points(threshold).items():
            counts[name] = counts.get(name, np.zeros(3)) + np.array(counted)
    rows = []
    for name in sorted(counts):
        distances = _join(found.distances_px.get(name, np.zeros(0)) for found in official)
        median = float(np.median(distances)) if len(distances) else float("nan")
        right, wrong, missed = (int(count) for count in counts[name])
        rows.append(ClassRow(name, right, wrong, missed, median))
    return tuple(rows)


def _join(parts: Iterable[Array]) -> Array:
    return np.concatenate([np.zeros(0), *parts])


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else 0.0
