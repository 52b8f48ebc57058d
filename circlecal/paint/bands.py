"""The one instrument that measures paint: where across a curve the middle and the edges of a thin light band are.

A marking a few pixels wide is measured by its flux, not by its edges: near and far on the field it is narrower than
the picture's blur; two edges are then a fiction, while the flux-weighted middle stays unbiased. :func:`measure_bands`
reads middle, edges, contrast and noise off each profile. Two gates say which profiles hold a marking: one that needs
the picture's noise (:func:`rise_above_noise`), and one for curves that may be covered or bare over long stretches
(:func:`look_like_one_marking`), which compares neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.medians import upper_median
from circlecal.geometry.projective import Array, freeze
from circlecal.paint.profiles import GrayPicture, Profiles, sample_profiles, smooth_along

__all__ = [
    "SIGMA_FLOOR_PX",
    "Bands",
    "MeasuredCurve",
    "local_width",
    "look_like_one_marking",
    "measure_bands",
    "measure_curve",
    "rise_above_noise",
    "stand_out",
]

PEAK_SHARE = 0.4
"""The middle is the centroid of what rises above this share of the peak: less lets the surface's texture pull, more
leaves fewer samples (the feasibility study on real frames found 0.1-0.2 px of noise with it).
"""
RIM_SHARE = 4
"""The surface is read off this part (a quarter) of each profile at either end, as the median of every other sample:
neighbours say the same. Means, a fifth, a sixth are as accurate on rendered frames (0.066 to 0.068 px rms), but a mean
takes in the player or the wide paint that reaches into a rim, and a sixth left one real frame of 39 another camera.
"""
SIGMA_FLOOR_PX = 0.08
"""What grass, paint and compression leave of every measurement, however strong the contrast (rendered frames, 1080p).
"""
MINIMUM_SNR = 3.0
"""Fewer standard deviations of the noise are no band: of 1,000 bare profiles one rises so far at any one place."""
LARGEST_STEP = 0.8
"""Difference of the surface on both sides, in contrasts: more is an edge between two surfaces (a step has 1)."""

LEAST_CONTRAST = 0.6
"""Gray levels: a picture of 8 bits shows no less."""
WEAKEST, STRONGEST = 0.35, 2.5
"""Contrast over the usual one of its piece: far paint has 0.4 to 0.8 of near paint's, players and captions are neither.
"""
COHERENCE = 5
"""Neighbours on either side, more than half of which a sample of a marking agrees with."""
APART_PX, APART_SHARE = 0.8, 0.12
"""How far apart agreeing samples lie at most: pixels of the picture, and share of the profiles' half length."""
FAR_AWAY = 1e9
"""Offset of what is no sample of a marking, px: it agrees with none that is."""
FEW = 5
"""Fewer samples do not make a median."""
TAP_PX = 0.75
"""Distance of the samples along a profile of :func:`measure_curve`, pixels of the picture."""
SEARCHED_SHARE = 2 / 3
"""Part of a profile of :func:`measure_curve`, on either side of the curve, in which the marking is looked for."""
LEAST_TAPS = 6
"""On either side of the curve."""
SMOOTHING_SAMPLES = 0.8
"""Standard deviation of its smoothing along the curve, in profiles."""
WIDTH_REACH = 7
"""Neighbours on either side over which the width of a marking is averaged."""

INWARD = np.array([[1], [-1]])
"""From the gap before the peak and from the one behind it towards the peak."""

