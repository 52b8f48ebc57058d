"""Which points of a straight marking lie on something else: where its paint ends a search goes on over a board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Mask, line_distance
from circlecal.results import LineCue

STRAY_SIGMAS, STRAY_PX = 4.0, 0.75
"""Points further from the course of the marking than so many robust standard deviations and, beside them, pixels at
1920 px width lie on something else. Of 800 rendered halfway lines, through lenses and on pitches of all kinds, 19 bend
further off a parabola at an end.
"""
NEIGHBOURS, LEAST_SHARE = 11, 0.75
"""Of so many points in a row, the middle one among them, this share lies on the course where it is paint: behind the
end of a line one of several that lie on a board is on the course by chance.
"""
RIDGE = 1e-12
"""Share of a point's weight that holds the parabola level, where all points lie at one place and tell no course."""
ROUNDS = 5
"""So often the course is fitted anew with weights from the last one: of 21,000 points of real and rendered lines five
rounds tell 54 otherwise than twelve do.
"""


def keep_on_course(line: LineCue, unit: float) -> LineCue:
    """The marking without points that lie on something else, in a picture of ``unit`` times 1920 px width."""
    kept = lie_on_course(line.points_px, line.line, unit)
    return replace(line, points_px=line.points_px[kept], sigma_px=line.sigma_px[kept])


def lie_on_course(points_px: Array, line: Array, unit: float) -> Mask:
    """Which points (N, 2) lie on the course of a marking, and most of their neighbours too.

    Parameters
    ----------
    points_px : (N, 2) array
        Points along the middle of a marking, in any order.
    line : (3,) array
        The line that it runs along, of unit normal, pixels; it may be bent.
    unit : float
        Width of the picture, in 1920 px.

    Returns
    -------
    (N,) bool
        All of them where there are too few to tell, or hardly any would be left.
    """
    count = len(points_px)
    if count < 2 * NEIGHBOURS:
        return np.ones(count, np.bool_)
    along = points_px @ np.array([line[1], -line[0]])
    order = np.argsort(along)
    beside = np.abs(_distance_from_parabola(along, line_distance(line, points_px)))
    near = (beside < STRAY_SIGMAS * 1.4826 * float(median_of_rows(beside)) + STRAY_PX * unit)[order]
    window = np.ones(NEIGHBOURS)
    share = np.convolve(near, window, "same") / np.convolve(np.ones(count), window, "same")
    kept = np.empty(count, np.bool_)
    kept[order] = near & (share >= LEAST_SHARE)
    return kept if np.count_nonzero(kept) >= NEIGHBOURS else np.ones(count, np.bool_)


def _distance_from_parabola(along: Array, off: Array) -> Array:
    """Distances (N,) from the parabola that most points (N,) of a line follow, px: robust by their own scatter, since
    strays may lie anywhere along it.
    """
    t = (along - along.mean()) / max(float(np.ptp(along)), 1e-9)
    rows, weight = np.array([np.ones_like(t), t, t * t]), np.ones_like(t)
    held = RIDGE * len(t) * np.eye(3)
    beside = off
    for _ in range(ROUNDS):
        weighted = rows * (weight * weight)
        beside = off - np.linalg.solve(weighted @ rows.T + held, weighted @ off) @ rows
        weight = 1.0 / (1.0 + np.square(beside / max(1.4826 * float(median_of_rows(np.abs(beside))), 1e-9)))
    return beside
