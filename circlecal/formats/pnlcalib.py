"""PnLCalib and NBJW keypoints and lines: predictions in; keypoints out with the virtual ones of the circle from us.

``{"kp": {"51": {"x": 0.503, "y": 0.412, "p": 0.71}}, "lines": {"13": {"x_1": ..., "y_1": ..., "p_1": ..., ...}}}`` with
coordinates divided by W and H, read off heat maps (steps of 2 px at 960x540): pixel = ``x W``, ``y H``. Keypoints are
numbered from 1, 57 of the network and 16 intersections of predicted lines; lines from 1 in SoccerNet's order without
circles.

Four traps:

* Keypoint 52 should be the right end of the circle, but stands at x = 9.00 m in the table that the network was trained
  with. It is paired with 9.00 m, read and written, and never taken for a point of the circle.
* The tangency points 38, 39, 42, 43 (and 37, 40, 41, 44 of the arcs) belong to a pitch of 68 m width and the network
  cannot know another. On any pitch they lie on the circle, so that is all that is read from them.
* 12, 15, 16 and 19 are the tops of the goal posts, 2.44 m above the field: left out.
* 58 to 73, and whatever else has a confidence of exactly 1, were computed from the predicted lines and say nothing new:
  left out where the file has lines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.formats.cameras import CalibratedFrame, Size
from circlecal.formats.format import (
    AnnotationFormat,
    Bounded,
    FileModel,
    json_bytes,
    parse_content,
    require_size,
    says_paint,
    tell_convention,
)
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.formats.soccernet import FLAT_PITCH, LINE_CLASSES
from circlecal.geometry.projective import Array

KEYPOINTS, LAST_KEYPOINT = 57, 73
GOAL_TOPS = frozenset({12, 15, 16, 19})
WRONG_RIGHT_END = 9.00 / 9.15
"""Where keypoint 52 is, as a share of the radius."""
CENTRE_MARK = 51
CIRCLE_TANGENCY = frozenset({38, 39, 42, 43})
ARC_TANGENCY = {37: "penalty_arc_left", 41: "penalty_arc_left", 40: "penalty_arc_right", 44: "penalty_arc_right"}
CIRCLE_POINTS = frozenset({32, 35, 48, 49, 50, 53, 54})
"""Keypoints that lie on the centre circle at a known place."""
VIRTUAL_CIRCLE_POINTS = (38, 39, 42, 43, 48, 49, 50, 51, 52, 53, 54)
"""Keypoints at which no two markings meet: the network has to imagine them, and circlecal derives them."""
LABEL = "kp_"


class _Keypoint(FileModel):
    x: Bounded
    y: Bounded
    p: Annotated[float, Field(ge=0, le=1.001)] = 1.0


class _Line(FileModel):
    x_1: Bounded
    y_1: Bounded
    p_1: Annotated[float, Field(ge=0, le=1.001)] = 1.0
    x_2: Bounded
    y_2: Bounded
    p_2: Annotated[float, Field(ge=0, le=1.001)] = 1.0


class _Prediction(FileModel):
    kp: Annotated[dict[str, _Keypoint], Field(max_length=1000)]
    lines: Annotated[dict[str, _Line], Field(max_length=1000)] = Field({})
    circlecal: Any = None


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frame of a prediction; keypoints get the labels ``kp_1`` ... ``kp_73``, lines those of SoccerNet.

    Raises
    ------
    InputError
        No prediction, or the size of the picture is not known.
    """
    found = parse_content(_Prediction, path, content)
    width, height = require_size(path, size)
    scale = np.array([width, height], dtype=np.float64)
    shapes, warnings = [], []
    for key, point in found.kp.items():
        if _number(key, LAST_KEYPOINT) is None:
            warnings.append(f"{path}: kp.{key}: is no keypoint from 1 to {LAST_KEYPOINT}; left out")
            continue
        pixels = np.array([[point.x, point.y]]) * scale
        shapes.append(Shape(f"{LABEL}{int(key)}", "points", pixels, (min(point.p, 1.0),)))
    for key, line in found.lines.items():
        number = _number(key, len(LINE_CLASSES))
        if number is None:
            warnings.append(f"{path}: lines.{key}: is no line from 1 to {len(LINE_CLASSES)}; left out")
            continue
        pixels = np.array([[line.x_1, line.y_1], [line.x_2, line.y_2]]) * scale
        confidence = min(line.p_1, 1.0), min(line.p_2, 1.0)
        shapes.append(Shape(LINE_CLASSES[number - 1], "line", pixels, confidence))
    identifier = path.name.removesuffix(path.suffix).removesuffix(".pnlcalib")
    original = found.model_dump(exclude={"circlecal"})
    on_paint = says_paint(found.circlecal)
    return [
        AnnotatedFrame(identifier, width, height, tuple(shapes), None, tuple(warnings), original, on_paint=on_paint)
    ]


