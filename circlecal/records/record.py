"""The result file: one JSON object per frame, written from a :class:`Calibration`, read back for projecting points.

The names of the keys are fixed; ``schema_version`` changes when they do. Numbers are finite; what was not reached or
not determined is null. A refused frame has no homography and no camera, but keeps what was seen and what was reached,
and ``rejected_estimate`` holds the homography and camera that the verdict did not trust.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from circlecal import __version__
from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.files import write_atomic
from circlecal.geometry.camera import Camera, PlaneCamera, camera_from_soccernet
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import FLAT, Surface, SurfaceShape
from circlecal.refusals import explain
from circlecal.results import Calibration, CameraFit, Correspondences, EllipseFit, EllipseFits, Verdict
from circlecal.view import FieldView

SCHEMA_VERSION = 1
POINT_DECIMALS = 3


def result_record(
    calibration: Calibration, template: FieldTemplate, *, time_s: float | None = None, digest: str | None = None
) -> dict[str, Any]:
    """The result file's content, ready for ``json.dumps(..., allow_nan=False)``.

    Parameters
    ----------
    calibration : Calibration
        What the pipeline returned.
    template : FieldTemplate
        The field that it ran with.
    time_s : float, optional
        Time of the frame in its video.
    digest : str, optional
        Digest of everything that the answer depends on beside the frame; that of the configuration when None.
    """
    accepted = calibration.status == "calibrated"
    fit = calibration.camera
    H_image_field, H_field_image = _homographies(calibration)
    camera = None if fit is None else _camera(fit)
    reached = H_image_field is not None or camera is not None
    record: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "version": __version__,
        "id": calibration.id,
        "source": {"path": calibration.source, "time_s": time_s},
        "image": {"width": calibration.width, "height": calibration.height},
        "field": {"template": template.name, "circle": calibration.circle_name, "sizes": template.sizes},
        **_verdict(calibration.verdict),
        "H_image_field": H_image_field if accepted else None,
        "H_field_image": H_field_image if accepted else None,
        "H_covariance": fit.H_covariance if accepted and fit is not None else None,
        "camera": camera if accepted else None,
        "rejected_estimate": {"H_image_field": H_image_field, "camera": camera} if reached and not accepted else None,
        **_circle_findings(calibration),
        "alternatives": _alternatives(calibration),
        "residuals_px": _residuals(calibration),
        "observations": None if calibration.observations is None else calibration.observations.to_json(),
        "timings_ms": {stage: round(time, 3) for stage, time in calibration.timings_ms.items()},
        "seed": calibration.seed,
        "config_digest": digest or calibration.config_digest,
    }
    finite: dict[str, Any] = _plain(record)
    return finite


def failed_record(
    frame_id: str, source: str, verdict: Verdict, seed: int, digest: str, time_s: float | None = None
) -> dict[str, Any]:
    """Record of a frame of a batch that never reached the pipeline, e.g. refused with ``unreadable_input``."""
    return {
        "schema_version": SCHEMA_VERSION,
        "version": __version__,
        "id": frame_id,
        "source": {"path": source, "time_s": time_s},
        "image": None,
        **_verdict(verdict),
        "H_image_field": None,
        "H_field_image": None,
        "camera": None,
        "seed": seed,
        "config_digest": digest,
    }


def _verdict(verdict: Verdict) -> dict[str, Any]:
    return {
        "status": verdict.status,
        "code": verdict.code,
        "stage": verdict.stage,
        "reason": verdict.reason,
        "help": None if verdict.code is None else explain(verdict.code, verdict.stage).help,
        "checks": [asdict(check) for check in verdict.checks],
    }


def _homographies(calibration: Calibration) -> tuple[Array | None, Array | None]:
    estimate = calibration.camera if calibration.camera is not None else calibration.homography
    return (None, None) if estimate is None else (estimate.H_image_field, estimate.H_field_image)


def _camera(fit: CameraFit) -> dict[str, Any]:
    return {
        **fit.camera.soccernet(),
        "crown_m": fit.surface.crown_m,
        "crown_shape": fit.surface.shape,
        "crown_radius_m": fit.surface.reference_m,
        "covariance": {"parameters": fit.parameters, "estimate": fit.theta, "matrix": fit.covariance},
        "derived_points": [asdict(point) for point in fit.derived_points],
        "named_lines": fit.named_lines,
        "rejected_observations": fit.rejected,
        "noise_scale": fit.noise_scale,
        "data_share": fit.data_share,
        "prior_dominated": fit.prior_dominated,
        "residual_correlation": fit.residual_correlation,
        "position_sigma_m": np.sqrt(np.diag(fit.covariance)[4:7]),
        "reference_m": fit.reference_m,
        "max_sigma_px": fit.max_sigma_px,
        "max_sigma_m": fit.max_sigma_m,
    }


def _circle_findings(calibration: Calibration) -> dict[str, Any]:
    """Case, ellipses, imaged centre, vanishing line, correspondences and inliers."""
    found = calibration.correspondences
    fit = calibration.camera
    center = fit.imaged_center_px if fit is not None else None if found is None else found.imaged_center[:2]
    return {
        "case": None if found is None else found.case,
        "ellipses": None if calibration.ellipses is None else _ellipses(calibration.ellipses),
        "imaged_center": center,
        "imaged_center_source": "camera" if fit is not None else None if found is None else found.center_source,
        "imaged_center_covariance": None if fit is None else fit.imaged_center_covariance,
        "vanishing_line": None if found is None else found.vanishing_line,
        "correspondences": None if found is None else _correspondences(found),
        "inliers": None if calibration.ellipses is None else _inliers(calibration.ellipses),
    }


def _ellipses(fits: EllipseFits) -> dict[str, Any]:
    written: dict[str, Any] = {"primary": fits.primary.edge if fits.all() else None}
    return written | {edge: _ellipse(getattr(fits, edge)) for edge in ("outer", "inner", "center")}


def _ellipse(fit: EllipseFit | None) -> dict[str, Any] | None:
    if fit is None:
        return None
    return {
        "conic": fit.conic,
        "center_px": fit.ellipse.center,
        "semi_axes_px": fit.ellipse.semi_axes,
        "angle_degrees": math.degrees(fit.ellipse.angle_rad),
        "covariance": fit.covariance,
        "method": fit.method,
        "rms_px": fit.rms_px,
        "arc_degrees": fit.arc_deg,
        "hypotheses": fit.hypotheses,
    }


def _inliers(fits: EllipseFits) -> dict[str, Any]:
    return {
        fit.edge: {
            "count": int(np.count_nonzero(fit.inliers)),
            "of": len(fit.inliers),
            "points_px": np.round(fit.points_px[fit.inliers], POINT_DECIMALS),
        }
        for fit in fits.all()
    }


def _correspondences(found: Correspondences) -> dict[str, Any]:
    return {
        "conic": found.conic,
        "radius_m": found.radius_m,
        "points": [
            {"label": p.label, "field_m": p.field_m, "image_px": p.image_px, "sigma_px": p.sigma_px}
            for p in found.points
        ],
        "tangents": [
            {"label": t.label, "field_line": t.field_line, "image_line": t.image_line} for t in found.tangents
        ],
    }


def _alternatives(calibration: Calibration) -> list[dict[str, Any]]:
    """The field turned by 180 degrees, which circle and halfway line cannot tell from the answer; only a prior can."""
    if calibration.camera is not None:
        turned = calibration.camera.camera.turned()
        return [{"kind": "turned_field", "H_image_field": turned.homography, "camera": turned.soccernet()}]
    if calibration.homography is not None:
        return [{"kind": "turned_field", "H_image_field": calibration.homography.H_image_field_turned, "camera": None}]
    return []


def _residuals(calibration: Calibration) -> dict[str, Any]:
    """Rms per fitted ellipse, rms per observation of the camera, one residual per correspondence of the DLT."""
    fits = () if calibration.ellipses is None else calibration.ellipses.all()
    return {
        "ellipses": {fit.edge: fit.rms_px for fit in fits},
        "homography": None if calibration.homography is None else calibration.homography.residuals_px,
        "camera": None if calibration.camera is None else calibration.camera.residuals_px,
    }


def _plain(value: Any) -> Any:
    """Arrays, tuples and numpy numbers as JSON knows them; what is not finite becomes null."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_result(path: Path, record: dict[str, Any]) -> None:
    """Write a result file, whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_atomic(path, (result_line(record) + "\n").encode())


def result_line(record: dict[str, Any]) -> str:
    """The record on one line."""
    return json.dumps(record, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


@dataclass(frozen=True, slots=True)
class StoredResult:
    """A result file, read back.

    Attributes
    ----------
    id, status, reason, width, height
        As written.
    H_image_field : (3, 3) array or None
        Field (metres) to undistorted pixels; None when refused.
    camera : Camera or None
        With the lens.
    surface : Surface
        With its crown; flat without a camera.
    covariance : (P, P) array or None
        Of the camera's parameters, in the order of :data:`circlecal.geometry.camera_parameters.PARAMETERS`.
    growth_m : (2,) array
        By how much the field was estimated to be longer and broader than its template.
    """

    id: str
    status: str
    reason: str | None
    width: int
    height: int
    H_image_field: Array | None
    camera: Camera | None
    surface: Surface
    covariance: Array | None
    growth_m: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def view(self) -> FieldView | None:
        """Where the field is seen, through the camera or else the homography; None without either."""
        if self.camera is not None:
            return FieldView(self.camera, self.surface, self.growth_m, self.covariance)
        if self.H_image_field is not None:
            return FieldView(PlaneCamera(self.width, self.height, self.H_image_field))
        return None


_READ = ConfigDict(extra="ignore", allow_inf_nan=False)
_Row = tuple[float, float, float]


class _ImageKeys(BaseModel):
    model_config = _READ

    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]


class _CovarianceKeys(BaseModel):
    model_config = _READ

    parameters: tuple[str, ...]
    matrix: list[list[float]]
    estimate: list[float] = Field(default_factory=list)

    @model_validator(mode="after")
    def _square(self) -> Self:
        if {len(self.matrix), *map(len, self.matrix)} != {len(self.parameters)}:
            raise ValueError(f"matrix is not {len(self.parameters)} x {len(self.parameters)}")
        return self


class _CameraKeys(BaseModel):
    model_config = _READ

    pan_degrees: float
    tilt_degrees: float
    roll_degrees: float
    position_meters: _Row
    x_focal_length: Annotated[float, Field(gt=0)]
    y_focal_length: Annotated[float, Field(gt=0)]
    principal_point: tuple[float, float]
    radial_distortion: Annotated[list[float], Field(min_length=2)]
    crown_m: float = 0.0
    crown_shape: SurfaceShape = "flat"
    crown_radius_m: Annotated[float, Field(gt=0)] = 1.0
    covariance: _CovarianceKeys | None = None


class _ResultKeys(BaseModel):
    model_config = _READ

    schema_version: int
    id: str
    status: str
    reason: str | None = None
    image: _ImageKeys | None
    H_image_field: tuple[_Row, _Row, _Row] | None
    camera: _CameraKeys | None


def read_result(path: Path) -> StoredResult:
    """Read what projecting points needs of a result file.

    Raises
    ------
    InputError
        Missing, no result of circlecal, of a newer version, or damaged.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror}; give a result file of circlecal calibrate"
        ) from error
    try:
        keys = _ResultKeys.model_validate_json(content)
    except ValidationError as error:
        raise _no_result(str(path), error) from error
    return _stored(keys, str(path))


