"""Straight markings in the full picture, and the halfway line: the one through the middle of the circle."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.circle import LEAST_REACH_PX, MOST_PROFILES, SPACING_PX, MeasuredCircle
from circlecal.detection.ellipse_batch import unit_frame
from circlecal.detection.options import DetectorConfig, ProfilesConfig
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import (
    Array,
    Mask,
    fit_line,
    join,
    lift,
    line_distance,
    normalise_line,
    transform_lines,
)
from circlecal.paint.bands import MeasuredCurve, local_width, measure_curve

__all__ = ["MeasuredLine", "MeasuredSegments", "find_halfway", "find_segments_through_middle", "measure_segments"]

MOST_TRIED = 4
"""Lines nearest to the circle's centre that are measured."""
EXTENT = 2.0
"""How far the line is followed, in half chords: further out the ground and the lens bend it."""
FURTHEST = 6.0
"""Half chords: where the picture shows a line outside the circle only, it shows it this near."""
FITTED_EXTENT = 1.2
"""Half chords within which its points fit the line: one that is fitted near the circle misses the paint by 1 to 8 px at
the bottom of broadcast frames."""
INSIDE = 0.97
"""Half chords: the crossing with the circle itself is left out of the support."""
NEARLY_CENTRAL = 0.12
"""A supported line this near to the centre, in radii, needs no comparison with others: right ones of 40 broadcast
frames were all within 0.08, penalty lines at 0.45 to 0.6.
"""
SUPPORT = 0.4
"""Smallest drawn share of the chord inside the circle."""
SUPPORT_WITH_REST = 0.18
"""Smallest drawn share of the chord where the line is drawn outside the circle too, by :data:`SUPPORT` of its visible
length: players stand in the circle at a kick-off.
"""
OUTSIDE_SUPPORT = 0.7
"""Smallest drawn share of what is visible of a line that is seen outside the circle only."""
SHORTEST_RUN = 0.75
"""Half chords over which a line that is seen outside the circle only is drawn at least, from there to its end: the
halfway line runs for 2.7 more on the field, which perspective shortens on the far side.
"""
WIDENED, WIDE_SHARE = 2.0, 0.8
"""How many times as far to both sides a line is looked for where none is found, and how wide its paint is then, over
the usual half length of profiles: in a close view it may be as wide as these are long, 14 to 20 px of 1280 on three
rendered frames. A seam of a real hall's floor, found by longer profiles alone, is 0.3 half lengths wide.
"""
BESIDE_SUPPORT, LEAST_BESIDE = 0.4, 0.15
"""Smallest drawn share of what is visible, within :data:`FURTHEST`, of a line that is bare inside the circle but runs
on both sides of it, and of either side: worn paint is gone for metres, and an accident does not go on beyond.
"""
LEAST_SEEN, LEAST_SEEN_BESIDE = 0.03, 0.15
"""Drawn shares of what is visible of a line, about the circle, and before it is fitted again along all its length,
below which it is no worn one. Worn ones had 0.1 and 0.25 or more in 80 frames of worn paint and painted scenes; most
lines that are none have less of one of both.
"""
SAME_PAINT = 0.4
"""Least contrast of the line over that of the circle: streaks of the floor have less, one paint 0.6 to 2.7."""
PIECES = 4
"""Of the line, between which the contrast may differ."""
FEWEST_SAMPLES, FEWEST_TO_FIT = 12, 8
"""Of a line that is measured, and of them those that show a marking and fit it."""
SEGMENT_SPACING, FEWEST_ON_SEGMENT = 2, 6
"""Profiles on other straight markings: distance in spacings of the circle's, and number at least."""
DIRECTIONS, FEWEST_VOTES = 60, 8
"""Over half a turn, in which ridge points inside the circle vote for a line; and votes in three neighbouring ones."""
VOTE_TOLERANCES_PX = 8.0, 4.0
"""Distances of the voters from their line in two rounds, pixels of the picture."""


