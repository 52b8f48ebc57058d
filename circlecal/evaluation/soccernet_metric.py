"""SoccerNet's camera calibration metric (Jaccard index of field elements, JaC), to the letter of the official one.

Every element of the field is drawn as the official evaluation draws it (steps, border crossings, points behind the
camera) and compared with the annotated points of its class. Distances are kept, so one comparison serves all
thresholds. The official field is 105 x 68 m, flat, of infinitely thin lines; class names are written without blanks at
the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from circlecal.formats.soccernet import CIRCLE_CLASSES, LINE_CLASSES, UNKNOWN_CLASSES
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array, Mask

CLASSES = tuple(sorted((*CIRCLE_CLASSES, *LINE_CLASSES, *UNKNOWN_CLASSES)))
LINE_STEP_M, CIRCLE_STEP_M = 0.9, 0.2
NEAREST_DEPTH_M = 1e-3
INVENTED_LINE_POINTS, INVENTED_CIRCLE_POINTS = 2, 9
"""How many wrong points an element counts that is predicted, but not annotated (per-class figures only)."""
_END, _SIDE, _RADIUS, _MARK = 52.5, 34.0, 9.15, 41.5
_AREA_X, _AREA_Y, _GOAL_X, _GOAL_Y, _POST, _BAR = 36.0, 20.16, 47.0, 9.16, 3.66, -2.44
_TURNED = {"left": "right", "right": "left", "top": "bottom", "bottom": "top"}


class Projector(Protocol):
    """Whatever says where a point of the field is seen."""

    @property
    def planar(self) -> bool:
        """Whether it knows the ground only."""

    def project(self, points_m: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) of points (N, 3), and which of them (N,) are seen in front."""


