"""Stage ``cues``: the halfway line, the centre mark and further straight lines, sub-pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.conics import line_conic_meet, pole
from circlecal.geometry.projective import Array, dehomogenise, fit_line, join, lift, line_distance
from circlecal.observations import CircleEdge, LineEnd, LinePoints, Observations
from circlecal.paint.centre_mark import find_centre_mark
from circlecal.paint.ends import paint_ends
from circlecal.paint.following import clip_segment, follow_line, widths_at
from circlecal.paint.hidden_ends import leave_out_hidden_ends
from circlecal.paint.lines import ONE_ROUND, TWO_ROUNDS, Rounds, measure_lines
from circlecal.paint.mark_under_ball import find_mark_under_ball
from circlecal.paint.profiles import GrayPicture
from circlecal.paint.rectified_line import half_chords
from circlecal.paint.strays import keep_on_course
from circlecal.results import Cues, EllipseFit, EllipseFits, LineCue, MarkCue, MarkingMask, Segment

REACH_HALF_CHORDS = 1.25
"""How far along the halfway line, in half chords from the middle of its chord, points carry the closed forms: lens and
crown bend it further out.
"""
SHORT_ARC_DEG, SHORT_ARC_SPARE = 240.0, 0.25
"""Arcs shorter than this leave the place of the centre mark more open, by up to so many half chords."""
FARTHER, CLEAR_TIMES = 0.2, 3.0
"""Where no centre mark lies in its usual place it is looked for so many half chords farther out, and believed where it
stands out so many times as clearly: the ellipse of a part of a circle may be off by more than its arc says. Of 270
rendered frames of three profiles three show such a mark, with ratios of 33 and more, and none something else.
"""
COVERED_SHARE = 0.67
"""Of the least support: enough where the line goes on outside the circle, whose middle a sign may cover."""
RIM_CLEARANCE_PX = 8.0
"""How far beyond the circle the halfway line goes on at least, pixels at 1920 px width."""
ON_LINE_PX, BENT_SHARE = 4.0, 0.03
"""How far from the halfway line its other pieces lie: pixels at 1920 px width, and of their distance along it."""
LARGEST_TURN = 0.1
"""Sine of the angle between the halfway line and one of its pieces: 0.03 at most among 284 pieces in 110 real and
rendered frames; a goal area's line, 1100 px further, whose own line meets a short piece of the halfway line, has 0.83.
"""
SURFACE_MARGIN = 0.02
"""Picture widths beyond the playing surface within which the halfway line may still be followed."""
END_CLEARANCE_PX = 2.0
"""Points so far behind the marking at which the halfway line ends are something else, pixels at 1920 px width."""
CHORD_AT = 0.6
"""Half chords from the middle at which the halfway line's width is predicted."""