@dataclass(frozen=True, slots=True)
class MeasuredLine:
    """A line (3,) with profiles in order along it; ``support`` is the drawn share of its chord in the circle, or
    of what is seen of it where the picture shows it ``outside`` the circle only; ``beside`` are the drawn shares of
    what is visible before and behind the circle.
    """

    line: Array
    curve: MeasuredCurve
    support: float
    outside: bool = False
    beside: tuple[float, float] = (0.0, 0.0)

    @property
    def ends(self) -> tuple[Array, Array]:
        """First and last supported place (2,), on the line."""
        on, points = np.flatnonzero(self.curve.supported), self.curve.points
        first, last = (on[0], on[-1]) if len(on) else (0, -1)
        return points[first], points[last]


@dataclass(frozen=True, slots=True)
class MeasuredSegments:
    """Profiles along several straight segments, one after the other; ``pieces`` (N,) tells which."""

    curve: MeasuredCurve
    pieces: NDArray[np.int64]


def measure_segments(
    gray: NDArray[np.uint8], segments: Array, sign: float, config: ProfilesConfig
) -> MeasuredSegments | None:
    """Profiles across straight segments (K, 2, 2) of the full picture, once; None where there is no segment."""
    if len(segments) == 0:
        return None
    width = gray.shape[1]
    span = segments[:, 1] - segments[:, 0]
    length = np.hypot(span[:, 0], span[:, 1])
    count = np.maximum(FEWEST_ON_SEGMENT, (length / (SEGMENT_SPACING * SPACING_PX * width / 1920.0)).astype(np.int64))
    pieces = np.repeat(np.arange(len(segments)), count)
    position = np.arange(len(pieces)) - np.repeat(np.cumsum(count) - count, count)
    points = segments[pieces, 0] + ((position + 0.5) / count[pieces])[:, None] * span[pieces]
    normals = np.stack([span[:, 1], -span[:, 0]], axis=-1) / np.maximum(length, 1e-9)[:, None]
    reach = np.full(len(points), max(config.line_reach_px * width / 1920.0, LEAST_REACH_PX))
    return MeasuredSegments(measure_curve(gray, points, normals[pieces], reach, pieces, sign), pieces)


def find_halfway(
    gray: NDArray[np.uint8], circle: MeasuredCircle, segments: Array, config: DetectorConfig
) -> MeasuredLine | None:
    """Choose and measure the line through the circle's middle.

    Parameters
    ----------
    gray : (H, W) uint8
        Full picture.
    circle : MeasuredCircle
    segments : (K, 2, 2) array
        Ends of the straight runs, px.
    config : DetectorConfig

    Returns
    -------
    MeasuredLine or None
        None where no line is near the middle or none is drawn there.
    """
    if len(segments) == 0:
        return None
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))
    lines = join(lift(segments[:, 0]), lift(segments[:, 1]))
    local = normalise_line(transform_lines(to_unit, lines))
    distance = np.abs(local[:, 2])
    near = [k for k in np.argsort(distance)[:MOST_TRIED] if distance[k] <= config.halfway.distance]
    nearest = near
    for widened, is_beside in itertools.product((1.0, WIDENED), (False, True)):
        best: tuple[float, MeasuredLine] | None = None
        tried, nearest = nearest if is_beside else near, []
        for index in tried:
            measured = _follow_line(gray, circle, local[index], config, is_beside=is_beside, widened=widened)
            if _measure_share(measured.curve) >= LEAST_SEEN:
                nearest.append(index)
            refined = abs(float(normalise_line(transform_lines(to_unit, measured.line))[2]))
            if not _is_halfway(measured, circle, refined, config):
                continue
            width = _usual(measured.curve.width, measured.curve)
            if widened > 1.0 and width < WIDE_SHARE * _reach_px(config, gray.shape[1]):
                continue
            value = measured.support - refined
            if best is None or value > best[0]:
                best = value, measured
            if refined <= NEARLY_CENTRAL:
                break
        if best is not None:
            return best[1]
    return None


def _is_halfway(line: MeasuredLine, circle: MeasuredCircle, refined: float, config: DetectorConfig) -> bool:
    """Whether a followed line, so many radii from the circle's middle, is drawn, in the circle's paint."""
    if not _is_drawn(line) or refined > (NEARLY_CENTRAL if line.outside else config.halfway.distance):
        return False
    return _usual(line.curve.contrast, line.curve) >= SAME_PAINT * _usual(circle.curve.contrast, circle.curve)


