"""A frame goes in, every intermediate and a verdict come out; and which circle is tried after a refusal."""

from __future__ import annotations

from typing import Literal
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from circlecal.chain import Chain, refused
from circlecal.config import Config
from circlecal.errors import ConfigError, EstimationError, InputError
from circlecal.field import Circle, FieldTemplate, load_field
from circlecal.geometry.ellipses import encloses
from circlecal.observations import Observations, joined
from circlecal.paint.profiles import to_gray
from circlecal.pictures.interlacing import row_motion, without_combs
from circlecal.results import (
    Calibration,
    CameraFit,
    Cues,
    EllipseFits,
    Interpretation,
    MarkingMask,
    Verdict,
)
from circlecal.stages.confirm import is_circle_painted, look_for_markings
from circlecal.stages.mask import with_arc
from circlecal.stages.verdict import beyond_doubt, confirmed, doubtful, surely_assigned

Convention = Literal["official", "paint"]
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
MOST_INTERPRETATIONS = 3
"""How often."""
PARTIAL_DEG = 240.0
"""The same where less of the circle is seen: an ellipse fitted to a part of it leaves the paint beyond."""
UNCERTAIN_PX = 12.0
"""Largest predicted error, pixels at 1920 px width, from which on fainter straight markings are looked for."""
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
    chain = Chain(config, template, circle, width, height, frame_generator(config.seed, frame_id))
    return chain.calibration(lambda: _Attempts(chain, image, mask, extra).verdict(), frame_id, source)


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
    chain = Chain(config, template, circle, *size, frame_generator(config.seed, frame_id))
    return chain.calibration(lambda: chain.from_observations(observations), frame_id, source)


