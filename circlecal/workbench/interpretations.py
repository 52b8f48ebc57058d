"""Ways to name what was measured in a frame that the chain refused, for a person to choose from.

Each long line is taken for each straight marking in turn and the camera estimated with that name alone. Of those that
the verdict accepts, the picture itself tells which are likely: the other lines that were measured must lie on markings,
and markings that are in view must be painted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from circlecal.api.calls import calibrate_annotation
from circlecal.config import Config
from circlecal.field import Arc, Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.paint.matched_filter import CLEAR
from circlecal.pipeline import field_of
from circlecal.results import Agreement, CameraFit, FrameCalibration
from circlecal.stages.confirm import look_for_markings, measure_circle_sectors
from circlecal.workbench.answers import (
    Answer,
    continues,
    distance_to_polyline,
    place_sigma,
    see_markings,
    suggest_names,
)
from circlecal.workbench.measuring import MeasuredPicture

LONGEST = 2
"""So many of the longest nameless lines are taken for every marking; pieces of one line count once."""
MOST_CURVES, BESIDE, ALWAYS_BESIDE = 2, 3, ("side_line_top",)
"""Of a picture in which no circle was believed: so many of its curves are taken for every circle and arc, with so many
of the straight markings nearest to these, and the far touchline, which main cameras see longest.
"""
SHOWN = 2
"""So many interpretations are offered."""
LEAST_PAINTED = 0.5
"""Share of its sectors in view that show paint where a curve is offered as a whole circle: a penalty arc of a real
frame that was taken for the centre circle has 0.39, the circle of a rendered one all of them.
"""
ALIKE_M = 1.0
"""Two interpretations that put the ground no further apart (median, metres) are one: the crown of the field moves two
views of one scene by less, and two parallel markings of a field are at least 5 m apart.
"""
SURER = 0.8
"""A further line is named where sigma becomes smaller than this share: less is not worth the risk of a wrong name."""
NEAR_PX, NEAR_SIGMAS, NEAREST = 4.0, 3.0, 3
"""Which markings a further line may be: so near to where the camera puts them, pixels at 1920 px width and standard
deviations of their places, and of those so many.
"""
GROUND_GRID = (8, 5)
"""Columns and rows of the places in the picture at which interpretations are compared."""


@dataclass(frozen=True, slots=True)
class Interpretation:
    """Names for measured lines, and what speaks for them.

    Attributes
    ----------
    names : dict of int to str
        Names by index of the marking.
    found_share : float
        Share of the expected markings that the picture shows.
    expected_px : float
        Length of those, pixels.
    explained_px : float
        Length of measured lines that are explained, pixels.
    ground : (N, 2) array
        Field points that the camera sees at fixed places of the picture, metres, nan above the horizon.
    on_usual_side : bool
        Whether the camera stands where ``correspondences.camera_side`` says.
    """

    names: dict[int, str]
    found_share: float
    expected_px: float
    explained_px: float
    ground: Array
    on_usual_side: bool

    @property
    def rank(self) -> tuple[bool, float]:
        """By which the best is chosen, the smaller the better: measured lines that are explained and markings that are
        where they are expected count for it, expected ones that are missing against it, by their lengths.
        """
        return not self.on_usual_side, -self.explained_px - (2.0 * self.found_share - 1.0) * self.expected_px

    def is_like(self, other: Interpretation) -> bool:
        """Whether both put the same ground into the picture, as it is or turned by 180 degrees: nobody sees which."""
        off = min(_median_distance(self.ground, sign * other.ground) for sign in (1.0, -1.0))
        return off < ALIKE_M

    def describe(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "names": {str(index): name for index, name in self.names.items()},
            "found": round(self.found_share, 3),
            "explained": round(self.explained_px),
        }


def interpret(
    annotation: Annotation,
    measured: MeasuredPicture,
    config: Config,
    *,
    is_wanted: Callable[[], bool] = lambda: True,
) -> list[Interpretation]:
    """The best ways to name the lines of a frame, at most :data:`SHOWN`; none where it shows no curve.

    One line is named first; what then lies on its place, or may lie there and makes the camera surer, is named too.

    Parameters
    ----------
    annotation : Annotation
        What is known of the frame so far.
    measured : MeasuredPicture
        Its picture.
    config : Config
        Options of every stage.
    is_wanted : callable
        Asked after each name that is tried, of which there may be thirty with a second each; where the answer is no,
        nothing is found.
    """
    template, circle = field_of(config)
    search = _Search(measured, config, template, circle)
    has_curve = any(m.kind == "curve" and m.name is not None and m.used for m in annotation.markings)
    found: list[_Tried] = []
    for tried in (_try_lines if has_curve else _try_curves)(annotation, search):
        if not is_wanted():
            return []
        if tried is not None:
            found.append(tried)
    best: list[_Tried] = []
    for tried in sorted(found, key=lambda t: t.offered.rank):
        if len(best) < SHOWN and not any(tried.offered.is_like(other.offered) for other in best):
            best.append(tried)
    return sorted((search.extend(tried).offered for tried in best), key=lambda i: i.rank)


def _try_lines(annotation: Annotation, search: _Search) -> Iterator[_Tried | None]:
    """The longest lines taken for every straight marking that has no line yet; None for each that is refused."""
    taken = {m.name for m in annotation.markings if m.name is not None and m.used}
    for k in _longest_nameless(annotation):
        for line in search.template.lines:
            if line.name not in taken:
                yield search.try_name(annotation, k, line.name)


def _try_curves(annotation: Annotation, search: _Search) -> Iterator[_Tried | None]:
    """Curves that nobody named taken for a circle or an arc, together with the longest line; None for each that is
    refused.
    """
    curves = [k for k, m in enumerate(annotation.markings) if m.kind == "curve" and m.name is None][:MOST_CURVES]
    for k in curves:
        for element in (*search.template.circles, *search.template.arcs):
            named = name_marking(annotation, k, element.name)
            for index in _longest_nameless(annotation)[:1]:
                for name in _lines_beside(element, search.template):
                    yield search.try_name(named, index, name, given={k: element.name})


def _lines_beside(element: Circle | Arc, template: FieldTemplate) -> list[str]:
    """Straight markings that a picture of a circle or an arc may show longest: those nearest to its centre."""
    drawn = template.polylines(1.0)
    off = {line.name: float(np.hypot(*(drawn[line.name] - element.center).T).min()) for line in template.lines}
    nearest = sorted(off, key=lambda name: off[name])[:BESIDE]
    return list(dict.fromkeys([*nearest, *(name for name in ALWAYS_BESIDE if name in off)]))


def _longest_nameless(annotation: Annotation) -> list[int]:
    lines = [k for k, m in enumerate(annotation.markings) if m.kind == "line" and m.name is None and m.used]
    found: list[int] = []
    unit = annotation.width / 1920.0
    for k in sorted(lines, key=lambda k: -length_px(annotation.markings[k])):
        if len(found) < LONGEST and not any(
            continues(annotation.markings[k].points, annotation.markings[other].points, unit) for other in found
        ):
            found.append(k)
    return found


def length_px(marking: AnnotatedMarking) -> float:
    """Distance between the ends of a marking, pixels."""
    return float(np.hypot(*np.ptp(marking.points, axis=0)))


def name_marking(annotation: Annotation, index: int, name: str) -> Annotation:
    """The annotation with a name for one marking."""
    markings = list(annotation.markings)
    markings[index] = markings[index].model_copy(update={"name": name, "used": True})
    return annotation.model_copy(update={"markings": markings})


@dataclass(frozen=True, slots=True)
class _Tried:
    """An interpretation with the annotation and the camera that it leads to."""

    offered: Interpretation
    annotation: Annotation
    found: FrameCalibration

    @property
    def sigma_px(self) -> float:
        """The largest predicted error."""
        camera = self.found.attempt.camera
        return float("inf") if camera is None else camera.max_sigma_px


@dataclass(frozen=True, slots=True)
class _Search:
    """One frame whose lines are named in turn."""

    measured: MeasuredPicture
    config: Config
    template: FieldTemplate
    circle: Circle

    def try_name(
        self,
        annotation: Annotation,
        index: int,
        name: str,
        before: _Tried | None = None,
        given: dict[int, str] | None = None,
    ) -> _Tried | None:
        """One more line under one name, and what then fits; None where the verdict refuses the camera, or a circle is
        mostly not painted.

        ``before`` is the interpretation that the line is added to, ``given`` what else was named in this one.
        """
        names = (given or {}) | ({} if before is None else before.offered.names) | {index: name}
        named = name_marking(annotation, index, name)
        earlier = None if before is None else before.found.attempt.camera
        found = calibrate_annotation(named, self.config, nameless=False, earlier=earlier)
        camera = found.attempt.camera
        if found.status != "calibrated" or camera is None or not self._are_painted(given or {}, camera):
            return None
        told = Answer(named, found, self.template, ())
        for k, fitting in suggest_names(told, see_markings(found.view, self.template)).items():
            names, named = names | {k: fitting}, name_marking(named, k, fitting)
        explained = sum(length_px(annotation.markings[k]) for k in names)
        seen = look_for_others(found, camera, self.measured, self.template, self.circle)
        side = np.asarray(SIDES[self.config.correspondences.camera_side])
        usual = float(camera.camera.position_m[:2] @ side) > 0.0
        return _Tried(
            Interpretation(names, seen.found_share, seen.expected_px, explained, _ground_in(found.view), usual),
            named,
            found,
        )

    def _are_painted(self, names: dict[int, str], camera: CameraFit) -> bool:
        """Whether the whole circles among the names show paint on most of what the camera puts into view of them."""
        whole = (circle for circle in self.template.circles if circle.name in names.values())
        sectors = (measure_circle_sectors(self.measured.light, camera, self.template, circle) for circle in whole)
        return all(np.mean(stands_out > CLEAR) >= LEAST_PAINTED for stands_out in sectors if len(stands_out))

    def extend(self, tried: _Tried) -> _Tried:
        """Name further lines, one after the other, where one name alone is likely and makes the camera much surer."""
        for index in _longest_nameless(tried.annotation):
            if index in tried.offered.names:
                continue
            further = [
                longer
                for name in self._names_near(tried, index)
                if (longer := self.try_name(tried.annotation, index, name, tried))
                and longer.sigma_px < SURER * tried.sigma_px
                and longer.offered.found_share >= tried.offered.found_share
            ]
            if further:
                tried = min(further, key=lambda t: t.offered.rank)
        return tried

    def _names_near(self, tried: _Tried, index: int) -> list[str]:
        """Names of the markings that may lie where a line was measured, the nearest first."""
        view = tried.found.view
        if view is None:
            return []
        points = tried.annotation.markings[index].points
        drawn = see_markings(view, self.template)
        taken = {m.name for m in tried.annotation.markings if m.name is not None and m.used}
        near: list[tuple[float, str]] = []
        for name, seen in drawn.items():
            if name not in self.template.line_by_name or name in taken:
                continue
            off = float(np.quantile(distance_to_polyline(points, seen.pixels), 0.9))
            if off < NEAR_PX * self.measured.unit + NEAR_SIGMAS * place_sigma(view, seen):
                near.append((off, name))
        return [name for _, name in sorted(near)[:NEAREST]]


def _ground_in(view: FieldView | None) -> Array:
    if view is None:
        return np.full((GROUND_GRID[0] * GROUND_GRID[1], 2), np.nan)
    shares = [(np.arange(count) + 0.5) / count for count in GROUND_GRID]
    x, y = np.meshgrid(shares[0] * view.camera.width, shares[1] * view.camera.height)
    return view.to_field(np.stack([x, y], axis=-1).reshape(-1, 2) - 0.5)


def _median_distance(one: Array, other: Array) -> float:
    off = np.linalg.norm(one - other, axis=1)
    known = off[np.isfinite(off)]
    return float(np.median(known)) if len(known) else float("inf")


def look_for_others(
    found: FrameCalibration, camera: CameraFit, measured: MeasuredPicture, template: FieldTemplate, circle: Circle
) -> Agreement:
    """Look for the markings in view to which the camera was not fitted."""
    seen = found.attempt.observations or Observations(found.width, found.height)
    known = frozenset(line.line for line in seen.lines if line.line) | {c.circle for c in seen.circles}
    region = None if measured.found.attempt.mask is None else measured.found.attempt.mask.field_region
    return look_for_markings(measured.light, camera, template, circle, known, region)
