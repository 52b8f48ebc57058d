"""What is derived from what was seen: points and tangents with their places on the field, homography, camera."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel
from circlecal.geometry.homography import scale_homography
from circlecal.geometry.projective import Array, apply_homography, freeze
from circlecal.geometry.short_repr import ShortRepr
from circlecal.geometry.surface import Surface
from circlecal.observations import MarkingKey
from circlecal.results.numbers import show_with_sigma

CONTRADICTING_SIGMAS, CONTRADICTING_PX = 5.0, 8.0
"""A single point further from its marking than so many of its standard deviations and pixels at 1920 px width
contradicts the rest: clicks scatter by 1.5 px.
"""


def _freeze_arrays(found: CameraFit | HomographyRegion | Camera) -> None:
    """Let nobody write into the arrays of a result."""
    for each in fields(found):
        value = getattr(found, each.name)
        if isinstance(value, np.ndarray):
            freeze(value)


@dataclass(frozen=True, slots=True, eq=False)
class PointCorrespondence:
    """A derived point: label, field (2,) metres, image (2,) pixels, and its sigma where known."""

    label: str
    field_m: Array
    image_px: Array
    sigma_px: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DerivedPoint:
    """A point of the circle as the camera puts it, on the crowned surface: label, field (2,), undistorted pixel (2,),
    covariance (2, 2).
    """

    label: str
    field_m: Array
    image_px: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class LineCorrespondence:
    """A derived tangent, or a straight marking: label, field line (3,), image line (3,), both normalised."""

    label: str
    field_line: Array
    image_line: Array


@dataclass(frozen=True, slots=True, eq=False)
class KnownPoint:
    """A point of known field position (2,) that was seen itself, its pixel (2,) and standard deviation."""

    field_m: Array
    image_px: Array
    sigma_px: float


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Correspondences(ShortRepr):
    """Stage ``correspondences``: the paper's points and tangents, and what was seen beside them.

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
        Eight of each. They follow from a conic, its imaged centre and a direction, which together have as many numbers
        as a homography: by themselves they never contradict each other.
    seen_points, seen_lines : tuples
        Marks, keypoints and named lines as they were seen themselves; a record has them as observations.
    """

    case: int
    conic: Array
    radius_m: float
    imaged_center: Array
    center_source: str
    vanishing_line: Array
    points: tuple[PointCorrespondence, ...]
    tangents: tuple[LineCorrespondence, ...]
    seen_points: tuple[KnownPoint, ...] = ()
    seen_lines: tuple[LineCorrespondence, ...] = ()

    @property
    def all_points(self) -> tuple[PointCorrespondence | KnownPoint, ...]:
        """The derived ones, then those that were seen themselves."""
        return (*self.points, *self.seen_points)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class HomographyFit(ShortRepr):
    """Stage ``homography``: the DLT on points and lines, both directions, and the solution of the turned field.

    ``residuals_px`` are the distances (N,) of the points, the derived ones first; ``lines`` is how many lines took
    part.
    """

    H_image_field: Array
    H_image_field_turned: Array
    residuals_px: Array
    condition: float
    null_ratio: float
    lines: int = 0

    @property
    def H_field_image(self) -> Array:
        """From the picture to the field (3, 3)."""
        return scale_homography(np.linalg.inv(self.H_image_field))


@dataclass(frozen=True, slots=True)
class OtherSize:
    """What it would change if the field were of another kind of size than it is taken to be.

    Attributes
    ----------
    share : float
        How likely that is after what was seen, 0..1.
    away_px : float
        By how much the field points in view would then be seen elsewhere, as they lie beside what was seen, pixels,
        mean of root mean squares.
    """

    share: float
    away_px: float


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
        length, width = show_with_sigma(self.length_m, self.length_sd_m), show_with_sigma(self.width_m, self.width_sd_m)
        return f"length {length}, width {width} m, {'usual' if self.is_usual else 'estimated'}"


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class HomographyRegion(ShortRepr):
    """Where the true homography lies, told by the pixels of four field points, far from each other in the picture.

    Four points and their pixels are a homography (Baker, Datta and Kanade, Parameterizing Homographies, 2006). In their
    pixels the region is an ellipsoid; in the entries of H it is bent where zoom can stand for distance.

    Attributes
    ----------
    field_m, image_px : (4, 2) arrays
        Points of the plane tangent at the centre mark, and where the estimate sees them, undistorted pixels.
    covariance : (8, 8) array
        Of ``image_px``, point by point.
    directions : int
        In how many directions the camera's parameters move the homography: 7 with square pixels and a known principal
        point, at most 8.
    """

    field_m: Array
    image_px: Array
    covariance: Array
    directions: int

    def __post_init__(self) -> None:
        """Nobody changes an answer by its arrays."""
        _freeze_arrays(self)

    def distance(self, H_image_field: Array) -> float:
        """Squared Mahalanobis distance of a homography (3, 3), along the ``directions`` of largest variance.

        That of the truth is distributed as chi-square with ``directions`` degrees of freedom, while the camera is known
        to some 40 px (at 1920 px width) everywhere: beyond, the ellipsoid does not follow the valley along which zoom
        and distance make up for each other.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        # an eighth direction is not free but the bend of the seven, and its variance would be taken for knowledge
        values, vectors = values[-self.directions :], vectors[:, -self.directions :]
        off = (apply_homography(H_image_field, self.field_m) - self.image_px).ravel() @ vectors
        return float(np.sum(off**2 / np.maximum(values, np.finfo(np.float64).tiny)))


