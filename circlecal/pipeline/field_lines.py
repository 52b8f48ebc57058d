"""The camera from straight markings and arcs alone: frames that show a part of the field without its circle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array
from circlecal.line_naming.two_directions import FEWEST_LINES
from circlecal.observations import Observations, join_observations
from circlecal.paint.profiles import estimate_noise
from circlecal.pipeline.attempts import add_checks, estimate, take_observations
from circlecal.pipeline.curves import measure_curves, replace_curves
from circlecal.pipeline.other_circles import masks_without_circle
from circlecal.pipeline.refinements import Retry, is_less_uncertain
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.pipeline.size_by_circle import HALF_CIRCLE, find_size_by_circle, misses_circle
from circlecal.pipeline.two_lights import join_lights
from circlecal.results import Attempt, CameraFit, MarkingMask, RoughCamera
from circlecal.stages.confirm import look_for_markings
from circlecal.stages.evidence import measure_evidence
from circlecal.stages.field_lines import carriers, observe_field_lines, without_worst_marking
from circlecal.stages.mask import marking_from_detection
from circlecal.stages.surroundings import measure_surroundings
from circlecal.stages.verdict_on_picture import confirm_field_lines, weigh_evidence

SURE_PX = 6.0
"""Largest predicted error, pixels at 1920 px width, of a camera from straight markings alone that is taken before the
circle was looked for thoroughly.
"""
HOPELESS_TIMES = 3.0
"""By how many times a draft may exceed a limit for the names to be fitted in earnest: of 108 real frames of penalty
areas as many are answered as without drafts, in half the time of the fits.
"""
OF_FIELD_LINES = ("named_markings", "beyond_end_widths", "found_share")
"""Checks of straight markings alone, which a camera keeps that curves refined."""
FIELD_LINES_TRIED = ("field lines",)
"""Under which a picture keeps what was tried last."""


def _may_use_field_lines(setting: Setting) -> bool:
    config = setting.config
    return config.cues.field_lines and config.camera.enabled and config.solver is None


def look_for_field_lines(setting: Setting, scene: Scene) -> Attempt | None:
    """A camera from straight markings and arcs alone after a first look that finds no circle; None where a circle is
    seen, and where the lines tell none.
    """
    if scene.first_look is None or not _may_use_field_lines(setting):
        return None
    marking, refusal = marking_from_detection(scene.first_look)
    if refusal is None:
        return None
    return calibrate_by_lines(setting, scene, marking)


def is_sure(setting: Setting, attempt: Attempt) -> bool:
    """Whether a camera from straight markings is known so well that no circle need be looked for thoroughly."""
    camera = attempt.camera
    if camera is None or misses_circle(camera, setting.template, setting.circle):
        return False
    return camera.max_sigma_px < SURE_PX * setting.width / 1920.0


def _shows_field_lines(setting: Setting, first: Attempt) -> bool:
    mask = first.mask
    return not first.is_calibrated and _may_use_field_lines(setting) and mask is not None and mask.source == "detector"


def take_field_lines(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """The attempt, where it calibrates, with the straight markings and arcs that together look like a part of the
    field: those beside the circle that was refused, then those that are seen where nothing is taken for it, then those
    in the sun and in the shade.
    """
    for mask in _list_masks(setting, scene, first):
        attempt = calibrate_by_lines(setting, scene, mask)
        if attempt is not None:
            yield replace(attempt, mask=mask)


def _list_masks(setting: Setting, scene: Scene, first: Attempt) -> Iterator[MarkingMask]:
    """What is tried after an attempt, each looked for only where those before it did not calibrate."""
    if first.mask is None:
        return
    yield first.mask
    yield from masks_without_circle(setting, scene, first)
    joined = join_lights(first.mask, scene.image)
    if joined is not None:
        yield joined


@dataclass(frozen=True, slots=True)
class _Tried:
    """Which markings were tried for which field, and what came of it."""

    setting: Setting
    mask: MarkingMask
    attempt: Attempt | None

    def answers(self, setting: Setting, mask: MarkingMask) -> bool:
        """Whether the same would be tried: thorough passes often see no other lines than the quick ones before."""
        return self.setting is setting and all(
            np.array_equal(one, other)
            for one, other in zip(_list_markings(self.mask), _list_markings(mask), strict=True)
        )


def _list_markings(mask: MarkingMask) -> tuple[NDArray[np.generic], ...]:
    """Ends of the lines (K, 2, 2), points of all arcs (N, 2), their numbers, the field, and the markings' polarity."""
    seen = [line for line in (*mask.lines, mask.halfway) if line is not None]
    ends = np.array([(line.start, line.end) for line in seen]).reshape(-1, 2, 2)
    points = np.concatenate([np.zeros((0, 2)), *(arc.points_px for arc in mask.arcs)])
    region = np.zeros((0, 0), np.bool_) if mask.field_region is None else mask.field_region
    return ends, points, np.array([len(arc.points_px) for arc in mask.arcs]), region, np.array([mask.polarity or 0.0])


