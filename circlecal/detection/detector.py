"""The built-in detector: field, ridges, straight lines, circle hypotheses, measurement, verdict, mask."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.arcs import SAME_ARC, distinct_arcs, drawn_arc, near_conics
from circlecal.detection.circle import (
    MeasuredCircle,
    drawn_on_both_sides,
    hypothesis_of,
    likely_arc,
    measure_circle,
    refusal_of,
)
from circlecal.detection.config import DetectorConfig
from circlecal.detection.field_region import FieldRegion, find_field_region
from circlecal.detection.flat_sides import onto_flat_sides
from circlecal.detection.halfway import MeasuredLine, find_halfway, segments_through_middle
from circlecal.detection.hypotheses import EllipseBatch, draw_ellipses
from circlecal.detection.lines import StraightRun, find_straight_runs
from circlecal.detection.marking_mask import MarkingSketch
from circlecal.detection.paint import painted_share
from circlecal.detection.result import CircleHypothesis, Detection, LineSegment
from circlecal.detection.ridges import RidgePoints, find_ridges
from circlecal.detection.ruled_out import assigned_alike, segments_left
from circlecal.detection.scoring import RidgeRaster, best_distinct, ranked, refitted, support_of
from circlecal.detection.sides import alike_paint, paint_colour, painted_alike, painted_on_one_surface
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.homogeneous import Array
from circlecal.profiles import grey as brightness_of
from circlecal.results import Assignment

__all__ = ["detect"]

_BRIGHTNESSES = {"light": ("light",), "dark": ("dark",), "any": ("light", "dark")}
_SIGNS = {"light": 1.0, "dark": -1.0}
_NO_FIELD = "no_field"
_MARGIN = 0.012  # of the picture's width: by how much the second pass looks beyond the field
_SHORTEST_RUN = 0.10  # picture widths: shorter straight runs are not reported
_FEWEST_SECTORS = 8  # of a circle: fewer do not tell how much of it is painted
_SHORTEST_HALFWAY = 0.04  # picture widths: of a piece of the halfway line of a circle that has no longer one


@dataclass(slots=True)
class _Stopwatch:
    timings_ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.timings_ms[name] = self.timings_ms.get(name, 0.0) + (now - self._last) * 1e3
        self._last = now


@dataclass(frozen=True, slots=True)
class _Frame:
    """The full picture (H, W, 3) and its brightness (H, W)."""

    image_bgr: NDArray[np.uint8]
    grey: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class _Scaling:
    """Detection picture <-> full picture, with pixel centres at whole numbers in both."""

    factor: Array  # full pixels per detection pixel, (2,)

    def full(self, points: Array) -> Array:
        return (points + 0.5) * self.factor - 0.5

    def full_ellipses(self, batch: EllipseBatch) -> EllipseBatch:
        return EllipseBatch(self.full(batch.centers), batch.great * self.factor, batch.small * self.factor)

    def detection_ellipses(self, batch: EllipseBatch) -> EllipseBatch:
        centers = (batch.centers + 0.5) / self.factor - 0.5
        return EllipseBatch(centers, batch.great / self.factor, batch.small / self.factor)


@dataclass(frozen=True, slots=True)
class _Found:
    """The accepted circle with its line, or the reason why there is none."""

    circle: MeasuredCircle | None
    hypothesis: CircleHypothesis | None
    halfway: MeasuredLine | None
    candidates: tuple[CircleHypothesis, ...]
    refusal: str | None
    certain: bool = True
    arcs: tuple[CircleHypothesis, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether the circle is beyond doubt and has its halfway line."""
        return self.circle is not None and self.certain and self.halfway is not None


@dataclass(frozen=True, slots=True)
class _Search:
    """One pass over the picture: what it took for the field, what it saw and what it found."""

    region: FieldRegion
    ridges: RidgePoints
    runs: list[StraightRun]
    segments: Array
    found: _Found
    scaling: _Scaling
    sign: float