class CuesConfig(BaseModel):
    """Options of the stage ``cues``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    halfway_line: bool = Field(True, description="Whether the halfway line is used.")
    centre_mark: bool = Field(True, description="Whether the centre mark is looked for.")
    further_lines: bool = Field(True, description="Whether other straight markings are measured.")
    field_lines: bool = Field(
        True, description="Whether a picture without the circle may be recognised by its straight markings."
    )
    search_px: float = Field(
        6, gt=0, le=100, description="Search to both sides of a rough line, pixels at 1920 px width."
    )
    spacing_px: float = Field(2.0, ge=0.5, le=20, description="Distance of the measured points, pixels.")
    minimum_support: float = Field(
        0.27, ge=0, le=1, description="Least share of the visible chord on which the halfway line is seen."
    )
    mark_snr: float = Field(4.0, ge=0, description="Least signal to noise ratio of the centre mark.")
    mark_offset: tuple[float, float] = Field(
        (0.05, 0.24),
        description="Where the centre mark may lie: half chords beyond the chord's middle, towards the far side.",
    )


@dataclass(frozen=True, slots=True)
class _Scene:
    """A picture with what all lines in it are measured by.

    Attributes
    ----------
    picture : (H, W) uint8 or float32
        Brightness.
    noise : float
        Grey-level noise.
    rounds : tuple of (float, float)
        How widely and how densely a line is measured, one measurement after the other.
    config : CuesConfig
        Options of the stage.
    """

    picture: GrayPicture
    noise: float
    rounds: Rounds
    config: CuesConfig

    @property
    def unit(self) -> float:
        """Pixels per pixel at 1920 px width."""
        return self.picture.shape[1] / 1920.0

    def measure(self, segments: Sequence[Segment], widths: Array) -> list[LineCue | None]:
        """Lines along segments whose paint is so many pixels wide (N, 2) at its ends; 0 where that is not known."""
        return measure_lines(
            self.picture, segments, self.noise, self.config.search_px, self.config.spacing_px, self.rounds, widths
        )


@dataclass(frozen=True, slots=True)
class _Expectation:
    """Where the halfway line is looked for.

    Attributes
    ----------
    rough : Segment
        As the stage ``mask`` found it.
    near : Segment
        The part that is measured.
    chord : (2, 2) array
        Where it enters and leaves the circle, in the picture or not.
    inside : Segment or None
        What the picture shows of the chord; None where that does not count, or none of it is in view.
    growth : (3,) array
        Width of its paint in the picture, px: coefficients of x, y and 1.
    surface : (h, w) bool array or None
        Where it may be followed, in a reduced picture; everywhere where None.
    name : str or None
        What the template calls it.
    """

    rough: Segment
    near: Segment
    chord: Array
    inside: Segment | None
    growth: Array
    surface: NDArray[np.bool_] | None
    name: str | None


def find_cues(
    picture: GrayPicture,
    mask: MarkingMask,
    ellipses: EllipseFits,
    noise: float,
    template: FieldTemplate,
    config: CuesConfig,
    blur_px: float = 1.0,
) -> Cues:
    """Measure what fixes the rotation about the circle and its imaged centre.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field (:func:`circlecal.paint.profiles.to_gray`).
    mask : MarkingMask
        Gives the rough lines.
    ellipses : EllipseFits
        From the stage ``ellipse``.
    noise : float
        Grey-level noise of the picture.
    template : FieldTemplate
        The field.
    config : CuesConfig
        Options.
    blur_px : float
        Standard deviation of the picture's blur.

    Returns
    -------
    Cues
        What was found; a cue that is not seen is None, never invented.
    """
    fit = ellipses.primary
    scene = _Scene(picture, noise, ONE_ROUND if mask.source == "detector" else TWO_ROUNDS, config)
    further = mask.lines if config.further_lines else ()
    expected = _expect_halfway_line(scene, mask, fit, template)
    if expected is None:
        measured = scene.measure(further, np.zeros((len(further), 2)))
        halfway, lines = None, [line for line in measured if line is not None]
    else:
        halfway, lines = _measure_halfway_line(scene, expected, further)
        halfway = None if halfway is None else leave_out_hidden_ends(halfway, lines, scene.unit)
    mark = None
    if config.centre_mark and halfway is not None and "centre_mark" in template.mark_by_name:
        mark = _centre_mark(picture, halfway, fit, template, blur_px, config)
    return Cues(halfway=halfway, mark=mark, lines=tuple(keep_on_course(line, scene.unit) for line in lines))


def _expect_halfway_line(
    scene: _Scene, mask: MarkingMask, fit: EllipseFit, template: FieldTemplate
) -> _Expectation | None:
    """Where the halfway line is looked for; None where it is not, or misses the circle or the picture."""
    rough, config, shape = mask.halfway, scene.config, scene.picture.shape
    if rough is None or not config.halfway_line or template.halfway_line is None:
        return None
    chord = _chord(fit.conic, join(lift(rough.start), lift(rough.end)))
    if chord is None:
        return None
    # the picture may show the halfway line outside the circle only
    inside = _clip_chord(chord, 1.0, shape)
    near = rough if inside is None else _clip_chord(chord, REACH_HALF_CHORDS, shape)
    if near is None:
        return None
    growth = _paint_width(fit.conic, chord, template, fit.edge)
    return _Expectation(rough, near, chord, inside, growth, _add_margin(mask.field_region), template.halfway_line)


def _measure_halfway_line(
    scene: _Scene, expected: _Expectation, further: Sequence[Segment]
) -> tuple[LineCue | None, list[LineCue]]:
    """The halfway line, None where too little of it is seen, and those further lines that are no pieces of it."""
    widths = np.zeros((len(further) + 1, 2))
    widths[-1:] = widths_at(expected.growth, [expected.near])
    *measured, first = scene.measure((*further, expected.near), widths)
    first = None if first is None else _keep_on_surface(first, expected, scene.picture.shape)
    pieces, others = _split_pieces(first, measured, scene.unit)
    halfway = _complete_halfway_line(scene, expected, first, pieces)
    if halfway is not None or expected.inside is None:
        return halfway, others
    # the paint inside the circle may be worn off: all of the line counts then
    whole = replace(expected, near=expected.rough, inside=None)
    (first,) = scene.measure((whole.near,), widths_at(whole.growth, [whole.near]))
    pieces, others_of_whole = _split_pieces(first, measured, scene.unit)
    halfway = _complete_halfway_line(scene, whole, first, pieces)
    return halfway, others if halfway is None else others_of_whole


def cues_from_observations(observations: Observations, template: FieldTemplate, circle: Circle) -> Cues:
    """Cues from points that somebody else found: named lines, the centre mark or a keypoint at the circle's centre."""
    lines = [_line_cue(seen) for seen in observations.lines if len(seen.points_px) >= 2]
    halfway = next((line for line in lines if line.name is not None and line.name == template.halfway_line), None)
    center = np.asarray(circle.center)
    spots = [
        (m.mark, m.point_px, m.sigma_px)
        for m in observations.marks
        if m.mark in template.mark_by_name and np.allclose(template.mark_by_name[m.mark].position, center)
    ]
    spots += [(k.name, k.point_px, k.sigma_px) for k in observations.keypoints if np.allclose(k.field_m, center)]
    mark = MarkCue(spots[0][0], spots[0][1], float(spots[0][2]), float("inf")) if spots else None
    return Cues(halfway, mark, tuple(line for line in lines if line is not halfway))


