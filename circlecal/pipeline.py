"""The order of the stages, and what is tried again after a refusal: a frame goes in, every intermediate comes out.

One attempt measures the picture (:func:`measure`) and estimates a calibration from what was measured
(:func:`estimate`). :data:`REFINEMENTS` look at the picture once more where an attempt's own camera says what to look
for; :data:`OTHER_INTERPRETATIONS` take something else in the picture for the circle. Each attempt is a value
of its own, so what is not taken leaves nothing behind.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config, config_digest, load_config
from circlecal.errors import ConfigError, EstimationError, InputError
from circlecal.field import Circle, FieldTemplate, load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.geometry.ellipses import encloses
from circlecal.geometry.projective import Array
from circlecal.line_naming.two_directions import FEWEST_LINES
from circlecal.observations import CirclePoints, LinePoints, MarkPoint, Observations, join_observations
from circlecal.paint.profiles import estimate_noise, to_gray
from circlecal.paint.spots import measure_spots
from circlecal.pictures.interlacing import measure_row_motion, remove_combs
from circlecal.refusals import REFUSALS, Confidence
from circlecal.results import (
    Attempt,
    CameraFit,
    Check,
    Cues,
    EllipseFits,
    FrameCalibration,
    Interpretation,
    MarkingMask,
    Verdict,
)
from circlecal.solvers import solve_by_name
from circlecal.stages.camera import estimate_camera
from circlecal.stages.confirm import is_circle_painted, look_for_markings
from circlecal.stages.correspondences import derive_correspondences, is_turned, turn_correspondences
from circlecal.stages.cues import cues_from_observations, find_cues
from circlecal.stages.edges import detect_edges
from circlecal.stages.ellipse import fit_ellipses, fit_observations
from circlecal.stages.faint_lines import find_faint_lines
from circlecal.stages.field_lines import carriers, observe_field_lines, without_worst_line
from circlecal.stages.homography import estimate_homography, homography_of_solver, turn_fit
from circlecal.stages.mask import find_marking, find_placement, replace_circle_by_arc, suit_field
from circlecal.stages.rays import cast_rays, measure_along_model, measure_template
from circlecal.stages.verdict import (
    confirm,
    confirm_field_lines,
    is_beyond_doubt,
    is_confirmed,
    judge,
    needs_confirmation,
)

Convention = Literal["official", "paint"]
T = TypeVar("T")

MOST_INTERPRETATIONS = 3
"""How many other circles or lines of a picture are tried; rendered rinks, the fields with most circles, need two."""
PARTIAL_DEG = 240.0
"""Degrees of the circle; where less is seen, the circle is measured again along the camera's curve: an ellipse that was
fitted to a part of it leaves the paint beyond.
"""
UNCERTAIN_PX = 12.0
"""Largest predicted error, pixels at 1920 px width, from which on fainter straight markings are looked for."""
SURE_PX = 6.0
"""Largest predicted error, pixels at 1920 px width, of a camera from straight markings alone that is taken before the
circle was looked for thoroughly.
"""
ARC_ALONE = (
    "a part of a circle is seen without a line through its middle, and no other markings tell how it is turned, "
    "or that it is no penalty arc"
)
"""Why arcs are not enough."""
PLACED_ROUNDS = 2
"""How often the markings of a placed field are measured: where the placement puts them, and where the camera does."""
LARGEST_MOVE_WIDTHS = 0.02
"""Mean distance, picture widths, by which the camera may move the markings from where they were found: the placement
knows no lens, which moves them by 0.001 to 0.013.
"""
UNDETERMINED = ("no_circle", "no_ellipse")
"""Refusals that say only that points, lines and arcs are too few without the circle."""


def frame_generator(seed: int) -> np.random.Generator:
    """Random generator of one frame, which every frame begins anew: neither its name, nor the order of frames, nor the
    number of workers changes an answer.
    """
    return np.random.default_rng(seed)


def field_of(config: Config) -> tuple[FieldTemplate, Circle]:
    """Field template and circle that the configuration names.

    Raises
    ------
    ConfigError
        Where the template or its circle does not exist.
    """
    template = load_field(config.field.template, config.field.sizes)
    template = template.model_copy(update=_known_sizes(config))
    name = config.field.circle or template.default_circle
    circle = template.circle_by_name.get(name)
    if not name:
        raise ConfigError(f"field.template: {template.name} has no circle, from which circlecal could calibrate")
    if circle is None:
        known = ", ".join(template.circle_by_name)
        raise ConfigError(f"field.circle: {name!r} is not a circle of {template.name}; known: {known}")
    return template, circle


def _known_sizes(config: Config) -> dict[str, float | None]:
    """What a configuration says of how much length and width of its template vary."""
    changes: dict[str, float | None] = {}
    for side, sd_m in (("length", config.field.length_sd_m), ("width", config.field.width_sd_m)):
        if sd_m is not None or side in config.field.sizes:
            changes[f"{side}_range_m"] = None
        if sd_m is not None:
            changes[f"{side}_sd_m"] = sd_m
    return changes


def apply_convention(template: FieldTemplate, convention: Convention) -> FieldTemplate:
    """The template as :func:`run_observations` takes it: with ``official`` no width of markings, and exact sizes."""
    if convention == "paint":
        return template
    known = {"marking_width_sd_m": 0.0, "length_sd_m": 0.0, "width_sd_m": 0.0}
    return template.model_copy(update={"marking_width_m": 1e-9, **known})


@dataclass(frozen=True, slots=True)
class Setting:
    """What stays the same over all attempts at one frame.

    Attributes
    ----------
    config, template, circle : Config, FieldTemplate, Circle
        Options, the field, and the circle of it that is looked for.
    width, height : int
        Size of the picture, pixels.
    rng : numpy.random.Generator
        For all random draws of the frame.
    timings_ms : dict
        Time spent in each stage so far.
    """

    config: Config
    template: FieldTemplate
    circle: Circle
    width: int
    height: int
    rng: np.random.Generator
    timings_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def clock(self, stage: str) -> Iterator[None]:
        """Add the time that is spent here to that of a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = (time.perf_counter() - start) * 1e3
            self.timings_ms[stage] = round(self.timings_ms.get(stage, 0.0) + spent, 3)

    def calibration(self, attempt: Attempt, frame_id: str, source: str | None) -> FrameCalibration:
        """The attempt that was taken, with the frame's identity."""
        return FrameCalibration(
            id=frame_id,
            width=self.width,
            height=self.height,
            field_name=self.template.name,
            circle_name=attempt.circle_name or self.circle.name,
            attempt=attempt,
            seed=self.config.seed,
            config_digest=config_digest(self.config),
            timings_ms=self.timings_ms,
            source=source,
        )


