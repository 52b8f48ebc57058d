"""The result record: one JSON object per frame, written from a calibration, and read back by whoever needs it.

The names of the keys are fixed; ``schema_version`` changes when they do. Numbers are finite; what was not reached or
not determined is null. A refused frame has no homography and no camera, but keeps what was seen and what was reached,
and ``rejected_estimate`` holds the homography and camera that the verdict did not trust.

:class:`ResultRecord` is all of it. :class:`ResultRow` is what tables of many frames need: reading a line as one makes
nothing of the rest, which is most of it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, InstanceOf, ValidationError, model_validator
from pydantic_core import PydanticSerializationError

from circlecal.errors import InputError
from circlecal.field.view import FieldView
from circlecal.files import read_file, write_atomic
from circlecal.geometry.camera import Camera, PlaneCamera, camera_from_soccernet
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.observations import CircleEdge, CirclePoints, Keypoint, LineEnd, LinePoints, MarkPoint, Observations
from circlecal.results import Status

SCHEMA_VERSION = 1
NEAR_SHARE = 0.1
"""Of a limit: a value that is no further from it is said to be near."""
GIVE_A_RESULT = "give a result file of circlecal calibrate"

Text = InstanceOf[str]
"""A name from outside, which need not be text that any encoding can write."""
Number = float | None
Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]
Matrix = tuple[Triple, Triple, Triple]


def _require_square(rows: list[list[Number]]) -> list[list[Number]]:
    if any(len(row) != len(rows) for row in rows):
        raise ValueError(f"is no square matrix: {len(rows)} rows of {', '.join(sorted({str(len(r)) for r in rows}))}")
    return rows


SquareMatrix = Annotated[list[list[Number]], AfterValidator(_require_square)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False, frozen=True)


class SourceRecord(_Part):
    """Where a frame comes from: its file or address, and its time in a video."""

    path: Text | None = None
    time_s: Number = None


class FieldRecord(_Part):
    """The field template and its circle."""

    template: Text
    circle: Text | None = None
    sizes: dict[str, float] | None = None


class ImageRecord(_Part):
    """Size of a frame, pixels."""

    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]


class CheckRecord(_Part):
    """One gate of the verdict."""

    name: str
    value: Number
    limit: Number
    passed: bool


class CovarianceRecord(_Part):
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
            own = _array(self.matrix)
        else:
            factor = np.zeros((len(self.factor), len(self.factor)))
            for row, numbers in enumerate(self.factor):
                factor[row, : len(numbers)] = numbers
            own = factor @ factor.T
        places = self._places
        covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
        covariance[np.ix_(places, places)] = own
        return covariance

    def theta(self) -> Array:
        """The estimate (P,) of all parameters of the camera model, zero where it is not written."""
        theta = np.zeros(len(PARAMETERS))
        if len(self.estimate) == len(self.parameters):
            theta[self._places] = _array(self.estimate)
        return theta

    @property
    def _places(self) -> list[int]:
        return [INDEX[name] for name in self.parameters]


class CameraRow(_Part):
    """Of a camera, what tables need."""

    pan_degrees: Number
    tilt_degrees: Number
    roll_degrees: Number
    position_meters: Triple
    x_focal_length: Number
    y_focal_length: Number
    principal_point: Pair
    radial_distortion: Annotated[list[Number], Field(min_length=2)]
    tangential_distortion: list[Number] = []
    thin_prism_distortion: list[Number] = []
    crown_m: Number = 0.0
    crown_shape: SurfaceShape = "flat"
    crown_radius_m: Number = 1.0
    position_sigma_m: Triple | None = None
    max_sigma_px: Number = None
    max_sigma_m: Number = None


class DerivedPointRecord(_Part):
    """A point of the circle as the camera puts it."""

    label: str
    field_m: Pair
    image_px: Pair
    covariance: tuple[Pair, Pair]


class FieldSizeRecord(_Part):
    """How long and broad the field is."""

    length_m: float
    width_m: float
    length_sd_m: float
    width_sd_m: float
    is_usual: bool
    usual_share: float


class CameraRecord(CameraRow):
    """A camera: SoccerNet's keys at the frame's own size, and circlecal's own."""

    covariance: CovarianceRecord | None = None
    derived_points: list[DerivedPointRecord] = []
    named_lines: list[str] = []
    rejected_observations: list[str] = []
    noise_scale: Number = None
    data_share: Number = None
    prior_dominated: bool | None = None
    residual_correlation: Number = None
    reference_m: Pair | None = None
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
        growth = known.theta()[[INDEX["length"], INDEX["breadth"]]]
        return FieldView(camera, self.surface, growth, known.full())


