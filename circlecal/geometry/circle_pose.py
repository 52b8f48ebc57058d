"""One circle, a line through its centre and an ordinary pinhole camera: the imaged centre needs not be seen.

A camera with square pixels and a known principal point has seven unknowns; the ellipse brings five constraints and a
line through the centre brings two. For a candidate centre on the line the homography is known in closed form
(:func:`circlecal.geometry.homography.homography_from_circle`); its first two columns must be orthogonal and of equal
length on the focal plane. Both conditions are linear in 1/f^2; eliminating it leaves one equation along the line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.conics import line_conic_meet, normalise_conic
from circlecal.geometry.projective import Array, dehomogenise

LARGEST_OFFSET = 0.6
"""Half chords from the chord's middle within which the imaged centre is looked for: at an offset s the depths of the
chord's ends have the ratio (1 + s) / (1 - s), here 4; cameras beside a field see their circles with ratios below 2.
"""
GRID, STEPS = 241, 20
"""Samples between which roots are looked for, and the most steps to each root."""


@dataclass(frozen=True, slots=True)
class PinholeCenter:
    """A candidate: imaged centre (3,), focal length in pixels, offset from the chord's middle in half chords."""

    center: Array
    focal_px: float
    offset: float


def _constraint(conic: Array, line: Array, centers: Array) -> tuple[Array, Array]:
    """Residual (K,) of the two square-pixel conditions with ``w = 1 / f^2`` eliminated, and that w (K,).

    ``centers`` (K, 3) lie on the line. The columns of the homography are the vanishing points v1 and v2 of the line's
    direction and of the one across it, scaled to ``v^T E v = 1``. On the focal plane they are orthogonal and of equal
    length: ``(x1 x2 + y1 y2) w + z1 z2 = 0`` and ``(x1^2 + y1^2 - x2^2 - y2^2) w + z1^2 - z2^2 = 0``.
    """
    # vanishing line p = E c, v1 = l x p (Magera et al. 2025, eq. 4 and 5), v2 = p x E v1 conjugate to it
    polars = centers @ conic
    v1 = _cross(line, polars)
    pushed = v1 @ conic
    v2 = _cross(polars.T, pushed)
    v1 = v1 / np.sqrt(np.maximum((pushed * v1).sum(axis=1), 1e-300))[:, None]
    v2 = v2 / np.sqrt(np.maximum(((v2 @ conic) * v2).sum(axis=1), 1e-300))[:, None]
    dot, product = np.sum(v1[:, :2] * v2[:, :2], axis=-1), v1[:, 2] * v2[:, 2]
    lengths = np.sum(v1[:, :2] ** 2 - v2[:, :2] ** 2, axis=-1)
    depths = v1[:, 2] ** 2 - v2[:, 2] ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        # w of both conditions in least squares
        inverse_f2 = -(dot * product + lengths * depths) / (dot**2 + lengths**2)
    # the determinant of both conditions, zero where one w fulfils them
    return dot * depths - lengths * product, inverse_f2


def _cross(first: Array, second: Array) -> Array:
    """Cross products (K, 3) of coordinates (3,) or (3, K) with vectors (K, 3)."""
    (a, b, c), (x, y, z) = first, second.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def pinhole_centers(
    conic: ArrayLike, line: ArrayLike, principal_point: ArrayLike, scale_px: float
) -> list[PinholeCenter]:
    """Imaged centres on a line through the circle's centre that an ordinary pinhole camera allows.

    Parameters
    ----------
    conic : (3, 3) array
        Image of the circle.
    line : (3,) array
        Image of a line through the circle's centre (its direction on the field need not be known).
    principal_point : (2,) array
        Known principal point; pixels are square and undistorted.
    scale_px : float
        Typical size of the picture, for the conditioning.

    Returns
    -------
    list of PinholeCenter
        All roots with a real focal length, at most a few; empty where the line misses the circle. Where the camera
        stands in the vertical plane of the line the condition holds everywhere and the roots mean nothing.
    """
    x, y = np.asarray(principal_point, dtype=np.float64)
    s = float(scale_px)
    T = np.array([[s, 0.0, x], [0.0, s, y], [0.0, 0.0, 1.0]])
    e = normalise_conic(T.T @ np.asarray(conic, dtype=np.float64) @ T)
    l_local = T.T @ np.asarray(line, dtype=np.float64)
    ends = line_conic_meet(e, l_local)
    if ends is None:
        return []
    p, q = dehomogenise(ends)

    def centers(offset: Array) -> Array:
        points = 0.5 * (p + q) + 0.5 * np.asarray(offset)[:, None] * (q - p)
        return np.column_stack([points, np.ones(len(points))])

    grid = np.linspace(-LARGEST_OFFSET, LARGEST_OFFSET, GRID)
    root = _find_roots(lambda offset: _constraint(e, l_local, centers(offset))[0], grid)
    if len(root) == 0:
        return []
    _, inverse_f2 = _constraint(e, l_local, centers(root))
    image = centers(root) @ T.T
    return [
        PinholeCenter(image[k], float(s / np.sqrt(inverse_f2[k])), float(root[k]))
        for k in range(len(root))
        if inverse_f2[k] > 0
    ]


def _find_roots(evaluate: Callable[[Array], Array], grid: Array) -> Array:
    """Roots (K,) of a function between those neighbours of a grid at which its signs differ, all at once.

    False position, with the value of an end that is kept twice halved (Illinois).
    """
    value = evaluate(grid)
    index = np.flatnonzero(np.sign(value[:-1]) * np.sign(value[1:]) < 0)
    if len(index) == 0:
        return np.zeros(0)
    low, high, low_value, high_value = grid[index], grid[index + 1], value[index], value[index + 1]
    root, last = low, high
    before = np.zeros(len(index), dtype=np.int_)
    for _ in range(STEPS):
        root = (low * high_value - high * low_value) / (high_value - low_value)
        found = evaluate(root)
        left = np.sign(found) == np.sign(low_value)
        side = np.where(left, 1, -1)
        kept = np.where(side == before, 0.5, 1.0)
        low_value, high_value = np.where(left, found, kept * low_value), np.where(left, kept * high_value, found)
        low, high = np.where(left, root, low), np.where(left, high, root)
        if (np.abs(root - last) <= 1e-13).all():
            break
        last, before = root, side
    return np.asarray(root)