Rows = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True, slots=True)
class Bands:
    """One measurement per profile, lengths in the unit of its offsets.

    Attributes
    ----------
    center, left, right : (N,) arrays
        Offsets along the normal: middle, and both crossings of half the peak, or the profile's end before it.
    contrast : (N,) array
        Peak over the surface, gray levels.
    step : (N,) array
        Difference of the surface between the two sides, gray levels.
    texture : (N,) array
        Mean departure of the surface from a straight line, gray levels.
    sensitivity : (N,) array
        Standard deviation of the middle for noise of one gray level.
    whole : (N,) bool
        Whether all of the profile lies in the picture, and all of the band in the profile.
    """

    center: Array
    left: Array
    right: Array
    contrast: Array
    step: Array
    texture: Array
    sensitivity: Array
    whole: NDArray[np.bool_]

    @property
    def width(self) -> Array:
        """Full width at half the peak (N,)."""
        return self.right - self.left

    def sigma(self, noise: float) -> Array:
        """Standard deviation (N,) of the middle for a picture's noise in gray levels."""
        return np.hypot(noise * self.sensitivity, SIGMA_FLOOR_PX)

    def take(self, kept: NDArray[np.bool_]) -> Bands:
        """The bands of some profiles (N,)."""
        return Bands(*(getattr(self, name)[kept] for name in Bands.__slots__))

    def stretch(self, times: Array) -> Bands:
        """The bands of profiles whose normals were so many times (N,) as long as a unit of the offsets."""
        lengths = {name: getattr(self, name) * times for name in ("center", "left", "right", "sensitivity")}
        return replace(self, **lengths)


def measure_bands(profiles: Profiles, offsets: Array, search: float) -> Bands:
    """Measure the light band in each profile.

    With the gray levels ``g_i`` at offsets ``x_i``, ``D`` apart:

    - the surface is a straight line ``b_i`` through the medians of both rims, and ``s_i = g_i - b_i``;
    - the contrast is the peak ``p = max s_i`` within the search, and the edges are where ``s = p / 2`` on either side
      of it, linear between samples;
    - the middle is the centroid ``c = sum w_i x_i / sum w_i`` of ``w_i = s_i - PEAK_SHARE p``, over the samples next to
      the peak up to the first that is not positive. Nothing jumps where a sample enters or leaves;
    - as ``dc / dg_i = (x_i - c) / sum w_i`` and noise of one gray level per pixel has a variance of ``1 / D`` in each
      sample, ``var c = D sum (x_i - c)^2 / (D sum w_i)^2``; its root is the sensitivity. The sum of squares over ``n``
      even samples about their middle ``m`` is ``n ((m - c)^2 + D^2 (n^2 - 1) / 12)``.

    Parameters
    ----------
    profiles : (N, S) array
        Gray levels from :func:`circlecal.paint.profiles.sample_profiles`; the band is lighter than both sides.
    offsets : (S,) array
        Evenly spaced positions along the normal.
    search : float
        The peak is looked for within this distance of offset 0, at least at the sample nearest to it.
    """
    step = float(offsets[1] - offsets[0])
    # one row per offset: all that follows runs along the profiles side by side
    values = np.ascontiguousarray(profiles.T, np.float32)
    known = np.isfinite(values).all(axis=0)
    if not known.all():
        values = np.where(known, values, np.float32(0))
    rim = max(2, len(offsets) // RIM_SHARE)
    low, high = _median_of_rows(values[:rim:2]), _median_of_rows(values[: -rim - 1 : -2])
    signal = values - _shares_of_rims(len(offsets), rim) @ np.array([low, high])

    middle = -float(offsets[0]) / step
    reach = max(search / step, 0.5) + 1e-6
    first, last = max(ceil(middle - reach), 0), int(middle + reach) + 1
    peak_row, peak = _find_highest_rows(signal[first:last])
    numbers = _number_rows(len(offsets))
    peak_number = (peak_row + (first + 1)).astype(numbers.dtype)
    around = numbers < peak_number, numbers > peak_number
    half = np.float32(0.5) * peak
    left, right = _find_crossings(signal, half, _find_gaps(signal < half, *around, numbers)) * step + offsets[0]
    threshold = np.float32(PEAK_SHARE) * peak
    before, after = gaps = _find_gaps(signal < threshold, *around, numbers)
    # between its gaps the signal is nowhere below the threshold
    inside = gaps.astype(numbers.dtype) + 1
    weight = (signal - threshold) * ((numbers > inside[0]) & (numbers < inside[1]))
    mass, moment = np.array([np.ones(len(offsets)), offsets], np.float32) @ weight
    mass = np.maximum(mass, np.float32(1e-9))
    center = (moment / mass).astype(np.float64)
    count, middle = after - before - 1.0, offsets[0] + 0.5 * step * (before + after)
    squares = count * ((middle - center) ** 2 + step**2 * (count * count - 1.0) / 12.0)
    return Bands(
        center,
        left,
        right,
        contrast=peak.astype(np.float64),
        step=(high - low).astype(np.float64),
        texture=0.5 * (np.abs(signal[:rim]).mean(axis=0) + np.abs(signal[-rim:]).mean(axis=0)),
        sensitivity=np.sqrt(np.maximum(squares, 0.0) * step) / (mass * step),
        whole=known & (before >= 0) & (after < len(offsets)),
    )


@lru_cache(maxsize=64)
def _shares_of_rims(count: int, rim: int) -> NDArray[np.float32]:
    """How much the medians of the first and the last samples, so many, count at each of the samples (count, 2)."""
    share = (np.arange(count) - 0.5 * (rim - 1)) / (count - rim)
    return freeze(np.stack([1.0 - share, share], axis=-1).astype(np.float32))


def stand_out(profiles: Profiles, offsets: Array, beside: tuple[float, float]) -> Profiles:
    """By how much each place (N, S) is lighter than the lighter one of both its sides, zero where it is not.

    A strip of lighter ground has the paint's brightness, but no darker ground right beside each of its places.

    Parameters
    ----------
    profiles : (N, S) array
        Gray levels; nan stays nan.
    offsets : (S,) array
        Evenly spaced positions along the normal.
    beside : tuple of float
        From where to where the ground beside a place is looked at, in the unit of the offsets. Places whose sides the
        profile does not hold stand out by nothing.
    """
    step = float(offsets[1] - offsets[0])
    first, last = (max(1, round(distance / step)) for distance in beside)
    values = np.ascontiguousarray(profiles.T, np.float32)
    sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1]), np.float32), values]), axis=0)
    means = (sums[last - first + 1 :] - sums[: first - last - 1]) / np.float32(last - first + 1)
    inner = slice(last, len(values) - last)
    sides = np.maximum(means[: len(values) - 2 * last], means[last + first :])
    result = np.where(np.isfinite(values), np.float32(0.0), values)
    result[inner] = np.maximum(values[inner] - sides, np.float32(0.0))
    return result.T


