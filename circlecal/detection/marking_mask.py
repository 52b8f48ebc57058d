"""Marking mask: bands of the markings' own width, drawn where the picture supports them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.circle import MeasuredCircle
from circlecal.detection.halfway import MeasuredLine, measure_segments
from circlecal.detection.options import ProfilesConfig
from circlecal.geometry.projective import Array, lift
from circlecal.paint.bands import MeasuredCurve, local_width

__all__ = ["CIRCLE_CLASS", "HALFWAY_CLASS", "UNKNOWN_CLASS", "MarkingSketch", "band_polygons"]

CIRCLE_CLASS, UNKNOWN_CLASS, HALFWAY_CLASS = 7, 17, 18  # SoccerNet: "Circle central", "Line unknown", "Middle line"
ON_HALFWAY_PX, ON_HALFWAY_DEG = 6.0, 3.0
"""Pixels at 1920 px width and degrees by which a piece of the halfway line may leave its middle part: it bends outside
the circle."""
LEAST_HALF_WIDTH_PX = 1.0
"""Of a band, pixels of the picture."""
_SHIFT = 4  # binary places of the sub-pixel corners


@dataclass(frozen=True, slots=True)
class MarkingSketch:
    """What the marking mask of a frame is drawn from; few frames' masks are ever looked at.

    Attributes
    ----------
    gray : (H, W) uint8
        The frame.
    circle : MeasuredCircle or None
    halfway : MeasuredLine or None
    segments : (K, 2, 2) float64
        Ends of the straight markings, px.
    sign : float
        +1 for light markings, -1 for dark ones.
    config : ProfilesConfig
    """

    gray: NDArray[np.uint8]
    circle: MeasuredCircle | None
    halfway: MeasuredLine | None
    segments: Array
    sign: float
    config: ProfilesConfig

    def draw(self) -> NDArray[np.uint8]:
        """Class ids (H, W): the circle over the halfway line over other straight markings."""
        mask = np.zeros(self.gray.shape, np.uint8)
        part = measure_segments(self.gray, self.segments, self.sign, self.config)
        if part is not None:
            halfway = self._lie_on_halfway()[part.pieces]
            for wanted, class_id in ((~halfway, UNKNOWN_CLASS), (halfway, HALFWAY_CLASS)):
                curve = replace(part.curve, supported=part.curve.supported & wanted)
                _fill(mask, band_polygons(curve, part.pieces, False), class_id)
        if self.halfway is not None:
            curve = self.halfway.curve
            one = np.zeros(len(curve.points), np.int64)
            _fill(mask, band_polygons(curve, one, False), HALFWAY_CLASS)
        if self.circle is not None:
            curve = self.circle.curve
            one = np.zeros(len(curve.points), np.int64)
            _fill(mask, band_polygons(curve, one, True), CIRCLE_CLASS)
        return mask

    def _lie_on_halfway(self) -> NDArray[np.bool_]:
        """Which segments (K,) are part of the halfway line, which may bend a little outside the circle."""
        if self.halfway is None:
            return np.zeros(len(self.segments), np.bool_)
        distance = np.abs(lift(self.segments) @ self.halfway.line)
        first, last = self.halfway.ends
        span = self.segments[:, 1] - self.segments[:, 0]
        cosine = np.abs(span @ (last - first)) / np.maximum(1e-9, np.hypot(*span.T) * np.hypot(*(last - first)))
        near = distance.min(axis=1) < ON_HALFWAY_PX * self.gray.shape[1] / 1920.0
        return np.asarray((cosine > np.cos(np.deg2rad(ON_HALFWAY_DEG))) & near, np.bool_)


def band_polygons(curve: MeasuredCurve, pieces: NDArray[np.int64], closed: bool) -> tuple[Array, ...]:
    """Outlines of a measured marking, one polygon (K, 2) for each run of supported samples.

    Parameters
    ----------
    curve : MeasuredCurve
        N samples.
    pieces : (N,) int64
        Samples of different pieces are not joined.
    closed : bool
        Whether the last sample is the first one's neighbour.
    """
    on = curve.supported
    if np.count_nonzero(on) < 2:
        return ()
    half = np.maximum(local_width(curve) / 2, LEAST_HALF_WIDTH_PX)[:, None]
    middle = curve.points + curve.offset[:, None] * curve.normals
    outer, inner = middle + half * curve.normals, middle - half * curve.normals
    order = np.arange(len(on))
    cut = np.flatnonzero(~on)
    if closed and len(cut):  # begin in a gap, so that no run crosses the seam
        order = np.roll(order, -int(cut[0]))
    breaks = np.flatnonzero((np.diff(on[order].astype(np.int8)) != 0) | (np.diff(pieces[order]) != 0)) + 1
    runs = [run for run in np.split(order, breaks) if len(run) > 1 and on[run[0]]]
    if closed and not len(cut):
        runs = [np.append(order, order[0])]
    return tuple(np.concatenate([outer[run], inner[run[::-1]]]) for run in runs)


def _fill(mask: NDArray[np.uint8], polygons: tuple[Array, ...], class_id: int) -> None:
    fixed = [np.rint(polygon * (1 << _SHIFT)).astype(np.int32) for polygon in polygons]
    if fixed:
        cv2.fillPoly(mask, fixed, class_id, lineType=cv2.LINE_8, shift=_SHIFT)