def find_segments_through_middle(points: Array, normals: Array, circle: MeasuredCircle, distance: float) -> Array:
    """Straight pieces (K, 2, 2) through the middle of a circle, from the directions in which ridge points (N, 2) inside
    it run: shorter and fainter ones than a search over the whole picture finds.
    """
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))
    local = lift(points) @ to_unit[:2].T
    inside = (local * local).sum(axis=-1) < INSIDE**2
    points, normals = points[inside], normals[inside]
    lines = np.concatenate([normals, -(normals * points).sum(axis=-1, keepdims=True)], axis=1)
    through = normalise_line(transform_lines(to_unit, lines))
    near = np.abs(through[:, 2]) <= 0.5 * distance
    points, direction = points[near], np.arctan2(through[near, 1], through[near, 0]) % np.pi
    bins = (direction * (DIRECTIONS / np.pi)).astype(np.int64) % DIRECTIONS
    votes = np.bincount(bins, minlength=DIRECTIONS)
    votes = votes + np.roll(votes, 1) + np.roll(votes, -1)
    peaks = np.flatnonzero((votes >= np.roll(votes, 1)) & (votes > np.roll(votes, -1)) & (votes >= FEWEST_VOTES))
    found = []
    for peak in peaks[np.argsort(-votes[peaks])][:MOST_TRIED]:
        members = points[np.abs((bins - peak + DIRECTIONS // 2) % DIRECTIONS - DIRECTIONS // 2) <= 1]
        line = fit_line(members)
        for tolerance in VOTE_TOLERANCES_PX:
            off = np.abs(line_distance(line, members))
            line = fit_line(members, (off <= max(float(median_of_rows(off)), tolerance)).astype(np.float64))
        along = members @ np.array([line[1], -line[0]])
        ends = members[[int(np.argmin(along)), int(np.argmax(along))]]
        found.append(ends - line_distance(line, ends)[:, None] * line[:2])
    return np.array(found).reshape(-1, 2, 2)


def _usual(values: Array, curve: MeasuredCurve) -> float:
    """What is usual of values (N,) where a curve is drawn; 0 where it is drawn nowhere."""
    return float(median_of_rows(values[curve.supported])) if curve.supported.any() else 0.0


def _reach_px(config: DetectorConfig, width: int) -> float:
    """Half length of a line's first profiles in a picture of this width, px."""
    return max(config.refinement.line_reach_px * width / 1920.0, LEAST_REACH_PX)


def _is_drawn(line: MeasuredLine) -> bool:
    """Whether enough of the line is drawn inside the circle, or a little there and enough of it altogether; outside it
    more of one side, or some of both.
    """
    if line.outside:
        is_on_both_sides = min(line.beside) >= LEAST_BESIDE and line.support >= BESIDE_SUPPORT
        return line.support >= OUTSIDE_SUPPORT or is_on_both_sides
    if line.support >= SUPPORT:
        return True
    visible = max(1, int(np.count_nonzero(line.curve.inside)))
    whole = float(np.count_nonzero(line.curve.supported)) / visible
    return line.support >= SUPPORT_WITH_REST and whole >= SUPPORT


def _follow_line(
    gray: NDArray[np.uint8],
    circle: MeasuredCircle,
    local: Array,
    config: DetectorConfig,
    *,
    is_beside: bool,
    widened: float,
) -> MeasuredLine:
    """Follow a line, given in the unit circle's frame, through the circle and beyond; fit it inside the circle, or
    wherever it is drawn where the picture shows it outside only, or its paint inside may be worn off (``is_beside``):
    then one side of it may lead to the other. Its first profiles are ``widened`` times as long as usual.
    """
    width = gray.shape[1]
    refinement = config.refinement
    middle, half_chord, (low, high) = _find_visible_part(local, circle, gray.shape)
    # the picture may show the line on one side of the circle only
    is_outside = is_beside or low >= 1.0 or high <= -1.0
    furthest = FURTHEST if is_outside else EXTENT
    extent = max(-furthest, low), min(furthest, high)
    if not extent[0] < extent[1]:
        extent = -1.0, 1.0
    start, end = (middle + place * half_chord for place in extent)
    length = float(np.hypot(*(end - start)))
    count = int(np.clip(length / (SPACING_PX * width / 1920.0), FEWEST_SAMPLES, MOST_PROFILES))
    share = (np.arange(count) + 0.5) / count
    chords = extent[0] + share * (extent[1] - extent[0])
    pieces = np.arange(count) * PIECES // count
    reach = np.full(count, widened * _reach_px(config, width))
    inner = np.abs(chords) <= INSIDE
    line = normalise_line(join(lift(start), lift(end)))
    curve = _measure_between(gray, start, end, share, reach, pieces, circle.sign)
    is_bare = is_beside and _measure_share(curve) < LEAST_SEEN_BESIDE
    for _ in range(0 if is_bare else 2 if is_beside else 1):
        on = curve.supported & ((np.abs(chords) <= FITTED_EXTENT) | is_outside)
        if np.count_nonzero(on) < FEWEST_TO_FIT:
            break
        line = fit_line(curve.points[on] + curve.offset[on, None] * curve.normals[on])
        start, end = (p - float(line_distance(line, p)) * line[:2] for p in (start, end))
        reach = np.maximum(refinement.narrow_reach_px * width / 1920.0, LEAST_REACH_PX) + local_width(curve)
        curve = _measure_between(gray, start, end, share, reach, pieces, circle.sign)
    before, behind = chords < -1.0, chords > 1.0
    shares = [_measure_share(curve, part) for part in (before, behind, (before | behind) if is_outside else inner)]
    if is_outside and not is_beside:
        shares[2] = max(shares[2], _measure_share(curve, _find_run(curve, chords)))
    return MeasuredLine(line, curve, shares[2], is_outside, (shares[0], shares[1]))


def _find_run(curve: MeasuredCurve, chords: Array) -> Mask:
    """The part (N,) of a curve at places (N,), half chords, from the circle to where its paint ends: a halfway line
    ends at the touchline. Of less than :data:`SHORTEST_RUN` nothing.
    """
    outwards = np.argsort(np.abs(chords), kind="stable")
    outwards = outwards[curve.inside[outwards] & (np.abs(chords[outwards]) > 1.0)]
    run = np.zeros(len(chords), np.bool_)
    if len(outwards) == 0:
        return run
    drawn = np.cumsum(curve.supported[outwards] - OUTSIDE_SUPPORT)
    outwards = outwards[: int(np.argmax(drawn)) + 1]
    run[outwards] = float(np.ptp(chords[outwards])) >= SHORTEST_RUN
    return run


def _measure_share(curve: MeasuredCurve, part: Mask | None = None) -> float:
    """Share of a curve, or of a part (N,) of it, that is drawn, of what the picture shows of it."""
    visible = curve.inside if part is None else curve.inside & part
    return float(np.count_nonzero(curve.supported & visible)) / max(1, int(np.count_nonzero(visible)))


def _measure_between(
    gray: NDArray[np.uint8],
    start: Array,
    end: Array,
    share: Array,
    reach: Array,
    pieces: NDArray[np.int64],
    sign: float,
) -> MeasuredCurve:
    points = start + share[:, None] * (end - start)
    normal = normalise_line(join(lift(start), lift(end)))[:2]
    normals = np.tile(normal, (len(points), 1))
    return measure_curve(gray, points, normals, reach, pieces, sign)


def _find_visible_part(
    local: Array, circle: MeasuredCircle, shape: tuple[int, ...]
) -> tuple[Array, Array, tuple[float, float]]:
    """Middle (2,) of the chord of a line that is given in the unit circle's frame, half of that chord (2,), and from
    where to where the picture shows the line, in half chords.
    """
    frame = unit_frame(circle.ellipse)[:2]
    foot = -local[2] * local[:2]
    half_chord = np.sqrt(max(0.05, 1.0 - local[2] ** 2)) * np.array([-local[1], local[0]])
    middle, step = frame[:, :2] @ foot + frame[:, 2], frame[:, :2] @ half_chord
    limit = np.array([shape[1] - 1.0, shape[0] - 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.stack([-middle / step, (limit - middle) / step])
    return middle, step, (float(np.nanmax(crossings.min(axis=0))), float(np.nanmin(crossings.max(axis=0))))
