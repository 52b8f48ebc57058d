"""Middles of painted spots that stand alone, where a view puts them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Mark
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array
from circlecal.observations import MarkPoint

__all__ = ["measure_spots"]

SEARCH_PX = 14.0
"""How far from its place a spot may lie, pixels at 1920 px width."""
SMALLEST_PX = 3.0
"""Radii of the spot in the picture, along and across, of which the smaller one must be half as large, pixels."""
PAINTED = 0.5
"""Share of the spot's contrast above which a pixel is painted."""
LEAST_CONTRAST, NOISE_TIMES = 8.0, 4.0
"""Gray levels by which a spot stands out at least, and how many times the picture's noise."""
AREA_RATIO = (0.45, 1.8)
"""Painted pixels over those that the spot should have."""
SIGMA_PX = 0.5
"""Standard deviation of a spot's middle, pixels at 1920 px width: ragged rims, feet."""


def measure_spots(
    picture: NDArray[np.uint8], view: FieldView, marks: Sequence[Mark], noise: float, placement_sd_m: float = 0.0
) -> tuple[MarkPoint, ...]:
    """Spots that are seen where a view puts them, as large as they should be.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    view : FieldView
        Where the field is seen.
    marks : sequence of Mark
        What is looked for.
    noise : float
        Grey-level noise of the picture.
    placement_sd_m : float
        By how much a spot is painted beside its place, metres, along either axis of the field.
    """
    found = (_measure_spot(picture, view, mark, noise, placement_sd_m) for mark in marks)
    return tuple(spot for spot in found if spot is not None)


def _measure_spot(
    picture: NDArray[np.uint8], view: FieldView, mark: Mark, noise: float, placement_sd_m: float
) -> MarkPoint | None:
    height, width = picture.shape
    unit, radius = width / 1920.0, mark.diameter_m / 2
    rim = np.asarray(mark.position) + radius * np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    seen = view.project(rim)
    if not np.isfinite(seen).all():
        return None
    half = np.ptp(seen, axis=0) / 2
    reach = half + SEARCH_PX * unit
    low, high = np.floor(seen[0] - reach).astype(int), np.ceil(seen[0] + reach).astype(int) + 1
    outside = (low < 0).any() or high[0] > width or high[1] > height
    if outside or half.max() < SMALLEST_PX or half.min() < SMALLEST_PX / 2:
        return None
    window = picture[low[1] : high[1], low[0] : high[0]].astype(np.float64)
    surface = float(np.median(window))
    contrast = float(np.percentile(window, 100 * (1 - 0.3 * np.pi * half.prod() / window.size))) - surface
    if contrast < max(LEAST_CONTRAST, NOISE_TIMES * noise):
        return None
    sigma_px = float(np.hypot(SIGMA_PX * unit, placement_sd_m * half.max() / radius))
    return _middle_of(window - surface > PAINTED * contrast, low, half, mark.name, sigma_px)


def _middle_of(
    painted: NDArray[np.bool_], low: NDArray[np.int_], half: Array, name: str, sigma_px: float
) -> MarkPoint | None:
    """Centroid of the largest painted piece, where it is as large as the spot and touches no border."""
    import cv2

    count, _, stats, centroids = cv2.connectedComponentsWithStats(painted.astype(np.uint8))
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    left, top, across, down, area = stats[largest].tolist()
    ratio = area / (np.pi * half.prod())
    rows, columns = painted.shape
    is_cut = left == 0 or top == 0 or left + across == columns or top + down == rows
    if is_cut or not AREA_RATIO[0] < ratio < AREA_RATIO[1]:
        return None
    return MarkPoint(name, low + centroids[largest], sigma_px)