def quick(config: DetectorConfig) -> DetectorConfig:
    """Options of the first pass: a smaller picture and fewer hypotheses."""
    first, drawn = config.first_pass, config.hypotheses
    draws, scored = max(100, int(first.effort * drawn.draws)), max(10, int(first.effort * drawn.scored))
    return config.model_copy(
        update={
            "detection_width_px": min(first.width_px, config.detection_width_px),
            "hypotheses": drawn.model_copy(update={"draws": draws, "scored": scored}),
        }
    )


def thorough(config: DetectorConfig) -> DetectorConfig:
    """Options of the second pass: fainter ridges, and more and more patient search among more of them."""
    second = config.second_pass
    ridges = config.ridges.model_copy(update={"threshold": min(config.ridges.threshold, second.threshold)})
    drawn = config.hypotheses
    hypotheses = drawn.model_copy(
        update={
            "draws": second.effort * drawn.draws,
            "scored": second.effort * drawn.scored,
            "kept": second.effort * drawn.kept,
        }
    )
    candidates = second.effort * config.candidates
    return config.model_copy(
        update={"ridges": ridges, "hypotheses": hypotheses, "candidates": candidates, "near_points": True}
    )


def flat(config: DetectorConfig) -> DetectorConfig:
    """Options of the last pass: more pixels, and flatter ellipses."""
    second = thorough(config)
    lowest = min(config.second_pass.flattest, config.hypotheses.axis_ratio[0])
    hypotheses = second.hypotheses.model_copy(update={"axis_ratio": (lowest, config.hypotheses.axis_ratio[1])})
    width = max(config.second_pass.flat_width_px, config.detection_width_px)
    return second.model_copy(update={"hypotheses": hypotheses, "detection_width_px": width, "near_points": False})


