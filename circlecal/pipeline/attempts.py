"""One attempt: what the picture shows of the circle and around it, and the camera and verdict from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from circlecal.camera.report import weigh_painters
from circlecal.errors import EstimationError
from circlecal.geometry.projective import Array
from circlecal.observations import CirclePoints, LinePoints, MarkPoint, Observations
from circlecal.paint.mark_colour import leave_out_other_mark
from circlecal.paint.other_paints import are_painted_otherwise, leave_out_other_paints, leave_out_yellow_lines
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.refusals import Confidence, explain, refuse
from circlecal.results import (
    Attempt,
    CameraFit,
    Check,
    Cues,
    EllipseFits,
    Interpretation,
    LineCue,
    MarkingMask,
    RoughCamera,
    Segment,
    Verdict,
)
from circlecal.solvers import solve_by_name
from circlecal.stages.bare_ends import count_bare_ends
from circlecal.stages.camera import estimate_camera
from circlecal.stages.confirm import are_others_painted, is_circle_painted, look_for_markings
from circlecal.stages.correspondences import choose_turn, derive_correspondences, is_turned, turn_correspondences
from circlecal.stages.cues import cues_from_observations, find_cues
from circlecal.stages.edges import detect_edges
from circlecal.stages.ellipse import fit_ellipses, fit_observations
from circlecal.stages.evidence import measure_evidence
from circlecal.stages.homography import estimate_homography, homography_of_solver, turn_fit
from circlecal.stages.mask import find_marking, suit_field
from circlecal.stages.rays import cast_rays
from circlecal.stages.surroundings import measure_surroundings
from circlecal.stages.verdict import judge
from circlecal.stages.verdict_on_picture import confirm, judge_ends, must_show_ends, weigh_evidence

UNDETERMINED = ("no_circle", "no_ellipse")
"""Refusals that say only that points, lines and arcs are too few without the circle."""

T = TypeVar("T")


def measure(
    setting: Setting, scene: Scene, ruled_out: tuple[Interpretation, ...] = (), marking: MarkingMask | None = None
) -> Attempt:
    """What the picture shows of the circle and of what lies around it; refused where a stage gives up."""
    config, template, circle = setting.config, setting.template, setting.circle
    attempt = Attempt()
    try:
        with setting.clock("mask"):
            refusal = None
            if marking is None:
                marking, refusal = find_marking_once(setting, scene, ruled_out)
            attempt = replace(attempt, mask=marking)
        if refusal is not None:
            raise refusal
        with setting.clock("edges"):
            picture = lighten_markings(scene.marked, marking, circle)
            edges = detect_edges(picture, marking, config.edges)
            attempt = replace(attempt, edges=edges)
        with setting.clock("rays"):
            # a rim has no width, and no two edges
            is_rim = circle.fill == "disc"
            relative_width = 0.0 if is_rim else template.marking_width_m / template.radius(circle, "center")
            rays = cast_rays(picture, edges, marking, relative_width, config.rays, setting.rng)
            rays = scene.clear_rays(rays)
            attempt = replace(attempt, rays=rays)
        with setting.clock("ellipse"):
            has_lines = marking.halfway is not None and len(marking.lines) > 0
            ellipses = fit_ellipses(rays, setting.width, config.ellipse, setting.rng, has_lines=has_lines)
            attempt = replace(
                attempt, ellipses=ellipses, observations=observe(setting, ellipses, Cues(None, None), edges.blur_px)
            )
        with setting.clock("cues"):
            cues = find_cues(picture, marking, ellipses, edges.noise, template, config.cues, edges.blur_px)
            cues = scene.clear_cues(cues)
            cues = set_apart_other_sports(setting, scene, marking, ellipses, cues)
            if template.is_in_one_paint and scene.relief is None:
                cues = leave_out_other_mark(scene.image, cues)
            arcs = tuple(arc.points_px for arc in marking.arcs)
            observations = replace(observe(setting, ellipses, cues, edges.blur_px), curves=arcs)
            attempt = replace(attempt, cues=cues, observations=observations)
    except EstimationError as error:
        return refuse_attempt(attempt, error)
    return attempt


def find_marking_once(
    setting: Setting, scene: Scene, ruled_out: tuple[Interpretation, ...]
) -> tuple[MarkingMask, EstimationError | None]:
    """Where the markings are, looked for once with the same options, and why that is not enough."""
    options = suit_field(setting.config.mask, setting.template)
    key = ("marking", options.model_dump_json(), *(other.key for other in ruled_out))
    return scene.looks.once(
        key,
        lambda: find_marking(
            scene.image,
            scene.given,
            options,
            setting.rng,
            gray=scene.marked,
            ruled_out=ruled_out,
            first_look=scene.first_look,
        ),
    )


def has_one_paint(setting: Setting, scene: Scene, marking: MarkingMask) -> bool:
    """Whether all lines of the field have the circle's paint, which the detector found as a band, and adds one
    colour to its ground: to grass it adds another one in every mown stripe.
    """
    is_painted = marking.source == "detector" and scene.relief is None and setting.template.ground != "grass"
    return is_painted and bool(suit_field(setting.config.mask, setting.template).detector.one_paint)


def set_apart_other_sports(
    setting: Setting, scene: Scene, marking: MarkingMask, ellipses: EllipseFits | None, cues: Cues
) -> Cues:
    """The cues with lines of other sports, which are told by their colour, apart from those that may be markings."""
    if ellipses is None:
        return cues
    if has_one_paint(setting, scene, marking):
        return leave_out_other_paints(scene.image, cues, ellipses, marking.band_px)
    if _tells_other_paints(setting, scene, marking):
        return leave_out_yellow_lines(scene.image, cues, ellipses, marking.band_px)
    return cues


def _tells_other_paints(setting: Setting, scene: Scene, marking: MarkingMask) -> bool:
    """Whether a line in another colour than the circle's paint, which the detector found as a band, is no marking."""
    return setting.template.is_in_one_paint and marking.source == "detector" and scene.relief is None


