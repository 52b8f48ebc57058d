"""What labelled shapes mean on the field: circles, lines, marks and keypoints of the template, each with its sigma.

A label is the template's own name of an element (``halfway_line``), its SoccerNet class (``Middle line``), and with
either of these a point of a circle by its direction on the map (``centre_circle top_left``) or the meet of two lines
(``halfway_line x side_line_top``), or a keypoint of PnLCalib (``kp_32``); capitals, blanks at the ends, ``center`` for
``centre`` and blanks for underscores make no difference. Points along a marking lie on its centreline.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from circlecal.field import COMPASS, MEET, Circle, FieldTemplate, load_field
from circlecal.formats import pnlcalib
from circlecal.formats.cameras import CENTRE, TANGENT, Size
from circlecal.formats.registry import annotation_formats, read_annotations
from circlecal.formats.shapes import ELLIPSE_SAMPLES, AnnotatedFrame, ObservedFrame, Shape
from circlecal.formats.soccernet import GOAL_CLASSES, UNKNOWN_CLASSES
from circlecal.geometry.projective import Array
from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkPoint, Observations, join_observations

REFERENCE_WIDTH_PX = 1920.0
"""Width of the picture for which the standard deviations are given; they grow with the width."""
MARGIN_WIDTHS = 0.005
"""An end of a line nearer to the border than this, in widths of the picture, is where the picture cuts the line."""
END_SIGMA_FACTOR = 2.0
"""The corner of two bands of paint is found less well than a point across one of them."""
_ELLIPSE_FREEDOMS = 5
NO_MARKING = "is no marking of the field"
"""What warnings say of a name that the field does not have."""
REACH = 20
"""How far outside the picture a point may lie, in its longer side: what is drawn on needs less, and damage has more."""
_SHARED = float(np.sqrt(2.0))
"""A point of the circle at a known place says where it is and that it is on the circle: its weight is shared."""
_CENTRE_WORDS = frozenset({"centre", "pitch centre", "field centre", "centre spot", "kick-off spot"})


def _default_sigmas() -> dict[str, float]:
    return {name: found.sigma_px for name, found in sorted(annotation_formats().items())}


class SourcesConfig(BaseModel):
    """Annotation noise: how far points that come from files are trusted."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sigma_px: dict[str, Annotated[float, Field(gt=0, le=100)]] = Field(
        default_factory=_default_sigmas,
        validate_default=True,
        description="Standard deviation of a point by format, pixels at 1920 px width; a detection's is divided by the "
        "root of its confidence. Formats that are not named keep their value.",
    )
    minimum_keypoint_confidence: float = Field(
        0.1, ge=0, le=1, description="Detected keypoints below this confidence are left out."
    )
    minimum_line_confidence: float = Field(
        0.3, ge=0, le=1, description="Detected lines with an end below this confidence are left out."
    )
    halfway_ends: bool = Field(
        False,
        description="Whether a halfway line of a SoccerNet annotation that ends inside the picture ends there on the "
        "touchline.",
    )

    @field_validator("sigma_px")
    @classmethod
    def _complete(cls, given: dict[str, float]) -> dict[str, float]:
        defaults = _default_sigmas()
        unknown = sorted(given.keys() - defaults.keys())
        if unknown:
            raise ValueError(f"{unknown[0]} is no annotation format; known: {', '.join(defaults)}")
        return defaults | given

    def point_sigma_px(self, source: str, width: int) -> float:
        """Standard deviation in pixels of one format's points in a picture of this width."""
        return self.sigma_px[source] * width / REFERENCE_WIDTH_PX


def observe(
    frame: AnnotatedFrame, template: FieldTemplate, sources: SourcesConfig, source: str, file: str
) -> ObservedFrame:
    """Observations of a frame.

    Parameters
    ----------
    frame : AnnotatedFrame
        Labelled shapes.
    template : FieldTemplate
        The field.
    sources : SourcesConfig
        Standard deviations and least confidences.
    source : str
        Name of the format, which chooses the standard deviation.
    file : str
        Named in warnings.

    Returns
    -------
    ObservedFrame
        With a warning for each label that is not of this field and each line of one point.
    """
    reading = _Reading(template, sources, sources.point_sigma_px(source, frame.width), file)
    reach = REACH * max(frame.width, frame.height)
    computed = _has_detected_lines(frame)
    measured = frame.observations
    for shape in frame.shapes if measured is None else [s for s in frame.shapes if s.kind == "points"]:
        near, left_out = _leave_out_far_points(shape, reach)
        if left_out:
            reading.warnings.append(f"{file}: {shape.label}: {left_out}; left out")
        if len(near.points_px) and not _is_computed_from_lines(near, computed):
            reading.take(near)
    observations = reading.observations(frame.width, frame.height)
    if measured is not None:
        reading.check_names(measured)
        observations = join_observations(measured, observations)
    known = annotation_formats().get(source)  # points of a call come in none
    if sources.halfway_ends and known is not None and known.marks_line_ends:
        observations = add_halfway_ends(observations, template)
    warnings = (*frame.warnings, *reading.warnings)
    return ObservedFrame(
        frame.id, frame.width, frame.height, observations, frame.image, warnings, frame.original, frame.on_paint
    )


