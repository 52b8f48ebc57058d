"""Lines so thin in the picture that no single place shows their paint, measured along hundreds of pixels at once.

A line of which a pixel holds a tenth still lightens all its pixels by a tenth of the paint's contrast. What the other
markings of the picture show of their paint tells how much that is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array, Mask
from circlecal.paint.bands import MeasuredCurve, stand_out
from circlecal.paint.lines import BESIDE_PX, LEAST_UNIT
from circlecal.paint.profiles import GrayPicture, Profiles, sample_profiles

TAP_PX = 0.75
"""Distance of the samples across a line, pixels."""
LEAST_PLACES = 12
"""Places along a line, 9 px apart at 1920 px width, whose mean shows its paint."""
MOST_LEVELS, MOST_STRENGTH = 8.0, 3.0
"""By how much a place may depart from the middle of its profile and counts, gray levels, and of what the paint should
have: players and boards do by 50 levels.
"""
STRENGTHS, NEXT_SHARE = (0.4, 2.5), 0.5
"""Least and greatest height of a line's ridge, of what its paint should have, and what share of it any other ridge may
have. In 14 rendered clips touchlines have 0.7 to 1.1, other ridges up to 0.3.
"""
LEAST_LEVELS = 0.8
"""Height of a ridge, gray levels, that is none of the picture's encoding."""


@dataclass(frozen=True, slots=True)
class PaintStrength:
    """What the paint of a picture, or of several, adds to the ground.

    Attributes
    ----------
    levels_m : float
        Gray levels times metres across a marking.
    blur_px : float
        Full width at half the peak of a thin line, pixels.
    """

    levels_m: float
    blur_px: float

    @classmethod
    def of(cls, contrast: Array, width_px: Array, scale_px_m: Array, is_clear: Mask) -> PaintStrength | None:
        """By places (N,) with paint: their contrast, full width at half the peak, and scale; the clear ones tell how
        much it is. None where too few are.
        """
        if np.count_nonzero(is_clear) < LEAST_PLACES:
            return None
        levels = contrast[is_clear] * width_px[is_clear] / scale_px_m[is_clear]
        return cls(float(np.median(levels)), float(np.percentile(width_px, 10)))

    def ridges(self, scale_px_m: Array, paint_px: Array, moved_px: float | Array = 0.0) -> tuple[Array, Array]:
        """Height (N,), gray levels, and full width at half of it (N,), pixels, of lines at so many pixels per metre, of
        paint so broad that moved across so far.
        """
        width = np.sqrt(self.blur_px**2 + paint_px**2 + np.square(moved_px))
        return self.levels_m * scale_px_m / width, width


def rise_of(profiles: Profiles, offsets: Array, unit: float) -> Array:
    """How much each place (N, S) of profiles rises above the ground right beside it on either side, gray levels."""
    length = max(unit, LEAST_UNIT)
    return stand_out(profiles, offsets, (BESIDE_PX[0] * length, BESIDE_PX[1] * length)).astype(np.float64)


def measure_faint(
    picture: GrayPicture,
    found: MeasuredCurve,
    faint: Mask,
    pieces: NDArray[np.int64],
    height: Array,
    width_px: Array,
    reach_px: Array,
    unit: float,
) -> MeasuredCurve:
    """The paint along curves, with that of faint places where it shows along their whole pieces.

    Parameters
    ----------
    picture : (H, W) uint8
        Gray levels.
    found : MeasuredCurve
        The paint (N,) of single places.
    faint : (N,) bool
        Places of lines that are too thin for that.
    pieces : (N,) int64
        Growing numbers of the pieces of lines.
    height, width_px : (N,) array
        How high a line's ridge should be there, gray levels, and its full width at half of that, pixels.
    reach_px : (N,) array
        How far beside its place the line may lie.
    unit : float
        Width of the picture over 1920.
    """
    at = np.flatnonzero(faint)
    if len(at) < LEAST_PLACES:
        return found
    beside = BESIDE_PX[1] * max(unit, LEAST_UNIT)
    half = np.ceil((float(reach_px[at].max()) + beside) / TAP_PX)
    offsets = np.arange(-half, half + 1.0) * TAP_PX
    profiles = sample_profiles(picture, found.points[at], found.normals[at], offsets, repeat_border=True)
    limit = np.maximum(MOST_LEVELS, MOST_STRENGTH * height[at])[:, None]
    levels = np.clip(profiles - np.median(profiles, axis=1, keepdims=True), -limit, limit)
    first = np.flatnonzero(np.diff(pieces[at], prepend=-1) != 0)
    count = np.diff(first, append=len(at))
    rise = rise_of((np.add.reduceat(levels, first, axis=0) / count[:, None]).astype(np.float32), offsets, unit)
    expected, near = (np.maximum.reduceat(values[at], first) for values in (height, reach_px))
    rise[np.abs(offsets) > near[:, None]] = 0.0
    top = rise.max(axis=1)
    apart = np.abs(offsets - offsets[np.argmax(rise, axis=1)][:, None]) > beside
    shown = (count >= LEAST_PLACES) & (top > np.maximum(STRENGTHS[0] * expected, LEAST_LEVELS))
    shown &= (top < STRENGTHS[1] * expected) & ((rise * apart).max(axis=1) < NEXT_SHARE * top)
    weight = np.maximum(rise - 0.5 * top[:, None], 0.0) * ~apart
    middle = (weight * offsets).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    on, piece = at[np.repeat(shown, count)], np.repeat(np.flatnonzero(shown), count[shown])
    offset, contrast, width = (values.copy() for values in (found.offset, found.contrast, found.width))
    supported = found.supported.copy()
    offset[on], contrast[on], width[on], supported[on] = middle[piece], top[piece], width_px[on], True
    return replace(found, offset=offset, contrast=contrast, width=width, supported=supported)