class EstimateRow(_Part):
    """Of an estimate that the verdict did not trust, what tables need."""

    camera: CameraRow | None = None


class EstimateRecord(EstimateRow):
    """An estimate that the verdict did not trust."""

    H_image_field: Matrix | None = None
    camera: CameraRecord | None = None


class EllipseRow(_Part):
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


class EllipsesRow(_Part):
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


class PointRecord(_Part):
    """A derived point."""

    label: str
    field_m: Pair
    image_px: Pair
    sigma_px: Number = None


class TangentRecord(_Part):
    """A derived tangent."""

    label: str
    field_line: Triple
    image_line: Triple


class CorrespondencesRecord(_Part):
    """The paper's points and tangents, and the conic that they were derived from."""

    conic: Matrix
    radius_m: Number
    points: list[PointRecord]
    tangents: list[TangentRecord]


class InliersRecord(_Part):
    """Points of one edge that its ellipse was fitted to, of how many."""

    count: int
    of: int
    points_px: list[Pair]


class AlternativeRecord(_Part):
    """Another solution of a real ambiguity."""

    kind: str
    H_image_field: Matrix
    camera: CameraRow | None = None
    circle: Text | None = None
    evidence: Number = None


class FieldCandidateRecord(_Part):
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


class ResidualsRecord(_Part):
    """Rms per fitted ellipse, one residual per row of the DLT, rms per observation of the camera.

    ``points`` are the signed distances of single points where a marking has few.
    """

    ellipses: dict[str, Number] = {}
    homography: list[Number] | None = None
    camera: dict[str, Number] | None = None
    points: dict[str, list[Number]] | None = None


class CirclePointsRecord(_Part):
    """Points seen on a circle."""

    circle: str
    edge: CircleEdge
    points_px: list[Pair]
    sigma_px: list[Number]


class LineEndRecord(_Part):
    """Where the paint of a line is seen to end."""

    point_px: Pair
    crossed: bool


class LinePointsRecord(_Part):
    """Points seen on a line."""

    line: str | None
    points_px: list[Pair]
    sigma_px: list[Number]
    ends: list[LineEndRecord] = []


class MarkRecord(_Part):
    """A spot that was seen."""

    mark: str
    point_px: Pair
    sigma_px: Number


class KeypointRecord(_Part):
    """A point of known place that was seen."""

    name: Text
    field_m: Pair
    point_px: Pair
    sigma_px: Number


class ObservationsRecord(_Part):
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
            tuple(CirclePoints(c.circle, c.edge, _points(c.points_px), _array(c.sigma_px)) for c in self.circles),
            tuple(
                LinePoints(
                    s.line,
                    _points(s.points_px),
                    _array(s.sigma_px),
                    tuple(LineEnd(_array(e.point_px), e.crossed) for e in s.ends),
                )
                for s in self.lines
            ),
            tuple(MarkPoint(m.mark, _array(m.point_px), float(_array(m.sigma_px))) for m in self.marks),
            tuple(
                Keypoint(k.name, _array(k.field_m), _array(k.point_px), float(_array(k.sigma_px)))
                for k in self.keypoints
            ),
        )


class AloneRecord(_Part):
    """The verdict on a frame before ``circlecal rig``."""

    status: Status
    code: Text | None = None
    reason: Text | None = None


class RigRecord(_Part):
    """The standing camera that took a frame, from ``circlecal rig`` or ``track``; from ``rig`` why it has none, and the
    verdict on it alone.
    """

    camera: Text | None = None
    reason: Text | None = None
    alone: AloneRecord | None = None


