"""Frozen result types: what each stage hands on, and the whole calibration of a frame.

Arrays are float64 unless said; nothing here computes. A field that is None was not reached or not determined.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, PlaneCamera
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel
from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.observations import CircleEdge, LineEnd, MarkingKey, Observations
from circlecal.refusals import Confidence, explain

Status = Literal["calibrated", "refused"]
CIRCLE_ID, HALFWAY_ID = 7, 18
"""SoccerNet class ids of the centre circle and of the halfway line in a marking mask."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A straight piece of the picture from ``start`` (2,) to ``end`` (2,), pixels, and the share of it that the
    picture supports.
    """

    start: Array
    end: Array
    support: float = 1.0


@dataclass(frozen=True, slots=True)
class Interpretation:
    """What in a picture is taken for the circle (``conic``, (3, 3)) and for the line through its middle."""

    conic: Array
    line: Segment | None

    @property
    def key(self) -> tuple[bytes, bytes]:
        """What tells it from others."""
        line = self.line
        return self.conic.tobytes(), b"" if line is None else line.start.tobytes() + line.end.tobytes()


@dataclass(frozen=True, slots=True)
class SeenArc:
    """A part of a circle: rough conic (3, 3), points (N, 2) on the middle of its paint, px, and whether it has hardly a
    gap wherever the picture shows the circle; an arc that ends inside the picture has one.
    """

    conic: Array
    points_px: Array
    gapless: bool


@dataclass(frozen=True, slots=True)
class CircleCandidate:
    """An ellipse that may be the circle: its conic (3, 3), the score by which the best is chosen, and its gates."""

    conic: Array
    score: float
    checks: tuple[Check, ...]


@dataclass(frozen=True, slots=True)
class MarkingMask:
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

    @property
    def classes(self) -> NDArray[np.uint8]:
        """SoccerNet class ids (H, W) at the frame's size: 7 circle, 18 halfway line, 17 other straight markings, 0
        elsewhere; user's masks may hold any id.
        """
        return self.drawn() if callable(self.drawn) else self.drawn


@dataclass(frozen=True, slots=True)
class EdgePoints:
    """Stage ``edges``: sub-pixel Canny points.

    ``points_px`` (N, 2); ``normals`` (N, 2) unit, from dark to bright; ``contrast`` (N,) grey levels across the edge;
    ``sigma_px`` (N,) along the normal; ``noise``
    grey-level noise of the picture; ``blur_px`` standard deviation of its blur; ``thresholds`` the two that Canny ran
    with.
    """

    points_px: Array
    normals: Array
    contrast: Array
    sigma_px: Array
    noise: float
    blur_px: float
    thresholds: tuple[float, float]


@dataclass(frozen=True, slots=True)
class RayPoints:
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


@dataclass(frozen=True, slots=True)
class EllipseFit:
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


@dataclass(frozen=True, slots=True)
class EllipseFits:
    """The fitted edges of one circle; ``primary`` is the one that carries the calibration."""

    outer: EllipseFit | None
    inner: EllipseFit | None
    center: EllipseFit | None

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


@dataclass(frozen=True, slots=True)
class LineCue:
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


@dataclass(frozen=True, slots=True)
class MarkCue:
    """The centre mark: position (2,), its sigma along and across the halfway line in one, signal to noise ratio."""

    name: str
    point_px: Array
    sigma_px: float
    snr: float


@dataclass(frozen=True, slots=True)
class Cues:
    """Stage ``cues``: what fixes the rotation and the imaged centre."""

    halfway: LineCue | None
    mark: MarkCue | None
    lines: tuple[LineCue, ...] = ()


@dataclass(frozen=True, slots=True)
class PointCorrespondence:
    """A derived point: label, field (2,) metres, image (2,) pixels, and its sigma where known."""

    label: str
    field_m: Array
    image_px: Array
    sigma_px: float | None = None


@dataclass(frozen=True, slots=True)
class DerivedPoint:
    """A point of the circle as the camera puts it: label, field (2,), undistorted pixel (2,), covariance (2, 2)."""

    label: str
    field_m: Array
    image_px: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class LineCorrespondence:
    """A derived tangent: label, field line (3,), image line (3,), both normalised."""

    label: str
    field_line: Array
    image_line: Array


@dataclass(frozen=True, slots=True)
class Correspondences:
    """Stage ``correspondences``: the paper's points and tangents.

    Attributes
    ----------
    case : int
        1 (line), 2 (point) or 3 (two edges).
    conic : (3, 3) array, radius_m : float
        The conic that they were derived from and the radius of its circle.
    imaged_center : (3,) array
        Homogeneous pixel, third entry 1.
    center_source : str
        ``"centre_mark"``, ``"pinhole"`` (square pixels and a known principal point) or ``"two_edges"``.
    vanishing_line : (3,) array
        Normalised.
    points, tangents : tuples
        Eight of each.
    """

    case: int
    conic: Array
    radius_m: float
    imaged_center: Array
    center_source: str
    vanishing_line: Array
    points: tuple[PointCorrespondence, ...]
    tangents: tuple[LineCorrespondence, ...]


@dataclass(frozen=True, slots=True)
class HomographyFit:
    """Stage ``homography``: the DLT on points and lines, both directions, and the solution of the turned field."""

    H_image_field: Array
    H_field_image: Array
    H_image_field_turned: Array
    residuals_px: Array
    condition: float
    null_ratio: float


CONTRADICTING_SIGMAS, CONTRADICTING_PX = 5.0, 8.0
"""A single point further from its marking than so many of its standard deviations and pixels at 1920 px width
contradicts the rest: clicks scatter by 1.5 px.
"""


@dataclass(frozen=True, slots=True)
class FieldSize:
    """How long and broad a field is.

    Attributes
    ----------
    length_m, width_m, length_sd_m, width_sd_m : float
        With their standard deviations, metres.
    is_usual : bool
        Whether the field is taken to be about as large as its template says; otherwise its size is estimated from what
        was seen.
    usual_share : float
        How likely that is after what was seen, 0..1.
    """

    length_m: float
    width_m: float
    length_sd_m: float
    width_sd_m: float
    is_usual: bool
    usual_share: float

    def __str__(self) -> str:
        sizes = (
            f"length {self.length_m:.1f} +- {self.length_sd_m:.1f}, width {self.width_m:.1f} +- {self.width_sd_m:.1f}"
        )
        return f"{sizes} m, {'usual' if self.is_usual else 'estimated'}"


@dataclass(frozen=True, slots=True)
class CameraFit:
    """Stage ``camera``: maximum a posteriori pinhole camera with its covariance.

    Attributes
    ----------
    camera : Camera
        The estimate.
    surface : Surface
        With the estimated crown, quoted at the circle's radius.
    covariance : (P, P) array
        Of the parameters in ``parameters`` (their names).
    H_image_field, H_field_image : (3, 3) arrays
        Of the plane tangent at the centre mark, undistorted pixels.
    H_covariance : (8, 8) array
        Of H_image_field scaled to H[2, 2] = 1, row-major without the last entry.
    imaged_center_px, imaged_center_covariance : (2,), (2, 2) arrays
        Image of the circle's centre (undistorted pixels).
    noise_scale : float
        Factor on the given sigmas that the residuals ask for.
    data_share : float
        Share of the predicted precision around the circle that the observations bring, 0..1.
    residual_correlation : float
        How many neighbouring residuals along the circle repeat each other (1 = white).
    max_sigma_px, max_sigma_m : float
        Largest predicted standard deviation over the visible field near ``reference_m``.
    residuals_px, stated_sigma_px : dict of MarkingKey
        Root mean square residual by observation, and the standard deviation that the observation itself stated.
    theta : (P,) array
        The estimate as the parameter vector, in the order of ``parameters``.
    derived_points : tuple of DerivedPoint
        The eight points of the circle with their covariance.
    rejected : tuple of MarkingKey
        Observations that contradict the others and were left out.
    named_lines : tuple of str
        Template lines that were recognised among the straight markings seen, and used.
    names_by_line : dict
        Template lines by the index of the seen line that each was recognised in.
    reference_m : (2,) array
        The field point about which distance and predicted errors are judged: the circle's centre, or the middle of what
        was seen instead of the circle.
    field_size : FieldSize or None
        How long and broad the field is; None where it was not asked.
    point_residuals_px : dict of MarkingKey
        Signed distance (N,) of each point of markings with few points, pixels, in the order in which they were given.
    """

    camera: Camera
    surface: Surface
    parameters: tuple[str, ...]
    covariance: Array
    H_image_field: Array
    H_field_image: Array
    H_covariance: Array
    imaged_center_px: Array
    imaged_center_covariance: Array
    noise_scale: float
    data_share: float
    max_sigma_px: float
    max_sigma_m: float
    residuals_px: dict[MarkingKey, float]
    theta: Array
    residual_correlation: float = 1.0
    stated_sigma_px: dict[MarkingKey, float] = field(default_factory=dict)
    derived_points: tuple[DerivedPoint, ...] = ()
    rejected: tuple[MarkingKey, ...] = ()
    named_lines: tuple[str, ...] = ()
    names_by_line: dict[int, str] = field(default_factory=dict)
    reference_m: Array = field(default_factory=lambda: np.zeros(2))
    field_size: FieldSize | None = None
    point_residuals_px: dict[MarkingKey, Array] = field(default_factory=dict)

    @property
    def contradicting_points(self) -> tuple[tuple[MarkingKey, int, float], ...]:
        """Single points that contradict the rest, the worst first: marking, number from 1 on, distance in pixels."""
        least_px = CONTRADICTING_PX * self.camera.width / 1920.0
        found = [
            (key, number + 1, abs(float(off)))
            for key, distances in self.point_residuals_px.items()
            for number, off in enumerate(distances)
            if abs(off) > max(least_px, CONTRADICTING_SIGMAS * self.stated_sigma_px.get(key, 0.0))
        ]
        return tuple(sorted(found, key=lambda point: -point[2]))

    @property
    def view(self) -> FieldView:
        """Where this camera sees the field."""
        known = self.parameters == PARAMETERS and self.theta.shape == (len(PARAMETERS),)
        growth_m = self.theta[[INDEX["length"], INDEX["breadth"]]] if known else np.zeros(2)
        return FieldView(self.camera, self.surface, growth_m, self.covariance if known else None)

    @property
    def model(self) -> ProjectionModel:
        """The model under which the parameters were estimated."""
        return ProjectionModel.of(self.camera, self.surface)

    @property
    def prior_dominated(self) -> bool:
        """Whether the priors bring the larger part of the predicted precision."""
        return self.data_share < 0.5


@dataclass(frozen=True, slots=True)
class Agreement:
    """Stage ``agreement``: markings that must be in view and that the camera was not fitted to.

    Attributes
    ----------
    names : tuple of str
        The template's.
    length_px : (K,) array
        How much of each lies where the picture shows the field and its place is known.
    share : (K,) array
        Share of that on which the picture shows a marking.
    certain : bool
        Whether their places are known well; otherwise they were looked for in a wider strip.
    """

    names: tuple[str, ...]
    length_px: Array
    share: Array
    certain: bool = True

    @property
    def expected_px(self) -> float:
        """Length of all of them."""
        return float(self.length_px.sum())

    @property
    def found_share(self) -> float:
        """Share of that which is drawn; 1 where nothing is expected."""
        return float(self.length_px @ self.share) / self.expected_px if len(self.names) else 1.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks against a camera.

    Attributes
    ----------
    oblique_widths, alone_widths : float
        Length of lines like the carriers' paint that lie surely on the field, where no marking is, picture widths: of
        those that run along neither axis of the field, and of one that runs along an axis where it is the only one.
        Several that do are the field of another sport.
    painted_share : float
        Share of the carriers that is painted where they must be in view.
    reversal : float
        By how much (half a chi-square) the width of the paint is better explained by a camera that has near and far
        exchanged; far below zero where the paint confirms the camera.
    rough_share : float
        Share of the field that must be in view which is no playing surface but as rough as a crowd.
    """

    oblique_widths: float
    alone_widths: float
    painted_share: float
    reversal: float
    rough_share: float


