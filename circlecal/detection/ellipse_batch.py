"""Ellipses as arrays, many at once: from conics, points along them, and one step of a fit to points near each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.conics import transform_conic
from circlecal.geometry.projective import Array

__all__ = [
    "EllipseBatch",
    "adjust_ellipses",
    "convert_coefficients",
    "ellipse_conic",
    "ellipse_points",
    "unit_frame",
]

FEWEST_POINTS = 8
"""Points that move an ellipse; five fix it."""
LARGEST_STEP = 0.9
"""Largest change of a coefficient in one step, where the ellipse is the unit circle: beyond, its points are others'."""
FLATTEST_STEP = 0.05
"""Smallest eigenvalue of the moved form, the unit circle's being 1: below, the points ask for a hyperbola."""
_UNIT_CIRCLE = np.diag([1.0, 1.0, -1.0])

Rows = NDArray[np.floating[Any]]
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class EllipseBatch:
    """Many ellipses: centre (M, 2), great and small half-axis vectors (M, 2) each."""

    centers: Array
    great: Array
    small: Array

    def __len__(self) -> int:
        return len(self.centers)

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> EllipseBatch:
        """The ellipses at these indices, or where the mask is true."""
        return EllipseBatch(self.centers[index], self.great[index], self.small[index])

    @property
    def great_lengths(self) -> Array:
        """Great half axes (M,)."""
        return np.hypot(self.great[:, 0], self.great[:, 1])

    @property
    def small_lengths(self) -> Array:
        """Small half axes (M,)."""
        return np.hypot(self.small[:, 0], self.small[:, 1])


def unit_frame(ellipse: EllipseBatch) -> Array:
    """Affinity (3, 3) from the frame in which the first ellipse of a batch is the unit circle to the picture."""
    frame = np.eye(3)
    frame[:2, 0], frame[:2, 1], frame[:2, 2] = ellipse.great[0], ellipse.small[0], ellipse.centers[0]
    return frame


def ellipse_conic(ellipse: EllipseBatch) -> Array:
    """Normalised conic (3, 3) of the first ellipse of a batch."""
    return transform_conic(unit_frame(ellipse), _UNIT_CIRCLE)


