"""Conics and ellipses: conversions, poles and polars, distances and fits.

Sources: Hartley & Zisserman, *Multiple View Geometry*, 2nd ed., section 2.2.3 (conics, pole and polar); Fitzgibbon,
Pilu and Fisher 1999 and Halir and Flusser 1998 (direct fit and its numerically stable split); Taubin 1991
(gradient-weighted fit); Sampson 1982 (first-order distance).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cbrt, cos, hypot, inf, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from circlecal.geometry.projective import Array, normalise_line, similarity_normalisation

FOOT_ROUNDS = 6
"""Most rounds of the search for foot points; two or three near the curve."""
MOVED = 1e-4
"""Foot points that moved less than this share of the semi-axes have arrived; the next move is about its square."""
CONVERGED = 3e-3
"""Share of the squared residuals; a step of the geometric fit that gains less is the last one:
the next would gain about its square."""
_SYMMETRIC, _HALVED = np.array([0, 1, 3, 1, 2, 4, 3, 4, 5]), np.array([1, 0.5, 0.5, 0.5, 1, 0.5, 0.5, 0.5, 1])
_FIRST, _SECOND = np.triu_indices(5, 1)
_UPPER, _DOUBLED = np.array([0, 1, 4, 2, 5, 8]), np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0])


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse by its centre (2,), semi-axes (longer first) and the angle from the x axis to the longer one."""

    center: Array
    semi_axes: tuple[float, float]
    angle_rad: float

    @property
    def axis_ratio(self) -> float:
        """Shorter over longer semi-axis."""
        return self.semi_axes[1] / self.semi_axes[0]

    def frame(self) -> Array:
        """Affinity (3, 3) from the unit circle's frame to the image."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        a, b = self.semi_axes
        return np.array([[a * c, -b * s, self.center[0]], [a * s, b * c, self.center[1]], [0.0, 0.0, 1.0]])

    def points(self, t_rad: ArrayLike) -> Array:
        """Points ``(..., 2)`` at the eccentric angles ``t_rad``."""
        t = np.asarray(t_rad, dtype=np.float64)
        m = self.frame()
        return np.stack([np.cos(t), np.sin(t)], axis=-1) @ m[:2, :2].T + m[:2, 2]

    def normals(self, t_rad: ArrayLike) -> Array:
        """Outward unit normals ``(..., 2)`` at the eccentric angles."""
        t = np.asarray(t_rad, dtype=np.float64)
        a, b = self.semi_axes
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        local = np.stack([np.cos(t) / a, np.sin(t) / b], axis=-1)
        normal = local @ np.array([[c, s], [-s, c]])
        return normal / np.hypot(normal[..., 0], normal[..., 1])[..., None]

    def course(self, t_rad: Array) -> tuple[Array, Array]:
        """:meth:`points` and :meth:`normals` (N, 2) at the eccentric angles (N,), in one."""
        turn = np.stack([np.cos(t_rad), np.sin(t_rad)], axis=-1)
        frame = self.frame()[:2, :2]
        normal = turn @ np.array([[frame[1, 1], -frame[0, 1]], [-frame[1, 0], frame[0, 0]]])
        return turn @ frame.T + self.center, normal / np.hypot(normal[:, 0], normal[:, 1])[:, None]

    def parameter(self, points: ArrayLike) -> Array:
        """Eccentric angle (N,) of each point (N, 2) in the frame in which the ellipse is the unit circle."""
        a, b = self.semi_axes
        c, s = cos(self.angle_rad), sin(self.angle_rad)
        away = np.asarray(points, dtype=np.float64) - self.center
        x, y = away[..., 0], away[..., 1]
        return np.arctan2((c * y - s * x) / b, (c * x + s * y) / a)


def conic_from_coefficients(coefficients: ArrayLike) -> Array:
    """``(..., 6)`` coefficients of ``x^2, xy, y^2, x, y, 1`` -> symmetric matrices ``(..., 3, 3)``."""
    c = np.asarray(coefficients, dtype=np.float64)
    return (c[..., _SYMMETRIC] * _HALVED).reshape(*c.shape[:-1], 3, 3)


def coefficients_from_conic(conic: ArrayLike) -> Array:
    """Inverse of :func:`conic_from_coefficients`."""
    m = np.asarray(conic, dtype=np.float64)
    return m.reshape(*m.shape[:-2], 9)[..., _UPPER] * _DOUBLED


def normalise_conic(conic: ArrayLike) -> Array:
    """Fix scale and sign ``(..., 3, 3)``: det = -1, so signature (+, +, -) for a real ellipse; the inside is negative.

    A degenerate conic (det = 0) comes back with non-finite entries.
    """
    m = np.asarray(conic, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        m = m / np.max(np.abs(m), axis=(-2, -1), keepdims=True)
        return -m / np.cbrt(np.linalg.det(m))[..., None, None]


def is_ellipse(conic: ArrayLike) -> NDArray[np.bool_]:
    """True where ``(..., 3, 3)`` is a real, non-degenerate ellipse."""
    m = normalise_conic(conic)
    with np.errstate(over="ignore", invalid="ignore"):
        minor = m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] ** 2
        return np.isfinite(m).all(axis=(-2, -1)) & (minor > 0) & (m[..., 0, 0] + m[..., 1, 1] > 0)


def conic_from_ellipse(ellipse: Ellipse) -> Array:
    """Normalised conic (3, 3) of an ellipse."""
    a, b = ellipse.semi_axes
    x, y = ellipse.center.tolist()
    c, s = cos(ellipse.angle_rad), sin(ellipse.angle_rad)
    scale = cbrt(a * b) ** 2  # makes the determinant -1
    p, q = scale / (a * a), scale / (b * b)
    xx, xy, yy = p * c * c + q * s * s, (p - q) * c * s, p * s * s + q * c * c
    u, v = -(xx * x + xy * y), -(xy * x + yy * y)
    return np.array([[xx, xy, u], [xy, yy, v], [u, v, -(u * x + v * y) - scale]])


def ellipse_from_conic(conic: ArrayLike) -> Ellipse | None:
    """Centre, semi-axes and angle of a conic (3, 3), or None where it is no real ellipse."""
    m = np.asarray(conic, dtype=np.float64)
    a, b, c, d, e, f = (float(m[i, j]) for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))
    minor = a * c - b * b
    if not minor > 0:
        return None
    x, y = (b * e - c * d) / minor, (b * d - a * e) / minor
    sign = 1.0 if a + c > 0 else -1.0
    level = -sign * (f + d * x + e * y)
    larger = sign * (a + c) / 2 + hypot((a - c) / 2, b)
    smaller = minor / larger
    if not (level > 0 and 0 < smaller < inf):
        return None
    angle = 0.5 * atan2(-2 * sign * b, sign * (c - a)) if (b or a != c) else 0.0
    return Ellipse(np.array([x, y]), (sqrt(level / smaller), sqrt(level / larger)), angle % pi)


def encloses(conic: ArrayLike, smaller: ArrayLike) -> bool:
    """Whether the ellipse of one conic (3, 3) has the whole of another one inside; False where one is no ellipse."""
    outer, inner = ellipse_from_conic(conic), ellipse_from_conic(smaller)
    if outer is None or inner is None:
        return False
    rim = inner.points(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)) - outer.center
    on_unit_disc = np.linalg.solve(outer.frame()[:2, :2], rim.T)
    return bool((np.hypot(*on_unit_disc) < 1.0).all())


def circle_conic(center: ArrayLike, radius: float) -> Array:
    """Conic (3, 3) of a circle (Magera et al. 2025, eq. 2)."""
    x, y = np.asarray(center, dtype=np.float64)
    return np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [-x, -y, x * x + y * y - radius * radius]])


def transform_conic(H: ArrayLike, conic: ArrayLike) -> Array:
    """Image of a conic under the point map ``H``: ``H^-T C H^-1`` (H&Z result 2.13), normalised."""
    inverse = np.linalg.inv(np.asarray(H, dtype=np.float64))
    return normalise_conic(np.swapaxes(inverse, -1, -2) @ np.asarray(conic, dtype=np.float64) @ inverse)


def polar(conic: ArrayLike, point: ArrayLike) -> Array:
    """Polar line of a homogeneous point: ``C p`` (H&Z section 2.8.1)."""
    return np.asarray(conic, dtype=np.float64) @ np.asarray(point, dtype=np.float64)


def pole(conic: ArrayLike, line: ArrayLike) -> Array:
    """Pole of a line: ``C^-1 l``.

    Magera et al. 2025 print case 2 as ``v = E l1``; a point is the pole of a line through the inverse.
    """
    return np.linalg.solve(np.asarray(conic, dtype=np.float64), np.asarray(line, dtype=np.float64))


def line_conic_meet(conic: ArrayLike, line: ArrayLike) -> Array | None:
    """Both points (2, 3) in which a line meets a conic, or None where they are not real or lie at infinity.

    The points are ordered along the direction ``(b, -a)`` of the line ``(a, b, c)``.
    """
    m = np.asarray(conic, dtype=np.float64)
    line = np.asarray(line, dtype=np.float64)
    if np.hypot(line[0], line[1]) <= 1e-15 * abs(line[2]):
        return None
    line = normalise_line(line)
    foot = np.array([-line[0] * line[2], -line[1] * line[2], 1.0])
    direction = np.array([line[1], -line[0], 0.0])
    a, b, c = direction @ m @ direction, foot @ m @ direction, foot @ m @ foot
    discriminant = b * b - a * c
    if not discriminant > 0 or a == 0:
        return None
    # the larger root first, the smaller from the product of the roots: no cancellation
    q = -(b + np.copysign(np.sqrt(discriminant), b))
    roots = np.sort([q / a, c / q])
    return foot + roots[:, None] * direction


def tangents_from_point(conic: ArrayLike, point: ArrayLike) -> Array | None:
    """Both tangent lines (2, 3) from a homogeneous point outside the conic, or None from inside."""
    contacts = line_conic_meet(conic, polar(conic, point))
    return None if contacts is None else contacts @ np.asarray(conic, dtype=np.float64)


def algebraic_residuals(conic: ArrayLike, points: ArrayLike) -> tuple[Array, Array]:
    """Value ``x^T C x`` (..., N) and gradient (..., N, 2) at the points (..., N, 2)."""
    m = np.asarray(conic, dtype=np.float64)
    p = np.asarray(points, dtype=np.float64)
    x, y = p[..., 0], p[..., 1]
    e = [[m[..., i, j, None] for j in range(3)] for i in range(3)]
    gx = e[0][0] * x + e[0][1] * y + e[0][2]
    gy = e[1][0] * x + e[1][1] * y + e[1][2]
    value = gx * x + gy * y + e[2][0] * x + e[2][1] * y + e[2][2]
    return value, 2.0 * np.stack([gx, gy], axis=-1)


def sampson_distance(conic: ArrayLike, points: ArrayLike) -> Array:
    """Signed first-order distance (..., N) of points (..., N, 2) or (N, 2) from conics (..., 3, 3), in their unit.

    Positive outside a normalised ellipse. Source: Sampson 1982; H&Z eq. 11.9 for conics.
    """
    value, gradient = algebraic_residuals(conic, points)
    return value / np.maximum(np.hypot(gradient[..., 0], gradient[..., 1]), 1e-300)


def orthogonal_distance(ellipse: Ellipse, points: ArrayLike) -> Array:
    """Signed orthogonal distance (N,) of points (N, 2), positive outside."""
    return _feet(ellipse, np.asarray(points, dtype=np.float64))[1]


def _feet(ellipse: Ellipse, points: Array) -> tuple[Array, Array]:
    """Foot points (2, N) and signed distances (N,), positive outside."""
    a, b = ellipse.semi_axes
    c, s = cos(ellipse.angle_rad), sin(ellipse.angle_rad)
    rotation, axes = np.array([[c, -s], [s, c]]), np.array([[a], [b]])
    local = rotation.T @ (points - ellipse.center).T
    p = np.abs(local)
    # points near the curve start in their own direction, others on the diagonal
    t = p / axes
    size = _length(t)
    outside = size >= 1.0
    near = np.abs(size - 1.0) < 0.5 * (b / a) ** 2  # half the smallest radius of curvature
    if not near.all():
        t, size = np.where(near, t, 1.0), np.where(near, size, sqrt(2.0))
    t /= size
    evolute = (a * a - b * b) * np.array([[1.0], [-1.0]]) / (axes * axes)
    for _ in range(FOOT_ROUNDS):
        # centre of curvature of the present foot point; the next one is where its circle meets the ray to the point
        center = evolute * t * t * t
        q = p / axes - center
        r = (t - center) * axes
        scaled = q * axes
        scale = np.sqrt((r * r).sum(axis=0) / np.maximum((scaled * scaled).sum(axis=0), 1e-300))
        following = np.minimum(np.maximum(q * scale + center, 0.0), 1.0)
        size = _length(following)
        if not size.all():  # from the centre of a circle all of its points are as far: keep the last one
            following, size = np.where(size > 0, following, t), np.where(size > 0, size, 1.0)
        following /= size
        moved = np.abs(following - t).max(initial=0.0)
        t = following
        if moved < MOVED:
            break
    foot = np.copysign(t * axes, local)
    distance = _length(local - foot)
    return rotation @ foot + ellipse.center[:, None], np.where(outside, distance, -distance)


def _length(vectors: Array) -> Array:
    """Lengths (N,) of the columns of (2, N)."""
    x, y = vectors
    return np.sqrt(x * x + y * y)


def _monomials(points: Array) -> Array:
    x, y = points[..., 0], points[..., 1]
    return np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)


def _denormalise(coefficients: Array, T: Array) -> Array:
    return T.T @ conic_from_coefficients(coefficients) @ T


def conics_through_points(points: ArrayLike) -> Array:
    """Conics (..., 3, 3) through exactly five points (..., 5, 2), all at once.

    Normalise the points to unit scale first; degenerate samples (repeated or collinear points) give arbitrary conics,
    to be sorted out by :func:`is_ellipse` and by their score. The constant term is fixed to 1, so the origin must not
    lie on the conic: the caller's coordinates are shifted here by an irrational offset.
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
    design = _monomials(points)
    weighted = design if weights is None else design * weights[..., None]
    return np.swapaxes(design, -1, -2) @ weighted