def observe(setting: Setting, ellipses: EllipseFits, cues: Cues, blur_px: float) -> Observations:
    """What the picture showed, as observations, with the standard deviation of its blur.

    The centreline's points already hold both edges, so the edges are given only where there is no centreline.
    """
    fits = (ellipses.center,) if ellipses.center is not None else (ellipses.outer, ellipses.inner)
    circles = tuple(
        CirclePoints(setting.circle.name, fit.edge, fit.points_px[fit.inliers], fit.sigma_px[fit.inliers])
        for fit in fits
        if fit is not None
    )
    lines = observe_lines((*cues.seen_halfway, *cues.lines), blur_px)
    marks = () if cues.mark is None else (MarkPoint(cues.mark.name, cues.mark.point_px, cues.mark.sigma_px),)
    return Observations(setting.width, setting.height, circles, lines, marks)


def observe_lines(lines: Sequence[LineCue], blur_px: float) -> tuple[LinePoints, ...]:
    """Straight markings as observations, of a picture with this standard deviation of its blur."""
    return tuple(
        LinePoints(line.name, line.points_px, line.sigma_px, line.ends, line.width_px, blur_px) for line in lines
    )


def take_observations(setting: Setting, attempt: Attempt, observations: Observations) -> Attempt:
    """An attempt with given observations in the place of measured ones; the camera can do without the circle."""
    attempt, config = replace(attempt, observations=observations), setting.config
    with setting.clock("ellipse"):
        found, refusal = _try_stage(
            lambda: fit_observations(observations, setting.circle.name, setting.width, config.ellipse, setting.rng)
        )
    if found is None and refusal is not None and (config.solver is not None or not config.camera.enabled):
        return refuse_attempt(attempt, refusal)
    with setting.clock("cues"):
        cues = cues_from_observations(observations, setting.template, setting.circle)
    return replace(attempt, ellipses=found or EllipseFits(None, None, None), cues=cues)


def calibrate_extra(setting: Setting, attempt: Attempt, extra: Observations) -> Attempt:
    """What was given beside a picture that was refused; the picture's own reason where that is too little."""
    found = estimate(setting, take_observations(setting, replace(attempt, verdict=None), extra))
    return replace(found, verdict=attempt.verdict) if found.code in UNDETERMINED else found


