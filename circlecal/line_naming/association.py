"""Which marking of the template is which straight line of the picture.

After a first camera from circle and halfway line every other line is predicted with a covariance that is long in one or
two directions (focal length against distance and height). Each plausible pair of a seen and a template's line is tried
as a seed: it updates the camera linearly, as a Kalman filter would, and the others are matched under the new camera,
nearest first. The seed that explains most seen length at the least cost wins; where another seed explains about as much
in another way, nothing is named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from circlecal.camera.residuals import CurvePoints, curve_points, curve_residuals, ground_feet, nearest_feet
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, LOG_FOCAL, ProjectionModel, project
from circlecal.geometry.projective import Array, Indices, Mask
from circlecal.observations import MarkingKey

MOST_SEEDS, SEEDS_OF_ONE = 24, 8
"""How many seeds are grown, and how many where only the best hypothesis is wanted: the longest lines."""
LARGEST_SEED_COST, LARGEST_MATCH_COST = 36.0, 16.0
"""Largest squared Mahalanobis distance (two degrees of freedom) of a seed from a camera that may be far off, six
standard deviations; and of a further match under a camera that a seed has corrected, four.
"""
PX_PER_COST = 12.0
"""Pixels of explained line that one unit of squared Mahalanobis distance outweighs in a hypothesis' score."""
PX_PER_MATCH_COST = 4.0
"""Pixels of line that one unit of squared Mahalanobis distance outweighs where the next match is chosen: mostly the
longest line comes first, since it corrects the camera most.
"""
FARTHEST_MATCH_SIGMAS, SAME_LINE_SIGMAS = 25.0, 4.0
"""How far a new line may lie from its predicted marking, and how far another piece of a marking that has a line
already, root mean square over both ends in standard deviations of a seen line: a piece of one line lies on it, whatever
the camera.
"""
SIZE_SIGMAS = 2.0
"""Standard deviations of the field's length and breadth by which a new line may lie farther than that: on a field of
any size the front of a penalty area is 5 m from where the usual one has it.
"""
EXTENT_SLACK_SHARE, EXTENT_SLACK_M, EXTENT_SIGMAS = 0.15, 3.0, 2.0
"""How far a seen line may reach beyond its predicted marking, in lengths of the marking plus metres plus standard
deviations of the field's sizes: an uncertain camera slides along a line, too, and a penalty area along and across its
own lines.
"""
UPDATES, LARGEST_ZOOM = 3, 1.0
"""Steps of a camera towards one line taken for one marking, and by how much they may change the logarithm of its focal
length.
"""
ROUGHLY_BEYOND_RULES_M = 3.0
"""Metres by which names may make a field smaller or larger than the rules of its sport allow: a rough fit is a metre
or two off.
"""
_SIZES = [INDEX[name] for name in ("width", "length", "breadth")]
EXTENTS = [INDEX[name] for name in ("length", "breadth")]
"""Indices of the parameters that tell the size of the field."""


