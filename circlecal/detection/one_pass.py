"""One pass over the picture: ridges, straight markings, ellipses, the circle; and the passes that there are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.arcs import SAME_ARC, lie_near_conics
from circlecal.detection.candidates import Candidates, Choice
from circlecal.detection.ellipse_search import EllipseSearch, search_ellipses
from circlecal.detection.field_region import FieldRegion
from circlecal.detection.lines import StraightRun, find_straight_runs
from circlecal.detection.options import DetectorConfig, RidgeConfig
from circlecal.detection.picture import Picture, Scaling, reduce_picture
from circlecal.detection.ridges import RidgePoints, RidgeRaster, find_ridges
from circlecal.geometry.projective import Array
from circlecal.results import Interpretation

__all__ = ["NO_FIELD", "Pass", "PassResult", "first_pass", "flat_pass", "run_pass", "second_pass"]

NO_FIELD = "no_field"
SHORTEST_RUN = 0.10
"""Picture widths: shorter straight runs are not reported."""
SHORTEST_LINE = 0.16
"""Picture widths: points on longer runs are not drawn for ellipses. The near and far side of a large circle are
straight for up to 0.15; without taking lines out, 73 of 84 runs of a study on 42 broadcast frames found the circle,
with it 82.
"""
SCORED, KEPT, MEASURED = 1500, 6, 3
"""Plausible ellipses that are scored, distinct best ones that are fitted again, and most of them that are measured.
Only the best one fitted again, 81 of the 84 runs found the circle, all six 82.
"""
FIRST_WIDTH_PX, FIRST_EFFORT = 960, 0.25
"""Of the first pass: largest width of its picture (does not scale), and share of the ellipses that it draws and scores,
which find the same circles. 720 px found them sooner, but fewer other lines."""
SECOND_EFFORT = 3
"""How many times as many ellipses the second pass draws, scores, keeps and measures."""
SECOND_THRESHOLD = 2.8
"""Ridge threshold of the second pass, in medians of the response, for paint too faint for the first. At 2.5 a single
pass found the circle in 69 of the 84 runs, where streaks hid it, at 4 in 82; from 7 on faded lines are lost.
"""
SECOND_MARGIN = 0.012
"""Picture widths by which the second pass looks beyond the field: markings at its edge belong to it."""
FLAT_WIDTH_PX, FLATTEST = 1440, 0.03
"""Of the last pass: width of its picture (does not scale), and smallest ratio of the axes: a circle that is seen very
flat has too few rows in a smaller picture.
"""


@dataclass(frozen=True, slots=True)
class Pass:
    """How a picture is searched once.

    Attributes
    ----------
    sign : float
        +1 where markings are lighter than the surface, -1 where they are darker.
    width_px : int
        Largest width of the picture that is searched.
    ridges : RidgeConfig
        How ridge points are found.
    ellipses : EllipseSearch
        How many ellipses are drawn, and of which shapes.
    measured : int
        Most ellipses that are measured in the full picture.
    margin : float
        How far beyond the field the search goes, in picture widths.
    is_near_tried : bool
        Whether ellipses through points near each other are drawn too, where no circle is found.
    is_last_resort : bool
        Whether it is run only where no other pass found a circle, and counts only where it finds one.
    """

    sign: float
    width_px: int
    ridges: RidgeConfig
    ellipses: EllipseSearch
    measured: int = MEASURED
    margin: float = 0.0
    is_near_tried: bool = False
    is_last_resort: bool = False


def first_pass(config: DetectorConfig, sign: float) -> Pass:
    """A quick pass, in which most circles are found: few ellipses."""
    shapes = config.hypotheses
    draws, scored = max(100, int(FIRST_EFFORT * shapes.draws)), int(FIRST_EFFORT * SCORED)
    ellipses = EllipseSearch(draws, scored, KEPT, shapes.half_axis, shapes.axis_ratio, shapes.tilt_deg)
    return Pass(sign, min(FIRST_WIDTH_PX, config.detection_width_px), config.ridges, ellipses)


def second_pass(config: DetectorConfig, sign: float) -> Pass:
    """A slow pass: fainter ridges, and many more ellipses."""
    shapes = config.hypotheses
    draws, scored, kept = (SECOND_EFFORT * count for count in (shapes.draws, SCORED, KEPT))
    return Pass(
        sign,
        config.detection_width_px,
        config.ridges.model_copy(update={"threshold": min(config.ridges.threshold, SECOND_THRESHOLD)}),
        EllipseSearch(draws, scored, kept, shapes.half_axis, shapes.axis_ratio, shapes.tilt_deg),
        SECOND_EFFORT * MEASURED,
        SECOND_MARGIN,
        is_near_tried=True,
    )


def flat_pass(config: DetectorConfig, sign: float) -> Pass:
    """A slow pass over more pixels, for flatter ellipses too."""
    second = second_pass(config, sign)
    lowest, highest = second.ellipses.axis_ratio
    ellipses = replace(second.ellipses, axis_ratio=(min(FLATTEST, lowest), highest))
    width = max(FLAT_WIDTH_PX, config.detection_width_px)
    return replace(second, width_px=width, ellipses=ellipses, is_near_tried=False, is_last_resort=True)


@dataclass(frozen=True, slots=True)
class PassResult:
    """What one pass took for the field, saw and chose; ``segments`` (K, 2, 2) are the ends of ``runs`` in pixels of the
    full picture.
    """

    region: FieldRegion
    ridges: RidgePoints
    runs: list[StraightRun]
    segments: Array
    choice: Choice
    scaling: Scaling
    sign: float


def run_pass(
    picture: Picture,
    region: FieldRegion,
    config: DetectorConfig,
    settings: Pass,
    rng: np.random.Generator,
    ruled_out: tuple[Interpretation, ...],
) -> PassResult:
    """Find ridges and straight runs, and the circle where there is a field."""
    gray, scaling = reduce_picture(picture.gray, settings.width_px, config.enlarged_width_px)
    rows, columns = gray.shape
    hull = region.hull_at(columns, rows)
    if settings.margin:
        side = 2 * max(1, round(settings.margin * columns)) + 1
        hull = np.asarray(cv2.dilate(hull, np.ones((side, side), np.uint8)), np.uint8)
    ridges = find_ridges(gray, hull, settings.sign, settings.ridges)
    runs = find_straight_runs(ridges, (columns, rows), SHORTEST_RUN * columns)
    segments = scaling.full_segments(runs)
    result = PassResult(region, ridges, runs, segments, Choice(refusal=NO_FIELD), scaling, settings.sign)
    if region.area_share < config.field_region.area_share:
        return result
    return replace(result, choice=_find_circle(picture, result, hull, config, settings, rng, ruled_out))


def _find_circle(
    picture: Picture,
    result: PassResult,
    hull: NDArray[np.uint8],
    config: DetectorConfig,
    settings: Pass,
    rng: np.random.Generator,
    ruled_out: tuple[Interpretation, ...],
) -> Choice:
    """The circle among ellipses through all ridges that are not straight; then among those beside the arcs found."""
    ridges, scaling = result.ridges, result.scaling
    usable = np.ones(len(ridges), np.bool_)
    for run in result.runs:
        if run.length >= SHORTEST_LINE * hull.shape[1]:
            usable[run.members] = False
    raster = RidgeRaster(ridges, hull)
    batch = search_ellipses(ridges, usable, raster, settings.ellipses, rng)
    if len(batch) == 0:
        return Choice()
    candidates = Candidates(picture, raster, result.segments, scaling, settings.sign, config, ruled_out)
    choice = candidates.choose(batch, settings.measured)
    if choice.circle is not None or not settings.is_near_tried:
        return choice
    arcs = [arc.conic for arc in choice.arcs]
    left = usable & ~lie_near_conics(scaling.full(ridges.points), arcs, SAME_ARC * picture.gray.shape[1])
    others = RidgeRaster(RidgePoints(ridges.points[left], ridges.normals[left], ridges.chain[left]), hull)
    usual = settings.ellipses
    fewer = replace(usual, draws=usual.draws // SECOND_EFFORT, kept=usual.kept // SECOND_EFFORT)
    batch = search_ellipses(ridges, left, others, fewer, rng, near=True)
    if len(batch) == 0:
        return choice
    again = candidates.choose(batch, settings.measured)
    return replace(again if again.circle is not None else choice, arcs=(*choice.arcs, *again.arcs))
