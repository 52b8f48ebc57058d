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
LARGEST_WIDTHS = 0.1
"""Larger radius, picture widths: a spot of which a wrong camera says so is not looked for."""
RING = 1.25, 1.7
"""Where the bare ground around a spot is looked at, radii of the spot: beyond the blur of its rim."""
PAINTED = 0.5
"""Share of the spot's contrast above which a pixel is painted."""
LEAST_CONTRAST, NOISE_TIMES = 8.0, 4.0
"""Gray levels by which a spot stands out at least, and how many times the picture's noise."""
LEAST_INSIDE, MOST_AROUND = 0.8, 0.35
"""Share of the spot that is painted at least, and of the ring that may be: brackets about it, a skate, a stick."""
HIDDEN, LEAST_SEEN = 1.1, 0.45
"""Farther than so many contrasts of the spot from the middle between it and the ground something else is seen, and so
much of the spot at least must be.
"""
OTHER_COLOUR = 0.45
"""Distance of a colour from those between ground and spot, in the distance of these, from which on it is another's."""
LARGEST_MISFIT = 0.28
"""Root mean square by which what is seen there may differ from the spot, in its contrast: of 82 spots of rendered rinks
whose cameras are known those of 0.25 at most are 1.9 px off at most, in 9 of 10 0.7; of 0.32 and more, mostly hidden or
missed, 3 to 13.
"""
NEAR_RIM = 0.4, 1.6
"""Between which radii of the spot its rim is fitted."""
RIM_PX, ROUNDS, LARGEST_MOVE_PX = 0.7, 6, 4.0
"""Width of a spot's soft rim, pixels; Gauss-Newton steps, and by how much they may move the middle."""
SIGMA_PX = 0.5
"""Standard deviation of a spot's middle, pixels at 1920 px width: ragged rims, feet."""


def measure_spots(
    picture: NDArray[np.uint8],
    image: NDArray[np.uint8],
    view: FieldView,
    marks: Sequence[Mark],
    noise: float,
    placement_sd_m: float = 0.0,
) -> tuple[MarkPoint, ...]:
    """Spots that are seen where a view puts them, as large as they should be.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    image : (H, W, 3) uint8
        The picture in colours.
    view : FieldView
        Where the field is seen.
    marks : sequence of Mark
        What is looked for.
    noise : float
        Grey-level noise of the picture.
    placement_sd_m : float
        By how much a spot is painted beside its place, metres, along either axis of the field.
    """
    found = (_measure_spot(picture, image, view, mark, noise, placement_sd_m) for mark in marks)
    return tuple(spot for spot in found if spot is not None)


