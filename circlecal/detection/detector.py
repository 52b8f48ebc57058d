"""The built-in detector: field, passes over the picture until one finds the circle, straight markings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.arcs import select_arcs
from circlecal.detection.circle import CircleHypothesis
from circlecal.detection.field_region import FieldRegion
from circlecal.detection.marking_mask import MarkingSketch
from circlecal.detection.one_pass import NO_FIELD, Pass, PassResult, PictureSearch, first_pass, flat_pass, second_pass
from circlecal.detection.options import DetectorConfig
from circlecal.detection.picture import Picture
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.projective import Array, Mask
from circlecal.paint.colour import lie_on_one_surface, measure_paint_colour, segments_match_paint
from circlecal.paint.profiles import to_gray
from circlecal.refusals import Confidence
from circlecal.results import Interpretation, Segment

__all__ = ["Detection", "Sighting", "detect"]

SIGNS = {"light": (1.0,), "dark": (-1.0,), "any": (1.0, -1.0)}
"""By the option ``marking``: +1 for markings lighter than the surface, -1 for darker ones, in the order of the search.
"""
LEAST_SEEN = 0.1
"""Score of the best ellipse that former passes saw on a surface, below which the last passes leave it alone, and the
slow one where another surface holds a circle. Of 131 last passes over real frames and those of eight profiles four led
to calibrations, after scores of 0.16 to 0.4, and 65 followed scores below 0.1. Of 20 slow passes beside a surface with
a circle those found one that saw it before, since both surfaces overlap.
"""
LEAST_GLIMPSED = 0.05
"""Score of the best ellipse that the quick pass saw on a surface beside the largest one, below which no slow pass over
it follows: of 55 such passes over 73 real pictures and 226 rendered ones of 14 profiles 14 found a circle, after scores
of 0.081 or more; 23 followed scores below 0.05. On the largest surface paint may be too faint for the quick pass. All
were first looks: where a circle was ruled out, a slow pass over a real yard saw an ellipse of 0.42 after 0.033.
"""
ON_CIRCLE_PX, PLACES = 4.0, 9
"""Pixels at 1920 px width from the circle within which half of a segment's places, so many, make it a flat part of it.
"""


@dataclass(frozen=True, slots=True)
class Sighting:
    """What all passes over one surface found of markings of one polarity.

    Attributes
    ----------
    region : FieldRegion
        The surface.
    sign : float
        +1 for markings lighter than it, -1 for darker ones.
    lines : tuple of Segment
        Straight markings, longest first.
    candidates : tuple of CircleHypothesis
        Measured ellipses, best first.
    arcs : tuple of CircleHypothesis
        Parts of circles, longest first.
    """

    region: FieldRegion
    sign: float
    lines: tuple[Segment, ...]
    candidates: tuple[CircleHypothesis, ...]
    arcs: tuple[CircleHypothesis, ...]


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
        The circle.
    candidates : tuple of CircleHypothesis
        The best measured hypotheses, best first, also when refused.
    halfway : Segment or None
        The straight marking through the circle's middle.
    sketch : MarkingSketch
        What the marking mask is drawn from.
    refusal : str or None
        Why there is no circle: ``no_field``, ``no_circle_found``, ``circle_support_too_low``, ``arc_too_short``,
        ``circle_off_marking``, ``width_unlike_marking``.
    confidence : Confidence
        Whether the circle stands by itself or something else must confirm it; rejected where there is none.
    polarity : float
        +1 where the markings are lighter than the surface, -1 where they are darker.
    arcs : tuple of CircleHypothesis
        Parts of circles without a line through their middle, longest first: the circle, or a penalty arc.
    passes : tuple of PassResult
        What each pass over the picture found, in the order of the search.
    search : PictureSearch
        The picture with all that was found in it, for further interpretations.
    sightings : tuple of Sighting
        What was found on each surface and of each polarity, that of the answer first.
    """

    region: FieldRegion
    lines: tuple[Segment, ...]
    circle: CircleHypothesis | None
    candidates: tuple[CircleHypothesis, ...]
    halfway: Segment | None
    sketch: MarkingSketch
    refusal: str | None
    confidence: Confidence
    polarity: float
    arcs: tuple[CircleHypothesis, ...]
    passes: tuple[PassResult, ...]
    search: PictureSearch
    sightings: tuple[Sighting, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Whether an accepted circle was found with its halfway line, so that no further pass is needed."""
        return self.passes[-1].choice.is_complete


def detect(
    image_bgr: NDArray[np.uint8],
    config: DetectorConfig,
    rng: np.random.Generator,
    gray: NDArray[np.uint8] | None = None,
    ruled_out: tuple[Interpretation, ...] = (),
    earlier: Detection | None = None,
    covered: Mask | None = None,
) -> Detection:
    """Find the field, its straight markings, the centre circle and the halfway line in one picture.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8
        The frame.
    config : DetectorConfig
    rng : numpy.random.Generator
        Draws the hypotheses.
    gray : (H, W) uint8, optional
        Gray levels of the frame, where they are known already.
    ruled_out : tuple of Interpretation
        What turned out wrong: such a circle is not found again with such a line.
    earlier : Detection, optional
        A quicker search of the picture with the same options, and nothing ruled out: what it found is not looked for
        again.
    covered : (H, W) bool, optional
        What graphics cover: no share of a circle is missed there.

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
    if earlier is not None and earlier.is_complete and not ruled_out:
        return earlier
    if earlier is not None:
        search = earlier.search
    else:
        search = PictureSearch(Picture(image_bgr, to_gray(image_bgr) if gray is None else gray, covered))
    picture = search.picture
    best, passes = _run_passes(search, config, rng, ruled_out)
    segments, choice = best.segments, best.choice
    kept = _select_straight_markings(image_bgr, best, config.one_paint is not False)
    sketch = MarkingSketch(picture.gray, choice.circle, choice.halfway, segments[kept], best.sign, config.refinement)
    return Detection(
        region=best.region,
        lines=tuple(Segment(segments[i, 0], segments[i, 1], best.runs[i].support) for i in kept),
        circle=choice.hypothesis,
        candidates=choice.candidates,
        halfway=None if choice.halfway is None else Segment(*choice.halfway.ends, support=choice.halfway.support),
        sketch=sketch,
        refusal=choice.refusal,
        confidence=choice.confidence,
        polarity=best.sign,
        arcs=choice.arcs,
        passes=passes,
        search=search,
        sightings=_sort_sightings(picture, best, kept, passes, config.one_paint is not False),
    )


def _sort_sightings(
    picture: Picture, best: PassResult, of_best: NDArray[np.int64], passes: tuple[PassResult, ...], one_paint: bool
) -> tuple[Sighting, ...]:
    """What the passes found, by surface and polarity; that of the best pass, whose straight markings are known by
    index, first.
    """
    groups: dict[tuple[int, float], list[PassResult]] = {(id(best.region), best.sign): []}
    for result in passes:
        groups.setdefault((id(result.region), result.sign), []).append(result)
    found = []
    for results in groups.values():
        last = results[-1]  # the most thorough one
        kept = of_best if last is best else _select_straight_markings(picture.image_bgr, last, one_paint)
        candidates = [candidate for result in results for candidate in result.choice.candidates]
        arcs = [arc for result in results for arc in result.choice.arcs]
        found.append(
            Sighting(
                last.region,
                last.sign,
                tuple(Segment(last.segments[i, 0], last.segments[i, 1], last.runs[i].support) for i in kept),
                tuple(sorted(candidates, key=lambda candidate: -candidate.score)),
                select_arcs(arcs, None, picture.gray.shape[1]),
            )
        )
    return tuple(found)


def _run_passes(
    search: PictureSearch,
    config: DetectorConfig,
    rng: np.random.Generator,
    ruled_out: tuple[Interpretation, ...],
) -> tuple[PassResult, tuple[PassResult, ...]]:
    """The first pass that finds an accepted circle with its halfway line, quick ones before slow ones; failing that,
    the best. And all passes that were made.

    A circle without that line may be one of several on the same floor, a face-off circle say.
    """
    results: list[PassResult] = []
    passes: list[PassResult] = []
    for settings, region in _plan(search, config, results, is_first_look=not ruled_out):
        result = search.run_pass(region, config, settings, rng, ruled_out)
        passes.append(result)
        if result.choice.refusal == NO_FIELD or result.choice.is_complete:
            return result, tuple(passes)
        if result.choice.circle is not None or not settings.is_last_resort:
            results.append(result)
    best = max(results, key=_rank)
    arcs = [arc for result in results if result.sign == best.sign for arc in result.choice.arcs]
    distinct = select_arcs(arcs, best.choice.hypothesis, search.picture.gray.shape[1])
    return replace(best, choice=replace(best.choice, arcs=distinct)), tuple(passes)


def _plan(
    search: PictureSearch, config: DetectorConfig, results: list[PassResult], *, is_first_look: bool
) -> Iterator[tuple[Pass, FieldRegion]]:
    """Passes and the regions that they search, in order: quick ones on the largest surface, then quick and slow ones
    also on the largest beside it; last ones where the ``results`` of all others hold no circle. Surfaces on which
    nothing like a circle was seen are left out of the slow ones where another holds one, and of the last ones; in a
    first look that beside the largest is left out where hardly anything was.
    """
    regions = [search.find_region(0, config)]
    signs = SIGNS[config.marking or "light"]
    for sign in signs:
        yield first_pass(config, sign), regions[0]
    if not config.thorough:
        return
    # the stands, or the track before the field, may fill more of the picture
    other = search.find_region(1, config)
    if other.area_share >= config.field_region.area_share:
        regions.append(other)
        for sign in signs:
            yield first_pass(config, sign), other
    for region in regions:
        elsewhere = any(result.choice.circle is not None and result.region is not region for result in results)
        is_beside = is_first_look and region is not regions[0]
        least = LEAST_SEEN if elsewhere else LEAST_GLIMPSED if is_beside else 0.0
        for sign in signs:
            if not _is_bare(results, region, sign, least):
                yield second_pass(config, sign), region
    if not any(result.choice.circle is not None for result in results):
        for sign in signs:
            for region in regions:
                if not _is_bare(results, region, sign, LEAST_SEEN):
                    yield flat_pass(config, sign), region


def _is_bare(results: Sequence[PassResult], region: FieldRegion, sign: float, least: float) -> bool:
    """Whether no pass over a surface saw an ellipse of markings of a polarity on it that has at least some score."""
    scores = (
        result.choice.candidates[0].score
        for result in results
        if result.region is region and result.sign == sign and result.choice.candidates
    )
    return max(scores, default=0.0) < least


def _rank(result: PassResult) -> tuple[bool, bool, bool, float, int]:
    """An accepted circle, better with its line, beats a tentative one, which beats a refusal; then the better score,
    and without a circle the longest arc: the field is where it is.
    """
    choice = result.choice
    return (
        choice.is_complete,
        choice.confidence is Confidence.ACCEPTED,
        choice.circle is not None,
        choice.hypothesis.score if choice.hypothesis is not None else 0.0,
        max((len(arc.points) for arc in choice.arcs), default=0),
    )


def _select_straight_markings(image_bgr: NDArray[np.uint8], result: PassResult, one_paint: bool) -> NDArray[np.int64]:
    """Indices of the segments that are painted on one surface, with the circle's paint, and are no part of it."""
    segments, circle, hypothesis = result.segments, result.choice.circle, result.choice.hypothesis
    straight = lie_on_one_surface(image_bgr, segments)
    if circle is not None and hypothesis is not None:
        straight &= ~_lie_on_circle(segments, hypothesis.conic, image_bgr.shape[1])
        if one_paint:
            colour = measure_paint_colour(image_bgr, circle.curve)
            straight &= segments_match_paint(image_bgr, segments, colour)
    return np.flatnonzero(straight)


def _lie_on_circle(segments: Array, conic: Array, width: int) -> NDArray[np.bool_]:
    """Which segments (K, 2, 2) are flat parts of the circle."""
    share = np.linspace(0.0, 1.0, PLACES)[:, None]
    points = segments[:, None, 0] + share * (segments[:, None, 1] - segments[:, None, 0])
    distance = np.abs(sampson_distance(conic, points.reshape(-1, 2))).reshape(-1, PLACES)
    return np.asarray(np.sort(distance, axis=1)[:, PLACES // 2] < ON_CIRCLE_PX * width / 1920.0, np.bool_)
