"""Masks of markings that somebody else made: the circle and the straight lines in them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.detector import detect
from circlecal.detection.options import DetectorConfig
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, Mask, fit_line, line_distance
from circlecal.geometry.ransac import ransac_conic
from circlecal.results import CIRCLE_ID, HALFWAY_ID, Segment

CURVED_IDS = (CIRCLE_ID, 8, 9)
"""Classes whose markings are no straight lines: the circle and the two penalty arcs."""
MOST_SKELETON_POINTS = 4000
"""Of one class, which bound the time of the robust fits."""
HYPOTHESES, HYPOTHESES_CONFIDENCE = 1000, 0.999
"""Most samples of the robust ellipse, and the probability at which it stops earlier."""
FEWEST_INLIERS, LEAST_INLIER_SHARE = 20, 0.2
"""Skeleton points on the ellipse: fewer, or a smaller share of the class (a binary mask holds all markings), are no
circle.
"""
STRAIGHT_SCALES_PX = 30.0, 10.0, 4.0, 4.0
"""Pixels at 1920 px width at which a point's weight has fallen to a quarter, by round of a line's fit."""
ON_LINE_PX, ON_LINE_SHARE, FEWEST_ON_LINE = 6.0, 0.4, 12
"""Pixels at 1920 px width from a line of its own class; least share of the class on it, and points at least."""
MIDDLE_DRAWS, MIDDLE_BASE_PX, MIDDLE_SHARE = 400, 20.0, 0.35
"""Pairs of the circle's points beside the ellipse that are tried as a line through its middle; their least distance,
pixels at 1920 px width; and the largest distance of the line from the ellipse's centre, in small half axes."""
MIDDLE_VOTE_PX, MIDDLE_LINE_PX = 3.0, 4.0
"""Pixels at 1920 px width from such a line within which points vote for it, and within which they fit it."""
FEWEST_ON_MIDDLE, MIDDLE_SUPPORT = 20, 0.25
"""Points on it at least, and in small half axes (in pixels): the chord is two of them long where it runs along the
view.
"""
DRAWN_PX, DRAWN_NOISE = 4.0, 3.0
"""Width of a mask's markings when they are drawn, pixels at 1920 px width, and the noise of that drawing."""
DRAWN_PAINT_BGR, DRAWN_TURF_BGR = (235.0, 235.0, 235.0), (70.0, 130.0, 75.0)
LEAST_DRAWN_SCORE = 0.6
"""Of an ellipse in a drawing of all markings: the circles of eight samples have 0.94 to 0.99."""
BESIDE_MARKED_PX, ELLIPSE_PLACES = 6.0, 180
"""How far beside a mask's markings a circle of the picture may run, pixels at 1920 px width, and places on it that are
looked at.
"""
MOST_LINES_BESIDE = 2
"""Straight markings in a drawing of a mask beside a circle that is not painted nearly throughout: of more lines, two
make a thin ellipse.
"""


@dataclass(frozen=True, slots=True)
class MaskedMarkings:
    """What a mask holds: the circle's conic (3, 3), the line through its middle, and the other straight lines."""

    conic: Array
    halfway: Segment | None
    lines: tuple[Segment, ...]


def sort_markings(
    classes: NDArray[np.uint8], threshold_px: float, config: DetectorConfig, rng: np.random.Generator
) -> MaskedMarkings | None:
    """Rough ellipse and lines of a mask of class ids (H, W); None where it holds no circle.

    A mask whose circle class holds other markings too (binary masks do) is sorted out here: the circle is what the
    built-in detector finds among the lines, or what a robust ellipse explains, the halfway line is what a robust line
    through the ellipse's middle explains of the rest.

    Parameters
    ----------
    classes : (H, W) uint8
        SoccerNet class ids.
    threshold_px : float
        How far the middle of the circle's class may lie from the circle, pixels.
    config : DetectorConfig
        Options of the built-in detector.
    rng : numpy.random.Generator
        For the robust fits.
    """
    unit = classes.shape[1] / 1920.0
    points = _skeleton_points(classes == CIRCLE_ID)
    conic, straight = None, np.zeros((0, 2, 2))
    if len(points) > 0 and is_binary(classes):
        conic, straight = _find_circle_among_lines(classes > 0, config, rng)
    if conic is None:
        conic = _fit_circle(points, threshold_px, rng)
        beside = conic is not None and np.abs(sampson_distance(conic, straight.mean(axis=1))) > threshold_px
        conic = None if np.count_nonzero(beside) > MOST_LINES_BESIDE else conic
    ellipse = None if conic is None else ellipse_from_conic(conic)
    if conic is None or ellipse is None:
        return None
    halfway = _fit_segment(_skeleton_points(classes == HALFWAY_ID), unit)
    if halfway is None:
        others = points[np.abs(sampson_distance(conic, points)) > threshold_px]
        halfway = _find_line_through_middle(others, ellipse.center, ellipse.semi_axes[1], unit, rng)
    labels = [label for label in np.unique(classes) if label not in (0, HALFWAY_ID, *CURVED_IDS)]
    lines = (_fit_segment(_skeleton_points(classes == label), unit) for label in labels)
    return MaskedMarkings(conic, halfway, tuple(line for line in lines if line is not None))


def _fit_circle(points: Array, threshold_px: float, rng: np.random.Generator) -> Array | None:
    """The ellipse (3, 3) on which most of the circle's points (N, 2) lie, None where these are too few."""
    robust = ransac_conic(
        points, threshold_px, rng, hypotheses=HYPOTHESES, method="taubin", confidence=HYPOTHESES_CONFIDENCE
    )
    ellipse = None if robust is None else ellipse_from_conic(robust.conic)
    # an ellipse as thin as the threshold is a straight line with two sides
    if robust is None or ellipse is None or ellipse.semi_axes[1] < 2 * threshold_px or not _has_enough(robust.inliers):
        return None
    return robust.conic


