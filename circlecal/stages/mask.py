"""Stage ``mask``: where the markings are: from the user's mask, from the picture itself, or by a user's network."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from circlecal.detection import Detection, DetectorConfig, detect
from circlecal.detection.arcs import GAPLESS_SHARE
from circlecal.detection.circle import CircleHypothesis
from circlecal.detection.detector import Sighting
from circlecal.detection.field_region import find_field_region
from circlecal.detection.given_mask import is_binary, is_marked, sort_markings
from circlecal.detection.marking_mask import MarkingSketch
from circlecal.detection.networks import SegmentationNetwork, load_network, segment
from circlecal.detection.options import FieldRegionConfig
from circlecal.detection.paints import find_paints
from circlecal.detection.short_lines import find_short_runs
from circlecal.errors import EstimationError
from circlecal.field import FieldTemplate, Ground
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, Mask
from circlecal.paint.colour import surface_colour
from circlecal.refusals import Confidence, refuse
from circlecal.results import CIRCLE_ID, HALFWAY_ID, CircleCandidate, Interpretation, MarkingMask, SeenArc

MODEL_KEY = "mask.model"
ARC_RADIUS_PX = 3.0
"""Of the discs that stand for an arc's paint in the mask, pixels at 1920 px width."""
ONE_ELLIPSE_SHARE = 0.25
"""Of the small half axis, by which a mask's circle and the picture's may differ: masks of networks are coarse."""
GREEN_HUE_DEG, LEAST_CHROMA = (100.0, 155.0), 10.0
"""Hue in the a-b plane of CIE Lab, degrees, and least distance from gray, of turf and green carpet: 55 real pictures of
them have 116 to 134 degrees and 20 to 67; ice and light halls stay below 6, wood and painted floors have other hues.
"""
LEAST_ICE_LEVEL = 165.0
"""Lightness (0 to 255) of ice and of light halls: nine real pictures of rinks have 186 to 221."""


