"""Ways to name what was measured in a frame that the chain refused, for a person to choose from.

Each long line is taken for each straight marking in turn and the camera estimated with that name alone. Of those that
the verdict accepts, the picture itself tells which are likely: the other lines that were measured must lie on markings,
and markings that are in view must be painted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from circlecal.api.calls import calibrate_annotation
from circlecal.config import Config
from circlecal.field import Circle, FieldTemplate
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.pipeline import field_of
from circlecal.results import FrameCalibration
from circlecal.stages.confirm import look_for_markings
from circlecal.workbench.answers import Answer, see_markings, suggestions
from circlecal.workbench.measuring import MeasuredPicture

LONGEST = 3
"""So many of the longest nameless lines are taken for every marking."""
SHOWN = 2
"""So many interpretations are offered."""


@dataclass(frozen=True, slots=True)
class Interpretation:
    """Names by index of the marking, the share of the expected markings that the picture shows, and the length of
    measured lines that are explained, pixels.
    """

    names: dict[int, str]
    found_share: float
    explained_px: float

    @property
    def score(self) -> float:
        """By which the best is chosen."""
        return self.explained_px * (0.25 + self.found_share)

    def describe(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "names": {str(index): name for index, name in self.names.items()},
            "found": round(self.found_share, 3),
            "explained": round(self.explained_px),
        }


def interpret(annotation: Annotation, measured: MeasuredPicture, config: Config) -> list[Interpretation]:
    """The best ways to name the lines of a frame, at most :data:`SHOWN`; none where it shows no circle.

    Parameters
    ----------
    annotation : Annotation
        What is known of the frame so far.
    measured : MeasuredPicture
        Its picture.
    config : Config
        Options of every stage.
    """
    template, circle = field_of(config)
    markings = annotation.markings
    if not any(m.kind == "curve" and m.name is not None and m.used for m in markings):
        return []
    taken = {m.name for m in markings if m.name is not None and m.used}
    lines = sorted(
        (k for k, m in enumerate(markings) if m.kind == "line" and m.name is None and m.used),
        key=lambda k: -length_px(markings[k]),
    )[:LONGEST]
    found = [
        tried
        for k in lines
        for line in template.lines
        if line.name not in taken and (tried := _try(annotation, k, line.name, measured, config, template, circle))
    ]
    best: list[Interpretation] = []
    for tried in sorted(found, key=lambda i: -i.score):
        if len(best) < SHOWN and all(_differ(tried, other) for other in best):
            best.append(tried)
    return best


def _differ(one: Interpretation, other: Interpretation) -> bool:
    return any(one.names.get(k, name) != name for k, name in other.names.items()) or not (
        one.names.keys() & other.names.keys()
    )


def length_px(marking: AnnotatedMarking) -> float:
    """Distance between the ends of a marking, pixels."""
    return float(np.hypot(*np.ptp(marking.points, axis=0)))


def name_marking(annotation: Annotation, index: int, name: str) -> Annotation:
    """The annotation with a name for one marking."""
    markings = list(annotation.markings)
    markings[index] = markings[index].model_copy(update={"name": name, "used": True})
    return annotation.model_copy(update={"markings": markings})


def _try(
    annotation: Annotation,
    index: int,
    name: str,
    measured: MeasuredPicture,
    config: Config,
    template: FieldTemplate,
    circle: Circle,
) -> Interpretation | None:
    """One line under one name; None where the verdict refuses the camera."""
    named = name_marking(annotation, index, name)
    found = calibrate_annotation(named, config, nameless=False)
    if found.status != "calibrated" or found.attempt.camera is None:
        return None
    told = Answer(named, found, template, ())
    names = {index: name} | suggestions(told, see_markings(found.view, template))
    explained = sum(length_px(annotation.markings[k]) for k in names)
    return Interpretation(names, share_of_paint(found, measured, template, circle), explained)


def share_of_paint(
    found: FrameCalibration, measured: MeasuredPicture, template: FieldTemplate, circle: Circle
) -> float:
    """Share of the markings in view, those apart that the camera was fitted to, on which the picture shows paint."""
    if found.attempt.camera is None or found.attempt.observations is None:
        return 0.0
    seen = found.attempt.observations
    known = frozenset(line.line for line in seen.lines if line.line) | {c.circle for c in seen.circles}
    region = None if measured.found.attempt.mask is None else measured.found.attempt.mask.field_region
    return look_for_markings(measured.light, found.attempt.camera, template, circle, known, region).found_share