def detect(
    image_bgr: NDArray[np.uint8],
    config: DetectorConfig,
    rng: np.random.Generator,
    brightness: NDArray[np.uint8] | None = None,
    excluded: tuple[Assignment, ...] = (),
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
    excluded : tuple of Assignment
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
    watch = _Stopwatch()
    full_grey = brightness_of(image_bgr) if brightness is None else brightness
    watch.lap("scale")
    region = find_field_region(image_bgr, config.field_region)
    watch.lap("field")
    search = _searched(_Frame(image_bgr, full_grey), region, config, rng, watch, excluded)
    ridges, runs, segments, found = search.ridges, search.runs, search.segments, search.found
    kept = _straight_markings(image_bgr, segments, found.circle, found.hypothesis, config.one_paint)
    watch.lap("surfaces")
    halfway = None if found.halfway is None else LineSegment(*found.halfway.ends, support=found.halfway.support)
    detection = Detection(
        region=search.region,
        ridge_points=search.scaling.full(ridges.points),
        lines=tuple(LineSegment(segments[i, 0], segments[i, 1], runs[i].support) for i in kept),
        circle=found.hypothesis,
        candidates=found.candidates,
        halfway=halfway,
        sketch=MarkingSketch(full_grey, found.circle, found.halfway, segments[kept], search.sign, config),
        refusal=found.refusal,
        timings_ms=watch.timings_ms,
        certain=found.certain,
        polarity=search.sign,
        arcs=found.arcs,
    )
    watch.lap("result")
    return detection


def _searched(
    frame: _Frame,
    region: FieldRegion,
    config: DetectorConfig,
    rng: np.random.Generator,
    watch: _Stopwatch,
    excluded: tuple[Assignment, ...],
) -> _Search:
    """The first search that finds a circle beyond doubt with its halfway line, quick ones before slow ones; failing
    that, the best.

    A circle without that line may be one of several on the same floor, a face-off circle say.
    """
    options = [config.model_copy(update={"marking": marking}) for marking in _BRIGHTNESSES[config.marking]]
    passes = [(quick(option), 0.0, region) for option in options]
    searches: list[_Search] = []
    for option, margin, surface in passes:
        search = _search(frame, surface, option, rng, watch, margin, excluded)
        if search.found.refusal == _NO_FIELD or search.found.settled:
            return search
        searches.append(search)
        if config.thorough and len(searches) == len(options):
            # the stands, or the track before the field, may fill more of the picture
            other = find_field_region(frame.image_bgr, config.field_region, region)
            watch.lap("field")
            enough = other.area_share >= config.field_region.area_share
            passes += [(quick(option), 0.0, other) for option in options if enough]
            passes += [
                (thorough(option), _MARGIN, s) for s in (region, *((other,) if enough else ())) for option in options
            ]
    if config.thorough and not any(search.found.circle is not None for search in searches):
        # a circle that is seen very flat has too few rows in the smaller picture
        surfaces = {id(surface): surface for _, _, surface in passes}.values()
        for option, surface in ((option, surface) for option in options for surface in surfaces):
            search = _search(frame, surface, flat(option), rng, watch, _MARGIN, excluded)
            if search.found.settled:
                return search
            searches += [search] if search.found.circle is not None else []
    best = max(searches, key=_rank)
    arcs = [arc for search in searches if search.sign == best.sign for arc in search.found.arcs]
    apart_px, gapless = SAME_ARC * frame.grey.shape[1], config.likely.gapless_share
    distinct = distinct_arcs(arcs, best.found.hypothesis, apart_px, gapless)
    return replace(best, found=replace(best.found, arcs=distinct))


def _search(
    frame: _Frame,
    region: FieldRegion,
    config: DetectorConfig,
    rng: np.random.Generator,
    watch: _Stopwatch,
    margin: float,
    excluded: tuple[Assignment, ...],
) -> _Search:
    """One pass: ridges, straight runs, and the circle where there is a field.

    The field is taken with a margin (in picture widths).
    """
    grey, scaling = _detection_picture(frame.grey, config)
    rows, columns = grey.shape
    hull = region.hull_at(columns, rows)
    if margin:
        hull = _grown(hull, margin)
    watch.lap("scale")
    sign = _SIGNS[config.marking]
    ridges = find_ridges(grey, hull, (sign,), config.ridges)
    watch.lap("ridges")
    runs = find_straight_runs(ridges, (columns, rows), _SHORTEST_RUN * columns, config.lines)
    watch.lap("lines")
    segments = _segments(runs, scaling)
    if region.area_share < config.field_region.area_share:
        found = _Found(None, None, None, (), _NO_FIELD)
    else:
        found = _find_circle(frame, hull, ridges, runs, segments, scaling, config, rng, watch, excluded)
    return _Search(region, ridges, runs, segments, found, scaling, sign)


def _rank(search: _Search) -> tuple[bool, bool, bool, float, int]:
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


def _grown(hull: NDArray[np.uint8], margin: float) -> NDArray[np.uint8]:
    """The field with a margin: markings at its edge belong to it."""
    side = 2 * max(1, round(margin * hull.shape[1])) + 1
    return np.asarray(cv2.dilate(hull, np.ones((side, side), np.uint8)), np.uint8)


def _detection_picture(grey: NDArray[np.uint8], config: DetectorConfig) -> tuple[NDArray[np.uint8], _Scaling]:
    """Grey picture reduced (or enlarged) to the width of the search, and the way back."""
    height, width = grey.shape
    wanted = max(min(width, config.detection_width_px), config.enlarged_width_px)
    if width == wanted:
        return grey, _Scaling(np.ones(2))
    size = (wanted, max(1, round(height * wanted / width)))
    # area averaging is slow for factors other than two; below two, linear interpolation loses nothing
    while grey.shape[1] >= 2 * wanted:
        half = (grey.shape[1] // 2, max(1, grey.shape[0] // 2))
        grey = np.asarray(cv2.resize(grey, half, interpolation=cv2.INTER_AREA), np.uint8)
    reduced = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR), np.uint8)
    return reduced, _Scaling(np.array([width / size[0], height / size[1]]))


def _segments(runs: list[StraightRun], scaling: _Scaling) -> Array:
    """Ends (K, 2, 2) of the runs in pixels of the full picture."""
    ends = np.array([[run.start, run.end] for run in runs]).reshape(-1, 2, 2)
    return scaling.full(ends)