def convert_coefficients(coefficients: Rows) -> tuple[EllipseBatch, NDArray[np.bool_]]:
    """Centre and half axes of conics (M, 6), and which of them are real ellipses.

    The centre is where the gradient of ``a x^2 + b x y + c y^2 + d x + e y + f`` vanishes; the half axes squared are
    minus its value there over the eigenvalues of ``[[a, b / 2], [b / 2, c]]``.

    Returns
    -------
    batch : EllipseBatch
        The real ellipses only, in order.
    real : (M,) bool
    """
    a, b, c, d, e, f = np.moveaxis(coefficients, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        minor = 4 * a * c - b * b
        x = (b * e - 2 * c * d) / minor
        y = (b * d - 2 * a * e) / minor
        level = -(f + (d * x + e * y) / 2)
        mean, half = (a + c) / 2, (a - c) / 2
        root = np.sqrt(half * half + b * b / 4)
        sign = np.sign(mean)
        great = level * sign / (np.abs(mean) - root)
        small = level * sign / (np.abs(mean) + root)
        real = (minor > 0) & (great > 0) & (small > 0) & np.isfinite(great)
    a, b, c, x, y, great, small, half, sign = (v[real] for v in (a, b, c, x, y, great, small, half, sign))
    angle = np.arctan2(b * sign, 2 * half * sign) / 2 + np.pi / 2  # direction of the smaller eigenvalue: the great axis
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = np.stack([-axis[:, 1], axis[:, 0]], axis=-1)
    centers = np.stack([x, y], axis=-1)
    return EllipseBatch(centers, axis * np.sqrt(great)[:, None], across * np.sqrt(small)[:, None]), real


def ellipse_points(batch: EllipseBatch, count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """x, y of points at equal eccentric angles and x, y of their normals (any length), each (M, count) float32."""
    angle = np.arange(count) * (2 * np.pi / count)
    turn = np.array([np.cos(angle), np.sin(angle)], np.float32)
    tangent = np.array([-turn[1], turn[0]])
    axes = np.array([batch.great.T, batch.small.T], np.float32)  # (axis, x or y, ellipse)
    center = batch.centers.T.astype(np.float32)[..., None]
    x, y = (center[k] + axes[:, k].T @ turn for k in (0, 1))
    return x, y, axes[:, 1].T @ tangent, -(axes[:, 0].T @ tangent)


def adjust_ellipses(batch: EllipseBatch, points: Array, weight: Array) -> EllipseBatch:
    """One weighted step of each ellipse towards its points.

    In the frame where the ellipse is the unit circle, the conic
    ``x^2 + y^2 - 1 + d . (x^2 + y^2, x^2 - y^2, 2 x y, x, y) = 0`` is fitted by least squares with residuals divided
    by their gradient in pixels (Sampson 1982, *Fitting conic sections to very scattered data*), five unknowns each.

    Parameters
    ----------
    batch : EllipseBatch
        M ellipses.
    points : (M, K, 2) array
    weight : (M, K) array
        Zero for points that do not count.

    Returns
    -------
    EllipseBatch
        An ellipse with too few points, or with too large a step, stays as it was.
    """
    frame = np.stack([batch.great, batch.small], axis=-1)
    inverse = np.linalg.inv(frame)
    local = (points - batch.centers[:, None]) @ np.swapaxes(inverse, -1, -2)
    x, y = local[..., 0], local[..., 1]
    gradient = 2 * local @ inverse
    scale = np.sqrt(weight) / np.maximum(np.hypot(gradient[..., 0], gradient[..., 1]), 1e-12)
    square = x * x + y * y
    design = np.stack([square, x * x - y * y, 2 * x * y, x, y], axis=-1) * scale[..., None]
    residual = (square - 1) * scale
    transposed = np.swapaxes(design, -1, -2)
    normal = transposed @ design
    damping = 1e-6 * np.trace(normal, axis1=-2, axis2=-1)[:, None, None] + 1e-9
    d = -np.linalg.solve(normal + damping * np.eye(5), (transposed @ residual[..., None]))[..., 0]
    return _apply_step(batch, frame, d, (weight > 0).sum(axis=-1))


def _apply_step(batch: EllipseBatch, frame: Array, d: Array, count: NDArray[np.int64]) -> EllipseBatch:
    """The conic of each step as an ellipse again: ``form`` about its own centre ``shift``, scaled by ``level``."""
    xx, yy, xy = 1 + d[:, 0] + d[:, 1], 1 + d[:, 0] - d[:, 1], d[:, 2]
    form = np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)
    values, vectors = np.linalg.eigh(form)
    good = (values[:, 0] > FLATTEST_STEP) & (count >= FEWEST_POINTS) & (np.abs(d) < LARGEST_STEP).all(axis=-1)
    form = np.where(good[:, None, None], form, np.eye(2))
    values = np.where(good[:, None], values, 1.0)
    shift = -np.linalg.solve(form, d[:, 3:, None] / 2)[..., 0]
    level = 1 + (shift[:, None] @ form @ shift[:, :, None])[:, 0, 0]
    axes = frame @ (vectors * np.sqrt(level[:, None] / values)[:, None, :])
    left, sizes, _ = np.linalg.svd(axes)  # principal axes of the image of the unit circle
    great, small = np.moveaxis(left * sizes[:, None, :], -1, 0)
    centers = batch.centers + (frame @ shift[:, :, None])[..., 0]
    keep = good[:, None]
    return EllipseBatch(
        np.where(keep, centers, batch.centers), np.where(keep, great, batch.great), np.where(keep, small, batch.small)
    )
