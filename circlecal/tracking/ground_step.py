"""Where thin paint lies between two grounds of different brightness.

Beyond a goal line or a touchline the grass is cut otherwise, or the run-off begins. A middle that is read off what
rises above the ground is then drawn to the brighter side. Along a piece of a line the profile is a line of paint upon a
step, both under one blur, wherever the step lies; which line fits it best says where the paint is.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from circlecal.geometry.projective import Array, Indices
from circlecal.paint.lines import BESIDE_PX, LEAST_UNIT
from circlecal.paint.profiles import GrayPicture, sample_profiles

TAP_PX = 0.5
"""Distance of the samples across a line, pixels."""
BLURS_PX = np.array([0.7, 0.9, 1.15, 1.5, 2.0])
"""Standard deviations of the blurred paint that are tried, pixels."""
STEP_PX, MIDDLE_PX, FARTHEST_PX = 0.5, 0.2, 0.8
"""Distance of the places of the step, and of the paint, that are tried, and the farthest of the latter from where the
paint was found, pixels.
"""
POLISHES = 2
"""Steps from the best place that was tried: it is then found to a hundredth of a pixel."""
LEAST_NORM = 1e-6
"""Of a column, as a share of its size, where two columns are alike."""
LEAST_PLACES = 8
"""Along a piece, whose mean profile is free enough of noise."""
RIM_TAPS = 2
"""At either end of a profile, which say how bright the ground is."""
LEAST_STEP = 0.1
"""Of the two grounds, as a share of the paint's height: what less moves a middle is a hundredth of a pixel."""


@lru_cache(maxsize=4)
def _models(half: int) -> tuple[Array, Array, Array]:
    """Orthonormal bases (B, E, C, 3, S) of profiles of ``2 half + 1`` samples with a blur, a step and a line, and the
    places of the steps (E,) and of the lines (C,).

    The first vector is constant, the second adds the step to it, and the third adds the line.
    """
    x = np.arange(-half, half + 1.0) * TAP_PX
    last = x[-1] - 2.0 * TAP_PX
    steps = np.arange(-last, last + 1e-9, STEP_PX)
    count = round(FARTHEST_PX / MIDDLE_PX)
    lines = np.arange(-count, count + 1.0) * MIDDLE_PX
    blur = BLURS_PX[:, None, None]
    step = ndtr((x - steps[None, :, None]) / blur)[:, :, None]
    line = np.exp(-0.5 * ((x - lines[None, :, None]) / blur) ** 2)[:, None]
    shape = (len(BLURS_PX), len(steps), len(lines), len(x))
    columns = np.stack([np.ones(shape), np.broadcast_to(step, shape), np.broadcast_to(line, shape)], axis=-1)
    basis, _ = np.linalg.qr(columns)
    return np.ascontiguousarray(np.swapaxes(basis, -1, -2)), steps, lines


def find_middles(picture: GrayPicture, points: Array, normals: Array, pieces: NDArray[np.int64], unit: float) -> Array:
    """How far (N,) along their normals the middles of thin paint lie from where they were found, pixels; the same along
    a piece, and 0 where the ground is the same on both sides.

    Parameters
    ----------
    picture : (H, W) uint8
        Gray levels.
    points, normals : (N, 2) arrays
        Where the paint was found, in order, and the direction across it.
    pieces : (N,) int64
        Growing numbers of the pieces of lines.
    unit : float
        Width of the picture over 1920.
    """
    if len(points) == 0:
        return np.zeros(0)
    half = int(np.ceil(BESIDE_PX[1] * max(unit, LEAST_UNIT) / TAP_PX))
    first = np.flatnonzero(np.diff(pieces, prepend=-1) != 0)
    count = np.diff(first, append=len(points))
    away = np.where(count >= LEAST_PLACES, _find_beside(picture, points, normals, first, count, half), 0.0)
    return np.repeat(away, count)


