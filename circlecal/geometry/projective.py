"""Points and lines of the projective plane (Hartley & Zisserman, 2nd ed., section 2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, sin, sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
PointsLike = ArrayLike | Sequence[object]
"""Points as users write them: to type checkers ``[[1, 2], [3.5, 4]]`` is a list of objects."""
Mask = NDArray[np.bool_]
Indices = NDArray[np.int_]
Values = TypeVar("Values", bound=NDArray[np.generic])
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def freeze(values: Values) -> Values:
    """The array itself, which nobody may write to from now on: several share it."""
    values.setflags(write=False)
    return values


def lift(points: ArrayLike) -> Array:
    """Append w = 1: ``(..., 2)`` -> ``(..., 3)``."""
    points = np.asarray(points, dtype=np.float64)
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def dehomogenise(points: ArrayLike) -> Array:
    """Divide by w: ``(..., 3)`` -> ``(..., 2)``; points at infinity become inf or nan."""
    points = np.asarray(points, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return points[..., :2] / points[..., 2:]


def join(p: ArrayLike, q: ArrayLike) -> Array:
    """Line through two homogeneous points, ``(..., 3)``."""
    return _cross(p, q)


def meet(l: ArrayLike, m: ArrayLike) -> Array:  # noqa: E741 - l is the field's letter for a line
    """Homogeneous point in which two lines meet, ``(..., 3)``."""
    return _cross(l, m)


def _cross(p: ArrayLike, q: ArrayLike) -> Array:
    """Cross product ``(..., 3)``; np.cross takes many times as long over its checks."""
    p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
    return p[..., _NEXT] * q[..., _LAST] - p[..., _LAST] * q[..., _NEXT]


def normalise_line(line: ArrayLike) -> Array:
    """Scale lines ``(..., 3)`` so that ``a^2 + b^2 = 1``: ``line @ lift(p)`` is then a signed distance in pixels."""
    line = np.asarray(line, dtype=np.float64)
    return line / np.hypot(line[..., 0], line[..., 1])[..., None]


def line_distance(line: ArrayLike, points: ArrayLike) -> Array:
    """Signed distance (N,) of points ``(N, 2)`` from a line ``(3,)``, in the points' unit."""
    a, b, c = normalise_line(line)
    points = np.asarray(points, dtype=np.float64)
    return a * points[..., 0] + b * points[..., 1] + c


def extent(points: Array) -> float:
    """Diagonal of the box around points (N, 2): about how far apart the outermost points of a marking are."""
    return float(np.hypot(*(points.max(axis=0) - points.min(axis=0))))


def fit_line(points: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Line through points by weighted total least squares.

    Parameters
    ----------
    points : (N, 2) array
        At least two different points.
    weights : (N,) array, optional
        Inverse variances.

    Returns
    -------
    (3,) array
        Normalised line.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 2:
        raise ValueError("a line needs at least two points")
    if weights is None:
        dx, dy = points[:, 0], points[:, 1]
        x, y = float(dx.sum()) / len(points), float(dy.sum()) / len(points)
        wx, wy = dx, dy = dx - x, dy - y
    else:
        w = np.asarray(weights, dtype=np.float64)
        x, y = (w @ points / w.sum()).tolist()
        dx, dy = points[:, 0] - x, points[:, 1] - y
        wx, wy = w * dx, w * dy
    # direction of the greater eigenvector of the 2 x 2 scatter
    angle = 0.5 * atan2(2.0 * float(wx @ dy), float(wx @ dx) - float(wy @ dy))
    a, b = -sin(angle), cos(angle)
    return np.array([a, b, -a * x - b * y])


def similarity_normalisation(points: ArrayLike) -> Array:
    """Similarity (3, 3) that moves points ``(N, 2)`` to zero mean and mean distance sqrt 2 (H&Z algorithm 4.2)."""
    points = np.asarray(points, dtype=np.float64)
    count = max(len(points), 1)
    x, y = (points.sum(axis=0) / count).tolist()
    spread = float(np.hypot(points[:, 0] - x, points[:, 1] - y).sum()) / count
    s = sqrt(2.0) / spread if spread > 0 else 1.0
    return np.array([[s, 0.0, -s * x], [0.0, s, -s * y], [0.0, 0.0, 1.0]])


def apply_homography(H: ArrayLike, points: ArrayLike) -> Array:
    """Map points ``(..., 2)`` by a homography ``(3, 3)``."""
    return dehomogenise(lift(points) @ np.asarray(H, dtype=np.float64).T)


def transform_lines(H: ArrayLike, lines: ArrayLike) -> Array:
    """Map lines ``(..., 3)`` by the homography that maps points with ``H``: ``l' = H^-T l`` (H&Z eq. 2.6)."""
    return np.asarray(lines, dtype=np.float64) @ np.linalg.inv(np.asarray(H, dtype=np.float64))