def estimate(
    setting: Setting,
    attempt: Attempt,
    earlier: CameraFit | RoughCamera | None = None,
    *,
    is_strain_left_out: bool = True,
    is_draft: bool = False,
) -> Attempt:
    """Closed forms, camera and verdict from what was measured, or the refusal of the stage that gives up.

    The camera can do without the closed forms, not the other way round.

    Parameters
    ----------
    setting : Setting
        The frame.
    attempt : Attempt
        With ellipses, cues and observations; returned unchanged where it is refused already.
    earlier : CameraFit or RoughCamera, optional
        Camera of about the same observations, from which the fit starts.
    is_strain_left_out, is_draft : bool
        As for :func:`circlecal.stages.camera.estimate_camera`.
    """
    if attempt.verdict is not None or attempt.ellipses is None or attempt.cues is None or attempt.observations is None:
        return attempt
    ellipses, cues, observations = attempt.ellipses, attempt.cues, attempt.observations
    config, template, circle = setting.config, setting.template, setting.circle
    attempt = replace(attempt, correspondences=None, no_correspondences=None, homography=None, camera=None)
    attempt = replace(attempt, is_placed=not is_strain_left_out)
    try:
        if config.solver is not None:
            return judge_attempt(setting, _solve(setting, config.solver, attempt, ellipses, observations))
        attempt, refusal = _derive_closed_form(setting, attempt, ellipses, cues, observations)
        if config.camera.enabled:
            with setting.clock("camera"):
                side = config.correspondences.camera_side
                camera = estimate_camera(
                    observations,
                    template,
                    circle,
                    config.camera,
                    camera_side=side,
                    earlier=earlier,
                    is_strain_left_out=is_strain_left_out,
                    is_draft=is_draft,
                )
            attempt = face_camera(replace(attempt, camera=camera), np.asarray(circle.center))
        elif attempt.homography is None and refusal is not None:
            raise refusal
    except EstimationError as error:
        return refuse_attempt(attempt, error)
    return judge_attempt(setting, attempt)


def _derive_closed_form(
    setting: Setting, attempt: Attempt, ellipses: EllipseFits, cues: Cues, observations: Observations
) -> tuple[Attempt, EstimationError | None]:
    """The attempt with the paper's points, tangents and homography, as far as they go, and why they go no further."""
    config, template, circle = setting.config, setting.template, setting.circle
    if not ellipses.all():
        return attempt, None
    with setting.clock("correspondences"):
        correspondences, refusal = _try_stage(
            lambda: derive_correspondences(ellipses, cues, template, circle, observations, config.correspondences)
        )
    if correspondences is None:
        missing = None if refusal is None else f"{refusal.reason}. {explain(refusal.code).help}"
        return replace(attempt, no_correspondences=missing), refusal
    attempt = replace(attempt, correspondences=correspondences)
    with setting.clock("homography"):
        homography, refusal = _try_stage(
            lambda: estimate_homography(correspondences, np.asarray(circle.center), config.homography)
        )
    return replace(attempt, homography=homography), refusal


def face_camera(attempt: Attempt, center_m: Array) -> Attempt:
    """The attempt with its points, tangents and closed form named as the camera sees them.

    A circle and a line look the same from both sides, and the closed form chose its side before the camera was known.
    """
    found, homography, camera = attempt.correspondences, attempt.homography, attempt.camera
    if found is None or camera is None or not is_turned(found, camera.H_image_field, center_m):
        return attempt
    turned = None if homography is None else turn_fit(homography)
    return replace(attempt, correspondences=turn_correspondences(found, center_m), homography=turned)


def _solve(
    setting: Setting, solver: str, attempt: Attempt, ellipses: EllipseFits, observations: Observations
) -> Attempt:
    """Answer of one of the published methods, from both edges of the marking where they were told apart."""
    name = setting.circle.name
    edges = (
        CirclePoints(name, fit.edge, fit.points_px[fit.inliers], fit.sigma_px[fit.inliers])
        for fit in (ellipses.outer, ellipses.inner)
        if fit is not None and observations.circle(name, fit.edge) is None
    )
    seen = replace(observations, circles=(*observations.circles, *edges))
    with setting.clock("homography"):
        found = solve_by_name(solver, seen, setting.template, setting.circle, setting.rng)
        if found.H_image_field is None:
            raise EstimationError("homography", found.code, found.reason)
        center, side = np.asarray(setting.circle.center), setting.config.correspondences.camera_side
        H = choose_turn(found.H_image_field, seen, setting.template, center, side)
        homography = homography_of_solver(H, center)
    return replace(attempt, homography=homography)


