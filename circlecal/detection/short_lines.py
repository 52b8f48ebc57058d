"""Straight markings too short to be looked for in every picture: among what is left where the long ones and the circle
are known, limbs of players for the most part, and now and then the corner of a penalty area.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.arcs import lie_near_conics
from circlecal.detection.field_region import resize_hull
from circlecal.detection.lines import find_straight_runs
from circlecal.detection.options import DetectorConfig
from circlecal.detection.picture import reduce_picture
from circlecal.detection.ridges import find_ridges
from circlecal.geometry.projective import Array, Mask

__all__ = ["find_short_runs"]

SHORTEST = 0.03
"""Picture widths: shorter straight runs are not reported. The corners of penalty areas in four rendered frames whose
camera is open or wrong without them are 0.03 to 0.08 long.
"""
KNOWN_PX = 6.0
"""Pixels at 1920 px width from known markings within which ridge points belong to them, or to the rims of their paint.
"""


def find_short_runs(
    gray: NDArray[np.uint8],
    hull: Mask,
    conic: Array,
    known: Array,
    config: DetectorConfig,
) -> Array:
    """Find short straight runs of paint apart from the markings that are known.

    Parameters
    ----------
    gray : (H, W) uint8
        The picture, with the markings lighter than the field.
    hull : (h, w) bool
        The playing surface in a reduced picture.
    conic : (3, 3) array
        The circle.
    known : (K, 2, 2) array
        Ends of the straight markings that were found, pixels.
    config : DetectorConfig

    Returns
    -------
    (R, 2, 2) array
        Ends of the runs in pixels of the picture, the longest first.
    """
    reduced, scaling = reduce_picture(gray, config.detection_width_px, config.enlarged_width_px)
    rows, columns = reduced.shape
    region = resize_hull(hull.astype(np.uint8) * 255, columns, rows)
    ridges = find_ridges(reduced, region, 1.0, config.ridges)
    points = scaling.full(ridges.points)
    near_px = KNOWN_PX * gray.shape[1] / 1920.0
    taken = lie_near_conics(points, [conic], near_px)
    taken |= _lie_near_segments(points, known, near_px)
    runs = find_straight_runs(ridges.take(~taken), (columns, rows), SHORTEST * columns)
    return scaling.full_segments(runs)


def _lie_near_segments(points: Array, segments: Array, distance_px: float) -> Mask:
    """Which points (N, 2) lie this near to one of the segments (K, 2, 2)."""
    start, span = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points[:, None] - start
    share = np.clip((offset * span).sum(axis=-1) / np.maximum((span * span).sum(axis=-1), 1e-9), 0.0, 1.0)
    return np.asarray((np.linalg.norm(offset - share[..., None] * span, axis=-1) < distance_px).any(axis=1), np.bool_)