@dataclass(frozen=True, slots=True, eq=False)
class PaintersFit:
    """An estimate that weighs what was seen by painters' errors too.

    Attributes
    ----------
    theta : (P,) array
        The parameter vector.
    covariance : (P, P) array
        What painters' errors add to the covariance of the parameters.
    residuals_px : dict of MarkingKey
        Root mean square residual by observation.
    point_residuals_px : dict of MarkingKey
        Signed distance (N,) of each point of markings with few points, pixels.
    """

    theta: Array
    covariance: Array
    residuals_px: dict[MarkingKey, float]
    point_residuals_px: dict[MarkingKey, Array]


@dataclass(frozen=True, slots=True, eq=False)
class RoughCamera:
    """Parameters (P,) of a camera that is about right, and the names that it gave to lines, by their index."""

    theta: Array
    names_by_line: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class CameraFit(ShortRepr):
    """Stage ``camera``: maximum a posteriori pinhole camera with its covariance.

    Attributes
    ----------
    camera : Camera
        The estimate.
    surface : Surface
        With the estimated crown, quoted at the circle's radius.
    covariance : (P, P) array
        Of the parameters in ``parameters`` (their names).
    H_covariance : (8, 8) array
        Of H_image_field scaled to H[2, 2] = 1, row-major without the last entry: for linear propagation.
    region : HomographyRegion or None
        Where the true homography lies; None where hardly any of the field is in view.
    imaged_center_px, imaged_center_covariance : (2,), (2, 2) arrays
        Image of the circle's centre (undistorted pixels).
    noise_scale : float
        Factor on the given sigmas that the residuals ask for.
    data_share : float
        Share of the predicted precision around the circle that the observations bring, 0..1.
    residual_correlation : float
        How many neighbouring residuals along the circle repeat each other (1 = white).
    max_sigma_px, max_sigma_m : float
        Largest predicted standard deviation over the visible field near ``reference_m``, counted from what was seen: at
        one end of a field whose length nobody knows, the other end is less certain by ``field_size``.
    mean_sigma_px : float
        Mean of it there.
    residuals_px, stated_sigma_px : dict of MarkingKey
        Root mean square residual by observation, and the standard deviation that the observation itself stated.
    theta : (P,) array
        The estimate as the parameter vector, in the order of ``parameters``.
    derived_points : tuple of DerivedPoint
        The eight points of the circle with their covariance.
    rejected : tuple of MarkingKey
        Observations that contradict the others and were left out.
    missed_ends_px : dict of MarkingKey
        Markings of which only an end of another line was seen, so far off that the loss leaves it no say, and by how
        many pixels: they carry nothing, and stand in a record among what was left out.
    named_lines : tuple of str
        Template lines that were recognised among the straight markings seen, and used.
    names_by_line : dict
        Template lines by the index of the seen line that each was recognised in.
    reference_m : (2,) array
        The field point about which distance and predicted errors are judged: the circle's centre, or the middle of what
        was seen instead of the circle.
    reference_by_growth : (2,) array
        By how much what was seen moves along x per metre that the field is longer, and along y per metre that it is
        broader; zero where the circle was seen.
    field_size : FieldSize or None
        How long and broad the field is; None where both are fixed, or told by other frames of the camera.
    other_size : OtherSize or None
        What another kind of size would change; None where no other is likely, and where a record was read.
    point_residuals_px : dict of MarkingKey
        Signed distance (N,) of each point of markings with few points, pixels, in the order in which they were given.
    bulk_residuals_px : dict of MarkingKey
        Root mean square residual of each line and curve without the few points that lie far off all others; empty where
        a record was read, which does not keep it.
    painters : PaintersFit or None
        The estimate that weighs what was seen by painters' errors too, while it is not this one; None where there are
        none.
    painted_sigma_px : dict of MarkingKey
        Part of each observation's residual that painters' errors may bring, pixels; empty where they make none.
    """

    camera: Camera
    surface: Surface
    parameters: tuple[str, ...]
    covariance: Array
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
    reference_by_growth: Array = field(default_factory=lambda: np.zeros(2))
    field_size: FieldSize | None = None
    other_size: OtherSize | None = None
    point_residuals_px: dict[MarkingKey, Array] = field(default_factory=dict)
    bulk_residuals_px: dict[MarkingKey, float] = field(default_factory=dict)
    region: HomographyRegion | None = None
    mean_sigma_px: float = 0.0
    painters: PaintersFit | None = None
    painted_sigma_px: dict[MarkingKey, float] = field(default_factory=dict)
    missed_ends_px: dict[MarkingKey, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Nobody changes an answer by its arrays, which its view, its record and its pictures share."""
        _freeze_arrays(self)
        _freeze_arrays(self.camera)

    @property
    def H_image_field(self) -> Array:
        """Of the plane tangent at the centre mark, to undistorted pixels (3, 3)."""
        return freeze(self.camera.homography)

    @property
    def H_field_image(self) -> Array:
        """From undistorted pixels to that plane (3, 3)."""
        return freeze(scale_homography(np.linalg.inv(self.camera.homography)))

    @property
    def all_residuals_px(self) -> dict[MarkingKey, float]:
        """Root mean square residual of everything that was not rejected, missed ends too, pixels."""
        return self.residuals_px | self.missed_ends_px

    @property
    def left_out(self) -> tuple[MarkingKey, ...]:
        """Observations that have no part in the answer."""
        return (*self.rejected, *self.missed_ends_px)

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