def judge_attempt(setting: Setting, attempt: Attempt) -> Attempt:
    """The attempt with its verdict, before other markings were looked for."""
    with setting.clock("verdict"):
        verdict = judge(attempt, setting.template, setting.circle, setting.width, setting.config.verdict)
    return replace(attempt, verdict=verdict)


def look_again(setting: Setting, scene: Scene, attempt: Attempt) -> Attempt:
    """The attempt after the picture was looked at where its camera puts the circle and the other markings."""
    fitted = attempt.fitted
    if fitted is None:
        return attempt
    mask, camera = fitted.mask, fitted.camera
    template, circle = setting.template, setting.circle
    picture = lighten_markings(scene.marked, mask, circle)
    # a field with several circles is laid over the picture as a whole where too little is found
    wider = weigh_painters(camera, circle, template) if len(template.circles) == 1 else camera
    seen_names = {line.line for line in fitted.observations.lines}
    seen_names |= {c.circle for c in fitted.observations.circles}
    known = frozenset(name for name in (*seen_names, *camera.named_lines) if name is not None)
    if attempt.code == "circle_unconfirmed" and (
        is_circle_painted(picture, camera, template, circle)
        or are_others_painted(picture, wider, template, circle, known, mask.field_region)
    ):
        attempt = judge_attempt(setting, replace(attempt, mask=replace(mask, confidence=Confidence.ACCEPTED)))
    with setting.clock("verdict"):
        verdict = attempt.verdict
        if verdict is None or verdict.status == "refused":
            return attempt
        carriers = frozenset(name for name in (circle.name, template.halfway_line) if name is not None)
        ground = picture if scene.relief is None else scene.gray
        other_paints = _find_other_paints(setting, scene, mask, attempt)
        evidence = measure_evidence(picture, mask, camera, template, carriers, other_paints)
        surroundings = measure_surroundings(ground, mask, camera, template, scene.unseen, scene.image)
        expected = look_for_markings(picture, wider, template, circle, known, mask.field_region)
        verdict = weigh_evidence(verdict, camera, evidence, surroundings, template, expected)
        attempt = replace(attempt, verdict=verdict)
        if verdict.status == "refused":
            return attempt
        verdict = confirm(verdict, camera, fitted.cues, expected, evidence)
        if verdict.status == "calibrated" and must_show_ends(camera, fitted.cues, template):
            verdict = judge_ends(verdict, count_bare_ends(picture, camera.view, template))
    return replace(attempt, verdict=verdict)


def _find_other_paints(
    setting: Setting, scene: Scene, mask: MarkingMask, attempt: Attempt
) -> Callable[[Sequence[Segment]], NDArray[np.bool_]] | None:
    """Tells other sports' lines, where a white circle lies on grass: coloured ones are no markings. None where nothing
    tells them.
    """
    cues, ellipses = attempt.cues, attempt.ellipses
    if not _tells_other_paints(setting, scene, mask) or cues is None or ellipses is None:
        return None
    return lambda segments: are_painted_otherwise(scene.image, segments, cues, ellipses, mask.band_px)


def refuse_attempt(attempt: Attempt, error: EstimationError) -> Attempt:
    """The attempt, ended by a stage that gave up; where no circle was found, with the gates of the best candidate."""
    candidates = attempt.mask.candidates[:1] if attempt.mask is not None and error.stage == "mask" else ()
    checks = candidates[0].checks if candidates else ()
    return replace(attempt, verdict=Verdict("refused", error.code, error.reason, error.stage, checks))


def add_checks(attempt: Attempt, *checks: Check) -> Attempt:
    """An attempt whose verdict has further checks."""
    verdict = attempt.verdict
    return attempt if verdict is None else replace(attempt, verdict=replace(verdict, checks=(*verdict.checks, *checks)))


def refuse_as_open(attempt: Attempt, code: str) -> Attempt:
    """An attempt that is refused after its verdict, and keeps its checks: the picture leaves something open."""
    error = refuse("verdict", code)
    checks = () if attempt.verdict is None else attempt.verdict.checks
    return replace(attempt, verdict=Verdict("refused", error.code, error.reason, error.stage, checks))


def _try_stage(stage: Callable[[], T]) -> tuple[T | None, EstimationError | None]:
    """Result of a closed form that the camera stage can do without, or why there is none."""
    try:
        return stage(), None
    except EstimationError as error:
        return None, error
