"""Ridge points: centrelines of thin bright (or dark) structures with their normals, sub-pixel, at several widths.

A ridge is found where the smoothed picture's second derivative across it is strongly negative and its first derivative
vanishes within the pixel (Steger 1998, *An unbiased detector of curvilinear structures*, section 3.1): with the unit
eigenvector ``n`` of the Hessian's most negative eigenvalue ``k``, the ridge lies at ``-(g . n) / k * n`` from the
pixel's centre, ``g`` being the gradient there. Wide markings are found in reduced pictures (a pyramid), so one small
filter serves all widths.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.options import RidgeConfig
from circlecal.geometry.projective import Array
from circlecal.paint.profiles import GrayPicture

__all__ = ["RidgePoints", "RidgeRaster", "find_ridges"]

Floats = NDArray[np.float32]

LEVELS = 3
"""Of the pyramid; each doubles the width of the markings that it answers. In a study of 42 broadcast frames one level
found the circle in 37, three in all."""
LEVEL_WEIGHT = 0.71
"""Of a level's response relative to the next finer one. Second derivatives in the pixels of a level hold the factor
sigma^2 that makes the levels comparable; 2^-0.5 less per level makes that sigma^1.5, the study's weight, which prefers
the finer of two levels that answer alike.
"""
LEAST_CONTRAST = 0.4
"""Least second derivative across a ridge, gray levels per square pixel, where the surface is so calm that the threshold
in medians would take the rounding of gray levels for ridges."""
STEP_LIMIT = 0.6
"""Largest step from a pixel's centre to its ridge, in pixels; 0.5 would lose diagonal ridges."""
KERNEL_REACH = 2.7
"""Half size of the smoothing kernel, in sigmas: what lies beyond holds 0.7 % of the weight."""
PREFILTER = 0.7
"""The negative Laplacian reaches at least this share of the ridge response on any line-like ridge; pixels below it are
passed over before anything is computed for each."""
SHORTEST_CHAIN_PX, FEWEST_IN_CHAIN = 13.5, 4.0
"""Shorter chains of ridge points are dropped: length in pixels at 1920 px width, as in the study, where 3 to 30
thousand points remained of a frame; and points at least.
"""
ALIGNED_DEG = 15.0
"""Largest difference of direction, degrees, between a curve and the ridge points that support it."""
NOTHING, OFF_FIELD = -1, -2
"""What a raster holds where there is no ridge point: on the field, and off it."""

_ALIGNED = float(np.cos(np.deg2rad(ALIGNED_DEG)))


@dataclass(frozen=True, slots=True)
class RidgePoints:
    """Points on ridges, in pixels of the picture they were found in.

    Attributes
    ----------
    points, normals : (N, 2) float64
        Sub-pixel position and unit normal (sign arbitrary).
    chain : (N,) int64
        Number of points in the connected chain that the point belongs to.
    """

    points: Array
    normals: Array
    chain: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: NDArray[np.bool_]) -> RidgePoints:
        """Some of them."""
        return RidgePoints(self.points[index], self.normals[index], self.chain[index])

    def join(self, other: RidgePoints) -> RidgePoints:
        """These, and others of a picture of this size behind them."""
        points, normals = np.concatenate([self.points, other.points]), np.concatenate([self.normals, other.normals])
        return RidgePoints(points, normals, np.concatenate([self.chain, other.chain]))


def find_ridges(gray: GrayPicture, region: NDArray[np.uint8], sign: float, config: RidgeConfig) -> RidgePoints:
    """Find ridge points inside a region.

    Parameters
    ----------
    gray : (h, w) uint8 or float32
        Floats in gray levels.
    region : (h, w) uint8
        255 where ridges are wanted, 0 elsewhere.
    sign : float
        +1 for bright ridges, -1 for dark ones.
    config : RidgeConfig

    Returns
    -------
    RidgePoints
    """
    top, bottom = _find_rows(region, 1 << LEVELS)
    region = region[top:bottom]
    smooth = _build_pyramid(gray[top:bottom], config)
    ridges = _drop_short_chains(_find_on_levels(smooth, region, sign, config), region.shape)
    ridges.points[:, 1] += top
    return ridges


def _find_rows(region: NDArray[np.uint8], multiple: int) -> tuple[int, int]:
    """First and last row (exclusive) that hold the region with a margin, the first a multiple of the pyramid's step."""
    rows = np.flatnonzero(region.any(axis=1))
    if len(rows) == 0:
        return 0, region.shape[0]
    top = max(0, int(rows[0]) - 2 * multiple) // multiple * multiple
    return top, min(region.shape[0], int(rows[-1]) + 2 * multiple)