def understand(frame: AnnotatedFrame, source: str) -> AnnotatedFrame:
    """The frame with the observations of its field, with default standard deviations of a format, for files that hold
    these.

    Raises
    ------
    ConfigError
        There is no field of that name.
    """
    seen = observe(frame, load_field(frame.field), SourcesConfig(), source, frame.id)
    return replace(frame, observations=seen.observations)


def read_observations(
    path: Path, template: FieldTemplate, sources: SourcesConfig, size: Size | None = None, name: str | None = None
) -> list[ObservedFrame]:
    """The frames of an annotation file as observations; see :func:`circlecal.formats.registry.read_annotations`.

    Raises
    ------
    InputError
        One line with the file, the field and the mend.
    """
    found, frames = read_annotations(path, size, name)
    return [observe(frame, template, sources, found.name, str(path)) for frame in frames]


def add_halfway_ends(observations: Observations, template: FieldTemplate) -> Observations:
    """Add the halfway line's ends inside the picture as keypoints, seen from the main camera's side of the field.

    SoccerNet's annotators mark the extremities of a straight line. Those of the halfway line that lie well inside the
    picture are its ends on the touchlines, unless something hides the rest of it; they say how far away the touchline
    is, which a circle alone says badly.
    """
    name = template.halfway_line
    line = None if name is None else observations.line(name)
    if name is None or line is None or len(line.points_px) < 2:
        return observations
    ends_m = template.line_ends(template.line_by_name[name])
    upper, lower = (ends_m[int(k)] for k in (ends_m[:, 1].argmin(), ends_m[:, 1].argmax()))
    order = np.argsort(line.points_px[:, 1], kind="stable")
    margin = MARGIN_WIDTHS * observations.width
    inner = np.array([observations.width, observations.height]) - 1 - margin
    sigma_px = END_SIGMA_FACTOR * line.sigma_px
    shifts = {side: _shift_of_crossing(template, at) for side, at in (("top", upper), ("bottom", lower))}
    found = [
        Keypoint(f"{name} end {side}", field_m, line.points_px[k], float(sigma_px[k]), shifts[side])
        for side, field_m, k in (("top", upper, order[0]), ("bottom", lower, order[-1]))
        if (line.points_px[k] > margin).all() and (line.points_px[k] < inner).all()
    ]
    return replace(observations, keypoints=(*observations.keypoints, *found))


def sure_shapes(frame: AnnotatedFrame, sources: SourcesConfig) -> tuple[Shape, ...]:
    """The shapes of a frame that :func:`observe` uses by their confidence."""
    computed = _has_detected_lines(frame)

    def is_sure(shape: Shape) -> bool:
        is_point = shape.kind == "points"
        least = sources.minimum_keypoint_confidence if is_point else sources.minimum_line_confidence
        return min(shape.confidence or (1.0,)) >= least and not _is_computed_from_lines(shape, computed)

    return tuple(shape for shape in frame.shapes if is_sure(shape))


def _leave_out_far_points(shape: Shape, reach: float) -> tuple[Shape, str]:
    """A shape without its points beyond ``reach`` pixels (of an ellipse with one of them, without any), and what was
    left out in words, which are empty where nothing was.
    """
    is_far = np.asarray((np.abs(shape.points_px) > reach).any(axis=1))
    if not is_far.any():
        return shape, ""
    if shape.kind == "ellipse":
        return replace(shape, points_px=shape.points_px[:0]), f"reaches more than {REACH} pictures away"
    places = np.flatnonzero(is_far).tolist()
    x, y = shape.points_px[places[0]].tolist()
    lie = f"and {len(places) - 1} more lie" if len(places) > 1 else "lies"
    told = f"point {places[0] + 1} of {len(is_far)} at ({x:.10g}, {y:.10g}) {lie} more than {REACH} pictures away"
    confidence = None if shape.confidence is None else tuple(np.array(shape.confidence)[~is_far].tolist())
    return replace(shape, points_px=shape.points_px[~is_far], confidence=confidence), told


def _has_detected_lines(frame: AnnotatedFrame) -> bool:
    return any(shape.kind == "line" and shape.confidence is not None for shape in frame.shapes)


