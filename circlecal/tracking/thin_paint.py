"""Thin paint once more, against the ground right beside it.

Behind a far touchline the dark run-off or the boards begin after 4 to 6 pixels. A profile that reaches there tilts the
surface from which its paint rises, and the middle of a line two pixels wide is off by one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Mask
from circlecal.paint.bands import MeasuredCurve, measure_curve
from circlecal.paint.lines import BESIDE_PX, LEAST_UNIT
from circlecal.paint.profiles import GrayPicture
from circlecal.tracking.ground_step import find_middles

AROUND_PX = 3.0
"""How far from where it was found the paint may lie, pixels at 1920 px width."""


def measure_thin(
    picture: GrayPicture, found: MeasuredCurve, is_thin: Mask, pieces: NDArray[np.int64], unit: float
) -> MeasuredCurve:
    """The paint along curves, with its middle at thin places measured against the ground right beside it, where it
    shows. How broad it looks is left as it was: it tells that something lies beside the paint, and what is left of that
    in a middle is up to 0.1 pixels at 1920 px width.

    Parameters
    ----------
    picture : (H, W) uint8
        Gray levels.
    found : MeasuredCurve
        The paint (N,) as longer profiles have it.
    is_thin : (N,) bool
        Where it is thin.
    pieces : (N,) int64
        As :func:`circlecal.paint.bands.measure_curve` takes them.
    unit : float
        Width of the picture over 1920.
    """
    at = np.flatnonzero(is_thin & found.supported)
    if len(at) == 0:
        return found
    length = max(unit, LEAST_UNIT)
    beside = BESIDE_PX[0] * length, BESIDE_PX[1] * length
    reach = np.full(len(at), beside[1] + AROUND_PX * length)
    middles = found.points[at] + found.offset[at, None] * found.normals[at]
    again = measure_curve(picture, middles, found.normals[at], reach, pieces[at], beside_px=beside)
    seen = again.supported
    told = at[seen]
    offset = found.offset.copy()
    offset[told] += again.offset[seen]
    middles = middles[seen] + again.offset[seen, None] * found.normals[told]
    offset[told] += find_middles(picture, middles, found.normals[told], pieces[told], unit)
    return replace(found, offset=offset)