def rise_above_noise(bands: Bands, noise: float) -> NDArray[np.bool_]:
    """Which profiles (N,) hold one whole band that rises clearly out of noise (gray levels) and out of its sides."""
    return bands.whole & (bands.contrast > MINIMUM_SNR * noise) & (np.abs(bands.step) < LARGEST_STEP * bands.contrast)


def look_like_one_marking(
    bands: Bands, offset_px: Array, inside: NDArray[np.bool_], pieces: NDArray[np.int64], reach_px: Array
) -> NDArray[np.bool_]:
    """Which profiles (N,) along a curve hold a marking: those alike to most of their neighbours, in place and contrast.

    Where a curve is bare or covered over long stretches, the surface's texture has the highest peaks there; what is
    usual is therefore asked twice, and never of samples that stand alone.

    Parameters
    ----------
    bands : Bands
        Of profiles in order along the curve, or along several curves one after the other.
    offset_px : (N,) array
        Their middles in pixels.
    inside : (N,) bool
        Which of them count at all.
    pieces : (N,) int64
        Number 0, 1, ... of the piece of the curve within which a profile's contrast must be usual.
    reach_px : (N,) array
        Half length of each profile.
    """
    # the mean size of normal noise is 0.8 standard deviations
    noise = 1.25 * upper_median(bands.texture[inside]) if inside.any() else 0.0
    supported = inside & (bands.contrast > max(LEAST_CONTRAST, MINIMUM_SNR * noise))
    supported &= np.abs(bands.step) <= LARGEST_STEP * bands.contrast + noise
    if len(offset_px) <= 2 * COHERENCE:
        return _have_usual_contrast(supported, bands.contrast, pieces)
    tolerance = np.maximum(APART_PX, APART_SHARE * reach_px)
    neighbours = np.arange(len(offset_px)) + np.arange(-COHERENCE, COHERENCE + 1)[:, None]
    # the noise of bare surface is no paint, and must not be what is usual
    supported = _agree_with_neighbours(supported, offset_px, tolerance, neighbours)
    supported = _have_usual_contrast(supported, bands.contrast, pieces)
    return _agree_with_neighbours(supported, offset_px, tolerance, neighbours)