def _number(key: str, last: int) -> int | None:
    return int(key) if key.isascii() and key.isdigit() and len(key) < 4 and 1 <= int(key) <= last else None


def keypoint_number(label: str) -> int | None:
    """Number of a keypoint label such as ``kp_51``; capitals, blanks at the ends and a blank for the underscore make no
    difference.
    """
    name = "_".join(label.replace("_", " ").split()).casefold()
    return _number(name.removeprefix(LABEL), LAST_KEYPOINT) if name.startswith(LABEL) else None


def field_position(number: int, template: FieldTemplate) -> Array | None:
    """Position (2,) of a keypoint on the field; None of those above it and of tangency points.

    Taken from the centrelines of the template's own markings, so that corners of another pitch are where they are.

    Raises
    ------
    InputError
        The template is no soccer pitch.
    """
    if number in GOAL_TOPS or number in CIRCLE_TANGENCY or number in ARC_TANGENCY:
        return None
    return keypoint_table(template).get(number)


def keypoint_table(template: FieldTemplate) -> dict[int, Array]:
    """Position (2,) by number of every keypoint on the ground that does not depend on an assumed width of the pitch."""
    return {number: np.array(position, dtype=np.float64) for number, position in _table(_pitch(template)).items()}


def tangency_points(radius_m: float) -> dict[int, Array]:
    """Where the tangents from the ends of the halfway line touch the centre circle, on a pitch of 68 m width."""
    half = FLAT_PITCH[1] / 2
    y = radius_m**2 / half
    x = radius_m * np.sqrt(1.0 - (radius_m / half) ** 2)
    signs = {38: (-1, -1), 39: (1, -1), 42: (-1, 1), 43: (1, 1)}
    return {number: np.array([sx * x, sy * y]) for number, (sx, sy) in signs.items()}


_GOAL_WIDTH_M = 7.32


@dataclass(frozen=True, slots=True)
class _Pitch:
    """Where the centrelines of a soccer pitch are, metres from the centre mark; the right and bottom ones."""

    end: float
    side: float
    area_x: float
    area_y: float
    goal_x: float
    goal_y: float
    mark: float
    radius: float


def _pitch(template: FieldTemplate) -> _Pitch:
    try:
        lines = {name: template.line_ends(line)[0] for name, line in template.line_by_name.items()}
        return _Pitch(
            end=float(lines["side_line_right"][0]),
            side=float(lines["side_line_bottom"][1]),
            area_x=float(lines["big_rect_right_main"][0]),
            area_y=float(lines["big_rect_right_bottom"][1]),
            goal_x=float(lines["small_rect_right_main"][0]),
            goal_y=float(lines["small_rect_right_bottom"][1]),
            mark=float(template.mark_by_name["penalty_mark_right"].position[0]),
            radius=template.radius(template.circle_by_name["centre_circle"], "center"),
        )
    except KeyError as error:
        raise InputError(
            f"keypoints of PnLCalib need a soccer pitch; the field {template.name!r} has no {error.args[0]}"
        ) from error


