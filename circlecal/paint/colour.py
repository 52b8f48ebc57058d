"""Colours of paint and of its ground: whether a straight run is painted on one surface, or is the border between two
(the foot of a board, a track); and whether in the paint of the circle.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Mask
from circlecal.paint.bands import MeasuredCurve
from circlecal.paint.lines import LEAST_UNIT

__all__ = [
    "colours_at",
    "colours_beside",
    "lie_on_one_surface",
    "match_paint",
    "measure_added_colour",
    "measure_added_colours",
    "measure_paint_colour",
    "segments_match_paint",
    "surface_colour",
]

_ENOUGH = 128  # places along a marking whose median is its colour
_SAMPLES = 48  # along each segment
_NEAR_PX, _FAR_PX = 5.25, 8.25
"""How far from the middle of a marking the surface beside it is looked at, pixels at 1920 px width."""
_SIDES, _STEPS_PX = np.array([[-1.0], [1.0]]), np.linspace(_NEAR_PX, _FAR_PX, 3)
_BEYOND_PX = 9.0
"""How much farther out, pixels at 1920 px width, one side's surface is looked at where another sport's line runs right
beside a marking: in a rendered frame such a line, 3 px wide and 6 px off, took away the near touchline. What lies
behind the foot of a board or the border of a track is wider than that.
"""
_WIDE_PX = 21.0
"""Width, pixels at 1920 px width, up to which a straight run may be paint: its surface is looked at beside thin paint
and beside paint of this width. None of 182 runs on markings in real frames, 24 rendered pitches and 12 rendered halls
is kept by the second look alone.
"""
_ALIKE = 0.06
"""Largest difference between both sides of a straight run in one colour's share of blue, green and red. On markings of
rendered frames 29 runs have 0.010 at most. In real ones 102 have 0.03 in the median, and 28 % of them more than this;
so have 8 % of 192 runs in real frames and 14 % of 70 in rendered ones that are no markings.
"""
_ONE_PAINT = 0.9
"""Least cosine between the colours that two markings in one paint add to their surfaces. Of runs on markings 68 in
rendered frames have 0.97 or more, and 103 of 113 in real ones that add enough more than this; of 140 runs on other
things in rendered frames four have less.
"""
_LEAST_COLOUR = 4.0
"""Grey levels that a marking must add to its surface for their colour to be told: of seven measurements on markings
that add less the cosine with the circle's paint is anything from -0.99 to 1.00.
"""


def lie_on_one_surface(image_bgr: NDArray[np.uint8], segments: Array) -> NDArray[np.bool_]:
    """Whether the colour beside each segment, whatever its brightness, is alike on both sides; a line of another colour
    may run close by on one of them.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8
    segments : (K, 2, 2) array
        Ends, px.

    Returns
    -------
    (K,) bool
    """
    if len(segments) == 0:
        return np.zeros(0, np.bool_)
    near, beyond = (_shares_beside(image_bgr, segments, farther_px) for farther_px in (0.0, _BEYOND_PX))
    pairs = ((near, near), (near, beyond), (beyond, near))
    unlike = [np.abs(first[:, 0] - second[:, 1]).max(axis=-1) for first, second in pairs]
    return np.asarray(np.min(unlike, axis=0) <= _ALIKE, np.bool_)


def _shares_beside(image_bgr: NDArray[np.uint8], segments: Array, farther_px: float) -> Array:
    """Shares (K, 2, 3) of blue, green and red in the surface on both sides of segments (K, 2, 2), so much farther out
    than usual.
    """
    places = _sample_segments(segments)
    beside = colours_beside(image_bgr, *places, np.zeros(1), farther_px).reshape(len(segments), _SAMPLES, 2, -1, 3)
    colour = beside.mean(axis=-2) + 1.0  # of each sample and side
    return median_of_rows((colour / colour.sum(axis=-1, keepdims=True)).swapaxes(0, 1))


def measure_paint_colour(image_bgr: NDArray[np.uint8], curve: MeasuredCurve) -> Array:
    """What the paint of a marking adds to the blue, green and red of its surface: medians (3,) over the places of a
    curve where the marking is seen, zeros where it is seen nowhere.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8
    curve : MeasuredCurve
    """
    on = np.flatnonzero(curve.supported)
    if len(on) == 0:
        return np.zeros(3)
    on = on[:: max(1, len(on) // _ENOUGH)]
    middle, normals = curve.points[on] + curve.offset[on, None] * curve.normals[on], curve.normals[on]
    return median_of_rows(measure_added_colours(image_bgr, middle, normals, curve.width[on]))


def segments_match_paint(image_bgr: NDArray[np.uint8], segments: Array, colour: Array) -> NDArray[np.bool_]:
    """Whether each segment (K, 2, 2) adds the colour (3,) of another marking's paint to the surface, in whatever
    strength; also where one of the two is too faint to tell.
    """
    if len(segments) == 0:
        return np.zeros(0, np.bool_)
    places = _sample_segments(segments)
    narrow, wide = (
        np.median(
            measure_added_colours(image_bgr, *places, np.full(1, width)).reshape(len(segments), _SAMPLES, 3), axis=1
        )
        for width in (0.0, _WIDE_PX * image_bgr.shape[1] / 1920.0)
    )
    return np.asarray(match_paint(narrow, colour) | match_paint(wide, colour), np.bool_)


def match_paint(added: Array, colour: Array) -> NDArray[np.bool_]:
    """Whether what markings add to their surfaces (..., 3) is the colour (3,) of another one's paint, in whatever
    strength; also where one of the two is too faint to tell.
    """
    strength, usual = np.sqrt((added * added).sum(axis=-1)), float(np.sqrt(colour @ colour))
    alike = added @ colour >= _ONE_PAINT * strength * usual
    return np.asarray(alike | (np.minimum(strength, usual) < _LEAST_COLOUR), np.bool_)


def _sample_segments(segments: Array) -> tuple[Array, Array]:
    """Places along segments (K, 2, 2), one segment after the other, and unit normals there, (K * _SAMPLES, 2) each."""
    span = segments[:, 1] - segments[:, 0]
    normal = np.stack([span[:, 1], -span[:, 0]], axis=-1)
    normal /= np.maximum(np.hypot(normal[:, :1], normal[:, 1:]), 1e-9)
    along = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    points = segments[:, None, 0] + along[:, None] * span[:, None]
    return points.reshape(-1, 2), np.repeat(normal, _SAMPLES, axis=0)


def surface_colour(picture: NDArray[np.uint8], surface: NDArray[np.uint8] | Mask) -> NDArray[np.float64] | None:
    """Median colour (3,) of a surface, which is not 0 in a reduced picture (h, w): lightness L (0 to 255), a and b of
    CIE Lab; None where there is no surface.
    """
    height, width = surface.shape
    small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(np.asarray(small, np.uint8), cv2.COLOR_BGR2LAB)[surface > 0]
    if len(lab) == 0:
        return None
    # channel by channel, in bytes: six times as fast as a median of rows of numbers
    return np.array([np.median(channel) for channel in np.ascontiguousarray(lab.T)]) - (0.0, 128.0, 128.0)


def colours_at(image_bgr: NDArray[np.uint8], places: Array) -> NDArray[np.uint8]:
    """Colours (..., 3) of the pixels nearest to places (..., 2)."""
    height, width = image_bgr.shape[:2]
    x, y = (
        np.minimum(np.maximum(np.rint(places[..., axis]), 0.0), size - 1.0) for axis, size in enumerate((width, height))
    )
    return image_bgr.reshape(-1, 3).take((y * width + x).astype(np.int64), axis=0)


def measure_added_colours(image_bgr: NDArray[np.uint8], points: Array, normals: Array, widths: Array) -> Array:
    """Colour (N, 3) of each place less that of its sides, beyond markings of these widths (N,) or (1,)."""
    beside = colours_beside(image_bgr, points, normals, widths)
    return np.asarray(
        colours_at(image_bgr, points) - np.einsum("nsfc->nc", beside) / (beside.shape[1] * beside.shape[2])
    )


def measure_added_colour(image_bgr: NDArray[np.uint8], points: Array, normals: Array, width_px: float) -> Array:
    """What the paint of one marking adds to blue, green and red of its surface: medians (3,) over places (N, 2) on it
    with normals (N, 2), or one (2,), beyond its width.
    """
    across = np.broadcast_to(normals, points.shape)
    return median_of_rows(measure_added_colours(image_bgr, points, across, np.full(1, width_px)))


def colours_beside(
    image_bgr: NDArray[np.uint8], points: Array, normals: Array, widths: Array, farther_px: float = 0.0
) -> Array:
    """Colours (N, 2, S, 3) on both sides of places (N, 2) on markings of these widths (N,) or (1,), so many pixels at
    1920 px width farther out than usual.
    """
    height, width = image_bgr.shape[:2]
    unit = max(LEAST_UNIT, width / 1920.0)
    steps = _SIDES * (farther_px + _STEPS_PX) * unit
    farther = np.maximum(1.0, widths / (_NEAR_PX * unit))[:, None, None]
    x, y = (
        np.minimum(np.maximum(np.rint(place[:, None, None] + farther * steps * normal[:, None, None]), 0.0), size - 1.0)
        for place, normal, size in zip(points.T, normals.T, (width, height), strict=True)
    )
    return np.asarray(image_bgr.reshape(-1, 3).take((y * width + x).astype(np.int64), axis=0), np.float64)