@dataclass(frozen=True, slots=True)
class MeasuredCurve:
    """A marking along a curve, or along several curves one after the other.

    Attributes
    ----------
    points, normals : (N, 2) array
        Samples of the curve, px, and unit normals.
    offset : (N,) array
        Middle of the marking along the normal, px.
    contrast : (N,) array
        How much lighter (or darker, where dark paint was looked for) than the surface the marking is, gray levels.
    width : (N,) array
        Width at half height, px.
    inside : (N,) bool
        The sample lies in the picture.
    supported : (N,) bool
        The picture shows a marking there.
    """

    points: Array
    normals: Array
    offset: Array
    contrast: Array
    width: Array
    inside: NDArray[np.bool_]
    supported: NDArray[np.bool_]

    @property
    def marking_points(self) -> Array:
        """Measured middle of the marking (K, 2) where it is seen, px."""
        on = self.supported
        return self.points[on] + self.offset[on, None] * self.normals[on]


def measure_curve(
    picture: GrayPicture,
    points: Array,
    normals: Array,
    reach_px: Array,
    pieces: NDArray[np.int64],
    sign: float = 1.0,
    beside_px: tuple[float, float] | None = None,
) -> MeasuredCurve:
    """Measure a marking across a curve, or across several curves one after the other.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
    points, normals : (N, 2) array
        Samples of the curve, in order, and unit normals.
    reach_px : (N,) array
        Half length of each profile; more than the marking's width, so that both ends see the bare surface.
    pieces : (N,) int64
        As :func:`look_like_one_marking` takes them.
    sign : float
        +1 for a light marking, -1 for a dark one.
    beside_px : tuple of float, optional
        From where to where, from its middle, the ground right beside the marking is looked at, in profiles of one
        length: the marking is what stands out above it (:func:`stand_out`). Else the surface is read off the ends of
        the profiles.
    """
    height, width = picture.shape
    x, y = points[:, 0], points[:, 1]
    inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    half = max(LEAST_TAPS, int(np.ceil(upper_median(reach_px) / TAP_PX)))
    tap_px = reach_px / half
    offsets = np.arange(-half, half + 1.0)
    profiles = sample_profiles(picture, points, normals * tap_px[:, None], offsets, repeat_border=True)
    profiles = sign * smooth_along(profiles, SMOOTHING_SAMPLES)
    if beside_px is not None:
        taps = half / upper_median(reach_px)
        profiles = stand_out(profiles, offsets, (beside_px[0] * taps, beside_px[1] * taps))
    bands = measure_bands(profiles, offsets, SEARCHED_SHARE * half)
    offset = bands.center * tap_px
    supported = look_like_one_marking(bands, offset, inside, pieces, reach_px)
    return MeasuredCurve(points, normals, offset, bands.contrast, bands.width * tap_px, inside, supported)


def local_width(curve: MeasuredCurve) -> Array:
    """Width of the marking (N,), px: mean over supported neighbours, the overall one where there are none."""
    on = curve.supported
    if not on.any():
        return np.zeros(len(on))
    width = np.where(on, curve.width, 0.0)
    kernel = np.ones(2 * WIDTH_REACH + 1)
    wrapped = np.arange(-WIDTH_REACH, len(on) + WIDTH_REACH)
    total, count = (np.convolve(row.take(wrapped, mode="wrap"), kernel, mode="valid") for row in (width, on * 1.0))
    return np.where(count > 0, total / np.maximum(count, 1), width.sum() / np.count_nonzero(on))


