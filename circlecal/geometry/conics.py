"""Conics: matrices and coefficients, pole and polar, meets with lines, images, and the first-order distance.

Sources: Hartley & Zisserman, *Multiple View Geometry*, 2nd ed., sections 2.2.3 and 2.8.1 (conics, pole and polar);
Sampson 1982 (first-order distance).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from circlecal.geometry.projective import Array, normalise_line

_SYMMETRIC, _HALVED = np.array([0, 1, 3, 1, 2, 4, 3, 4, 5]), np.array([1, 0.5, 0.5, 0.5, 1, 0.5, 0.5, 0.5, 1])
_UPPER, _DOUBLED = np.array([0, 1, 4, 2, 5, 8]), np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0])


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
    # (foot + t direction)^T C (foot + t direction) = a t^2 + 2 b t + c = 0;
    # the larger root first, the smaller from the product of the roots: no cancellation
    q = -(b + np.copysign(np.sqrt(discriminant), b))
    roots = np.sort([q / a, c / q])
    return foot + roots[:, None] * direction


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

    ``x^T C x / |grad(x^T C x)|``, positive outside a normalised ellipse. Source: Sampson 1982; H&Z eq. 11.9.
    """
    value, gradient = algebraic_residuals(conic, points)
    return value / np.maximum(np.hypot(gradient[..., 0], gradient[..., 1]), 1e-300)
