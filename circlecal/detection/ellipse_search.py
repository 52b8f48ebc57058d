"""Circle hypotheses: ellipses through ridge points, drawn at random, scored by how much of each is drawn on the field,
and the best fitted again.

An ellipse is drawn from two points with their tangents and a third point. The conics that touch line ``l1`` in ``p1``
and line ``l2`` in ``p2`` form the pencil ``C(mu) = l1 l2^T + l2 l1^T + 2 mu l12 l12^T`` with the join ``l12`` (conics
in double contact; Semple and Kneebone 1952, *Algebraic Projective Geometry*); ``p3^T C(mu) p3 = 0`` fixes ``mu``. Three
ridge points with their normals overdetermine the conic by one: the third tangent is the check.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.ellipse_batch import (
    EllipseBatch,
    Rows,
    adjust_ellipses,
    convert_coefficients,
    ellipse_points,
)
from circlecal.detection.ridges import OFF_FIELD, RidgePoints, RidgeRaster
from circlecal.geometry.projective import Array

__all__ = [
    "EllipseSearch",
    "Support",
    "conics_from_tangents",
    "draw_ellipses",
    "find_pencil_parameter",
    "measure_support",
    "refit_ellipses",
    "search_ellipses",
    "select_best",
]

TANGENT_TOLERANCE_DEG = 12.0
"""Agreement of the third point's tangent, degrees: ridge normals of thin markings are uncertain by some degrees. In a
study of 42 broadcast frames directions mattered here and in the refit, hardly in the score."""
CHAIN_WEIGHT_PX = 90.0
"""A point comes up the more often the longer its chain is, up to this length, pixels at 1920 px width. Drawn evenly, 79
of 84 runs of the same study found the circle, weighted 82: streaks and blades of grass make short chains.
"""
URN_TICKETS = 8
"""How often a point on a long chain is in the urn; one on a short chain is there once."""
ROUND_RATIO = 0.6
"""Ratio of the axes from which on any tilt is allowed: the tilt of what is nearly round is measured badly."""
CENTRE_MARGIN = 0.15
"""How far outside the picture the centre may lie, picture widths: less than half of such a circle is seen."""
NEAR_CELL = 0.05
"""Size of the cells from which points near each other are drawn, picture widths: a short arc fills a few of them."""
SAME_HYPOTHESIS, SAME_ELLIPSE = 0.12, 0.03
"""Shares of the half axes within which two ellipses are the same: as drawn, and after they were fitted to their points.
"""
USUAL_HALF_AXIS = 0.1
"""Great half axis, picture widths, below which the score falls: small ellipses are more easily stitched by chance."""
COARSE_ANGLES, FINE_ANGLES, REFIT_ANGLES = 48, 160, 120
"""Points along an ellipse: for a first score of all, for the score of the best, for finding the points near it."""
FINELY_SCORED = 8
"""How many times as many as are kept are scored finely."""
REFIT_REACHES_PX = 7.5, 3.0
"""How far from the curve its points are looked for in each round of the refit, pixels at 1920 px width."""
LEAST_REACH_PX = 1.2
"""Pixels of the searched picture below which a round would miss the points beside its pixel."""


@dataclass(frozen=True, slots=True)
class EllipseSearch:
    """How many ellipses are drawn, and which of them may be circles on the ground.

    Attributes
    ----------
    draws, scored, kept : int
        Random triples; most plausible ellipses that are scored; distinct best ones that are fitted again.
    half_axis : (float, float)
        Smallest and largest great half axis, in picture widths.
    axis_ratio : (float, float)
        Smallest and largest ratio of the axes.
    tilt_deg : float
        Largest tilt of the great axis, unless nearly round.
    """

    draws: int
    scored: int
    kept: int
    half_axis: tuple[float, float]
    axis_ratio: tuple[float, float]
    tilt_deg: float


def find_pencil_parameter(points: Rows, normals: Rows) -> tuple[Rows, Rows]:
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
    v1 = a1 * (x3 - x1) + b1 * (y3 - y1)  # l1 . p3
    v2 = a2 * (x3 - x2) + b2 * (y3 - y2)  # l2 . p3
    a, b = y1 - y2, x2 - x1  # join of the first two points
    v = a * (x3 - x1) + b * (y3 - y1)  # l12 . p3
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mu = -(v1 * v2) / (v * v)  # p3^T C(mu) p3 = 2 (l1 . p3) (l2 . p3) + 2 mu (l12 . p3)^2 = 0
        # the conic's tangent in p3 is C p3 = l1 (l2 . p3) + l2 (l1 . p3) + 2 mu l12 (l12 . p3)
        gx = a1 * v2 + a2 * v1 + 2 * mu * a * v
        gy = b1 * v2 + b2 * v1 + 2 * mu * b * v
        agreement = np.abs(gx * a3 + gy * b3) / np.sqrt(gx * gx + gy * gy)
    return mu, np.nan_to_num(agreement)


def conics_from_tangents(points: Rows, normals: Rows, mu: Rows) -> Rows:
    """Conics of the pencils of :func:`find_pencil_parameter`: coefficients (M, 6) of ``x^2, xy, y^2, x, y, 1``."""
    (x1, x2, _), (y1, y2, _) = points
    (a1, a2, _), (b1, b2, _) = normals
    c1, c2 = -(a1 * x1 + b1 * y1), -(a2 * x2 + b2 * y2)
    a, b = y1 - y2, x2 - x1
    c = -(a * x1 + b * y1)
    return np.stack(
        [  # entries of C(mu) / 2, those off the diagonal twice
            a1 * a2 + mu * a * a,
            a1 * b2 + a2 * b1 + 2 * mu * a * b,
            b1 * b2 + mu * b * b,
            a1 * c2 + a2 * c1 + 2 * mu * a * c,
            b1 * c2 + b2 * c1 + 2 * mu * b * c,
            c1 * c2 + mu * c * c,
        ],
        axis=-1,
    )


def draw_ellipses(
    ridges: RidgePoints,
    usable: NDArray[np.bool_],
    size: tuple[int, int],
    search: EllipseSearch,
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
    search : EllipseSearch
    rng : numpy.random.Generator
    near : bool
        Whether the points of a triple lie near each other: short arcs hold few of all points.

    Returns
    -------
    EllipseBatch
        At most ``search.scored`` of them, in pixels.
    """
    index = np.flatnonzero(usable)
    if len(index) < 6:
        return EllipseBatch(*(np.zeros((0, 2)),) * 3)
    width, height = size
    unit = width / 2.0
    origin = np.array([(width - 1) / 2, (height - 1) / 2])
    triples = (_draw_near_triples if near else _draw_triples)(ridges, index, width, search.draws, rng)
    rows = np.concatenate([((ridges.points - origin) / unit).T, ridges.normals.T]).astype(np.float32)
    drawn = rows.take(triples, axis=1)
    mu, agreement = find_pencil_parameter(drawn[:2], drawn[2:])
    good = np.flatnonzero(agreement >= np.cos(np.deg2rad(TANGENT_TOLERANCE_DEG)))
    kept = drawn[..., good].astype(np.float64)
    batch, _ = convert_coefficients(conics_from_tangents(kept[:2], kept[2:], mu[good].astype(np.float64)))
    batch = EllipseBatch(batch.centers * unit + origin, batch.great * unit, batch.small * unit)
    batch = batch.take(_are_plausible(batch, size, search))
    if len(batch) > search.scored:
        batch = batch.take(rng.choice(len(batch), search.scored, replace=False))
    return batch


