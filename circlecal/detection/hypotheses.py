"""Circle hypotheses: conics through two points with their tangents and a third point, many at once.

The conics that touch line ``l1`` in ``p1`` and line ``l2`` in ``p2`` form the pencil
``l1 l2^T + l2 l1^T + 2 mu l12 l12^T`` with the join ``l12`` (conics in double contact; Semple and Kneebone 1952,
*Algebraic Projective Geometry*); a third point fixes ``mu``. Three ridge points with their normals overdetermine the
conic by one: the third tangent is the check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.options import HypothesisConfig
from circlecal.detection.ridges import RidgePoints
from circlecal.geometry.projective import Array

__all__ = ["EllipseBatch", "conics_from_tangents", "draw_ellipses", "ellipses_from_coefficients", "pencil_parameter"]

_CELL = 0.05  # picture widths: size of the cells from which near points are drawn
Rows = NDArray[np.floating[Any]]


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


def pencil_parameter(points: Rows, normals: Rows) -> tuple[Rows, Rows]:
    """Parameter ``mu`` of each hypothesis and how well the third tangent agrees.

    Parameters
    ----------
    points, normals : (2, 3, M) array
        x and y of three points of each hypothesis and of their unit normals; any unit, near the origin for accuracy.

    Returns
    -------
    mu : (M,) array
    agreement : (M,) array
        |cosine| between the conic's normal in the third point and the third normal; 0 where undefined.
    """
    (x1, x2, x3), (y1, y2, y3) = points
    (a1, a2, a3), (b1, b2, b3) = normals
    v1 = a1 * (x3 - x1) + b1 * (y3 - y1)
    v2 = a2 * (x3 - x2) + b2 * (y3 - y2)
    a, b = y1 - y2, x2 - x1  # join of the first two points
    v = a * (x3 - x1) + b * (y3 - y1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mu = -(v1 * v2) / (v * v)
        gx = a1 * v2 + a2 * v1 + 2 * mu * a * v
        gy = b1 * v2 + b2 * v1 + 2 * mu * b * v
        agreement = np.abs(gx * a3 + gy * b3) / np.sqrt(gx * gx + gy * gy)
    return mu, np.nan_to_num(agreement)


def conics_from_tangents(points: Rows, normals: Rows, mu: Rows) -> Rows:
    """Conics of the pencils of :func:`pencil_parameter`: coefficients (M, 6) of ``x^2, xy, y^2, x, y, 1``."""
    (x1, x2, _), (y1, y2, _) = points
    (a1, a2, _), (b1, b2, _) = normals
    c1, c2 = -(a1 * x1 + b1 * y1), -(a2 * x2 + b2 * y2)
    a, b = y1 - y2, x2 - x1
    c = -(a * x1 + b * y1)
    return np.stack(
        [
            a1 * a2 + mu * a * a,
            a1 * b2 + a2 * b1 + 2 * mu * a * b,
            b1 * b2 + mu * b * b,
            a1 * c2 + a2 * c1 + 2 * mu * a * c,
            b1 * c2 + b2 * c1 + 2 * mu * b * c,
            c1 * c2 + mu * c * c,
        ],
        axis=-1,
    )


def ellipses_from_coefficients(coefficients: Rows) -> tuple[EllipseBatch, NDArray[np.bool_]]:
    """Centre and half axes of conics (M, 6), and which of them are real ellipses.

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


