"""The parts of a result record."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, InstanceOf, model_validator

from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, camera_from_soccernet
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.observations import CircleEdge, CirclePoints, Keypoint, LineEnd, LinePoints, MarkPoint, Observations
from circlecal.results import Status

Text = InstanceOf[str]
"""A name from outside, which need not be text that any encoding can write."""
Number = float | None
LARGEST = 1e30
"""Of a camera's numbers, in whatever unit: far beyond any camera, and their fourth powers are finite still."""
CameraNumber = Annotated[float, Field(ge=-LARGEST, le=LARGEST)] | None
Count = Annotated[int, Field(ge=0, lt=2**63)]
"""A whole number that tables hold in 64 bits."""
Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]
Matrix = tuple[Triple, Triple, Triple]
FourPoints = Annotated[list[tuple[float, float]], Field(min_length=4, max_length=4)]
EightNumbers = Annotated[list[float], Field(min_length=8, max_length=8)]


def _require_square(rows: list[list[Number]]) -> list[list[Number]]:
    if any(len(row) != len(rows) for row in rows):
        raise ValueError(f"is no square matrix: {len(rows)} rows of {', '.join(sorted({str(len(r)) for r in rows}))}")
    return rows


SquareMatrix = Annotated[list[list[Number]], AfterValidator(_require_square)]


class RecordPart(BaseModel):
    """Part of a record: finite numbers, types as written, keys that are not known passed over."""

    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False, frozen=True)


class MaskRecord(RecordPart):
    """A mask that lay beside a picture: its path from the picture's folder, and its size."""

    path: Text
    bytes: Count | None = None

    @property
    def label(self) -> str:
        """Path and size on one line."""
        return f"{self.path} {self.bytes}"


class SourceRecord(RecordPart):
    """Where a frame comes from: its file or address, the size of the picture's or video's file, its time in a video;
    ``mask`` is null where none lay beside the picture, and not there where none was looked for.
    """

    path: Text | None = None
    time_s: Number = None
    bytes: Count | None = None
    mask: MaskRecord | None = None

    @property
    def mask_label(self) -> str | None:
        """Path and size of the mask beside the picture, nothing where there was none; None where that is not known."""
        if "mask" not in self.model_fields_set:
            return None
        return "" if self.mask is None else self.mask.label


class FieldRecord(RecordPart):
    """The field template and its circle."""

    template: Text
    circle: Text | None = None
    sizes: dict[str, float] | None = None


class ImageRecord(RecordPart):
    """Size of a frame, pixels, and the width of a pixel over its height."""

    width: Annotated[int, Field(gt=0, lt=2**31)]
    height: Annotated[int, Field(gt=0, lt=2**31)]
    aspect: Annotated[float, Field(gt=0, lt=1e3)] = 1.0


class CheckRecord(RecordPart):
    """One gate of the verdict."""

    name: str
    value: Number
    limit: Number
    passed: bool


