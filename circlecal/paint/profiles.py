"""Brightness profiles across a thin light (or dark) band, and where its middle and its edges are.

A marking a few pixels wide is measured by its flux, not by its edges: near and far on the field it is narrower than
the picture's blur, and two
edges are then a fiction, while the flux-weighted middle stays unbiased.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array

Rows = NDArray[np.signedinteger[Any]]
"""Numbers of rows."""
Brightness = NDArray[np.uint8 | np.float32]
"""Grey picture (H, W): as it is decoded, or with fractions."""

PEAK_SHARE = 0.4
"""The middle is the centroid of what rises above this share of the peak."""
SIGMA_FLOOR_PX = 0.08
"""What grass, paint and compression leave of every measurement, however strong the contrast (rendered frames, 1080p).
"""


@dataclass(frozen=True, slots=True)
class Bands:
    """One measurement per profile.

    Attributes
    ----------
    center, left, right : (N,) arrays
        Offsets in pixels along the normal: middle, and both crossings of half the peak.
    sigma : (N,) array
        Standard deviation of the middle, pixels.
    contrast : (N,) array
        Peak over the background, grey levels.
    step : (N,) array
        Difference of the background between the two sides, grey levels.
    valid : (N,) bool
        Whether the profile holds one band that rises clearly out of its surroundings.
    """

    center: Array
    left: Array
    right: Array
    sigma: Array
    contrast: Array
    step: Array
    valid: NDArray[np.bool_]

    @property
    def width(self) -> Array:
        """Full width at half the peak (N,), pixels."""
        return self.right - self.left


def to_gray(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Gray picture (H, W) of a BGR one (H, W, 3), as ITU-R BT.601 weighs the three colours."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def sample_profiles(picture: Brightness, points_px: Array, normals: Array, offsets: Array) -> NDArray[np.float32]:
    """Brightness (N, S) at ``points + offset * normal``, bilinear; nan outside the picture.

    Stored with the profiles side by side (``.T`` is contiguous), as :func:`measure_bands` reads them.
    """
    height, width = picture.shape
    if len(points_px) == 0:
        return np.zeros((0, len(offsets)), np.float32)
    x, y = along_normals(points_px.T, normals.T, offsets)
    sampled = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(sampled, np.float32)
    ends = ((x[0], width), (x[-1], width), (y[0], height), (y[-1], height))
    if any(end.min() < 0 or end.max() > size - 1 for end, size in ends):
        values[(x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)] = np.nan
    return values.T


def along_normals(points: Array, normals: Array, offsets: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """x and y (S, N each) of ``points + offset * normal``, points and normals (2, N), offsets (S,)."""
    lever = np.stack([offsets, np.ones(len(offsets))], axis=-1).astype(np.float32)
    x, y = (lever @ np.stack([normal, point]).astype(np.float32) for normal, point in zip(normals, points, strict=True))
    return x, y


def smooth_along(profiles: NDArray[np.float32], sigma_samples: float) -> NDArray[np.float32]:
    """Gaussian mean of neighbouring profiles (N, S); rows with nan stay nan and lend nothing to their neighbours."""
    if sigma_samples <= 0 or len(profiles) < 3:
        return profiles
    values = np.ascontiguousarray(profiles.T, np.float32)
    kernel = cv2.getGaussianKernel(2 * int(np.ceil(2.5 * sigma_samples)) + 1, sigma_samples, cv2.CV_32F)
    known = np.isfinite(values)
    if known.all():
        return _along_rows(values, kernel).T
    total = _along_rows(np.where(known, values, np.float32(0)), kernel)
    weight = _along_rows(known.astype(np.float32), kernel)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(known, total / weight, np.float32(np.nan)).T


def _along_rows(values: NDArray[np.float32], kernel: cv2.typing.MatLike) -> NDArray[np.float32]:
    one = np.ones((1, 1), np.float32)
    return np.asarray(cv2.sepFilter2D(values, -1, kernel, one, borderType=cv2.BORDER_REFLECT), np.float32)


def measure_bands(
    profiles: NDArray[np.floating[Any]], offsets: Array, search_px: float, noise: float, minimum_snr: float = 3.0
) -> Bands:
    """Find the band in each profile.

    Parameters
    ----------
    profiles : (N, S) array
        Brightness, from :func:`sample_profiles`; the band is lighter than both sides.
    offsets : (S,) array
        Evenly spaced positions along the normal, pixels.
    search_px : float
        The peak is looked for within this distance of offset 0, at the least at the offset nearest to it.
    noise : float
        Grey-level noise of one sample.
    minimum_snr : float
        Peaks below this many noise levels are invalid.
    """
    step_px = float(offsets[1] - offsets[0])
    # one row per offset: all that follows runs along the profiles side by side
    values = np.ascontiguousarray(profiles.T, np.float32)
    known = np.isfinite(values).all(axis=0)
    if not known.all():
        values = np.where(known, values, np.float32(0))
    index = row_numbers(len(offsets))
    away = np.abs(offsets)
    searched = np.flatnonzero(away <= max(search_px, float(away.min())))
    peak_index = highest_rows(values[searched[0] : searched[-1] + 1])[0] + searched[0]
    signal, low, high = _without_background(values, offsets)
    peak = _in_row(signal, peak_index)

    before, after = nearest_gaps(signal < np.float32(0.5) * peak, peak_index, index)
    left = _crossing(signal, peak, before, 1) * step_px + offsets[0]
    right = _crossing(signal, peak, after, -1) * step_px + offsets[0]
    threshold = np.float32(PEAK_SHARE) * peak
    before, after = nearest_gaps(signal < threshold, peak_index, index)
    # between its gaps the signal is nowhere below the threshold
    weight = (signal - threshold) * ((index - 1 > before) & (index - 1 < after))
    mass = np.maximum(weight.sum(axis=0), np.float32(1e-9))
    center = (offsets.astype(np.float32) @ weight / mass).astype(np.float64)
    # noise of a centroid: samples are step_px apart but the picture's noise is per pixel
    count, middle = (
        after.astype(np.float64) - before - 1.0,
        offsets[0] + 0.5 * step_px * (after.astype(np.float64) + before),
    )
    squared_lever = count * ((middle - center) ** 2 + step_px**2 * (count * count - 1.0) / 12.0)
    sigma = np.hypot(noise * np.sqrt(np.maximum(squared_lever, 0.0) * step_px) / (mass * step_px), SIGMA_FLOOR_PX)

    touches_end = (before < 0) | (after >= len(offsets)) | ~np.isfinite(left) | ~np.isfinite(right)
    valid = known & ~touches_end & (peak > minimum_snr * noise) & (np.abs(high - low) < 0.8 * peak)
    return Bands(center, left, right, sigma, peak.astype(np.float64), (high - low).astype(np.float64), valid)


def row_numbers(count: int) -> Rows:
    """Numbers (count, 1) from 1, in the smallest type that holds one more: what is done with them is faster."""
    numbers = np.arange(1, count + 1)[:, None]
    return numbers.astype(np.int8) if count < 127 else numbers.astype(np.int16)


def highest_rows(values: NDArray[np.float32]) -> tuple[NDArray[np.int_], NDArray[np.float32]]:
    """First row (N,) in which each column of (S, N) is highest, and how high; faster than argmax across rows."""
    highest = values.max(axis=0)
    backwards = np.multiply(row_numbers(len(values))[::-1], values == highest).max(axis=0)
    return len(values) - backwards.astype(np.int_), highest


def _in_row(values: NDArray[np.float32], rows: NDArray[np.int_]) -> NDArray[np.float32]:
    """Value (N,) of each column in its row."""
    count = values.shape[1]
    return np.asarray(values.ravel().take(rows * count + np.arange(count)), np.float32)


def _without_background(
    values: NDArray[np.float32], offsets: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Signal (S, N) over a straight line through the medians of both outer quarters; also the two medians (N,)."""
    quarter = max(3, len(offsets) // 4)
    low, high = _median(values[:quarter]), _median(values[-quarter:])
    x0, x1 = offsets[:quarter].mean(), offsets[-quarter:].mean()
    share = (offsets - x0) / (x1 - x0)
    lever = np.stack([1.0 - share, share], axis=-1).astype(np.float32)
    return values - lever @ np.stack([low, high]), low, high


def _median(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median over the rows (R, N) of each column; sorting whole rows against each other is faster than np.median."""
    ordered = np.sort(rows, axis=0)
    middle = len(rows) // 2
    return ordered[middle] if len(rows) % 2 else (ordered[middle - 1] + ordered[middle]) / 2


def nearest_gaps(low: NDArray[np.bool_], peak_index: NDArray[np.int_], index: Rows) -> tuple[Rows, Rows]:
    """Nearest low cell (N,) on either side of each column's peak: -1 and S where there is none.

    ``index`` (S, 1) are the :func:`row_numbers`. Products with it are much faster than ``np.where``.
    """
    count = len(index)
    peak = (peak_index + 1).astype(index.dtype)
    before = np.multiply(index, low & (index < peak)).max(axis=0) - 1
    after = count - np.multiply(index[::-1], low & (index > peak)).max(axis=0)
    return before, after


def _crossing(signal: NDArray[np.float32], peak: NDArray[np.float32], outer: Rows, inward: int) -> Array:
    """Fractional row at which the signal falls through half its peak towards the gap; nan where there is no gap."""
    last = len(signal) - 1
    found = (outer >= 0) & (outer <= last)
    row = np.minimum(np.maximum(outer, 0), last).astype(np.int_)
    a, b = _in_row(signal, row), _in_row(signal, np.minimum(np.maximum(row + inward, 0), last))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(b != a, (0.5 * peak - a) / (b - a), 0.0)
    return np.where(found, row + inward * share, np.nan)


def picture_noise(picture: Brightness, places: NDArray[np.int_] | None = None) -> float:
    """Grey-level noise: robust standard deviation of the diagonal second difference (Immerkaer 1996), floor 0.5.

    ``places`` (N,) are the flat indices of the pixels that are looked at, none of them at the picture's border; every
    other one without them, or where they are few.
    """
    if places is None or len(places) < 100:
        second_difference = np.array([1, -2, 1], dtype=np.float32)
        values = np.abs(cv2.sepFilter2D(picture, cv2.CV_32F, second_difference, second_difference)[::2, ::2]).ravel()
    else:
        flat, width = picture.ravel(), picture.shape[1]
        around = places + np.array([-width, 0, width])[:, None, None] + np.array([-1, 0, 1])[:, None]
        before, here, after = np.moveaxis(flat.take(around).astype(np.float32), 1, 0)
        rows = before + after - 2 * here
        values = np.abs(rows[0] - 2 * rows[1] + rows[2])
    return float(max(0.5, 1.4826 / 6 * np.median(values)))
