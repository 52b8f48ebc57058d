"""Where a named line ends, another one runs: the halfway line ends on the touchlines, seen or not.

Such an end is one point of the other marking, measured across it. It says how far the field reaches, and which of
several parallel edges is the marking: the one through that point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.problem import COARSE, WIDE_LOSS, Problem, State, add_curves, minimise, resume, with_loss
from circlecal.camera.residuals import (
    CurvePoints,
    curve_residuals,
    ground_feet,
    line_curve,
    stack_curves,
)
from circlecal.field import FieldTemplate, Line
from circlecal.geometry.camera_parameters import LOG_FOCAL, POSITION, project
from circlecal.geometry.projective import Array, fit_line, freeze, line_distance, meet
from circlecal.observations import LineEnd, LinePoints, Observations
from circlecal.paint.ends import piece_beside

SIGMA_PX = 2.0
"""Standard deviation of an end along its line, pixels at 1920 px width."""
WORST_SIGMAS = (12.0, 4.0)
"""An end further than this from where the camera expects the other marking is a cover's edge: at first generously,
since a vague camera's expectation bends.
"""
WORST_COST = 25.0
"""By how much chi-square may grow per end that is used."""
MISSED_SIGMAS, DOLLIES = 4.0, (0.4, 2.0, 4.0)
"""By how many of its standard deviations a fit misses an end for others to be tried, and how many times as far away
their cameras start: of a rendered hall whose lens is a barrel a fit from 10 m missed the end by 35 px, and that from
31 m, where the camera stood, by 0.1.
"""
NEAR_PX, BEND_SHARE, LEAST_SINE = 3.0, 0.008, 0.15
"""How far a seen line may pass by an end: pixels at 1920 px width, and share of its distance; and the sine of the least
angle between both.
"""
NEAR_SIGMAS = 1.5
"""A line passes through another one's end within this many of the end's standard deviations."""
PASSED_PX, PLACE_PX, PASSED_SHARE, MET_LENGTHS = 20.0, 2.0, 0.6, 3.0
"""A line runs on beyond another where it is seen at this share of the places, so many pixels apart, within so many
pixels at 1920 px width on both sides of it, and as much farther off where lettering on the floor hides the crossing;
and by how many of its lengths that one may be drawn on to meet it. The side of a penalty area ends two lengths before
the halfway line that a rendered field of 40 m was made to end on it.
"""
DRAWN_ON = 1.0
"""Lengths of its own by which a line may be drawn on to pass through an end: streaks of a floor 130 and 190 px long
that pass by chance were 550 and 800 px away from ends at which players hid the halfway line.
"""
BEYOND_PX = 9.0
"""By how much farther the halfway line's paint is seen to end, pixels at 1920 px width, a line is not the border on
which it ends: of 150 ends in 160 rendered halls on true borders at most 6.9, on streaks of light 13.7 to 35.
"""
FEWEST_POINTS = 8
"""Points of a seen line that gets a name or crosses another line; fewer are a fragment."""
TOUCH_M = 0.3
"""How far a line of the template may end from the one it runs into."""


def add_line_ends(
    problem: Problem, state: State, observations: Observations, template: FieldTemplate
) -> tuple[Problem, State, tuple[LinePoints, ...]]:
    """Fit once more with the ends of named lines as points of the markings that they run into.

    Parameters
    ----------
    problem, state : Problem, State
        The fit without them.
    observations : Observations
        Everything that was seen.
    template : FieldTemplate
        The field.

    Returns
    -------
    problem, state : Problem, State
        The new fit, or the old one where no end is seen that the camera can believe in.
    ends : tuple of LinePoints
        One point each, of the markings that lines end on.
    """
    for worst in WORST_SIGMAS:
        ends = _find_ends(problem, state, observations, template, worst)
        if not ends:
            break
        parts = [
            _curve_of_point(template.line_by_name[str(m.line)], m.points_px[0], m.sigma_px, template) for m in ends
        ]
        # an end may lie far from where a vague camera expects it
        wide, start = with_loss(problem, state.best(), WIDE_LOSS * problem.loss_scale)
        wide, found = add_curves(wide, start, stack_curves(parts))
        fuller, found = with_loss(wide, resume(wide, found, COARSE), problem.loss_scale)
        most = float(state.cost[0]) + WORST_COST * len(ends)
        found = _reach_ends(fuller, resume(fuller, found, COARSE), len(ends), most)
        if found.cost[0] < most:
            return fuller, found, ends
    return problem, state, ()


def _reach_ends(problem: Problem, state: State, count: int, most: float) -> State:
    """The fit, or a better one from a camera that stands nearer or farther with the same zoomed view, where one of the
    first ``count`` points, which are ends of lines, is missed: a lens bends a near circle as a far one is seen. What
    promises no cost (chi-square) below ``most`` is not followed to its end.
    """
    if np.abs(state.values[0, :count]).max() <= MISSED_SIGMAS:
        return state
    starts = np.repeat(state.theta[:1], len(DOLLIES), axis=0)
    starts[:, LOG_FOCAL] += np.log(DOLLIES)
    middle = np.append(problem.priors.center_m, 0.0)
    starts[:, POSITION] = middle + np.array(DOLLIES)[:, None] * (starts[:, POSITION] - middle)
    rule = replace(COARSE, bar=min(most, float(state.cost[0])))
    found = minimise(problem, starts, rule, ground_feet(problem.curves, starts, problem.model)).best()
    return found if found.cost[0] < state.cost[0] else state


@dataclass(frozen=True, slots=True)
class _Ending:
    """An end of a named line on another marking.

    Attributes
    ----------
    end, seen : LineEnd, LinePoints
        The end, and the line that ends there, as they are seen.
    other : Line
        The marking that it ends on.
    middle_px, sigma_px : (2,), (1,) arrays
        Where the middle of that marking lies, and its standard deviation.
    """

    end: LineEnd
    seen: LinePoints
    other: Line
    middle_px: Array
    sigma_px: Array


def _find_ends(
    problem: Problem, state: State, observations: Observations, template: FieldTemplate, worst: float
) -> tuple[LinePoints, ...]:
    """Points of the markings that named lines are seen to end on, each within so many of its standard deviations of
    where the camera expects that marking.
    """
    unit = observations.width / 1920.0
    endings = _locate_endings(problem, state.theta[:1], observations, template)
    if not endings:
        return ()
    away = _count_sigmas(problem, state, endings, template)
    return tuple(
        LinePoints(ending.other.name, ending.middle_px[None], ending.sigma_px)
        for ending, off in zip(endings, away, strict=True)
        if off <= worst and (ending.end.crossed or _is_crossed(ending.end, ending.seen, observations, unit))
    )


def _locate_endings(
    problem: Problem, theta: Array, observations: Observations, template: FieldTemplate
) -> list[_Ending]:
    """The ends of named lines on other markings, at a camera (1, P)."""
    ends = [
        (end, seen, drawn)
        for seen in observations.lines
        if (drawn := template.line_by_name.get(seen.line or "")) is not None
        for end in seen.ends
    ]
    if not ends:
        return []
    sigma = np.array([SIGMA_PX * observations.width / 1920.0])
    lines = stack_curves([_curve_of_point(drawn, end.point_px, sigma, template) for end, _, drawn in ends])
    along = ground_feet(lines, theta, problem.model)
    place = lines.origin + along[0, :, None] * lines.direction
    corners = np.array([template.line_ends(drawn) for *_, drawn in ends])
    far = along[0] > 0.5 * np.linalg.norm(corners[:, 1] - corners[:, 0], axis=-1)
    outward = np.where(far[:, None], lines.direction, -lines.direction)
    # the paint ends on the near edge of the other marking, its middle lies half a width further
    at = project(theta, place[None], problem.model)
    steps = at.along(*outward.T)[0].T * 0.5 * template.marking_width_m
    middles = lines.points_px + steps
    # where both cross at a slant the paint ends anywhere within the other marking
    sigmas = np.hypot(sigma, np.linalg.norm(steps, axis=-1))[:, None]
    return [
        _Ending(end, seen, other, middles[k], sigmas[k])
        for k, (end, seen, drawn) in enumerate(ends)
        if (other := find_line_through(corners[k, int(far[k])], drawn, template)) is not None
    ]


def _count_sigmas(problem: Problem, state: State, endings: Sequence[_Ending], template: FieldTemplate) -> Array:
    """By how many of its standard deviations (N,) each end lies off where the camera expects its marking."""
    theta = state.theta[:1]
    points = stack_curves([_curve_of_point(e.other, e.middle_px, e.sigma_px, template) for e in endings])
    expected = curve_residuals(points, theta, ground_feet(points, theta, problem.model), problem.model, updates=0)
    J = expected.jacobian[0]
    spread = np.sqrt(((J @ posterior_covariance(state.normal[0], problem.priors.sd)) * J).sum(axis=1))
    return np.asarray(np.abs(expected.values[0]) / np.hypot(spread, 1.0))


def passes_point(segment: Array, point_px: Array, unit: float, near_px: float = NEAR_PX) -> bool:
    """Whether a seen line with the ends (2, 2) goes through a point (2,), or would if it were drawn on."""
    along = (segment[1] - segment[0]) / np.linalg.norm(segment[1] - segment[0])
    first, second = (point_px - segment) @ along
    away = max(-float(first), float(second), 0.0)
    return abs(float(line_distance(_line_through(segment), point_px[None])[0])) < near_px * unit + BEND_SHARE * away


def _is_near(segment: Array, point_px: Array) -> bool:
    """Whether a seen line with the ends (2, 2) is drawn on to a point (2,) by no more than so many of its lengths."""
    nearest = float(np.linalg.norm(segment - point_px, axis=1).min())
    return nearest < DRAWN_ON * float(np.linalg.norm(segment[1] - segment[0]))


def passes_end(points_px: Array, end: LinePoints, unit: float) -> bool:
    """Whether a seen line (N, 2) passes an end of :func:`add_line_ends` within what is known of it, or would if drawn
    on.
    """
    segment = segment_ends(_piece_beside(points_px, end.points_px[0]))
    return passes_point(segment, end.points_px[0], unit, NEAR_SIGMAS * float(end.sigma_px[0]) / unit)


def _piece_beside(points_px: Array, point_px: Array) -> Array:
    """The points (M, 2) of a seen line around a point (2,) that it passes, since the lens bends a long line; all of its
    points where it ends before.
    """
    first, last = segment_ends(points_px)
    way = (points_px - point_px) @ (last - first)
    is_inside = min(way.max(), -way.min()) > 0.0
    return piece_beside(points_px, point_px, last - first, FEWEST_POINTS) if is_inside else points_px


def agree_with_ends(names: dict[int, str], ends: tuple[LinePoints, ...], observations: Observations) -> bool:
    """Whether lines (names by index) are nothing but markings on which ends were seen, and pass through those ends."""
    places = {point.line: point for point in ends}
    unit = observations.width / 1920.0
    return bool(names) and all(
        name in places and passes_end(observations.lines[k].points_px, places[name], unit) for k, name in names.items()
    )


def find_passed_lines(
    observations: Observations, unnamed: Sequence[int], template: FieldTemplate
) -> frozenset[tuple[int, str]]:
    """Names that nameless lines (by place among the ``unnamed`` ones) cannot have: a named line runs on beyond them,
    and ends where it meets those markings.

    Other sports' touchlines run along the field's own, nearer to its middle; players hide the end of the halfway line.
    """
    unit = observations.width / 1920.0
    reach, found = PASSED_PX * unit, set()
    segments = [segment_ends(observations.lines[k].points_px) for k in unnamed]
    for seen in observations.lines:
        drawn = template.line_by_name.get(seen.line or "")
        if drawn is None or len(seen.points_px) < FEWEST_POINTS:
            continue
        others = (find_line_through(corner, drawn, template) for corner in template.line_ends(drawn))
        names = [other.name for other in others if other is not None]
        for place, k in enumerate(unnamed) if names else ():
            points_px = observations.lines[k].points_px
            if _runs_on_beyond(seen.points_px, segments[place], reach) and not _has_end_on(seen, points_px, unit):
                found |= {(place, name) for name in names}
    return frozenset(found)


def _has_end_on(line: LinePoints, points_px: Array, unit: float) -> bool:
    """Whether the paint of a line was seen to end on another one (N, 2): what lies behind it is none of it."""
    pieces = ((segment_ends(_piece_beside(points_px, end.point_px)), end.point_px) for end in line.ends)
    return any(_is_near(segment, point) and passes_point(segment, point, unit) for segment, point in pieces)


def lies_short_of_end(points_px: Array, ends: Sequence[LineEnd], before_px: Array, unit: float) -> bool:
    """Whether a line (N, 2) lies between a place (2,) on another line and an end of its paint, well before that end."""
    for end in ends:
        line = fit_line(_piece_beside(points_px, end.point_px))
        before, beyond = line_distance(line, np.stack([before_px, end.point_px]))
        if before * beyond < 0.0 and abs(beyond) > BEYOND_PX * unit:
            return True
    return False


def _runs_on_beyond(points: Array, segment: Array, reach_px: float) -> bool:
    """Whether points (N, 2) along a line go on for so far on both sides of where it meets a segment (2, 2)."""
    line, other = _line_through(points), _line_through(segment)
    meeting = meet(line, other)
    if abs(meeting[2]) < LEAST_SINE:
        return False
    crossing = meeting[:2] / meeting[2]
    span = segment[1] - segment[0]
    share = float((crossing - segment[0]) @ span / (span @ span))
    lengths = max(-share, share - 1.0, 0.0)
    # where it meets the other line is the less sure the further that one is drawn on
    unsure = BEND_SHARE * lengths * float(np.linalg.norm(span))
    along = (points - crossing) @ np.array([line[1], -line[0]])
    beyond = (side - unsure for side in (along, -along))
    counts = [_count_places(side[side > 0.0], reach_px) for side in beyond]
    return lengths < MET_LENGTHS and min(counts) >= PASSED_SHARE * reach_px / PLACE_PX


def _count_places(beyond: Array, reach_px: float) -> int:
    """Places at which a line is seen beyond another one (N,), pixels, from the first of them on, which something that
    lies where both meet may hide for as long.
    """
    first = float(beyond.min(initial=np.inf))
    return len(np.unique(np.floor(beyond[beyond < first + reach_px] / PLACE_PX))) if first < reach_px else 0


def segment_ends(points: Array) -> Array:
    """First and last point (2, 2) along a straight marking, not to be written to."""
    return _course_of(points.tobytes())[1]


def _line_through(points: Array) -> Array:
    """The line (3,) through points (N, 2) of a straight marking, not to be written to."""
    return _course_of(points.tobytes())[0]


@lru_cache(maxsize=256)
def _course_of(points: bytes) -> tuple[Array, Array]:
    """Line and ends of points (N, 2), kept since each ending asks for those of all lines that are seen."""
    places = np.frombuffer(points).reshape(-1, 2)
    line = fit_line(places)
    position = places @ np.array([line[1], -line[0]])
    ends = places[[np.argmin(position), np.argmax(position)]]
    return freeze(line), freeze(ends)


def _curve_of_point(line: Line, point_px: Array, sigma: Array, template: FieldTemplate) -> CurvePoints:
    return line_curve(line.name, point_px[None], sigma, template.line_ends(line), template.line_shift(line))


def find_line_through(point_m: Array, ending: Line, template: FieldTemplate) -> Line | None:
    """The line of the template, other than the one that ends there, on which a point (2,) lies."""
    ends, _ = template.drawn_lines
    span, offset = ends[:, 1] - ends[:, 0], point_m - ends[:, 0]
    length = np.hypot(*span.T)
    share = (offset * span).sum(axis=1) / length
    beside = np.abs(offset[:, 0] * span[:, 1] - offset[:, 1] * span[:, 0]) < TOUCH_M * length
    touched = np.flatnonzero(beside & (share > -TOUCH_M) & (share < length + TOUCH_M))
    return next((template.lines[k] for k in touched if template.lines[k].name != ending.name), None)


def _is_crossed(end: LineEnd, line: LinePoints, observations: Observations, unit: float) -> bool:
    """Whether a nameless line is seen to pass through the end, across the line that ends there."""
    along = _line_through(line.points_px)[:2]
    for other in observations.lines:
        if other.line is None and len(other.points_px) >= FEWEST_POINTS:
            # by its own ends a long line that the lens bends lies beside a point that it passes
            segment = segment_ends(_piece_beside(other.points_px, end.point_px))
            normal = _line_through(other.points_px)[:2]
            across = abs(normal[0] * along[1] - normal[1] * along[0]) > LEAST_SINE
            if across and _is_near(segment, end.point_px) and passes_point(segment, end.point_px, unit):
                return True
    return False