def _is_computed_from_lines(shape: Shape, lines_given: bool) -> bool:
    number = pnlcalib.keypoint_number(shape.label)
    if number is None or not lines_given:
        return False
    return number > pnlcalib.KEYPOINTS or shape.confidence == (1.0,)


def normalise(label: str) -> str:
    """A label as labels are compared: without regard to case, blanks and underscores."""
    return " ".join(label.replace("_", " ").split()).casefold().replace("center", "centre")


def names_a_point(label: str, template: FieldTemplate) -> bool:
    """Whether a label names one point of the field: a mark, a point of a circle, or where two lines meet."""
    name = normalise(label)
    kind, _ = _elements(template).get(name, ("", ""))
    if kind or pnlcalib.keypoint_number(label) is not None:
        return kind in ("", "mark")
    _, direction = _split_circle(name, template)
    return name in _CENTRE_WORDS or MEET in name or direction in (CENTRE, *_DIRECTIONS)


def _split_circle(name: str, template: FieldTemplate) -> tuple[Circle | None, str]:
    """The circle with which a normalised label begins, by either of its names, and what follows; None where there is
    none.
    """
    for circle in template.circles:
        for spelling in (circle.name, circle.class_name):
            if spelling is not None and name.startswith(prefix := normalise(spelling) + " "):
                return circle, name.removeprefix(prefix)
    return None, ""


