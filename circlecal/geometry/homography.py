"""Homographies from points and lines, from a circle with its imaged centre, and their errors.

Sources: Hartley & Zisserman, 2nd ed., algorithm 4.2 (normalised DLT) and section 4.1.1; lines enter through ``l_field ~
H^T l_image``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.projective import (
    Array,
    apply_homography,
    lift,
    meet,
    similarity_normalisation,
    transform_lines,
)

_WORST_CONDITION = 1e14


@dataclass(frozen=True, slots=True)
class DltSolution:
    """Homography (3, 3) and how well the linear system determined it.

    ``condition`` is the ratio of the largest to the second smallest singular value of the normalised system;
    ``null_ratio`` that of the smallest to the second smallest (0 = exact data).
    """

    H: Array
    condition: float
    null_ratio: float


def _cross_rows(x: Array, y: Array) -> Array:
    """Rows of ``[y]_x (M x) = 0`` for unknown ``M`` (row-major 9): (N, 3, 9)."""
    zero = np.zeros_like(x)
    rows = [
        np.concatenate([zero, -y[:, 2:] * x, y[:, 1:2] * x], axis=1),
        np.concatenate([y[:, 2:] * x, zero, -y[:, :1] * x], axis=1),
        np.concatenate([-y[:, 1:2] * x, y[:, :1] * x, zero], axis=1),
    ]
    return np.stack(rows, axis=1)


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def dlt(
    field_points: ArrayLike,
    image_points: ArrayLike,
    field_lines: ArrayLike | None = None,
    image_lines: ArrayLike | None = None,
) -> DltSolution | None:
    """Normalised direct linear transform on points and lines together.

    Parameters
    ----------
    field_points, image_points : (N, 2) arrays
        Corresponding points; N may be 0 only when lines determine the map.
    field_lines, image_lines : (M, 3) arrays, optional
        Corresponding homogeneous lines.

    Returns
    -------
    DltSolution or None
        ``H`` maps field to image and is scaled to ``H[2, 2] = 1`` where possible. None where the correspondences leave
        it undetermined.
    """
    x = np.asarray(field_points, dtype=np.float64).reshape(-1, 2)
    y = np.asarray(image_points, dtype=np.float64).reshape(-1, 2)
    l_field = np.zeros((0, 3)) if field_lines is None else np.asarray(field_lines, dtype=np.float64).reshape(-1, 3)
    l_image = np.zeros((0, 3)) if image_lines is None else np.asarray(image_lines, dtype=np.float64).reshape(-1, 3)
    if len(x) != len(y) or len(l_field) != len(l_image):
        raise ValueError("every field point or line needs its image")
    T_field = similarity_normalisation(x) if len(x) else np.eye(3)
    T_image = similarity_normalisation(y) if len(y) else np.eye(3)
    system = correspondence_rows(x, y, l_field, l_image, T_field, T_image).reshape(-1, 9)
    if not np.isfinite(system).all() or len(system) < 8:
        return None
    # nine rows at least, so that the thin decomposition holds the null vector
    padded = np.concatenate([system, np.zeros((max(0, 9 - len(system)), 9))])
    _, singular, vectors = np.linalg.svd(padded, full_matrices=False)
    if singular[7] <= 1e-12 * singular[0]:
        return None
    H = np.linalg.inv(T_image) @ vectors[8].reshape(3, 3) @ T_field
    return DltSolution(scale_homography(H), float(singular[0] / singular[7]), float(singular[8] / singular[7]))


def correspondence_rows(
    field_points: Array, image_points: Array, field_lines: Array, image_lines: Array, T_field: Array, T_image: Array
) -> Array:
    """Linear equations (N + M, 3, 9) that N points and M lines set to a homography, after a change of coordinates.

    Parameters
    ----------
    field_points, image_points : (N, 2) arrays
        Corresponding points.
    field_lines, image_lines : (M, 3) arrays
        Corresponding homogeneous lines.
    T_field, T_image : (3, 3) arrays
        Normalisation of the field's and of the picture's points; the rows are those of ``T_image H T_field^-1``.
    """
    by_points = _cross_rows(lift(field_points) @ T_field.T, lift(image_points) @ T_image.T)
    a, b = _unit(transform_lines(T_field, field_lines)), _unit(transform_lines(T_image, image_lines))
    # a ~ H^T b: unknown H^T in row-major order, then transposed back to H's order
    order = np.arange(9).reshape(3, 3).T.ravel()
    return np.concatenate([by_points, _cross_rows(b, a)[..., order]])


def scale_homography(H: ArrayLike) -> Array:
    """Scale to ``H[2, 2] = 1`` (w = 1 at the field's origin); by norm where that entry vanishes."""
    H = np.asarray(H, dtype=np.float64)
    return H / H[2, 2] if abs(H[2, 2]) > 1e-12 * np.linalg.norm(H) else H / np.linalg.norm(H)


def is_invertible(H: ArrayLike) -> bool:
    """Whether a matrix (3, 3) maps both ways: not that of a camera in the plane, which sees it as one line."""
    return bool(np.linalg.cond(np.asarray(H, dtype=np.float64)) < _WORST_CONDITION)


def homography_from_circle(
    conic: ArrayLike,
    center: ArrayLike,
    image_line: ArrayLike,
    field_center: ArrayLike,
    radius: float,
    field_direction: ArrayLike,
) -> Array | None:
    """Closed form of case 1: a circle, its imaged centre and one line of known direction.

    The conic is scaled so that ``c^T E c = -r^2``; two vectors of the plane ``{x : (E c)^T x = 0}`` that are
    orthonormal for E are the images of two orthogonal unit directions, and with the centre they are the columns of H.
    The line fixes the rotation. No linear system is solved, which makes it an independent check of the correspondences
    and the DLT.

    Parameters
    ----------
    conic : (3, 3) array
        Image of the circle.
    center : (3,) array
        Imaged centre, inside the ellipse.
    image_line : (3,) array
        Image of a line of known direction.
    field_center : (2,) array
        Centre of the circle on the field.
    radius : float
        Its radius.
    field_direction : (2,) array
        Direction of the line on the field.

    Returns
    -------
    (3, 3) array or None
        ``H_image_field`` with positive determinant, up to the 180 degree turn about the circle's centre. None where the
        centre lies outside.
    """
    e = np.asarray(conic, dtype=np.float64)
    c = np.asarray(center, dtype=np.float64)
    level = c @ e @ c
    if level == 0 or not np.isfinite(level):
        return None
    e = e * (-(radius**2) / level)
    vanishing = e @ c
    v1 = meet(image_line, vanishing)
    v2 = np.cross(vanishing, e @ v1)
    n1, n2 = v1 @ e @ v1, v2 @ e @ v2
    if n1 <= 0 or n2 <= 0:
        return None
    direction = _unit(np.asarray(field_direction, dtype=np.float64))
    across = np.array([-direction[1], direction[0]])
    # v1, v2 image the unit vectors along the line and across it
    world_from_local = np.array([[direction[0], across[0], 0.0], [direction[1], across[1], 0.0], [0.0, 0.0, 1.0]])
    columns = np.stack([v1 / np.sqrt(n1), v2 / np.sqrt(n2), c], axis=-1)
    if np.linalg.det(columns) * np.sign(c[2]) < 0:
        columns[:, 1] *= -1
    o = np.asarray(field_center, dtype=np.float64)
    shift = np.array([[1.0, 0.0, -o[0]], [0.0, 1.0, -o[1]], [0.0, 0.0, 1.0]])
    return scale_homography(columns @ world_from_local.T @ shift)


def turn_homography(H: ArrayLike, center: ArrayLike) -> Array:
    """The other solution: the field turned by 180 degrees about ``center`` (2,)."""
    x, y = np.asarray(center, dtype=np.float64)
    return scale_homography(
        np.asarray(H, dtype=np.float64) @ np.array([[-1.0, 0.0, 2 * x], [0.0, -1.0, 2 * y], [0.0, 0.0, 1.0]])
    )


Side = Literal["main", "opposite", "left_goal", "right_goal"]
SIDES = {
    "main": (0.0, 1.0),
    "opposite": (0.0, -1.0),
    "left_goal": (-1.0, 0.0),
    "right_goal": (1.0, 0.0),
}
"""Direction on the field to each side on which a camera can stand."""


def side_of_place(position_m: ArrayLike) -> Side:
    """The side of the field on which a camera at ``position_m`` (3,) or (2,) stands, metres from the centre mark."""
    x, y = np.asarray(position_m, dtype=np.float64)[:2]
    side: Side = max(get_args(Side), key=lambda name: x * SIDES[name][0] + y * SIDES[name][1])
    return side


def camera_side_of(H: ArrayLike, side: str, seen_m: ArrayLike) -> float:
    """Positive where the camera stands on the named side (main: towards larger y, left_goal: towards smaller x, ...) of
    a field point ``seen_m`` (2,) that it sees.

    Depth falls towards the camera, so the sign follows from the gradient of w over the field and from the sign of w at
    that point, which is in front of the camera; its size is that of the gradient.
    """
    H = np.asarray(H, dtype=np.float64)
    gradient = H[2, :2] * (np.sign(H[2] @ lift(seen_m)) or 1.0)
    return float(-gradient @ SIDES[side])


def transfer_errors(H: ArrayLike, field_points: ArrayLike, image_points: ArrayLike) -> Array:
    """Distance (N,) in the image between mapped field points and their images."""
    return np.asarray(np.linalg.norm(apply_homography(H, field_points) - np.asarray(image_points), axis=-1))


def projects_in_front(H: ArrayLike, points: ArrayLike) -> bool:
    """Whether every field point (N, 2) has the same sign of w, i.e. none lies behind the camera."""
    w = (lift(points) @ np.asarray(H, dtype=np.float64).T)[:, 2]
    return bool(np.all(w > 0) or np.all(w < 0))


_COMPASS = ("right", "bottom_right", "bottom", "bottom_left", "left", "top_left", "top", "top_right")


def compass_label(outward: ArrayLike) -> str:
    """Name of a direction (2,) on the field as the main camera sees it (top = far), or its angle beside the eight."""
    x, y = np.asarray(outward, dtype=np.float64)
    angle = float(np.degrees(np.arctan2(y, x))) % 360.0
    sector = round(angle / 45.0)
    return _COMPASS[sector % 8] if abs(angle - 45.0 * sector) < 0.5 else f"deg_{angle:.0f}"
