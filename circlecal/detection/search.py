"""One pass over the picture: ridges, straight markings, ellipses, the circle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.arcs import SAME_ARC, near_conics
from circlecal.detection.candidates import Candidates, Found
from circlecal.detection.field_region import FieldRegion
from circlecal.detection.hypotheses import EllipseBatch, draw_ellipses
from circlecal.detection.lines import StraightRun, find_straight_runs
from circlecal.detection.options import DetectorConfig, HypothesisConfig
from circlecal.detection.picture import Picture, Scaling, detection_picture
from circlecal.detection.ridges import RidgePoints, find_ridges
from circlecal.detection.scoring import RidgeRaster, best_distinct, ranked, refitted
from circlecal.geometry.projective import Array
from circlecal.results import Interpretation

__all__ = ["NO_FIELD", "Search", "search_once"]

NO_FIELD = "no_field"
_SHORTEST_RUN = 0.10  # picture widths: shorter straight runs are not reported


@dataclass(frozen=True, slots=True)
class Search:
    """One pass over the picture: what it took for the field, what it saw and what it found."""

    region: FieldRegion
    ridges: RidgePoints
    runs: list[StraightRun]
    segments: Array
    found: Found
    scaling: Scaling
    sign: float


def search_once(
    picture: Picture,
    region: FieldRegion,
    config: DetectorConfig,
    rng: np.random.Generator,
    ruled_out: tuple[Interpretation, ...],
    margin: float = 0.0,
) -> Search:
    """One pass: ridges, straight runs, and the circle where there is a field.

    The field is taken with a margin (in picture widths).
    """
    grey, scaling = detection_picture(picture.gray, config)
    rows, columns = grey.shape
    hull = region.hull_at(columns, rows)
    if margin:
        hull = _grown(hull, margin)
    ridges = find_ridges(grey, hull, config.sign, config.ridges)
    runs = find_straight_runs(ridges, (columns, rows), _SHORTEST_RUN * columns, config.lines)
    segments = scaling.full_segments(runs)
    search = Search(region, ridges, runs, segments, Found(None, None, None, (), NO_FIELD), scaling, config.sign)
    if region.area_share < config.field_region.area_share:
        return search
    return replace(search, found=_find_circle(picture, search, hull, config, rng, ruled_out))


def _grown(hull: NDArray[np.uint8], margin: float) -> NDArray[np.uint8]:
    """The field with a margin: markings at its edge belong to it."""
    side = 2 * max(1, round(margin * hull.shape[1])) + 1
    return np.asarray(cv2.dilate(hull, np.ones((side, side), np.uint8)), np.uint8)


def _find_circle(
    picture: Picture,
    search: Search,
    hull: NDArray[np.uint8],
    config: DetectorConfig,
    rng: np.random.Generator,
    ruled_out: tuple[Interpretation, ...],
) -> Found:
    """The circle among ellipses through all ridges that are not straight; then among those beside the arcs found."""
    ridges, scaling = search.ridges, search.scaling
    usable = np.ones(len(ridges), np.bool_)
    for run in search.runs:
        if run.length >= config.lines.minimum_length * hull.shape[1]:
            usable[run.members] = False
    raster = RidgeRaster(ridges, hull)
    batch = _best_ellipses(ridges, usable, raster, config.hypotheses, rng)
    if len(batch) == 0:
        return Found(None, None, None, (), "no_circle_found")
    candidates = Candidates(picture, raster, search.segments, scaling, config, ruled_out)
    found = candidates.first_accepted(batch)
    if found.circle is not None or not config.near_points:
        return found
    on_arcs = near_conics(
        scaling.full(ridges.points), [arc.conic for arc in found.arcs], SAME_ARC * picture.gray.shape[1]
    )
    left = usable & ~on_arcs
    fewer = {name: getattr(config.hypotheses, name) // config.second_pass.effort for name in ("draws", "kept")}
    others = RidgeRaster(RidgePoints(ridges.points[left], ridges.normals[left], ridges.chain[left]), hull)
    batch = _best_ellipses(ridges, left, others, config.hypotheses.model_copy(update=fewer), rng, near=True)
    if len(batch) == 0:
        return found
    again = candidates.first_accepted(batch)
    return replace(again if again.circle is not None else found, arcs=(*found.arcs, *again.arcs))


def _best_ellipses(
    ridges: RidgePoints,
    usable: NDArray[np.bool_],
    raster: RidgeRaster,
    hypotheses: HypothesisConfig,
    rng: np.random.Generator,
    near: bool = False,
) -> EllipseBatch:
    """Draw ellipses through usable ridges, and fit the best distinct ones to those of ``raster``."""
    batch = draw_ellipses(ridges, usable, (raster.width, raster.height), hypotheses, rng, near=near)
    if len(batch) == 0:
        return batch
    batch = best_distinct(batch, raster, hypotheses.kept)
    unit = raster.width / 1280.0
    batch = ranked(refitted(batch, raster, tuple(max(1.2, reach * unit) for reach in (5.0, 2.0))), raster)
    return batch