def _number_rows(count: int) -> Rows:
    """Numbers (count, 1) from 1, in the smallest type that holds one more: what is done with them is faster."""
    numbers = np.arange(1, count + 1)[:, None]
    return numbers.astype(np.int8) if count < 127 else numbers.astype(np.int16)


def _find_highest_rows(values: NDArray[np.float32]) -> tuple[NDArray[np.int_], NDArray[np.float32]]:
    """First row (N,) in which each column of (S, N) is highest, and how high; faster than argmax across rows."""
    highest = values.max(axis=0)
    backwards = np.multiply(_number_rows(len(values))[::-1], values == highest).max(axis=0)
    return len(values) - backwards.astype(np.int_), highest


def _find_gaps(
    low: NDArray[np.bool_], before: NDArray[np.bool_], after: NDArray[np.bool_], numbers: Rows
) -> NDArray[np.int_]:
    """Nearest low row (2, N) before and after each column's peak: -1 and S where there is none.

    ``before`` and ``after`` (S, N) tell on which side of the peak a cell lies, ``numbers`` (S, 1) are the
    :func:`_number_rows`. Products with them are much faster than ``np.where``.
    """
    gaps = np.empty((2, low.shape[1]), np.int_)
    np.subtract(np.multiply(numbers, low & before).max(axis=0), 1, out=gaps[0], casting="unsafe")
    np.subtract(len(numbers), np.multiply(numbers[::-1], low & after).max(axis=0), out=gaps[1], casting="unsafe")
    return gaps


def _find_crossings(signal: NDArray[np.float32], half: NDArray[np.float32], gaps: NDArray[np.int_]) -> Array:
    """Fractional rows (2, N) at which the signal crosses half its peak (N,) next to its gaps (2, N), linear between
    rows; the profile's ends where there is no gap.
    """
    last, columns = signal.shape[0] - 1, np.arange(signal.shape[1])
    outer = np.minimum(np.maximum(gaps, 0), last)
    inner = np.minimum(np.maximum(gaps + INWARD, 0), last)
    low, high = (signal.ravel().take(rows * len(columns) + columns) for rows in (outer, inner))
    share = (half - low) / np.maximum(high - low, np.float32(1e-6))
    return outer + INWARD * np.minimum(np.maximum(share, 0.0), 1.0)


def _median_of_rows(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median over the rows (R, N) of each column; sorting whole rows against each other is faster than np.median."""
    ordered = np.sort(rows, axis=0)
    middle = len(rows) // 2
    return ordered[middle] if len(rows) % 2 else (ordered[middle - 1] + ordered[middle]) / 2


def _have_usual_contrast(supported: NDArray[np.bool_], contrast: Array, pieces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Leave out samples much weaker or stronger than the median contrast of the samples in their piece."""
    on = np.flatnonzero(supported)
    if len(on) < FEW:
        return supported
    seen, owner = contrast[on], pieces[on]
    count = np.bincount(owner, minlength=int(pieces.max()) + 1)
    middle = np.minimum(np.cumsum(count) - count + count // 2, len(on) - 1)
    overall = upper_median(seen)
    # one sort serves all pieces: no contrast is as large as the step between them
    middles = np.sort(seen + 1024.0 * owner)[middle] - 1024.0 * np.arange(len(count))
    usual = np.where(count >= FEW, middles, overall)
    usual = np.minimum(np.maximum(usual, overall / 3), overall * 3)[pieces]
    return supported & (contrast >= WEAKEST * usual) & (contrast <= STRONGEST * usual)


def _agree_with_neighbours(
    supported: NDArray[np.bool_], offset: Array, tolerance: Array, neighbours: NDArray[np.int_]
) -> NDArray[np.bool_]:
    """Leave out samples whose offset is unlike that of most of their neighbours, whose numbers are given (M, N)."""
    filled = np.where(supported, offset, FAR_AWAY)
    alike = np.abs(filled.take(neighbours, mode="wrap") - filled) <= tolerance
    return supported & (alike.view(np.int8).sum(axis=0, dtype=np.int8) >= 1 + COHERENCE)
