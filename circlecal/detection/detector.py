"""The built-in detector: field, passes over the picture until one finds the circle, mask."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.arcs import SAME_ARC, distinct_arcs
from circlecal.detection.circle import CircleHypothesis, MeasuredCircle
from circlecal.detection.field_region import FieldRegion, find_field_region
from circlecal.detection.marking_mask import MarkingSketch
from circlecal.detection.options import DetectorConfig
from circlecal.detection.passes import flat, quick, thorough
from circlecal.detection.picture import Picture
from circlecal.detection.search import NO_FIELD, Search, search_once
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.projective import Array
from circlecal.paint.colour import lie_on_one_surface, measure_paint_colour, segments_match_paint
from circlecal.paint.profiles import to_gray
from circlecal.results import Interpretation, Segment

__all__ = ["Detection", "detect"]

_BRIGHTNESSES = {"light": ("light",), "dark": ("dark",), "any": ("light", "dark")}
_MARGIN = 0.012  # of the picture's width: by how much the second pass looks beyond the field


@dataclass(frozen=True, slots=True)
class Detection:
    """Everything found in one frame.

    Attributes
    ----------
    region : FieldRegion
        Hull of the playing field, in a reduced picture.
    lines : tuple of Segment
        Straight markings, longest first.
    circle : CircleHypothesis or None
        The accepted circle.
    candidates : tuple of CircleHypothesis
        The best measured hypotheses, best first, also when refused.
    certain : bool
        Whether the circle stands by itself; otherwise it is likely, and something else must confirm it.
    polarity : float
        +1 where the markings are lighter than the surface, -1 where they are darker.
    halfway : Segment or None
        The straight marking through the circle's middle.
    sketch : MarkingSketch
        What the marking mask is drawn from.
    refusal : str or None
        Why there is no circle: ``no_field``, ``no_circle_found``, ``circle_support_too_low``, ``arc_too_short``,
        ``circle_off_marking``, ``width_unlike_marking``.
    arcs : tuple of CircleHypothesis
        Parts of circles without a line through their middle, longest first: the circle, or a penalty arc.
    """

    region: FieldRegion
    lines: tuple[Segment, ...]
    circle: CircleHypothesis | None
    candidates: tuple[CircleHypothesis, ...]
    halfway: Segment | None
    sketch: MarkingSketch
    refusal: str | None
    certain: bool = True
    polarity: float = 1.0
    arcs: tuple[CircleHypothesis, ...] = ()


def detect(
    image_bgr: NDArray[np.uint8],
    config: DetectorConfig,
    rng: np.random.Generator,
    brightness: NDArray[np.uint8] | None = None,
    ruled_out: tuple[Interpretation, ...] = (),
) -> Detection:
    """Find the field, its straight markings, the centre circle and the halfway line in one picture.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8
        The frame.
    config : DetectorConfig
    rng : numpy.random.Generator
        Draws the hypotheses.
    brightness : (H, W) uint8, optional
        Of the frame, where it is known already.
    ruled_out : tuple of Interpretation
        What turned out wrong: such a circle is not found again with such a line.

    Returns
    -------
    Detection
        All coordinates in pixels of the frame; ``refusal`` says why ``circle`` is None.

    Raises
    ------
    ValueError
        Where the picture has another shape or type.
    """
    if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or image_bgr.dtype != np.uint8:
        raise ValueError(f"image_bgr must be (H, W, 3) uint8, not {image_bgr.shape} {image_bgr.dtype}")
    full_grey = to_gray(image_bgr) if brightness is None else brightness
    region = find_field_region(image_bgr, config.field_region)
    search = _searched(Picture(image_bgr, full_grey), region, config, rng, ruled_out)
    segments, found = search.segments, search.found
    kept = _straight_markings(image_bgr, segments, found.circle, found.hypothesis, config.one_paint)
    return Detection(
        region=search.region,
        lines=tuple(Segment(segments[i, 0], segments[i, 1], search.runs[i].support) for i in kept),
        circle=found.hypothesis,
        candidates=found.candidates,
        halfway=None if found.halfway is None else Segment(*found.halfway.ends, support=found.halfway.support),
        sketch=MarkingSketch(full_grey, found.circle, found.halfway, segments[kept], search.sign, config),
        refusal=found.refusal,
        certain=found.certain,
        polarity=search.sign,
        arcs=found.arcs,
    )


def _searched(
    picture: Picture,
    region: FieldRegion,
    config: DetectorConfig,
    rng: np.random.Generator,
    ruled_out: tuple[Interpretation, ...],
) -> Search:
    """The first search that finds a circle beyond doubt with its halfway line, quick ones before slow ones; failing
    that, the best.

    A circle without that line may be one of several on the same floor, a face-off circle say.
    """
    options = [config.model_copy(update={"marking": marking}) for marking in _BRIGHTNESSES[config.marking]]
    passes = [(quick(option), 0.0, region) for option in options]
    searches: list[Search] = []
    for option, margin, surface in passes:
        search = search_once(picture, surface, option, rng, ruled_out, margin)
        if search.found.refusal == NO_FIELD or search.found.settled:
            return search
        searches.append(search)
        if config.thorough and len(searches) == len(options):
            # the stands, or the track before the field, may fill more of the picture
            other = find_field_region(picture.image_bgr, config.field_region, region)
            enough = other.area_share >= config.field_region.area_share
            passes += [(quick(option), 0.0, other) for option in options if enough]
            passes += [
                (thorough(option), _MARGIN, s) for s in (region, *((other,) if enough else ())) for option in options
            ]
    if config.thorough and not any(search.found.circle is not None for search in searches):
        # a circle that is seen very flat has too few rows in the smaller picture
        surfaces = {id(surface): surface for _, _, surface in passes}.values()
        for option, surface in ((option, surface) for option in options for surface in surfaces):
            search = search_once(picture, surface, flat(option), rng, ruled_out, _MARGIN)
            if search.found.settled:
                return search
            searches += [search] if search.found.circle is not None else []
    best = max(searches, key=_rank)
    arcs = [arc for search in searches if search.sign == best.sign for arc in search.found.arcs]
    apart_px, gapless = SAME_ARC * picture.gray.shape[1], config.likely.gapless_share
    distinct = distinct_arcs(arcs, best.found.hypothesis, apart_px, gapless)
    return replace(best, found=replace(best.found, arcs=distinct))


def _rank(search: Search) -> tuple[bool, bool, bool, float, int]:
    """A certain circle, better with its line, beats a likely one, which beats a refusal; then the better score, and
    without a circle the longest arc: the field is where it is.
    """
    found = search.found
    score = found.hypothesis.score if found.hypothesis is not None else 0.0
    return (
        found.settled,
        found.circle is not None and found.certain,
        found.circle is not None,
        score,
        max((len(arc.points) for arc in found.arcs), default=0),
    )


def _straight_markings(
    image_bgr: NDArray[np.uint8],
    segments: Array,
    circle: MeasuredCircle | None,
    hypothesis: CircleHypothesis | None,
    one_paint: bool,
) -> NDArray[np.int64]:
    """Indices of the segments (K, 2, 2) that are painted on one surface, with the circle's paint, and no part of it."""
    straight = lie_on_one_surface(image_bgr, segments)
    if circle is not None and hypothesis is not None:
        straight &= ~_lie_on_circle(segments, hypothesis.conic, image_bgr.shape[1])
        if one_paint:
            colour = measure_paint_colour(image_bgr, circle.points, circle.normals, circle.band)
            straight &= segments_match_paint(image_bgr, segments, colour)
    return np.flatnonzero(straight)


def _lie_on_circle(segments: Array, conic: Array, width: int) -> NDArray[np.bool_]:
    """Which segments (K, 2, 2) are flat parts of the circle."""
    share = np.linspace(0.0, 1.0, 9)[:, None]
    points = segments[:, None, 0] + share * (segments[:, None, 1] - segments[:, None, 0])
    distance = np.abs(sampson_distance(conic, points.reshape(-1, 2))).reshape(-1, 9)
    return np.asarray(np.sort(distance, axis=1)[:, 4] < 4.0 * width / 1920.0, np.bool_)