def calibrate_by_lines(setting: Setting, scene: Scene, mask: MarkingMask) -> Attempt | None:
    """The first naming of a picture's straight markings and arcs that calibrates; None where none does."""
    tried = scene.looks.recall(FIELD_LINES_TRIED)
    if not isinstance(tried, _Tried) or not tried.answers(setting, mask):
        tried = _Tried(setting, mask, next(_try_namings(setting, scene, mask), None))
        scene.looks.keep(FIELD_LINES_TRIED, tried)
    return tried.attempt


def _try_namings(setting: Setting, scene: Scene, mask: MarkingMask) -> Iterator[Attempt]:
    """Attempts, all of them calibrated, by one naming of the lines after the other."""
    if len(mask.lines) < FEWEST_LINES:
        return
    template, circle, config = setting.template, setting.circle, setting.config
    with setting.clock("cues"):
        picture = lighten_markings(scene.marked, mask, circle)
        side, cues = config.correspondences.camera_side, config.cues
        noise = estimate_noise(picture)
        namings = observe_field_lines(picture, mask, noise, template, cues.search_px, cues.spacing_px, side)
    for observations, theta in namings:
        for attempt in _fit_naming(setting, scene, mask, picture, observations, theta, noise):
            accepted = _accept(setting, scene, mask, picture, attempt, noise)
            if accepted is not None:
                yield accepted
                break


def _accept(
    setting: Setting, scene: Scene, mask: MarkingMask, picture: NDArray[np.uint8], attempt: Attempt, noise: float
) -> Attempt | None:
    """A calibrated attempt that the picture confirms, with the curves that its camera finds; None for any other."""
    template, circle = setting.template, setting.circle
    camera, seen = attempt.camera, attempt.observations
    if not attempt.is_calibrated or camera is None or seen is None or attempt.verdict is None:
        return None
    with setting.clock("verdict"):
        used = carriers(seen, camera)
        agreement = look_for_markings(picture, camera, template, circle, used, mask.field_region, used)
        verdict = confirm_field_lines(attempt.verdict, camera, seen, used, agreement, template)
        if verdict.status == "calibrated":
            evidence = measure_evidence(picture, mask, camera, template, used)
            ground = measure_surroundings(picture, mask, camera, template, scene.unseen, scene.image)
            verdict = weigh_evidence(verdict, camera, evidence, ground, template, agreement)
    if verdict.status != "calibrated":
        return None
    accepted = replace(attempt, verdict=verdict)
    accepted = _add_curves(setting, scene, picture, accepted, noise) or accepted
    misses = accepted.camera is not None and misses_circle(accepted.camera, template, circle, HALF_CIRCLE)
    return None if misses else accepted


def _keeps(attempt: Attempt, name: str) -> bool:
    """Whether an attempt calibrates with a marking of this name."""
    camera = attempt.camera
    return attempt.is_calibrated and camera is not None and any(key.name == name for key in camera.residuals_px)