class HeadRecord(_Part):
    """How a tripod's head stands in a frame: its own angles, which differ from the camera's where its axis leans, and
    the logarithm of the focal length in pixels; each with its standard deviation.
    """

    pan_degrees: Number
    tilt_degrees: Number
    log_focal: Number
    pan_sigma_degrees: Number = None
    tilt_sigma_degrees: Number = None
    log_focal_sigma: Number = None


class TrackRecord(_Part):
    """What ``circlecal track`` knows of a frame beside its camera.

    ``frame`` counts the frames of the video, ``shot`` its shots, both from 0, and ``carried_by`` names what the answer
    rests on, the most important first. The name of its tripod is ``rig.camera``.
    """

    frame: int
    shot: int
    carried_by: list[str] = []
    head: HeadRecord | None = None


class ResultRow(_Part):
    """Of a record, what tables of many frames need."""

    schema_version: int
    version: Text | None = None
    id: Text
    source: SourceRecord | None = None
    field: FieldRecord | None = None
    status: Status
    code: Text | None = None
    stage: Text | None = None
    reason: Text | None = None
    case: int | None = None
    camera: CameraRow | None = None
    rejected_estimate: EstimateRow | None = None
    ellipses: EllipsesRow | None = None
    timings_ms: dict[str, Number] | None = None
    seed: int | None = None
    config_digest: Text | None = None
    rig: RigRecord | None = None
    annotation: Text | None = None
    track: TrackRecord | None = None

    @property
    def path(self) -> str | None:
        """The frame's file or address."""
        return None if self.source is None else self.source.path

    @property
    def estimated_camera(self) -> CameraRow | None:
        """The camera, also one that the verdict did not trust."""
        return self.camera or (self.rejected_estimate.camera if self.rejected_estimate else None)


class ResultRecord(ResultRow):
    """A frame's whole record; keys that this version does not know stay in it."""

    model_config = ConfigDict(extra="allow")

    help: Text | None = None
    image: ImageRecord | None = None
    checks: list[CheckRecord] = []
    H_image_field: Matrix | None = None
    H_field_image: Matrix | None = None
    H_covariance: SquareMatrix | None = None
    camera: CameraRecord | None = None
    rejected_estimate: EstimateRecord | None = None
    ellipses: EllipsesRecord | None = None
    imaged_center: Pair | None = None
    imaged_center_source: str | None = None
    imaged_center_covariance: tuple[Pair, Pair] | None = None
    vanishing_line: Triple | None = None
    correspondences: CorrespondencesRecord | None = None
    inliers: dict[str, InliersRecord] | None = None
    alternatives: list[AlternativeRecord] = []
    fields: list[FieldCandidateRecord] | None = None
    residuals_px: ResidualsRecord | None = None
    observations: ObservationsRecord | None = None

    @property
    def width(self) -> int:
        """Width of the picture; 1 where it was never read."""
        return self.image.width if self.image else 1

    @property
    def height(self) -> int:
        """Height of the picture; 1 where it was never read."""
        return self.image.height if self.image else 1

    @property
    def view(self) -> FieldView | None:
        """Where the field is seen, through the camera or else the homography; None without either."""
        return self._view(self.camera, self.H_image_field)

    @property
    def estimated_view(self) -> FieldView | None:
        """Where the field is seen, also through an estimate that the verdict did not trust."""
        if self.rejected_estimate is None:
            return self.view
        return self._view(self.rejected_estimate.camera, self.rejected_estimate.H_image_field)

    @property
    def near_limits(self) -> list[str]:
        """Checks that only just passed, or only just failed, as ``sigma_px 5.62 of 6``: another seed, release or
        encoding of the picture may end on the other side. Counts, which are whole numbers, are left out.
        """
        return [
            f"{check.name} {check.value:.3g} of {check.limit:.3g}"
            for check in self.checks
            if check.value is not None
            and check.limit
            and not (check.value.is_integer() and check.limit.is_integer())
            and abs(check.value - check.limit) <= NEAR_SHARE * abs(check.limit)
        ]

    @property
    def seen(self) -> Observations | None:
        """What was seen; None where that was not reached."""
        return self.observations.observations(self.image) if self.observations and self.image else None

    def _view(self, camera: CameraRecord | None, H: Matrix | None) -> FieldView | None:
        if self.image is None:
            return None
        if camera is not None:
            return camera.view(self.image)
        H_image_field = _array(H) if H is not None else np.full((3, 3), np.nan)
        if not np.isfinite(H_image_field).all():
            return None
        return FieldView(PlaneCamera(self.image.width, self.image.height, H_image_field))