@dataclass(frozen=True, slots=True)
class Association:
    """Names by index of the seen line, the summed length in pixels that they explain, and the squared Mahalanobis
    cost.
    """

    names: dict[int, str]
    length_px: float
    cost: float

    @property
    def score(self) -> float:
        """Explained length less what the squared Mahalanobis distances cost."""
        return self.length_px - PX_PER_COST * self.cost

    def contradicts(self, other: Association) -> bool:
        """Whether the two name one seen line differently, or give one name to different lines only."""
        if any(other.names.get(k, name) != name for k, name in self.names.items()):
            return True
        shared = {name for _, name in set(self.names.items()) & set(other.names.items())}
        return bool(set(self.names.values()) & set(other.names.values()) - shared)


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Residuals (..., S, T, 2) of the ends of S seen lines against T template lines, Jacobians (..., S, T, 2, P), and
    which pairs lie on the marking's extent; before one camera, or each of several.
    """

    residuals: Array
    jacobians: Array
    on_marking: Mask

    def __iter__(self) -> Iterator[_Pairs]:
        """Those before each camera."""
        return map(_Pairs, self.residuals, self.jacobians, self.on_marking)


def associate_lines(
    segments: Array,
    template: FieldTemplate,
    excluded: tuple[str, ...],
    cameras: tuple[Array, Array, ProjectionModel],
    sigma_px: float,
    count: int = 6,
    elsewhere: frozenset[tuple[int, str]] = frozenset(),
    asked: Mask | None = None,
) -> list[list[Association]]:
    """Name seen lines in the most plausible ways.

    Parameters
    ----------
    segments : (S, 2, 2) array
        Ends of the seen lines, pixels as stored.
    template : FieldTemplate
        The field.
    excluded : tuple of str
        Template lines that are known already.
    cameras : tuple of (C, P) array, (C, P, P) array, ProjectionModel
        Cameras under each of which the lines are named, their covariances, and the picture size.
    sigma_px : float
        How well a seen line follows the straight line between its ends (lens, measuring).
    count : int
        How many different hypotheses are returned.
    elsewhere : frozenset of (int, str)
        Names that a seen line cannot have, since that marking is known to run elsewhere.
    asked : (C, S) bool, optional
        Lines of which one must come near a marking for any line to be named.

    Returns
    -------
    list of list of Association
        Under each camera, best first; empty where nothing fits.
    """
    thetas, covariances, model = cameras
    drawn = [k for k, line in enumerate(template.lines) if line.name not in excluded]
    names = [template.lines[k].name for k in drawn]
    if len(segments) == 0 or not names:
        return [[] for _ in thetas]
    ends, shifts = (geometry[drawn] for geometry in template.drawn_lines)
    slide_m = EXTENT_SIGMAS * _slide_sd(shifts, covariances[:, None, _SIZES][..., _SIZES])
    pairs = _pairs(segments, ends, shifts, thetas, model, slide_m)
    limits = _limits_of_sizes(template) - thetas[:, EXTENTS, None]
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    may_seed = np.zeros(pairs.on_marking.shape, dtype=np.bool_)
    for c, own in enumerate(pairs):
        cost, growth = _innovate(own.residuals[None], own.jacobians, covariances[[c]], sigma_px)
        may_seed[c] = (cost[0] < LARGEST_SEED_COST) & _lie_within(growth[0], limits[c])
    if asked is not None:
        may_seed &= (may_seed & asked[..., None]).any(axis=(1, 2), keepdims=True)
    off = np.argwhere(may_seed & ~pairs.on_marking)
    if len(off):
        of_pair = thetas[off[:, 0]], covariances[off[:, 0]], model
        pairs.on_marking[tuple(off.T)] = _lie_on_under_own(off[:, 1:], segments, ends, shifts, of_pair, sigma_px)
    for s, name in elsewhere:
        if name in names:
            pairs.on_marking[:, s, names.index(name)] = False
    found: list[list[Association]] = []
    for c, own in enumerate(pairs):
        seeds = np.argwhere(own.on_marking & may_seed[c])
        seeds = seeds[np.argsort(-lengths[seeds[:, 0]], kind="stable")][: MOST_SEEDS if count > 1 else SEEDS_OF_ONE]
        grown = _grow(seeds, own, lengths, covariances[c], limits[c], sigma_px) if len(seeds) else None
        found.append([] if grown is None else _list_different(*grown, names, lengths)[:count])
    return found


def _list_different(chosen: Indices, costs: Array, names: list[str], lengths: Array) -> list[Association]:
    """Different associations, best first, from the template line of each seen line (K, S), -1 for none, and costs."""
    different: dict[frozenset[tuple[int, str]], Association] = {}
    for row, total in zip(chosen, costs, strict=True):
        named = {int(s): names[row[s]] for s in np.flatnonzero(row >= 0)}
        found = Association(named, float(lengths[list(named)].sum()), float(total))
        known = different.setdefault(frozenset(named.items()), found)
        if found.score > known.score:
            different[frozenset(named.items())] = found
    return sorted(different.values(), key=lambda a: a.score, reverse=True)


def _slide_sd(shifts: Array, sizes: Array) -> Array:
    """Standard deviation (..., T), metres, of how far the field's sizes move each marking, by shifts (T, 3, 2) and the
    covariances of the sizes (..., T or 1, 3, 3): along itself, or across, which at a slant moves the nearest point
    along it as far.
    """
    variance = ((np.swapaxes(shifts, 1, 2) @ sizes) * np.swapaxes(shifts, 1, 2)).sum(axis=(-2, -1))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _pairs(
    segments: Array, ends: Array, shifts: Array, thetas: Array, model: ProjectionModel, slide_m: Array
) -> _Pairs:
    """All pairs before each camera (C, P); a line may reach beyond its marking by the usual slack and as far as that
    may slide (C, T), metres.
    """
    C, S, T = len(thetas), len(segments), len(ends)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    curves = _points_on(np.tile(segments.reshape(-1, 2), (T, 1)), ends, shifts, np.repeat(np.arange(T), 2 * S))
    seen = curve_residuals(curves, thetas, ground_feet(curves, thetas, model), model, updates=0)
    feet = seen.feet.reshape(C, T, S, 2)
    on_marking = lie_on_extent(feet, lengths[:, None, None], slide_m[..., None, None])
    on_marking &= _are_visible(curves, seen.feet, thetas, model).reshape(C, T, S, 2).all(axis=-1)
    return _Pairs(
        np.swapaxes(seen.values.reshape(C, T, S, 2), 1, 2),
        np.ascontiguousarray(np.swapaxes(seen.jacobian.reshape(C, T, S, 2, -1), 1, 2)),
        np.swapaxes(on_marking, 1, 2),
    )


def lie_on_extent(feet: Array, lengths: Array, slide_m: Array | float = 0.0) -> Mask:
    """Whether both ends (..., 2) of seen lines, metres along markings of some lengths, lie about on these, which may
    slide by so much.
    """
    slack = EXTENT_SLACK_SHARE * lengths + EXTENT_SLACK_M + slide_m
    return np.asarray(((feet > -slack) & (feet < lengths + slack)).all(axis=-1), np.bool_)


def _lie_on_under_own(
    pairs: Indices,
    segments: Array,
    ends: Array,
    shifts: Array,
    camera: tuple[Array, Array, ProjectionModel],
    sigma_px: float,
) -> Mask:
    """Whether lines lie on the extents of markings (K, 2: which line, which marking) under the cameras that each pair
    implies alone, by an iterated Kalman update (Bell and Cathey 1993) of a camera (K, P) with its covariance (K, P, P).

    Under a first camera of circle and halfway line the far end of a penalty area's front seemed 25 m beyond it that
    lies on its corner: the line itself tells how far the ground is stretched there.
    """
    theta, covariance, model = camera
    seen, drawn = pairs.T
    # each camera sees its own pair only: both ends of one line
    curves = _ends_on(segments[seen], ends[drawn], shifts[drawn])
    cameras = theta
    for _ in range(UPDATES):
        fit = curve_residuals(curves, cameras, ground_feet(curves, cameras, model), model, updates=1)
        J = fit.jacobian
        r = fit.values - (J @ (cameras - theta)[..., None])[..., 0]
        pushed, inverse = _push(J, covariance, sigma_px)
        cameras = theta - (np.swapaxes(pushed, 1, 2) @ (inverse @ r[..., None]))[..., 0]
        # no linear model reaches so far
        is_near = np.isfinite(cameras).all(axis=1) & (np.abs(cameras - theta)[:, LOG_FOCAL] < LARGEST_ZOOM)
        cameras = np.where(is_near[:, None], cameras, theta)
    feet = nearest_feet(curves, cameras, ground_feet(curves, cameras, model), model, updates=1)
    lengths = np.linalg.norm(ends[drawn, 1] - ends[drawn, 0], axis=-1)
    known = pushed[..., _SIZES]
    sizes = covariance[:, _SIZES][..., _SIZES] - np.swapaxes(known, 1, 2) @ inverse @ known
    slide_m = EXTENT_SIGMAS * _slide_sd(shifts[drawn], sizes)
    on_extent = lie_on_extent(feet, lengths[:, None], slide_m[:, None])
    is_visible = _are_visible(curves, feet, cameras, model).all(axis=-1)
    return np.asarray(on_extent & is_visible & is_near)


def _are_visible(curves: CurvePoints, feet: Array, cameras: Array, model: ProjectionModel) -> Mask:
    """Whether places (B, N) on markings are seen by cameras (B, P): beyond where a barrel lens folds back, markings far
    aside of the picture seem to run through it.
    """
    places, _ = curve_points(curves, feet, cameras)
    return project(cameras, places, model).visible


def _points_on(points_px: Array, ends: Array, shifts: Array, group: Indices) -> CurvePoints:
    """Points (N, 2) of T lines with these ends (T, 2, 2), by the number of each one's line (N,)."""
    span, zero = ends[:, 1] - ends[:, 0], np.zeros(len(group))
    lengths = np.hypot(span[:, 0], span[:, 1])
    return CurvePoints(
        points_px, zero + 1.0, ends[group, 0], zero, zero, zero, (span / lengths[:, None])[group], shifts[group],
        group, (MarkingKey(""),) * len(ends),
    )  # fmt: skip