@dataclass(frozen=True, slots=True)
class Check:
    """One gate of the verdict: name, measured value, limit, passed or not."""

    name: str
    value: float
    limit: float
    passed: bool


@dataclass(frozen=True, slots=True)
class Verdict:
    """Stage ``verdict``: calibrated, or refused with a code, a reason in words and the stage that refused."""

    status: Status
    code: str | None
    reason: str | None
    stage: str | None
    checks: tuple[Check, ...] = ()

    @property
    def help(self) -> str | None:
        """What helps against a refusal; None where there is none."""
        return None if self.code is None else explain(self.code, self.stage).help

    def check(self, name: str) -> Check | None:
        """The check of this name, where it was made."""
        return next((check for check in self.checks if check.name == name), None)


class Fitted(NamedTuple):
    """What a picture's attempt holds once a camera was fitted to it: where looking at the picture again starts."""

    mask: MarkingMask
    edges: EdgePoints
    cues: Cues
    observations: Observations
    camera: CameraFit
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class Rival:
    """Another way to see the picture: its circle taken for another one of the field.

    Attributes
    ----------
    circle_name : str
        What the circle is taken for.
    camera : CameraFit
        The camera that follows.
    evidence : float
        Length of markings that are painted where this camera puts them, beyond break-even, picture widths.
    """

    circle_name: str
    camera: CameraFit
    evidence: float