Record = TypeVar("Record", bound=ResultRow)


def _array(values: Any) -> Array:
    """Numbers of a record; null is nan."""
    return np.asarray(values, dtype=np.float64)


def _points(values: Any) -> Array:
    return _array(values).reshape(-1, 2)


def write_result(path: Path, record: ResultRecord) -> None:
    """Write a result file, whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_atomic(path, (result_line(record) + "\n").encode())


def result_line(record: ResultRecord) -> str:
    """The record on one line, with the keys that were given."""
    try:
        return record.model_dump_json(exclude_unset=True)
    except PydanticSerializationError:  # a name that no encoding can write
        return json.dumps(record.model_dump(exclude_unset=True), allow_nan=False, separators=(",", ":"))


def read_result(path: Path) -> ResultRecord:
    """Read a result file.

    Raises
    ------
    InputError
        Missing, no result of circlecal, of another version, or damaged.
    """
    try:
        content = read_file(path)
    except InputError as error:
        raise InputError(f"{error}; {GIVE_A_RESULT}") from error
    return parse_record(content, ResultRecord, str(path), GIVE_A_RESULT)


def parse_record(content: bytes, model: type[Record], name: str, mend: str) -> Record:
    """A record from its JSON text.

    Parameters
    ----------
    content : bytes
        The text.
    model : type
        :class:`ResultRecord`, or :class:`ResultRow` for no more than tables need.
    name, mend : str
        Where the text stands, and what to do about damage, for messages.

    Raises
    ------
    InputError
        No result of circlecal, of another version, or damaged.
    """
    try:
        record = _validate(content, model)
    except ValidationError as error:
        version = _version_of(content)
        if version in (None, SCHEMA_VERSION):
            raise InputError(f"{name}: is no result: {explain_damage(error)}; {mend}") from error
    else:
        version = record.schema_version
        if version == SCHEMA_VERSION:
            return record
    raise InputError(f"{name}: has schema_version {version}; this version reads {SCHEMA_VERSION}")


def _validate(content: bytes, model: type[Record]) -> Record:
    try:
        return model.model_validate_json(content)
    except ValidationError:
        if b"\\ud" not in content:
            raise
    try:
        value = json.loads(content)  # which takes a name that no encoding can write, as the model's parser does not
    except (ValueError, RecursionError):
        return model.model_validate_json(content)
    return model.model_validate(value, strict=False)


def parse_sound_parts(content: bytes) -> ResultRecord:
    """A record from its JSON text without those of its keys whose content is damaged.

    Raises
    ------
    ValueError
        Not even what every record has is sound.
    """
    try:
        return _validate(content, ResultRecord)
    except ValidationError as error:
        damaged = {problem["loc"][0] for problem in error.errors(include_url=False) if problem["loc"]}
        value = json.loads(content)
        return ResultRecord.model_validate({k: v for k, v in value.items() if k not in damaged}, strict=False)


def is_record(content: bytes) -> bool | None:
    """Whether a JSON text is meant to be a record, sound or not; None where it is no JSON."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        return None
    return isinstance(value, dict) and value.keys() >= {"schema_version", "status"}


def _version_of(content: bytes) -> Any:
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        return None
    return value.get("schema_version") if isinstance(value, dict) else None


def explain_damage(error: ValidationError) -> str:
    """The first thing that is wrong with a record, as field and words."""
    first = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "missing":
        return f"{where} is missing"
    return f"{where}{': ' * bool(where)}{first['msg'].removeprefix('Value error, ')}"


def to_mapping(record: ResultRecord) -> dict[str, Any]:
    """The record as JSON's own types."""
    content: dict[str, Any] = json.loads(result_line(record))
    return content
