"""Conics through points: exactly five, many in closed form, and many by their distances from the curve.

Sources: Fitzgibbon, Pilu and Fisher 1999 and Halir and Flusser 1998 (the direct fit and its numerically stable split);
Taubin 1991 (gradient-weighted fit); Ahn, Rauh and Warnecke 2001 (fit of the orthogonal distances).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.conics import coefficients_from_conic, conic_from_coefficients, normalise_conic
from circlecal.geometry.ellipses import ellipse_from_conic, foot_points
from circlecal.geometry.least_squares import DenseProblem, NormalState, StoppingRule, minimise
from circlecal.geometry.projective import Array, similarity_normalisation

REFINEMENT = StoppingRule(3e-3, unit=np.inf, last_step=True, iterations=30)
"""A step of the geometric fit that gains less than 0.3 % of the squared residuals is the last one: the next would gain
about its square.
"""
RANK_TOLERANCE = 1e-14
"""Share of the largest eigenvalue of a scatter matrix of normalised points that is rounding."""
_FIRST, _SECOND = np.triu_indices(5, 1)
_UPPER = np.array([0, 1, 4, 2, 5, 8])


def _monomials(points: Array) -> Array:
    x, y = points[..., 0], points[..., 1]
    return np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)


def _denormalise(coefficients: Array, T: Array) -> Array:
    return T.T @ conic_from_coefficients(coefficients) @ T


def conics_through_points(points: ArrayLike) -> Array:
    """Conics (..., 3, 3) through exactly five points (..., 5, 2), all at once.

    Normalise the points to unit scale first; degenerate samples (repeated or collinear points) give arbitrary conics,
    to be sorted out by :func:`circlecal.geometry.conics.is_ellipse` and by their score. The constant term is fixed
    to 1, so the origin must not lie on the conic: the caller's coordinates are shifted here by an irrational offset.
    """
    p = np.asarray(points, dtype=np.float64)
    shift = np.array([np.pi, np.e])
    design = _monomials(p + shift)
    system, one = design[..., :5], -np.ones((*p.shape[:-2], 5, 1))
    x, y = p[..., 0], p[..., 1]
    repeated = ((x[..., _FIRST] == x[..., _SECOND]) & (y[..., _FIRST] == y[..., _SECOND])).any(axis=-1)
    system = np.where(repeated[..., None, None], np.eye(5), system)
    try:
        solved = np.linalg.solve(system, one)[..., 0]
    except np.linalg.LinAlgError:  # one exactly singular sample stops the whole batch: find it, then solve the others
        repeated |= np.linalg.det(system) == 0
        solved = np.linalg.solve(np.where(repeated[..., None, None], np.eye(5), system), one)[..., 0]
    coefficients = np.concatenate([solved, np.ones((*solved.shape[:-1], 1))], axis=-1)
    T = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]], [0.0, 0.0, 1.0]])
    conics = _denormalise(coefficients, T)
    return np.where(repeated[..., None, None], np.nan, conics)


def _scatter(points: Array, weights: Array | None) -> Array:
    """Scatter matrices ``S = D^T W D`` (..., 6, 6) of the monomials D of points."""
    design = _monomials(points)
    weighted = design if weights is None else design * weights[..., None]
    return np.swapaxes(design, -1, -2) @ weighted


def _smallest_algebraic(scatter: Array) -> Array:
    """The unit vector a that minimises ``a^T S a``: the eigenvector of the smallest eigenvalue."""
    return np.linalg.eigh(scatter)[1][..., 0]


def _halir_flusser(scatter: Array) -> Array:
    """Fitzgibbon's fit in Halir and Flusser's split: minimise ``a^T S a`` under ``a^T C a = 4 A C - B^2 = 1``.

    With quadratic coefficients a1 = (A, B, C) and linear ones a2, ``S = [[S1, S2], [S2^T, S3]]``, and C zero but for
    ``C1 = [[0, 0, 2], [0, -1, 0], [2, 0, 0]]``, two conditions hold: ``S1 a1 + S2 a2 = lambda C1 a1`` and
    ``S2^T a1 + S3 a2 = 0``.
    """
    s1, s2, s3 = scatter[..., :3, :3], scatter[..., :3, 3:], scatter[..., 3:, 3:]
    # the second condition: a2 = T a1 with T = -S3^-1 S2^T
    t = -np.linalg.solve(s3, np.swapaxes(s2, -1, -2))
    # put into the first one: M a1 = lambda a1 with M = C1^-1 (S1 + S2 T)
    m = s1 + s2 @ t
    reduced = np.stack([m[..., 2, :] / 2, -m[..., 1, :], m[..., 0, :] / 2], axis=-2)
    _, vectors = np.linalg.eig(reduced)
    vectors = np.real(vectors)
    # of the three eigenvectors the one with a1^T C1 a1 = 4 A C - B^2 > 0 is the ellipse
    constraint = 4 * vectors[..., 0, :] * vectors[..., 2, :] - vectors[..., 1, :] ** 2
    best = np.argmax(constraint, axis=-1)
    quadratic = np.take_along_axis(vectors, best[..., None, None], axis=-1)[..., 0]
    linear = (t @ quadratic[..., None])[..., 0]
    return np.concatenate([quadratic, linear], axis=-1)


def _taubin(scatter: Array, points: Array, weights: Array | None) -> Array:
    """Taubin's fit: minimise ``a^T S a / a^T N a`` with ``N = sum |grad (monomials)|^2``, so ``S a = lambda N a``.

    The constant coefficient f has no part in N and is eliminated: with ``S = [[A, b], [b^T, s]]``, ``f = -b^T a' / s``
    and ``(A - b b^T / s) a' = lambda N a'``.
    """
    x, y = points[..., 0], points[..., 1]
    zero, one = np.zeros_like(x), np.ones_like(x)
    dx = np.stack([2 * x, y, zero, one, zero], axis=-1)
    dy = np.stack([zero, x, 2 * y, zero, one], axis=-1)
    wx, wy = (dx, dy) if weights is None else (dx * weights[..., None], dy * weights[..., None])
    gradient_scatter = np.swapaxes(dx, -1, -2) @ wx + np.swapaxes(dy, -1, -2) @ wy
    last = scatter[..., :5, 5:]
    reduced = scatter[..., :5, :5] - last @ np.swapaxes(last, -1, -2) / scatter[..., 5:, 5:]
    # with N = L L^T an ordinary symmetric eigenproblem of L^-1 (A - b b^T / s) L^-T
    lower = np.linalg.inv(np.linalg.cholesky(gradient_scatter + 1e-12 * np.eye(5)))
    vectors = np.linalg.eigh(lower @ reduced @ np.swapaxes(lower, -1, -2))[1][..., :1]
    first = (np.swapaxes(lower, -1, -2) @ vectors)[..., 0]
    constant = -(np.swapaxes(last, -1, -2) @ first[..., None])[..., 0] / scatter[..., 5, 5][..., None]
    return np.concatenate([first, constant], axis=-1)


FIT_METHODS = ("direct", "algebraic", "taubin")


def fit_conic(points: ArrayLike, method: str = "direct") -> Array | None:
    """Conic through many points by a closed form.

    Parameters
    ----------
    points : (N, 2) array
        At least five points.
    method : {"direct", "algebraic", "taubin"}
        Fitzgibbon's direct ellipse fit in Halir and Flusser's split (always an ellipse; shrinks on short arcs), plain
        least squares on unit coefficients, or Taubin's gradient-weighted fit (unbiased down to quarter arcs; may give a
        hyperbola on shorter ones).

    Returns
    -------
    (3, 3) array or None
        The normalised conic; None where the points determine none (too few, collinear, not finite).
    """
    if method not in FIT_METHODS:
        raise ValueError(f"method must be one of {FIT_METHODS}, not {method!r}")
    p = np.asarray(points, dtype=np.float64)
    if len(p) < 5 or not np.isfinite(p).all():
        return None
    T = similarity_normalisation(p)
    local = p * T[0, 0] + T[:2, 2]
    scatter = _scatter(local, None)
    spectrum = np.linalg.eigvalsh(scatter)
    # more than one conic passes through points that are collinear or stand in fewer than five places
    if spectrum[1] <= RANK_TOLERANCE * spectrum[5]:
        return None
    try:
        coefficients = _closed_form(method, scatter, local, None)
    except np.linalg.LinAlgError:
        return None
    conic = normalise_conic(_denormalise(coefficients, T))
    return conic if np.isfinite(conic).all() else None


def _closed_form(method: str, scatter: Array, points: Array, weights: Array | None) -> Array:
    if method == "direct":
        return _halir_flusser(scatter)
    if method == "algebraic":
        return _smallest_algebraic(scatter)
    return _taubin(scatter, points, weights)


def fit_conics(points: ArrayLike, weights: ArrayLike, method: str = "direct") -> Array:
    """Conics through one point set under K weightings at once, by the closed forms of :func:`fit_conic`.

    Parameters
    ----------
    points : (N, 2) array
        Points of unit scale (see :func:`circlecal.geometry.projective.similarity_normalisation`).
    weights : (K, N) array
        Weight of each point in each fit.
    method : {"direct", "algebraic", "taubin"}
        As in :func:`fit_conic`.

    Returns
    -------
    (K, 3, 3) array
        Normalised conics; not finite where a weighting determines none.
    """
    p, w = np.asarray(points, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    scatter = _scatter(p, w) + 1e-12 * np.eye(6)
    try:
        return normalise_conic(conic_from_coefficients(_closed_form(method, scatter, p, w)))
    except np.linalg.LinAlgError:
        return np.full((len(w), 3, 3), np.nan)


@dataclass(frozen=True, slots=True)
class OrthogonalFit(DenseProblem):
    """Squared orthogonal distances over sigma of points (N, 2) with standard deviations (N,) from one conic (1, 6)."""

    points: Array
    sigma: Array

    def evaluate(self, parameters: Array) -> NormalState:
        """State at coefficients of unit length; no ellipse costs inf."""
        c = parameters[0]
        ellipse = ellipse_from_conic(conic_from_coefficients(c))
        if ellipse is None:
            return NormalState(parameters, np.full(1, np.inf), np.zeros((1, 6)), np.eye(6)[None])
        (x, y), distance = foot_points(ellipse, self.points)
        A, B, C, D, E, _ = c.tolist()
        gx, gy = 2 * A * x + B * y + D, B * x + 2 * C * y + E
        size = np.maximum(np.hypot(gx, gy), 1e-300)
        residual = distance / self.sigma if A + C > 0 else -distance / self.sigma
        # a distance changes with the conic by (monomials . dc) / |gradient| at its foot, which moves along the curve
        jacobian = (np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)]) / (size * self.sigma)).T
        normal = jacobian.T @ jacobian
        return NormalState(parameters, (residual @ residual)[None], (jacobian.T @ residual)[None], normal[None])

    def move(self, parameters: Array, change: Array) -> Array:
        """Coefficients of unit length."""
        moved = parameters + change
        return np.asarray(moved / np.linalg.norm(moved))

    def gauge(self, state: NormalState) -> Array:
        """The scale of the coefficients moves no point: it is held by a term of the size of the others."""
        return (
            state.normal.trace(axis1=1, axis2=2)[:, None, None]
            * state.parameters[:, :, None]
            * state.parameters[:, None]
        )


def refine_conic(points: ArrayLike, conic: ArrayLike, sigma_px: ArrayLike | float = 1.0) -> tuple[Array, Array] | None:
    """Geometric fit: minimise the sum of squared orthogonal distances over sigma.

    Parameters
    ----------
    points : (N, 2) array
        Points near the ellipse.
    conic : (3, 3) array
        Start; must be an ellipse.
    sigma_px : float or (N,) array
        Standard deviation of each point along the normal.

    Returns
    -------
    conic : (3, 3) array
        Normalised conic.
    covariance : (6, 6) array
        Covariance of its coefficients (``x^2, xy, y^2, x, y, 1``), rank 5 as the determinant is fixed, for the given
        sigmas.
    None where the start is no ellipse, or there are fewer than five points.
    """
    p = np.asarray(points, dtype=np.float64)
    if len(p) < 5:
        return None
    T = similarity_normalisation(p)
    inverse_T = np.linalg.inv(T)
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64) * T[0, 0], len(p))
    problem = OrthogonalFit(p * T[0, 0] + T[:2, 2], sigma)
    local = inverse_T.T @ np.asarray(conic, dtype=np.float64) @ inverse_T
    first = coefficients_from_conic(local)
    start = problem.evaluate(first[None] / np.linalg.norm(first))
    if not np.isfinite(start.cost[0]):
        return None
    state = minimise(problem, start, REFINEMENT).state
    values, vectors = np.linalg.eigh(state.normal[0])
    known = vectors[:, values > RANK_TOLERANCE * values[-1]]
    covariance = (known / values[values > RANK_TOLERANCE * values[-1]]) @ known.T
    return _denormalise_with_covariance(state.parameters[0], covariance, T)


def _denormalise_with_covariance(coefficients: Array, covariance: Array, T: Array) -> tuple[Array, Array]:
    (k, _, u), (_, _, v), _ = T.tolist()
    by_scaled = np.diag([k * k, k * k, k * k, k, k, 1.0])
    by_scaled[3, :3], by_scaled[4, :3] = (2 * k * u, k * v, 0.0), (0.0, k * u, 2 * k * v)
    by_scaled[5, :5] = u * u, u * v, v * v, u, v
    raw = by_scaled @ coefficients
    conic = normalise_conic(conic_from_coefficients(raw))
    normalised = coefficients_from_conic(conic)
    # the fixed determinant takes back whatever part of a change is a mere change of scale: d det = det tr(C^-1 dC)
    by_scale = np.linalg.inv(conic).reshape(9)[_UPPER]
    basis = (np.eye(6) - np.outer(normalised, by_scale) / 3.0) @ by_scaled * ((normalised @ raw) / (raw @ raw))
    return conic, basis @ covariance @ basis.T
