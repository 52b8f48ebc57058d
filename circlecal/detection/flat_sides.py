"""The near and the far side of a flat circle are straight over a long way, and found as lines: an ellipse that runs
beside such a line, on streaks of the surface, is moved onto it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.circle import MeasuredCircle, conic_of, measure_circle, unit_frame
from circlecal.detection.scoring import adjusted
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.projective import Array, lift
from circlecal.paint.bands import RefinementConfig

__all__ = ["onto_flat_sides"]

_SAMPLES = 33
_BESIDE = 0.25  # radii from the circle, where the ellipse is the unit circle: no other marking runs along it so near
_SHORTEST = 0.25  # radians of the circle
_APART_PX1920 = 4.0  # lines nearer to the ellipse were followed by it already
_STEPS = 4


def onto_flat_sides(
    grey: NDArray[np.uint8], circle: MeasuredCircle, segments: Array, config: RefinementConfig
) -> MeasuredCircle:
    """The circle that also follows the straight runs beside it, where more of that one is drawn; else the one given.

    Parameters
    ----------
    grey : (H, W) uint8
        Full picture.
    circle : MeasuredCircle
    segments : (K, 2, 2) array
        Ends of the straight runs, px.
    config : RefinementConfig
    """
    if len(segments) == 0:
        return circle
    share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    points = segments[:, None, 0] + share * (segments[:, None, 1] - segments[:, None, 0])
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))[:2]
    local = lift(points) @ to_unit.T
    radius, angle = np.hypot(local[..., 0], local[..., 1]), np.unwrap(np.arctan2(local[..., 1], local[..., 0]), axis=1)
    turn = np.abs(angle[:, -1] - angle[:, 0])
    beside = (np.abs(radius - 1.0) < _BESIDE).all(axis=1) & (turn > _SHORTEST)
    conic, apart_px = conic_of(circle.ellipse), _APART_PX1920 * grey.shape[1] / 1920.0
    for k in np.flatnonzero(beside):
        beside[k] = np.median(np.abs(sampson_distance(conic, points[k]))) > apart_px
    if not beside.any():
        return circle
    own = lift(circle.marking_points) @ to_unit.T
    own_angle = np.arctan2(own[:, 1], own[:, 0])
    middle, half = angle[beside, _SAMPLES // 2], 0.5 * turn[beside]
    away = np.abs((own_angle[:, None] - middle + np.pi) % (2 * np.pi) - np.pi) > half
    together = np.concatenate([circle.marking_points[away.all(axis=1)], points[beside].reshape(-1, 2)])
    if len(together) < _SAMPLES + 6:
        return circle
    ellipse = circle.ellipse
    for _ in range(_STEPS):
        ellipse = adjusted(ellipse, together[None], np.ones((1, len(together))))
    moved = measure_circle(grey, ellipse, circle.sign, config)
    return max(circle, moved, key=lambda found: int(np.count_nonzero(found.band.supported)))
