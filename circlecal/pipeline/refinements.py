"""What is measured again within one attempt, where its own camera says what to look for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Arc, Circle, FieldTemplate
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.marking_places import place_markings
from circlecal.observations import CirclePoints, LinePoints, Observations, join_observations
from circlecal.paint.old_coat import find_old_coats, remove_old_coat, sample_coats
from circlecal.paint.predicted_width import WIDE_PX, blur_widths, predict_line_widths, predict_paint_widths
from circlecal.paint.profiles import GrayPicture
from circlecal.pipeline.attempts import calibrate_extra, estimate, look_again, measure
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.pipeline.template_markings import measure_straight_markings
from circlecal.placement import mean_distance_px
from circlecal.refusals import REFUSALS
from circlecal.results import Attempt, CameraFit, Interpretation, LineCue, MarkingMask
from circlecal.stages.faint_lines import find_faint_lines
from circlecal.stages.rays import measure_along_model

PARTIAL_DEG = 240.0
"""Degrees of the circle; where less is seen, the circle is measured again along the camera's curve: an ellipse that was
fitted to a part of it leaves the paint beyond.
"""


MOST_ROUNDS, SETTLED_PX = 4, 0.5
"""How often the circle is measured again while the camera moves the markings by more than this on average, pixels at
1920 px width: paint that is wider than the search leads there step by step. An experiment that always measured again,
on 60 rendered robots' fields, brought 46 instead of 43 within 5 px, and none instead of one beyond 20 px.
"""
LOST_WIDTHS = 0.12
"""Mean distance, picture widths, by which one round may move the markings for another one to follow: in 64 rendered
frames of four profiles those of wide paint in calibrated frames moved them by 0.003 at most, of one refused frame by
0.034; in a picture without a field, where rounds led nowhere, all that had a camera by 0.24 or more.
"""
BROADEST = 2.0
"""Times the width that the camera predicts for its paint, blurred as the picture is, from which on a line is no marking
but a kerb or a part of a board.
"""
CLEAR_OF_LINES_PX = 6.0
"""Points of an arc so near to where a straight marking runs, pixels at 1920 px width, are left out: at a slant the line
on which the arc ends is as near as the arc, and nine of 39 points lay on it in a rendered frame, up to 6 px beside
the arc.
"""
SEEN_BEFORE_PX, SEEN_BEFORE_SHARE = 6.0, 0.5
"""A faint marking of which this share of the points lies so near to those of a measured line, pixels at 1920 px width,
was seen before: in a rendered frame both halves of a touchline were, and what joined them bent the camera by 8 px.
"""
MOST_COAT_ROUNDS, QUIET_NOISE, MORE_NOISE = 3, 1.2, 1.1
"""How often the circle is measured again without an old coat; noise of a camera, in units of what was measured, that
leaves nothing to be explained; and by which factor a further round may raise it: a camera that the old coat had led
astray came down from 5.8 to 5.2, 4.5 and 1.1 in three rounds, and its error from 42 to 3 px.
"""
UNEXPLAINED_NOISE, LESS_NOISE, CLEARLY_LESS_NOISE = 4.5, 0.7, 0.8
"""Noise of a camera, in units of what was measured, from which on two coats that are alike are looked for; the factor
to which it comes down at most where they are there; and the factor to which it does without the old one compared with
the new one. Measured along both of them the circle of nine rendered frames leaves 6.2 to 29, and 0.07 to 0.62 of that
without the old one, which is 0.03 to 0.5 of what it leaves without the new one on eight; on one it is 1.05, and the
centre mark tells. Real circles without an old coat leave 1.9 to 5.5, and 0.95 or more of that on the three where two
alike coats explain the paint better.
"""
UNCERTAIN_PX = 12.0
"""Largest predicted error, pixels at 1920 px width, from which on fainter straight markings are looked for."""


@dataclass(frozen=True, slots=True)
class Retry:
    """One thing to try after an attempt: when it is worth it, the attempts that it makes, which of them is taken."""

    when: Callable[[Setting, Attempt], bool]
    how: Callable[[Setting, Scene, Attempt], Iterator[Attempt]]
    accept: Callable[[Setting, Attempt, Attempt], bool]

    def try_out(self, setting: Setting, scene: Scene, attempt: Attempt) -> Attempt | None:
        """The first of its attempts that is taken in the place of the one given; None where none is."""
        if not self.when(setting, attempt):
            return None
        return next((new for new in self.how(setting, scene, attempt) if self.accept(setting, attempt, new)), None)


def _is_draft(attempt: Attempt) -> bool:
    """Whether the first camera is only what the circle is measured again along: where a halfway line turns it, names of
    other lines do not matter then.
    """
    if attempt.ellipses is None or not attempt.ellipses.all() or attempt.cues is None or attempt.cues.halfway is None:
        return False
    return attempt.ellipses.primary.arc_deg < PARTIAL_DEG


def _is_worth_remeasuring(setting: Setting, attempt: Attempt) -> bool:
    if attempt.camera is None or attempt.ellipses is None or not attempt.ellipses.all():
        return False
    refusal = REFUSALS.get(attempt.code or "")
    is_partial = attempt.ellipses.primary.arc_deg < PARTIAL_DEG
    return is_partial or (refusal is not None and refusal.remeasure) or _is_wide(setting, attempt.camera)


def _is_wide(setting: Setting, camera: CameraFit) -> bool:
    """Whether the paint of the circle is somewhere wider in the picture than a search of a few pixels reaches."""
    widths = predict_paint_widths(camera.view, setting.circle, setting.template)
    return bool(widths.max(initial=0.0) > WIDE_PX * setting.width / 1920.0)


def measure_curves(
    setting: Setting, picture: GrayPicture, camera: CameraFit, curves: Iterable[Circle], noise: float
) -> dict[str, CirclePoints]:
    """Circles and arcs, by name, measured where a camera puts them; without those of which too little is seen."""
    config = setting.config
    found = {}
    with setting.clock("rays"):
        for curve in curves:
            points, sigma = measure_along_model(picture, camera.view, curve, setting.template, noise, config.rays)
            if isinstance(curve, Arc) and len(points):
                kept = _lie_clear_of_lines(points, camera, setting.template)
                points, sigma = points[kept], sigma[kept]
            if len(points) >= config.ellipse.minimum_points:
                found[curve.name] = CirclePoints(curve.name, "center", points, sigma)
    return found


def _lie_clear_of_lines(points_px: Array, camera: CameraFit, template: FieldTemplate) -> Mask:
    """Which points (N, 2) of the picture lie beside all straight markings, as a camera shows these."""
    names, _, _ = template.outlines
    lines = place_markings(camera, template, [k for k, name in enumerate(names) if name in template.line_by_name])
    return np.asarray(
        _measure_distances(points_px, lines.base) > CLEAR_OF_LINES_PX * camera.model.width / 1920.0, np.bool_
    )


def replace_curves(observations: Observations, curves: Mapping[str, CirclePoints]) -> Observations:
    """The observations with these circles and arcs in the place of those of their names."""
    others = tuple(circle for circle in observations.circles if circle.circle not in curves)
    return replace(observations, circles=(*curves.values(), *others))


def remeasure_wide_paint(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The circle measured again along the curves of one camera after the other, where its paint is wide, until they
    settle, leave the markings, or are too uncertain: of six such frames of 500 that went on none came to an answer.
    """
    last = attempt
    for _ in range(MOST_ROUNDS):
        again = next(remeasure_along_camera(setting, scene, last), None)
        before, last = last.camera, again or last
        if again is None or again.camera is None or before is None or not _is_wide(setting, again.camera):
            break
        if again.code == "too_uncertain":  # what moves it is its own uncertainty, which no further round ends
            break
        moved_widths = mean_distance_px(before.view, again.camera.view, setting.template) / setting.width
        if not SETTLED_PX / 1920.0 <= moved_widths <= LOST_WIDTHS:
            break
    if last is not attempt:
        yield last