def _smallest_algebraic(scatter: Array) -> Array:
    return np.linalg.eigh(scatter)[1][..., 0]


def _halir_flusser(scatter: Array) -> Array:
    s1, s2, s3 = scatter[..., :3, :3], scatter[..., :3, 3:], scatter[..., 3:, 3:]
    t = -np.linalg.solve(s3, np.swapaxes(s2, -1, -2))
    m = s1 + s2 @ t
    reduced = np.stack([m[..., 2, :] / 2, -m[..., 1, :], m[..., 0, :] / 2], axis=-2)
    _, vectors = np.linalg.eig(reduced)
    vectors = np.real(vectors)
    constraint = 4 * vectors[..., 0, :] * vectors[..., 2, :] - vectors[..., 1, :] ** 2
    best = np.argmax(constraint, axis=-1)
    quadratic = np.take_along_axis(vectors, best[..., None, None], axis=-1)[..., 0]
    linear = (t @ quadratic[..., None])[..., 0]
    return np.concatenate([quadratic, linear], axis=-1)


def _taubin(scatter: Array, points: Array, weights: Array | None) -> Array:
    x, y = points[..., 0], points[..., 1]
    zero, one = np.zeros_like(x), np.ones_like(x)
    dx = np.stack([2 * x, y, zero, one, zero], axis=-1)
    dy = np.stack([zero, x, 2 * y, zero, one], axis=-1)
    wx, wy = (dx, dy) if weights is None else (dx * weights[..., None], dy * weights[..., None])
    gradient_scatter = np.swapaxes(dx, -1, -2) @ wx + np.swapaxes(dy, -1, -2) @ wy
    last = scatter[..., :5, 5:]
    reduced = scatter[..., :5, :5] - last @ np.swapaxes(last, -1, -2) / scatter[..., 5:, 5:]
    lower = np.linalg.inv(np.linalg.cholesky(gradient_scatter + 1e-12 * np.eye(5)))
    vectors = np.linalg.eigh(lower @ reduced @ np.swapaxes(lower, -1, -2))[1][..., :1]
    first = (np.swapaxes(lower, -1, -2) @ vectors)[..., 0]
    constant = -(np.swapaxes(last, -1, -2) @ first[..., None])[..., 0] / scatter[..., 5, 5][..., None]
    return np.concatenate([first, constant], axis=-1)


