"""One pass over the picture: ridges, straight markings, ellipses, the circle; and the passes that there are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from circlecal.detection.arcs import SAME_ARC, lie_near_conics
from circlecal.detection.candidates import Candidates, Choice
from circlecal.detection.ellipse_batch import EllipseBatch
from circlecal.detection.ellipse_search import EllipseSearch, search_ellipses
from circlecal.detection.field_region import FieldRegion, find_field_region, uncover
from circlecal.detection.lines import StraightRun, find_straight_runs
from circlecal.detection.options import DetectorConfig, RidgeConfig
from circlecal.detection.picture import Picture, Scaling, reduce_picture
from circlecal.detection.ridges import RidgePoints, RidgeRaster, find_ridges
from circlecal.geometry.projective import Array
from circlecal.results import Interpretation

__all__ = ["NO_FIELD", "Pass", "PassResult", "PictureSearch", "first_pass", "flat_pass", "second_pass"]

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


class PassSearch:
    """What one pass found, whatever may be ruled out: ridges, straight runs, and ellipses where there is a field."""

    def __init__(
        self,
        picture: Picture,
        region: FieldRegion,
        config: DetectorConfig,
        settings: Pass,
        rng: np.random.Generator,
    ) -> None:
        self.region, self.settings, self._rng = region, settings, rng
        gray, scaling = reduce_picture(picture.gray, settings.width_px, config.enlarged_width_px)
        rows, columns = gray.shape
        hull = region.hull_at(columns, rows)
        if settings.margin:
            side = 2 * max(1, round(settings.margin * columns)) + 1
            hull = np.asarray(cv2.dilate(hull, np.ones((side, side), np.uint8)), np.uint8)
        ridges = find_ridges(gray, hull, settings.sign, settings.ridges)
        runs = find_straight_runs(ridges, (columns, rows), SHORTEST_RUN * columns)
        segments = scaling.full_segments(runs)
        self._seen = PassResult(region, ridges, runs, segments, Choice(refusal=NO_FIELD), scaling, settings.sign)
        self._has_field = region.area_share >= config.field_region.area_share
        if not self._has_field:
            return
        self._hull, self._same_arc_px = hull, SAME_ARC * picture.gray.shape[1]
        self._usable = np.ones(len(ridges), np.bool_)
        for run in runs:
            if run.length >= SHORTEST_LINE * columns:
                self._usable[run.members] = False
        raster = RidgeRaster(ridges, hull)
        self._batch = search_ellipses(ridges, self._usable, raster, settings.ellipses, rng)
        self._beside: EllipseBatch | None = None
        self._candidates = Candidates(picture, raster, segments, scaling, settings.sign, config)

    def choose(self, ruled_out: tuple[Interpretation, ...] = ()) -> PassResult:
        """The pass with its circle among ellipses through all ridges that are not straight, or else among those beside
        the arcs found.
        """
        if not self._has_field:
            return self._seen
        if len(self._batch) == 0:
            return replace(self._seen, choice=Choice())
        most = self.settings.measured
        choice = self._candidates.choose(self._batch, most, ruled_out)
        if choice.circle is not None or not self.settings.is_near_tried:
            return replace(self._seen, choice=choice)
        if self._beside is None:
            self._beside = self._search_beside(choice)
        if len(self._beside) == 0:
            return replace(self._seen, choice=choice)
        again = self._candidates.choose(self._beside, most, ruled_out)
        arcs = (*choice.arcs, *again.arcs)
        return replace(self._seen, choice=replace(again if again.circle is not None else choice, arcs=arcs))

    def _search_beside(self, choice: Choice) -> EllipseBatch:
        """Ellipses through points near each other that belong to none of the arcs found."""
        ridges, usual = self._seen.ridges, self.settings.ellipses
        arcs = [arc.conic for arc in choice.arcs]
        left = self._usable & ~lie_near_conics(self._seen.scaling.full(ridges.points), arcs, self._same_arc_px)
        others = RidgeRaster(RidgePoints(ridges.points[left], ridges.normals[left], ridges.chain[left]), self._hull)
        fewer = replace(usual, draws=usual.draws // SECOND_EFFORT, kept=usual.kept // SECOND_EFFORT)
        return search_ellipses(ridges, left, others, fewer, self._rng, near=True)


@dataclass(frozen=True, slots=True)
class PictureSearch:
    """A picture with the surfaces and all that passes found in it, which further interpretations of it share."""

    picture: Picture
    regions: list[FieldRegion] = field(default_factory=list)
    passes: list[PassSearch] = field(default_factory=list)

    def find_region(self, number: int, config: DetectorConfig) -> FieldRegion:
        """The largest surface (0), or the largest beside it (1)."""
        while len(self.regions) <= number:
            found = find_field_region(self.picture.image_bgr, config.field_region, *self.regions[:1])
            self.regions.append(uncover(found, self.picture.covered))
        return self.regions[number]

    def run_pass(
        self,
        region: FieldRegion,
        config: DetectorConfig,
        settings: Pass,
        rng: np.random.Generator,
        ruled_out: tuple[Interpretation, ...] = (),
    ) -> PassResult:
        """Find ridges and straight runs, and the circle where there is a field; what is known already is not looked for
        again.
        """
        known = (found for found in self.passes if found.region is region and found.settings == settings)
        search = next(known, None)
        if search is None:
            search = PassSearch(self.picture, region, config, settings, rng)
            self.passes.append(search)
        return search.choose(ruled_out)