class _Attempts:
    """One picture, and what is tried with it: the first circle that is found, then others, then arcs."""

    def __init__(
        self, chain: Chain, image: NDArray[np.uint8], given: NDArray[np.uint8] | None, extra: Observations | None
    ) -> None:
        self.chain = chain
        self.image = image
        self.given = given
        self.extra = extra
        with chain.clock("mask"):
            self.brightness = to_gray(image)
            motion = row_motion(self.brightness) if chain.config.mask.deinterlace else None
            if motion is not None:
                self.image = without_combs(image, motion)
                self.brightness = to_gray(self.image)

    def verdict(self) -> Verdict:
        """The answer with the first circle; failing that, with another one, or with an arc as the circle."""
        chain = self.chain
        first = verdict = self._with_circle()
        reached = chain.reached
        ruled_out: tuple[Interpretation, ...] = ()
        while (verdict.code in TAKEN_WRONGLY or doubtful(verdict)) and len(ruled_out) < MOST_INTERPRETATIONS:
            mask: MarkingMask = chain.reached["mask"]
            if mask.source != "detector" or mask.conic is None:
                break
            ruled_out = (*ruled_out, Interpretation(mask.conic, mask.halfway))
            chain.reached = {}
            verdict = self._with_circle(ruled_out)
            if verdict.status == "calibrated" and (
                surely_assigned(verdict, chain.reached["camera"], chain.reached["cues"])
                or (first.code == "line_beyond_field" and self._about(ruled_out[0]))
            ):
                return verdict
        chain.reached = reached
        return self._with_arcs(first) if first.status == "refused" else first

    def _about(self, smaller: Interpretation) -> bool:
        """Whether the circle lies about one that was too small for the field, and another marking is at its place."""
        mask: MarkingMask = self.chain.reached["mask"]
        camera: CameraFit = self.chain.reached["camera"]
        return bool(camera.named_lines) and mask.conic is not None and encloses(mask.conic, smaller.conic)

    def _with_arcs(self, first: Verdict) -> Verdict:
        """The first answer that is accepted with a nearly gapless arc as the circle; where there are such arcs and no
        circle, that they are not enough.
        """
        chain, reached = self.chain, self.chain.reached
        marking: MarkingMask = reached["mask"]
        arcs = [arc for arc in marking.arcs if arc.gapless]
        for arc in arcs:
            chain.reached = {}
            verdict = self._with_circle(marking=with_arc(marking, arc))
            if verdict.status == "calibrated":
                return verdict
        chain.reached = reached
        if arcs and first.stage == "mask":
            return Verdict("refused", "rotation_free", ARC_ALONE, "camera")
        return first

    def _with_circle(self, ruled_out: tuple[Interpretation, ...] = (), marking: MarkingMask | None = None) -> Verdict:
        """The answer with the circle of a marking, or with the first that is found, other than those ruled out."""
        chain, extra = self.chain, self.extra
        try:
            ellipses, cues, seen = chain.seen(self.image, self.given, self.brightness, ruled_out, marking)
        except EstimationError as refusal:
            if extra is None:
                return refused(refusal)
            try:
                return chain.from_observations(extra)
            except EstimationError as error:
                return refused(refusal if error.code in UNDETERMINED else error)
        observations = seen if extra is None else joined(seen, extra)
        chain.reached["observations"] = observations
        try:
            verdict = chain.answer(ellipses, cues, observations)
            camera: CameraFit | None = chain.reached.get("camera")
            partial = ellipses.primary.arc_deg < PARTIAL_DEG
            if camera is not None and (partial or verdict.code in MEASURED_AGAIN):
                turned = cues.halfway is None and bool(camera.names_by_line)
                again = chain.seen_again(self.brightness, observations, turned)
                if again is not None:
                    verdict = chain.answer(ellipses, cues, again, camera if turned else None)
            verdict = self._with_faint_lines(verdict, ellipses, cues)
        except EstimationError as error:
            return refused(error)
        return self._looked_at(verdict, ellipses, chain.reached["cues"], chain.reached["observations"])

    def _with_faint_lines(self, verdict: Verdict, ellipses: EllipseFits, cues: Cues) -> Verdict:
        """The answer with straight markings that only an uncertain camera finds, where it is the better one."""
        chain = self.chain
        camera: CameraFit | None = chain.reached.get("camera")
        uncertain = verdict.status == "calibrated" or verdict.code == "too_uncertain"
        if camera is None or cues.halfway is None or not uncertain or not chain.config.cues.further_lines:
            return verdict
        if camera.max_sigma_px < UNCERTAIN_PX * chain.width / 1920.0:
            return verdict
        before = dict(chain.reached)
        observations = chain.with_faint_lines(self.brightness, chain.reached["observations"])
        if observations is None:
            return verdict
        try:
            again = chain.answer(ellipses, chain.reached["cues"], observations)
        except EstimationError:
            again = None
        found: CameraFit = chain.reached["camera"]
        if again is not None and again.status == "calibrated" and found.max_sigma_px < camera.max_sigma_px:
            return again
        chain.reached = before
        return verdict

    def _looked_at(self, verdict: Verdict, ellipses: EllipseFits, cues: Cues, observations: Observations) -> Verdict:
        """The verdict after the picture was looked at once more, where the camera puts the markings."""
        chain = self.chain
        camera: CameraFit | None = chain.reached.get("camera")
        if camera is None:
            return verdict
        template, circle = chain.template, chain.circle
        picture = chain.with_light_markings(self.brightness)
        if verdict.code == "circle_unconfirmed" and is_circle_painted(picture, camera, template, circle):
            verdict = chain.judged(ellipses, cues, certain=True)
        with chain.clock("verdict"):
            if verdict.status == "refused" or beyond_doubt(camera, cues, template):
                return verdict
            mask: MarkingMask = chain.reached["mask"]
            seen_names = {line.line for line in observations.lines} | {c.circle for c in observations.circles}
            known = frozenset(name for name in (*seen_names, *camera.named_lines) if name is not None)
            expected = look_for_markings(picture, camera, template, circle, known, mask.field_region)
            return confirmed(verdict, camera, cues, expected)
