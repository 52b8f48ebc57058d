"""Marking mask: bands of the markings' own width, drawn where the picture supports them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.refine import BandProfile, local_width
from circlecal.geometry.homogeneous import Array

__all__ = ["CIRCLE_CLASS", "HALFWAY_CLASS", "UNKNOWN_CLASS", "draw_band"]

CIRCLE_CLASS, UNKNOWN_CLASS, HALFWAY_CLASS = 7, 17, 18  # SoccerNet: "Circle central", "Line unknown", "Middle line"
_SHIFT = 4  # binary places of the sub-pixel corners


def draw_band(
    mask: NDArray[np.uint8],
    points: Array,
    normals: Array,
    band: BandProfile,
    pieces: NDArray[np.int64],
    closed: bool,
    class_id: int,
) -> None:
    """Draw a measured marking into a mask, one polygon for each run of supported samples.

    Parameters
    ----------
    mask : (H, W) uint8
        Changed in place.
    points, normals : (N, 2) array
        Samples of the curve and unit normals, px.
    band : BandProfile
    pieces : (N,) int64
        Samples of different pieces are not joined.
    closed : bool
        Whether the last sample is the first one's neighbour.
    class_id : int
    """
    on = band.supported
    if np.count_nonzero(on) < 2:
        return
    half = np.maximum(local_width(band) / 2, 1.0)[:, None]
    middle = points + band.offset[:, None] * normals
    outer, inner = middle + half * normals, middle - half * normals
    order = np.arange(len(points))
    cut = np.flatnonzero(~on)
    if closed and len(cut):  # begin in a gap, so that no run crosses the seam
        order = np.roll(order, -int(cut[0]))
    breaks = np.flatnonzero((np.diff(on[order].astype(np.int8)) != 0) | (np.diff(pieces[order]) != 0)) + 1
    runs = [run for run in np.split(order, breaks) if len(run) > 1 and on[run[0]]]
    if closed and not len(cut):
        runs = [np.append(order, order[0])]
    polygons = [np.concatenate([outer[run], inner[run[::-1]]]) for run in runs]
    fixed = [np.rint(polygon * (1 << _SHIFT)).astype(np.int32) for polygon in polygons]
    cv2.fillPoly(mask, fixed, class_id, lineType=cv2.LINE_8, shift=_SHIFT)
