"""What the stages see in a picture: marking mask, edges, ellipses, cues."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.projective import Array
from circlecal.geometry.short_repr import ShortRepr
from circlecal.observations import CircleEdge, LineEnd
from circlecal.refusals import Confidence
from circlecal.results.verdict import Check

CIRCLE_ID, HALFWAY_ID = 7, 18
"""SoccerNet class ids of the centre circle and of the halfway line in a marking mask."""


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """A straight piece of the picture from ``start`` (2,) to ``end`` (2,), pixels, and the share of it that the
    picture supports.
    """

    start: Array
    end: Array
    support: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Interpretation:
    """What in a picture is taken for the circle (``conic``, (3, 3)) and for the line through its middle."""

    conic: Array
    line: Segment | None

    @property
    def key(self) -> tuple[bytes, bytes]:
        """What tells it from others."""
        line = self.line
        return self.conic.tobytes(), b"" if line is None else line.start.tobytes() + line.end.tobytes()


@dataclass(frozen=True, slots=True, eq=False)
class SeenArc:
    """A part of a circle: rough conic (3, 3), points (N, 2) on the middle of its paint, px, and whether it has hardly a
    gap wherever the picture shows the circle; an arc that ends inside the picture has one.
    """

    conic: Array
    points_px: Array
    gapless: bool


@dataclass(frozen=True, slots=True, eq=False)
class CircleCandidate:
    """An ellipse that may be the circle: its conic (3, 3), the score by which the best is chosen, and its gates."""

    conic: Array
    score: float
    checks: tuple[Check, ...]


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class MarkingMask(ShortRepr):
    """Stage ``mask``: where the markings are.

    Attributes
    ----------
    drawn : (H, W) uint8, or a function that draws it
        As ``classes``; what the detector found is drawn only when it is asked for.
    source : str
        ``"file"``, ``"detector"`` or ``"network"``.
    conic : (3, 3) array or None
        Rough ellipse of the circle's marking.
    halfway : Segment or None
        Rough halfway line.
    lines : tuple of Segment
        Other straight markings.
    field_region : (h, w) bool or None
        The playing surface in a reduced picture, where the detector found it.
    candidates : tuple of CircleCandidate
        The best that were found, also when all were refused.
    confidence : Confidence
        Whether the circle stands by itself or another marking must confirm it; rejected where there is none.
    polarity : float or None
        +1 where the markings are seen lighter than the surface, -1 where darker; None where only the field template
        tells.
    band_px : float or None
        Width of the circle's marking where it is widest, where the detector measured it.
    arcs : tuple of SeenArc
        Other parts of circles; gapless ones may be the circle where other lines confirm it.
    sightings : tuple of MarkingMask
        What the detector saw on each surface of the picture and of each polarity, none of it taken for the circle; the
        likeliest first.
    """

    drawn: NDArray[np.uint8] | Callable[[], NDArray[np.uint8]]
    source: str
    conic: Array | None = None
    halfway: Segment | None = None
    lines: tuple[Segment, ...] = ()
    field_region: NDArray[np.bool_] | None = None
    candidates: tuple[CircleCandidate, ...] = ()
    confidence: Confidence = Confidence.ACCEPTED
    polarity: float | None = None
    band_px: float | None = None
    arcs: tuple[SeenArc, ...] = ()
    sightings: tuple[MarkingMask, ...] = ()

    @property
    def classes(self) -> NDArray[np.uint8]:
        """SoccerNet class ids (H, W) at the frame's size: 7 circle, 18 halfway line, 17 other straight markings, 0
        elsewhere; user's masks may hold any id.
        """
        return self.drawn() if callable(self.drawn) else self.drawn


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class EdgePoints(ShortRepr):
    """Stage ``edges``: sub-pixel Canny points.

    ``points_px`` (N, 2); ``normals`` (N, 2) unit, from dark to bright; ``contrast`` (N,) grey levels across the edge;
    ``sigma_px`` (N,) along the normal; ``noise`` grey-level noise of the picture; ``blur_px`` standard deviation of its
    blur; ``thresholds`` the two that Canny ran with.
    """

    points_px: Array
    normals: Array
    contrast: Array
    sigma_px: Array
    noise: float
    blur_px: float
    thresholds: tuple[float, float]


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class RayPoints(ShortRepr):
    """Stage ``rays``: edge points told apart, and band centres.

    Attributes
    ----------
    center_px : (2,) array
        Where the rays started: the rough centre, re-estimated once.
    outer_px, inner_px, center_line_px : (N, 2), (N, 2), (M, 2) arrays
        Outer and inner edge of the same N rays, and band centres.
    outer_sigma_px, inner_sigma_px, center_line_sigma_px : arrays
        Standard deviations along the normal.
    rays : int
        How many rays were cast.
    rejected : int
        How many met something that is no light band of plausible width.
    rejected_px : (K, 2) array
        Where those met it (for the debug picture).
    rough : Ellipse or None
        The ellipse across which the band centres were measured.
    """

    center_px: Array
    outer_px: Array
    outer_sigma_px: Array
    inner_px: Array
    inner_sigma_px: Array
    center_line_px: Array
    center_line_sigma_px: Array
    rays: int
    rejected: int
    rejected_px: Array
    rough: Ellipse | None = None


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class EllipseFit(ShortRepr):
    """Stage ``ellipse``: the conic of one edge of the marking.

    Attributes
    ----------
    edge : {"outer", "inner", "center"}
        Which edge; ``"center"`` is the centreline of the paint.
    conic : (3, 3) array
        Normalised.
    covariance : (6, 6) array
        Of the coefficients ``x^2, xy, y^2, x, y, 1``.
    ellipse : Ellipse
        Centre, axes and angle of the conic.
    method : str
        Closed form that was refined: direct, algebraic or taubin.
    points_px : (N, 2) array, sigma_px (N,), inliers (N,) bool
        All points given; the inliers are those of the returned conic.
    rms_px : float
        Root mean square orthogonal distance of the inliers.
    arc_deg : float
        Degrees of the ellipse that have inliers.
    hypotheses : int
        RANSAC samples drawn.
    """

    edge: CircleEdge
    conic: Array
    covariance: Array
    ellipse: Ellipse
    method: str
    points_px: Array
    sigma_px: Array
    inliers: NDArray[np.bool_]
    rms_px: float
    arc_deg: float
    hypotheses: int


@dataclass(frozen=True, slots=True, eq=False)
class EllipseFits:
    """The fitted edges of one circle; ``primary`` is the one that carries the calibration.

    ``least_arc_deg`` is how much of the circle the camera must see on the field, where the ellipse shows less; else 0.
    """

    outer: EllipseFit | None
    inner: EllipseFit | None
    center: EllipseFit | None
    least_arc_deg: float = 0.0

    @property
    def primary(self) -> EllipseFit:
        """The fit with the longest arc (centreline first); a frame calibrated without the circle has none."""
        fits = [f for f in (self.center, self.outer, self.inner) if f is not None]
        if not fits:
            raise ValueError("no ellipse was fitted")
        return max(fits, key=lambda f: f.arc_deg)

    def all(self) -> tuple[EllipseFit, ...]:
        """The fitted edges, among outer, inner and centreline."""
        return tuple(f for f in (self.outer, self.inner, self.center) if f is not None)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class LineCue(ShortRepr):
    """A straight marking: normalised line (3,), its points (N, 2) with sigmas (N,), the measured segment, rms and the
    share of it that is seen.

    ``name`` is the template's, or None while it is not known; ``ends`` are where its paint is seen to end; ``width_px``
    is the median width at half height, 0 where it was not measured.
    """

    name: str | None
    line: Array
    points_px: Array
    sigma_px: Array
    segment: Segment
    rms_px: float
    ends: tuple[LineEnd, ...] = ()
    width_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class MarkCue:
    """The centre mark: position (2,), its sigma along and across the halfway line in one, signal to noise ratio."""

    name: str
    point_px: Array
    sigma_px: float
    snr: float


@dataclass(frozen=True, slots=True, eq=False)
class Cues:
    """Stage ``cues``: what fixes the rotation and the imaged centre. Of the straight lines beside the halfway line
    those that may be markings are apart from the others, which are in another paint than the circle.
    """

    halfway: LineCue | None
    mark: MarkCue | None
    lines: tuple[LineCue, ...] = ()
    others: tuple[LineCue, ...] = ()

    @property
    def seen_halfway(self) -> tuple[LineCue, ...]:
        """The halfway line, where it is seen."""
        return () if self.halfway is None else (self.halfway,)
