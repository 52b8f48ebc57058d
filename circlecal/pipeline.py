"""The order of the stages, and nothing else: a frame goes in, every intermediate and a verdict come out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal, TypeVar
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config, config_digest
from circlecal.errors import ConfigError, EstimationError, InputError
from circlecal.field import Circle, FieldTemplate, load_field
from circlecal.geometry.homography import scale_homography, turn_homography
from circlecal.interlacing import row_motion, without_combs
from circlecal.observations import CirclePoints, LinePoints, MarkPoint, Observations
from circlecal.profiles import grey
from circlecal.results import (
    Assignment,
    Calibration,
    CameraFit,
    Cues,
    EllipseFits,
    HomographyFit,
    MarkingMask,
    Verdict,
)
from circlecal.solvers import solve_by_name
from circlecal.stages.agreement import expected_markings
from circlecal.stages.camera import estimate_camera
from circlecal.stages.correspondences import derive_correspondences
from circlecal.stages.cues import cues_from_observations, find_cues
from circlecal.stages.edges import detect_edges
from circlecal.stages.ellipse import fit_ellipses, fit_observed
from circlecal.stages.evidence import painted_all_round
from circlecal.stages.homography import estimate_homography
from circlecal.stages.mask import find_marking, with_arc
from circlecal.stages.rays import cast_rays, measure_along_model
from circlecal.stages.verdict import beyond_doubt, confirmed, doubtful, judge, surely_assigned

Convention = Literal["official", "paint"]
T = TypeVar("T")
MEASURED_AGAIN = frozenset({"residual_too_large", "too_uncertain", "circle_unconfirmed"})
"""Refusals after which the circle is measured once more, along the curve that the refused camera predicts."""
TAKEN_WRONGLY = frozenset(
    {
        "markings_missing",
        "residual_too_large",
        "edges_contradict",
        "line_beyond_field",
        "mark_contradicts_circle",
        "implausible_camera",
        "circle_behind_camera",
        "mirrored",
        "rotation_free",
        "no_camera",
    }
)
"""Refusals after which another circle or line is looked for: this one may be a face-off circle, or one of a logo."""
MOST_ASSIGNMENTS = 3
"""How often."""
PARTIAL_DEG = 240.0
"""The same where less of the circle is seen: an ellipse fitted to a part of it leaves the paint beyond."""
ARC_ALONE = (
    "a part of a circle is seen without a line through its middle, and no other markings tell how it is turned, "
    "or that it is no penalty arc"
)
"""Why arcs are not enough."""
UNDETERMINED = ("no_circle", "no_ellipse")
"""Refusals that say only that points, lines and arcs are too few without the circle."""


def frame_generator(seed: int, frame_id: str) -> np.random.Generator:
    """Random generator of one frame: neither the order of frames nor the number of workers changes an answer."""
    return np.random.default_rng([seed, crc32(frame_id.encode("utf-8"))])


def field_of(config: Config) -> tuple[FieldTemplate, Circle]:
    """Field template and circle that the configuration names.

    Raises
    ------
    ConfigError
        Where the template or its circle does not exist.
    """
    template = load_field(config.field.template, config.field.sizes)
    name = config.field.circle or template.default_circle
    circle = template.circle_by_name.get(name)
    if circle is None:
        known = ", ".join(template.circle_by_name)
        raise ConfigError(f"field.circle: {name!r} is not a circle of {template.name}; known: {known}")
    return template, circle


def in_convention(template: FieldTemplate, convention: Convention) -> FieldTemplate:
    """The template as :func:`run_observations` takes it: with ``official`` no width of markings, and exact sizes."""
    if convention == "paint":
        return template
    known = {"marking_width_sd_m": 0.0, "length_sd_m": 0.0, "width_sd_m": 0.0}
    return template.model_copy(update={"marking_width_m": 1e-9, **known})


def run(
    image: NDArray[np.uint8],
    config: Config,
    *,
    mask: NDArray[np.uint8] | None = None,
    extra: Observations | None = None,
    frame_id: str,
    source: str | None = None,
) -> Calibration:
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
    Calibration
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
    job = _Job(config, template, circle, width, height, frame_generator(config.seed, frame_id))
    return job.calibration(lambda: job.from_picture(image, mask, extra), frame_id, source)


def run_observations(
    observations: Observations,
    config: Config,
    *,
    frame_id: str,
    source: str | None = None,
    convention: Convention = "official",
) -> Calibration:
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
    """
    template, circle = field_of(config)
    template = in_convention(template, convention)
    size = observations.width, observations.height
    job = _Job(config, template, circle, *size, frame_generator(config.seed, frame_id))
    return job.calibration(lambda: job.from_observations(observations), frame_id, source)