@dataclass(slots=True)
class _Reading:
    """Shapes of one frame on their way to observations."""

    template: FieldTemplate
    sources: SourcesConfig
    sigma_px: float
    file: str
    warnings: list[str] = field(default_factory=list)
    circles: dict[str, list[tuple[Array, Array]]] = field(default_factory=lambda: defaultdict(list))
    lines: dict[str, list[tuple[Array, Array]]] = field(default_factory=lambda: defaultdict(list))
    marks: list[MarkPoint] = field(default_factory=list)
    keypoints: list[Keypoint] = field(default_factory=list)

    def take(self, shape: Shape) -> None:
        """Take a shape into the observations, or say why not."""
        if shape.sigma_px not in (None, self.sigma_px):
            replace(self, sigma_px=shape.sigma_px).take(shape)
            return
        name = normalise(shape.label)
        elements = _elements(self.template)
        count = len(shape.points_px)
        if count > 1 and shape.kind != "ellipse" and names_a_point(shape.label, self.template):
            self.warnings.append(
                f"{self.file}: {shape.label}: has {count} points, but names one of the field; left out"
            )
        elif pnlcalib.keypoint_number(shape.label) is not None:
            self._take_detection(shape)
        elif name in elements:
            self._take_element(shape, elements[name])
        elif not self._take_place(shape, name) and name not in _SILENT and TANGENT not in name.split():
            self.warnings.append(f"{self.file}: {shape.label}: {NO_MARKING} {self.template.name!r}; left out")

    def check_names(self, measured: Observations) -> None:
        """Warn of names that the field does not have."""
        names = [circle.circle for circle in measured.circles]
        names += [line.line for line in measured.lines if line.line is not None]
        elements = {name for _, name in _elements(self.template).values()}
        for name in dict.fromkeys(names):
            if name not in elements:
                self.warnings.append(f"{self.file}: {name}: {NO_MARKING} {self.template.name!r}; left out")

    def _take_element(self, shape: Shape, element: tuple[str, str]) -> None:
        kind, name = element
        if kind == "mark":
            self.marks.append(MarkPoint(name, shape.points_px[0], self.sigma_px))
        elif kind == "circle":
            points = shape.sample()
            few = np.sqrt(ELLIPSE_SAMPLES / _ELLIPSE_FREEDOMS) if shape.kind == "ellipse" else 1.0
            self.circles[name].append((points, np.full(len(points), self.sigma_px * few)))
        elif shape.kind == "ellipse":
            self.warnings.append(f"{self.file}: {shape.label}: is an ellipse, but the marking is straight; left out")
        elif shape.confidence is None:
            self.lines[name].append((shape.points_px, np.full(len(shape.points_px), self.sigma_px)))
        elif min(shape.confidence) >= self.sources.minimum_line_confidence:
            sigma = self.sigma_px / np.sqrt(np.maximum(shape.confidence, 1e-3))
            self.lines[name].append((shape.points_px, sigma))

    def _take_place(self, shape: Shape, name: str) -> bool:
        """Take a point whose position on the field its label says; whether the label is one."""
        if name in _CENTRE_WORDS:
            name = normalise(f"{self.template.default_circle} {CENTRE}")
        circle, direction = _split_circle(name, self.template)
        if circle is not None:
            return self._take_circle_place(shape, circle, direction)
        first, _, second = name.partition(MEET)
        elements = _elements(self.template)
        crossing = self.template.meet_lines(elements.get(first, ("", ""))[1], elements.get(second, ("", ""))[1])
        if crossing is None:
            return False
        self._keypoint(shape.label, crossing, shape.points_px[0], self.sigma_px)
        return True

    def _take_circle_place(self, shape: Shape, circle: Circle, direction: str) -> bool:
        """Take a point of a circle, or its centre; whether the direction is one of a map."""
        point = shape.points_px[0]
        center = np.asarray(circle.center)
        if direction == CENTRE:
            mark = next((m for m in self.template.marks if np.allclose(m.position, center)), None)
            if mark is not None:
                self.marks.append(MarkPoint(mark.name, point, self.sigma_px))
            else:
                self._keypoint(shape.label, center, point, self.sigma_px)
            return True
        if direction not in _DIRECTIONS:
            return False
        position = center + self.template.radius(circle, "center") * _DIRECTIONS[direction]
        self._circle_keypoint(shape.label, circle.name, position, point, self.sigma_px)
        return True

    def _take_detection(self, shape: Shape) -> None:
        """A keypoint of PnLCalib."""
        number = pnlcalib.keypoint_number(shape.label) or 0
        confidence = 1.0 if shape.confidence is None else shape.confidence[0]
        if number in pnlcalib.GOAL_TOPS or confidence < self.sources.minimum_keypoint_confidence:
            return
        sigma = self.sigma_px / float(np.sqrt(max(confidence, 1e-3)))
        point, central = shape.points_px[0], self.template.default_circle
        position = pnlcalib.field_position(number, self.template)
        tangent_to = central if number in pnlcalib.CIRCLE_TANGENCY else pnlcalib.ARC_TANGENCY.get(number)
        if position is None:
            if tangent_to is not None:
                self.circles[tangent_to].append((point[None], np.array([sigma])))
        elif number == pnlcalib.CENTRE_MARK and "centre_mark" in self.template.mark_by_name:
            self.marks.append(MarkPoint("centre_mark", point, sigma))
        elif number in pnlcalib.CIRCLE_POINTS:
            self._circle_keypoint(shape.label, central, position, point, sigma)
        else:
            self._keypoint(shape.label, position, point, sigma)

    def _circle_keypoint(self, name: str, circle: str, position: Array, point: Array, sigma: float) -> None:
        """A point of a circle, which goes with its centre."""
        shift = self.template.place_shift(self.template.circle_by_name[circle].center)
        self.keypoints.append(Keypoint(name, position, point, sigma * _SHARED, shift))
        self.circles[circle].append((point[None], np.array([sigma * _SHARED])))

    def _keypoint(self, name: str, position: Array, point: Array, sigma: float) -> None:
        """A point where markings meet, which goes with them."""
        self.keypoints.append(Keypoint(name, position, point, sigma, _shift_of_crossing(self.template, position)))

    def observations(self, width: int, height: int) -> Observations:
        """Everything taken; shapes of one marking put together, lines of one point left out with a warning."""
        circles = tuple(CirclePoints(name, "center", *_stack(parts)) for name, parts in self.circles.items())
        lines = []
        for name, parts in self.lines.items():
            points, sigma = _stack(parts)
            if np.ptp(points, axis=0).max() == 0:
                label = self.template.line_by_name[name].class_name or name
                self.warnings.append(f"{self.file}: {label}: is a line of one point; left out")
            else:
                lines.append(LinePoints(name, points, sigma))
        return Observations(width, height, circles, tuple(lines), tuple(self.marks), tuple(self.keypoints))


def _shift_of_crossing(template: FieldTemplate, position: Array) -> Array:
    """How a point where the middles of painted lines meet moves (3, 2), as :meth:`FieldTemplate.place_shift` says it of
    the field's own sizes, which on touchlines count to the outer edge.
    """
    x, y = position.tolist()
    side = template.width_m / 2.0
    is_on_touchline = abs(abs(y) - side) <= template.marking_width_m
    return template.place_shift((x, float(np.copysign(side, y)) if is_on_touchline else y))


_DIRECTIONS = {normalise(label): outward for label, outward in COMPASS.items()}
_SILENT = frozenset(normalise(name) for name in (*GOAL_CLASSES, *UNKNOWN_CLASSES))


def _elements(template: FieldTemplate) -> dict[str, tuple[str, str]]:
    """Kind and name of every element of the template by each of its spellings."""
    kinds = (("circle", template.round_ones), ("line", template.lines), ("mark", template.marks))
    return {
        normalise(label): (kind, element.name)
        for kind, elements in kinds
        for element in elements
        for label in (element.class_name, element.name)
        if label is not None
    }


def _stack(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    return np.concatenate([points for points, _ in parts]), np.concatenate([sigma for _, sigma in parts])
