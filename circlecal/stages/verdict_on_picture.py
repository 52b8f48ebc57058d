"""The verdict on an accepted camera after a look at the rest of the picture: at the markings that the camera was not
fitted to, at paint that no marking explains, and at the ground around the field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from circlecal.checks import CHECKS
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.projective import Array, apply_homography, extent, lift, normalise_line, transform_lines
from circlecal.line_naming.reach import measure_beyond_ends
from circlecal.observations import MarkingKey, Observations
from circlecal.results import Agreement, Attempt, CameraFit, Check, Cues, Evidence, Surroundings, Verdict

LEAST_FOUND, FOUND_SURELY = 0.25, 0.3
"""Least share of the markings to be expected that is found, and from which on nothing else is tried: of right cameras
0.58 (47 real and rendered frames), of a wrong circle's or line's mostly less than a tenth, of a basketball court's as a
pitch's 0.13 to 0.2.
"""
LEAST_FOUND_CONFIRMED = 0.01
"""Least such share where the centre mark and another line confirm circle and halfway line, or one kind of confirmation
does and places are not well known: a right camera near the field's plane has 0.04 there, since thin paint is missed; of
a ring drawn on bare green nothing at all is found. Where less confirms the circle the other limit holds: right cameras
whose places are not well known have 0.7 and 0.9 (one rendered and one real frame of 160), a penalty arc that was taken
for the circle 0.05, a picture put together from others, with a mark but no line, 0.13.
"""
WORN_SHARES, WORN_LIMITS = (0.65, 0.9), (0.4, 1.0)
"""Share of circle and halfway line that is painted, and what is left of the least share for it: where much of them is
worn off, as much of the others is, which are thinner in the picture. Two right cameras of 80 rendered fields with worn
paint have 0.13 and 0.15 of the others, with 0.64 and 0.69 of circle and line; what a camera of another sport's field
was fitted to is painted throughout.
"""
OTHER_PAINT_WIDTHS, LEAST_FOUND_BESIDE = 0.1, 0.15
"""From so much paint along the field's axes on, picture widths, that no marking explains, such a share is asked for
whatever confirms the circle, where places are well known. That paint alone tells nothing: of right cameras it is 0.1 to
3.3 on 40 of 51 rendered pitches with white lines of rugby or hockey, on 6 of 323 without, and on 2 of 43 real ones; of
wrong cameras of smaller pitches and smaller circles 0.11 to 0.28. But of these five none finds more than 0.09 of the
markings to be expected, and of the 14 right ones that expect any 13 find 0.27 to 1; one that is 4 px off finds 0.06.
"""
EXPECTED_WIDTHS, EXPECTED_WIDTHS_MORE = 0.12, 0.2
"""So much of them, in picture widths, must be expected for that, and more where the centre mark confirms the circle and
their places are not well known. Of 1,264 calibrated frames of rendered pitches of all sizes the former refuses one
wrong and no right one where two further lines are named without a mark; where a mark is seen it would refuse three
right ones by the larger share. So less than that is asked there by the smaller one, for places that are well known:
four wrong cameras of smaller pitches expect 0.12 to 0.19 and find nothing; of 91 right ones of rendered and real
pitches that expect 0.12 or more the least finds 0.36, and 0.06 of nine with white lines of other sports.
"""
FEWEST_NAMED = 5
"""Different lines and arcs that carry a camera without the circle, arcs counted twice: of four lines, two along the
field and two across it, one constraint of eight is left to tell a wrong naming (of 33 real frames with lines left out
at random, only cameras from four markings were wrong), and an arc brings as many constraints as two lines or more.
"""
MOST_BEYOND_END = 0.035
"""Picture widths over which a line may be seen beyond its end: 15 cameras of real penalty areas and 12 right ones of
rendered frames have at most 0.022; one that was 16 m off, since it took a part of a penalty area's front for all of it,
has 0.077.
"""
LEAST_FOUND_OF_FIELD, EXPECTED_OF_FIELD_WIDTHS = 0.5, 0.06
"""Least share of the other markings to be expected that is found for such a camera, and how many picture widths of them
must be expected for that: right ones on those frames have 0.57 to 1. Of 45 rendered and two real ones the 13 that
expect 0.04 to 0.12 find 0.82 to 1; a tennis court that was taken for a penalty area expects 0.116 and finds 0.11.
"""
MOST_UNEXPLAINED = 0.22
"""Most paint on the field that no marking explains, picture widths: on 190 right answers to rendered frames of all
kinds at most 0.18 oblique to the field's axes (real frames 0.05), on wrong ones up to 0.3. Lines of other sports run
along those axes (up to 1.9 on a hall's floor); one alone counts where no further line confirms the camera.
"""
LEAST_PAINTED, LEAST_PAINTED_MARKED, LEAST_PAINTED_CARRIED, CARRYING_LINES = 0.55, 0.48, 0.35, 3
"""Least share of circle and halfway line that is painted where they must be in view: of those right answers at least
0.68, of a rink's circle taken for a pitch's 0.46. Where a further line and a mark agree with the camera, a worn circle
needs a share that is only just above the latter. The last two are for so many further lines that carry the camera,
which another circle's would not: a right camera of a rendered field with worn paint has 0.45 and three.
"""
MOST_REVERSAL = 3.0
"""By how much (half a chi-square) exchanged near and far may explain the width of the paint better, and as much more
for each further line that is named: of right answers without such lines at most 0.9 (rendered frames of all kinds, 54
real frames of pans), with them at most 4.8; of pictures turned upside down or mirrored 3.8 to 8.6.
"""
USUAL_RADIUS_PX = 500.0
"""Radius of a circle in the picture, pixels at 1920 px width, from which on what paint and ground leave of it grows
with it, since that is some of the field: circles of real pitches lie 0.5 to 1 cm beside the ideal one. Three of 40
pictures of real pitches of which the middle half was left, and in which the circle is 1.5 to 3.5 times as large, left
13 to 15 times the picture's noise with cameras within 5 px of the truth; uncut ones at most 5.6 times.
"""
ROUND = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
"""Angles at which the circle is looked at for how large it is seen."""
MOST_NOISE, THIN_PAINT = 11.0, 0.02
"""Times the noise of the picture that circle and lines may leave, and the width of paint, in radii of its circle, from
which on it may be more, as paint is wider: it is ragged. Of 3,620 rendered answers within 5 px of the truth at most
9.7, of real pitches 5.6; of 285 others five have 11.8 to 23.9, one of them a picture put together from two halves. A
real robots' field, with paint of 0.067 radii, has 14.3.
"""
MOST_ROUGH = 0.12
"""Most of the field in view that may be as rough as a crowd: of right answers at most 0.09 (lettered banners, strips of
advertising), of pictures whose quarters were exchanged 0.08 to 0.37.
"""
LONGEST_BARE, LONGEST_BARE_CONFIRMED = 0.08, 0.16
"""By how much the paint of the halfway line may end too early in full view, picture widths: of right answers at most
0.042, of pictures whose quarters were exchanged, and of lines drawn on green, 0.10 to 0.28. Where the circle is worn
off for longer the line may be, too: three right cameras of 40 rendered fields with worn paint have 0.09 to 0.13 beside
0.18 to 0.25 on the circle. Where several lines confirm the camera, and the centre mark does or a marking to which it
was not fitted is found, the line's end is worn off: three right cameras of 240 have 0.10 to 0.13; of seven pictures of
200 that were altered, whose lines break off by 0.14 to 0.28, none has two further lines, or a marking that is found.
"""
MOST_BEYOND, MOST_BEYOND_LINES = 0.05, 0.25
"""Most of the picture that may be playing surface above the horizon or far beyond the field's border; beyond it where a
further line tells the border, since there may be another field beside it. Of right answers 0.002 at most, of pictures
whose quarters were exchanged 0.09 to 0.5.
"""
FLOOR_LINES, MOST_FLOOR = 2, 0.5
"""Further lines and marks of a field on a floor that must carry the camera, or be found where it puts them, with which
so much of the picture may be floor above the horizon or beyond the border: walls and ceilings have a floor's colour. Of
right answers in 100 rendered halls up to 0.39, and oblique paint up to 0.64: other sports' arcs, as much more of which
is allowed for each further line that carries the camera.
"""
MOST_BEFORE = 0.28
"""Most of the picture that may lie before the field and be no playing surface, unless it is plain: of right answers to
real frames at most 0.22 (spectators, dugouts), of pictures whose halves were exchanged 0.1 to 0.6, the only one of 80
that nothing else refuses 0.30.
"""
MOST_OF_SEAM = 0.4
"""Share of the picture's width or height along which two rows or columns may meet in a step that no lens leaves: of 260
right answers at most 0.22, of pictures whose quarters were exchanged 0.41 to 0.91 in 13 of 20.
"""
ADDED_UP = (
    "unexplained_widths",
    "painted_share_of_carriers",
    "bare_widths",
    "rough_share",
    "above_share",
    "beyond_share",
)
MOST_TOGETHER = 1.3
"""Checks that are added up, and the most to which they may come: the root of the summed squares of how much of its
limit each uses up. Of 1,481 right answers to rendered frames two have 1.07 and 1.15 and all others at most 0.92, of 55
right ones to real frames at most 0.8; a circle behind a banner that a camera puts into the stands has 1.62.
"""
LOWEST_FREE_M = 1.5
"""A camera that stands lower, metres, sees boards and walls around the field above its horizon, on grass too: those of
rendered robots' fields reach to 1 m and have a rail of the carpet's colour.
"""
MOST_BARE_ENDS = 1.0
"""Ends of the halfway line that may lie on bare ground in full view, where it alone confirms the circle: one may be
worn off. Of 100 rendered pitches with worn and repainted lines and 45 real frames none has two, whatever confirms it; a
ring and a line drawn on green have, and were calibrated with 57 px (at 1920 px width) where no other check spoke.
"""
CONFIRMING_LINES = 2
"""So many further lines confirm circle and halfway line: one is easily named wrongly."""


def kinds_of_confirmation(camera: CameraFit, cues: Cues) -> int:
    """How many of these confirm circle and halfway line: the centre mark, several other lines."""
    return int(has_mark(camera, cues)) + int(len(camera.named_lines) >= CONFIRMING_LINES)


def has_mark(camera: CameraFit, cues: Cues) -> bool:
    """Whether the camera was fitted to a centre mark too."""
    return cues.mark is not None and MarkingKey(cues.mark.name) not in camera.rejected


def is_beyond_doubt(camera: CameraFit, cues: Cues, template: FieldTemplate) -> bool:
    """Whether nothing else need be looked for: the centre mark is seen where there is one circle only, or more lines
    too.
    """
    kinds = kinds_of_confirmation(camera, cues)
    return kinds == 2 or (kinds == 1 and cues.mark is not None and len(template.circles) == 1)


def must_show_ends(camera: CameraFit, cues: Cues, template: FieldTemplate) -> bool:
    """Whether nothing but the halfway line confirms the circle of a pitch: then it must end at other lines."""
    is_confirmed = has_mark(camera, cues) or len(camera.named_lines) > 0
    return template.ground == "grass" and template.halfway_line is not None and not is_confirmed


def judge_ends(verdict: Verdict, bare_ends: int) -> Verdict:
    """The verdict on an accepted camera after the ends of the halfway line's paint were looked at."""
    return verdict.with_checks(Check.of("bare_ends", float(bare_ends), MOST_BARE_ENDS))


def confirm(
    verdict: Verdict, camera: CameraFit, cues: Cues, agreement: Agreement, evidence: Evidence | None = None
) -> Verdict:
    """The verdict on an accepted camera after a look at the markings that it was not fitted to.

    Paint that no marking explains asks for more of them: it may be theirs.
    """
    is_marked = has_mark(camera, cues)
    expected_widths = agreement.expected_px / camera.camera.width
    is_little = is_marked and expected_widths < EXPECTED_WIDTHS + EXPECTED_WIDTHS_MORE
    if expected_widths < EXPECTED_WIDTHS or (is_little and not agreement.certain):
        return verdict
    is_confirmed_well = (
        is_little
        or (is_marked and len(camera.named_lines) > 0)
        or (not agreement.certain and kinds_of_confirmation(camera, cues) > 0)
    )
    is_other_painted = evidence is not None and evidence.parallel_widths >= OTHER_PAINT_WIDTHS and agreement.certain
    confirmed = LEAST_FOUND_BESIDE if is_other_painted else LEAST_FOUND_CONFIRMED
    limit = confirmed if is_confirmed_well else LEAST_FOUND
    painted = verdict.check("painted_share_of_carriers")
    if painted is not None and not is_confirmed_well:
        limit *= float(np.interp(painted.value, WORN_SHARES, WORN_LIMITS))
    return verdict.with_checks(Check.of("found_share", agreement.found_share, limit))


def weigh_evidence(
    verdict: Verdict,
    camera: CameraFit,
    evidence: Evidence,
    ground: Surroundings,
    template: FieldTemplate,
    agreement: Agreement,
) -> Verdict:
    """The verdict on an accepted camera after all of the picture, its paint and its ground, was weighed against it.

    Paint that lies where the camera puts it, although it was not fitted to it, carries it like a further line.
    """
    unexplained = evidence.oblique_widths + (0.0 if camera.named_lines else evidence.alone_widths)
    lines = _count_further_lines(camera, template)
    further = 0 if template.ground == "grass" else lines
    marks = _count_marks(camera, template)
    found = _count_found(agreement)
    carried = lines + marks + found
    most_beyond = MOST_BEYOND_LINES if camera.named_lines else MOST_BEYOND
    is_floor = _may_have_walls(camera, template) and carried >= FLOOR_LINES
    least_painted = LEAST_PAINTED_MARKED if lines > 0 and marks > 0 else LEAST_PAINTED
    least_painted = LEAST_PAINTED_CARRIED if lines >= CARRYING_LINES else least_painted
    longest_bare = LONGEST_BARE_CONFIRMED if lines >= CONFIRMING_LINES and marks + found > 0 else LONGEST_BARE
    own = (
        Check.of("unexplained_widths", unexplained, MOST_UNEXPLAINED * (1 + further)),
        Check.of("painted_share_of_carriers", evidence.painted_share, least_painted),
        Check.of("reversal", evidence.reversal, MOST_REVERSAL * (1 + len(camera.named_lines))),
        Check.of("bare_widths", evidence.bare_widths, max(longest_bare, evidence.worn_widths)),
        Check.of("rough_share", ground.rough_share, MOST_ROUGH),
        Check.of("above_share", ground.above_share, MOST_FLOOR if is_floor else MOST_BEYOND),
        Check.of("beyond_share", ground.beyond_share, MOST_FLOOR if is_floor else most_beyond),
        Check.of("near_share", ground.near_share, MOST_BEFORE),
        Check.of("seam_share", ground.seam_share, MOST_OF_SEAM),
        Check.of("noise_scale", camera.noise_scale, _most_noise(camera, template)),
    )
    return verdict.with_checks(*own, Check.of("contradictions", _add_up(own), MOST_TOGETHER))


def _add_up(checks: Sequence[Check]) -> float:
    """How much of what :data:`ADDED_UP` allow is used up by all together: the root of the sum of squares."""
    used = [
        (1.0 - check.value) / (1.0 - check.limit) if CHECKS[check.name].at_least else check.value / check.limit
        for check in checks
        if check.name in ADDED_UP
    ]
    return float(np.linalg.norm(used))


def _most_noise(camera: CameraFit, template: FieldTemplate) -> float:
    """Most of the picture's noise that may be left, where paint is as wide as the template's and the camera sees it so
    large.
    """
    circle = template.circle_by_name[template.default_circle]
    ragged = template.marking_width_m / template.radius(circle, "center") / THIN_PAINT
    pixels = camera.view.project(camera.view.circle_points(circle, "center", ROUND, template))
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    radius_px = extent(seen) / 2.0 * 1920.0 / camera.camera.width if len(seen) else 0.0
    return MOST_NOISE * max(1.0, ragged) * max(1.0, radius_px / USUAL_RADIUS_PX)


def _may_have_walls(camera: CameraFit, template: FieldTemplate) -> bool:
    """Whether what has the surface's colour above the horizon may be a wall or a ceiling."""
    return template.ground != "grass" or float(-camera.camera.position_m[2]) < LOWEST_FREE_M


def _count_found(agreement: Agreement) -> int:
    """How many markings to which the camera was not fitted are found where it puts them; none where most are not."""
    if agreement.found_share < LEAST_FOUND_OF_FIELD:
        return 0
    return int(np.count_nonzero(agreement.share >= LEAST_FOUND_OF_FIELD))


def _count_further_lines(camera: CameraFit, template: FieldTemplate) -> int:
    """How many lines beside the halfway line carry a camera, by their points or by an end of another one on them."""
    seen = {key.name for key in camera.residuals_px} & set(template.line_by_name)
    return len(seen - {template.halfway_line})


def _count_marks(camera: CameraFit, template: FieldTemplate) -> int:
    """How many marks carry a camera: with its circle, that in its middle tells where the horizon is."""
    return len({key.name for key in camera.residuals_px} & set(template.mark_by_name))


def confirm_field_lines(
    verdict: Verdict,
    camera: CameraFit,
    observations: Observations,
    used: frozenset[str],
    agreement: Agreement,
    template: FieldTemplate,
) -> Verdict:
    """The verdict on a camera from straight markings that were named together, without the circle: enough different
    markings carry it and end where it has their ends, and of the others that must be in view most are there.
    """
    arcs = used & set(template.circle_by_name)
    count = Check.of("named_markings", float(len(used) + len(arcs)), float(FEWEST_NAMED))
    beyond = Check.of("beyond_end_widths", measure_beyond_ends(camera, observations, template), MOST_BEYOND_END)
    checks = (*verdict.checks, count, beyond)
    if agreement.expected_px >= EXPECTED_OF_FIELD_WIDTHS * camera.camera.width:
        checks = (*checks, Check.of("found_share", agreement.found_share, LEAST_FOUND_OF_FIELD))
    failed = next((check for check in checks if not check.passed), None)
    return replace(verdict, checks=checks) if failed is None else Verdict.refusal_by(failed, checks)


def needs_confirmation(verdict: Verdict) -> bool:
    """Whether an accepted circle may be another one: hardly any other marking is where it would have to be."""
    found = verdict.check("found_share")
    return verdict.status == "calibrated" and found is not None and found.value < FOUND_SURELY


def is_confirmed(attempt: Attempt, template: FieldTemplate, circle: Circle, near_px: float) -> bool:
    """Whether a circle that was not the first choice is believed: other markings, or the centre mark, confirm it.

    A homography without a camera may be ``near_px`` off at the centre mark, pixels of the picture.
    """
    if attempt.verdict is None or attempt.cues is None:
        return False
    if attempt.camera is None:
        H = None if attempt.homography is None else attempt.homography.H_image_field
        return H is not None and _is_confirmed_by_homography(H, attempt.cues, template, circle, near_px)
    found = attempt.verdict.check("found_share")
    is_there = found is not None and found.value >= FOUND_SURELY
    return is_there or kinds_of_confirmation(attempt.camera, attempt.cues) > 0


def _is_confirmed_by_homography(H: Array, cues: Cues, template: FieldTemplate, circle: Circle, near_px: float) -> bool:
    """Whether the centre mark, or several further lines, are seen where a homography alone puts them.

    It knows no lens, so everything may be as far off as the centre mark may.
    """
    if cues.mark is not None:
        return bool(np.linalg.norm(apply_homography(H, np.asarray(circle.center)) - cues.mark.point_px) <= near_px)
    lines = [line for line in template.lines if line.name != template.halfway_line]
    drawn = normalise_line(transform_lines(H, np.array([template.line_coordinates(line) for line in lines])))
    # root mean square distance of each seen line's points from the nearest drawn one
    seen = [np.sqrt(np.mean((lift(cue.points_px) @ drawn.T) ** 2, axis=0)).min(initial=np.inf) for cue in cues.lines]
    return sum(rms <= near_px for rms in seen) >= CONFIRMING_LINES