def _ends_on(segments: Array, ends: Array, shifts: Array) -> CurvePoints:
    """Both ends of K segments (K, 2, 2), each of them on a line of its own with these ends (K, 2, 2): K hypotheses."""
    span, zero = ends[:, 1] - ends[:, 0], np.zeros(2)
    direction = span / np.hypot(span[:, 0], span[:, 1])[:, None]
    origins, directions, moves = (np.repeat(v[:, None], 2, axis=1) for v in (ends[:, 0], direction, shifts))
    return CurvePoints(
        segments, zero + 1.0, origins, zero, zero, zero, directions, moves, np.zeros(2, np.int64), (MarkingKey(""),)
    )


def has_allowed_size(theta: Array, template: FieldTemplate) -> Mask:
    """Whether the fields of cameras (..., P) are about as long and as broad as the rules allow."""
    return _lie_within(theta[..., EXTENTS], _limits_of_sizes(template))


def _limits_of_sizes(template: FieldTemplate) -> Array:
    """Least and largest (2, 2) of the parameters length and breadth of fields that may be told by names."""
    ranges = [(np.array(e.range_m or (-np.inf, np.inf)) - e.size_m) for e in template.extents]
    return np.array(ranges) + np.array([-ROUGHLY_BEYOND_RULES_M, ROUGHLY_BEYOND_RULES_M])


