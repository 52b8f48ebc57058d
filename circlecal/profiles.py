"""Brightness profiles across a thin light (or dark) band, and where its middle and its edges are.

A marking a few pixels wide is measured by its flux, not by its edges: near and far on the field it is narrower than
the picture's blur, and two
edges are then a fiction, while the flux-weighted middle stays unbiased.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.homogeneous import Array

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


def grey(image: NDArray[np.uint8], polarity: float = 1.0) -> NDArray[np.float32]:
    """Brightness (H, W) of a BGR picture; negative ``polarity`` turns dark markings into light ones."""
    values = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return values if polarity >= 0 else 255.0 - values


def sample_profiles(picture: NDArray[np.float32], points_px: Array, normals: Array, offsets: Array) -> Array:
    """Brightness (N, S) at ``points + offset * normal``, bilinear; nan outside the picture."""
    position = points_px[:, None, :] + offsets[None, :, None] * normals[:, None, :]
    height, width = picture.shape
    if position.shape[0] == 0:
        return np.zeros(position.shape[:2])
    x, y = position[..., 0].astype(np.float32), position[..., 1].astype(np.float32)
    values = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
    outside = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)
    values[outside] = np.nan
    return values


def smooth_along(profiles: Array, sigma_samples: float) -> Array:
    """Gaussian mean of neighbouring profiles (N, S); rows with nan stay nan and lend nothing to their neighbours."""
    if sigma_samples <= 0 or len(profiles) < 3:
        return profiles
    known = np.isfinite(profiles)
    size = 2 * int(np.ceil(2.5 * sigma_samples)) + 1
    kernel = cv2.getGaussianKernel(size, sigma_samples)
    total = cv2.sepFilter2D(np.where(known, profiles, 0.0), -1, np.ones((1, 1)), kernel, borderType=cv2.BORDER_REFLECT)
    weight = cv2.sepFilter2D(known.astype(np.float64), -1, np.ones((1, 1)), kernel, borderType=cv2.BORDER_REFLECT)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(known, total / weight, np.nan)


def measure_bands(profiles: Array, offsets: Array, search_px: float, noise: float, minimum_snr: float = 3.0) -> Bands:
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
    known = np.isfinite(profiles).all(axis=1)
    values = np.where(np.isfinite(profiles), profiles, 0.0)
    rows = np.arange(len(values))
    index = np.arange(len(offsets))
    searched = np.abs(offsets) <= search_px
    peak_index = np.argmax(np.where(searched, values, -np.inf), axis=1)
    signal, low, high = _without_background(values, peak_index, offsets)
    peak = signal[rows, peak_index]

    below_half = signal < 0.5 * peak[:, None]
    left = _crossing(signal, peak, peak_index, index, below_half, -1) * step_px + offsets[0]
    right = _crossing(signal, peak, peak_index, index, below_half, 1) * step_px + offsets[0]
    inside = _connected(signal >= PEAK_SHARE * peak[:, None], peak_index, index)
    weight = np.where(inside, np.maximum(signal - PEAK_SHARE * peak[:, None], 0.0), 0.0)
    mass = np.maximum(weight.sum(axis=1), 1e-9)
    center = weight @ offsets / mass
    # noise of a centroid: samples are step_px apart but the picture's noise is per pixel
    lever = np.sqrt((inside * (offsets - center[:, None]) ** 2).sum(axis=1) * step_px)
    sigma = np.hypot(noise * lever / (mass * step_px), SIGMA_FLOOR_PX)

    touches_end = inside[:, 0] | inside[:, -1] | ~np.isfinite(left) | ~np.isfinite(right)
    valid = known & ~touches_end & (peak > minimum_snr * noise) & (np.abs(high - low) < 0.8 * peak)
    return Bands(center, left, right, sigma, peak, high - low, valid)


def _without_background(values: Array, peak_index: NDArray[np.int_], offsets: Array) -> tuple[Array, Array, Array]:
    """Signal over a straight line through the medians of both outer thirds; also the two medians."""
    third = max(3, len(offsets) // 4)
    low, high = np.median(values[:, :third], axis=1), np.median(values[:, -third:], axis=1)
    x0, x1 = offsets[:third].mean(), offsets[-third:].mean()
    line = low[:, None] + (high - low)[:, None] * (offsets - x0) / (x1 - x0)
    return values - line, low, high


def _connected(high: NDArray[np.bool_], peak_index: NDArray[np.int_], index: NDArray[np.int_]) -> NDArray[np.bool_]:
    """The run of true cells of each row that holds its peak."""
    gap_left = np.where(~high & (index < peak_index[:, None]), index, -1).max(axis=1)
    gap_right = np.where(~high & (index > peak_index[:, None]), index, len(index)).min(axis=1)
    return (index > gap_left[:, None]) & (index < gap_right[:, None])


def _crossing(
    signal: Array,
    peak: Array,
    peak_index: NDArray[np.int_],
    index: NDArray[np.int_],
    below: NDArray[np.bool_],
    side: int,
) -> Array:
    """Fractional index at which the signal falls through half its peak on one side; nan where it never does."""
    rows = np.arange(len(signal))
    if side < 0:
        outer = np.where(below & (index < peak_index[:, None]), index, -1).max(axis=1)
        found = outer >= 0
    else:
        outer = np.where(below & (index > peak_index[:, None]), index, len(index)).min(axis=1)
        found = outer < len(index)
    outer = np.where(found, outer, peak_index)
    inner = np.clip(outer - side, 0, len(index) - 1)
    a, b = signal[rows, outer], signal[rows, inner]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(b != a, (0.5 * peak - a) / (b - a), 0.0)
    return np.where(found, outer - side * share, np.nan)


def picture_noise(picture: NDArray[np.float32], region: NDArray[np.bool_] | None = None) -> float:
    """Grey-level noise: robust standard deviation of the diagonal second difference (Immerkaer 1996), floor 0.5."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6.0
    response = cv2.filter2D(picture, -1, kernel)
    values = response[::2, ::2] if region is None else response[::2, ::2][region[::2, ::2]]
    if values.size < 100:
        values = response
    return float(max(0.5, 1.4826 * np.median(np.abs(values))))