class _Job:
    """One frame on its way through the stages; every intermediate is left in ``reached`` for the pictures of refused
    frames too.
    """

    def __init__(
        self, config: Config, template: FieldTemplate, circle: Circle, width: int, height: int, rng: np.random.Generator
    ) -> None:
        self.config = config
        self.template = template
        self.circle = circle
        self.width = width
        self.height = height
        self.rng = rng
        self.reached: dict[str, Any] = {}
        self.timings: dict[str, float] = {}

    def calibration(self, stages: Callable[[], Verdict], frame_id: str, source: str | None) -> Calibration:
        """Run the stages and gather what they reached."""
        try:
            verdict = stages()
        except EstimationError as error:
            verdict = _refused(error)
        return Calibration(
            id=frame_id,
            width=self.width,
            height=self.height,
            field_name=self.template.name,
            circle_name=self.circle.name,
            verdict=verdict,
            seed=self.config.seed,
            config_digest=config_digest(self.config),
            timings_ms=self.timings,
            source=source,
            **self.reached,
        )

    def from_picture(
        self, image: NDArray[np.uint8], given: NDArray[np.uint8] | None, extra: Observations | None
    ) -> Verdict:
        """Picture -> observations -> answer; failing that, with every arc that may be the circle as the circle."""
        with self._clock("mask"):
            brightness = grey(image)
            motion = row_motion(brightness) if self.config.mask.deinterlace else None
            if motion is not None:
                image = without_combs(image, motion)
                brightness = grey(image)
        first = verdict = self._from_circle(image, given, brightness, extra)
        reached = self.reached
        excluded: tuple[Assignment, ...] = ()
        while (verdict.code in TAKEN_WRONGLY or doubtful(verdict)) and len(excluded) < MOST_ASSIGNMENTS:
            mask: MarkingMask = self.reached["mask"]
            if mask.source != "detector" or mask.conic is None:
                break
            excluded = (*excluded, Assignment(mask.conic, mask.halfway))
            self.reached = {}
            verdict = self._from_circle(image, given, brightness, extra, excluded)
            if verdict.status == "calibrated" and surely_assigned(
                verdict, self.reached["camera"], self.reached["cues"]
            ):
                return verdict
        self.reached = reached
        if first.status == "refused":
            return self._from_arcs(image, brightness, extra, first)
        return first

    def _from_arcs(
        self, image: NDArray[np.uint8], brightness: NDArray[np.uint8], extra: Observations | None, first: Verdict
    ) -> Verdict:
        """The first answer that is accepted with a nearly gapless arc as the circle; where there are such arcs and no
        circle, that they are not enough.
        """
        reached = self.reached
        marking: MarkingMask = reached["mask"]
        arcs = [arc for arc in marking.arcs if arc.gapless]
        for arc in arcs:
            self.reached = {}
            verdict = self._from_circle(image, None, brightness, extra, marking=with_arc(marking, arc))
            if verdict.status == "calibrated":
                return verdict
        self.reached = reached
        if arcs and first.stage == "mask":
            return Verdict("refused", "rotation_free", ARC_ALONE, "camera")
        return first

    def _from_circle(
        self,
        image: NDArray[np.uint8],
        given: NDArray[np.uint8] | None,
        brightness: NDArray[np.uint8],
        extra: Observations | None,
        excluded: tuple[Assignment, ...] = (),
        marking: MarkingMask | None = None,
    ) -> Verdict:
        """Answer with the circle of a marking, or with the first that is found, other than those that are excluded."""
        try:
            ellipses, cues, seen = self._seen(image, given, brightness, excluded, marking)
        except EstimationError as refusal:
            if extra is None:
                return _refused(refusal)
            try:
                return self.from_observations(extra)
            except EstimationError as error:
                return _refused(refusal if error.code in UNDETERMINED else error)
        observations = seen if extra is None else joined(seen, extra)
        self.reached["observations"] = observations
        try:
            verdict = self._answer(ellipses, cues, observations)
            camera: CameraFit | None = self.reached.get("camera")
            partial = ellipses.primary.arc_deg < PARTIAL_DEG
            if camera is not None and (partial or verdict.code in MEASURED_AGAIN):
                turned = cues.halfway is None and bool(camera.names_by_line)
                again = self._seen_again(brightness, observations, turned)
                if again is not None:
                    verdict = self._answer(ellipses, cues, again, camera if turned else None)
        except EstimationError as error:
            return _refused(error)
        camera = self.reached.get("camera")
        if camera is None:
            return verdict
        picture = self._with_light_markings(brightness)
        with self._clock("verdict"):
            if verdict.code == "circle_unconfirmed" and painted_all_round(picture, camera, self.template, self.circle):
                closed_forms = self.reached.get("homography")
                limits = self.config.verdict
                verdict = judge(ellipses, cues, closed_forms, camera, self.template, self.circle, self.width, limits)
            if verdict.status == "refused" or beyond_doubt(camera, cues, self.template):
                return verdict
            mask: MarkingMask = self.reached["mask"]
            seen_names = {line.line for line in observations.lines} | {c.circle for c in observations.circles}
            known = frozenset(name for name in (*seen_names, *camera.named_lines) if name is not None)
            expected = expected_markings(picture, camera, self.template, self.circle, known, mask.field_region)
            return confirmed(verdict, camera, cues, expected)

    def _seen_again(
        self, brightness: NDArray[np.uint8], observations: Observations, with_arcs: bool
    ) -> Observations | None:
        """The same observations with the circle, and the arcs of the field too, measured along the curves of the first
        camera.
        """
        circle, template = self.circle, self.template
        wanted = [circle, *(template.arcs if with_arcs else ())]
        found: dict[str, CirclePoints] = {}
        with self._clock("rays"):
            picture = self._with_light_markings(brightness)
            for curve in wanted:
                points, sigma = measure_along_model(
                    picture,
                    self.reached["camera"],
                    curve,
                    template,
                    self.reached["edges"].noise,
                    self.config.rays,
                    with_arcs,
                )
                if len(points) >= self.config.ellipse.minimum_points:
                    found[curve.name] = CirclePoints(curve.name, "center", points, sigma)
        if circle.name not in found:
            return None
        others = tuple(c for c in observations.circles if c.circle not in found)
        self.reached["observations"] = replace(observations, circles=(*found.values(), *others))
        return self.reached["observations"]

    def _seen(
        self,
        image: NDArray[np.uint8],
        given: NDArray[np.uint8] | None,
        brightness: NDArray[np.uint8],
        excluded: tuple[Assignment, ...],
        marking: MarkingMask | None,
    ) -> tuple[EllipseFits, Cues, Observations]:
        """What the picture shows of the circle and of what lies around it."""
        config, template, circle, reached = self.config, self.template, self.circle, self.reached
        with self._clock("mask"):
            refusal = None
            if marking is None:
                marking, refusal = find_marking(image, given, config.mask, self.rng, brightness, excluded)
            reached["mask"] = marking
        if refusal is not None:
            raise refusal
        with self._clock("edges"):
            picture = self._with_light_markings(brightness)
            edges = reached["edges"] = detect_edges(picture, marking, config.edges)
        with self._clock("rays"):
            relative_width = template.marking_width_m / template.radius(circle, "center")
            rays = reached["rays"] = cast_rays(picture, edges, marking, relative_width, config.rays, self.rng)
        with self._clock("ellipse"):
            ellipses = reached["ellipses"] = fit_ellipses(rays, self.width, config.ellipse, self.rng)
            reached["observations"] = observed(ellipses, Cues(None, None), circle, self.width, self.height)
        with self._clock("cues"):
            cues = reached["cues"] = find_cues(
                picture, marking, ellipses, edges.noise, template, config.cues, edges.blur_px
            )
            seen = observed(ellipses, cues, circle, self.width, self.height)
            observations = reached["observations"] = replace(seen, curves=tuple(a.points_px for a in marking.arcs))
        return ellipses, cues, observations

    def from_observations(self, observations: Observations) -> Verdict:
        """Observations -> answer, by the same stages; the camera can do without the circle."""
        self.reached["observations"] = observations
        with self._clock("ellipse"):
            name, config = self.circle.name, self.config
            found, refusal = _attempt(lambda: fit_observed(observations, name, self.width, config.ellipse, self.rng))
            if found is None and refusal is not None and (config.solver is not None or not config.camera.enabled):
                raise refusal
            ellipses = self.reached["ellipses"] = found or EllipseFits(None, None, None)
        with self._clock("cues"):
            cues = self.reached["cues"] = cues_from_observations(observations, self.template, self.circle)
        return self._answer(ellipses, cues, observations)

    def _answer(
        self, ellipses: EllipseFits, cues: Cues, observations: Observations, earlier: CameraFit | None = None
    ) -> Verdict:
        """Closed forms, camera, verdict. The camera can do without the closed forms, not the other way round."""
        config, template, circle, reached = self.config, self.template, self.circle, self.reached
        if config.solver is not None:
            return self._solved(config.solver, ellipses, cues, observations)
        size = self.width, self.height
        correspondences, homography, refusal = None, None, None
        if ellipses.all():
            with self._clock("correspondences"):
                correspondences, refusal = _attempt(
                    lambda: derive_correspondences(
                        ellipses, cues, template, circle, size, config.correspondences, observations.keypoints
                    )
                )
        if correspondences is not None:
            reached["correspondences"] = correspondences
            with self._clock("homography"):
                center = np.asarray(circle.center)
                homography, refusal = _attempt(lambda: estimate_homography(correspondences, center, config.homography))
                reached["homography"] = homography
        if config.camera.enabled:
            with self._clock("camera"):
                side = config.correspondences.camera_side
                reached["camera"] = estimate_camera(observations, template, circle, config.camera, side, earlier)
        elif homography is None and refusal is not None:
            raise refusal
        with self._clock("verdict"):
            camera = reached.get("camera")
            return judge(
                ellipses, cues, homography, camera, template, circle, self.width, config.verdict, self._certain
            )

    def _solved(self, solver: str, ellipses: EllipseFits, cues: Cues, observations: Observations) -> Verdict:
        """Answer of one of the published methods, from both edges of the marking where they were told apart."""
        edges = (
            CirclePoints(self.circle.name, fit.edge, fit.points_px[fit.inliers], fit.sigma_px[fit.inliers])
            for fit in (ellipses.outer, ellipses.inner)
            if fit is not None and observations.circle(self.circle.name, fit.edge) is None
        )
        seen = replace(observations, circles=(*observations.circles, *edges))
        with self._clock("homography"):
            found = solve_by_name(solver, seen, self.template, self.circle, self.rng)
            if found.H_image_field is None:
                raise EstimationError("homography", found.code or "no_homography", found.reason or "no answer")
            H = found.H_image_field
            turned = turn_homography(H, np.asarray(self.circle.center))
            homography = HomographyFit(
                H, scale_homography(np.linalg.inv(H)), turned, np.zeros(0), float("nan"), float("nan")
            )
            self.reached["homography"] = homography
        with self._clock("verdict"):
            limits = self.config.verdict
            return judge(
                ellipses, cues, homography, None, self.template, self.circle, self.width, limits, self._certain
            )

    def _with_light_markings(self, brightness: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The picture, turned where its markings are darker than the surface, as seen or as the template says."""
        seen: float | None = self.reached["mask"].polarity
        dark = self.circle.color == "dark" if seen is None else seen < 0
        return ~brightness if dark else brightness

    @property
    def _certain(self) -> bool:
        """Whether the circle needs no confirmation by another marking."""
        marking = self.reached.get("mask")
        return marking is None or marking.certain

    @contextmanager
    def _clock(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = (time.perf_counter() - start) * 1e3
            self.timings[stage] = round(self.timings.get(stage, 0.0) + spent, 3)


def _refused(error: EstimationError) -> Verdict:
    return Verdict("refused", error.code, error.reason, error.stage)


def _attempt(stage: Callable[[], T]) -> tuple[T | None, EstimationError | None]:
    """Result of a closed form that the camera stage can do without, or why there is none."""
    try:
        return stage(), None
    except EstimationError as error:
        return None, error


def observed(ellipses: EllipseFits, cues: Cues, circle: Circle, width: int, height: int) -> Observations:
    """What the picture showed, as observations.

    The centreline's points already hold both edges, so the edges are given only where there is no centreline.
    """
    fits = (ellipses.center,) if ellipses.center is not None else (ellipses.outer, ellipses.inner)
    circles = tuple(
        CirclePoints(circle.name, fit.edge, fit.points_px[fit.inliers], fit.sigma_px[fit.inliers])
        for fit in fits
        if fit is not None
    )
    seen = (*((cues.halfway,) if cues.halfway is not None else ()), *cues.lines)
    lines = tuple(LinePoints(line.name, line.points_px, line.sigma_px, line.ends) for line in seen)
    marks = () if cues.mark is None else (MarkPoint(cues.mark.name, cues.mark.point_px, cues.mark.sigma_px),)
    return Observations(width, height, circles, lines, marks)


def joined(first: Observations, second: Observations) -> Observations:
    """Observations of one frame from two sources."""
    return Observations(
        first.width,
        first.height,
        (*first.circles, *second.circles),
        (*first.lines, *second.lines),
        (*first.marks, *second.marks),
        (*first.keypoints, *second.keypoints),
        (*first.curves, *second.curves),
    )