def _draw_triples(
    ridges: RidgePoints, index: NDArray[np.int64], width: int, draws: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Triples of point indices (3, draws); a point on a long chain comes up more often than one on a short one."""
    longest = max(float(URN_TICKETS), CHAIN_WEIGHT_PX * width / 1920.0)
    weight = np.ceil(URN_TICKETS * np.minimum(ridges.chain[index], longest) / longest).astype(np.int64)
    urn = np.repeat(index, weight)
    return np.asarray(urn[rng.integers(0, len(urn), (3, draws))], np.int64)


def _draw_near_triples(
    ridges: RidgePoints, index: NDArray[np.int64], width: int, draws: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Triples of point indices (3, draws), the second and third point from the first one's cell of a grid, or from one
    of the cells around it.
    """
    x, y = (ridges.points[index] // (NEAR_CELL * width)).astype(np.int64).T + 1
    columns = int(x.max()) + 2
    cell = y * columns + x
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange((int(y.max()) + 2) * columns + 1))
    drawn = rng.integers(0, len(index), draws)
    aside = rng.integers(-1, 2, (2, 2, draws))
    there = cell[drawn] + aside[0] * columns + aside[1]
    count = first[there + 1] - first[there]
    picked = order[np.minimum(first[there] + (rng.random(there.shape) * count).astype(np.int64), len(order) - 1)]
    # two points that are the same make no conic
    return np.asarray(index[np.vstack([drawn, np.where(count > 0, picked, drawn)])], np.int64)


def _are_plausible(batch: EllipseBatch, size: tuple[int, int], search: EllipseSearch) -> NDArray[np.bool_]:
    """True (M,) where size, shape, tilt and place are those of a circle on the ground."""
    width, height = size
    great, small = batch.great_lengths, batch.small_lengths
    ratio = small / great
    level = np.abs(batch.great[:, 1]) <= np.sin(np.deg2rad(search.tilt_deg)) * great
    margin = CENTRE_MARGIN * width
    x, y = batch.centers[:, 0], batch.centers[:, 1]
    return np.asarray(
        (great >= search.half_axis[0] * width)
        & (great <= search.half_axis[1] * width)
        & (ratio >= search.axis_ratio[0])
        & (ratio <= search.axis_ratio[1])
        & (level | (ratio >= ROUND_RATIO))
        & (x >= -margin)
        & (x <= width - 1 + margin)
        & (y >= -margin)
        & (y <= height - 1 + margin)
    )


@dataclass(frozen=True, slots=True)
class Support:
    """Shares (M,) of ellipses: of the whole, of the part in the field; and the score made of them."""

    whole: Array
    field: Array
    score: Array


def measure_support(batch: EllipseBatch, raster: RidgeRaster, count: int = FINE_ANGLES) -> Support:
    """Share of each ellipse that lies on ridge points of its direction.

    The score is ``whole * sqrt(field) * min(1, sqrt(a / a0))`` with the great half axis ``a`` and its usual size
    ``a0``: the drawn share of the whole ellipse (a penalty arc has at most 0.35 of it) counts more than that of the
    part in the field, which a short arc fills as well.
    """
    x, y, nx, ny = ellipse_points(batch, count)
    index = raster.lookup(x, y)
    supported = np.count_nonzero(raster.is_aligned(index, nx, ny), axis=1)
    in_field = np.count_nonzero(index != OFF_FIELD, axis=1)
    whole = supported / count
    field = supported / np.maximum(in_field, 1)
    size = np.sqrt(np.minimum(1.0, batch.great_lengths / (USUAL_HALF_AXIS * raster.width)))
    return Support(whole, field, whole * np.sqrt(field) * size)


def select_best(batch: EllipseBatch, raster: RidgeRaster, count: int) -> EllipseBatch:
    """The best ``count`` ellipses, best first, no two of them nearly the same."""
    coarse = measure_support(batch, raster, COARSE_ANGLES).score
    batch = batch.take(np.argsort(-coarse)[: FINELY_SCORED * count])
    fine = measure_support(batch, raster).score
    batch = batch.take(np.argsort(-fine))
    return batch.take(_find_distinct(batch, count, SAME_HYPOTHESIS))


def _find_distinct(batch: EllipseBatch, count: int, tolerance: float) -> NDArray[np.int64]:
    """Greedy choice; ellipses whose centres and half axes differ by little more than this share are the same."""
    shape = np.column_stack([batch.centers, batch.great_lengths, batch.small_lengths])
    scale = tolerance * np.column_stack([batch.great_lengths, batch.small_lengths] * 2) + 1.0
    chosen: list[int] = []
    free = np.ones(len(batch), np.bool_)
    while len(chosen) < count and free.any():
        best = int(np.argmax(free))
        chosen.append(best)
        free &= (np.abs(shape[best] - shape) / scale[best]).max(axis=-1) > 1.0
    return np.array(chosen, np.int64)


def refit_ellipses(batch: EllipseBatch, raster: RidgeRaster, reaches_px: tuple[float, ...]) -> EllipseBatch:
    """Fit each ellipse again to the aligned ridge points near it, nearer in each round.

    Parameters
    ----------
    batch : EllipseBatch
    raster : RidgeRaster
    reaches_px : tuple of float
        How far from the curve points are looked for, one entry per round, in pixels of the raster.

    Returns
    -------
    EllipseBatch
        As many as before; one that does not become an ellipse stays as it was.
    """
    for reach in reaches_px:
        x, y, nx, ny = ellipse_points(batch, REFIT_ANGLES)
        length = np.hypot(nx, ny)
        nx /= length
        ny /= length
        steps = np.arange(-reach, reach + 0.5, 2.0, dtype=np.float32) if reach > 1.5 else np.zeros(1, np.float32)
        index = raster.lookup(x[..., None] + steps * nx[..., None], y[..., None] + steps * ny[..., None])
        aligned = raster.is_aligned(index, nx[..., None], ny[..., None])
        found = raster.ridges.points[np.maximum(index, 0)]
        distance = (found[..., 0] - x[..., None]) * nx[..., None] + (found[..., 1] - y[..., None]) * ny[..., None]
        weight = (aligned & (np.abs(distance) <= reach)).astype(np.float64)
        batch = adjust_ellipses(batch, found.reshape(len(batch), -1, 2), weight.reshape(len(batch), -1))
    return batch


def search_ellipses(
    ridges: RidgePoints,
    usable: NDArray[np.bool_],
    raster: RidgeRaster,
    search: EllipseSearch,
    rng: np.random.Generator,
    near: bool = False,
) -> EllipseBatch:
    """Draw ellipses through usable ridge points, and fit the best distinct ones to those of ``raster``, best first.

    Parameters are those of :func:`draw_ellipses`; the batch may be empty.
    """
    batch = draw_ellipses(ridges, usable, (raster.width, raster.height), search, rng, near)
    if len(batch) == 0:
        return batch
    batch = select_best(batch, raster, search.kept)
    reaches = tuple(max(LEAST_REACH_PX, reach * raster.width / 1920.0) for reach in REFIT_REACHES_PX)
    batch = refit_ellipses(batch, raster, reaches)
    batch = batch.take(np.argsort(-measure_support(batch, raster).score))
    return batch.take(_find_distinct(batch, len(batch), SAME_ELLIPSE))
