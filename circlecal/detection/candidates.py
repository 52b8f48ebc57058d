"""Measuring the ellipses of one pass, and which of them is the circle: not one that turned out wrong before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from circlecal.detection.arcs import find_longest_arc, move_onto_straight_arcs
from circlecal.detection.circle import (
    LEAST_FIRST_SHARE,
    TENTATIVE_WHOLE_SHARE,
    CircleHypothesis,
    MeasuredCircle,
    check_circle,
    describe_circle,
    find_refusal,
    hide_samples,
    is_drawn_on_both_sides,
    is_tentative,
    may_be_faint,
    measure_circle,
)
from circlecal.detection.ellipse_batch import EllipseBatch
from circlecal.detection.ellipse_search import measure_support
from circlecal.detection.halfway import MeasuredLine, find_halfway, find_segments_through_middle
from circlecal.detection.lines import find_straight_runs
from circlecal.detection.options import DetectorConfig
from circlecal.detection.picture import Picture, Scaling
from circlecal.detection.ridges import RidgeRaster
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, join, lift, normalise_line
from circlecal.paint.colour import match_paint, measure_paint_colour
from circlecal.paint.matched_filter import measure_painted_share
from circlecal.refusals import Confidence
from circlecal.results import Interpretation

__all__ = ["Candidates", "Choice", "drop_ruled_out_segments", "drop_segments_on", "find_interpretations_of"]

FEWEST_SECTORS = 8
"""Of a circle: fewer do not tell how much of it is painted."""
MOST_LINES = 3
"""Through a circle's middle that are looked at for its halfway line, in one paint with it."""
LEAST_WHITE = 0.2
"""Of what paint adds to blue, green and red of grass, the least over the largest from which on it is white: 50 white
circles, a third of them real, have 0.37 to 0.99, a blue ring that was drawn into a rendered picture 0.08.
"""
SHORTEST_HALFWAY = 0.04
"""Picture widths: of a piece of the halfway line of a circle that has no longer one."""
SAME_CIRCLE = 0.05
"""Shares of the great half axis by which centres and axes of one circle may differ between two searches."""
ON_LINE_PX = 8.0
"""Pixels at 1920 px width within which a segment lies on a line."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The circle that was chosen with its line, or the reason why there is none.

    Attributes
    ----------
    circle, hypothesis : MeasuredCircle, CircleHypothesis, or None
        The circle, and what speaks for it.
    halfway : MeasuredLine or None
        The straight marking through its middle.
    candidates : tuple of CircleHypothesis
        What was measured, best first.
    refusal : str or None
        Why there is no circle.
    confidence : Confidence
        Whether the circle stands by itself or something else must confirm it; rejected where there is none.
    arcs : tuple of CircleHypothesis
        Parts of circles that may belong to arcs of the field, or to the circle.
    """

    circle: MeasuredCircle | None = None
    hypothesis: CircleHypothesis | None = None
    halfway: MeasuredLine | None = None
    candidates: tuple[CircleHypothesis, ...] = ()
    refusal: str | None = "no_circle_found"
    confidence: Confidence = Confidence.REJECTED
    arcs: tuple[CircleHypothesis, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Whether the circle stands by itself and has its halfway line."""
        return self.confidence is Confidence.ACCEPTED and self.halfway is not None


@dataclass(frozen=True, slots=True)
class _Measured:
    """A measured ellipse before its halfway line is looked for: what speaks against it with one, and whether something
    else may confirm it.
    """

    circle: MeasuredCircle
    hypothesis: CircleHypothesis
    refusal: str | None
    is_tentative: bool


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A measured ellipse: what speaks against it as the circle, its halfway line, and itself where it may be an arc."""

    circle: MeasuredCircle
    hypothesis: CircleHypothesis
    refusal: str | None
    halfway: MeasuredLine | None = None
    arc: CircleHypothesis | None = None
    is_ruled_out: bool = False  # with another halfway line

    def choice(
        self,
        confidence: Confidence,
        candidates: tuple[CircleHypothesis, ...],
        arcs: tuple[CircleHypothesis, ...] = (),
    ) -> Choice:
        """The detector's answer with this hypothesis as the circle."""
        return Choice(self.circle, self.hypothesis, self.halfway, candidates, None, confidence, arcs)


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
    sign : float
        +1 where markings are lighter than the surface, -1 where they are darker.
    config : DetectorConfig
    """

    def __init__(
        self,
        picture: Picture,
        raster: RidgeRaster,
        segments: Array,
        scaling: Scaling,
        sign: float,
        config: DetectorConfig,
    ) -> None:
        self._picture, self._raster, self._segments, self._scaling = picture, raster, segments, scaling
        self._sign, self._config = sign, config
        self._width = picture.gray.shape[1]
        self._shorter: Array | None = None
        # what does not depend on what is ruled out is measured once
        self._measured: dict[bytes, _Measured] = {}
        self._usual: dict[bytes, _Candidate] = {}

    def choose(self, batch: EllipseBatch, most: int, ruled_out: tuple[Interpretation, ...] = ()) -> Choice:
        """Measure the ellipses in order until one is accepted with its halfway line; failing that, take the first that
        is accepted without it, or the best one that something else may confirm.

        Parameters
        ----------
        batch : EllipseBatch
            Best first, in pixels of the picture that was searched.
        most : int
            Most of them that are measured, beside those that are ruled out.
        ruled_out : tuple of Interpretation
            What turned out wrong.
        """
        measured: list[_Candidate] = []
        for index in range(min(len(batch), most + len(ruled_out))):
            found = self._weigh(self._scaling.full_ellipses(batch.take(np.array([index]))), ruled_out)
            if found is None:
                continue
            if found.refusal is None and found.halfway is not None:
                others = tuple(other.hypothesis for other in measured)
                return found.choice(Confidence.ACCEPTED, (found.hypothesis, *others))
            measured.append(found)
        arcs = tuple(found.arc for found in measured if found.arc is not None)
        best_first = sorted(measured, key=lambda found: -found.hypothesis.score)
        hypotheses = tuple(found.hypothesis for found in best_first)
        for lone in measured:
            if lone.refusal is None and not lone.is_ruled_out:
                return lone.choice(Confidence.ACCEPTED, hypotheses, arcs)
        for tentative in best_first:
            if tentative.halfway is not None:
                return tentative.choice(Confidence.TENTATIVE, hypotheses, arcs)
        # of the best ellipse less is drawn than of any circle that something else might confirm: there is none
        is_hopeless = not best_first or hypotheses[0].whole_share < TENTATIVE_WHOLE_SHARE
        refusal = "no_circle_found" if is_hopeless else best_first[0].refusal or ""
        return Choice(candidates=hypotheses, refusal=refusal, arcs=arcs)

    def _weigh(self, start: EllipseBatch, ruled_out: tuple[Interpretation, ...]) -> _Candidate | None:
        """The one ellipse of the batch; None where it is ruled out with any halfway line."""
        key = start.centers.tobytes() + start.great.tobytes() + start.small.tobytes()
        if key not in self._measured:
            self._measured[key] = self._measure(start)
        measured = self._measured[key]
        of_this = find_interpretations_of(ruled_out, measured.circle.ellipse)
        if any(interpretation.line is None for interpretation in of_this):
            return None
        if of_this:
            return self._add_halfway(measured, of_this)
        if key not in self._usual:
            self._usual[key] = self._add_halfway(measured, ())
        return self._usual[key]

    def _measure(self, start: EllipseBatch) -> _Measured:
        """The one ellipse of the batch, measured, and what speaks for it without a halfway line."""
        config, width, gray = self._config, self._width, self._picture.gray
        circle = measure_circle(gray, start, self._sign, config.refinement)
        if circle.seen_share >= LEAST_FIRST_SHARE:
            circle = move_onto_straight_arcs(gray, circle, self._segments, config.refinement)
        circle = hide_samples(circle, self._picture.covered)
        inside = measure_support(self._scaling.detection_ellipses(circle.ellipse), self._raster).field[0]
        hypothesis = describe_circle(circle, float(inside), width)
        hypothesis = replace(hypothesis, checks=check_circle(hypothesis, True, width, config.acceptance))
        refusal = find_refusal(hypothesis.checks)
        # faint paint is only looked for where it would change something
        if refusal == "circle_support_too_low" and may_be_faint(hypothesis, width, config.acceptance):
            share, sectors = measure_painted_share(gray, ellipse_from_conic(hypothesis.conic), circle.sign)
            hypothesis = replace(hypothesis, painted_share=share if sectors >= FEWEST_SECTORS else 0.0)
        tentative = is_tentative(hypothesis, width, config.acceptance)
        return _Measured(circle, hypothesis, refusal, tentative)

    def _add_halfway(self, measured: _Measured, ruled_out: tuple[Interpretation, ...]) -> _Candidate:
        """What was measured, with its halfway line, which is none of those that are ruled out with it."""
        circle, hypothesis, refusal = measured.circle, measured.hypothesis, measured.refusal
        config, width = self._config, self._width
        if refusal is not None and not measured.is_tentative:
            return _Candidate(circle, hypothesis, refusal, arc=find_longest_arc(circle, hypothesis, width))
        halfway = self._find_halfway(circle, ruled_out, thorough=refusal is not None)
        is_through = halfway is not None and not halfway.outside
        hypothesis = replace(hypothesis, checks=check_circle(hypothesis, is_through, width, config.acceptance))
        refusal = find_refusal(hypothesis.checks)
        is_alone = halfway is None and measured.is_tentative and hypothesis.painted_share == 0.0
        if refusal is not None and halfway is not None and not is_drawn_on_both_sides(circle, halfway.line):
            halfway = None
        return _Candidate(
            circle, hypothesis, refusal, halfway, hypothesis if is_alone else None, is_ruled_out=bool(ruled_out)
        )

    def _find_halfway(
        self, circle: MeasuredCircle, ruled_out: tuple[Interpretation, ...], *, thorough: bool
    ) -> MeasuredLine | None:
        """The line through the circle's middle, among the long straight markings, the short ones (``thorough``), and
        the ridge points that head there; in another paint than the circle's where none is in this one.
        """
        long, long_stranger = self._find_in_paint(circle, self._segments, ruled_out)
        if long is not None:
            return long
        if thorough:
            short, _ = self._find_in_paint(circle, self._shorter_segments(), ruled_out)
            if short is not None:
                return short
        points, normals = self._scaling.full(self._raster.ridges.points), self._raster.ridges.normals
        pieces = find_segments_through_middle(points, normals, circle, self._config.halfway.distance)
        piece, piece_stranger = self._find_in_paint(circle, pieces, ruled_out)
        if piece is not None:
            return piece
        stranger = long_stranger or piece_stranger
        return stranger if stranger is not None and self._config.shared_halfway and self._is_white(circle) else None

    def _is_white(self, circle: MeasuredCircle) -> bool:
        """Whether a circle's paint adds to all three colours of its surface, as a soccer field's does: only across
        white paint another sport's line may run along with the halfway line.
        """
        added = measure_paint_colour(self._picture.image_bgr, circle.curve)
        return float(added.min()) >= LEAST_WHITE * float(added.max())

    def _shorter_segments(self) -> Array:
        """All straight runs (K, 2, 2) that may be a piece of a halfway line, found when they are first asked for."""
        if self._shorter is None:
            size = (self._raster.width, self._raster.height)
            runs = find_straight_runs(self._raster.ridges, size, SHORTEST_HALFWAY * self._raster.width)
            self._shorter = self._scaling.full_segments(runs)
        return self._shorter

    def _find_in_paint(
        self, circle: MeasuredCircle, segments: Array, ruled_out: tuple[Interpretation, ...]
    ) -> tuple[MeasuredLine | None, MeasuredLine | None]:
        """The first line through the circle's middle that is in the circle's paint, and the first in any."""
        image, segments = self._picture.image_bgr, drop_ruled_out_segments(segments, ruled_out, self._width)
        first = None
        for _ in range(MOST_LINES):
            line = find_halfway(self._picture.gray, circle, segments, self._config)
            first = first or line
            if line is None or self._config.one_paint is False:
                return line, first
            colours = (measure_paint_colour(image, marking.curve) for marking in (line, circle))
            if match_paint(*colours):
                return line, first
            segments = drop_segments_on(line.line, segments, self._width)
        return None, first


def find_interpretations_of(ruled_out: tuple[Interpretation, ...], ellipse: EllipseBatch) -> tuple[Interpretation, ...]:
    """The ruled out interpretations whose circle is the first ellipse of the batch."""
    axes = np.array([ellipse.great_lengths[0], ellipse.small_lengths[0]])
    found = []
    for interpretation in ruled_out:
        other = ellipse_from_conic(interpretation.conic)
        if other is None:
            continue
        shift = np.abs(other.center - ellipse.centers[0]).max()
        if max(shift, np.abs(np.asarray(other.semi_axes) - axes).max()) <= SAME_CIRCLE * float(axes[0]) + 1.0:
            found.append(interpretation)
    return tuple(found)


def drop_ruled_out_segments(segments: Array, ruled_out: tuple[Interpretation, ...], width: int) -> Array:
    """Segments (K, 2, 2) of a picture of this width (px) that lie on no line that is ruled out with the circle."""
    for interpretation in ruled_out:
        if interpretation.line is None:
            return segments[:0]
        line = join(lift(interpretation.line.start), lift(interpretation.line.end))
        segments = drop_segments_on(line, segments, width)
    return segments


def drop_segments_on(line: Array, segments: Array, width: int) -> Array:
    """Segments (K, 2, 2) of a picture of this width (px) that do not lie on a line (3,)."""
    off = np.abs(lift(segments) @ normalise_line(line)).max(axis=-1)
    return segments[off > ON_LINE_PX * width / 1920.0]