def remeasure_along_camera(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The circle, and the arcs of the field too where only further lines turn it, along the curves of the camera."""
    if attempt.fitted is None:
        return
    mask, edges, cues, observations, camera, _ = attempt.fitted
    is_turned_by_lines = cues.halfway is None and bool(camera.names_by_line)
    circle = setting.circle
    picture = lighten_markings(scene.marked, mask, circle)
    curves = (circle, *(setting.template.arcs if is_turned_by_lines else ()))
    found = measure_curves(setting, picture, camera, curves, edges.noise)
    if circle.name not in found:
        if _is_draft(attempt):
            yield estimate(setting, replace(attempt, verdict=None))
        return
    again = replace_curves(observations, found)
    if _is_wide(setting, camera):
        again = _measure_halfway(setting, picture, camera, again, mask.field_region, edges.noise)
    start = camera if is_turned_by_lines else None
    yield estimate(setting, replace(attempt, observations=again, verdict=None), start)


def _find_broad_lines(setting: Setting, attempt: Attempt) -> frozenset[int]:
    """Numbers among the further lines of those that are named, and far broader than the paint that they would be."""
    if attempt.fitted is None:
        return frozenset()
    _, edges, cues, _, camera, _ = attempt.fitted
    first = 0 if cues.halfway is None else 1
    names = {k - first: name for k, name in camera.names_by_line.items() if 0 <= k - first < len(cues.lines)}
    if not names:
        return frozenset()
    lines = [cues.lines[k] for k in names]
    seen_px = np.array([0.5 * (line.segment.start + line.segment.end) for line in lines])
    paint_px = predict_line_widths(camera.view.project, list(names.values()), seen_px, setting.template)
    largest_px = BROADEST * blur_widths(paint_px, edges.blur_px)
    is_broad = np.array([line.width_px for line in lines]) > largest_px
    return frozenset(k for k, broad in zip(names, is_broad.tolist(), strict=True) if broad)


def _names_lines(setting: Setting, attempt: Attempt) -> bool:
    return attempt.camera is not None and bool(attempt.camera.names_by_line)


def leave_out_broad_lines(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt without lines that were named and are far broader than the paint that they would be."""
    broad = _find_broad_lines(setting, attempt)
    if attempt.cues is None or attempt.observations is None or not broad:
        return
    first = 0 if attempt.cues.halfway is None else 1
    lines = tuple(line for k, line in enumerate(attempt.cues.lines) if k not in broad)
    kept = tuple(line for k, line in enumerate(attempt.observations.lines) if k - first not in broad)
    cues, observations = replace(attempt.cues, lines=lines), replace(attempt.observations, lines=kept)
    yield estimate(setting, replace(attempt, cues=cues, observations=observations, verdict=None))


def _measure_halfway(
    setting: Setting,
    picture: NDArray[np.uint8],
    camera: CameraFit,
    observations: Observations,
    region: NDArray[np.bool_] | None,
    noise: float,
) -> Observations:
    """The observations with the halfway line measured where a camera puts it, whose paint is wide like the circle's;
    its ends stay.
    """
    template = setting.template
    line = template.line_by_name.get(template.halfway_line or "")
    if line is None or all(seen.line != line.name for seen in observations.lines):
        return observations
    with setting.clock("cues"):
        options = region, noise, setting.config.rays
        found = measure_straight_markings(picture, camera.view, template, (line,), *options)
    if not found:
        return observations
    lines = (replace(found[0], ends=seen.ends) if seen.line == line.name else seen for seen in observations.lines)
    return replace(observations, lines=tuple(lines))


def _may_have_old_coat(setting: Setting, attempt: Attempt) -> bool:
    """Whether much of a circle was measured by the middle of its paint, which an old coat beside it would move."""
    if attempt.fitted is None or setting.circle.fill == "disc" or attempt.camera is None:
        return False
    is_measured = attempt.observations is not None and attempt.observations.circle(setting.circle.name, "center")
    return bool(is_measured)


def leave_out_old_coat(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt with the circle measured without the light of what is left of an old one beside it. Two coats that
    are alike are looked for where the camera leaves much unexplained, and believed where it does not without one.
    """
    cleaned = _clean_in_rounds(setting, scene, attempt, may_be_alike=False)
    if cleaned is None and _noise(attempt) > UNEXPLAINED_NOISE:
        cleaned = _clean_in_rounds(setting, scene, attempt, may_be_alike=True)
        if _noise(cleaned) > LESS_NOISE * _noise(attempt):
            return
    if cleaned is not None:
        yield cleaned


def _clean_in_rounds(setting: Setting, scene: Scene, attempt: Attempt, may_be_alike: bool) -> Attempt | None:
    """The attempt with the circle measured without an old coat, again along the camera that this leads to while that
    explains what was seen as well; None where no coat is told.
    """
    last = None
    for _ in range(MOST_COAT_ROUNDS):
        before = last or attempt
        again = _clean_circle(setting, scene, before, may_be_alike)
        if again is None or (last is not None and _noise(again) > MORE_NOISE * _noise(last)):
            break
        last = again
        if _noise(last) < QUIET_NOISE or _distance_widths(setting, before, last) <= SETTLED_PX / 1920.0:
            break
    return last


def _clean_circle(setting: Setting, scene: Scene, attempt: Attempt, may_be_alike: bool) -> Attempt | None:
    """The attempt with the circle measured without an old coat; None where none is told, or of two that are alike it
    is not clear which is the old one.
    """
    if attempt.fitted is None:
        return None
    mask, edges, _, observations, camera, _ = attempt.fitted
    circle, template = setting.circle, setting.template
    picture = lighten_markings(scene.marked, mask, circle)
    with setting.clock("rays"):
        profiles = sample_coats(picture, camera.view, circle, template)
        coats = () if profiles is None else find_old_coats(profiles, template.marking_width_m, may_be_alike)
        radius_m = template.radius(circle, "center")
        cleaned = [remove_old_coat(picture, camera.view, circle, radius_m, coat) for coat in coats]
    found = [measure_curves(setting, clean, camera, (circle,), edges.noise) for clean in cleaned]
    tried = [
        estimate(setting, replace(attempt, observations=replace_curves(observations, curves), verdict=None))
        for curves in found
        if curves
    ]
    return _choose_coat(tried)


def _choose_coat(tried: Sequence[Attempt]) -> Attempt | None:
    """That one of attempts without one coat each whose camera leaves out fewer of its cues, or else leaves less noise;
    None where that is not clear.
    """
    ranked = sorted(tried, key=lambda attempt: (_count_rejected(attempt), _noise(attempt)))
    if len(ranked) < 2 or _count_rejected(ranked[0]) < _count_rejected(ranked[1]):
        return next(iter(ranked), None)
    return ranked[0] if _noise(ranked[0]) < CLEARLY_LESS_NOISE * _noise(ranked[1]) else None


def _count_rejected(attempt: Attempt) -> float:
    """How many cues a camera leaves out; infinite without one."""
    return np.inf if attempt.camera is None else len(attempt.camera.rejected)


def _distance_widths(setting: Setting, one: Attempt, other: Attempt) -> float:
    """Mean distance between the markings of two attempts, picture widths; infinite where one has no camera."""
    if one.camera is None or other.camera is None:
        return np.inf
    return mean_distance_px(one.camera.view, other.camera.view, setting.template) / setting.width


def _noise(attempt: Attempt | None) -> float:
    """The noise that an attempt's camera leaves unexplained, in units of what was measured; infinite without one."""
    return np.inf if attempt is None or attempt.camera is None else attempt.camera.noise_scale


def _may_show_faint_lines(setting: Setting, attempt: Attempt) -> bool:
    if attempt.camera is None or attempt.cues is None or attempt.cues.halfway is None:
        return False
    is_uncertain = attempt.camera.max_sigma_px >= UNCERTAIN_PX * setting.width / 1920.0
    is_usable = attempt.is_calibrated or attempt.code == "too_uncertain"
    return is_uncertain and is_usable and setting.config.cues.further_lines


def add_faint_lines(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt with straight markings that stand out only where an uncertain camera may put them."""
    if attempt.fitted is None:
        return
    mask, _, cues, observations, camera, _ = attempt.fitted
    with setting.clock("cues"):
        picture = lighten_markings(scene.marked, mask, setting.circle)
        found = find_faint_lines(picture, camera, setting.template, setting.circle, mask.field_region)
        found = tuple(
            line for line in found if not _is_repetition(line, cues.lines, SEEN_BEFORE_PX * setting.width / 1920.0)
        )
    if not found:
        return
    lines = (LinePoints(None, line.points_px, line.sigma_px) for line in found)
    more = replace(observations, lines=(*observations.lines, *lines))
    more_cues = replace(cues, lines=(*cues.lines, *found))
    yield estimate(setting, replace(attempt, cues=more_cues, observations=more, verdict=None))


def _is_repetition(line: LineCue, others: Sequence[LineCue], near_px: float) -> bool:
    """Whether other lines were measured along most of a line."""
    if not others:
        return False
    points_px = np.concatenate([other.points_px for other in others])
    return bool(np.mean(_measure_distances(line.points_px, points_px) < near_px) > SEEN_BEFORE_SHARE)


def _measure_distances(points_px: Array, others_px: Array) -> Array:
    """From points (N, 2) to the nearest of others (M, 2) each, (N,)."""
    return np.asarray(np.linalg.norm(points_px[:, None] - others_px, axis=-1).min(axis=1, initial=np.inf))


def is_less_uncertain(setting: Setting, attempt: Attempt, refined: Attempt) -> bool:
    """Whether the refined attempt is calibrated, and its worst field point surer than that of the first."""
    if attempt.camera is None or refined.camera is None:
        return False
    return refined.is_calibrated and refined.camera.max_sigma_px < attempt.camera.max_sigma_px


def _misses_markings(setting: Setting, attempt: Attempt) -> bool:
    """Whether a camera is refused since markings are not where a field of the usual size has them."""
    size = None if attempt.camera is None else attempt.camera.field_size
    return attempt.code == "markings_missing" and size is not None and size.is_usual


def resize_field(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt on a field of another size than the usual one."""
    camera = setting.config.camera.model_copy(update={"usual_size_share": 0.0})
    other = replace(setting, config=setting.config.model_copy(update={"camera": camera}))
    yield look_again(other, scene, estimate(other, replace(attempt, verdict=None)))


def names_more_lines(setting: Setting, attempt: Attempt, refined: Attempt) -> bool:
    """Whether the refined attempt is calibrated, and names markings that the first did not."""
    if attempt.camera is None or refined.camera is None or not refined.is_calibrated:
        return False
    return len(set(refined.camera.named_lines) - set(attempt.camera.named_lines)) > 0


REFINEMENTS = (
    Retry(_is_worth_remeasuring, remeasure_wide_paint, lambda setting, attempt, refined: True),
    Retry(_names_lines, leave_out_broad_lines, lambda setting, attempt, refined: True),
    Retry(_may_have_old_coat, leave_out_old_coat, lambda setting, attempt, refined: True),
    Retry(_may_show_faint_lines, add_faint_lines, is_less_uncertain),
)
"""What is measured again within one attempt, where its camera says what to look for; in this order."""
RESIZE = Retry(_misses_markings, resize_field, names_more_lines)
"""A field of another size, where markings of the usual one are not there."""


def calibrate_scene(
    setting: Setting,
    scene: Scene,
    ruled_out: tuple[Interpretation, ...] = (),
    marking: MarkingMask | None = None,
) -> Attempt:
    """One attempt: measure, estimate, refine, and look whether the other markings are there.

    Parameters
    ----------
    setting, scene : Setting, Scene
        The frame.
    ruled_out : tuple of Interpretation
        What the built-in detector shall not take for the circle and its line again.
    marking : MarkingMask, optional
        Where the circle is; found in the picture when None.
    """
    attempt = measure(setting, scene, ruled_out, marking)
    if attempt.verdict is not None:
        return attempt if scene.extra is None else calibrate_extra(setting, attempt, scene.extra)
    if scene.extra is not None and attempt.observations is not None:
        attempt = replace(attempt, observations=join_observations(attempt.observations, scene.extra))
    attempt = estimate(setting, attempt, is_draft=_is_draft(attempt))
    for refinement in REFINEMENTS:
        attempt = refinement.try_out(setting, scene, attempt) or attempt
    attempt = look_again(setting, scene, attempt)
    return RESIZE.try_out(setting, scene, attempt) or attempt
