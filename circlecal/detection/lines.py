"""Straight markings: oriented voting in (theta, rho), total least squares, longest gap-free run.

Every ridge point votes only near its own direction (O'Gorman and Clowes 1976, *Finding picture edges through
collinearity of feature points*), so the vote is a single histogram and its peaks are sharp.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.ridges import RidgePoints
from circlecal.geometry.projective import Array, fit_line

__all__ = ["StraightRun", "find_straight_runs"]

MOST_LINES = 16
"""Of one picture; a soccer pitch has 17 straight markings in all."""
ANGLE_BINS, RHO_BIN_PX = 180, 2.0
"""Directions over half a turn in the vote, and pixels of the searched picture between two of its parallels."""
VOTE_SPREAD_DEG = 2.0
"""Degrees: a ridge normal of a thin marking is this uncertain, so that each point votes for the neighbours too."""
TOLERANCE_PX, LOOSE = 1.2, 2.5
"""Distance of a supporting point from its line, pixels of the searched picture, and the first one around a peak of the
vote, in such distances. The flat arcs of a large circle leave a line of 200 px by as little (study of 42 broadcast
frames), so that a larger tolerance would take them."""
ANGLE_TOLERANCE_DEG = 12.0
"""Largest difference of direction between a line and its points, degrees."""
SUPPORT = 0.5
"""Smallest share of a line's length with ridge points."""
GAP = 0.03
"""A gap longer than this ends a segment, in picture widths: what lies beyond may be another marking."""
TRIES = 2
"""Peaks of the vote that are looked at for each wanted line."""
FEWEST_POINTS = 4
"""Of a line; two fix it."""
BINS_PER_PX = 0.5
"""Occupancy of a run is counted in cells of two pixels."""


@dataclass(frozen=True, slots=True)
class StraightRun:
    """One straight, nearly gap-free run of ridge points.

    Attributes
    ----------
    start, end : (2,) float64
        Ends, in pixels of the ridge points' picture.
    members : (M,) int64
        Indices of the ridge points on it.
    support : float
        Share 0..1 of its length with a ridge point.
    """

    start: Array
    end: Array
    members: NDArray[np.int64]
    support: float

    @property
    def length(self) -> float:
        """Distance between the ends."""
        return float(np.hypot(*(self.end - self.start)))


