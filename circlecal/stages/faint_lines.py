"""Straight markings too faint to be seen anywhere, but not in their sum: looked for where an uncertain camera may put
them.

One circle leaves focal length, distance and height to each other; every other marking is then predicted as a curve that
can be shifted and turned a little. A matched filter is summed along each such curve; the far touchline, a third of a
pixel wide, stands out of two thousand pixels where it does not in fifty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, project
from circlecal.geometry.projective import Array, fit_line, line_distance
from circlecal.line_naming.marking_places import lie_on_surface
from circlecal.paint.matched_filter import TAPS, paint_and_sides
from circlecal.paint.profiles import sample_profiles
from circlecal.results import CameraFit, LineCue, Segment

__all__ = ["find_faint_lines"]

WIDTH_PX = 2.0
"""Of the paint as blur leaves it, at 1920 px width, like all lengths here."""
SPACING_PX, JOINED = 4.0, 3
"""Distance of the profiles along a marking, and how many neighbours are averaged at once."""
NODES = 400
"""Along each marking of the template."""
SHORTEST_WIDTHS = 0.15
"""Shorter parts of a marking, picture widths, are not looked for."""
SIGMAS, LEAST_SHIFT_PX, LARGEST_SHIFT_PX = 3.5, 60.0, 160.0
"""How far a marking is shifted: standard deviations of its place, at least so far (what the others are compared with),
and no further.
"""
LEAST_TURN_PX, TURNS = 4.0, 20
"""How far its ends are turned at least, and in how many steps to either side at most."""
PIECE_PX = 240.0
"""Long pieces of the marking must each be lighter than both sides: a step in brightness is no marking."""
CLIPPED = 3.0
"""Single responses count up to so many standard deviations: players and captions are outliers."""
STANDING_OUT, RIVAL_SHARE, RIVAL_PX = 5.0, 0.5, 6.0
"""By how many standard deviations of the sums a marking must stand out, how much less any other place further off than
this may.
"""
MEASURED_PX, WITHIN_PX = 60.0, 3.0
"""A point is measured on each such piece, so near to the best shift."""
LEAST_SIGMA_PX = 0.3
"""Standard deviation of a measured point at least."""
FEWEST_POINTS = 8
"""Of a faint marking that is believed: so many pieces show it each by itself."""
SMOOTH_PX = 1.0
"""Scatter of the points about the gentle bend that lens and crown give a straight marking, at most: peaks of the
surface's own texture jump about.
"""
FEWEST_NODES = 3
"""Of a marking in the picture."""
_SIZES = [INDEX[name] for name in ("width", "length", "breadth")]


@dataclass(frozen=True, slots=True)
class _Course:
    """Where a camera puts a marking: places and normals (M, 2) in the picture, px, and how the marking moves along the
    normals with the two most uncertain combinations of the camera's parameters, (M, 2) px per standard deviation.
    """

    places: Array
    normals: Array
    modes: Array


@dataclass(frozen=True, slots=True)
class _Responses:
    """How much lighter each place is than its left and its right side (M, S), at shifts (S,) px along the normal; zero
    where the picture ends.
    """

    left: Array
    right: Array
    seen: NDArray[np.bool_]
    shifts: Array


def find_faint_lines(
    picture: NDArray[np.uint8],
    fit: CameraFit,
    template: FieldTemplate,
    surface: NDArray[np.bool_] | None = None,
) -> tuple[LineCue, ...]:
    """Straight markings other than the halfway line, where their sum along a curve stands out.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    fit : CameraFit
        An uncertain camera.
    template : FieldTemplate
        The field.
    surface : (h, w) bool, optional
        The playing surface in a reduced picture: where nothing stands out in all of the picture, it may there.

    Returns
    -------
    tuple of LineCue
        Without names: which marking it is shows only together with the others.
    """
    model = fit.model
    ends, shifts = template.drawn_lines
    found: list[LineCue] = []
    others = np.array([line.name != template.halfway_line for line in template.lines], dtype=np.bool_)
    for course in _courses(fit, model, ends[others], shifts[others]):
        shift = _best_shift(picture, None, course, model.width / 1920.0)
        if shift is None and surface is not None:
            shift = _best_shift(picture, surface, course, model.width / 1920.0)
        cue = None if shift is None else _measure(picture, course, shift, model.width / 1920.0)
        if cue is not None and not any(_are_same(cue, other, model.width / 1920.0) for other in found):
            found.append(cue)
    return tuple(found)


def _courses(fit: CameraFit, model: ProjectionModel, ends: Array, shifts: Array) -> Iterator[_Course]:
    """The parts in the picture of markings between two ends (K, 2, 2) that move with the field's sizes by shifts (K, 3,
    2); without those that are short.
    """
    starts, spans = ends[:, 0] + fit.theta[_SIZES] @ shifts, ends[:, 1] - ends[:, 0]
    share = np.linspace(0.0, 1.0, NODES)
    nodes = starts[:, None] + spans[:, None] * share[:, None]
    seen = project(fit.theta[None], nodes.reshape(1, -1, 2), model)
    pixels, ahead = seen.pixels[0].reshape(nodes.shape), seen.visible[0].reshape(nodes.shape[:2])
    inside = ahead & ((pixels >= 0) & (pixels <= (model.width - 1, model.height - 1))).all(axis=2)
    for k in np.flatnonzero(np.count_nonzero(inside, axis=1) >= FEWEST_NODES):
        first, last = np.flatnonzero(inside[k])[[0, -1]]
        part = slice(first, last + 1)
        if ahead[k, part].all():
            course = _course(fit, model, pixels[k, part], share[part], (starts[k], spans[k], shifts[k]))
            if course is not None:
                yield course


def _course(
    fit: CameraFit, model: ProjectionModel, pixels: Array, share: Array, marking: tuple[Array, Array, Array]
) -> _Course | None:
    """The part of a marking (start, span, shift) that lies at pixels (N, 2), by its shares (N,) of the whole."""
    spacing_px = SPACING_PX * model.width / 1920.0
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    if length[-1] < SHORTEST_WIDTHS * model.width:
        return None
    start, span, shift = marking
    along = np.interp(np.arange(0.5 * spacing_px, length[-1], spacing_px), length, share)
    seen = project(fit.theta[None], (start + span * along[:, None])[None], model)
    places = seen.pixels[0]
    tangents = np.gradient(places, axis=0)
    tangents /= np.maximum(np.hypot(tangents[:, :1], tangents[:, 1:]), 1e-9)
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=-1)
    by_theta, by_field = (rows[0] for rows in seen.gradient(normals.T[None]))
    by_theta[_SIZES] += shift @ by_field
    return _Course(places, normals, main_modes(by_theta, fit.covariance))


def main_modes(by_theta: Array, covariance: Array) -> Array:
    """The two main modes (M, 2) of shifts with derivatives (P, M) by parameters of this covariance (P, P), as long as
    their standard deviation, and negative where the line begins: shifts are tried in the order of their sign.

    With ``covariance = L L^T`` and ``A = L^T by_theta`` the shifts' covariance ``A^T A`` (M, M), of rank P at most, has
    the eigenvectors ``A^T u`` of the small matrix ``A A^T``.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    rows = (vectors * np.sqrt(np.maximum(values, 0.0))).T @ (size[:, None] * by_theta)
    _, axes = np.linalg.eigh(rows @ rows.T)
    modes = rows.T @ axes[:, :-3:-1]
    return np.asarray(np.where(modes[0] > 0.0, -modes, modes))