@dataclass(frozen=True, slots=True)
class Scene:
    """One picture as the stages see it.

    Attributes
    ----------
    image : (H, W, 3) uint8
        BGR picture, with both halves of an interlaced frame join_observations.
    gray : (H, W) uint8
        Its brightness.
    given : (H, W) uint8 or None
        The user's marking mask.
    extra : Observations or None
        What was given beside the picture.
    """

    image: NDArray[np.uint8]
    gray: NDArray[np.uint8]
    given: NDArray[np.uint8] | None
    extra: Observations | None


def run(
    image: NDArray[np.uint8],
    config: Config,
    *,
    mask: NDArray[np.uint8] | None = None,
    extra: Observations | None = None,
    frame_id: str,
    source: str | None = None,
) -> FrameCalibration:
    """Calibrate one frame.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    config : Config
        Options of every stage.
    mask : (H, W) uint8, optional
        Marking mask as SoccerNet class ids.
    extra : Observations, optional
        Keypoints, lines and marks from elsewhere, used together with what the picture shows.
    frame_id : str
        Name of the frame; with the seed it fixes all random draws.
    source : str, optional
        Path or URL as given, recorded in the result.

    Returns
    -------
    FrameCalibration
        With a refused verdict where a stage could not answer; nothing is raised for a frame.

    Raises
    ------
    ConfigError
        For an unknown field template or circle.
    InputError
        Where the mask is not of the picture's size.
    """
    template, circle = field_of(config)
    height, width = image.shape[:2]
    if mask is not None and mask.shape != (height, width):
        raise InputError(f"{frame_id}: the mask is {mask.shape[1]}x{mask.shape[0]}, the picture {width}x{height}")
    setting = Setting(config, template, circle, width, height, frame_generator(config.seed))
    scene = prepare_scene(setting, image, mask, extra)
    attempt = look_for_field_lines(setting, scene)
    if attempt is None:
        attempt = reconsider(setting, scene, calibrate_scene(setting, scene))
    return setting.calibration(attempt, frame_id, source)