def _line_cue(seen: LinePoints) -> LineCue:
    """The line through points that somebody else found."""
    line = fit_line(seen.points_px, 1.0 / seen.sigma_px**2)
    position = seen.points_px @ np.array([line[1], -line[0]])
    ends = Segment(seen.points_px[np.argmin(position)], seen.points_px[np.argmax(position)])
    rms = float(np.sqrt(np.mean(line_distance(line, seen.points_px) ** 2)))
    return LineCue(seen.line, line, seen.points_px, seen.sigma_px, ends, rms)


def _clip_chord(chord: Array, half_chords: float, shape: tuple[int, ...]) -> Segment | None:
    """The part in the picture of a chord's line, so many half chords to both sides of the chord's middle."""
    middle, half = _middle_and_half(*chord)
    clipped = clip_segment(middle - half_chords * half, middle + half_chords * half, shape[1], shape[0])
    return None if clipped is None else Segment(*clipped)


def _complete_halfway_line(
    scene: _Scene, expected: _Expectation, cue: LineCue | None, pieces: Sequence[LineCue]
) -> LineCue | None:
    """The measured line with further pieces, continued as far as it is seen; None where too little is seen of the chord
    inside the picture, or of the line where the chord does not count.
    """
    if cue is None:
        return None
    config, growth = scene.config, expected.growth
    support = _support(cue, expected, config)
    if support < COVERED_SHARE * config.minimum_support:
        return None
    chord = expected.chord if expected.inside is not None else (cue.segment.start, cue.segment.end)
    middle, half = _middle_and_half(*chord)
    reach = float(np.linalg.norm(half))
    further = follow_line(scene.picture, cue, reach, growth, scene.noise, config.search_px, config.spacing_px)
    if support < config.minimum_support and not further:
        return None
    points, sigma = _join_pieces(cue, further, pieces, expected.surface, scene.picture.shape)
    segment = Segment(cue.segment.start, cue.segment.end, support)
    unit = max(scene.unit, 0.5)
    line = LineCue(expected.name, cue.line, points, sigma, segment, cue.rms_px, (), cue.width_px)
    line = keep_on_course(line, unit)
    clear = RIM_CLEARANCE_PX * unit if expected.inside is not None else -RIM_CLEARANCE_PX * unit
    ends = paint_ends(scene.picture, line.points_px, middle, reach + clear, growth)
    kept = _find_before_crossing(line.points_px, middle, ends, END_CLEARANCE_PX * unit)
    return replace(line, points_px=line.points_px[kept], sigma_px=line.sigma_px[kept], ends=ends)