def _best_shift(
    picture: NDArray[np.uint8], surface: NDArray[np.bool_] | None, course: _Course, unit: float
) -> Array | None:
    """Shift (M,) px along the normals of the curve that alone stands out, or None."""
    reach = np.maximum(np.abs(course.modes).max(axis=0), 1e-6)
    furthest = np.clip(SIGMAS * reach[0], LEAST_SHIFT_PX * unit, LARGEST_SHIFT_PX * unit)
    turned = max(SIGMAS * reach[1], LEAST_TURN_PX * unit)
    steps = min(TURNS, int(np.ceil(turned / (2.0 * unit))))
    first = np.arange(-furthest, furthest + unit, unit) / reach[0]
    second = np.arange(-steps, steps + 1) * (turned / steps / reach[1])
    responses = _responses(picture, surface, course, furthest + turned, unit)
    modes = _average_neighbours(course.modes)
    sums = np.array([_sums(responses, first[:, None] * modes[:, 0] + turn * modes[:, 1]) for turn in second])
    middle = np.median(sums)
    sums = (sums - middle) / max(1.4826 * float(np.median(np.abs(sums - middle))), 1e-9)
    turn, at = np.unravel_index(int(sums.argmax()), sums.shape)
    rival = np.abs(first - first[at]) * reach[0] > RIVAL_PX * unit
    best = float(sums[turn, at])
    if best < STANDING_OUT or float(sums[:, rival].max(initial=-np.inf)) > RIVAL_SHARE * best:
        return None
    if abs(first[at]) > SIGMAS:
        return None
    return np.asarray(first[at] * course.modes[:, 0] + second[turn] * course.modes[:, 1])


def _average_neighbours(values: Array) -> Array:
    """Means (M // JOINED, ...) over neighbours."""
    count = len(values) // JOINED
    return np.asarray(values[: count * JOINED].reshape(count, JOINED, -1).mean(axis=1))


