"""Robust conic: RANSAC over batched minimal conics with local refits.

Sources: Fischler and Bolles 1981 (RANSAC); Torr and Zisserman 2000 (MSAC score); Chum, Matas and Kittler 2003 (local
optimisation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from circlecal.geometry.conic_fits import conics_through_points, fit_conics
from circlecal.geometry.conics import coefficients_from_conic, is_ellipse, normalise_conic, sampson_distance
from circlecal.geometry.projective import Array, similarity_normalisation

BLOCK = 128
"""Hypotheses that are scored together."""
MOSTLY_EXPLAINED = 0.8
"""Above this share of inliers only samples that are better before any refit are followed (Chum, Matas and Kittler)."""
NEARLY_ALL = 0.95
"""Share of inliers above which a conic is taken as it is: no sample and no refit can gain more than noise."""
FIRST_BATCH = 48
"""Hypotheses before the first look at the share of inliers."""
SAFETY = 3.0
"""Samples without outliers that are wanted: noise makes many of them poor."""
MOST_REFITS = 4
"""Hypotheses of each batch, those that explain most, that are refitted locally."""
LOCAL_ROUNDS = 4
"""Refits of each kept hypothesis to its own inliers."""


@dataclass(frozen=True, slots=True)
class RobustConic:
    """Conic (3, 3), the inliers (N,) of exactly this conic, its MSAC cost per point, and the hypotheses drawn."""

    conic: Array
    inliers: NDArray[np.bool_]
    cost: float
    hypotheses: int


def msac_costs(conics: ArrayLike, points: ArrayLike, threshold: ArrayLike) -> Array:
    """Mean truncated squared Sampson distance (K,) of points (N, 2) from conics (K, 3, 3).

    In units of the threshold (scalar or (N,)). Computed in float32: give points of unit scale.
    """
    coefficients = coefficients_from_conic(conics).astype(np.float32)
    x, y = np.asarray(points, dtype=np.float32).T
    one = np.ones_like(x)
    monomials, lifted = np.stack([x * x, x * y, y * y, x, y, one]), np.stack([x, y, one])
    a, b, c, d, e, _ = coefficients.T
    by_x, by_y = np.stack([2 * a, b, d], axis=1), np.stack([b, 2 * c, e], axis=1)
    squared = np.broadcast_to(np.asarray(threshold, dtype=np.float32) ** 2, x.shape)
    costs = np.empty(len(coefficients), dtype=np.float32)
    mean = np.full(len(x), 1.0 / len(x), dtype=np.float32)
    # blocks that stay in the processor's cache
    for start in range(0, len(coefficients), BLOCK):
        block = slice(start, start + BLOCK)
        value = coefficients[block] @ monomials
        gx, gy = by_x[block] @ lifted, by_y[block] @ lifted
        np.square(value, out=value)
        np.square(gx, out=gx)
        np.square(gy, out=gy)
        gx += gy
        gx *= squared
        with np.errstate(divide="ignore", invalid="ignore"):
            value /= gx
        np.fmin(value, np.float32(1.0), out=value)
        costs[block] = value @ mean
    return costs.astype(np.float64)


def sample_conics(points: Array, hypotheses: int, rng: np.random.Generator) -> Array:
    """Ellipses (K, 3, 3), K <= hypotheses, through random five of the points (N, 2).

    Repeated picks and other conics are dropped.
    """
    picks = rng.integers(0, len(points), (hypotheses, 5))
    conics = conics_through_points(points[picks])
    return normalise_conic(conics[is_ellipse(conics)])


def ransac_conic(
    points: ArrayLike,
    threshold_px: ArrayLike | float,
    rng: np.random.Generator,
    *,
    hypotheses: int = 1000,
    method: str = "direct",
    confidence: float = 1.0,
    start: ArrayLike | None = None,
) -> RobustConic | None:
    """Ellipse that explains most of the points.

    Parameters
    ----------
    points : (N, 2) array
        Points, many of which may be wrong.
    threshold_px : float or (N,) array
        Distance at which a point stops counting.
    rng : numpy.random.Generator
        Source of the samples.
    hypotheses : int
        Most minimal samples, computed in batches.
    method : {"direct", "algebraic", "taubin"}
        Closed form of the local refits.
    confidence : float
        Sampling stops when, with this probability, some sample held no outlier, by the inliers of the best conic so far
        (Fischler and Bolles 1981, section II B), after some times as many samples, since noise makes many of them poor;
        1 draws them all.
    start : (3, 3) array, optional
        An ellipse from elsewhere. Where it explains nearly all points and ``confidence`` is less than 1, it is the
        answer, and nothing is fitted.

    Returns
    -------
    RobustConic or None
        None for fewer than six points or where no sample gives an ellipse.
    """
    p = np.asarray(points, dtype=np.float64)
    if len(p) < 6 or not np.isfinite(p).all():
        return None
    if start is not None and confidence < 1.0:
        squared = np.square(sampson_distance(start, p) / np.asarray(threshold_px, dtype=np.float64))
        if np.mean(squared < 1.0) > NEARLY_ALL:
            return RobustConic(normalise_conic(start), squared < 1.0, float(np.minimum(squared, 1.0).mean()), 0)
    T = similarity_normalisation(p)
    local = p * T[0, 0] + T[:2, 2]
    threshold = np.broadcast_to(np.asarray(threshold_px, dtype=np.float64) * T[0, 0], len(p))
    everything = fit_conics(local, np.ones((1, len(p))), "direct")
    everything = everything[np.isfinite(everything).all(axis=(1, 2))]
    best = _best_refit(everything, local, threshold, method) if len(everything) else None
    drawn = 0
    while drawn < (needed := _count_samples(best, hypotheses, confidence)):
        batch = needed if confidence >= 1.0 else min(max(FIRST_BATCH, drawn), needed - drawn)
        sampled, drawn = sample_conics(local, batch, rng), drawn + batch
        costs = msac_costs(sampled, local, threshold)
        promising = np.argsort(costs, kind="stable")[:MOST_REFITS]
        if best is not None and best.inliers.mean() > MOSTLY_EXPLAINED:
            promising = promising[costs[promising] < best.cost]
        if len(promising):
            found = _best_refit(sampled[promising], local, threshold, method)
            best = found if best is None or found.cost < best.cost else best
    if best is None:
        return None
    return RobustConic(normalise_conic(T.T @ best.conic @ T), best.inliers, best.cost, drawn)


def _count_samples(best: RobustConic | None, most: int, confidence: float) -> int:
    """How many samples of five points make one without outliers as sure as ``confidence``, with some more for noise, at
    most ``most``; 0 where the best conic so far explains nearly all points.
    """
    share = 0.0 if best is None else float(np.mean(best.inliers))
    if confidence >= 1.0 or share <= 0.0:
        return most
    if share > NEARLY_ALL:
        return 0
    clean = share**5
    return min(most, int(np.ceil(SAFETY * np.log(1.0 - confidence) / np.log(1.0 - min(clean, 0.999)))))


def _best_refit(conics: Array, points: Array, threshold: Array, method: str) -> RobustConic:
    """Best of conics (K, 3, 3) after local refits, without any where it explains nearly all points; in their frame."""
    costs = msac_costs(conics, points, threshold)
    inliers = np.abs(sampson_distance(conics[np.argmin(costs)], points)) < threshold
    if inliers.mean() > NEARLY_ALL:
        return RobustConic(conics[np.argmin(costs)], inliers, float(costs.min()), 0)
    refined, costs = _refit(conics, costs, points, threshold, method)
    conic = refined[np.argmin(costs)]
    inliers = np.abs(sampson_distance(conic, points)) < threshold
    return RobustConic(conic, inliers, float(costs.min()), 0)


def _refit(conics: Array, costs: Array, points: Array, threshold: Array, method: str) -> tuple[Array, Array]:
    """Conics (K, 3, 3) refitted together to their own inliers, from twice the threshold inwards, and their costs (K,).

    A refit is kept only where it costs less than before (``costs``, (K,)).
    """
    current = conics
    for scale in np.linspace(2.0, 1.0, LOCAL_ROUNDS):
        distance = sampson_distance(current, points) / (scale * threshold)
        weights = np.clip(1.0 - distance**2, 0.0, None)
        proposal = fit_conics(points, weights, method)
        valid = is_ellipse(proposal)
        proposal = np.where(valid[:, None, None], proposal, current)
        new_costs = msac_costs(proposal, points, threshold)
        better = new_costs < costs
        current, costs = np.where(better[:, None, None], proposal, current), np.minimum(costs, new_costs)
    return current, costs