def _support(cue: LineCue, expected: _Expectation, config: CuesConfig) -> float:
    """Share of the chord inside the picture on which a line is seen; its own support where the chord does not count."""
    if expected.inside is None:
        return cue.segment.support
    middle, half = _middle_and_half(*expected.chord)
    inside = np.abs((cue.points_px - middle) @ half / (half @ half)) < 1.0
    most = float(np.linalg.norm(expected.inside.end - expected.inside.start)) / config.spacing_px
    return float(inside.sum() / max(most, 1.0))


def _join_pieces(
    cue: LineCue,
    further: Sequence[LineCue],
    pieces: Sequence[LineCue],
    surface: NDArray[np.bool_] | None,
    shape: tuple[int, ...],
) -> tuple[Array, Array]:
    """Points (N, 2) of a line, of where it was followed to and of its pieces beyond that, and their standard deviations
    (N,); those that were added lie on the surface (h, w) of a reduced picture.
    """
    added = list(further)
    for piece in pieces:
        beyond = _beyond_extent(cue.line, (cue, *added), piece.points_px) > 0
        added.append(replace(piece, points_px=piece.points_px[beyond], sigma_px=piece.sigma_px[beyond]))
    points = np.concatenate([part.points_px for part in (cue, *added)])
    sigma = np.concatenate([part.sigma_px for part in (cue, *added)])
    if surface is None:
        return points, sigma
    painted = _lie_on(surface, points, shape)
    painted[: len(cue.points_px)] = True
    return points[painted], sigma[painted]


def _middle_and_half(start: Array, end: Array) -> tuple[Array, Array]:
    """Middle (2,) of a segment, and from there to its end (2,)."""
    return 0.5 * (start + end), 0.5 * (end - start)


def _split_pieces(
    halfway: LineCue | None, lines: Sequence[LineCue | None], unit: float
) -> tuple[list[LineCue], list[LineCue]]:
    """Which of the lines are pieces of the halfway line, and which are others.

    Players hide so much of it now and then that it is found in two parts; lens and crown bend one against the other.
    """
    seen = [line for line in lines if line is not None]
    if halfway is None:
        return [], seen
    pieces: list[LineCue] = []
    others: list[LineCue] = []
    for line in seen:
        its = _continues(halfway, line, unit) or _continues(line, halfway, unit)
        (pieces if its else others).append(line)
    return pieces, others


def _continues(line: LineCue, other: LineCue, unit: float) -> bool:
    """Whether all points of the other lie on a line or where it goes on, in about its direction."""
    if abs(float(line.line[0] * other.line[1] - line.line[1] * other.line[0])) > LARGEST_TURN:
        return False
    off = np.abs(line_distance(line.line, other.points_px))
    bend = BENT_SHARE * _beyond_extent(line.line, (line,), other.points_px)
    return bool((off < ON_LINE_PX * unit + bend).all())


def _beyond_extent(line: Array, pieces: Sequence[LineCue], points: Array) -> Array:
    """How far along a line points (N, 2) lie beyond those of its pieces, px; 0 between them."""
    along = np.array([line[1], -line[0]])
    own, place = np.concatenate([piece.points_px for piece in pieces]) @ along, points @ along
    return np.maximum(np.maximum(own.min() - place, place - own.max()), 0.0)