def _build_pyramid(gray: GrayPicture, config: RidgeConfig) -> list[Floats]:
    side = 2 * int(np.ceil(KERNEL_REACH * config.sigma_px)) + 1
    kernel = cv2.getGaussianKernel(side, config.sigma_px, cv2.CV_32F)
    levels = []
    current = gray
    for level in range(LEVELS):
        if level:
            size = (current.shape[1] // 2, current.shape[0] // 2)
            if min(size) < 16:
                break
            fractions = current.astype(np.float32, copy=False)
            current = np.asarray(cv2.resize(fractions, size, interpolation=cv2.INTER_AREA), np.float32)
        levels.append(np.asarray(cv2.sepFilter2D(current, cv2.CV_32F, kernel, kernel), np.float32))
    return levels


def _find_on_levels(smooth: list[Floats], region: NDArray[np.uint8], sign: float, config: RidgeConfig) -> Floats:
    """Rows x, y, nx, ny, strength (5, K) of the points of all levels; a place keeps the level that responds most."""
    height, width = region.shape
    responses = [
        np.asarray(cv2.Laplacian(picture, cv2.CV_32F, scale=-sign * LEVEL_WEIGHT**level), np.float32)
        for level, picture in enumerate(smooth)
    ]
    threshold = _choose_threshold(responses[0], region, config)
    taken = np.zeros(region.shape, np.uint8)
    parts = []
    for level, picture in enumerate(smooth):
        candidates = _find_candidates(responses[level], region, PREFILTER * threshold)
        found = _locate_ridges(picture, candidates, sign, LEVEL_WEIGHT**level, threshold)
        found[0] = (found[0] + 0.5) * (width / picture.shape[1]) - 0.5
        found[1] = (found[1] + 0.5) * (height / picture.shape[0]) - 0.5
        if level:
            found = found.take(np.flatnonzero(taken.ravel()[_pixel_indices(found, region.shape)] == 0), axis=1)
        if level + 1 < len(smooth):
            coarser = [_look_up_response(response, found, region.shape) for response in responses[level + 1 :]]
            found = found.take(np.flatnonzero(np.max(coarser, axis=0) <= found[4]), axis=1)
            taken.ravel()[_pixel_indices(found, region.shape)] = 1
            taken = np.asarray(cv2.dilate(taken, np.ones((3, 3), np.uint8)), np.uint8)
        parts.append(_repeat_along_ridge(found, 1 << level))
    return np.concatenate(parts, axis=1)


def _choose_threshold(response: Floats, region: NDArray[np.uint8], config: RidgeConfig) -> float:
    rows, columns = slice(2, None, 8), slice(2, None, 4)
    sample = response[rows, columns]
    positive = sample[(region[rows, columns] > 0) & (sample > 0)]
    if positive.size == 0:
        return float("inf")
    median = float(np.partition(positive, positive.size // 2)[positive.size // 2])
    return max(LEAST_CONTRAST, config.threshold * median)


def _find_candidates(response: Floats, region: NDArray[np.uint8], threshold: float) -> NDArray[np.int64]:
    """Flat indices of the pixels worth a closer look, borders left out."""
    wanted = (response > threshold).view(np.uint8)
    if region.shape != response.shape:
        region = np.asarray(cv2.resize(region, response.shape[::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
    wanted &= region & 1
    wanted[0] = wanted[-1] = 0
    wanted[:, 0] = wanted[:, -1] = 0
    return np.flatnonzero(wanted.view(np.bool_))


def _locate_ridges(
    picture: Floats, candidates: NDArray[np.int64], sign: float, weight: float, threshold: float
) -> Floats:
    """Ridges through the candidate pixels: rows x, y, nx, ny, strength (5, M), in pixels of this picture."""
    width = picture.shape[1]
    flat = picture.ravel() if sign > 0 else -picture.ravel()
    corner = candidates - (width + 1)
    (nw, n, ne), (w, c, e), (sw, s, se) = (
        [flat[start + column :].take(corner) for column in range(3)] for start in (0, width, 2 * width)
    )
    twice = c + c
    xx, yy, xy = w + e - twice, n + s - twice, (se - sw - ne + nw) * np.float32(0.25)
    gx, gy = e - w, s - n  # twice the gradient
    half = (xx - yy) * np.float32(0.5)
    # k = (xx + yy) / 2 - sqrt((xx - yy)^2 / 4 + xy^2), with the eigenvector (xy, k - xx) or (k - yy, xy), any length
    across = (xx + yy) * np.float32(0.5) - np.sqrt(half * half + xy * xy)
    steep = half < 0
    nx, ny = np.where(steep, across - yy, xy), np.where(steep, xy, across - xx)
    length = nx * nx + ny * ny
    # -(g . n) / (k |n|^2), the step to the ridge in units of the eigenvector
    step = (gx * nx + gy * ny) / (length * np.minimum(across, np.float32(-1e-6)) * np.float32(-2.0) + np.float32(1e-30))
    sx, sy = step * nx, step * ny
    on = np.maximum(np.abs(sx), np.abs(sy)) <= np.float32(STEP_LIMIT)
    on &= across < np.float32(-threshold / weight)
    on &= length > 0  # a round dot has no direction
    keep = np.flatnonzero(on)
    pixels, size = candidates.take(keep), np.sqrt(length.take(keep))
    rows = np.empty((5, len(keep)), np.float32)
    np.add(pixels % width, sx.take(keep), out=rows[0])
    np.add(pixels // width, sy.take(keep), out=rows[1])
    np.divide(nx.take(keep), size, out=rows[2])
    np.divide(ny.take(keep), size, out=rows[3])
    np.multiply(across.take(keep), np.float32(-weight), out=rows[4])
    return rows


def _pixel_indices(rows: Floats, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Flat index of the pixel that each point lies in."""
    x = np.clip(np.rint(rows[0]), 0, shape[1] - 1).astype(np.int64)
    y = np.clip(np.rint(rows[1]), 0, shape[0] - 1).astype(np.int64)
    return np.asarray(y * shape[1] + x, np.int64)


def _look_up_response(response: Floats, rows: Floats, shape: tuple[int, ...]) -> Floats:
    """Response of another level at the place of each point (M,)."""
    height, width = response.shape
    x = np.clip((rows[0] + 0.5) * (width / shape[1]), 0, width - 1).astype(np.int64)
    y = np.clip((rows[1] + 0.5) * (height / shape[0]), 0, height - 1).astype(np.int64)
    return np.asarray(response.ravel()[y * width + x], np.float32)


def _repeat_along_ridge(rows: Floats, copies: int) -> Floats:
    """Points of a coarse level repeated along the ridge, so that every level has about one point per pixel."""
    if copies == 1:
        return rows
    spread = np.repeat(rows, copies, axis=1)
    offset = np.tile(np.arange(copies, dtype=np.float32) - np.float32((copies - 1) / 2), rows.shape[1])
    spread[0] -= offset * spread[3]
    spread[1] += offset * spread[2]
    return spread


def _drop_short_chains(rows: Floats, shape: tuple[int, ...]) -> RidgePoints:
    cells = _pixel_indices(rows, shape)
    raster = np.zeros(shape, np.uint8)
    raster.ravel()[cells] = 1
    _, labels = cv2.connectedComponents(raster, connectivity=8)
    label = labels.ravel()[cells]
    chain = np.bincount(label, minlength=1)[label]
    keep = np.flatnonzero(chain >= max(FEWEST_IN_CHAIN, SHORTEST_CHAIN_PX * shape[1] / 1920.0))
    kept = rows[:4].take(keep, axis=1).astype(np.float64)
    return RidgePoints(kept[:2].T.copy(), kept[2:].T.copy(), chain[keep].astype(np.int64))


class RidgeRaster:
    """Which ridge point is at or beside a pixel.

    Parameters
    ----------
    ridges : RidgePoints
    region : (h, w) uint8
        Non-zero inside the field.
    """

    def __init__(self, ridges: RidgePoints, region: NDArray[np.uint8]) -> None:
        self.height, self.width = region.shape
        self.ridges = ridges
        wide = self.width + 2  # one pixel of border: neighbours need no clipping, places off the picture end up there
        inside = cv2.copyMakeBorder(region, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=[0.0]) > 0
        cells = inside.view(np.int8) + np.int8(OFF_FIELD)  # one more is NOTHING
        flat = cells.astype(np.int32).ravel()
        x, y = np.rint(ridges.points).astype(np.int64).T
        place = (np.clip(y, 0, self.height - 1) + 1) * wide + np.clip(x, 0, self.width - 1) + 1
        index = np.arange(len(place), dtype=np.int32)
        diagonal, straight = (-wide - 1, -wide + 1, wide - 1, wide + 1), (-wide, -1, 1, wide)
        for offset in (*diagonal, *straight, 0):  # nearest last: it wins
            flat[place + offset] = index
        self._flat, self._stride = flat, wide
        empty = np.zeros(1)  # entry for "no ridge point": aligned with nothing
        self._nx = np.concatenate([ridges.normals[:, 0], empty]).astype(np.float32)
        self._ny = np.concatenate([ridges.normals[:, 1], empty]).astype(np.float32)

    def lookup(self, x: Floats, y: Floats) -> NDArray[np.int32]:
        """Ridge index at or beside each place (...); negative where there is none."""
        column = np.minimum(np.maximum(np.rint(x), -1), self.width).astype(np.int32)
        row = np.minimum(np.maximum(np.rint(y), -1), self.height).astype(np.int32)
        return self._flat.take(row * self._stride + column + (self._stride + 1))

    def is_aligned(self, index: NDArray[np.int32], nx: Floats, ny: Floats) -> NDArray[np.bool_]:
        """Whether the ridge points (...) run along the curve with these normals (any length)."""
        where = np.maximum(index, NOTHING)  # -1: the empty entry
        dot = self._nx.take(where) * nx + self._ny.take(where) * ny
        return np.asarray(dot * dot > np.float32(_ALIGNED**2) * (nx * nx + ny * ny), np.bool_)
