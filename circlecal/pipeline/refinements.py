"""What is measured again within one attempt, where its own camera says what to look for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.observations import Observations, join_observations
from circlecal.paint.predicted_width import WIDE_PX, blur_widths, predict_line_widths, predict_paint_widths
from circlecal.pipeline.attempts import (
    calibrate_extra,
    estimate,
    look_again,
    measure,
    observe_lines,
    set_apart_other_sports,
)
from circlecal.pipeline.curves import SETTLED_PX, distance_widths, measure_curves, measure_distances, replace_curves
from circlecal.pipeline.old_coats import leave_out_old_coat, may_have_old_coat
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.pipeline.template_markings import measure_straight_markings
from circlecal.refusals import REFUSALS
from circlecal.results import Attempt, CameraFit, Cues, Interpretation, LineCue, MarkingMask
from circlecal.stages.faint_lines import find_faint_lines
from circlecal.stages.mask import find_short_markings
from circlecal.stages.short_lines import measure_short_lines
from circlecal.stages.verdict_on_picture import has_mark

PARTIAL_DEG = 240.0
"""Degrees of the circle; where less is seen, the circle is measured again along the camera's curve: an ellipse that was
fitted to a part of it leaves the paint beyond.
"""
MOST_ROUNDS = 4
"""How often the circle is measured again while the camera moves the markings: paint that is wider than the search leads
there step by step. To measure always again brought 46 instead of 43 of 60 rendered robots' fields within 5 px, and none
instead of one beyond 20 px.
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
SEEN_BEFORE_PX, SEEN_BEFORE_SHARE = 6.0, 0.5
"""A faint marking of which this share of the points lies so near to those of a measured line, pixels at 1920 px width,
was seen before: in a rendered frame both halves of a touchline were, and what joined them bent the camera by 8 px.
"""
USUAL_WIDTH_M, TOLD_WIDTH_SD_M = 1.5, 1.0
"""Metres off the usual width, and standard deviation of the width among fields of all sizes, with which a touchline
tells that only the length is another: two rendered pitches 114 m long, whose penalty areas lie outside of where usual
ones do, have 0.1 and 0.5 to 0.6, three altered pictures that miss markings 0 to 0.5 and 9 to 12.
"""
OPEN_PX, OPEN_SIZE_M = 3.0, 0.5
"""Largest predicted error, pixels at 1920 px width, and standard deviation of the field's length or width, metres, from
which on short straight markings are looked for. Of 45 real frames those in which a penalty area told both sizes have
0.48 m at most; a size that nothing tells has 0.67 m or more.
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
        if not SETTLED_PX / 1920.0 <= distance_widths(setting, before, again.camera) <= LOST_WIDTHS:
            break
    if last is not attempt:
        yield last


def remeasure_along_camera(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The circle, and the arcs of the field too where only further lines turn it, along the curves of the camera."""
    fitted = attempt.fitted
    if fitted is None:
        return
    mask, camera, noise = fitted.mask, fitted.camera, fitted.edges.noise
    is_turned_by_lines = fitted.cues.halfway is None and bool(camera.names_by_line)
    circle = setting.circle
    picture = lighten_markings(scene.marked, mask, circle)
    curves = (circle, *(setting.template.arcs if is_turned_by_lines else ()))
    found = measure_curves(setting, picture, camera, curves, noise, scene.covered)
    if circle.name not in found:
        if _is_draft(attempt):
            yield estimate(setting, replace(attempt, verdict=None))
        return
    again = replace_curves(fitted.observations, found)
    if _is_wide(setting, camera):
        again = _measure_halfway(setting, picture, camera, again, mask.field_region, noise)
    start = camera if is_turned_by_lines else None
    yield estimate(setting, replace(attempt, observations=again, verdict=None), start)


def _find_broad_lines(setting: Setting, attempt: Attempt) -> frozenset[int]:
    """Numbers among the further lines of those that are named, and far broader than the paint that they would be."""
    fitted = attempt.fitted
    if fitted is None:
        return frozenset()
    cues, camera = fitted.cues, fitted.camera
    first = 0 if cues.halfway is None else 1
    names = {k - first: name for k, name in camera.names_by_line.items() if 0 <= k - first < len(cues.lines)}
    if not names:
        return frozenset()
    lines = [cues.lines[k] for k in names]
    seen_px = np.array([0.5 * (line.segment.start + line.segment.end) for line in lines])
    paint_px = predict_line_widths(camera.view.project, list(names.values()), seen_px, setting.template)
    largest_px = BROADEST * blur_widths(paint_px, fitted.edges.blur_px)
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
        found = measure_straight_markings(
            picture, camera.view, template, (line,), region=region, noise=noise, config=setting.config.rays
        )
    if not found:
        return observations
    lines = (replace(found[0], ends=seen.ends) if seen.line == line.name else seen for seen in observations.lines)
    return replace(observations, lines=tuple(lines))


def _may_show_faint_lines(setting: Setting, attempt: Attempt) -> bool:
    if attempt.camera is None or attempt.cues is None or attempt.cues.halfway is None:
        return False
    is_uncertain = attempt.camera.max_sigma_px >= UNCERTAIN_PX * setting.width / 1920.0
    is_usable = attempt.is_calibrated or attempt.code == "too_uncertain"
    return is_uncertain and is_usable and setting.config.cues.further_lines