def _find_circle_among_lines(
    marked: Mask, config: DetectorConfig, rng: np.random.Generator
) -> tuple[Array | None, Array]:
    """The circle (3, 3) in a mask (H, W) of all markings, None where none of its ellipses is believed or painted nearly
    throughout, and the ends (K, 2, 2) of straight markings: the built-in detector tells them apart, when they are drawn
    thin on turf, with some noise to find its thresholds by.
    """
    from skimage.morphology import skeletonize

    unit = marked.shape[1] / 1920.0
    side = 2 * round(DRAWN_PX * unit / 2.0) + 1
    thin = cv2.dilate(skeletonize(marked).astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    sharp = np.where(thin[..., None], DRAWN_PAINT_BGR, DRAWN_TURF_BGR)
    picture = cv2.GaussianBlur(sharp, (0, 0), 1.0) + rng.normal(0.0, DRAWN_NOISE, sharp.shape)
    drawn = config.model_copy(
        update={
            "marking": "light",
            "one_paint": True,
            "field_region": config.field_region.model_copy(update={"light": False}),
        }
    )
    found = detect(np.clip(picture, 0, 255).astype(np.uint8), drawn, rng)
    best = found.circle or (found.candidates[0] if found.candidates else None)
    is_circle = best is not None and (found.circle is not None or best.score >= LEAST_DRAWN_SCORE)
    straight = np.array([(line.start, line.end) for line in found.lines]).reshape(-1, 2, 2)
    return best.conic if best is not None and is_circle else None, straight


def _has_enough(inliers: NDArray[np.bool_]) -> bool:
    """Whether the points (N,) of the circle's class on an ellipse are enough for a circle."""
    return bool(inliers.sum() >= FEWEST_INLIERS and inliers.mean() >= LEAST_INLIER_SHARE)


def _skeleton_points(region: NDArray[np.bool_]) -> Array:
    """Middle of a thick mask: its skeleton's pixels (N, 2), thinned out evenly."""
    if not region.any():
        return np.zeros((0, 2))
    from skimage.morphology import skeletonize

    x, y, w, h = cv2.boundingRect(region.astype(np.uint8))
    rows, columns = np.nonzero(skeletonize(np.pad(region[y : y + h, x : x + w], 1)))
    points = np.stack([columns + x - 1, rows + y - 1], axis=-1).astype(np.float64)
    return points[:: max(1, -(-len(points) // MOST_SKELETON_POINTS))]


def _fit_segment(points: Array, unit: float) -> Segment | None:
    """Robust segment through the middle of a straight marking, or None where the points are few or not straight."""
    if len(points) < FEWEST_ON_LINE:
        return None
    line = fit_line(points)
    for scale in np.array(STRAIGHT_SCALES_PX) * unit:
        line = fit_line(points, 1.0 / (1.0 + (line_distance(line, points) / scale) ** 2) ** 2)
    kept = points[np.abs(line_distance(line, points)) < ON_LINE_PX * unit]
    return _cut_segment(line, kept) if len(kept) > ON_LINE_SHARE * len(points) and len(kept) >= FEWEST_ON_LINE else None


def _find_line_through_middle(
    points: Array, center: Array, small_axis_px: float, unit: float, rng: np.random.Generator
) -> Segment | None:
    """The line that most of the points lie on, among lines that pass near the ellipse's middle."""
    if len(points) < FEWEST_ON_MIDDLE:
        return None
    picks = points[rng.integers(0, len(points), (MIDDLE_DRAWS, 2))]
    direction = picks[:, 1] - picks[:, 0]
    length = np.linalg.norm(direction, axis=1)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1) / np.maximum(length, 1e-9)[:, None]
    offset = -np.sum(normal * picks[:, 0], axis=1)
    near = (length > MIDDLE_BASE_PX * unit) & (np.abs(normal @ center + offset) < MIDDLE_SHARE * small_axis_px)
    if not near.any():
        return None
    support = (np.abs(points @ normal[near].T + offset[near]) < MIDDLE_VOTE_PX * unit).sum(axis=0)
    best = int(np.argmax(support))
    line = np.r_[normal[near][best], offset[near][best]]
    kept = points[np.abs(line_distance(line, points)) < MIDDLE_LINE_PX * unit]
    if len(kept) < max(FEWEST_ON_MIDDLE, MIDDLE_SUPPORT * small_axis_px):
        return None
    return _cut_segment(fit_line(kept), kept)


def _cut_segment(line: Array, points: Array) -> Segment:
    """The part of a line (3,) between the feet of the outermost of the points (N, 2)."""
    foot = points - line_distance(line, points)[:, None] * line[:2]
    position = foot @ np.array([line[1], -line[0]])
    return Segment(foot[np.argmin(position)], foot[np.argmax(position)])


def is_marked(conic: Array, classes: NDArray[np.uint8]) -> bool:
    """Whether most of an ellipse, as far as it is in view, runs along what is marked in a mask (H, W)."""
    ellipse = ellipse_from_conic(conic)
    if ellipse is None:
        return False
    height, width = classes.shape
    side = 2 * round(BESIDE_MARKED_PX * width / 1920.0) + 1
    wide = cv2.dilate((classes > 0).astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    column, row = np.round(ellipse.points(np.linspace(0.0, 2 * np.pi, ELLIPSE_PLACES, endpoint=False))).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    return bool(inside.any() and wide[row[inside], column[inside]].mean() > max(0.5, 2.0 * wide.mean()))


def is_binary(classes: NDArray[np.uint8]) -> bool:
    """Whether a mask says where markings are, and not which ones."""
    return not np.any((classes != 0) & (classes != CIRCLE_ID))