def run_observations(
    observations: Observations,
    config: Config,
    *,
    frame_id: str,
    source: str | None = None,
    convention: Convention = "official",
    earlier: CameraFit | None = None,
) -> FrameCalibration:
    """Calibrate from what somebody else saw: annotated points or detected keypoints, without a picture.

    Parameters
    ----------
    observations : Observations
        Circles, lines, marks and keypoints with their sigmas.
    config : Config
        Options of every stage.
    frame_id, source : str
        As in :func:`run`.
    convention : {"official", "paint"}
        Where points on a marking lie: ``official`` takes them at the size that the rules name (the official metric's
        model has no paint width, and every field is of its size), ``paint`` on the centreline of the paint.
    earlier : CameraFit, optional
        As for :func:`estimate`.

    Returns
    -------
    FrameCalibration
        What is too uncertain with default options for camera and verdict is tried with those of the configuration
        ``annotations``, whose digest the answer then has.
    """
    template, circle = field_of(config)
    template = apply_convention(template, convention)
    size = observations.width, observations.height

    def answer(chosen: Config) -> FrameCalibration:
        setting = Setting(chosen, template, circle, *size, frame_generator(config.seed))
        attempt = estimate(setting, take_observations(setting, Attempt(), observations), earlier)
        return setting.calibration(attempt, frame_id, source)

    first = answer(config)
    if first.attempt.code != "too_uncertain" or convention != "official" or not _leaves_choice(config):
        return first
    other = answer(config.model_copy(update=_options_for_clicks()))
    return other if other.status == "calibrated" else first


def _leaves_choice(config: Config) -> bool:
    """Whether nothing was said of cameras and limits, so that those for clicked points may be taken."""
    usual = Config()
    is_usual = config.camera == usual.camera and config.verdict == usual.verdict and config.solver is None
    return is_usual and config.field.template == usual.field.template


@lru_cache(maxsize=1)
def _options_for_clicks() -> dict[str, object]:
    """Camera and limits of the configuration ``annotations``: few clicks need to know where main cameras stand."""
    preset = load_config("annotations")
    return {"camera": preset.camera, "verdict": preset.verdict}


def prepare_scene(
    setting: Setting, image: NDArray[np.uint8], given: NDArray[np.uint8] | None, extra: Observations | None
) -> Scene:
    """A picture with its brightness, after both halves of an interlaced frame were join_observations."""
    with setting.clock("mask"):
        gray = to_gray(image)
        motion = measure_row_motion(gray) if setting.config.mask.deinterlace else None
        if motion is not None:
            image = remove_combs(image, motion)
            gray = to_gray(image)
    return Scene(image, gray, given, extra)