def _table(pitch: _Pitch) -> dict[int, tuple[float, float]]:
    end, side, mark, radius = pitch.end, pitch.side, pitch.mark, pitch.radius
    area_x, area_y, goal_x, goal_y = pitch.area_x, pitch.area_y, pitch.goal_x, pitch.goal_y
    post, diagonal = _GOAL_WIDTH_M / 2, radius / np.sqrt(2.0)
    chord = float(np.sqrt(max(radius**2 - (mark - area_x) ** 2, 0.0)))
    by_row: list[tuple[float, float]] = [(-end, -side), (0, -side), (end, -side)]
    by_row += [(x, -area_y) for x in (-end, -area_x, area_x, end)]
    by_row += [(x, -goal_y) for x in (-end, -goal_x, goal_x, end)]
    by_row += [(x, y) for y in (-post, post) for x in (-end, -end, end, end)]
    by_row += [(x, goal_y) for x in (-end, -goal_x, goal_x, end)]
    by_row += [(x, area_y) for x in (-end, -area_x, area_x, end)]
    by_row += [(-end, side), (0, side), (end, side)]
    by_row += [(x, y) for s in (-1, 1) for x, y in ((-area_x, s * chord), (0, s * radius), (area_x, s * chord))]
    table = dict(enumerate(by_row, start=1))
    axis = {45: -mark, 46: -area_x, 47: -mark + radius, 50: -radius, 51: 0.0, 52: radius * WRONG_RIGHT_END}
    axis |= {55: mark - radius, 56: area_x, 57: mark}
    table |= {number: (x, 0.0) for number, x in axis.items()}
    corners = {48: (-1, -1), 49: (1, -1), 53: (-1, 1), 54: (1, 1)}
    table |= {number: (sx * diagonal, sy * diagonal) for number, (sx, sy) in corners.items()}
    columns = (-goal_x, -area_x, area_x, goal_x)
    auxiliary = [(x, -side) for x in columns]
    auxiliary += [(x, y) for y, xs in ((-area_y, goal_x), (-goal_y, area_x), (goal_y, area_x), (area_y, goal_x))
                  for x in (-xs, xs)]  # fmt: skip
    auxiliary += [(x, side) for x in columns]
    table |= dict(enumerate(auxiliary, start=KEYPOINTS + 1))
    return {number: position for number, position in table.items() if number not in GOAL_TOPS}


def derive(frame: CalibratedFrame, original: Mapping[str, Any] | None = None) -> AnnotatedFrame:
    """The virtual keypoints of the circle as the calibration puts them.

    In ``original`` they are replaced, filled in, or removed where they lie outside the picture; all others, and the
    lines, stay. Without an original there are the circle's keypoints alone, 32 and 35 among them.
    """
    radius = frame.template.radius(frame.circle, "center")
    positions = {n: p for n, p in keypoint_table(frame.template).items() if n in {*CIRCLE_POINTS, 51, 52}}
    positions |= tangency_points(radius)
    wanted = sorted(positions) if original is None else VIRTUAL_CIRCLE_POINTS
    placed = {number: frame.view.project([positions[number]]) for number in wanted}
    seen = {number: point for number, point in placed.items() if frame.view.shows(point[0], margin_px=0.5)}
    if original is not None:
        keys = {*original["kp"], *map(str, seen)} - {str(number) for number in placed if number not in seen}
        ordered = sorted(keys, key=lambda key: (len(key), key))
        original = {**original, "kp": {key: original["kp"].get(key) for key in ordered}}
    shapes = tuple(Shape(f"{LABEL}{number}", "points", point) for number, point in seen.items())
    on_paint = frame.is_painted and original is None
    return AnnotatedFrame(
        frame.id, frame.width, frame.height, shapes, frame.image, original=original, on_paint=on_paint
    )


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a file: what was read, and the frame's ``kp_`` points and the ends of its straight lines over it."""
    (frame,) = frames
    width, height = frame.width, frame.height
    original = frame.original or {"kp": {}, "lines": {}}
    keypoints, lines = dict(original["kp"]), dict(original["lines"])
    for shape in frame.shapes:
        number = keypoint_number(shape.label)
        confidence = shape.confidence or (1.0,) * len(shape.points_px)
        if number is not None:
            x, y = shape.points_px[0].tolist()
            keypoints[str(number)] = {"x": x / width, "y": y / height, "p": confidence[0]}
        elif shape.label in LINE_CLASSES and shape.kind == "line" and len(shape.points_px) >= 2:
            (x1, y1), (x2, y2) = _ends(shape.points_px).tolist()
            lines[str(LINE_CLASSES.index(shape.label) + 1)] = {
                "x_1": x1 / width, "y_1": y1 / height, "p_1": confidence[0],
                "x_2": x2 / width, "y_2": y2 / height, "p_2": confidence[-1],
            }  # fmt: skip
    return json_bytes({"kp": keypoints, "lines": lines, **tell_convention(frame)})


def _ends(points: Array) -> Array:
    """The two points (2, 2) of a line that are furthest apart along its longer side."""
    axis = int(np.argmax(np.ptp(points, axis=0)))
    first, last = int(np.argmin(points[:, axis])), int(np.argmax(points[:, axis]))
    return points[sorted((first, last))] if first != last else points[[0, -1]]


FORMAT = AnnotationFormat(
    name="pnlcalib",
    recognises=lambda content: isinstance(content.mapping.get("kp"), dict),
    read=read,
    write=write,
    derive=derive,
    file_name="{id}.json",
    sigma_px=2.5,
    holds_confidence=True,
    requires=keypoint_table,
)