class CovarianceRecord(RecordPart):
    """Covariance of the camera's parameters: the matrix, or the rows of its lower Cholesky factor, which are short.

    Parameters of the camera model that are not named are fixed.
    """

    parameters: tuple[str, ...]
    estimate: list[Number] = []
    matrix: list[list[Number]] = []
    factor: list[list[float]] | None = None

    @model_validator(mode="after")
    def _square(self) -> Self:
        size = len(self.parameters)
        if self.factor is not None:
            if [len(row) for row in self.factor] != list(range(1, size + 1)):
                raise ValueError(f"factor has no {size} rows with 1 to {size} numbers")
        elif {len(self.matrix), *map(len, self.matrix)} != {size}:
            raise ValueError(f"matrix is not {size} x {size}")
        return self

    @property
    def is_known(self) -> bool:
        """Whether the parameters are those of this version's camera model, all of them or some."""
        return set(self.parameters) <= set(PARAMETERS)

    def full(self) -> Array:
        """Covariance (P, P) of all parameters of the camera model, zero where they are fixed."""
        if self.factor is None:
            own = as_array(self.matrix)
        else:
            factor = np.zeros((len(self.factor), len(self.factor)))
            for row, numbers in enumerate(self.factor):
                factor[row, : len(numbers)] = numbers
            own = factor @ factor.T
        places = self._places
        covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
        covariance[np.ix_(places, places)] = own
        return covariance

    def sigma(self, name: str) -> float:
        """Standard deviation of a parameter that is named."""
        place = self.parameters.index(name)
        row = [np.sqrt(as_array(self.matrix)[place, place])] if self.factor is None else self.factor[place]
        return float(np.linalg.norm(row))

    def theta(self) -> Array:
        """The estimate (P,) of all parameters of the camera model, zero where it is not written."""
        theta = np.zeros(len(PARAMETERS))
        if len(self.estimate) == len(self.parameters):
            theta[self._places] = as_array(self.estimate)
        return theta

    @property
    def growth_m(self) -> Array:
        """By how much the field is longer and broader (2,) than its template says, metres."""
        return self.theta()[[INDEX["length"], INDEX["breadth"]]]

    @property
    def _places(self) -> list[int]:
        return [INDEX[name] for name in self.parameters]


class CameraRow(RecordPart):
    """Of a camera, what tables need."""

    pan_degrees: CameraNumber
    tilt_degrees: CameraNumber
    roll_degrees: CameraNumber
    position_meters: tuple[CameraNumber, CameraNumber, CameraNumber]
    x_focal_length: CameraNumber
    y_focal_length: CameraNumber
    principal_point: tuple[CameraNumber, CameraNumber]
    radial_distortion: Annotated[list[CameraNumber], Field(min_length=2)]
    tangential_distortion: list[Number] = []
    thin_prism_distortion: list[Number] = []
    crown_m: CameraNumber = 0.0
    crown_shape: SurfaceShape = "flat"
    crown_radius_m: CameraNumber = 1.0
    position_sigma_m: Triple | None = None
    max_sigma_px: Number = None
    max_sigma_m: Number = None


class DerivedPointRecord(RecordPart):
    """A point of the circle as the camera puts it."""

    label: str
    field_m: Pair
    image_px: Pair
    covariance: tuple[Pair, Pair]


class FieldSizeRecord(RecordPart):
    """How long and broad the field is."""

    length_m: float
    width_m: float
    length_sd_m: float
    width_sd_m: float
    is_usual: bool
    usual_share: float


class RegionRecord(RecordPart):
    """Where the true homography lies."""

    field_m: FourPoints
    image_px: FourPoints
    covariance: Annotated[list[EightNumbers], Field(min_length=8, max_length=8)]
    directions: Annotated[int, Field(ge=1, le=8)]


class CameraRecord(CameraRow):
    """A camera: SoccerNet's keys at the frame's own size, and circlecal's own."""

    covariance: CovarianceRecord | None = None
    derived_points: list[DerivedPointRecord] = []
    named_lines: list[str] = []
    rejected_observations: list[str] = []
    noise_scale: Number = None
    mean_sigma_px: Number = None
    data_share: Number = None
    prior_dominated: bool | None = None
    residual_correlation: Number = None
    reference_m: Pair | None = None
    reference_by_growth: Pair | None = None
    field_size: FieldSizeRecord | None = None

    @property
    def surface(self) -> Surface:
        """The surface with its crown."""
        return Surface(self.crown_shape, self.crown_radius_m or 1.0, self.crown_m or 0.0)

    def pinhole(self, image: ImageRecord) -> Camera | None:
        """The camera; None where it has numbers that are not finite."""
        numbers = [self.pan_degrees, self.tilt_degrees, self.roll_degrees, self.x_focal_length, self.y_focal_length]
        numbers += [*self.position_meters, *self.principal_point, *self.radial_distortion[:2]]
        if None in numbers or not self.x_focal_length or not self.y_focal_length:
            return None
        return camera_from_soccernet(self.model_dump(include=set(CameraRow.model_fields)), image.width, image.height)

    def view(self, image: ImageRecord) -> FieldView | None:
        """The field before the camera; None where it has numbers that are not finite."""
        camera, known = self.pinhole(image), self.covariance
        if camera is None or known is None or not known.is_known:
            return None if camera is None else FieldView(camera, self.surface)
        return FieldView(camera, self.surface, known.growth_m, known.full())