def _fit_naming(
    setting: Setting,
    scene: Scene,
    mask: MarkingMask,
    picture: NDArray[np.uint8],
    observations: Observations,
    theta: Array,
    noise: float,
) -> Iterator[Attempt]:
    """Attempts with named lines, from the rough camera (P,) that their names imply: with the arcs measured where a
    draft of its camera puts them instead of traced, where these calibrate, and without the marking that it explains
    worst, where that mends it; then with the circle measured there, too, which few lines need.
    """
    draft = _calibrate_field_lines(setting, scene, mask, observations, RoughCamera(theta), is_draft=True)
    if draft.camera is None or _is_hopeless(draft):
        return
    curves = (setting.circle, *setting.template.arcs)
    found = measure_curves(setting, picture, draft.camera, curves, noise, scene.covered)
    arcs = {name: seen for name, seen in found.items() if name != setting.circle.name}
    tried = [replace_curves(observations, arcs)] if arcs else []
    for seen in (*tried, observations):
        attempt = _calibrate_field_lines(setting, scene, mask, seen, draft.camera)
        if attempt.is_calibrated:
            break
    if attempt.code == "residual_too_large" and attempt.camera is not None:
        # the edge of a board beside a line, say
        attempt = _calibrate_field_lines(setting, scene, mask, without_worst_marking(observations, attempt.camera))
    yield attempt
    if setting.circle.name in found:
        yield _calibrate_field_lines(setting, scene, mask, replace_curves(observations, found), draft.camera)


def _is_hopeless(draft: Attempt) -> bool:
    """Whether a camera on a field of the usual size fails a check by so much that no other size, surface or arc mends
    that: wrong names for lines, mostly.
    """
    checks = () if draft.verdict is None else draft.verdict.checks
    return any(not check.passed and check.value > HOPELESS_TIMES * check.limit > 0.0 for check in checks)


def _add_curves(
    setting: Setting, scene: Scene, picture: NDArray[np.uint8], attempt: Attempt, noise: float
) -> Attempt | None:
    """The attempt with the circle and the arcs measured where its camera puts them; None where that brings nothing."""
    camera, observations = attempt.camera, attempt.observations
    if camera is None or observations is None or attempt.verdict is None:
        return None
    curves = (setting.circle, *setting.template.arcs)
    found = measure_curves(setting, picture, camera, curves, noise, scene.covered)
    if setting.circle.name not in found:
        with setting.clock("verdict"):
            stretched = find_size_by_circle(picture, camera, setting.template, setting.circle)
        if stretched is not None:
            camera = stretched
            found = measure_curves(setting, picture, camera, curves, noise, scene.covered)
    if not found:
        return None
    fuller = replace_curves(observations, found)
    refined = estimate(setting, take_observations(setting, Attempt(mask=attempt.mask), fuller), camera)
    # a circle ties what was seen to the middle of the field, from which the errors then count
    is_tied = setting.circle.name in found and _keeps(refined, setting.circle.name)
    if refined.verdict is None or not (is_tied or is_less_uncertain(setting, attempt, refined)):
        return None
    own = tuple(check for check in attempt.verdict.checks if check.name in OF_FIELD_LINES)
    return add_checks(refined, *own)


def _calibrate_field_lines(
    setting: Setting,
    scene: Scene,
    mask: MarkingMask,
    observations: Observations,
    earlier: CameraFit | RoughCamera | None = None,
    *,
    is_draft: bool = False,
) -> Attempt:
    """Estimate from named lines and arcs, and from what was given beside the picture; from an earlier camera of about
    these where there is one.
    """
    extra = scene.extra
    seen = observations if extra is None else join_observations(observations, extra)
    return estimate(setting, take_observations(setting, Attempt(mask=mask), seen), earlier, is_draft=is_draft)


FIELD_LINES = Retry(_shows_field_lines, take_field_lines, lambda setting, first, other: True)
"""Tried where no circle calibrated."""