def _lie_within(sizes: Array, limits: Array) -> Mask:
    """Whether both sizes (..., 2) lie within their limits (2, 2)."""
    return np.asarray(((sizes > limits[..., 0]) & (sizes < limits[..., 1])).all(axis=-1), np.bool_)


def _innovate(residuals: Array, jacobians: Array, covariances: Array, sigma_px: float) -> tuple[Array, Array]:
    """Squared Mahalanobis lengths (K, S, T) of residuals (K, S, T, 2) with Jacobians (S, T, 2, P) under K covariances,
    and by how much each would change length and breadth of the field (K, S, T, 2).
    """
    flat = jacobians.reshape(-1, jacobians.shape[-1])
    pushed = (flat @ covariances).reshape(len(covariances), *jacobians.shape)
    # each end stands for half of a segment
    own = 0.5 * sigma_px**2
    a = np.einsum("kstp,stp->kst", pushed[..., 0, :], jacobians[:, :, 0]) + own
    b = np.einsum("kstp,stp->kst", pushed[..., 0, :], jacobians[:, :, 1])
    d = np.einsum("kstp,stp->kst", pushed[..., 1, :], jacobians[:, :, 1]) + own
    x, y = residuals[..., 0], residuals[..., 1]
    determinant = np.maximum(a * d - b * b, own * own)
    weighed = np.stack([d * x - b * y, a * y - b * x], axis=-1) / determinant[..., None]
    cost = (weighed * residuals).sum(axis=-1)
    growth = -np.einsum("kste,kstep->kstp", weighed, pushed[..., EXTENTS])
    return np.asarray(cost), np.asarray(growth)


def _size_sd(jacobians: Array, covariances: Array) -> Array:
    """How far length and breadth of the field, as uncertain as K covariances have them, move the ends of seen lines
    against template lines (K, S, T), root mean square, pixels.
    """
    own = jacobians[..., EXTENTS]
    variance = np.einsum("step,kpq,steq->kst", own, covariances[:, EXTENTS][..., EXTENTS], own)
    return np.asarray(np.sqrt(np.maximum(0.5 * variance, 0.0)))