def _measure_spot(
    picture: NDArray[np.uint8],
    image: NDArray[np.uint8],
    view: FieldView,
    mark: Mark,
    noise: float,
    placement_sd_m: float,
) -> MarkPoint | None:
    height, width = picture.shape
    unit, radius = width / 1920.0, mark.diameter_m / 2
    seen = view.project(np.asarray(mark.position) + radius * np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1]]))
    if not np.isfinite(seen).all():
        return None
    axes = 0.5 * np.stack([seen[1] - seen[2], seen[3] - seen[4]], axis=-1)
    half = np.hypot(*axes.T)
    if (
        not SMALLEST_PX <= half.max() <= LARGEST_WIDTHS * width
        or abs(np.linalg.det(axes)) < half.max() * SMALLEST_PX / 2
    ):
        return None
    reach = half * RING[1] + SEARCH_PX * unit
    low, high = np.floor(seen[0] - reach).astype(int), np.ceil(seen[0] + reach).astype(int) + 1
    low, high = np.maximum(low, 0), np.minimum(high, (width, height))
    disc, ring = _draw_kernels(axes)
    if (high - low < disc.shape[::-1]).any():
        return None
    window = picture[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    colours = image[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    place = _match_disc(window, colours, disc, ring, axes, max(LEAST_CONTRAST, NOISE_TIMES * noise))
    if place is None:
        return None
    sigma_px = float(np.hypot(SIGMA_PX * unit, placement_sd_m * half.max() / radius))
    return MarkPoint(mark.name, low + place, sigma_px)


def _draw_kernels(axes: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Weights (h, w) of the mean over a spot with half axes as columns (2, 2), pixels, and over the ring about it."""
    across, down = np.ceil(np.hypot(*axes.T) * RING[1]).astype(int)
    grid = np.stack(np.meshgrid(np.arange(-across, across + 1), np.arange(-down, down + 1)), axis=-1)
    away = np.linalg.norm(np.linalg.solve(axes, grid.reshape(-1, 2).T.astype(np.float64)), axis=0)
    away = away.reshape(grid.shape[:2])
    disc, ring = (away <= 1.0).astype(np.float32), ((away > RING[0]) & (away < RING[1])).astype(np.float32)
    return disc / disc.sum(), ring / ring.sum()


def _match_disc(
    window: NDArray[np.float32],
    colours: NDArray[np.float32],
    disc: NDArray[np.float32],
    ring: NDArray[np.float32],
    axes: Array,
    least: float,
) -> Array | None:
    """Where a spot (x, y) stands out from the ring about it in a window (h, w) by some gray levels at least; None where
    nothing as large does.

    It is looked for by brightness first, which tells its colour; then by what lies between the colours (h, w, 3) of the
    ground and of the spot, so that skates and sticks of other colours do not count.
    """
    surface = float(np.median(window))
    x, y, contrast = _find_peak((window - surface) / np.float32(255.0), np.ones_like(window), disc, ring)
    if 255.0 * contrast < least:
        return None
    rows, columns = disc.shape
    here = slice(y, y + rows), slice(x, x + columns)
    inside = (disc > 0) & (window[here] - surface > PAINTED * 255.0 * contrast)
    ground = np.median(colours.reshape(-1, 3), axis=0)
    added = np.median(colours[here][inside], axis=0) - ground if inside.any() else np.zeros(3)
    strength = float(added @ added)
    if strength < least**2:
        return None
    amount = np.asarray((colours - ground) @ added / strength, np.float64)
    beside = np.linalg.norm(colours - ground - amount[..., None] * added, axis=-1) / np.sqrt(strength)
    known = ((beside < OTHER_COLOUR) & (np.abs(amount - 0.5) < HIDDEN)).astype(np.float32)
    x, y, _ = _find_peak(amount.astype(np.float32), known, disc, ring)
    here = slice(y, y + rows), slice(x, x + columns)
    painted = known[here] * (amount[here] > PAINTED)
    shares = [float((kernel * painted).sum() / max((kernel * known[here]).sum(), 1e-9)) for kernel in (disc, ring)]
    if (disc * known[here]).sum() < LEAST_SEEN or shares[0] < LEAST_INSIDE or shares[1] > MOST_AROUND:
        return None
    middle = np.array([x + columns // 2, y + rows // 2], np.float64)
    return _refine_place(amount, known, np.asarray(np.linalg.inv(axes)), middle)


def _find_peak(
    values: NDArray[np.float32], known: NDArray[np.float32], disc: NDArray[np.float32], ring: NDArray[np.float32]
) -> tuple[int, int, float]:
    """Column and row of the kernels in a window (h, w) where the known values under the disc exceed those under the
    ring by most, and the mean under the disc there.
    """
    (inside, seen), (around, _) = _mean_over(values, known, disc), _mean_over(values, known, ring)
    score = np.where(seen > LEAST_SEEN, inside - around, -np.inf)
    y, x = (int(k) for k in np.unravel_index(np.argmax(score), score.shape))
    return x, y, float(inside[y, x])


def _mean_over(
    values: NDArray[np.float32], known: NDArray[np.float32], kernel: NDArray[np.float32]
) -> tuple[Array, Array]:
    """Mean of known values (h, w) under a kernel at each place that holds it, and the share of it that is known."""
    import cv2

    share = np.asarray(cv2.matchTemplate(known, kernel, cv2.TM_CCORR), np.float64)
    total = np.asarray(cv2.matchTemplate(values * known, kernel, cv2.TM_CCORR), np.float64)
    return total / np.maximum(share, 1e-6), share


def _refine_place(amount: Array, known: NDArray[np.float32], inverse_axes: Array, place: Array) -> Array | None:
    """The middle (x, y) of a spot in a window (h, w) whose known values are 1 on it and 0 beside it, from one within a
    pixel or two: least squares against an ellipse with a soft rim. None where it goes astray.
    """
    rows, columns = np.nonzero(known)
    pixels, values = np.stack([columns, rows], axis=-1).astype(np.float64), amount[rows, columns]
    at, off = place, np.ones(1)
    for _ in range(ROUNDS):
        unit = (pixels - at) @ inverse_axes.T
        radius = np.linalg.norm(unit, axis=1)
        near = (radius > NEAR_RIM[0]) & (radius < NEAR_RIM[1])
        slope = (unit[near] @ inverse_axes) / radius[near, None]
        steep = np.linalg.norm(slope, axis=1)
        model = 1.0 / (1.0 + np.exp((radius[near] - 1.0) / steep / RIM_PX))
        J = (model * (1.0 - model) / RIM_PX / steep)[:, None] * slope
        off = np.clip(values[near] - model, -1.0, 1.0)
        normal = J.T @ J
        if np.linalg.det(normal) <= 1e-9:
            return None
        at = at + np.linalg.solve(normal, J.T @ off)
        if np.linalg.norm(at - place) > LARGEST_MOVE_PX:
            return None
    return np.asarray(at) if np.sqrt(np.mean(off**2)) <= LARGEST_MISFIT else None