# --- one attempt: measure, then estimate


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
        return attempt if scene.extra is None else _calibrate_extra(setting, attempt, scene.extra)
    if scene.extra is not None and attempt.observations is not None:
        attempt = replace(attempt, observations=join_observations(attempt.observations, scene.extra))
    attempt = estimate(setting, attempt)
    for refinement in REFINEMENTS:
        attempt = refinement.try_out(setting, scene, attempt) or attempt
    return look_again(setting, scene, attempt)


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
                options = suit_field(config.mask, template)
                marking, refusal = find_marking(scene.image, scene.given, options, setting.rng, scene.gray, ruled_out)
            attempt = replace(attempt, mask=marking)
        if refusal is not None:
            raise refusal
        with setting.clock("edges"):
            picture = lighten_markings(scene.gray, marking, circle)
            edges = detect_edges(picture, marking, config.edges)
            attempt = replace(attempt, edges=edges)
        with setting.clock("rays"):
            relative_width = template.marking_width_m / template.radius(circle, "center")
            rays = cast_rays(picture, edges, marking, relative_width, config.rays, setting.rng)
            attempt = replace(attempt, rays=rays)
        with setting.clock("ellipse"):
            ellipses = fit_ellipses(rays, setting.width, config.ellipse, setting.rng)
            attempt = replace(attempt, ellipses=ellipses, observations=observe(setting, ellipses, Cues(None, None)))
        with setting.clock("cues"):
            cues = find_cues(picture, marking, ellipses, edges.noise, template, config.cues, edges.blur_px)
            arcs = tuple(arc.points_px for arc in marking.arcs)
            observations = replace(observe(setting, ellipses, cues), curves=arcs)
            attempt = replace(attempt, cues=cues, observations=observations)
    except EstimationError as error:
        return refuse_attempt(attempt, error)
    return attempt


def observe(setting: Setting, ellipses: EllipseFits, cues: Cues) -> Observations:
    """What the picture showed, as observations.

    The centreline's points already hold both edges, so the edges are given only where there is no centreline.
    """
    fits = (ellipses.center,) if ellipses.center is not None else (ellipses.outer, ellipses.inner)
    circles = tuple(
        CirclePoints(setting.circle.name, fit.edge, fit.points_px[fit.inliers], fit.sigma_px[fit.inliers])
        for fit in fits
        if fit is not None
    )
    seen = (*((cues.halfway,) if cues.halfway is not None else ()), *cues.lines)
    lines = tuple(LinePoints(line.name, line.points_px, line.sigma_px, line.ends) for line in seen)
    marks = () if cues.mark is None else (MarkPoint(cues.mark.name, cues.mark.point_px, cues.mark.sigma_px),)
    return Observations(setting.width, setting.height, circles, lines, marks)


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


def _calibrate_extra(setting: Setting, attempt: Attempt, extra: Observations) -> Attempt:
    """What was given beside a picture that was refused; the picture's own reason where that is too little."""
    found = estimate(setting, take_observations(setting, replace(attempt, verdict=None), extra))
    return replace(found, verdict=attempt.verdict) if found.code in UNDETERMINED else found


def estimate(setting: Setting, attempt: Attempt, earlier: CameraFit | None = None) -> Attempt:
    """Closed forms, camera and verdict from what was measured, or the refusal of the stage that gives up.

    The camera can do without the closed forms, not the other way round.

    Parameters
    ----------
    setting : Setting
        The frame.
    attempt : Attempt
        With ellipses, cues and observations; returned unchanged where it is refused already.
    earlier : CameraFit, optional
        Camera of about the same observations, from which the fit starts.
    """
    if attempt.verdict is not None or attempt.ellipses is None or attempt.cues is None or attempt.observations is None:
        return attempt
    ellipses, cues, observations = attempt.ellipses, attempt.cues, attempt.observations
    config, template, circle = setting.config, setting.template, setting.circle
    attempt = replace(attempt, correspondences=None, homography=None, camera=None)
    try:
        if config.solver is not None:
            return _judge(setting, _solve(setting, config.solver, attempt, ellipses, observations))
        refusal = None
        if ellipses.all():
            with setting.clock("correspondences"):
                size = setting.width, setting.height
                correspondences, refusal = _try_stage(
                    lambda: derive_correspondences(
                        ellipses, cues, template, circle, size, config.correspondences, observations.keypoints
                    )
                )
            attempt = replace(attempt, correspondences=correspondences)
            if correspondences is not None:
                with setting.clock("homography"):
                    homography, refusal = _try_stage(
                        lambda: estimate_homography(correspondences, np.asarray(circle.center), config.homography)
                    )
                attempt = replace(attempt, homography=homography)
        if config.camera.enabled:
            with setting.clock("camera"):
                side = config.correspondences.camera_side
                camera = estimate_camera(observations, template, circle, config.camera, side, earlier)
            attempt = face_camera(replace(attempt, camera=camera), np.asarray(circle.center))
        elif attempt.homography is None and refusal is not None:
            raise refusal
    except EstimationError as error:
        return refuse_attempt(attempt, error)
    return _judge(setting, attempt)


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
        homography = homography_of_solver(found.H_image_field, np.asarray(setting.circle.center))
    return replace(attempt, homography=homography)


