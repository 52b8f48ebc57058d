"""What the detector found in one frame, in pixels of the full picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from circlecal.detection.field_region import FieldRegion
from circlecal.geometry.projective import Array
from circlecal.results import Segment

if TYPE_CHECKING:
    from circlecal.detection.marking_mask import MarkingSketch

__all__ = ["CircleHypothesis", "Detection"]


@dataclass(frozen=True, slots=True)
class CircleHypothesis:
    """An ellipse that may be the image of the circle, and what speaks for it.

    Attributes
    ----------
    conic : (3, 3) float64
        Normalised conic through the middle of the marking, px.
    score : float
        Order among the hypotheses; larger is better.
    whole_share : float
        Share of the whole circle (by eccentric angle) where the picture shows a marking.
    field_share : float
        Share of the part inside the field that lies on ridge points of its direction.
    picture_share : float
        Share of the part inside the picture (by length) where the picture shows a marking.
    sector_share : float
        Share of the visible part (by eccentric angle) where the picture shows a marking.
    rms_px : float
        Scatter of the marking's middle about the conic, in px at 1920 px width.
    points : (N, 2) float64
        Measured middle of the marking, px.
    band_width : float or None
        Width of the band on the field in radii of the circle, from how much wider it is where the circle is seen
        broadside than near and far; None where that cannot be told.
    painted_share : float
        Share of the visible sectors in which paint stands out on average, where single places show too little; else 0.
    """

    conic: Array
    score: float
    whole_share: float
    field_share: float
    picture_share: float
    sector_share: float
    rms_px: float
    points: Array
    band_width: float | None = None
    painted_share: float = 0.0

    @property
    def least_share(self) -> float:
        """The smallest of the shares of what is seen of it."""
        return min(self.picture_share, self.field_share, self.sector_share)


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
