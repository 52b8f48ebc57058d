"""Observations as residuals: each point is compared with the nearest point of its marking, along the marking's normal
in the picture.

Where the nearest point lies on its marking is one foot parameter per point: an angle on a circle, metres along a line.
At the nearest point the residual does not depend on it to first order, so the feet are moved beside the camera and
never enter the normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from circlecal.geometry.camera import NEAREST_M
from circlecal.geometry.camera_parameters import INDEX, Projection, ProjectionModel, level_points, project
from circlecal.geometry.projective import Array, Indices, Mask
from circlecal.observations import MarkingKey


@dataclass(frozen=True)
class CurvePoints:
    """N points on circles and straight lines, ready for the optimiser.

    ``points_px``, ``sigma_px``, ``origin``, ``direction`` and ``shift`` may run over a leading axis of B hypotheses
    about which line is which; :func:`sample_feet` and the methods know one only.

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
        How much a marking moves per metre of marking width, of length and of breadth of the field.
    group : (N,) int array
        Index into ``keys``.
    keys : tuple of MarkingKey
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
    keys: tuple[MarkingKey, ...]

    @cached_property
    def straight(self) -> Mask:
        """Which of the points (N,) are on lines."""
        return np.asarray(self.radius == 0, dtype=np.bool_)

    @cached_property
    def round_part(self) -> tuple[slice, Array | None]:
        """From the first to the last point on a circle, and 1 for those of them (K,) that are, 0 for others; None where
        all are.
        """
        on_circles = np.flatnonzero(~self.straight)
        part = slice(int(on_circles[0]), int(on_circles[-1]) + 1) if len(on_circles) else slice(0, 0)
        among = self.straight[part]
        return part, np.where(among, 0.0, 1.0) if among.any() else None

    @cached_property
    def scale(self) -> Array:
        """Metres (N,) per unit of the foot parameters."""
        return np.where(self.straight, 1.0, np.maximum(self.radius, 1e-9))

    @cached_property
    def has_lines(self) -> bool:
        """Whether any of the points is on a line."""
        return bool(self.straight.any())

    @cached_property
    def has_bloom(self) -> bool:
        """Whether any of the points is on an edge, which bloom moves."""
        return bool(self.bloom_sign.any())

    @cached_property
    def has_shifts(self) -> bool:
        """Whether the sizes of the field move any of the points' markings."""
        return bool(self.shift.any())

    @cached_property
    def largest_moves(self) -> Array:
        """Of the feet in one Newton step, to both sides (2, N)."""
        most = np.where(self.straight, *LARGEST_MOVE)
        return np.array([-most, most])

    @cached_property
    def rows(self) -> tuple[Array, Array, Array]:
        """Origin and direction (..., 2, N) and shift (..., 3, 2, N), each coordinate in one piece."""
        origin, direction = (np.swapaxes(v, -1, -2).copy() for v in (self.origin, self.direction))
        return origin, direction, np.moveaxis(self.shift, -3, -1).copy()

    @property
    def common_shift(self) -> Array:
        """By how much most markings move (2,): along x per metre of length and along y per metre of breadth; of lines
        only across them.
        """
        moves = np.stack([self.shift[:, 1, 0], self.shift[:, 2, 1]])
        across = np.stack([np.abs(self.direction[:, 0]) < 0.5, np.abs(self.direction[:, 1]) < 0.5])
        return np.array([np.median(m[a]) if a.any() else 0.0 for m, a in zip(moves, across, strict=True)])

    def select(self, keep: Indices) -> CurvePoints:
        """The points at an index or mask."""
        return replace(self, group=self.group[keep], **{name: getattr(self, name)[keep] for name in _BY_POINT})

    def hypotheses(self, index: Indices) -> CurvePoints:
        """Some of several hypotheses."""
        names = (*(("points_px",) if self.points_px.ndim > 2 else ()), "sigma_px", "origin", "direction", "shift")
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def with_sigma(self, sigma_px: Array) -> CurvePoints:
        """These points with other standard deviations."""
        return replace(self, sigma_px=sigma_px)


_BY_POINT = (
    "points_px", "sigma_px", "origin", "radius", "radius_by_width", "bloom_sign", "direction", "shift",
)  # fmt: skip