class _Vote:
    """Histogram over direction and distance, from which the points of found lines are taken out again."""

    def __init__(self, points: Array, normals: Array, size: tuple[int, int]) -> None:
        self._origin = (np.array(size) - 1) / 2
        self._rho_count = int(np.ceil(np.hypot(*size) / RHO_BIN_PX)) + 8
        nx, ny = normals.T.astype(np.float32)
        angle = np.arctan2(ny, nx) % np.float32(np.pi)
        spread = max(1, round(VOTE_SPREAD_DEG * ANGLE_BINS / 180.0))
        offsets = np.arange(-spread, spread + 1, dtype=np.int32)
        bins = (angle * np.float32(ANGLE_BINS / np.pi)).astype(np.int32)[:, None] + offsets
        folded = bins % np.int32(ANGLE_BINS)
        table = (np.arange(ANGLE_BINS) + 0.5) * (np.pi / ANGLE_BINS)
        cosine, sine = (np.asarray(f / RHO_BIN_PX, np.float32) for f in (np.cos(table), np.sin(table)))
        local = (points - self._origin).astype(np.float32)
        rho = local[:, :1] * cosine[folded] + local[:, 1:] * sine[folded]
        # ridge points lie at most a few pixels off the picture, so every cell exists
        cell = np.rint(rho).astype(np.int32) + np.int32(self._rho_count // 2)
        self._cells = folded * np.int32(self._rho_count) + cell
        votes = np.bincount(self._cells.ravel(), minlength=ANGLE_BINS * self._rho_count)
        self._votes = votes.astype(np.int32)
        self._voting = np.ones(len(points), np.bool_)

    def peak(self) -> tuple[Array, int, int]:
        """Strongest line (3,) in pixels, its votes and its cell."""
        cell = int(self._votes.argmax())
        theta = (cell // self._rho_count + 0.5) * np.pi / ANGLE_BINS
        rho = (cell % self._rho_count - self._rho_count // 2) * RHO_BIN_PX
        normal = np.array([np.cos(theta), np.sin(theta)])
        return np.append(normal, -rho - normal @ self._origin), int(self._votes[cell]), cell

    def remove(self, members: NDArray[np.int64]) -> None:
        """Take the votes of these points back, once."""
        voting = members[self._voting[members]]
        self._voting[voting] = False
        np.subtract.at(self._votes, self._cells[voting].ravel(), np.int32(1))

    def forget(self, cell: int) -> None:
        """Never return to this cell."""
        self._votes[cell] = 0


def find_straight_runs(ridges: RidgePoints, size: tuple[int, int], minimum_length_px: float) -> list[StraightRun]:
    """Find straight runs among ridge points.

    Parameters
    ----------
    ridges : RidgePoints
    size : (int, int)
        Width and height of the picture of the ridge points.
    minimum_length_px : float
        Shorter runs are not reported.

    Returns
    -------
    list of StraightRun
        Longest first, at most :data:`MOST_LINES`; no point belongs to two of them.
    """
    if len(ridges) < 2:
        return []
    vote = _Vote(ridges.points, ridges.normals, size)
    columns = np.concatenate([ridges.points.T, ridges.normals.T])
    free = np.ones(len(ridges), np.bool_)
    runs: list[StraightRun] = []
    for _ in range(TRIES * MOST_LINES):
        line, votes, cell = vote.peak()
        if votes < SUPPORT * minimum_length_px or len(runs) >= MOST_LINES:
            break
        run = _fit_run(line, columns, free, size[0])
        if run is None:
            vote.forget(cell)
            continue
        if run.length >= minimum_length_px and run.support >= SUPPORT:
            runs.append(run)
            free[run.members] = False
        vote.remove(run.members)
        vote.forget(cell)
    return sorted(runs, key=lambda run: -run.length)


def _fit_run(line: Array, columns: Array, free: NDArray[np.bool_], width: int) -> StraightRun | None:
    """Refit a line to the free points near it, tighter each time, and take its longest run.

    ``columns`` (4, N) holds x, y and the normals' x, y of all points.
    """
    reach = LOOSE * TOLERANCE_PX
    aligned = cos(radians(ANGLE_TOLERANCE_DEG))
    pool = np.flatnonzero((_distance(line, columns) <= 2 * reach) & free)
    near = columns.take(pool, axis=1)
    chosen, run = pool, near
    for tolerance in (reach, TOLERANCE_PX):
        along_normal = np.abs(line[0] * near[2] + line[1] * near[3])
        (chosen,) = ((_distance(line, near) <= tolerance) & (along_normal >= aligned)).nonzero()
        if len(chosen) < FEWEST_POINTS:
            return None
        chosen = chosen[_longest_run(_along(line, near.take(chosen, axis=1)), GAP * width)]
        if len(chosen) < FEWEST_POINTS:
            return None
        run = near[:2].take(chosen, axis=1)
        line = fit_line(run.T)
    t = _along(line, run)
    low, high = float(t.min()), float(t.max())
    cells = np.bincount(((t - low) * BINS_PER_PX).astype(np.int64))
    support = min(1.0, float(np.count_nonzero(cells)) / max(1.0, (high - low) * BINS_PER_PX))
    foot = -line[2] * line[:2]
    direction = np.array([-line[1], line[0]])
    return StraightRun(foot + low * direction, foot + high * direction, pool[chosen], support)


def _distance(line: Array, columns: Array) -> Array:
    """Distance (M,) of points from the line."""
    return np.asarray(np.abs(line[0] * columns[0] + line[1] * columns[1] + line[2]), np.float64)


def _along(line: Array, columns: Array) -> Array:
    """Position (M,) of points along the line's direction (-b, a)."""
    return np.asarray(line[0] * columns[1] - line[1] * columns[0], np.float64)


def _longest_run(t: Array, gap: float) -> NDArray[np.int64]:
    """Indices of the positions in the longest run without a gap larger than ``gap``."""
    order = t.argsort()
    ordered = t.take(order)
    (cuts,) = (ordered[1:] - ordered[:-1] > gap).nonzero()
    if len(cuts) == 0:
        return order
    bounds = np.concatenate([[0], cuts + 1, [len(t)]])
    best = int((ordered[bounds[1:] - 1] - ordered[bounds[:-1]]).argmax())
    return order[bounds[best] : bounds[best + 1]]