def add_faint_lines(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt with straight markings that stand out only where an uncertain camera may put them."""
    fitted = attempt.fitted
    if fitted is None:
        return
    mask, cues = fitted.mask, fitted.cues
    with setting.clock("cues"):
        picture = lighten_markings(scene.marked, mask, setting.circle)
        seen = find_faint_lines(picture, fitted.camera, setting.template, mask.field_region)
        told = Cues(None, None, scene.clear_lines(seen))
        found = tuple(
            line
            for line in set_apart_other_sports(setting, scene, mask, attempt.ellipses, told).lines
            if not _is_repetition(line, (*cues.lines, *cues.others), SEEN_BEFORE_PX * setting.width / 1920.0)
        )
    if not found:
        return
    yield _estimate_with(setting, attempt, found)


def may_show_short_lines(setting: Setting, attempt: Attempt) -> bool:
    """Whether a usable camera with a halfway line leaves the size of the field open, which short straight markings may
    tell.
    """
    if attempt.camera is None or attempt.cues is None or attempt.cues.halfway is None:
        return False
    size, is_open = attempt.camera.field_size, attempt.camera.max_sigma_px >= OPEN_PX * setting.width / 1920.0
    is_open &= size is not None and max(size.length_sd_m, size.width_sd_m) >= OPEN_SIZE_M
    is_usable = attempt.is_calibrated or attempt.code in ("too_uncertain", "circle_unconfirmed")
    return is_open and is_usable and setting.config.cues.further_lines


def add_short_lines(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt with short straight markings that run as an open camera shows the field there."""
    fitted = attempt.fitted
    if fitted is None:
        return
    mask, edges, cues, camera = fitted.mask, fitted.edges, fitted.cues, fitted.camera
    config = setting.config
    with setting.clock("cues"):
        picture = lighten_markings(scene.marked, mask, setting.circle)
        seen = (*cues.seen_halfway, *cues.lines, *cues.others)
        known = np.array([(line.segment.start, line.segment.end) for line in seen]).reshape(-1, 2, 2)
        runs = find_short_markings(picture, mask, known, config.mask)
        sampling_px = config.cues.search_px, config.cues.spacing_px
        short = measure_short_lines(
            scene.image, picture, runs, camera, setting.template, edges.noise, edges.blur_px, sampling_px
        )
        told = Cues(None, None, scene.clear_lines(short))
        found = set_apart_other_sports(setting, scene, mask, attempt.ellipses, told).lines
    if found:
        yield _estimate_with(setting, attempt, found)


def _estimate_with(setting: Setting, attempt: Attempt, found: tuple[LineCue, ...]) -> Attempt:
    """The attempt with further lines that have no names yet."""
    fitted = attempt.fitted
    if fitted is None:
        return attempt
    lines = observe_lines(found, fitted.edges.blur_px)
    more = replace(fitted.observations, lines=(*fitted.observations.lines, *lines))
    more_cues = replace(fitted.cues, lines=(*fitted.cues.lines, *found))
    return estimate(setting, replace(attempt, cues=more_cues, observations=more, verdict=None))


def _is_repetition(line: LineCue, others: Sequence[LineCue], near_px: float) -> bool:
    """Whether other lines were measured along most of a line."""
    if not others:
        return False
    points_px = np.concatenate([other.points_px for other in others])
    return bool(np.mean(measure_distances(line.points_px, points_px) < near_px) > SEEN_BEFORE_SHARE)


def is_less_uncertain(setting: Setting, attempt: Attempt, refined: Attempt) -> bool:
    """Whether the refined attempt is calibrated, and its worst field point surer than that of the first."""
    if attempt.camera is None or refined.camera is None:
        return False
    return refined.is_calibrated and refined.camera.max_sigma_px < attempt.camera.max_sigma_px


def is_told_more(setting: Setting, attempt: Attempt, refined: Attempt) -> bool:
    """Whether the refined attempt names further markings, and is less uncertain."""
    return names_more_lines(setting, attempt, refined) and is_less_uncertain(setting, attempt, refined)


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


def _is_told_twice(refined: Attempt) -> bool:
    """Whether the centre mark and a further line carry a calibrated camera: then nothing but the size was wrong."""
    if not refined.is_calibrated or refined.camera is None or refined.cues is None:
        return False
    return has_mark(refined.camera, refined.cues) and bool(refined.camera.named_lines)


def _has_usual_width(setting: Setting, refined: Attempt) -> bool:
    """Whether a named line tells that the width of a field of another length is the usual one."""
    camera = refined.camera
    if not refined.is_calibrated or camera is None or camera.field_size is None or not camera.named_lines:
        return False
    off_m = abs(camera.field_size.width_m - setting.template.width_m)
    return off_m < USUAL_WIDTH_M and camera.field_size.width_sd_m < TOLD_WIDTH_SD_M


def is_resized(setting: Setting, attempt: Attempt, refined: Attempt) -> bool:
    """Whether an attempt on a field of another size is taken for one that misses markings of the usual size."""
    is_told = _is_told_twice(refined) or _has_usual_width(setting, refined)
    return is_told or names_more_lines(setting, attempt, refined)


REFINEMENTS = (
    Retry(_is_worth_remeasuring, remeasure_wide_paint, lambda setting, attempt, refined: True),
    Retry(_names_lines, leave_out_broad_lines, lambda setting, attempt, refined: True),
    Retry(may_have_old_coat, leave_out_old_coat, lambda setting, attempt, refined: True),
    Retry(may_show_short_lines, add_short_lines, is_told_more),
    Retry(_may_show_faint_lines, add_faint_lines, is_less_uncertain),
)
"""What is measured again within one attempt, where its camera says what to look for; in this order."""
RESIZE = Retry(_misses_markings, resize_field, is_resized)
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
