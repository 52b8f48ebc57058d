"""The order of the stages, and nothing else: a frame goes in, every intermediate and a verdict come out."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config, config_digest
from circlecal.errors import ConfigError, EstimationError, InputError
from circlecal.field import Circle, FieldTemplate, load_field
from circlecal.observations import CirclePoints, LinePoints, MarkPoint, Observations
from circlecal.results import Calibration, Cues, EllipseFits, Verdict
from circlecal.stages.camera import estimate_camera
from circlecal.stages.correspondences import derive_correspondences
from circlecal.stages.cues import find_cues
from circlecal.stages.edges import detect_edges
from circlecal.stages.ellipse import fit_ellipses
from circlecal.stages.homography import estimate_homography
from circlecal.stages.mask import find_marking
from circlecal.stages.rays import cast_rays
from circlecal.stages.verdict import judge


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
    circle = next((c for c in template.circles if c.name == name), None)
    if circle is None:
        known = ", ".join(c.name for c in template.circles)
        raise ConfigError(f"field.circle: {name!r} is not a circle of {template.name}; known: {known}")
    return template, circle


def run(
    image: NDArray[np.uint8],
    config: Config,
    *,
    mask: NDArray[np.uint8] | None = None,
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
    reached: dict[str, Any] = {}
    timings: dict[str, float] = {}
    try:
        verdict = _stages(image, mask, config, template, circle, frame_generator(config.seed, frame_id), reached, timings)
    except EstimationError as error:
        verdict = Verdict("refused", error.code, error.reason, error.stage)
    return Calibration(
        id=frame_id,
        width=width,
        height=height,
        field_name=template.name,
        circle_name=circle.name,
        verdict=verdict,
        seed=config.seed,
        config_digest=config_digest(config),
        timings_ms=timings,
        source=source,
        **reached,
    )


def _stages(
    image: NDArray[np.uint8],
    given: NDArray[np.uint8] | None,
    config: Config,
    template: FieldTemplate,
    circle: Circle,
    rng: np.random.Generator,
    reached: dict[str, Any],
    timings: dict[str, float],
) -> Verdict:
    """Run the stages in order, leaving every intermediate in ``reached`` for the pictures of refused frames too."""
    height, width = image.shape[:2]
    polarity = -1.0 if circle.color == "dark" else 1.0
    clock = _clock(timings)
    with clock("mask"):
        marking, refusal = find_marking(image, given, config.mask, rng)
        reached["mask"] = marking
    if refusal is not None:
        raise refusal
    with clock("edges"):
        edges = reached["edges"] = detect_edges(image, marking, config.edges, polarity)
    with clock("rays"):
        relative_width = template.marking_width_m / template.radius(circle, "center")
        rays = reached["rays"] = cast_rays(image, edges, marking, relative_width, config.rays, rng, polarity)
    with clock("ellipse"):
        ellipses = reached["ellipses"] = fit_ellipses(rays, width, config.ellipse, rng)
        reached["observations"] = observed(ellipses, Cues(None, None), circle, width, height)
    with clock("cues"):
        cues = reached["cues"] = find_cues(image, marking, ellipses, edges.noise, template, config.cues, polarity)
        observations = reached["observations"] = observed(ellipses, cues, circle, width, height)
    with clock("correspondences"):
        found, refusal = _attempt(
            lambda: derive_correspondences(ellipses, cues, template, circle, (width, height), config.correspondences)
        )
        correspondences = reached["correspondences"] = found
    if correspondences is None and refusal is not None and not config.camera.enabled:
        raise refusal
    homography = None
    if correspondences is not None:
        with clock("homography"):
            homography, refusal = _attempt(
                lambda: estimate_homography(correspondences, np.asarray(circle.center), config.homography)
            )
            reached["homography"] = homography
    if config.camera.enabled:
        with clock("camera"):
            side = config.correspondences.camera_side
            reached["camera"] = estimate_camera(observations, template, circle, config.camera, side)
    elif homography is None and refusal is not None:
        raise refusal
    with clock("verdict"):
        return judge(
            ellipses, cues, correspondences, homography, reached.get("camera"), template, circle, width, config.verdict
        )


def _attempt(stage: Any) -> tuple[Any, EstimationError | None]:
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
        CirclePoints(circle.name, fit.edge, fit.points_px[fit.inliers], fit.sigma_px[fit.inliers]) for fit in fits if fit is not None
    )
    seen = (*((cues.halfway,) if cues.halfway is not None else ()), *cues.lines)
    lines = tuple(LinePoints(line.name, line.points_px, line.sigma_px) for line in seen)
    marks = () if cues.mark is None else (MarkPoint(cues.mark.name, cues.mark.point_px, cues.mark.sigma_px),)
    return Observations(width, height, circles, lines, marks)


def _clock(timings: dict[str, float]) -> Any:
    @contextmanager
    def measure(stage: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            timings[stage] = round((time.perf_counter() - start) * 1e3, 3)

    return measure
