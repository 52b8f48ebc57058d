"""How the head turns between the frames of a survey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator

from circlecal.geometry.projective import Array
from circlecal.rig.tripod import TripodEstimate
from circlecal.tracking.frame_paint import HeadedFrame
from circlecal.tracking.motion import SHUTTER, move_of_middle

NEAR_S, LONGEST_GAP_S = 0.5, 3.0
"""Frames so near to each other belong to one shot, and how the head turned between them is told; gaps up to the second
are worth to be followed, seconds.
"""
MOST_MORE, MOST_BETWEEN = 72, 4
"""Times between frames that are near each other: at most so many in all, and between two."""


@dataclass(frozen=True, slots=True)
class HeadPath:
    """How the head turns between frames: their times (N,), seconds, in order, and heads (N, 3)."""

    times_s: Array
    heads: Array

    @classmethod
    def of(cls, members: Sequence[HeadedFrame]) -> HeadPath:
        """Through the heads of frames."""
        known = {float(frame.name): frame.head for frame in members}
        times = sorted(known)
        return cls(np.array(times), np.array([known[time] for time in times]).reshape(-1, 3))

    def at(self, time_s: float) -> Array:
        """Where the head (3,) may be at a time."""
        return np.asarray(self._curve(time_s))

    def blur_px(self, time_s: float, tripod: TripodEstimate, period_s: float) -> Array | None:
        """Way (2,) of the picture while the shutter is open; None where no frames near the time, before and after it,
        tell it.
        """
        last = len(self.times_s) - 1
        # of a frame's own time, its neighbours
        before = int(np.searchsorted(self.times_s, time_s)) - 1
        after = int(np.searchsorted(self.times_s, time_s, side="right"))
        if period_s == 0.0 or before < 0 or after > last or np.diff(self.times_s[before : after + 1]).max() >= NEAR_S:
            return None
        turn = SHUTTER * period_s * self._curve.derivative()(time_s)
        return move_of_middle(turn, self.at(time_s), tripod.model, tripod.mean)

    def blur_at_gap(self, time_s: float, tripod: TripodEstimate, period_s: float) -> Array | None:
        """Way (2,) of the picture while the shutter is open in the frame of a time on one side of a gap, as the head
        turned between it and its nearest neighbour; None where that is not near.
        """
        away_s = np.abs(self.times_s - time_s)
        here, neighbour = np.argsort(away_s, kind="stable")[:2]
        if away_s[neighbour] >= NEAR_S:
            return None
        turn = (self.heads[neighbour] - self.heads[here]) / (self.times_s[neighbour] - self.times_s[here])
        return move_of_middle(SHUTTER * period_s * turn, self.heads[here], tripod.model, tripod.mean)

    def times_between(self, period_s: float) -> list[float]:
        """Times between those of frames near each other, evenly, but no more than the video has frames of a period."""
        gaps = [(a, b) for a, b in pairwise(self.times_s) if b - a < NEAR_S]
        if not gaps:
            return []
        pieces = 1 + min(MOST_BETWEEN, max(1, MOST_MORE // len(gaps)))
        most = [min(pieces, round((b - a) / period_s)) if period_s > 0.0 else pieces for a, b in gaps]
        return [float(a + (b - a) * k / n) for (a, b), n in zip(gaps, most, strict=True) for k in range(1, n)]

    def gaps(self) -> list[tuple[float, float]]:
        """Times of the frames on both sides of longer gaps, those with the largest turn between them first."""
        between = [k for k, gap_s in enumerate(np.diff(self.times_s)) if NEAR_S <= gap_s <= LONGEST_GAP_S]
        turn = np.abs(np.diff(self.heads[:, 1]))
        between.sort(key=lambda k: -turn[k])
        return [(float(self.times_s[k]), float(self.times_s[k + 1])) for k in between]

    @property
    def _curve(self) -> PchipInterpolator:
        return PchipInterpolator(self.times_s, self.heads)