def _push(jacobians: Array, covariances: Array, sigma_px: float) -> tuple[Array, Array]:
    """What a Kalman update by both ends of K seen lines needs: their Jacobians (K, 2, P) times covariances (P, P), or
    (K, P, P), and the inverses (K, 2, 2) of the covariances of their residuals.
    """
    pushed, own = jacobians @ covariances, 0.5 * sigma_px**2
    return pushed, _inverse(pushed @ np.swapaxes(jacobians, 1, 2) + own * np.eye(2), own)


def _inverse(matrices: Array, own: float) -> Array:
    """Inverses (K, 2, 2) of symmetric matrices that are no smaller than ``own`` times the unit matrix."""
    (a, b), (_, d) = np.moveaxis(matrices, 0, -1)
    adjugate = np.moveaxis(np.array([[d, -b], [-b, a]]), -1, 0)
    return np.asarray(adjugate / np.maximum(a * d - b * b, own * own)[:, None, None])


def _grow(
    seeds: Indices, pairs: _Pairs, lengths: Array, covariance: Array, limits: Array, sigma_px: float
) -> tuple[Indices, Array]:
    """From each seed (K, 2) on, match further lines under the camera that the matches so far imply, as long as the
    field's length and breadth stay within their limits (2, 2), told as changes.

    Returns the template line of each seen line, (K, S), -1 for none, and the squared Mahalanobis cost (K,).
    """
    K, (S, T) = len(seeds), pairs.on_marking.shape
    chosen, total = np.full((K, S), -1), np.zeros(K)
    residuals = np.broadcast_to(pairs.residuals, (K, S, T, 2)).copy()
    spread = np.broadcast_to(covariance, (K, *covariance.shape)).copy()
    growth = np.zeros((K, len(EXTENTS)))
    rows, s, t = np.arange(K), seeds[:, 0], seeds[:, 1]
    while len(rows):
        chosen[rows, s] = t
        J, r = pairs.jacobians[s, t], residuals[rows, s, t]
        pushed, inverse = _push(J, spread[rows], sigma_px)
        gain = inverse @ pushed
        total[rows] += (r * (inverse @ r[..., None])[..., 0]).sum(axis=1)
        step = -(np.swapaxes(gain, 1, 2) @ r[..., None])[..., 0]
        residuals[rows] += (step @ pairs.jacobians.reshape(-1, step.shape[1]).T).reshape(len(rows), S, T, 2)
        spread[rows] -= np.swapaxes(pushed, 1, 2) @ gain
        growth[rows] += step[:, EXTENTS]
        left = limits - growth[rows][:, None, None, :, None]
        rows, s, t = _next(rows, pairs, residuals[rows], spread[rows], chosen[rows], left, lengths, sigma_px)
    return chosen, total


def _next(
    rows: Indices, pairs: _Pairs, residuals: Array, spread: Array, chosen: Indices, limits: Array, lengths: Array,
    sigma_px: float,
) -> tuple[Indices, Indices, Indices]:  # fmt: skip
    """The next match of each hypothesis that has one, within what its limits leave (K, 1, 1, 2, 2)."""
    cost, growth = _innovate(residuals, pairs.jacobians, spread, sigma_px)
    offset = np.sqrt(np.mean(residuals**2, axis=-1))
    farthest = FARTHEST_MATCH_SIGMAS * sigma_px + SIZE_SIGMAS * _size_sd(pairs.jacobians, spread)
    fits = pairs.on_marking & (cost < LARGEST_MATCH_COST) & (offset < farthest)
    fits &= _lie_within(growth, limits)
    # a second piece of a known line must lie on it, a new line must be the only one that fits
    taken = (chosen[:, :, None] == np.arange(fits.shape[2])).any(axis=1)
    fits &= (chosen < 0)[:, :, None] & (~taken[:, None] | (offset < SAME_LINE_SIGMAS * sigma_px))
    fits &= fits.sum(axis=2, keepdims=True) == 1
    worth = np.where(fits, lengths[None, :, None] - PX_PER_MATCH_COST * cost, -np.inf).reshape(len(rows), -1)
    best = np.argmax(worth, axis=1)
    more = np.flatnonzero(fits.reshape(len(rows), -1)[np.arange(len(rows)), best])
    s, t = np.unravel_index(best[more], pairs.on_marking.shape)
    return rows[more], s, t
