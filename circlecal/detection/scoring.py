"""How much of an ellipse is drawn on the field: lookup of ellipse points in a raster of oriented ridge points."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.hypotheses import EllipseBatch
from circlecal.detection.ridges import RidgePoints
from circlecal.geometry.projective import Array

__all__ = ["RidgeRaster", "Support", "best_distinct", "ellipse_points", "ranked", "refitted", "support_of"]

_NOTHING, _OFF_FIELD = -1, -2
_ALIGNED = float(np.cos(np.deg2rad(15.0)))
_ALIKE, _SAME = 0.12, 0.03  # hypotheses, fitted ellipses: shares of the half axes
_COARSE_ANGLES, _FINE_ANGLES, _REFIT_ANGLES = 48, 160, 120

Picture = NDArray[np.float32]


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
        cells = inside.view(np.int8) + np.int8(_OFF_FIELD)  # one more is _NOTHING
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

    def lookup(self, x: Picture, y: Picture) -> NDArray[np.int32]:
        """Ridge index at or beside each place (...); negative where there is none."""
        column = np.clip(np.rint(x), -1, self.width).astype(np.int32) + 1
        row = np.clip(np.rint(y), -1, self.height).astype(np.int32) + 1
        return np.asarray(self._flat[row * self._stride + column], np.int32)

    def aligned(self, index: NDArray[np.int32], nx: Picture, ny: Picture) -> NDArray[np.bool_]:
        """Whether the ridge points (...) run along the curve with these normals (any length)."""
        where = np.maximum(index, _NOTHING)  # -1: the empty entry
        dot = self._nx[where] * nx + self._ny[where] * ny
        return np.asarray(dot * dot > np.float32(_ALIGNED**2) * (nx * nx + ny * ny), np.bool_)


@dataclass(frozen=True, slots=True)
class Support:
    """Shares (M,) of ellipses: of the whole, of the part in the field; and the score made of them."""

    whole: Array
    field: Array
    score: Array


def ellipse_points(batch: EllipseBatch, count: int) -> tuple[Picture, Picture, Picture, Picture]:
    """x, y of points at equal eccentric angles and x, y of their normals (any length), each (M, count) float32."""
    angle = np.arange(count) * (2 * np.pi / count)
    turn = np.array([np.cos(angle), np.sin(angle)], np.float32)
    tangent = np.array([-turn[1], turn[0]])
    axes = np.array([batch.great.T, batch.small.T], np.float32)  # (axis, x or y, ellipse)
    center = batch.centers.T.astype(np.float32)[..., None]
    x, y = (center[k] + axes[:, k].T @ turn for k in (0, 1))
    return x, y, axes[:, 1].T @ tangent, -(axes[:, 0].T @ tangent)


def support_of(batch: EllipseBatch, raster: RidgeRaster, count: int = _FINE_ANGLES) -> Support:
    """Share of each ellipse that lies on ridge points of the same direction."""
    x, y, nx, ny = ellipse_points(batch, count)
    index = raster.lookup(x, y)
    supported = np.count_nonzero(raster.aligned(index, nx, ny), axis=1)
    in_field = np.count_nonzero(index != _OFF_FIELD, axis=1)
    whole = supported / count
    field = supported / np.maximum(in_field, 1)
    size = np.sqrt(np.minimum(1.0, batch.great_lengths / (0.1 * raster.width)))
    return Support(whole, field, whole * np.sqrt(field) * size)


def best_distinct(batch: EllipseBatch, raster: RidgeRaster, count: int) -> EllipseBatch:
    """The best ``count`` ellipses, best first, no two of them nearly the same."""
    coarse = support_of(batch, raster, _COARSE_ANGLES).score
    batch = batch.take(np.argsort(-coarse)[: 8 * count])
    fine = support_of(batch, raster).score
    batch = batch.take(np.argsort(-fine))
    return batch.take(_distinct(batch, count, _ALIKE))


def ranked(batch: EllipseBatch, raster: RidgeRaster) -> EllipseBatch:
    """The ellipses in the order of their scores, without those that have become nearly the same."""
    batch = batch.take(np.argsort(-support_of(batch, raster).score))
    return batch.take(_distinct(batch, len(batch), _SAME))


def _distinct(batch: EllipseBatch, count: int, tolerance: float) -> NDArray[np.int64]:
    """Greedy choice; ellipses whose centres and half axes differ by little more than this share are the same."""
    shape = np.column_stack([batch.centers, batch.great_lengths, batch.small_lengths])
    scale = tolerance * np.column_stack([batch.great_lengths, batch.small_lengths] * 2) + 1.0
    alike = (np.abs(shape[:, None] - shape[None]) / scale[:, None]).max(axis=-1) <= 1.0
    chosen: list[int] = []
    free = np.ones(len(batch), np.bool_)
    while len(chosen) < count and free.any():
        best = int(np.argmax(free))
        chosen.append(best)
        free &= ~alike[best]
    return np.array(chosen, np.int64)


def refitted(batch: EllipseBatch, raster: RidgeRaster, reaches_px: tuple[float, ...]) -> EllipseBatch:
    """Fit each ellipse again to the aligned ridge points near it, nearer in each round.

    Parameters
    ----------
    batch : EllipseBatch
    raster : RidgeRaster
    reaches_px : tuple of float
        How far from the curve points are looked for, one entry per round.

    Returns
    -------
    EllipseBatch
        As many as before; one that does not become an ellipse stays as it was.
    """
    for reach in reaches_px:
        x, y, nx, ny = ellipse_points(batch, _REFIT_ANGLES)
        length = np.hypot(nx, ny)
        nx /= length
        ny /= length
        steps = np.arange(-reach, reach + 0.5, 2.0, dtype=np.float32) if reach > 1.5 else np.zeros(1, np.float32)
        index = raster.lookup(x[..., None] + steps * nx[..., None], y[..., None] + steps * ny[..., None])
        aligned = raster.aligned(index, nx[..., None], ny[..., None])
        found = raster.ridges.points[np.maximum(index, 0)]
        distance = (found[..., 0] - x[..., None]) * nx[..., None] + (found[..., 1] - y[..., None]) * ny[..., None]
        weight = (aligned & (np.abs(distance) <= reach)).astype(np.float64)
        batch = adjusted(batch, found.reshape(len(batch), -1, 2), weight.reshape(len(batch), -1))
    return batch


def adjusted(batch: EllipseBatch, points: Array, weight: Array) -> EllipseBatch:
    """One weighted step of each ellipse towards its points.

    In the frame where the ellipse is the unit circle, the conic
    ``x^2 + y^2 - 1 + d . (x^2 + y^2, x^2 - y^2, 2 x y, x, y) = 0`` is fitted by least squares with residuals divided
    by their gradient in pixels (Sampson 1982), five unknowns each.

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
    return _accepted_step(batch, frame, d, (weight > 0).sum(axis=-1))