def draw_ellipses(
    ridges: RidgePoints,
    usable: NDArray[np.bool_],
    size: tuple[int, int],
    config: HypothesisConfig,
    rng: np.random.Generator,
    near: bool = False,
) -> EllipseBatch:
    """Draw random triples of usable ridge points and keep the plausible ellipses.

    Parameters
    ----------
    ridges : RidgePoints
    usable : (N,) bool
        False for points that may not be drawn (on long straight lines).
    size : (int, int)
        Width and height of the picture of the ridge points.
    config : HypothesisConfig
    rng : numpy.random.Generator
    near : bool
        Whether the points of a triple lie near each other: short arcs hold few of all points.

    Returns
    -------
    EllipseBatch
        At most ``config.scored`` of them, in pixels.
    """
    index = np.flatnonzero(usable)
    if len(index) < 6:
        return EllipseBatch(*(np.zeros((0, 2)),) * 3)
    width, height = size
    unit = width / 2.0
    origin = np.array([(width - 1) / 2, (height - 1) / 2])
    triples = (_near_triples if near else _weighted_triples)(ridges, index, width, config, rng)
    rows = np.concatenate([(ridges.points - origin) / unit, ridges.normals], axis=1).astype(np.float32)
    drawn = np.ascontiguousarray(np.moveaxis(rows[triples], -1, 0))
    mu, agreement = pencil_parameter(drawn[:2], drawn[2:])
    good = np.flatnonzero(agreement >= np.cos(np.deg2rad(config.tangent_tolerance_deg)))
    kept = drawn[..., good].astype(np.float64)
    coefficients = conics_from_tangents(kept[:2], kept[2:], mu[good].astype(np.float64))
    batch, _ = ellipses_from_coefficients(coefficients)
    batch = EllipseBatch(batch.centers * unit + origin, batch.great * unit, batch.small * unit)
    batch = batch.take(_plausible(batch, size, config))
    if len(batch) > config.scored:
        batch = batch.take(rng.choice(len(batch), config.scored, replace=False))
    return batch


def _weighted_triples(
    ridges: RidgePoints, index: NDArray[np.int64], width: int, config: HypothesisConfig, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Triples of point indices (3, draws); a point on a long chain comes up to eight times as often."""
    longest = max(8.0, config.chain_weight_px1280 * width / 1280.0)
    weight = np.ceil(8.0 * np.minimum(ridges.chain[index], longest) / longest).astype(np.int64)
    urn = np.repeat(index, weight)
    return np.asarray(urn[rng.integers(0, len(urn), (3, config.draws))], np.int64)


def _near_triples(
    ridges: RidgePoints, index: NDArray[np.int64], width: int, config: HypothesisConfig, rng: np.random.Generator
) -> NDArray[np.int64]:
    """The same with the second and third point from the first one's cell of a grid, or from one of those around it."""
    x, y = (ridges.points[index] // (_CELL * width)).astype(np.int64).T + 1
    columns = int(x.max()) + 2
    cell = y * columns + x
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange((int(y.max()) + 2) * columns + 1))
    drawn = rng.integers(0, len(index), config.draws)
    aside = rng.integers(-1, 2, (2, 2, config.draws))
    there = cell[drawn] + aside[0] * columns + aside[1]
    count = first[there + 1] - first[there]
    picked = order[np.minimum(first[there] + (rng.random(there.shape) * count).astype(np.int64), len(order) - 1)]
    # two points that are the same make no conic
    return np.asarray(index[np.vstack([drawn, np.where(count > 0, picked, drawn)])], np.int64)


def _plausible(batch: EllipseBatch, size: tuple[int, int], config: HypothesisConfig) -> NDArray[np.bool_]:
    """True (M,) where size, shape, tilt and place are those of a circle on the ground."""
    width, height = size
    great, small = batch.great_lengths, batch.small_lengths
    ratio = small / great
    level = np.abs(batch.great[:, 1]) <= np.sin(np.deg2rad(config.tilt_deg)) * great
    margin = config.centre_margin * width
    x, y = batch.centers[:, 0], batch.centers[:, 1]
    return np.asarray(
        (great >= config.half_axis[0] * width)
        & (great <= config.half_axis[1] * width)
        & (ratio >= config.axis_ratio[0])
        & (ratio <= config.axis_ratio[1])
        & (level | (ratio >= config.round_ratio))
        & (x >= -margin)
        & (x <= width - 1 + margin)
        & (y >= -margin)
        & (y <= height - 1 + margin)
    )
