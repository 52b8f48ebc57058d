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

from circlecal.geometry.homogeneous import Array

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


def grey(image: NDArray[np.uint8], polarity: float = 1.0) -> NDArray[np.uint8]:
    """Brightness (H, W) of a BGR picture; negative ``polarity`` turns dark markings into light ones."""
    values = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return values if polarity >= 0 else ~values


def sample_profiles(picture: Brightness, points_px: Array, normals: Array, offsets: Array) -> NDArray[np.float32]:
    """Brightness (N, S) at ``points + offset * normal``, bilinear; nan outside the picture.

    Stored with the profiles side by side (``.T`` is contiguous), as :func:`measure_bands` reads them.
    """
    height, width = picture.shape
    if len(points_px) == 0:
        return np.zeros((0, len(offsets)), np.float32)
    across = np.asarray(offsets, np.float32)[:, None]
    (x0, y0), (nx, ny) = (np.asarray(v, np.float32).T for v in (points_px, normals))
    x, y = x0 + across * nx, y0 + across * ny
    sampled = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(sampled, np.float32)
    ends_x, ends_y = x[[0, -1]], y[[0, -1]]
    if ends_x.min() < 0 or ends_y.min() < 0 or ends_x.max() > width - 1 or ends_y.max() > height - 1:
        values[(x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)] = np.nan
    return values.T


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
        The peak is looked for within this distance of offset 0.
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
    columns = np.arange(values.shape[1])
    index = np.arange(1, len(offsets) + 1, dtype=np.int16)[:, None]
    searched = np.flatnonzero(np.abs(offsets) <= search_px)
    peak_index = values[searched[0] : searched[-1] + 1].argmax(axis=0) + searched[0]
    signal, low, high = _without_background(values, offsets)
    peak = signal[peak_index, columns]

    before, after = nearest_gaps(signal < 0.5 * peak, peak_index, index)
    left = _crossing(signal, peak, before, 1) * step_px + offsets[0]
    right = _crossing(signal, peak, after, -1) * step_px + offsets[0]
    threshold = np.float32(PEAK_SHARE) * peak
    before, after = nearest_gaps(signal < threshold, peak_index, index)
    inside = (index - 1 > before) & (index - 1 < after)
    weight = np.maximum(signal - threshold, np.float32(0)) * inside
    across = offsets.astype(np.float32)
    mass = np.maximum(weight.sum(axis=0), np.float32(1e-9))
    center = (across @ weight / mass).astype(np.float64)
    # noise of a centroid: samples are step_px apart but the picture's noise is per pixel
    first, second = across @ inside.astype(np.float32), (across * across) @ inside.astype(np.float32)
    squared_lever = second - 2 * center * first + center**2 * (after - before - 1)
    sigma = np.hypot(noise * np.sqrt(np.maximum(squared_lever, 0.0) * step_px) / (mass * step_px), SIGMA_FLOOR_PX)

    touches_end = (before < 0) | (after >= len(offsets)) | ~np.isfinite(left) | ~np.isfinite(right)
    valid = known & ~touches_end & (peak > minimum_snr * noise) & (np.abs(high - low) < 0.8 * peak)
    return Bands(center, left, right, sigma, peak.astype(np.float64), (high - low).astype(np.float64), valid)


def _without_background(
    values: NDArray[np.float32], offsets: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Signal (S, N) over a straight line through the medians of both outer quarters; also the two medians (N,)."""
    quarter = max(3, len(offsets) // 4)
    low, high = _median(values[:quarter]), _median(values[-quarter:])
    x0, x1 = offsets[:quarter].mean(), offsets[-quarter:].mean()
    share = ((offsets - x0) / (x1 - x0)).astype(np.float32)[:, None]
    return values - (low + (high - low) * share), low, high


def _median(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median over the rows (R, N) of each column; sorting whole rows against each other is faster than np.median."""
    ordered = np.sort(rows, axis=0)
    middle = len(rows) // 2
    return ordered[middle] if len(rows) % 2 else (ordered[middle - 1] + ordered[middle]) / 2


def nearest_gaps(
    low: NDArray[np.bool_], peak_index: NDArray[np.int_], index: NDArray[np.int16]
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Nearest low cell (N,) on either side of each column's peak: -1 and S where there is none.

    ``index`` (S, 1) counts the rows from 1. Products with it are much faster than ``np.where``.
    """
    count = len(index)
    peak = (peak_index + 1).astype(np.int16)
    before = np.multiply(index, low & (index < peak)).max(axis=0)
    after = np.multiply(np.int16(count + 1) - index, low & (index > peak)).max(axis=0)
    return before.astype(np.int_) - 1, count - after.astype(np.int_)


def _crossing(signal: NDArray[np.float32], peak: NDArray[np.float32], outer: NDArray[np.int_], inward: int) -> Array:
    """Fractional row at which the signal falls through half its peak towards the gap; nan where there is no gap."""
    columns = np.arange(signal.shape[1])
    found = (outer >= 0) & (outer < len(signal))
    row = np.clip(outer, 0, len(signal) - 1)
    a, b = signal[row, columns], signal[np.clip(row + inward, 0, len(signal) - 1), columns]
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
        around = places + np.array([[-width], [0], [width]])
        ends, middle = flat[around - 1].astype(np.float32) + flat[around + 1], flat[around].astype(np.float32)
        rows = ends - 2 * middle
        values = np.abs(rows[0] - 2 * rows[1] + rows[2])
    return float(max(0.5, 1.4826 / 6 * np.median(values)))
