"""Measuring the ellipses of one pass, and which of them is the circle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from circlecal.detection.arcs import drawn_arc
from circlecal.detection.circle import (
    CircleHypothesis,
    MeasuredCircle,
    drawn_on_both_sides,
    hypothesis_of,
    likely_arc,
    measure_circle,
    refusal_of,
)
from circlecal.detection.flat_sides import onto_flat_sides
from circlecal.detection.halfway import MeasuredLine, find_halfway, segments_through_middle
from circlecal.detection.hypotheses import EllipseBatch
from circlecal.detection.lines import find_straight_runs
from circlecal.detection.options import DetectorConfig
from circlecal.detection.picture import Picture, Scaling
from circlecal.detection.ruled_out import interpretations_of, segments_left, segments_off
from circlecal.detection.scoring import RidgeRaster, support_of
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array
from circlecal.paint.colour import match_paint, measure_paint_colour
from circlecal.paint.matched_filter import measure_painted_share
from circlecal.results import Interpretation

__all__ = ["Candidates", "Found"]

_FEWEST_SECTORS = 8  # of a circle: fewer do not tell how much of it is painted
_MOST_LINES = 3  # through a circle's middle that are looked at for its halfway line, in one paint with it
_SHORTEST_HALFWAY = 0.04  # picture widths: of a piece of the halfway line of a circle that has no longer one


@dataclass(frozen=True, slots=True)
class Found:
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
class _Candidate:
    """A measured ellipse: what speaks against it as the circle, its halfway line, and itself where it may be an arc."""

    circle: MeasuredCircle
    hypothesis: CircleHypothesis
    refusal: str | None
    halfway: MeasuredLine | None = None
    arc: CircleHypothesis | None = None
    tried: bool = False  # with another halfway line, which turned out wrong


class Candidates:
    """The ellipses of one pass, measured in the full picture.

    Parameters
    ----------
    picture : Picture
    raster : RidgeRaster
        Of the pass.
    segments : (K, 2, 2) array
        Straight markings, px of the full picture.
    scaling : Scaling
    config : DetectorConfig
    ruled_out : tuple of Interpretation
        What turned out wrong.
    """

    def __init__(
        self,
        picture: Picture,
        raster: RidgeRaster,
        segments: Array,
        scaling: Scaling,
        config: DetectorConfig,
        ruled_out: tuple[Interpretation, ...],
    ) -> None:
        self._picture, self._raster, self._segments, self._scaling = picture, raster, segments, scaling
        self._config, self._ruled_out = config, ruled_out
        self._width = picture.gray.shape[1]
        self._shorter: Array | None = None

    def first_accepted(self, batch: EllipseBatch) -> Found:
        """Measure the ellipses in order until one is accepted with its halfway line; failing that, the first accepted
        without it, or the best likely one.
        """
        measured: list[_Candidate] = []
        for index in range(min(len(batch), self._config.candidates + len(self._ruled_out))):
            found = self._measured(self._scaling.full_ellipses(batch.take(np.array([index]))))
            if found is None:
                continue
            if found.refusal is None and found.halfway is not None:
                others = tuple(other.hypothesis for other in measured)
                return Found(found.circle, found.hypothesis, found.halfway, (found.hypothesis, *others), None)
            measured.append(found)
        arcs = tuple(found.arc for found in measured if found.arc is not None)
        best_first = sorted(measured, key=lambda found: -found.hypothesis.score)
        ranked = tuple(found.hypothesis for found in best_first)
        for lone in measured:
            if lone.refusal is None and not lone.tried:
                return Found(lone.circle, lone.hypothesis, None, ranked, None, arcs=arcs)
        for likely in best_first:
            if likely.halfway is not None:
                return Found(likely.circle, likely.hypothesis, likely.halfway, ranked, None, certain=False, arcs=arcs)
        refusal = (best_first[0].refusal or "") if best_first else "no_circle_found"
        return Found(None, None, None, ranked, refusal, arcs=arcs)

    def _measured(self, start: EllipseBatch) -> _Candidate | None:
        """The one ellipse of the batch; None where it is ruled out with any halfway line."""
        config, width = self._config, self._width
        circle = measure_circle(self._picture.gray, start, config.sign, config.refinement)
        circle = onto_flat_sides(self._picture.gray, circle, self._segments, config.refinement)
        alike = interpretations_of(self._ruled_out, circle.ellipse)
        if any(interpretation.line is None for interpretation in alike):
            return None
        inside = support_of(self._scaling.detection_ellipses(circle.ellipse), self._raster).field[0]
        hypothesis = hypothesis_of(circle, float(inside), width)
        refusal = refusal_of(hypothesis, True, width, config.acceptance)
        likely = likely_arc(hypothesis, width, config.acceptance, config.likely)
        if refusal == "circle_support_too_low" and not likely:
            share, sectors = measure_painted_share(
                self._picture.gray, ellipse_from_conic(hypothesis.conic), circle.sign
            )
            hypothesis = replace(hypothesis, painted_share=share if sectors >= _FEWEST_SECTORS else 0.0)
            likely = likely_arc(hypothesis, width, config.acceptance, config.likely)
        if refusal is not None and not likely:
            return _Candidate(circle, hypothesis, refusal, arc=drawn_arc(circle, hypothesis, width, config.likely))
        halfway = self._halfway(circle, alike, thorough=refusal is not None)
        through = halfway is not None and not halfway.outside
        refusal = refusal_of(hypothesis, through, width, config.acceptance)
        arc = hypothesis if halfway is None and likely and hypothesis.painted_share == 0.0 else None
        if refusal is not None and halfway is not None:
            both_sides = drawn_on_both_sides(circle, halfway.line, config.likely.side_share)
            halfway = halfway if both_sides else None
        return _Candidate(circle, hypothesis, refusal, halfway, arc, tried=bool(alike))

    def _halfway(
        self, circle: MeasuredCircle, alike: tuple[Interpretation, ...], *, thorough: bool
    ) -> MeasuredLine | None:
        """The line through the circle's middle, among the long straight markings, the short ones (``thorough``), and
        the ridge points that head there.
        """
        halfway = self._in_paint(circle, segments_left(self._segments, alike, self._width))
        if halfway is None and thorough:
            halfway = self._in_paint(circle, segments_left(self._shorter_segments(), alike, self._width))
        if halfway is None:
            ridges = self._raster.ridges
            points = self._scaling.full(ridges.points)
            pieces = segments_through_middle(points, ridges.normals, circle, self._config.halfway)
            halfway = self._in_paint(circle, segments_left(pieces, alike, self._width))
        return halfway

    def _shorter_segments(self) -> Array:
        if self._shorter is None:
            size = (self._raster.width, self._raster.height)
            least = _SHORTEST_HALFWAY * self._raster.width
            runs = find_straight_runs(self._raster.ridges, size, least, self._config.lines)
            self._shorter = self._scaling.full_segments(runs)
        return self._shorter

    def _in_paint(self, circle: MeasuredCircle, segments: Array) -> MeasuredLine | None:
        """The first line through the circle's middle that is in the circle's paint."""
        for _ in range(_MOST_LINES):
            line = find_halfway(self._picture.gray, circle, segments, self._config)
            if line is None or not self._config.one_paint:
                return line
            colours = (
                measure_paint_colour(self._picture.image_bgr, curve.points, curve.normals, curve.band)
                for curve in (line, circle)
            )
            if match_paint(*colours):
                return line
            segments = segments_off(segments, line.line, self._width)
        return None