@dataclass(frozen=True, slots=True)
class Attempt:
    """What the stages made of one frame with one circle: each stage's result, None where it was not reached.

    Attributes
    ----------
    mask, edges, rays, ellipses, cues, correspondences, homography, camera : stage results
        In the order of the stages.
    observations : Observations or None
        What the camera is fitted to: everything that was measured, and what was given beside the picture.
    verdict : Verdict or None
        The answer of the last stage, or why an earlier one gave up.
    circle_name : str or None
        Circle of the template that the seen one was taken for, where it is another than the one looked for.
    rivals : tuple of Rival
        What else it may be, the likeliest first, where that was asked.
    """

    mask: MarkingMask | None = None
    edges: EdgePoints | None = None
    rays: RayPoints | None = None
    ellipses: EllipseFits | None = None
    cues: Cues | None = None
    observations: Observations | None = None
    correspondences: Correspondences | None = None
    homography: HomographyFit | None = None
    camera: CameraFit | None = None
    verdict: Verdict | None = None
    circle_name: str | None = None
    rivals: tuple[Rival, ...] = ()

    @property
    def fitted(self) -> Fitted | None:
        """What was reached, where a picture led to a camera and a verdict; else None."""
        if self.mask is None or self.edges is None or self.cues is None:
            return None
        if self.observations is None or self.camera is None or self.verdict is None:
            return None
        return Fitted(self.mask, self.edges, self.cues, self.observations, self.camera, self.verdict)

    @property
    def is_calibrated(self) -> bool:
        """Whether the verdict accepts it."""
        return self.verdict is not None and self.verdict.status == "calibrated"

    @property
    def code(self) -> str | None:
        """Why the verdict refuses it, for machines; None where it does not."""
        return None if self.verdict is None else self.verdict.code