def _accepted_step(batch: EllipseBatch, frame: Array, d: Array, count: NDArray[np.int64]) -> EllipseBatch:
    """The moved ellipses; those with too few points or too large a step stay."""
    xx, yy, xy = 1 + d[:, 0] + d[:, 1], 1 + d[:, 0] - d[:, 1], d[:, 2]
    form = np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)
    values, vectors = np.linalg.eigh(form)
    good = (values[:, 0] > 0.05) & (count >= 8) & (np.abs(d) < 0.9).all(axis=-1)
    form = np.where(good[:, None, None], form, np.eye(2))
    values = np.where(good[:, None], values, 1.0)
    shift = -np.linalg.solve(form, d[:, 3:, None] / 2)[..., 0]
    level = 1 + (shift[:, None] @ form @ shift[:, :, None])[:, 0, 0]
    axes = frame @ (vectors * np.sqrt(level[:, None] / values)[:, None, :])
    great, small = principal_axes(axes)
    centers = batch.centers + (frame @ shift[:, :, None])[..., 0]
    keep = good[:, None]
    return EllipseBatch(
        np.where(keep, centers, batch.centers), np.where(keep, great, batch.great), np.where(keep, small, batch.small)
    )


def principal_axes(frame: Array) -> tuple[Array, Array]:
    """Great and small half-axis vectors (M, 2) of the images of the unit circle under linear maps (M, 2, 2)."""
    left, sizes, _ = np.linalg.svd(frame)
    axes = left * sizes[:, None, :]
    return axes[..., 0], axes[..., 1]
