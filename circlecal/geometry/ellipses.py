"""Ellipses by centre, semi-axes and angle: points, feet of perpendiculars, distances, and their conics."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cbrt, cos, hypot, inf, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.projective import Array

FOOT_ROUNDS = 6
"""Most rounds of the search for foot points; two or three near the curve."""
MOVED = 1e-4
"""Foot points that moved less than this share of the semi-axes have arrived; the next move is about its square."""


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

    def points_and_normals(self, t_rad: Array) -> tuple[Array, Array]:
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


def orthogonal_distance(ellipse: Ellipse, points: ArrayLike) -> Array:
    """Signed orthogonal distance (N,) of points (N, 2), positive outside."""
    return foot_points(ellipse, np.asarray(points, dtype=np.float64))[1]


def foot_points(ellipse: Ellipse, points: Array) -> tuple[Array, Array]:
    """Nearest points (2, N) of an ellipse to points (N, 2), and the signed distances (N,), positive outside.

    Each round replaces the ellipse about the present foot point by its circle of curvature, whose nearest point is
    known. At the eccentric angle t its centre is the evolute's point ``(a^2 - b^2) (cos^3 t / a, -sin^3 t / b)``.
    """
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


def arc_coverage_deg(ellipse: Ellipse, points: ArrayLike) -> float:
    """Degrees of the ellipse (eccentric angle) that have at least one point (N, 2) in their bin of 5 degrees."""
    bins = 72
    occupied = np.bincount(np.floor(ellipse.parameter(points) * (bins / (2 * np.pi))).astype(int) % bins)
    return float(np.count_nonzero(occupied) * 360.0 / bins)