def _find_beside(
    picture: GrayPicture, points: Array, normals: Array, first: Indices, count: Indices, half: int
) -> Array:
    """Places (P,) of the lines beside where they are taken to be, by the mean profile of each piece, pixels."""
    offsets = np.arange(-half, half + 1.0) * TAP_PX
    profiles = sample_profiles(picture, points, normals, offsets, repeat_border=True)
    mean = np.add.reduceat(profiles.astype(np.float64), first, axis=0) / count[:, None]
    rim = mean[:, :RIM_TAPS].mean(axis=1), mean[:, -RIM_TAPS:].mean(axis=1)
    is_uneven = np.abs(rim[1] - rim[0]) > LEAST_STEP * (mean[:, half] - np.minimum(*rim))
    away, fitted = np.zeros(len(first)), np.flatnonzero(is_uneven)
    if len(fitted):
        away[fitted] = _fit_middles(mean[fitted], half)
    return away


def _fit_middles(profiles: Array, half: int) -> Array:
    """Places (P,) of the line in mean profiles (P, S), pixels; 0 where their step is too small to tell."""
    bases, steps, lines = _models(half)
    count = len(profiles)
    parts = profiles @ bases.reshape(-1, bases.shape[-1]).T
    explained = (parts.reshape(count, *bases.shape[:-1]) ** 2).sum(axis=-1)
    tried = np.unravel_index(explained.reshape(count, -1).argmax(axis=1), explained.shape[1:])
    blur, step, line = BLURS_PX[tried[0]], steps[tried[1]], lines[tried[2]]
    x = np.arange(-half, half + 1.0) * TAP_PX
    rise, height = _fit_levels(profiles, x, blur, step, line)
    for _ in range(POLISHES):
        rise, height, step_change, line_change = _linearise(profiles, x, blur, step, line, rise, height)
        step = step + np.clip(step_change, -STEP_PX, STEP_PX)
        line = line + np.clip(line_change, -MIDDLE_PX, MIDDLE_PX)
    told = (height > 0.0) & (np.abs(rise) > LEAST_STEP * height) & (np.abs(line) < FARTHEST_PX)
    return np.where(told, line, 0.0)


def _fit_levels(profiles: Array, x: Array, blur: Array, step: Array, line: Array) -> tuple[Array, Array]:
    """Rise (P,) of the ground and height (P,) of the paint in profiles (P, S), gray levels."""
    blur = blur[:, None]
    bell = np.exp(-0.5 * ((x - line[:, None]) / blur) ** 2)
    columns = np.stack([np.ones(profiles.shape), ndtr((x - step[:, None]) / blur), bell], axis=-1)
    levels = _solve(columns, profiles)
    return levels[:, 1], levels[:, 2]


def _linearise(
    profiles: Array, x: Array, blur: Array, step: Array, line: Array, rise: Array, height: Array
) -> tuple[Array, Array, Array, Array]:
    """Rise (P,) of the ground and height (P,) of the paint anew, and by how much their places (P,), (P,) are to be
    changed, pixels: one step of Gauss and Newton's method.
    """
    blur = blur[:, None]
    from_step, from_line = (x - step[:, None]) / blur, (x - line[:, None]) / blur
    bell = np.exp(-0.5 * from_line**2)
    slope = np.exp(-0.5 * from_step**2) / (blur * np.sqrt(2.0 * np.pi))
    moved = -slope * rise[:, None], bell * from_line / blur * height[:, None]
    found = _solve(np.stack([np.ones(profiles.shape), ndtr(from_step), bell, *moved], axis=-1), profiles)
    return found[:, 1], found[:, 2], found[:, 3], found[:, 4]


def _solve(columns: Array, profiles: Array) -> Array:
    """Least-squares weights (P, K) of columns (P, S, K) that make up profiles (P, S)."""
    rows = np.swapaxes(columns, 1, 2)
    size = np.sqrt(np.einsum("pks,pks->pk", rows, rows)) + LEAST_NORM
    normal = rows @ columns / (size[:, :, None] * size[:, None]) + LEAST_NORM * np.eye(columns.shape[2])
    return np.asarray(np.linalg.solve(normal, rows @ profiles[..., None] / size[..., None])[..., 0] / size)
