"""Straight markings: oriented voting in (theta, rho), total least squares, longest gap-free run.

Every ridge point votes only near its own direction (O'Gorman and Clowes 1976, *Finding picture edges through
collinearity of feature points*), so the vote is a single histogram and its peaks are sharp.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.options import LineConfig
from circlecal.detection.ridges import RidgePoints
from circlecal.geometry.projective import Array, fit_line

__all__ = ["StraightRun", "find_straight_runs"]

_RHO_BIN_PX = 2.0
_VOTE_SPREAD_DEG = 2.0  # a ridge normal of a thin marking is this uncertain
_LOOSE = 2.5  # first tolerance around a peak of the vote, in final tolerances
_TRIES = 2  # peaks looked at for each wanted line
_BINS_PER_PX = 0.5  # occupancy of a run is counted in cells of two pixels


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

    def __init__(self, points: Array, normals: Array, size: tuple[int, int], config: LineConfig) -> None:
        self._bins = config.angle_bins
        self._origin = (np.array(size) - 1) / 2
        self._rho_count = int(np.ceil(np.hypot(*size) / _RHO_BIN_PX)) + 8
        nx, ny = normals.T.astype(np.float32)
        angle = np.arctan2(ny, nx) % np.float32(np.pi)
        spread = max(1, round(_VOTE_SPREAD_DEG * config.angle_bins / 180.0))
        offsets = np.arange(-spread, spread + 1, dtype=np.int32)
        bins = (angle * np.float32(config.angle_bins / np.pi)).astype(np.int32)[:, None] + offsets
        folded = bins % np.int32(config.angle_bins)
        table = (np.arange(config.angle_bins) + 0.5) * (np.pi / config.angle_bins)
        cosine, sine = (np.asarray(f / _RHO_BIN_PX, np.float32) for f in (np.cos(table), np.sin(table)))
        local = (points - self._origin).astype(np.float32)
        rho = local[:, :1] * cosine[folded] + local[:, 1:] * sine[folded]
        # ridge points lie at most a few pixels off the picture, so every cell exists
        cell = np.rint(rho).astype(np.int32) + np.int32(self._rho_count // 2)
        self._cells = folded * np.int32(self._rho_count) + cell
        votes = np.bincount(self._cells.ravel(), minlength=config.angle_bins * self._rho_count)
        self._votes = votes.astype(np.int32)
        self._voting = np.ones(len(points), np.bool_)

    def peak(self) -> tuple[Array, int, int]:
        """Strongest line (3,) in pixels, its votes and its cell."""
        cell = int(self._votes.argmax())
        theta = (cell // self._rho_count + 0.5) * np.pi / self._bins
        rho = (cell % self._rho_count - self._rho_count // 2) * _RHO_BIN_PX
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


def find_straight_runs(
    ridges: RidgePoints, size: tuple[int, int], minimum_length_px: float, config: LineConfig
) -> list[StraightRun]:
    """Find straight runs among ridge points.

    Parameters
    ----------
    ridges : RidgePoints
    size : (int, int)
        Width and height of the picture of the ridge points.
    minimum_length_px : float
        Shorter runs are not reported.
    config : LineConfig

    Returns
    -------
    list of StraightRun
        Longest first, at most ``config.count``; no point belongs to two of them.
    """
    if len(ridges) < 2:
        return []
    vote = _Vote(ridges.points, ridges.normals, size, config)
    columns = np.concatenate([ridges.points.T, ridges.normals.T])
    free = np.ones(len(ridges), np.bool_)
    runs: list[StraightRun] = []
    for _ in range(_TRIES * config.count):
        line, votes, cell = vote.peak()
        if votes < config.support * minimum_length_px or len(runs) >= config.count:
            break
        run = _run_near(line, columns, free, config, size[0])
        if run is None:
            vote.forget(cell)
            continue
        if run.length >= minimum_length_px and run.support >= config.support:
            runs.append(run)
            free[run.members] = False
        vote.remove(run.members)
        vote.forget(cell)
    return sorted(runs, key=lambda run: -run.length)


def _run_near(
    line: Array, columns: Array, free: NDArray[np.bool_], config: LineConfig, width: int
) -> StraightRun | None:
    """Refit a line to the free points near it, tighter each time, and take its longest run.

    ``columns`` (4, N) holds x, y and the normals' x, y of all points.
    """
    reach = _LOOSE * config.tolerance_px
    aligned = cos(radians(config.angle_tolerance_deg))
    pool = np.flatnonzero((_distance(line, columns) <= 2 * reach) & free)
    near = columns.take(pool, axis=1)
    chosen, run = pool, near
    for tolerance in (reach, config.tolerance_px):
        along_normal = np.abs(line[0] * near[2] + line[1] * near[3])
        (chosen,) = ((_distance(line, near) <= tolerance) & (along_normal >= aligned)).nonzero()
        if len(chosen) < 4:
            return None
        chosen = chosen[_longest_run(_along(line, near.take(chosen, axis=1)), config.gap * width)]
        if len(chosen) < 4:
            return None
        run = near[:2].take(chosen, axis=1)
        line = fit_line(run.T)
    t = _along(line, run)
    low, high = float(t.min()), float(t.max())
    cells = np.bincount(((t - low) * _BINS_PER_PX).astype(np.int64))
    support = min(1.0, float(np.count_nonzero(cells)) / max(1.0, (high - low) * _BINS_PER_PX))
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