FIT_METHODS = ("direct", "algebraic", "taubin")


def fit_conic(points: ArrayLike, method: str = "direct", weights: ArrayLike | None = None) -> Array | None:
    """Conic through many points by a closed form.

    Parameters
    ----------
    points : (N, 2) array
        At least five (six for ``direct``) points.
    method : {"direct", "algebraic", "taubin"}
        Fitzgibbon's direct ellipse fit in Halir and Flusser's split (always an ellipse; shrinks on short arcs), plain
        least squares on unit coefficients, or Taubin's gradient-weighted fit (unbiased down to quarter arcs; may give a
        hyperbola on shorter ones).
    weights : (N,) array, optional
        Inverse variances.

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
    w = None if weights is None else np.asarray(weights, dtype=np.float64) / np.max(weights)
    scatter = _scatter(local, w)
    spectrum = np.linalg.eigvalsh(scatter)
    # more than one conic passes through points that are collinear or stand in fewer than five places
    if spectrum[1] <= 1e-14 * spectrum[5]:
        return None
    try:
        coefficients = _closed_form(method, scatter, local, w)
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
    """The same closed forms for K weightings of one point set at once.

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


def refine_conic(
    points: ArrayLike,
    conic: ArrayLike,
    sigma_px: ArrayLike | float = 1.0,
    loss_scale: float | None = None,
    iterations: int = 30,
) -> tuple[Array, Array] | None:
    """Geometric fit: minimise the sum of squared orthogonal distances over sigma by Levenberg-Marquardt.

    Parameters
    ----------
    points : (N, 2) array
        Points near the ellipse.
    conic : (3, 3) array
        Start; must be an ellipse.
    sigma_px : float or (N,) array
        Standard deviation of each point along the normal.
    loss_scale : float, optional
        Scale (in sigmas) of a Geman-McClure loss; None is plain least squares.
    iterations : int
        Upper limit of accepted or rejected steps.

    Returns
    -------
    conic : (3, 3) array
        Normalised conic.
    covariance : (6, 6) array
        Covariance of its coefficients (``x^2, xy, y^2, x, y, 1``), rank 5 as the determinant is fixed, for the given
        sigmas.
    None where the start or the normal equations are degenerate.
    """
    p = np.asarray(points, dtype=np.float64)
    T = similarity_normalisation(p)
    inverse_T = np.linalg.inv(T)
    local = p * T[0, 0] + T[:2, 2]
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64) * T[0, 0], len(p))
    current = coefficients_from_conic(inverse_T.T @ np.asarray(conic, dtype=np.float64) @ inverse_T)
    current = current / np.linalg.norm(current)

    def linearise(coefficients: Array) -> tuple[Array, Array, float] | None:
        ellipse = ellipse_from_conic(conic_from_coefficients(coefficients))
        if ellipse is None:
            return None
        (x, y), distance = _feet(ellipse, local)
        a, b, c, d, e, _ = coefficients.tolist()
        gx, gy = 2 * a * x + b * y + d, b * x + 2 * c * y + e
        size = np.maximum(np.hypot(gx, gy), 1e-300)
        residual = distance / sigma if a + c > 0 else -distance / sigma
        jacobian = (np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)]) / (size * sigma)).T
        if loss_scale is None:
            return residual, jacobian, float(residual @ residual)
        weight = 1.0 / (1.0 + (residual / loss_scale) ** 2)
        cost = float(np.sum(residual**2 * weight))
        return residual * weight, jacobian * weight[:, None], cost

    state = linearise(current)
    if state is None:
        return None
    damping = 1e-4
    for _ in range(iterations):
        residual, jacobian, cost = state
        normal = jacobian.T @ jacobian
        diagonal = normal.diagonal()
        gradient = jacobian.T @ residual
        scaled = normal + np.diag(damping * diagonal) + diagonal.sum() * current[:, None] * current
        try:
            step = -np.linalg.solve(scaled, gradient)
        except np.linalg.LinAlgError:
            return None
        proposal = current + step
        proposal = proposal / np.linalg.norm(proposal)
        # what the linear model promises; where that is nothing, the fit has arrived
        promised = -float(step @ (2 * gradient + normal @ step))
        if promised <= CONVERGED * cost:
            current = proposal
            break
        new_state = linearise(proposal)
        if new_state is not None and new_state[2] <= cost:
            converged = np.linalg.norm(proposal - current) < 1e-15 or cost - new_state[2] <= 1e-7 * cost
            current, state, damping = proposal, new_state, max(damping * 0.1, 1e-12)
            if converged:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    _, jacobian, _ = state
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    known = vectors[:, values > 1e-14 * values[-1]]
    covariance = (known / values[values > 1e-14 * values[-1]]) @ known.T
    return _denormalised_with_covariance(current, covariance, T)


def _denormalised_with_covariance(coefficients: Array, covariance: Array, T: Array) -> tuple[Array, Array]:
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


def arc_coverage_deg(ellipse: Ellipse, points: ArrayLike, bin_deg: float = 5.0) -> float:
    """Degrees of the ellipse (eccentric angle) that have at least one point (N, 2) in their bin."""
    bins = round(360.0 / bin_deg)
    occupied = np.bincount(np.floor(ellipse.parameter(points) * (bins / (2 * np.pi))).astype(int) % bins)
    return float(np.count_nonzero(occupied) * 360.0 / bins)
