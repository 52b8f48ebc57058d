"""Metrics of the WorldCup 2014 data for homographies: IoU part and whole, projection and reprojection error.

A homography here goes from the picture (1280 x 720) to a template in yards, 115 x 74, whose origin is the top left
corner of the field; they are computed as the published code of the field does, oddities included.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from circlecal.evaluation.soccernet_metric import Projector
from circlecal.formats.worldcup import PICTURE, yards_from_metres
from circlecal.geometry.homography import dlt
from circlecal.geometry.projective import Array

TEMPLATE = (115, 74)
"""Length and width, yards; what follows is as in the published code."""
PROJECTION_SCALE = (100.0 / 115.0, 60.0 / 74.0)
PROJECTION_SAMPLES = 2501
REPROJECTION_FIELD = (114.83, 74.37)
REPROJECTION_GRID = (13, 7)
_MIN_POINTS, _MAX_POINTS = 8, 200
"""Of the field in view, from which the homography nearest to a camera is found, at least and about at most."""


@dataclass(frozen=True, slots=True)
class HomographyScores:
    """One frame.

    Attributes
    ----------
    iou_part : float
        Overlap on the template of the parts that both say are in view.
    iou_whole : float
        Overlap, in the picture, of its rectangle with that taken to the template by the truth and back by the
        prediction; 0 where that is no simple polygon.
    projection : float
        Mean distance on the template, shrunk to 100 x 60, of random pixels; its unit is not a metre.
    reprojection : float
        Mean distance in the picture of a grid of the field, over the picture's height.
    """

    iou_part: float
    iou_whole: float
    projection: float
    reprojection: float


def score_homography(truth: Array, predicted: Array, rng: np.random.Generator) -> HomographyScores:
    """Compare two homographies (3, 3) from picture to template; nan where nothing is visible in both.

    ``rng`` draws the pixels of the projection error.
    """
    return HomographyScores(
        iou_part(truth, predicted),
        iou_whole(truth, predicted),
        projection_error(truth, predicted, rng),
        reprojection_error(truth, predicted),
    )


def template_homography(camera: Projector, H_image_field: Array | None) -> Array | None:
    """Picture to template (3, 3) of a prediction at 1280 x 720; of a camera with a lens the nearest over the field."""
    H = H_image_field
    if H is None:
        H = _nearest_homography(camera)
    if H is None:
        return None
    try:
        return np.asarray(yards_from_metres() @ np.linalg.inv(H))
    except np.linalg.LinAlgError:
        return None


def _nearest_homography(camera: Projector) -> Array | None:
    x, y = np.meshgrid(np.arange(-52.5, 52.6, 1.5), np.arange(-34.0, 34.1, 1.0))
    field = np.stack([x.ravel(), y.ravel()], axis=-1)
    pixels, front = camera.project(np.column_stack([field, np.zeros(len(field))]))
    inside = np.flatnonzero(front & (pixels >= 0).all(axis=1) & (pixels < PICTURE).all(axis=1))
    used = inside[:: max(1, len(inside) // _MAX_POINTS)]
    solution = dlt(field[used], pixels[used]) if len(used) >= _MIN_POINTS else None
    return None if solution is None else solution.H


def iou_part(truth: Array, predicted: Array) -> float:
    """Intersection over union on the template of the picture's area under both."""
    picture = np.ones(PICTURE[::-1], dtype=np.float32)
    areas = [cv2.warpPerspective(picture, H, TEMPLATE) > 0 for H in (truth, predicted)]
    union = np.logical_or(*areas).sum()
    return float(np.logical_and(*areas).sum() / union) if union else 0.0


def iou_whole(truth: Array, predicted: Array) -> float:
    """Intersection over union, in the picture, of its rectangle and the same taken there and back."""
    width, height = PICTURE
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    try:
        moved = _map_points(_inverse(predicted), _map_points(truth, corners))
    except np.linalg.LinAlgError:
        return 0.0
    if not np.isfinite(moved).all() or _crosses_itself(moved):
        return 0.0
    common = abs(_area(_clip(moved, width, height)))
    union = abs(_area(moved)) + width * height - common
    return float(common / union) if union > 0 else 0.0


def projection_error(truth: Array, predicted: Array, rng: np.random.Generator) -> float:
    """Mean distance on the shrunk template of random pixels that show the field, over those inside it under both."""
    pixels = rng.uniform((0.0, 0.0), PICTURE, (4 * PROJECTION_SAMPLES, 2))
    on_field = _map_points(truth, pixels)
    pixels = pixels[((on_field >= 0) & (on_field < TEMPLATE)).all(axis=1)][:PROJECTION_SAMPLES]
    first, second = (_map_points(H, pixels) * PROJECTION_SCALE for H in (truth, predicted))
    both = ((first >= 0) & (first < (100, 60)) & (second >= 0) & (second < (100, 60))).all(axis=1)
    return float(np.linalg.norm(first - second, axis=1)[both].mean()) if both.any() else float("nan")


def reprojection_error(truth: Array, predicted: Array) -> float:
    """Mean distance in the picture of 13 x 7 points of the field that both show, over the picture's height."""
    axes = [np.linspace(0.0, side, count) for side, count in zip(REPROJECTION_FIELD, REPROJECTION_GRID, strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    try:
        first, second = (_map_points(_inverse(H), grid) for H in (truth, predicted))
    except np.linalg.LinAlgError:
        return float("nan")
    both = ((first >= 0) & (first < PICTURE) & (second >= 0) & (second < PICTURE)).all(axis=1)
    return float(np.linalg.norm(first - second, axis=1)[both].mean() / PICTURE[1]) if both.any() else float("nan")


def _map_points(H: Array, points: Array) -> Array:
    lifted = np.column_stack([points, np.ones(len(points))]) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(lifted[:, :2] / lifted[:, 2:])


def _inverse(H: Array) -> Array:
    return np.asarray(np.linalg.inv(H), dtype=np.float64)


def _area(polygon: Array) -> float:
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) if len(polygon) > 2 else 0.0


def _crosses_itself(quadrilateral: Array) -> bool:
    """Whether two opposite sides of four corners (4, 2) meet."""
    return any(_sides_meet(*quadrilateral[[k, k + 1, k + 2, (k + 3) % 4]]) for k in (0, 1))


def _sides_meet(a: Array, b: Array, c: Array, d: Array) -> bool:
    def turn(p: Array, q: Array, r: Array) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0


def _clip(polygon: Array, width: int, height: int) -> Array:
    """The part of a polygon inside the picture: cut by its four sides one after the other."""
    for axis, limit, sign in ((0, 0.0, 1.0), (0, width, -1.0), (1, 0.0, 1.0), (1, height, -1.0)):
        if len(polygon) == 0:
            break
        depth = sign * (polygon[:, axis] - limit)
        kept = []
        for k in range(len(polygon)):
            following = (k + 1) % len(polygon)
            if depth[k] >= 0:
                kept.append(polygon[k])
            if depth[k] * depth[following] < 0:
                share = depth[k] / (depth[k] - depth[following])
                kept.append(polygon[k] + share * (polygon[following] - polygon[k]))
        polygon = np.array(kept).reshape(-1, 2)
    return polygon