def read_record(path: Path) -> dict[str, Any]:
    """Content of a result file.

    Raises
    ------
    InputError
        As :func:`read_result`.
    """
    read_result(path)
    content: dict[str, Any] = json.loads(path.read_bytes())
    return content


def stored_result(record: Mapping[str, Any], name: str) -> StoredResult:
    """What projecting points needs of a record; ``name`` says in errors where it comes from.

    Raises
    ------
    InputError
        As :func:`read_result`.
    """
    try:
        keys = _ResultKeys.model_validate(record)
    except ValidationError as error:
        raise _no_result(name, error) from error
    return _stored(keys, name)


def _no_result(name: str, error: ValidationError) -> InputError:
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    return InputError(f"{name}: is no result of circlecal calibrate: {where}{': ' * bool(where)}{first['msg']}")


def _stored(keys: _ResultKeys, name: str) -> StoredResult:
    if keys.schema_version != SCHEMA_VERSION:
        raise InputError(f"{name}: has schema_version {keys.schema_version}; this version reads {SCHEMA_VERSION}")
    size = keys.image or _ImageKeys(width=1, height=1)
    camera = keys.camera
    return StoredResult(
        id=keys.id,
        status=keys.status,
        reason=keys.reason,
        width=size.width,
        height=size.height,
        H_image_field=None if keys.H_image_field is None else np.asarray(keys.H_image_field, dtype=np.float64),
        camera=None if camera is None else camera_from_soccernet(camera.model_dump(), size.width, size.height),
        surface=FLAT if camera is None else Surface(camera.crown_shape, camera.crown_radius_m, camera.crown_m),
        covariance=None if camera is None else _covariance(camera.covariance),
        growth_m=_growth(None if camera is None else camera.covariance),
    )


def _growth(keys: _CovarianceKeys | None) -> Array:
    known = keys is not None and keys.parameters == PARAMETERS and len(keys.estimate) == len(PARAMETERS)
    return np.array([keys.estimate[INDEX[name]] if known and keys else 0.0 for name in ("length", "breadth")])


def _covariance(keys: _CovarianceKeys | None) -> Array | None:
    """The matrix, where it is that of the camera's parameters as this version knows them."""
    return np.asarray(keys.matrix, dtype=np.float64) if keys is not None and keys.parameters == PARAMETERS else None