def _judge(setting: Setting, attempt: Attempt) -> Attempt:
    with setting.clock("verdict"):
        verdict = judge(attempt, setting.template, setting.circle, setting.width, setting.config.verdict)
    return replace(attempt, verdict=verdict)


def look_again(setting: Setting, scene: Scene, attempt: Attempt) -> Attempt:
    """The attempt after the picture was looked at where its camera puts the circle and the other markings."""
    if attempt.fitted is None:
        return attempt
    mask, _, cues, observations, camera, _ = attempt.fitted
    template, circle = setting.template, setting.circle
    picture = lighten_markings(scene.gray, mask, circle)
    if attempt.code == "circle_unconfirmed" and is_circle_painted(picture, camera, template, circle):
        attempt = _judge(setting, replace(attempt, mask=replace(mask, confidence=Confidence.ACCEPTED)))
    with setting.clock("verdict"):
        verdict = attempt.verdict
        if verdict is None or verdict.status == "refused" or is_beyond_doubt(camera, cues, template):
            return attempt
        seen_names = {line.line for line in observations.lines} | {c.circle for c in observations.circles}
        known = frozenset(name for name in (*seen_names, *camera.named_lines) if name is not None)
        expected = look_for_markings(picture, camera, template, circle, known, mask.field_region)
    return replace(attempt, verdict=confirm(verdict, camera, cues, expected))


def lighten_markings(gray: NDArray[np.uint8], mask: MarkingMask, circle: Circle) -> NDArray[np.uint8]:
    """Brightness, inverted where the markings are darker than the surface, as it was seen or as the template says."""
    dark = circle.color == "dark" if mask.polarity is None else mask.polarity < 0
    return ~gray if dark else gray


# --- what is tried again


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


def _is_worth_remeasuring(setting: Setting, attempt: Attempt) -> bool:
    if attempt.camera is None or attempt.ellipses is None or not attempt.ellipses.all():
        return False
    refusal = REFUSALS.get(attempt.code or "")
    return attempt.ellipses.primary.arc_deg < PARTIAL_DEG or (refusal is not None and refusal.remeasure)


def _measure_curves(
    setting: Setting, picture: NDArray[np.uint8], camera: CameraFit, curves: Iterable[Circle], noise: float
) -> dict[str, CirclePoints]:
    """Circles and arcs, by name, measured where a camera puts them; without those of which too little is seen."""
    config = setting.config
    found = {}
    with setting.clock("rays"):
        for curve in curves:
            points, sigma = measure_along_model(picture, camera.view, curve, setting.template, noise, config.rays)
            if len(points) >= config.ellipse.minimum_points:
                found[curve.name] = CirclePoints(curve.name, "center", points, sigma)
    return found


def _with_curves(observations: Observations, curves: Mapping[str, CirclePoints]) -> Observations:
    """The observations with these circles and arcs in the place of those of their names."""
    others = tuple(circle for circle in observations.circles if circle.circle not in curves)
    return replace(observations, circles=(*curves.values(), *others))