class MaskConfig(BaseModel):
    """Options of the stage ``mask``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    source: Literal["auto", "file", "detector", "onnx"] = Field(
        "auto",
        description="Where the marking comes from; auto takes a given mask, else the built-in detector, also where a "
        "court or a rink is refused with its mask; onnx runs the network of `model`.",
    )
    model: str | None = Field(None, description="ONNX file of a segmentation network, for the source onnx.")
    network: SegmentationNetwork = Field(SegmentationNetwork(), description="What that network takes and gives.")
    threshold_px: float = Field(
        4.0,
        gt=0,
        le=100,
        description="How far the middle of a given mask may lie from the circle, pixels at 1920 px width; larger for "
        "masks of networks that work on small pictures.",
    )
    deinterlace: bool = Field(
        True, description="Join the two halves of an interlaced frame's rows where they show different moments."
    )
    leave_out_graphics: bool = Field(
        True, description="Leave out level boxes of graphics: their edges are no markings, and hide some."
    )
    paint_bgr: tuple[float, float, float] | None = Field(
        None,
        description="What the paint adds to blue, green and red of the surface, in any strength: markings are told by"
        " this colour and not by their brightness; `circlecal batch` and `track` fill it in with what they learn.",
    )
    other_paint_bgr: tuple[tuple[float, float, float], ...] = Field(
        (), description="The same of other lines on this floor, which then show as little as they can."
    )
    tell_paints: bool = Field(
        True,
        description="Whether on a floor with lines of several colours those of each colour are looked at by themselves,"
        " where all together are refused.",
    )
    detector: DetectorConfig = Field(DetectorConfig(), description="Options of the built-in detector.")


def find_marking(
    image: NDArray[np.uint8],
    given: NDArray[np.uint8] | None,
    config: MaskConfig,
    rng: np.random.Generator,
    gray: NDArray[np.uint8] | None = None,
    ruled_out: tuple[Interpretation, ...] = (),
    first_look: Detection | None = None,
) -> tuple[MarkingMask, EstimationError | None]:
    """The marking mask of a frame, and the reason where it holds no circle.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    given : (H, W) uint8 or None
        The user's mask as SoccerNet class ids.
    config : MaskConfig
        Options.
    rng : numpy.random.Generator
        For the detector's and the mask's robust fits.
    gray : (H, W) uint8, optional
        Gray levels of the picture, where they are known already.
    ruled_out : tuple of Interpretation
        What the built-in detector shall not find again.
    first_look : Detection, optional
        What :func:`look_quickly` found, with which the built-in detector goes on.

    Returns
    -------
    MarkingMask
        Also for frames without a circle, so that they can be looked at.
    EstimationError or None
        Why no circle was found.

    Raises
    ------
    ConfigError
        The network is missing or unusable.
    """
    if config.source == "onnx":
        classes = segment(image, config.model, config.network, MODEL_KEY)
        return _look_beyond_mask(image, *marking_from_classes(classes, config, rng, "network"), config, rng, gray)
    if given is None and config.source == "file":
        return MarkingMask(np.zeros(image.shape[:2], dtype=np.uint8), "file"), refuse("mask", "no_mask")
    if given is None or config.source == "detector":
        return marking_from_detection(detect(image, config.detector, rng, gray, ruled_out, first_look))
    found = marking_from_classes(given, config, rng)
    return found if config.source == "file" else _look_beyond_mask(image, *found, config, rng, gray)


def _look_beyond_mask(
    image: NDArray[np.uint8],
    marking: MarkingMask,
    refusal: EstimationError | None,
    config: MaskConfig,
    rng: np.random.Generator,
    gray: NDArray[np.uint8] | None,
) -> tuple[MarkingMask, EstimationError | None]:
    """A mask's marking with what the picture shows of lines, where the mask has nothing but a circle, or lines and no
    circle: a circle alone leaves open how it is turned, and lines of a mask have no names.
    """
    if (marking.halfway is not None or marking.lines) if refusal is None else not marking.classes.any():
        return marking, refusal
    seen, nothing_seen = marking_from_detection(detect(image, config.detector, rng, gray))
    if refusal is not None:
        if (
            nothing_seen is None
            and seen.conic is not None
            and is_binary(marking.classes)
            and is_marked(seen.conic, marking.classes)
        ):
            return seen, None
        shown = seen.lines if seen.halfway is None else (*seen.lines, seen.halfway)
        return replace(seen, conic=None, halfway=None, lines=shown, arcs=(), candidates=()), refusal
    if marking.conic is None or seen.conic is None or not _is_one_ellipse(marking.conic, seen.conic):
        return marking, None
    return replace(marking, halfway=seen.halfway, lines=seen.lines), None


def _is_one_ellipse(first: Array, second: Array) -> bool:
    """Whether two conics are nearly one ellipse: their middles and half axes differ by little of the small one."""
    one, other = ellipse_from_conic(first), ellipse_from_conic(second)
    if one is None or other is None:
        return False
    apart = [np.abs(one.center - other.center).max(), np.abs(np.subtract(one.semi_axes, other.semi_axes)).max()]
    return bool(max(apart) < ONE_ELLIPSE_SHARE * one.semi_axes[1])


def find_short_markings(gray: NDArray[np.uint8], marking: MarkingMask, known: Array, config: MaskConfig) -> Array:
    """Ends (R, 2, 2) of straight runs that are too short to be looked for in every picture.

    Parameters
    ----------
    gray : (H, W) uint8
        The picture, with the markings lighter than the field.
    marking : MarkingMask
        What was found; there are no short runs where it holds no circle or no playing surface.
    known : (K, 2, 2) array
        Ends of straight markings that were measured; those of the marking mask are known, too.
    config : MaskConfig
        Options.
    """
    if marking.field_region is None or marking.conic is None:
        return np.zeros((0, 2, 2))
    rough = np.array([(line.start, line.end) for line in marking.lines]).reshape(-1, 2, 2)
    straight = np.concatenate([rough, known])
    return find_short_runs(gray, marking.field_region, marking.conic, straight, config.detector)


def look_quickly(
    image: NDArray[np.uint8],
    given: NDArray[np.uint8] | None,
    config: MaskConfig,
    rng: np.random.Generator,
    gray: NDArray[np.uint8],
    covered: Mask | None = None,
) -> Detection | None:
    """The quick passes of the built-in detector over a frame; None where its marking comes from elsewhere.

    Parameters
    ----------
    image, given, config, rng, gray
        As for :func:`find_marking`.
    covered : (H, W) bool, optional
        What graphics cover.
    """
    if config.source == "detector" or (config.source == "auto" and given is None):
        quick = config.detector.model_copy(update={"thorough": False})
        return detect(image, quick, rng, gray, covered=covered)
    return None


def suit_field(config: MaskConfig, template: FieldTemplate) -> MaskConfig:
    """The options with what they leave open about the paint as a field template says."""
    given = config.detector
    told = {
        # along the colour of its paint a marking is light
        "marking": (given.marking or template.polarity) if config.paint_bgr is None else "light",
        "one_paint": template.is_in_one_paint if given.one_paint is None else given.one_paint,
        "shared_halfway": template.ground == "grass" if given.shared_halfway is None else given.shared_halfway,
        "field_region": given.field_region.model_copy(
            update={"light": template.ground == "ice" if given.field_region.light is None else given.field_region.light}
        ),
    }
    return config.model_copy(update={"detector": given.model_copy(update=told)})


def tell_paint(config: MaskConfig, added_bgr: tuple[float, float, float] | None) -> MaskConfig:
    """The options with what the paint adds to blue, green and red of its surface, where the options leave it open and
    somebody knows it.
    """
    if added_bgr is None or config.paint_bgr is not None:
        return config
    return config.model_copy(update={"paint_bgr": added_bgr})


def tell_grounds(image: NDArray[np.uint8]) -> tuple[Ground, ...]:
    """Playing surfaces that a BGR picture (H, W, 3) may show by the colour that dominates it, the likeliest first."""
    colour = surface_colour(image, find_field_region(image, FieldRegionConfig()).hull)
    if colour is None:
        return ("grass", "floor", "ice")
    level, a, b = colour.tolist()
    hue = float(np.degrees(np.arctan2(b, a)))
    if np.hypot(a, b) < LEAST_CHROMA:
        return ("ice", "floor") if level >= LEAST_ICE_LEVEL else ("grass", "floor", "ice")
    return ("grass",) if GREEN_HUE_DEG[0] <= hue <= GREEN_HUE_DEG[1] else ("floor",)


def tell_paints(image: NDArray[np.uint8], config: MaskConfig) -> tuple[Array, ...]:
    """What each paint on the playing surface of a BGR picture (H, W, 3) adds to its blue, green and red (3,), the one
    with most lines first.
    """
    return find_paints(image, config.detector.field_region)


def require_mask_network(config: MaskConfig) -> None:
    """Load the network, so that a run fails before its first frame.

    Raises
    ------
    ConfigError, MissingExtraError
        As :func:`circlecal.detection.networks.load_network`.
    """
    if config.source == "onnx":
        load_network(config.model, config.network.provider, MODEL_KEY)


def marking_from_classes(
    classes: NDArray[np.uint8], config: MaskConfig, rng: np.random.Generator, source: str = "file"
) -> tuple[MarkingMask, EstimationError | None]:
    """Take over what a mask of class ids (H, W) holds."""
    threshold_px = config.threshold_px * classes.shape[1] / 1920.0
    found = sort_markings(classes, threshold_px, config.detector, rng)
    if found is not None:
        return MarkingMask(classes, source, found.conic, found.halfway, found.lines), None
    is_black = "the mask is all black: nothing is marked in it"
    words = "the mask holds no ellipse of the circle's class (id 7)" if classes.any() else is_black
    return MarkingMask(classes, source), refuse("mask", "no_circle_found", words)


def marking_from_detection(found: Detection) -> tuple[MarkingMask, EstimationError | None]:
    """Take over what the built-in detector found."""
    refusal = found.refusal or "no_circle_found"
    marking = MarkingMask(
        drawn=found.sketch.draw,
        source="detector",
        conic=None if found.circle is None else found.circle.conic,
        halfway=found.halfway,
        lines=found.lines,
        field_region=found.region.hull > 0,
        candidates=tuple(CircleCandidate(c.conic, c.score, c.checks) for c in found.candidates),
        confidence=found.confidence,
        polarity=found.polarity,
        band_px=0.0 if found.sketch.circle is None else found.sketch.circle.widest_px,
        arcs=_take_over_arcs(found.arcs),
        sightings=tuple(_marking_from_sighting(sighting, found.sketch) for sighting in found.sightings),
    )
    if found.circle is None:
        return marking, refuse("mask", refusal)
    return marking, None


def _take_over_arcs(arcs: tuple[CircleHypothesis, ...]) -> tuple[SeenArc, ...]:
    return tuple(SeenArc(arc.conic, arc.points, arc.least_share >= GAPLESS_SHARE) for arc in arcs)


def _marking_from_sighting(seen: Sighting, sketch: MarkingSketch) -> MarkingMask:
    """Markings of one polarity on one surface, none of which is taken for the circle."""
    ends = np.array([(line.start, line.end) for line in seen.lines]).reshape(-1, 2, 2)
    return MarkingMask(
        drawn=replace(sketch, circle=None, halfway=None, segments=ends, sign=seen.sign).draw,
        source="detector",
        lines=seen.lines,
        field_region=seen.region.hull > 0,
        candidates=tuple(CircleCandidate(c.conic, c.score, c.checks) for c in seen.candidates),
        confidence=Confidence.REJECTED,
        polarity=seen.sign,
        band_px=0.0,
        arcs=_take_over_arcs(seen.arcs),
    )


def replace_circle_by_arc(marking: MarkingMask, arc: SeenArc) -> MarkingMask:
    """Take an arc for the circle, which other markings must confirm, and no line for the halfway line."""
    others = tuple(other for other in marking.arcs if other is not arc)

    def draw() -> NDArray[np.uint8]:
        classes = marking.classes.copy()
        classes[(classes == CIRCLE_ID) | (classes == HALFWAY_ID)] = 0
        radius = max(1, round(ARC_RADIUS_PX * classes.shape[1] / 1920.0))
        for x, y in np.round(arc.points_px).astype(int).tolist():
            cv2.circle(classes, (x, y), radius, CIRCLE_ID, cv2.FILLED)
        return classes

    return replace(
        marking, drawn=draw, conic=arc.conic, halfway=None, confidence=Confidence.TENTATIVE, arcs=others, band_px=None
    )