@dataclass(frozen=True)
class FixedPoints:
    """M points of known field position: ``field_m`` (M, 2), ``points_px`` (M, 2), ``sigma_px`` (M,), their keys.

    ``upright_px`` (M,) are their standard deviations along the picture's vertical, where the ground may be higher or
    lower than its profile; None where they do not differ from ``sigma_px``. ``shift`` (M, 3, 2) is how much each moves
    per metre of marking width, of length and of breadth of the field; None where none does.
    """

    field_m: Array
    points_px: Array
    sigma_px: Array
    keys: tuple[MarkingKey, ...]
    upright_px: Array | None = None
    shift: Array | None = None

    @cached_property
    def shift_twice(self) -> Array | None:
        """Shifts (3, 2, 2 M), each point twice; None where no point moves."""
        if self.shift is None or not self.shift.any():
            return None
        return np.repeat(np.moveaxis(self.shift, 0, -1), 2, axis=-1)

    @cached_property
    def twice(self) -> tuple[Array, Array]:
        """Places on the field and pixels (2, 2 M), each point twice."""
        return np.repeat(self.field_m.T, 2, axis=1), np.repeat(self.points_px.T, 2, axis=1)

    @property
    def sigmas_px(self) -> Array:
        """Standard deviations (M, 2) along x and along y."""
        return np.stack([self.sigma_px, self.sigma_px if self.upright_px is None else self.upright_px], axis=1)

    @cached_property
    def across(self) -> Array:
        """Image vectors (2, 2 M) along which the points count, each along x and along y, over sigma."""
        found = np.zeros((2, 2 * len(self.sigma_px)))
        found[0, 0::2], found[1, 1::2] = 1.0 / self.sigmas_px.T
        return found

    def select(self, keep: Mask) -> FixedPoints:
        """The points at a mask."""
        keys = tuple(key for key, kept in zip(self.keys, keep, strict=True) if kept)
        upright_px = None if self.upright_px is None else self.upright_px[keep]
        shift = None if self.shift is None else self.shift[keep]
        return FixedPoints(self.field_m[keep], self.points_px[keep], self.sigma_px[keep], keys, upright_px, shift)


NOT_MOVED = np.zeros((3, 2))
"""Shift of what the sizes of the field leave in its place."""
NO_POINTS = FixedPoints(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), ())


def stack_curves(parts: list[CurvePoints]) -> CurvePoints:
    """One set from several, each of one marking."""
    keys = tuple(key for part in parts for key in part.keys)
    group = (
        np.concatenate([np.full(len(part.points_px), k) for k, part in enumerate(parts)]) if parts else np.zeros(0, int)
    )
    empty = {"points_px": (0, 2), "origin": (0, 2), "direction": (0, 2), "shift": (0, 3, 2)}
    stacked = {
        name: np.concatenate([getattr(part, name) for part in parts]) if parts else np.zeros(empty.get(name, (0,)))
        for name in _BY_POINT
    }
    return CurvePoints(**stacked, group=group, keys=keys)


def join_curves(first: CurvePoints, second: CurvePoints) -> CurvePoints:
    """The markings of both."""
    stacked = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in _BY_POINT}
    group = np.concatenate([first.group, second.group + len(first.keys)])
    return CurvePoints(**stacked, group=group, keys=(*first.keys, *second.keys))


def circle_curve(
    key: MarkingKey,
    points_px: Array,
    sigma_px: Array,
    center: Array,
    radius: float,
    radius_by_width: float,
    bloom_sign: float,
    shift: Array | None = None,
) -> CurvePoints:
    """Points of one edge of a circle or an arc, whose centre moves with the sizes of the field by its shift (3, 2)."""
    n = len(points_px)
    full = np.full(n, 1.0)
    return CurvePoints(
        points_px, sigma_px, _to_each(n, center), radius * full, radius_by_width * full, bloom_sign * full,
        np.zeros((n, 2)), _to_each(n, NOT_MOVED if shift is None else shift), np.zeros(n, dtype=int), (key,),
    )  # fmt: skip


def line_curve(name: str, points_px: Array, sigma_px: Array, ends_m: Array, shift: Array) -> CurvePoints:
    """Points of the centreline of a straight marking with its ends (2, 2) and its shift (3, 2) by the sizes of the
    field.
    """
    n = len(points_px)
    direction = (ends_m[1] - ends_m[0]) / np.linalg.norm(ends_m[1] - ends_m[0])
    zero = np.zeros(n)
    return CurvePoints(
        points_px, sigma_px, _to_each(n, ends_m[0]), zero, zero, zero,
        _to_each(n, direction), _to_each(n, shift), np.zeros(n, dtype=int), (MarkingKey(name),),
    )  # fmt: skip


def _to_each(count: int, values: Array) -> Array:
    """What (...,) all points of a marking have, (count, ...)."""
    return np.repeat(values[None], count, axis=0)


NEAR_PX = 10.0
"""So far along a marking its bend is not felt across it: 0.1 px on a circle of 500 px radius."""
LARGEST_MOVE = (20.0, 0.5)
"""Of a foot in one Newton step: metres along a line, radians on a circle."""
FOOT_SAMPLES, LONGEST_LINE_M = 72, 110.0
"""Of each marking from which the nearest are taken, 5 degrees of a circle apart; and over which length of a line."""
SIZES = [INDEX["width"], INDEX["length"], INDEX["breadth"]]
"""Parameters that move the markings on the field rather than the camera."""


