"""Observations as residuals: each point is compared with the nearest point of its marking, along the marking's normal
in the picture.

The nearest point is a hidden parameter per point (an angle on a circle, a distance along a line); at the nearest
point the residual does not depend on it to first order, so it is
re-estimated beside the camera and never enters the normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera_fit.model import INDEX, Frame, project, project_pixels
from circlecal.geometry.homogeneous import Array, Indices, Mask


@dataclass(frozen=True, slots=True)
class CurvePoints:
    """N points on circles and straight lines, ready for the optimiser.

    Attributes
    ----------
    points_px : (N, 2) array, sigma_px : (N,) array
        Pixels as stored, and their standard deviations along the normal.
    origin : (N, 2) array
        Centre of the circle, or a point of the line, metres.
    radius : (N,) array
        Radius with the template's marking width; 0 for lines.
    radius_by_width : (N,) array
        How much the radius grows per metre of marking width (0.5, 0, -0.5 relative to the named edge).
    bloom_sign : (N,) array
        +1 on an outer edge, -1 on an inner one, 0 on a centreline.
    direction : (N, 2) array
        Unit direction of the line; zero for circles.
    shift : (N, 3, 2) array
        How much a line moves per metre of marking width, of length and of breadth of the field.
    group : (N,) int array
        Index into ``names``.
    names : tuple of str
        One per observed marking.
    """

    points_px: Array
    sigma_px: Array
    origin: Array
    radius: Array
    radius_by_width: Array
    bloom_sign: Array
    direction: Array
    shift: Array
    group: Indices
    names: tuple[str, ...]

    def select(self, keep: Indices) -> CurvePoints:
        """The points at an index or mask."""
        chosen = {name: getattr(self, name)[keep] for name in CurvePoints.__slots__ if name != "names"}
        return replace(self, **chosen)

    def with_sigma(self, sigma_px: Array) -> CurvePoints:
        """The same points with other standard deviations."""
        return replace(self, sigma_px=sigma_px)


def stack_curves(parts: list[CurvePoints]) -> CurvePoints:
    """One set from several, each of one marking."""
    names = tuple(name for part in parts for name in part.names)
    group = (
        np.concatenate([np.full(len(part.points_px), k) for k, part in enumerate(parts)]) if parts else np.zeros(0, int)
    )
    fields = [name for name in CurvePoints.__slots__ if name not in ("names", "group")]
    empty = {"points_px": (0, 2), "origin": (0, 2), "direction": (0, 2), "shift": (0, 3, 2)}
    stacked = {
        name: np.concatenate([getattr(part, name) for part in parts]) if parts else np.zeros(empty.get(name, (0,)))
        for name in fields
    }
    return CurvePoints(**stacked, group=group, names=names)


def circle_curve(
    name: str,
    points_px: Array,
    sigma_px: Array,
    center: Array,
    radius: float,
    radius_by_width: float,
    bloom_sign: float,
) -> CurvePoints:
    """Points of one edge of a circle."""
    n = len(points_px)
    full = np.full(n, 1.0)
    return CurvePoints(
        points_px, sigma_px, np.tile(center, (n, 1)), radius * full, radius_by_width * full, bloom_sign * full,
        np.zeros((n, 2)), np.zeros((n, 3, 2)), np.zeros(n, dtype=int), (name,),
    )  # fmt: skip


def line_curve(name: str, points_px: Array, sigma_px: Array, ends_m: Array, shift: Array) -> CurvePoints:
    """Points of the centreline of a straight marking with its ends (2, 2) and its shift (3, 2) by the sizes of the
    field.
    """
    n = len(points_px)
    direction = (ends_m[1] - ends_m[0]) / np.linalg.norm(ends_m[1] - ends_m[0])
    zero = np.zeros(n)
    return CurvePoints(
        points_px, sigma_px, np.tile(ends_m[0], (n, 1)), zero, zero, zero,
        np.tile(direction, (n, 1)), np.tile(shift, (n, 1, 1)), np.zeros(n, dtype=int), (name,),
    )  # fmt: skip


SIZES = [INDEX["width"], INDEX["length"], INDEX["breadth"]]
"""Parameters that move the markings on the field rather than the camera."""


def curve_points(curves: CurvePoints, hidden: Array, theta: Array) -> tuple[Array, Array]:
    """Field points (B, N, 2) at the hidden parameters (B, N), and the unit tangents there, with the sizes of theta
    (B, P).
    """
    radius = curves.radius + curves.radius_by_width * theta[:, SIZES[:1]]
    cos, sin = np.cos(hidden), np.sin(hidden)
    outward = np.stack([cos, sin], axis=-1)
    straight = (curves.radius == 0)[:, None]
    moved = np.einsum("bs,nsi->bni", theta[:, SIZES], curves.shift)
    on_line = curves.origin + hidden[..., None] * curves.direction + moved
    points = np.where(straight, on_line, curves.origin + radius[..., None] * outward)
    tangents = np.where(straight, curves.direction, np.stack([-sin, cos], axis=-1))
    return points, tangents


@dataclass(frozen=True, slots=True)
class Residuals:
    """Normalised residuals (B, N), their Jacobian (B, N, P), the hidden parameters (B, N), and who is behind the
    camera (B, N).
    """

    values: Array
    jacobian: Array
    hidden: Array
    behind: Mask


def first_hidden(curves: CurvePoints, theta: Array, frame: Frame, samples: int = 72) -> tuple[Array, Array]:
    """Hidden parameters (B, N) of the nearest of some samples of each marking, and the distances there (B, N) in
    pixels.

    Far starts need no good guess.
    """
    B, N = len(theta), len(curves.points_px)
    best = np.zeros((B, N))
    straight = curves.radius == 0
    grid = np.where(
        straight[:, None],
        np.linspace(0.0, 110.0, samples)[None],
        np.linspace(0.0, 2 * np.pi, samples, endpoint=False)[None],
    )
    nearest = np.full((B, N), np.inf)
    for k in range(samples):  # a loop over samples of the curve, not over points
        hidden = np.broadcast_to(grid[:, k], (B, N))
        field, _ = curve_points(curves, hidden, theta)
        seen = project_pixels(theta, field, frame)
        offset = seen.pixels - curves.points_px
        distance = np.where(seen.depth > 0.1, offset[..., 0] ** 2 + offset[..., 1] ** 2, np.inf)
        closer = distance < nearest
        nearest, best = np.where(closer, distance, nearest), np.where(closer, hidden, best)
    return best, np.sqrt(nearest)


def curve_residuals(curves: CurvePoints, theta: Array, hidden: Array, frame: Frame, updates: int = 2) -> Residuals:
    """Signed distances over sigma along the markings' normals, after moving the hidden parameters to the nearest
    points.

    Parameters
    ----------
    curves : CurvePoints
        N points.
    theta : (B, P) array
        Parameter vectors.
    hidden : (B, N) array
        Where the nearest points were last.
    frame : Frame
        Picture size and crown.
    updates : int
        Newton steps of the hidden parameters.
    """
    scale = np.where(curves.radius == 0, 1.0, np.maximum(curves.radius, 1e-9))
    limit = np.where(curves.radius == 0, 20.0, 0.5)
    for _ in range(updates):
        field, tangent = curve_points(curves, hidden, theta)
        near = project_pixels(theta, field, frame, derivative=True)
        along = _applied(near.by_field, tangent)
        difference = curves.points_px - near.pixels
        length2 = np.maximum(along[..., 0] ** 2 + along[..., 1] ** 2, 1e-18)
        move = (difference[..., 0] * along[..., 0] + difference[..., 1] * along[..., 1]) / (length2 * scale)
        hidden = hidden + np.clip(move, -limit, limit)
    field, tangent = curve_points(curves, hidden, theta)
    seen = project(theta, field, frame)
    along = _applied(seen.by_field, tangent)
    along = along / np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-9)[..., None]
    difference = curves.points_px - seen.pixels
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    # the normal's positive side is the outside of a circle
    outward = _applied(seen.by_field, field - curves.origin)
    inside_out = (np.sum(normal * outward, axis=-1) < 0) & (curves.radius > 0)
    normal = np.where(inside_out[..., None], -normal, normal)
    sigma = curves.sigma_px
    values = (np.sum(normal * difference, axis=-1) - curves.bloom_sign * theta[:, INDEX["bloom"], None]) / sigma
    jacobian = -(normal[..., 0, None] * seen.by_theta[..., 0, :] + normal[..., 1, None] * seen.by_theta[..., 1, :])
    by_sizes = np.broadcast_to(curves.shift, (*field.shape[:2], 3, 2)).copy()
    radius = np.where(curves.radius == 0, 1.0, curves.radius + curves.radius_by_width * theta[:, SIZES[:1]])
    by_sizes[..., 0, :] += (field - curves.origin) * (curves.radius_by_width / radius)[..., None]
    jacobian[..., SIZES] = -np.einsum("bni,bnij,bnsj->bns", normal, seen.by_field, by_sizes)
    jacobian[..., INDEX["bloom"]] = -curves.bloom_sign
    jacobian /= sigma[None, :, None]
    return Residuals(values, jacobian, hidden, seen.depth < 0.1)


def _applied(matrices: Array | None, vectors: Array) -> Array:
    """2 x 2 matrices (B, N, 2, 2) times vectors (B or 1, N, 2)."""
    assert matrices is not None
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([matrices[..., i, 0] * x + matrices[..., i, 1] * y for i in range(2)], axis=-1)


@dataclass(frozen=True, slots=True)
class FixedPoints:
    """M points of known field position: ``field_m`` (M, 2), ``points_px`` (M, 2), ``sigma_px`` (M,), their names."""

    field_m: Array
    points_px: Array
    sigma_px: Array
    names: tuple[str, ...]


def point_residuals(points: FixedPoints, theta: Array, frame: Frame) -> tuple[Array, Array]:
    """Normalised residuals (B, 2 M) of fixed points and their Jacobian (B, 2 M, P)."""
    B, M = len(theta), len(points.points_px)
    seen = project(theta, np.broadcast_to(points.field_m, (B, M, 2)), frame)
    values = (points.points_px - seen.pixels) / points.sigma_px[:, None]
    jacobian = -seen.by_theta / points.sigma_px[:, None, None]
    return values.reshape(B, 2 * M), jacobian.reshape(B, 2 * M, theta.shape[1])