class EstimateRow(RecordPart):
    """Of an estimate that the verdict did not trust, what tables need."""

    camera: CameraRow | None = None


class EstimateRecord(EstimateRow):
    """An estimate that the verdict did not trust."""

    H_image_field: Matrix | None = None
    camera: CameraRecord | None = None


class EllipseRow(RecordPart):
    """Of a fitted ellipse, what tables need."""

    rms_px: Number = None


class EllipseRecord(EllipseRow):
    """The ellipse of one edge of the circle."""

    conic: Matrix | None = None
    center_px: Pair
    semi_axes_px: Pair
    angle_degrees: Number
    covariance: SquareMatrix | None = None
    method: str | None = None
    arc_degrees: Number = None
    hypotheses: int | None = None


class EllipsesRow(RecordPart):
    """Of the fitted ellipses, what tables need; ``primary`` names the one that carries the calibration."""

    primary: CircleEdge | None = None
    outer: EllipseRow | None = None
    inner: EllipseRow | None = None
    center: EllipseRow | None = None

    @property
    def found(self) -> EllipseRow | None:
        """The one that carries the calibration."""
        return None if self.primary is None else getattr(self, self.primary)


class EllipsesRecord(EllipsesRow):
    """The fitted ellipses."""

    outer: EllipseRecord | None = None
    inner: EllipseRecord | None = None
    center: EllipseRecord | None = None

    @property
    def found(self) -> EllipseRecord | None:
        """The one that carries the calibration."""
        return None if self.primary is None else getattr(self, self.primary)


class PointRecord(RecordPart):
    """A derived point."""

    label: str
    field_m: Pair
    image_px: Pair
    sigma_px: Number = None


class TangentRecord(RecordPart):
    """A derived tangent."""

    label: str
    field_line: Triple
    image_line: Triple


class CorrespondencesRecord(RecordPart):
    """The paper's points and tangents, and the conic that they were derived from."""

    conic: Matrix
    radius_m: Number
    points: list[PointRecord]
    tangents: list[TangentRecord]


class InliersRecord(RecordPart):
    """Points of one edge that its ellipse was fitted to, of how many."""

    count: Count
    of: Count
    points_px: list[Pair]


class AlternativeRecord(RecordPart):
    """Another solution of a real ambiguity."""

    kind: str
    H_image_field: Matrix
    camera: CameraRow | None = None
    circle: Text | None = None
    evidence: Number = None


class FieldCandidateRecord(RecordPart):
    """A field template that a frame may show, and what speaks for it."""

    template: Text
    sport: Text
    status: Status
    code: str | None = None
    evidence: Number = None
    found_share: Number = None
    explained_share: Number = None
    max_sigma_px: Number = None
    H_image_field: Matrix | None = None


class SportRecord(RecordPart):
    """The sport that a refused frame looks like, null where nothing tells, and how sure that is."""

    name: Text | None = None
    probability: Number = None


class ResidualsRecord(RecordPart):
    """Rms per fitted ellipse, one residual per point of the DLT, rms per observation of the camera.

    ``points`` are the signed distances of single points where a marking has few.
    """

    ellipses: dict[str, Number] = {}
    homography: list[Number] | None = None
    camera: dict[str, Number] | None = None
    points: dict[str, list[Number]] | None = None


class CirclePointsRecord(RecordPart):
    """Points seen on a circle."""

    circle: str
    edge: CircleEdge
    points_px: list[Pair]
    sigma_px: list[Number]


class LineEndRecord(RecordPart):
    """Where the paint of a line is seen to end."""

    point_px: Pair
    crossed: bool