def curve_points(curves: CurvePoints, feet: Array, theta: Array) -> tuple[Array, Array]:
    """Field points (B, N, 2) at the foot parameters (B, N), and the unit tangents there, with the sizes of theta
    (B, P).
    """
    places, tangents, _ = _points_on_markings(curves, feet, theta)
    return np.swapaxes(places, 1, 2), np.swapaxes(tangents, 1, 2)


def _points_on_markings(
    curves: CurvePoints, feet: Array, theta: Array, points: FixedPoints = NO_POINTS
) -> tuple[Array, Array, Array]:
    """Field points at the foot parameters and the unit tangents there, (B, 2, N + 2 M), last each fixed point twice
    and without a tangent; and cosine and sine (B, 2, N): zero on lines.
    """
    origin, direction, shift = curves.rows
    B, N = feet.shape
    outward = np.zeros((B, 2, N))
    part, are_round = curves.round_part
    np.cos(feet[:, part], out=outward[:, 0, part])
    np.sin(feet[:, part], out=outward[:, 1, part])
    if are_round is not None:
        outward[:, :, part] *= are_round
    places, tangents = np.zeros((2, B, 2, N + 2 * len(points.sigma_px)))
    on_curves, at_points = places[..., :N], places[..., N:]
    sizes = theta[:, SIZES]
    if at_points.size:
        at_points[:] = points.twice[0]
        if points.shift_twice is not None and sizes.any():
            at_points += (sizes @ points.shift_twice.reshape(3, -1)).reshape(at_points.shape)
    radius = curves.radius + curves.radius_by_width * theta[:, INDEX["width"], None]
    np.multiply(radius[:, None], outward, out=on_curves)
    on_curves += origin
    if curves.has_lines:
        on_curves += feet[:, None] * direction
    if curves.has_shifts and sizes.any():
        on_curves += (sizes[:, None] @ shift.reshape(*shift.shape[:-3], 3, 2 * N)).reshape(B, 2, N)
    np.subtract(direction[..., 0, :], outward[:, 1], out=tangents[:, 0, :N])
    np.add(direction[..., 1, :], outward[:, 0], out=tangents[:, 1, :N])
    return places, tangents, outward


@dataclass(frozen=True, slots=True)
class Residuals:
    """Normalised residuals (B, N + 2 M), their Jacobian (B, N + 2 M, P), the foot parameters (B, N), which of them are
    of places that are not seen (B, N + 2 M), and how the residuals change per metre by which a marking lies elsewhere
    (B, 2, N + 2 M).

    Not seen is what lies behind the camera, and a fixed point where the lens folds back: feet move along their marking
    and come back from there.
    """

    values: Array
    jacobian: Array
    feet: Array
    behind: Mask
    by_place: Array


def sample_feet(curves: CurvePoints, theta: Array, model: ProjectionModel, samples: int = FOOT_SAMPLES) -> Array:
    """Foot parameters (B, N) of the nearest of some samples of each marking: far starts need no good guess."""
    if len(curves.points_px) == 0:
        return np.zeros((len(theta), 0))
    change = np.concatenate([[True], np.diff(curves.group) != 0])
    first, marking = np.flatnonzero(change), np.cumsum(change) - 1
    markings = curves.select(np.repeat(first, samples))
    shape = (len(first), samples)
    straight = (curves.radius[first] == 0)[:, None]
    turn = np.linspace(0.0, 2 * np.pi, samples, endpoint=False)
    grid = np.where(straight, np.linspace(0.0, LONGEST_LINE_M, samples), turn)
    places, *_ = _points_on_markings(markings, np.broadcast_to(grid.reshape(1, -1), (len(theta), grid.size)), theta)
    seen = project(theta, np.swapaxes(places, 1, 2), model)
    pixels = np.where(seen.visible[:, None], seen.xy, np.inf).reshape(len(theta), 2, *shape)
    nearest = np.empty((len(theta), len(curves.points_px)))
    for k in range(len(first)):
        index = np.flatnonzero(marking == k)
        offset_x = pixels[:, 0, k, None, :] - curves.points_px[index, 0, None]
        offset_y = pixels[:, 1, k, None, :] - curves.points_px[index, 1, None]
        nearest[:, index] = grid[k, np.argmin(offset_x * offset_x + offset_y * offset_y, axis=-1)]
    return nearest


def ground_feet(curves: CurvePoints, theta: Array, model: ProjectionModel) -> Array:
    """Foot parameters (B, N) of where the points lie on level ground: near enough to the nearest points for cameras
    that are nearly right.
    """
    x, y = np.moveaxis(level_points(theta, curves.points_px, model) - curves.origin, -1, 0)
    on_line = x * curves.direction[..., 0] + y * curves.direction[..., 1]
    return np.where(curves.radius > 0, np.arctan2(y, x), on_line)


