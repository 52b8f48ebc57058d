"""The order of the stages, and nothing else: from a picture with one marking, or from observations, to a verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config, config_digest
from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.homography import scale_homography, turn_homography
from circlecal.observations import CirclePoints, LinePoints, MarkPoint, Observations
from circlecal.results import (
    Calibration,
    CameraFit,
    Cues,
    EllipseFits,
    HomographyFit,
    Interpretation,
    MarkingMask,
    Verdict,
)
from circlecal.solvers import solve_by_name
from circlecal.stages.camera import estimate_camera
from circlecal.stages.correspondences import derive_correspondences
from circlecal.stages.cues import cues_from_observations, find_cues
from circlecal.stages.edges import detect_edges
from circlecal.stages.ellipse import fit_ellipses, fit_observed
from circlecal.stages.faint_lines import find_faint_lines
from circlecal.stages.homography import estimate_homography
from circlecal.stages.mask import find_marking
from circlecal.stages.rays import cast_rays, measure_along_model
from circlecal.stages.verdict import judge

T = TypeVar("T")


class Chain:
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
            verdict = refused(error)
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

    def seen(
        self,
        image: NDArray[np.uint8],
        given: NDArray[np.uint8] | None,
        brightness: NDArray[np.uint8],
        ruled_out: tuple[Interpretation, ...],
        marking: MarkingMask | None,
    ) -> tuple[EllipseFits, Cues, Observations]:
        """What the picture shows of the circle and of what lies around it."""
        config, template, circle, reached = self.config, self.template, self.circle, self.reached
        with self.clock("mask"):
            refusal = None
            if marking is None:
                marking, refusal = find_marking(image, given, config.mask, self.rng, brightness, ruled_out)
            reached["mask"] = marking
        if refusal is not None:
            raise refusal
        with self.clock("edges"):
            picture = self.with_light_markings(brightness)
            edges = reached["edges"] = detect_edges(picture, marking, config.edges)
        with self.clock("rays"):
            relative_width = template.marking_width_m / template.radius(circle, "center")
            rays = reached["rays"] = cast_rays(picture, edges, marking, relative_width, config.rays, self.rng)
        with self.clock("ellipse"):
            ellipses = reached["ellipses"] = fit_ellipses(rays, self.width, config.ellipse, self.rng)
            reached["observations"] = observed(ellipses, Cues(None, None), circle, self.width, self.height)
        with self.clock("cues"):
            cues = reached["cues"] = find_cues(
                picture, marking, ellipses, edges.noise, template, config.cues, edges.blur_px
            )
            seen = observed(ellipses, cues, circle, self.width, self.height)
            observations = reached["observations"] = replace(seen, curves=tuple(a.points_px for a in marking.arcs))
        return ellipses, cues, observations

    def seen_again(
        self, brightness: NDArray[np.uint8], observations: Observations, with_arcs: bool
    ) -> Observations | None:
        """The same observations with the circle, and the arcs of the field too, measured along the curves of the first
        camera.
        """
        circle, template = self.circle, self.template
        wanted = [circle, *(template.arcs if with_arcs else ())]
        found: dict[str, CirclePoints] = {}
        with self.clock("rays"):
            picture = self.with_light_markings(brightness)
            for curve in wanted:
                points, sigma = measure_along_model(
                    picture,
                    self.reached["camera"],
                    curve,
                    template,
                    self.reached["edges"].noise,
                    self.config.rays,
                )
                if len(points) >= self.config.ellipse.minimum_points:
                    found[curve.name] = CirclePoints(curve.name, "center", points, sigma)
        if circle.name not in found:
            return None
        others = tuple(c for c in observations.circles if c.circle not in found)
        self.reached["observations"] = replace(observations, circles=(*found.values(), *others))
        return self.reached["observations"]

    def with_faint_lines(self, brightness: NDArray[np.uint8], observations: Observations) -> Observations | None:
        """The same observations and the straight markings that stand out only where the camera may put them."""
        with self.clock("cues"):
            picture = self.with_light_markings(brightness)
            found = find_faint_lines(picture, self.reached["camera"], self.template, self.circle)
        if not found:
            return None
        cues: Cues = self.reached["cues"]
        self.reached["cues"] = replace(cues, lines=(*cues.lines, *found))
        lines = (LinePoints(None, line.points_px, line.sigma_px) for line in found)
        self.reached["observations"] = replace(observations, lines=(*observations.lines, *lines))
        return self.reached["observations"]

    def from_observations(self, observations: Observations) -> Verdict:
        """Observations -> answer, by the same stages; the camera can do without the circle."""
        self.reached["observations"] = observations
        with self.clock("ellipse"):
            name, config = self.circle.name, self.config
            found, refusal = _attempt(lambda: fit_observed(observations, name, self.width, config.ellipse, self.rng))
            if found is None and refusal is not None and (config.solver is not None or not config.camera.enabled):
                raise refusal
            ellipses = self.reached["ellipses"] = found or EllipseFits(None, None, None)
        with self.clock("cues"):
            cues = self.reached["cues"] = cues_from_observations(observations, self.template, self.circle)
        return self.answer(ellipses, cues, observations)

    def answer(
        self, ellipses: EllipseFits, cues: Cues, observations: Observations, earlier: CameraFit | None = None
    ) -> Verdict:
        """Closed forms, camera, verdict. The camera can do without the closed forms, not the other way round."""
        config, template, circle, reached = self.config, self.template, self.circle, self.reached
        if config.solver is not None:
            return self._solved(config.solver, ellipses, cues, observations)
        size = self.width, self.height
        correspondences, homography, refusal = None, None, None
        if ellipses.all():
            with self.clock("correspondences"):
                correspondences, refusal = _attempt(
                    lambda: derive_correspondences(
                        ellipses, cues, template, circle, size, config.correspondences, observations.keypoints
                    )
                )
        if correspondences is not None:
            reached["correspondences"] = correspondences
            with self.clock("homography"):
                center = np.asarray(circle.center)
                homography, refusal = _attempt(lambda: estimate_homography(correspondences, center, config.homography))
                reached["homography"] = homography
        if config.camera.enabled:
            with self.clock("camera"):
                side = config.correspondences.camera_side
                reached["camera"] = estimate_camera(observations, template, circle, config.camera, side, earlier)
        elif homography is None and refusal is not None:
            raise refusal
        return self.judged(ellipses, cues, certain=self._certain)

    def judged(self, ellipses: EllipseFits, cues: Cues, *, certain: bool) -> Verdict:
        """The verdict on the camera and the homography that were reached."""
        homography, camera = self.reached.get("homography"), self.reached.get("camera")
        with self.clock("verdict"):
            return judge(
                ellipses,
                cues,
                homography,
                camera,
                self.template,
                self.circle,
                self.width,
                self.config.verdict,
                certain,
            )

    def _solved(self, solver: str, ellipses: EllipseFits, cues: Cues, observations: Observations) -> Verdict:
        """Answer of one of the published methods, from both edges of the marking where they were told apart."""
        edges = (
            CirclePoints(self.circle.name, fit.edge, fit.points_px[fit.inliers], fit.sigma_px[fit.inliers])
            for fit in (ellipses.outer, ellipses.inner)
            if fit is not None and observations.circle(self.circle.name, fit.edge) is None
        )
        seen = replace(observations, circles=(*observations.circles, *edges))
        with self.clock("homography"):
            found = solve_by_name(solver, seen, self.template, self.circle, self.rng)
            if found.H_image_field is None:
                raise EstimationError("homography", found.code or "no_homography", found.reason or "no answer")
            H = found.H_image_field
            turned = turn_homography(H, np.asarray(self.circle.center))
            homography = HomographyFit(
                H, scale_homography(np.linalg.inv(H)), turned, np.zeros(0), float("nan"), float("nan")
            )
            self.reached["homography"] = homography
        return self.judged(ellipses, cues, certain=self._certain)

    def with_light_markings(self, brightness: NDArray[np.uint8]) -> NDArray[np.uint8]:
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
    def clock(self, stage: str) -> Iterator[None]:
        """Add the time that is spent here to that of a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = (time.perf_counter() - start) * 1e3
            self.timings[stage] = round(self.timings.get(stage, 0.0) + spent, 3)


def refused(error: EstimationError) -> Verdict:
    """The verdict that an error in a stage stands for."""
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
