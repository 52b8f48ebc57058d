"""The result record: one JSON object per frame, written from a calibration, and read back by whoever needs it.

The names of the keys are fixed; ``schema_version`` changes when they do. Numbers are finite; what was not reached or
not determined is null. A refused frame has no homography and no camera, but keeps what was seen and what was reached,
and ``rejected_estimate`` holds the homography and camera that the verdict did not trust.

:class:`ResultRecord` is all of it. :class:`ResultRow` is what tables of many frames need: reading a line as one makes
nothing of the rest, which is most of it.
"""

from __future__ import annotations

from typing import Annotated, cast

import numpy as np
from pydantic import ConfigDict, Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.observations import Observations
from circlecal.records.parts import (
    AlternativeRecord,
    CameraRecord,
    CameraRow,
    CheckRecord,
    CorrespondencesRecord,
    Count,
    EllipsesRecord,
    EllipsesRow,
    EstimateRecord,
    EstimateRow,
    FieldCandidateRecord,
    FieldRecord,
    ImageRecord,
    InliersRecord,
    LearntRecord,
    Matrix,
    Number,
    ObservationsRecord,
    PaintRecord,
    Pair,
    RecordPart,
    RegionRecord,
    ResidualsRecord,
    RigRecord,
    SourceRecord,
    SportRecord,
    SquareMatrix,
    Text,
    TrackRecord,
    Triple,
    as_array,
)
from circlecal.results import Status

SCHEMA_VERSION = 1
NEAR_SHARE = 0.1
"""Of a limit: a value that is no further from it is said to be near."""


def _is_near(check: CheckRecord) -> bool:
    value, limit = check.value, check.limit
    if value is None or not limit or (value.is_integer() and limit.is_integer()):
        return False
    return abs(value - limit) <= NEAR_SHARE * abs(limit)


def _leave_out_damage(part: object, read: ValidatorFunctionWrapHandler) -> ImageRecord | None:
    """A picture's size as it is read; None where it is damaged, since a row is worth reading without."""
    try:
        return cast(ImageRecord | None, read(part))
    except ValidationError:
        return None


class ResultRow(RecordPart):
    """Of a record, what tables of many frames need."""

    schema_version: int
    version: Text | None = None
    id: Text
    source: SourceRecord | None = None
    image: Annotated[ImageRecord | None, WrapValidator(_leave_out_damage)] = None
    field: FieldRecord | None = None
    status: Status
    code: Text | None = None
    stage: Text | None = None
    reason: Text | None = None
    case: Annotated[int, Field(ge=1, le=3)] | None = None
    camera: CameraRow | None = None
    rejected_estimate: EstimateRow | None = None
    ellipses: EllipsesRow | None = None
    timings_ms: dict[str, Number] | None = None
    seed: Count | None = None
    config_digest: Text | None = None
    rig: RigRecord | None = None
    annotation: Text | None = None
    track: TrackRecord | None = None
    paint: PaintRecord | None = None
    learnt: LearntRecord | None = None

    @property
    def path(self) -> str | None:
        """The frame's file or address."""
        return None if self.source is None else self.source.path

    @property
    def estimated_camera(self) -> CameraRow | None:
        """The camera, also one that the verdict did not trust."""
        return self.camera or (self.rejected_estimate.camera if self.rejected_estimate else None)

    @property
    def picture_width(self) -> int | None:
        """Width of the picture, pixels; where the record does not say it, that of one whose middle is where the
        camera's lens points, and None where there is no camera either.
        """
        if self.image is not None:
            return self.image.width
        middle = None if self.estimated_camera is None else self.estimated_camera.principal_point[0]
        return None if middle is None or not 0.0 <= middle < 2.0**30 else round(2.0 * middle) + 1


class ResultRecord(ResultRow):
    """A frame's whole record; keys that this version does not know stay in it."""

    model_config = ConfigDict(extra="allow")

    help: Text | None = None
    image: ImageRecord | None = None
    checks: list[CheckRecord] = Field(default_factory=list)
    H_image_field: Matrix | None = None
    H_field_image: Matrix | None = None
    H_covariance: SquareMatrix | None = None
    region: RegionRecord | None = None
    camera: CameraRecord | None = None
    rejected_estimate: EstimateRecord | None = None
    ellipses: EllipsesRecord | None = None
    imaged_center: Pair | None = None
    imaged_center_source: str | None = None
    imaged_center_covariance: tuple[Pair, Pair] | None = None
    vanishing_line: Triple | None = None
    correspondences: CorrespondencesRecord | None = None
    no_correspondences: Text | None = None
    inliers: dict[str, InliersRecord] | None = None
    alternatives: list[AlternativeRecord] = Field(default_factory=list)
    fields: list[FieldCandidateRecord] | None = None
    sport: SportRecord | None = None
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
        """What the verdict hangs on, as ``sigma_px 5.62 of 6``: checks of a calibrated frame that only just passed, or
        those of a refused one that failed, where all of them only just did. Another seed, release or encoding of the
        picture may end on the other side. Counts, which are whole numbers, are never near.
        """
        if self.status == "calibrated":
            near = [check for check in self.checks if _is_near(check)]
        else:
            failed = [check for check in self.checks if not check.passed]
            near = failed if all(map(_is_near, failed)) else []
        return [f"{check.name} {check.value:.3g} of {check.limit:.3g}" for check in near]

    @property
    def field_size_m(self) -> tuple[Number, Number]:
        """Length and width of the field as it was calibrated, metres; None of a refused frame."""
        if self.camera is None or self.field is None:
            return None, None
        size, sizes = self.camera.field_size, self.field.sizes or {}
        if size is not None:
            return size.length_m, size.width_m
        # a camera that frames share, or a venue, has sizes of its own, which it tells beside its other parameters
        told, stated = self.camera.covariance, (sizes.get("length"), sizes.get("width"))
        if told is None or not told.is_known or None in stated:
            return stated
        length_m, width_m = (None if s is None else s + g for s, g in zip(stated, told.growth_m.tolist(), strict=True))
        return length_m, width_m

    @property
    def seen(self) -> Observations | None:
        """What was seen; None where that was not reached."""
        return self.observations.observations(self.image) if self.observations and self.image else None

    def _view(self, camera: CameraRecord | None, H: Matrix | None) -> FieldView | None:
        if self.image is None:
            return None
        if camera is not None:
            return camera.view(self.image)
        H_image_field = as_array(H) if H is not None else np.full((3, 3), np.nan)
        if not np.isfinite(H_image_field).all():
            return None
        return FieldView(PlaneCamera(self.image.width, self.image.height, H_image_field))