def nearest_feet(curves: CurvePoints, theta: Array, feet: Array, model: ProjectionModel, updates: int = 2) -> Array:
    """The foot parameters (B, N) that :func:`curve_residuals` returns, which takes longer."""
    return _move_feet(curves, theta, feet, model, updates, NO_POINTS)[0]


def _move_feet(
    curves: CurvePoints, theta: Array, feet: Array, model: ProjectionModel, updates: int, points: FixedPoints
) -> tuple[Array, Projection, Array, Array, Array, Array]:
    """Foot parameters after so many Newton steps and one more, and what was seen before that: the projection, the
    pictures of the tangents (B, 2, N) and their lengths (B, N), the way from each place to its point (B, 2, N + 2 M),
    and cosine and sine of the feet (B, 2, N).
    """
    count = feet.shape[1]
    observed = np.empty((*curves.points_px.shape[:-2], 2, count + 2 * len(points.sigma_px)))
    observed[..., :count], observed[..., count:] = np.swapaxes(curves.points_px, -1, -2), points.twice[1]
    least, most = curves.largest_moves
    for step in range(updates + 2):
        places, tangents, outward = _points_on_markings(curves, feet, theta, points)
        seen = project(theta, places.swapaxes(1, 2), model)
        along = seen.along(tangents[:, 0], tangents[:, 1])[..., :count]
        along_x, along_y = along[:, 0], along[:, 1]
        difference = observed - seen.xy
        length2 = np.maximum(along_x * along_x + along_y * along_y, 1e-18)
        beside = difference[:, 0, :count] * along_x + difference[:, 1, :count] * along_y
        feet = feet + np.minimum(np.maximum(beside / (length2 * curves.scale), least), most)
        length = np.sqrt(length2)
        if step >= updates and (np.abs(beside) < NEAR_PX * length).all():
            break
    return feet, seen, along, length, difference, outward


def curve_residuals(
    curves: CurvePoints,
    theta: Array,
    feet: Array,
    model: ProjectionModel,
    updates: int = 2,
    points: FixedPoints = NO_POINTS,
) -> Residuals:
    """Signed distances over sigma along the markings' normals, after moving the foot parameters to the nearest
    points; then those of fixed points.

    Parameters
    ----------
    curves : CurvePoints
        N points.
    theta : (B, P) array
        Parameter vectors.
    feet : (B, N) array
        Where the nearest points were last.
    model : ProjectionModel
        Picture size and crown.
    updates : int
        Newton steps of the foot parameters before the residuals are taken, one more where the points then still lie
        far along the marking; the foot parameters that are returned are one step further.
    points : FixedPoints
        M points that are seen in the same view, each along x and along y.
    """
    feet, seen, along, length, difference, outward = _move_feet(curves, theta, feet, model, updates, points)
    count, (along_x, along_y) = feet.shape[1], (along[:, 0], along[:, 1])
    sigma = curves.sigma_px
    # the normal's positive side is the outside of a circle
    unit = np.where(curves.straight | seen.upward[:, :count], 1.0, -1.0) / (length * sigma)
    inward = np.empty_like(difference)
    np.multiply(along_y, -unit, out=inward[:, 0, :count])
    np.multiply(along_x, unit, out=inward[:, 1, :count])
    if len(points.sigma_px):
        inward[:, :, count:] = -points.across
    values = -(inward[:, 0] * difference[:, 0] + inward[:, 1] * difference[:, 1])
    rows, field = seen.gradient(inward)
    if curves.has_bloom:
        bloom = curves.bloom_sign / sigma
        values[:, :count] -= bloom * theta[:, INDEX["bloom"], None]
        rows[:, INDEX["bloom"], :count] = -bloom
    field_x, field_y, shift = field[:, :1, :count], field[:, 1:, :count], curves.rows[2]
    if curves.has_shifts:
        by_size = field_x * shift[..., 0, :] + field_y * shift[..., 1, :]
        rows[:, SIZES[0], :count], rows[:, SIZES[1] : SIZES[2] + 1, :count] = by_size[:, 0], by_size[:, 1:]
    if points.shift_twice is not None:
        by_size = (field[:, None, :, count:] * points.shift_twice).sum(axis=2)
        rows[:, SIZES[0], count:], rows[:, SIZES[1] : SIZES[2] + 1, count:] = by_size[:, 0], by_size[:, 1:]
    outside = field_x[:, 0] * outward[:, 0] + field_y[:, 0] * outward[:, 1]
    rows[:, SIZES[0], :count] += curves.radius_by_width * outside
    behind = seen.depth < NEAREST_M
    if len(points.sigma_px):
        behind[:, count:] = ~seen.visible[:, count:]
    return Residuals(values, rows.swapaxes(1, 2), feet, behind, field)