def _find_circle(
    frame: _Frame,
    hull: NDArray[np.uint8],
    ridges: RidgePoints,
    runs: list[StraightRun],
    segments: Array,
    scaling: _Scaling,
    config: DetectorConfig,
    rng: np.random.Generator,
    watch: _Stopwatch,
    excluded: tuple[Assignment, ...],
) -> _Found:
    rows, columns = hull.shape
    usable = np.ones(len(ridges), np.bool_)
    for run in runs:
        if run.length >= config.lines.minimum_length * columns:
            usable[run.members] = False
    batch = draw_ellipses(ridges, usable, (columns, rows), config.hypotheses, rng)
    watch.lap("hypotheses")
    if len(batch) == 0:
        return _Found(None, None, None, (), "no_circle_found")
    raster = RidgeRaster(ridges, hull)
    batch = best_distinct(batch, raster, config.hypotheses.kept)
    watch.lap("scoring")
    unit = columns / 1280.0
    batch = refitted(batch, raster, tuple(max(1.2, reach * unit) for reach in (5.0, 2.0)))
    batch = ranked(batch, raster)
    watch.lap("refit")
    found = _first_accepted(frame, batch, raster, segments, scaling, config, watch, excluded)
    if found.circle is not None or not config.near_points:
        return found
    on_arcs = near_conics(
        scaling.full(ridges.points), [arc.conic for arc in found.arcs], SAME_ARC * frame.grey.shape[1]
    )
    left = np.flatnonzero(usable & ~on_arcs)
    drawn = config.hypotheses.model_copy(update={"draws": config.hypotheses.draws // config.second_pass.effort})
    batch = draw_ellipses(ridges, usable & ~on_arcs, (columns, rows), drawn, rng, near=True)
    watch.lap("hypotheses")
    if len(batch) == 0:
        return found
    others = RidgeRaster(RidgePoints(ridges.points[left], ridges.normals[left], ridges.chain[left]), hull)
    batch = best_distinct(batch, others, config.hypotheses.kept // config.second_pass.effort)
    watch.lap("scoring")
    batch = ranked(refitted(batch, others, tuple(max(1.2, reach * unit) for reach in (5.0, 2.0))), others)
    watch.lap("refit")
    again = _first_accepted(frame, batch, raster, segments, scaling, config, watch, excluded)
    arcs = (*found.arcs, *again.arcs)
    return replace(again if again.circle is not None else found, arcs=arcs)


def _first_accepted(
    frame: _Frame,
    batch: EllipseBatch,
    raster: RidgeRaster,
    segments: Array,
    scaling: _Scaling,
    config: DetectorConfig,
    watch: _Stopwatch,
    excluded: tuple[Assignment, ...],
) -> _Found:
    """Measure the candidates in order until one is accepted with its halfway line; failing that, the first accepted
    without it, or the best likely one.
    """
    width = frame.grey.shape[1]
    candidates: list[CircleHypothesis] = []
    refusals: list[str] = []
    lone: tuple[MeasuredCircle, CircleHypothesis] | None = None
    likely: list[tuple[MeasuredCircle, CircleHypothesis, MeasuredLine]] = []
    arcs: list[CircleHypothesis] = []
    shorter: Array | None = None
    least = _SHORTEST_HALFWAY * raster.width
    for index in range(min(len(batch), config.candidates + len(excluded))):
        start = scaling.full_ellipses(batch.take(np.array([index])))
        circle = measure_circle(frame.grey, start, (_SIGNS[config.marking],), config.refinement)
        circle = onto_flat_sides(frame.grey, circle, segments, config.refinement)
        alike = assigned_alike(excluded, circle.ellipse)
        if any(assignment.halfway is None for assignment in alike):
            continue
        field_share = float(support_of(scaling.detection_ellipses(circle.ellipse), raster).field[0])
        hypothesis = hypothesis_of(circle, field_share, width)
        watch.lap("refine")
        refusal = refusal_of(hypothesis, True, width, config.acceptance)
        likely_one = likely_arc(hypothesis, width, config.acceptance, config.likely)
        if refusal == "circle_support_too_low" and not likely_one:
            share, sectors = painted_share(frame.grey, circle.ellipse, circle.sign)
            hypothesis = replace(hypothesis, painted_share=share if sectors >= _FEWEST_SECTORS else 0.0)
            likely_one = likely_arc(hypothesis, width, config.acceptance, config.likely)
            watch.lap("refine")
        if refusal is None or likely_one:
            halfway = _halfway_of(frame, circle, segments_left(segments, alike, width), config)
            if halfway is None and refusal is not None:
                if shorter is None:
                    runs = find_straight_runs(raster.ridges, (raster.width, raster.height), least, config.lines)
                    shorter = _segments(runs, scaling)
                halfway = _halfway_of(frame, circle, segments_left(shorter, alike, width), config)
            if halfway is None:
                ridges = raster.ridges
                pieces = segments_through_middle(scaling.full(ridges.points), ridges.normals, circle, config.halfway)
                halfway = _halfway_of(frame, circle, segments_left(pieces, alike, width), config)
            through = halfway is not None and not halfway.outside
            refusal = refusal_of(hypothesis, through, width, config.acceptance)
            watch.lap("halfway")
            if refusal is None and halfway is not None:
                return _Found(circle, hypothesis, halfway, (hypothesis, *candidates), None)
            if refusal is None and not alike:
                lone = lone or (circle, hypothesis)
            elif halfway is not None and drawn_on_both_sides(circle, halfway.line, config.likely.side_share):
                likely.append((circle, hypothesis, halfway))
            if halfway is None and likely_one and hypothesis.painted_share == 0.0:
                arcs.append(hypothesis)
        else:
            arc = drawn_arc(circle, hypothesis, width, config.likely)
            arcs += [] if arc is None else [arc]
        candidates.append(hypothesis)
        refusals.append(refusal or "")
    order = sorted(range(len(candidates)), key=lambda i: -candidates[i].score)
    ranked = tuple(candidates[i] for i in order)
    if lone is not None:
        return _Found(*lone, None, ranked, None, arcs=tuple(arcs))
    if likely:
        circle, hypothesis, halfway = max(likely, key=lambda found: found[1].score)
        return _Found(circle, hypothesis, halfway, ranked, None, certain=False, arcs=tuple(arcs))
    refusal = refusals[order[0]] if order else "no_circle_found"
    return _Found(None, None, None, ranked, refusal, arcs=tuple(arcs))


def _halfway_of(frame: _Frame, circle: MeasuredCircle, segments: Array, config: DetectorConfig) -> MeasuredLine | None:
    """The line through the circle's middle, if it is in the circle's paint."""
    line = find_halfway(frame.grey, circle, segments, config)
    if line is None or not config.one_paint:
        return line
    on = line.band.supported
    points = line.points[on] + line.band.offset[on, None] * line.normals[on]
    colours = paint_colour(frame.image_bgr, points, line.normals[on]), _colour_of(frame.image_bgr, circle)
    return line if alike_paint(*colours) else None


def _colour_of(image_bgr: NDArray[np.uint8], circle: MeasuredCircle) -> Array:
    return paint_colour(image_bgr, circle.marking_points, circle.normals[circle.band.supported])


def _straight_markings(
    image_bgr: NDArray[np.uint8],
    segments: Array,
    circle: MeasuredCircle | None,
    hypothesis: CircleHypothesis | None,
    one_paint: bool,
) -> NDArray[np.int64]:
    """Indices of the segments (K, 2, 2) that are painted on one surface, with the circle's paint, and no part of it."""
    straight = painted_on_one_surface(image_bgr, segments)
    if circle is not None and hypothesis is not None:
        straight &= ~_lie_on_circle(segments, hypothesis.conic, image_bgr.shape[1])
        if one_paint:
            straight &= painted_alike(image_bgr, segments, _colour_of(image_bgr, circle))
    return np.flatnonzero(straight)


def _lie_on_circle(segments: Array, conic: Array, width: int) -> NDArray[np.bool_]:
    """Which segments (K, 2, 2) are flat parts of the circle."""
    share = np.linspace(0.0, 1.0, 9)[:, None]
    points = segments[:, None, 0] + share * (segments[:, None, 1] - segments[:, None, 0])
    distance = np.abs(sampson_distance(conic, points.reshape(-1, 2))).reshape(-1, 9)
    return np.asarray(np.sort(distance, axis=1)[:, 4] < 4.0 * width / 1920.0, np.bool_)