def _responses(
    picture: NDArray[np.uint8], surface: NDArray[np.bool_] | None, course: _Course, furthest_px: float, unit: float
) -> _Responses:
    step = WIDTH_PX * unit / TAPS
    reach = furthest_px + 3.0 * WIDTH_PX * unit
    offsets = np.arange(-reach, reach + step, step)
    profiles = _average_neighbours(sample_profiles(picture, course.places, course.normals, offsets).astype(np.float64))
    seen = np.isfinite(profiles)
    left, middle, right = paint_and_sides(np.where(seen, profiles, 0.0))
    if surface is not None:
        middles, normals = _average_neighbours(course.places), _average_neighbours(course.normals)
        places = middles[:, None] + offsets[:, None] * normals[:, None]
        flat = lie_on_surface(places.reshape(-1, 2), surface, picture.shape[1], picture.shape[0])
        seen &= flat.reshape(seen.shape)
    seen = seen[:, : -4 * TAPS] & seen[:, 4 * TAPS :]
    shifts = offsets[2 * TAPS : -2 * TAPS]
    return _Responses(_limit(middle - left, seen), _limit(middle - right, seen), seen, shifts)


def _limit(response: Array, seen: NDArray[np.bool_]) -> Array:
    usual = 1.4826 * float(np.median(np.abs(response[seen]))) if seen.any() else 0.0
    return np.asarray(np.where(seen, np.clip(response, -CLIPPED * usual, CLIPPED * usual), 0.0))


def _sums(responses: _Responses, shifts: Array) -> Array:
    """How much lighter curves with these shifts (A, M) are than their surroundings (A,)."""
    step = responses.shifts[1] - responses.shifts[0]
    at = np.rint((shifts - responses.shifts[0]) / step).astype(np.int64)
    at = np.clip(at, 0, responses.left.shape[1] - 1)
    rows = np.arange(shifts.shape[1])
    pieces = max(1, round(len(rows) * SPACING_PX * JOINED / PIECE_PX))
    starts = np.unique(np.linspace(0, len(rows), pieces, endpoint=False).astype(np.int64))
    left, right = (np.add.reduceat(side[rows, at], starts, axis=1) for side in (responses.left, responses.right))
    count = np.count_nonzero(responses.seen[rows, at], axis=1)
    return np.asarray(np.minimum(left, right).sum(axis=1) / np.sqrt(np.maximum(count, len(rows) / 3)))


def _measure(picture: NDArray[np.uint8], course: _Course, shift: Array, unit: float) -> LineCue | None:
    """Points of a marking, each from the mean profile of a piece of it."""
    places = course.places + shift[:, None] * course.normals
    step = WIDTH_PX * unit / TAPS
    reach = (WITHIN_PX + 3.0 * WIDTH_PX) * unit
    offsets = np.arange(-reach, reach + step, step)
    profiles = sample_profiles(picture, places, course.normals, offsets).astype(np.float64)
    whole = np.isfinite(profiles).all(axis=1)
    pieces = np.arange(len(places)) // max(2, round(MEASURED_PX / SPACING_PX))
    points, sigmas = [], []
    for piece in range(int(pieces[-1]) + 1):
        own = whole & (pieces == piece)
        if np.count_nonzero(own) < 0.5 * MEASURED_PX / SPACING_PX:
            continue
        middle, sigma = _middle(np.median(profiles[own], axis=0), offsets, unit)
        if np.isfinite(middle):
            points.append((places[own] + middle * course.normals[own]).mean(axis=0))
            sigmas.append(sigma)
    if len(points) < FEWEST_POINTS:
        return None
    measured, sigma_px = np.array(points), np.array(sigmas)
    along = np.linspace(-1.0, 1.0, len(measured))
    bend = (measured - measured.mean(axis=0)) @ fit_line(measured)[:2]
    jump = bend - np.polyval(np.polyfit(along, bend, 2), along)
    if np.sqrt(np.mean(jump**2)) > SMOOTH_PX * unit:
        return None
    line = fit_line(measured, 1.0 / sigma_px**2)
    off = np.abs(line_distance(line, measured))
    rms = float(np.sqrt(np.mean(off**2)))
    segment = Segment(measured[0], measured[-1], len(points) / (int(pieces[-1]) + 1))
    return LineCue(None, line, measured, sigma_px, segment, rms)


def _middle(profile: Array, offsets: Array, unit: float) -> tuple[float, float]:
    """Where a mean profile (S,) is lightest against both sides, and how well that is known, px."""
    left, middle, right = paint_and_sides(profile)
    response = middle - np.maximum(left, right)
    at = offsets[2 * TAPS : -2 * TAPS]
    near = np.flatnonzero(np.abs(at) <= WITHIN_PX * unit)
    best = int(near[response[near].argmax()])
    noise = 1.4826 * float(np.median(np.abs(np.diff(profile, 2)))) / np.sqrt(6.0) + 1e-6
    weight = np.maximum(response[near] - 0.5 * response[best], 0.0) * (np.abs(at[near] - at[best]) <= WIDTH_PX * unit)
    if response[best] <= 0.0 or weight.sum() <= 0.0:
        return float("nan"), float("nan")
    sigma = WIDTH_PX * unit * noise / float(response[best])
    return float(weight @ at[near] / weight.sum()), max(LEAST_SIGMA_PX * unit, sigma)


def _are_same(one: LineCue, other: LineCue, unit: float) -> bool:
    """Whether two lines are one marking of the picture."""
    return float(np.median(np.abs(line_distance(other.line, one.points_px)))) < RIVAL_PX * unit