def _add_margin(region: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """The playing surface and what lies close around it, where its own markings may still run."""
    if region is None:
        return None
    side = 2 * round(SURFACE_MARGIN * region.shape[1]) + 1
    grown = cv2.dilate(region.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(grown, np.uint8).view(np.bool_)


def _keep_on_surface(line: LineCue, expected: _Expectation, shape: tuple[int, ...]) -> LineCue:
    """The line without points beyond the segment by which it was found that lie off the playing surface: of a short arc
    the chord is a guess, and may reach into the stands.
    """
    if expected.surface is None:
        return line
    start, along = expected.rough.start, expected.rough.end - expected.rough.start
    share = (line.points_px - start) @ along / (along @ along)
    kept = ((share >= 0.0) & (share <= 1.0)) | _lie_on(expected.surface, line.points_px, shape)
    return replace(line, points_px=line.points_px[kept], sigma_px=line.sigma_px[kept]) if kept.any() else line


def _lie_on(surface: NDArray[np.bool_], points: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which points (N, 2) of a picture of this shape lie on the surface (h, w) of a reduced one."""
    (rows, columns), (height, width) = surface.shape, shape
    x, y = (points * (columns / width, rows / height)).astype(int).T
    return surface[np.clip(y, 0, rows - 1), np.clip(x, 0, columns - 1)]


def _find_before_crossing(points: Array, middle: Array, ends: Sequence[LineEnd], clear_px: float) -> NDArray[np.bool_]:
    """Which points (N, 2) do not lie behind a marking that the line runs into: there is none of its paint there."""
    kept = np.ones(len(points), np.bool_)
    for end in ends:
        along = end.point_px - middle
        if end.crossed:
            kept &= (points - middle) @ along < along @ along + clear_px * np.linalg.norm(along)
    return kept


def _paint_width(conic: Array, chord: Array, template: FieldTemplate, edge: CircleEdge) -> Array:
    """How wide the halfway line's paint is in the picture, to first order: coefficients (3,) of x, y and 1, px.

    Inside the circle its chords across the line give the scale; the image of a strip widens evenly along itself.
    """
    middle, half = _middle_and_half(*chord)
    points = middle + np.array([[-CHORD_AT], [CHORD_AT]]) * half
    aim = pole(conic, join(lift(chord[0]), lift(chord[1])))
    across = aim[:2] - aim[2] * points
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    length = float(np.linalg.norm(half))
    normal = np.array([-half[1], half[0]]) / length
    radius = template.radius(template.circle_by_name[template.default_circle], edge)
    share = template.marking_width_m / (radius * np.sqrt(1.0 - CHORD_AT**2))
    near, far = np.nan_to_num(share * half_chords(conic, points, across) * np.abs(across @ normal))
    along = half / length**2 * (far - near) / (2.0 * CHORD_AT)
    return np.append(along, 0.5 * (near + far) - along @ middle)


def _chord(conic: Array, line: Array) -> Array | None:
    """Where a line enters and leaves the circle (2, 2); None where it misses it."""
    meets = line_conic_meet(conic, line)
    return None if meets is None else dehomogenise(meets)


def _centre_mark(
    picture: GrayPicture,
    halfway: LineCue,
    fit: EllipseFit,
    template: FieldTemplate,
    blur_px: float,
    config: CuesConfig,
) -> MarkCue | None:
    """The centre mark on the halfway line; a short arc says less about where it may lie."""
    circle = template.circle_by_name[template.default_circle]
    radius = template.radius(circle, fit.edge)
    low, high = config.mark_offset
    spare = SHORT_ARC_SPARE * max(0.0, 1.0 - fit.arc_deg / SHORT_ARC_DEG)

    given = (
        picture,
        halfway.line,
        halfway.points_px,
        fit.conic,
        template.mark_by_name["centre_mark"].diameter_m / radius,
        template.marking_width_m / radius,
        float(np.clip(blur_px, 0.5, 3.0)),
    )
    usual, wider = ((low - more, high + more) for more in (spare, spare + FARTHER))
    found = (
        find_centre_mark(*given, usual, config.mark_snr)
        or find_centre_mark(*given, wider, CLEAR_TIMES * config.mark_snr)
        or find_mark_under_ball(*given, wider)
    )
    return None if found is None else MarkCue("centre_mark", found.point_px, found.sigma_px, found.snr)
