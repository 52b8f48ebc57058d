"""A record as the stages' results that it was written from, as far as it holds them."""

from __future__ import annotations

from typing import Any

import numpy as np

from circlecal.geometry.camera_parameters import PARAMETERS
from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.projective import Array
from circlecal.observations import CircleEdge, MarkingKey
from circlecal.records.parts import (
    EllipseRecord,
    EstimateRecord,
    InliersRecord,
    Matrix,
    Number,
    RegionRecord,
    ResidualsRecord,
)
from circlecal.records.record import ResultRecord
from circlecal.results import (
    Attempt,
    CameraFit,
    Check,
    Correspondences,
    DerivedPoint,
    EllipseFit,
    EllipseFits,
    FieldSize,
    FrameCalibration,
    HomographyFit,
    HomographyRegion,
    LineCorrespondence,
    PointCorrespondence,
    Verdict,
)


def calibration_of_record(record: ResultRecord) -> FrameCalibration:
    """The calibration of a record, without mask, edges, rays and cues, and with the inliers as the only edge points.

    A refused frame has the estimate that the verdict did not trust.
    """
    estimate = EstimateRecord(H_image_field=record.H_image_field, camera=record.camera)
    if record.status != "calibrated":
        estimate = record.rejected_estimate or EstimateRecord()
    camera = _camera(record, estimate)
    checks = tuple(
        Check(check.name, _number(check.value), _number(check.limit), check.passed) for check in record.checks
    )
    attempt = Attempt(
        ellipses=_ellipses(record),
        observations=record.seen,
        correspondences=_correspondences(record),
        no_correspondences=record.no_correspondences,
        homography=None if camera is not None else _homography(record, estimate.H_image_field),
        camera=camera,
        verdict=Verdict(record.status, record.code, record.reason, record.stage, checks),
    )
    return FrameCalibration(
        id=record.id,
        width=record.image.width if record.image else 0,
        height=record.image.height if record.image else 0,
        field_name=record.field.template if record.field else "",
        circle_name=(record.field and record.field.circle) or "",
        attempt=attempt,
        seed=record.seed or 0,
        config_digest=record.config_digest or "",
        timings_ms={stage: _number(time) for stage, time in (record.timings_ms or {}).items()},
        source=record.path,
    )


def _array(value: Any) -> Array:
    """Numbers of a record; null, which stands for what is not finite, becomes nan."""
    return np.array(value, dtype=np.float64)


def _number(value: Number) -> float:
    return np.inf if value is None else value


def _camera(record: ResultRecord, estimate: EstimateRecord) -> CameraFit | None:
    keys, H_image_field = estimate.camera, estimate.H_image_field
    view = None if keys is None or record.image is None else keys.pinhole(record.image)
    known = None if keys is None else keys.covariance
    if keys is None or view is None or H_image_field is None or known is None:
        return None
    residuals = record.residuals_px or ResidualsRecord()
    return CameraFit(
        camera=view,
        surface=keys.surface,
        parameters=PARAMETERS if known.is_known else known.parameters,
        covariance=known.full() if known.is_known else _array(known.matrix),
        H_image_field=_array(H_image_field),
        H_field_image=_array(record.H_field_image or np.linalg.inv(_array(H_image_field))),
        H_covariance=np.full((8, 8), np.nan) if record.H_covariance is None else _array(record.H_covariance),
        imaged_center_px=_array(record.imaged_center or (np.nan, np.nan)),
        imaged_center_covariance=_array(record.imaged_center_covariance or np.full((2, 2), np.nan)),
        noise_scale=_number(keys.noise_scale),
        data_share=_number(keys.data_share),
        max_sigma_px=_number(keys.max_sigma_px),
        max_sigma_m=_number(keys.max_sigma_m),
        residuals_px={MarkingKey.parse(name): _number(value) for name, value in (residuals.camera or {}).items()},
        point_residuals_px={MarkingKey.parse(name): _array(off) for name, off in (residuals.points or {}).items()},
        theta=known.theta() if known.is_known else _array(known.estimate),
        residual_correlation=_number(keys.residual_correlation),
        derived_points=tuple(
            DerivedPoint(p.label, _array(p.field_m), _array(p.image_px), _array(p.covariance))
            for p in keys.derived_points
        ),
        rejected=tuple(map(MarkingKey.parse, keys.rejected_observations)),
        named_lines=tuple(keys.named_lines),
        reference_m=_array(keys.reference_m or (0.0, 0.0)),
        reference_by_growth=_array(keys.reference_by_growth or (0.0, 0.0)),
        field_size=None if keys.field_size is None else FieldSize(**keys.field_size.model_dump()),
        region=None if record.region is None else _region(record.region),
    )


def _region(region: RegionRecord) -> HomographyRegion:
    return HomographyRegion(
        _array(region.field_m), _array(region.image_px), _array(region.covariance), region.directions
    )


def _homography(record: ResultRecord, H_image_field: Matrix | None) -> HomographyFit | None:
    if H_image_field is None:
        return None
    H, inverse = _array(H_image_field), _array(np.linalg.inv(_array(H_image_field)))
    turned = next((a.H_image_field for a in record.alternatives if a.kind == "turned_field"), H_image_field)
    residuals = _array((record.residuals_px and record.residuals_px.homography) or [])
    return HomographyFit(H, inverse, _array(turned), residuals, condition=np.nan, null_ratio=np.nan)


def _ellipses(record: ResultRecord) -> EllipseFits | None:
    written, inliers = record.ellipses, record.inliers or {}
    if written is None:
        return None
    return EllipseFits(
        _ellipse("outer", written.outer, inliers.get("outer")),
        _ellipse("inner", written.inner, inliers.get("inner")),
        _ellipse("center", written.center, inliers.get("center")),
    )


def _ellipse(edge: CircleEdge, keys: EllipseRecord | None, inliers: InliersRecord | None) -> EllipseFit | None:
    if keys is None:
        return None
    points = _array(inliers.points_px if inliers else []).reshape(-1, 2)
    axes = _array(keys.semi_axes_px)
    return EllipseFit(
        edge=edge,
        conic=_array(keys.conic),
        covariance=_array(keys.covariance),
        ellipse=Ellipse(_array(keys.center_px), (axes[0], axes[1]), np.radians(_number(keys.angle_degrees))),
        method=keys.method or "",
        points_px=points,
        sigma_px=np.full(len(points), np.nan),
        inliers=np.ones(len(points), np.bool_),
        rms_px=_number(keys.rms_px),
        arc_deg=_number(keys.arc_degrees),
        hypotheses=keys.hypotheses or 0,
    )


def _correspondences(record: ResultRecord) -> Correspondences | None:
    keys, center = record.correspondences, record.imaged_center
    if keys is None or center is None or record.case is None:
        return None
    return Correspondences(
        case=record.case,
        conic=_array(keys.conic),
        radius_m=_number(keys.radius_m),
        imaged_center=np.append(_array(center), 1.0),
        center_source=record.imaged_center_source or "",
        vanishing_line=_array(record.vanishing_line),
        points=tuple(
            PointCorrespondence(p.label, _array(p.field_m), _array(p.image_px), p.sigma_px) for p in keys.points
        ),
        tangents=tuple(LineCorrespondence(t.label, _array(t.field_line), _array(t.image_line)) for t in keys.tangents),
    )