@dataclass(frozen=True, slots=True)
class PlaneHomography:
    """A homography (3, 3) from the field (metres) to pixels: it knows no element above the ground."""

    H_image_field: Array

    @property
    def planar(self) -> bool:
        """True: a homography knows the ground only."""
        return True

    def project(self, points_m: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) of points (N, 3) on the ground, and which of them (N,) lie in front of the camera."""
        lifted = np.column_stack([points_m[:, :2], np.ones(len(points_m))]) @ self.H_image_field.T
        depth = lifted[:, 2] * np.sign(np.linalg.det(self.H_image_field))
        front = depth > 0
        return lifted[:, :2] / np.where(front, lifted[:, 2], 1.0)[:, None], front


@dataclass(frozen=True, slots=True)
class MetricCamera:
    """A camera as the official evaluation reads it, with OpenCV's full model of distortion.

    Attributes
    ----------
    focal_px, principal_point_px : (2,) arrays
        At the size at which it is evaluated.
    rotation : (3, 3) array
        World to camera.
    position_m : (3,) array
        Position; z is negative above the ground.
    radial : (6,) array
        k1, k2, k3 of the numerator, then of the denominator.
    tangential, thin_prism : (2,), (4,) arrays
        As OpenCV's p1, p2 and s1 ... s4.
    """

    focal_px: Array
    principal_point_px: Array
    rotation: Array
    position_m: Array
    radial: Array
    tangential: Array
    thin_prism: Array

    @property
    def planar(self) -> bool:
        """False: a camera knows the goals, too."""
        return False

    @staticmethod
    def from_camera(camera: Camera) -> MetricCamera:
        """One of circlecal's cameras; its coefficients in half-widths go to the focal plane."""
        radial = np.array([*camera.dist[:2], 0.0, 0.0, 0.0, 0.0])
        return MetricCamera(
            camera.focal_px, camera.principal_point_px, camera.R, camera.position_m, radial, np.zeros(2),
            np.zeros(4),
        )  # fmt: skip

    def resize(self, factor: tuple[float, float]) -> MetricCamera:
        """This camera for pictures that are ``factor`` times as wide and as high."""
        by = np.array(factor)
        return MetricCamera(
            self.focal_px * by, self.principal_point_px * by, self.rotation, self.position_m, self.radial,
            self.tangential, self.thin_prism,
        )  # fmt: skip

    def project(self, points_m: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) of points (N, 3), and which of them (N,) lie in front of the camera."""
        local = (points_m - self.position_m) @ self.rotation.T
        front = local[:, 2] > NEAREST_DEPTH_M
        normalised = local[:, :2] / np.where(front, local[:, 2], 1.0)[:, None]
        # the official reader keeps the distorted point in single precision
        distorted = self._distort(normalised).astype(np.float32).astype(np.float64)
        return distorted * self.focal_px + self.principal_point_px, front

    def _distort(self, normalised: Array) -> Array:
        x, y = normalised.T
        r2 = x * x + y * y
        powers = np.stack([r2, r2**2, r2**3])
        radial = (1.0 + self.radial[:3] @ powers) / (1.0 + self.radial[3:] @ powers)
        p1, p2 = self.tangential
        s1, s2, s3, s4 = self.thin_prism
        return np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + s1 * r2 + s2 * r2**2,
                y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y) + s3 * r2 + s4 * r2**2,
            ],
            axis=-1,
        )


@dataclass(frozen=True, slots=True)
class Comparison:
    """Annotation and prediction of one frame under one labelling.

    Attributes
    ----------
    distances_px : mapping of str to (N,) array
        Distance of every annotated point from the predicted element, for classes that are in both.
    missed : mapping of str to int
        Classes that are annotated only, with their number of points.
    invented : tuple of str
        Classes that are predicted only.
    """

    distances_px: Mapping[str, Array]
    missed: Mapping[str, int]
    invented: tuple[str, ...]

    def right(self, threshold_px: float) -> int:
        """Number of elements of which every annotated point is nearer than the threshold."""
        return sum(bool((d < threshold_px).all()) for d in self.distances_px.values())

    def jaccard(self, threshold_px: float) -> float:
        """Right elements over all elements that are annotated or predicted; 0 where there are none."""
        total = len(self.distances_px) + len(self.missed) + len(self.invented)
        return self.right(threshold_px) / total if total else 0.0

    def precision(self, threshold_px: float) -> float | None:
        """Share of the predicted elements that are right."""
        predicted = len(self.distances_px) + len(self.invented)
        return self.right(threshold_px) / predicted if predicted else None

    def recall(self, threshold_px: float) -> float | None:
        """Right elements over right and missed ones; None where both are none."""
        right = self.right(threshold_px)
        return right / (right + len(self.missed)) if right + len(self.missed) else None

    def class_points(self, threshold_px: float) -> dict[str, tuple[int, int, int]]:
        """Right, wrong and missed points by class, as the official per-class figures count them."""
        counted = {
            name: (int((d < threshold_px).sum()), int((d >= threshold_px).sum()), 0)
            for name, d in self.distances_px.items()
        }
        counted |= {name: (0, 0, count) for name, count in self.missed.items()}
        for name in self.invented:
            counted[name] = (0, INVENTED_CIRCLE_POINTS if name in CIRCLE_CLASSES else INVENTED_LINE_POINTS, 0)
        return counted


@dataclass(frozen=True, slots=True)
class FrameComparison:
    """One frame: its annotation as it is and with the labels of the field turned by 180 degrees."""

    direct: Comparison
    turned: Comparison

    def official(self, threshold_px: float) -> Comparison:
        """The labelling that the official evaluation takes: turned, unless the direct one scores strictly more."""
        better = self.direct.jaccard(threshold_px) > self.turned.jaccard(threshold_px)
        return self.direct if better else self.turned


def opposite_class(name: str) -> str:
    """Class of an element after the field is turned by 180 degrees about the centre mark.

    The posts of a goal are named as seen from in front of it, so the left one stays a left one.
    """
    words = name.split(" ")
    if words[0] == "Goal" and len(words) > 2:
        return " ".join([words[0], _TURNED[words[1]], *words[2:]])
    return " ".join(_TURNED.get(word, word) for word in words)


@lru_cache(maxsize=1)
def field_polylines() -> dict[str, Array]:
    """Points (N, 3) of every element of the field, as the official evaluation samples them.

    Straight lines every 0.9 m from one end, and the other end; the centre circle every 0.2 m of arc from the angle 0,
    287 points, not closed; the penalty arcs every 0.2 m, and their last end.
    """
    count = int(2 * np.pi * _RADIUS / CIRCLE_STEP_M)
    drawn = {"Circle central": _circle_points(0.0, CIRCLE_STEP_M / _RADIUS * np.arange(count, dtype=np.float64))}
    half = float(np.arctan2(np.sqrt(_RADIUS**2 - (_MARK - _AREA_X) ** 2), _MARK - _AREA_X))
    steps = CIRCLE_STEP_M / _RADIUS * np.arange(int(2 * half * _RADIUS / CIRCLE_STEP_M) + 1, dtype=np.float64)
    angles = np.concatenate([steps - half, np.full(1, half)])
    drawn["Circle left"] = _circle_points(-_MARK, angles)
    drawn["Circle right"] = _circle_points(_MARK, np.pi + angles)
    return drawn | {name: _line_points(np.array(a), np.array(b)) for name, (a, b) in _straight_elements().items()}


def _circle_points(center_x: float, angles: Array) -> Array:
    return np.stack([center_x + _RADIUS * np.cos(angles), _RADIUS * np.sin(angles), np.zeros(len(angles))], axis=-1)


def _line_points(start: Array, end: Array) -> Array:
    length = float(np.linalg.norm(end - start))
    along = LINE_STEP_M * np.arange(int(length / LINE_STEP_M - 1) + 1)
    return np.concatenate([start + along[:, None] * (end - start) / length, end[None]])


_Ends = tuple[tuple[float, float, float], tuple[float, float, float]]


def _straight_elements() -> dict[str, _Ends]:
    """Both ends of every straight element, in the order in which the official evaluation walks along it."""
    ends: dict[str, _Ends] = {
        "Middle line": ((0, -_SIDE, 0), (0, _SIDE, 0)),
        "Side line top": ((-_END, -_SIDE, 0), (_END, -_SIDE, 0)),
        "Side line bottom": ((-_END, _SIDE, 0), (_END, _SIDE, 0)),
        "Side line left": ((-_END, -_SIDE, 0), (-_END, _SIDE, 0)),
        "Side line right": ((_END, -_SIDE, 0), (_END, _SIDE, 0)),
    }
    for area, inner, y in (("Big rect.", _AREA_X, _AREA_Y), ("Small rect.", _GOAL_X, _GOAL_Y)):
        for side, (first, last) in (("left", (-_END, -inner)), ("right", (inner, _END))):
            ends[f"{area} {side} top"] = (first, -y, 0), (last, -y, 0)
            ends[f"{area} {side} bottom"] = (first, y, 0), (last, y, 0)
            main = -inner if side == "left" else inner
            ends[f"{area} {side} main"] = (main, -y, 0), (main, y, 0)
    for side, x, y in (("left", -_END, _POST), ("right", _END, -_POST)):
        ends[f"Goal {side} post left"] = (x, y, _BAR), (x, y, 0)
        ends[f"Goal {side} post right"] = (x, -y, _BAR), (x, -y, 0)
    ends["Goal left crossbar"] = (-_END, -_POST, _BAR), (-_END, _POST, _BAR)
    ends["Goal right crossbar"] = (_END, -_POST, _BAR), (_END, _POST, _BAR)
    return ends


def image_polylines(camera: Projector, width: int, height: int) -> dict[str, Array]:
    """Pixels (N, 2) of the part of every element that a picture of this size shows; elements out of view are absent.

    Runs of an element that leaves the picture and comes back are joined by a straight piece, as officially.
    """
    elements = {
        name: points for name, points in field_polylines().items() if not (camera.planar and points[:, 2].any())
    }
    pixels, front = camera.project(np.concatenate(list(elements.values())))
    starts = np.cumsum([len(points) for points in elements.values()])[:-1]
    drawn = {
        name: _clip_to_picture(element[seen], width, height)
        for name, element, seen in zip(elements, np.split(pixels, starts), np.split(front, starts), strict=True)
    }
    return {name: points for name, points in drawn.items() if len(points)}


def _clip_to_picture(pixels: Array, width: int, height: int) -> Array:
    """Pixels inside the picture, with the points where the border is crossed between them."""
    inside = _inside(pixels, width, height)
    changes = np.flatnonzero(inside[1:] != inside[:-1]) + 1
    crossings, found = _border_crossings(pixels[changes], pixels[changes - 1], width, height)
    order = np.concatenate([2 * changes[found], 2 * np.flatnonzero(inside) + 1])
    return np.concatenate([crossings[found], pixels[inside]])[np.argsort(order, kind="stable")]


def _inside(pixels: Array, width: int, height: int) -> Mask:
    return np.asarray(((pixels >= 0) & (pixels < (width, height))).all(axis=-1))


def _border_crossings(current: Array, previous: Array, width: int, height: int) -> tuple[Array, Mask]:
    """Where the lines (N,) through two pixels meet the border nearest to the current one, and whether they do."""
    borders = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 1.0 - width], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0 - height]])
    ones = np.ones((len(current), 1))
    lines = np.cross(np.hstack([current, ones]), np.hstack([previous, ones]))
    meets = np.cross(lines[:, None, :], borders[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        points = meets[..., :2] / meets[..., 2:]
    distance = np.where(_inside(points, width, height), np.linalg.norm(points - current[:, None], axis=-1), np.inf)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(current))
    return points[rows, nearest], np.isfinite(distance[rows, nearest])


def polyline_distances(points: Array, polyline: Array) -> Array:
    """Distances (N,) of points (N, 2) from a polyline (M, 2); from a single point where M is 1."""
    start, along = polyline[:-1], np.diff(polyline, axis=0)
    if len(start) == 0:
        return np.asarray(np.linalg.norm(points - polyline[0], axis=1))
    length2 = np.maximum(np.sum(along**2, axis=1), 1e-300)
    offset = points[:, None] - start
    share = np.clip(np.sum(offset * along, axis=2) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - share[..., None] * along, axis=2).min(axis=1))


def compare_frame(annotated: Mapping[str, Array], camera: Projector, width: int, height: int) -> FrameComparison:
    """Compare the annotated points (N, 2) of every class with a camera.

    Parameters
    ----------
    annotated : mapping of str to (N, 2) array
        Pixels by class; classes without points are ignored, those of unknown elements can only be missed.
    camera : Projector
        The prediction at this size.
    width, height : int
        Size of the picture at which is evaluated.
    """
    drawn = image_polylines(camera, width, height)
    present = {name: points for name, points in annotated.items() if len(points)}
    turned = {opposite_class(name): points for name, points in present.items()}
    return FrameComparison(_compare(present, drawn), _compare(turned, drawn))


def _compare(annotated: Mapping[str, Array], drawn: Mapping[str, Array]) -> Comparison:
    both = [name for name in annotated if name in drawn]
    return Comparison(
        {name: polyline_distances(annotated[name], drawn[name]) for name in both},
        {name: len(points) for name, points in annotated.items() if name not in drawn},
        tuple(name for name in drawn if name not in annotated),
    )