@dataclass(frozen=True, slots=True)
class FieldCandidate:
    """What a frame looks like as one field among several that it may be.

    Attributes
    ----------
    template, sport : str
        Name of the field template, and the sport that it belongs to.
    status, code : str, str or None
        Verdict under this template.
    evidence : float or None
        Length of its markings that are painted where its camera puts them, beyond the length at which as much is
        missing as a wrong camera's would be, picture widths; None where there is no camera.
    found_share : float or None
        Share of its markings in view that are painted.
    explained_share : float or None
        Share of what was found painted that are its markings.
    max_sigma_px : float or None
        Largest predicted standard deviation, pixels.
    H_image_field : (3, 3) array or None
        Field to pixels, where it was calibrated.
    """

    template: str
    sport: str
    status: Status
    code: str | None
    evidence: float | None = None
    found_share: float | None = None
    explained_share: float | None = None
    max_sigma_px: float | None = None
    H_image_field: Array | None = None


@dataclass(frozen=True, slots=True)
class FrameCalibration:
    """Everything known about one frame: which one it is, how it was run, and the attempt that was taken.

    The :class:`circlecal.Calibration` that users get is made from it.

    Attributes
    ----------
    id, source : str, str or None
        Name of the frame, and the file or address that it comes from.
    width, height : int
        Size of the picture, pixels.
    field_name, circle_name : str
        Field template, and the circle of it that was looked for.
    attempt : Attempt
        What every stage reached.
    seed, config_digest : int, str
        Seed of the random draws, and digest of the configuration.
    timings_ms : dict
        Time spent in each stage, over all attempts.
    template : FieldTemplate or None
        The field itself; None where the calibration was read from a file.
    fields : tuple of FieldCandidate
        Where the field was to be told by the picture: the templates that were tried, the one that was taken first.
    """

    id: str
    width: int
    height: int
    field_name: str
    circle_name: str
    attempt: Attempt
    seed: int
    config_digest: str
    timings_ms: dict[str, float] = field(default_factory=dict)
    source: str | None = None
    template: FieldTemplate | None = None
    fields: tuple[FieldCandidate, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Calibrated, or refused with a reason."""
        return self.attempt.verdict or Verdict("refused", "no_homography", "no stage was run", None)

    @property
    def status(self) -> Status:
        """``"calibrated"`` or ``"refused"``."""
        return self.verdict.status

    @property
    def view(self) -> FieldView | None:
        """Where the field is seen, through the camera or else the homography, also of a refused frame; None without."""
        camera, homography = self.attempt.camera, self.attempt.homography
        if camera is not None:
            return camera.view
        if homography is not None:
            return FieldView(PlaneCamera(self.width, self.height, homography.H_image_field))
        return None

    @property
    def H_image_field(self) -> Array | None:
        """Field (metres) to undistorted pixels: of the camera where there is one, else the DLT; None when refused."""
        if self.status != "calibrated":
            return None
        camera, homography = self.attempt.camera, self.attempt.homography
        if camera is not None:
            return camera.H_image_field
        return None if homography is None else homography.H_image_field