def remeasure_along_camera(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The circle, and the arcs of the field too where only further lines turn it, along the curves of the camera."""
    if attempt.fitted is None:
        return
    mask, edges, cues, observations, camera, _ = attempt.fitted
    is_turned_by_lines = cues.halfway is None and bool(camera.names_by_line)
    circle = setting.circle
    picture = lighten_markings(scene.gray, mask, circle)
    curves = (circle, *(setting.template.arcs if is_turned_by_lines else ()))
    found = _measure_curves(setting, picture, camera, curves, edges.noise)
    if circle.name not in found:
        return
    again = _with_curves(observations, found)
    start = camera if is_turned_by_lines else None
    yield estimate(setting, replace(attempt, observations=again, verdict=None), start)


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
        picture = lighten_markings(scene.gray, mask, setting.circle)
        found = find_faint_lines(picture, camera, setting.template, setting.circle)
    if not found:
        return
    lines = (LinePoints(None, line.points_px, line.sigma_px) for line in found)
    more = replace(observations, lines=(*observations.lines, *lines))
    more_cues = replace(cues, lines=(*cues.lines, *found))
    yield estimate(setting, replace(attempt, cues=more_cues, observations=more, verdict=None))


def _is_less_uncertain(setting: Setting, attempt: Attempt, refined: Attempt) -> bool:
    if attempt.camera is None or refined.camera is None:
        return False
    return refined.is_calibrated and refined.camera.max_sigma_px < attempt.camera.max_sigma_px


def reconsider(setting: Setting, scene: Scene, first: Attempt) -> Attempt:
    """The first attempt, or another interpretation of the picture where the first one is refused or doubtful."""
    for interpretation in OTHER_INTERPRETATIONS:
        other = interpretation.try_out(setting, scene, first)
        if other is not None:
            return other
    if first.verdict is not None and first.verdict.stage == "mask" and first.code is not None and _arcs_of(first):
        return replace(first, verdict=Verdict("refused", "rotation_free", ARC_ALONE, "camera"))
    return first


def _may_be_another_circle(setting: Setting, attempt: Attempt) -> bool:
    """Whether another circle or line may be the right one: this one is refused for it, or nothing else confirms it."""
    if attempt.verdict is None:
        return False
    refusal = REFUSALS.get(attempt.code or "")
    return needs_confirmation(attempt.verdict) or (refusal is not None and refusal.another_interpretation)


def interpret_otherwise(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """Attempts with other circles or lines, each without those that came before."""
    attempt = first
    ruled_out: tuple[Interpretation, ...] = ()
    while _may_be_another_circle(setting, attempt) and len(ruled_out) < MOST_INTERPRETATIONS:
        mask = attempt.mask
        if mask is None or mask.source != "detector" or mask.conic is None:
            return
        ruled_out = (*ruled_out, Interpretation(mask.conic, mask.halfway))
        attempt = calibrate_scene(setting, scene, ruled_out)
        yield attempt


def _is_better_circle(setting: Setting, first: Attempt, other: Attempt) -> bool:
    """Whether another circle is believed: other markings confirm it, or it lies about one that was too small."""
    if not other.is_calibrated:
        return False
    if is_confirmed(other, setting.template, setting.circle, setting.width, setting.config.verdict):
        return True
    small = None if first.mask is None else first.mask.conic
    large = None if other.mask is None else other.mask.conic
    has_lines = other.camera is not None and bool(other.camera.named_lines)
    is_about = small is not None and large is not None and encloses(large, small)
    return first.code == "line_beyond_field" and has_lines and is_about


def _arcs_of(attempt: Attempt) -> tuple[MarkingMask, ...]:
    """The markings with each nearly gapless arc in the place of the circle."""
    mask = attempt.mask
    return () if mask is None else tuple(replace_circle_by_arc(mask, arc) for arc in mask.arcs if arc.gapless)


def take_arcs(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """Attempts with a nearly gapless arc as the circle."""
    for marking in _arcs_of(first):
        yield calibrate_scene(setting, scene, marking=marking)


def _may_place_field(setting: Setting, first: Attempt) -> bool:
    """Whether any circle of the template may be the one seen, and what is looked for usually did not calibrate."""
    field = setting.config.field
    is_seen = first.mask is not None and first.mask.source == "detector"
    is_open = first.verdict is not None and (not first.is_calibrated or needs_confirmation(first.verdict))
    return field.any_circle and field.circle is None and is_seen and is_open and setting.config.camera.enabled


def place_template(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """The attempt with the field laid over the picture by all that is painted, where that is possible in one way."""
    mask, config, template = first.mask, setting.config, setting.template
    if mask is None:
        return
    with setting.clock("cues"):
        side = config.correspondences.camera_side
        placed = find_placement(scene.image, scene.gray, mask, config.mask, template, side)
    if placed is None:
        return
    told = replace(setting, circle=placed.circle)
    mask = replace(mask, conic=placed.conic, halfway=None, confidence=Confidence.ACCEPTED, band_px=0.0)
    picture = lighten_markings(scene.gray, mask, placed.circle)
    attempt = Attempt(mask=mask, circle_name=placed.circle.name)
    view = FieldView(PlaneCamera(setting.width, setting.height, placed.H_image_field))
    try:
        with setting.clock("edges"):
            attempt = replace(attempt, edges=detect_edges(picture, mask, config.edges))
    except EstimationError:
        return
    for _ in range(PLACED_ROUNDS):
        attempt = _calibrate_view(told, picture, attempt, view)
        if attempt.camera is None:
            return
        view = attempt.camera.view
    if attempt.verdict is None or placed.distance_px(view, template) > LARGEST_MOVE_WIDTHS * setting.width:
        return
    found = Check("found_share", placed.found_share, placed.least_share, True)
    yield replace(attempt, verdict=replace(attempt.verdict, checks=(*attempt.verdict.checks, found)))


def _calibrate_view(setting: Setting, picture: NDArray[np.uint8], attempt: Attempt, view: FieldView) -> Attempt:
    """The attempt with every marking measured where a view puts it."""
    mask, edges, template = attempt.mask, attempt.edges, setting.template
    if mask is None or edges is None:
        return attempt
    with setting.clock("rays"):
        circles, lines = measure_template(picture, view, template, mask.field_region, edges.noise, setting.config.rays)
        spots = measure_spots(picture, view, template.lone_marks, edges.noise)
    observations = Observations(setting.width, setting.height, circles, lines, spots)
    seen = replace(attempt, verdict=None, camera=None, correspondences=None, homography=None)
    return estimate(setting, take_observations(setting, seen, observations))


REFINEMENTS = (
    Retry(_is_worth_remeasuring, remeasure_along_camera, lambda setting, attempt, refined: True),
    Retry(_may_show_faint_lines, add_faint_lines, _is_less_uncertain),
)
"""What is measured again within one attempt, where its camera says what to look for; in this order."""


def _may_use_field_lines(setting: Setting) -> bool:
    config = setting.config
    return config.cues.field_lines and config.camera.enabled and config.solver is None


def look_for_field_lines(setting: Setting, scene: Scene) -> Attempt | None:
    """A camera from straight markings and arcs alone after one quick look that finds no circle; None where a circle is
    seen, and where the lines leave the camera uncertain.
    """
    config = setting.config
    source = config.mask.source
    if not _may_use_field_lines(setting) or source not in ("auto", "detector") or scene.given is not None:
        return None
    suited = suit_field(config.mask, setting.template)
    quick = suited.model_copy(update={"detector": suited.detector.model_copy(update={"thorough": False})})
    with setting.clock("mask"):
        marking, refusal = find_marking(scene.image, None, quick, np.random.default_rng(config.seed), scene.gray)
    if refusal is None:
        return None
    attempt = next(take_field_lines(setting, scene, Attempt(mask=marking)), None)
    limit_px = SURE_PX * setting.width / 1920.0
    is_sure = attempt is not None and attempt.camera is not None and attempt.camera.max_sigma_px < limit_px
    return attempt if is_sure else None


def _shows_field_lines(setting: Setting, first: Attempt) -> bool:
    mask = first.mask
    return not first.is_calibrated and _may_use_field_lines(setting) and mask is not None and mask.source == "detector"


def take_field_lines(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """Attempts, all of them calibrated, with the straight markings and arcs that together look like a part of the
    field, without the circle.
    """
    if first.mask is None or len(first.mask.lines) < FEWEST_LINES:
        return
    mask, template, circle, config = first.mask, setting.template, setting.circle, setting.config
    with setting.clock("cues"):
        picture = lighten_markings(scene.gray, mask, circle)
        side, cues = config.correspondences.camera_side, config.cues
        noise = estimate_noise(picture)
        namings = observe_field_lines(picture, mask, noise, template, cues.search_px, cues.spacing_px, side)
    for observations in namings:
        attempt = _calibrate_field_lines(setting, scene, mask, observations)
        if attempt.code == "residual_too_large" and attempt.camera is not None:
            # the edge of a board beside a line, say
            fewer = without_worst_line(observations, attempt.camera)
            attempt = _calibrate_field_lines(setting, scene, mask, fewer)
        if not attempt.is_calibrated or attempt.camera is None or attempt.verdict is None:
            continue
        with setting.clock("verdict"):
            used = carriers(observations, attempt.camera)
            agreement = look_for_markings(picture, attempt.camera, template, circle, used, mask.field_region, used)
            verdict = confirm_field_lines(attempt.verdict, attempt.camera, used, agreement)
        if verdict.status == "calibrated":
            accepted = replace(attempt, verdict=verdict)
            yield _add_curves(setting, picture, accepted, noise) or accepted


def _add_curves(setting: Setting, picture: NDArray[np.uint8], attempt: Attempt, noise: float) -> Attempt | None:
    """The attempt with the circle and the arcs measured where its camera puts them; None where that brings nothing."""
    camera, observations = attempt.camera, attempt.observations
    if camera is None or observations is None or attempt.verdict is None:
        return None
    found = _measure_curves(setting, picture, camera, (setting.circle, *setting.template.arcs), noise)
    if not found:
        return None
    fuller = _with_curves(observations, found)
    refined = estimate(setting, take_observations(setting, Attempt(mask=attempt.mask), fuller), camera)
    if refined.verdict is None or not _is_less_uncertain(setting, attempt, refined):
        return None
    own = tuple(check for check in attempt.verdict.checks if check.name in ("named_markings", "found_share"))
    return replace(refined, verdict=replace(refined.verdict, checks=(*refined.verdict.checks, *own)))


def _calibrate_field_lines(setting: Setting, scene: Scene, mask: MarkingMask, observations: Observations) -> Attempt:
    """Estimate from named lines and arcs, and from what was given beside the picture."""
    extra = scene.extra
    seen = observations if extra is None else join_observations(observations, extra)
    return estimate(setting, take_observations(setting, Attempt(mask=mask), seen))


OTHER_INTERPRETATIONS = (
    Retry(_may_be_another_circle, interpret_otherwise, _is_better_circle),
    Retry(
        lambda setting, first: not first.is_calibrated,
        take_arcs,
        lambda setting, first, other: other.is_calibrated,
    ),
    Retry(_may_place_field, place_template, lambda setting, first, other: other.is_calibrated),
    Retry(_shows_field_lines, take_field_lines, lambda setting, first, other: True),
)
"""What else in the picture is taken for the circle; in this order."""


def refuse_attempt(attempt: Attempt, error: EstimationError) -> Attempt:
    """The attempt, ended by a stage that gave up; where no circle was found, with the gates of the best candidate."""
    candidates = attempt.mask.candidates[:1] if attempt.mask is not None and error.stage == "mask" else ()
    checks = candidates[0].checks if candidates else ()
    return replace(attempt, verdict=Verdict("refused", error.code, error.reason, error.stage, checks))


def _try_stage(stage: Callable[[], T]) -> tuple[T | None, EstimationError | None]:
    """Result of a closed form that the camera stage can do without, or why there is none."""
    try:
        return stage(), None
    except EstimationError as error:
        return None, error