class LinePointsRecord(RecordPart):
    """Points seen on a line."""

    line: str | None
    points_px: list[Pair]
    sigma_px: list[Number]
    ends: list[LineEndRecord] = []


class MarkRecord(RecordPart):
    """A spot that was seen."""

    mark: str
    point_px: Pair
    sigma_px: Number


class KeypointRecord(RecordPart):
    """A point of known place that was seen; ``shift`` is how it moves with the width of the markings, the length and
    the width of the field, null where it does not.
    """

    name: Text
    field_m: Pair
    point_px: Pair
    sigma_px: Number
    shift: Annotated[list[Pair], Field(min_length=3, max_length=3)] | None = None


class ObservationsRecord(RecordPart):
    """What was seen."""

    circles: list[CirclePointsRecord] = []
    lines: list[LinePointsRecord] = []
    marks: list[MarkRecord] = []
    keypoints: list[KeypointRecord] = []

    def observations(self, image: ImageRecord) -> Observations:
        """What was seen, as it was given to the estimate but for the rounding."""
        return Observations(
            image.width,
            image.height,
            tuple(CirclePoints(c.circle, c.edge, as_points(c.points_px), as_array(c.sigma_px)) for c in self.circles),
            tuple(
                LinePoints(
                    s.line,
                    as_points(s.points_px),
                    as_array(s.sigma_px),
                    tuple(LineEnd(as_array(e.point_px), e.crossed) for e in s.ends),
                )
                for s in self.lines
            ),
            tuple(MarkPoint(m.mark, as_array(m.point_px), float(as_array(m.sigma_px))) for m in self.marks),
            tuple(
                Keypoint(
                    k.name,
                    as_array(k.field_m),
                    as_array(k.point_px),
                    float(as_array(k.sigma_px)),
                    None if k.shift is None else as_array(k.shift),
                )
                for k in self.keypoints
            ),
        )


class AloneRecord(RecordPart):
    """The verdict on a frame before ``circlecal rig``."""

    status: Status
    code: Text | None = None
    reason: Text | None = None


class PaintRecord(RecordPart):
    """The paint of the markings as a frame shows it: what it adds to blue, green and red of the surface, and whether
    that makes it lighter or darker; and the other paints on the floor, where it was told apart from them by its colour.
    """

    added_bgr: Triple
    polarity: Literal["light", "dark"]
    others_bgr: list[Triple] = Field(default_factory=list)


class LearntRecord(RecordPart):
    """What a frame that was refused alone was told by the others of its run: their field, the colour of their paint,
    how many frames agree on it; whether it was calibrated with it, and the verdict on it alone.
    """

    field: Text
    added_bgr: Triple
    frames: Count
    taken: bool
    alone: AloneRecord


class RigRecord(RecordPart):
    """The standing camera that took a frame, from ``circlecal rig`` or ``track``; from ``rig`` why it has none, and the
    verdict on it alone.
    """

    camera: Text | None = None
    reason: Text | None = None
    alone: AloneRecord | None = None


class HeadRecord(RecordPart):
    """How a tripod's head stands in a frame: its own angles, which differ from the camera's where its axis leans, and
    the logarithm of the focal length in pixels; each with its standard deviation.
    """

    pan_degrees: Number
    tilt_degrees: Number
    log_focal: Number
    pan_sigma_degrees: Number = None
    tilt_sigma_degrees: Number = None
    log_focal_sigma: Number = None


class TrackRecord(RecordPart):
    """What ``circlecal track`` knows of a frame beside its camera.

    ``frame`` counts the frames of the video as they are shown, ``shot`` its shots, both from 0, and ``carried_by``
    names what the answer rests on, the most important first. The name of its tripod is ``rig.camera``.
    """

    frame: Count
    shot: Count
    carried_by: list[str] = []
    head: HeadRecord | None = None


def as_array(values: Any) -> Array:
    """Numbers of a record; null is nan."""
    return np.asarray(values, dtype=np.float64)


def as_points(values: Any) -> Array:
    """Points (N, 2) of a record; null is nan."""
    return as_array(values).reshape(-1, 2)
