"""A record as the stages' results that it was written from, as far as it holds them."""

from __future__ import annotations

from typing import Any

import numpy as np

from circlecal.geometry.camera_parameters import PARAMETERS
from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.projective import Array
from circlecal.observations import CircleEdge, MarkingKey
from circlecal.records.parts import (
    DerivedPointRecord,
    EllipseRecord,
    EstimateRecord,
    InliersRecord,
    Matrix,
    Number,
    RegionRecord,
    ResidualsRecord,
    as_array,
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
    estimate = _estimate(record)
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


def _estimate(record: ResultRecord) -> EstimateRecord:
    """The estimate of an accepted frame, or the one that the verdict did not trust."""
    if record.status != "calibrated":
        return record.rejected_estimate or EstimateRecord()
    return EstimateRecord(H_image_field=record.H_image_field, camera=record.camera)


def _array_or(value: Any, missing: Any) -> Array:
    """Numbers of a record, or what stands for them where it has none."""
    return as_array(missing if value is None else value)


def _number(value: Number) -> float:
    """A number of a record; null, which stands for what is not finite, becomes infinite."""
    return np.inf if value is None else value


def _camera(record: ResultRecord, estimate: EstimateRecord) -> CameraFit | None:
    """The camera of an estimate with what the record says of its fit; None where the record lacks a part of it."""
    keys = estimate.camera
    if keys is None or record.image is None or estimate.H_image_field is None or keys.covariance is None:
        return None
    camera = keys.pinhole(record.image)
    if camera is None:
        return None
    known = keys.covariance
    residuals = record.residuals_px or ResidualsRecord()
    return CameraFit(
        camera=camera,
        surface=keys.surface,
        parameters=PARAMETERS if known.is_known else known.parameters,
        covariance=known.full() if known.is_known else as_array(known.matrix),
        H_covariance=_array_or(record.H_covariance, np.full((8, 8), np.nan)),
        imaged_center_px=_array_or(record.imaged_center, (np.nan, np.nan)),
        imaged_center_covariance=_array_or(record.imaged_center_covariance, np.full((2, 2), np.nan)),
        noise_scale=_number(keys.noise_scale),
        data_share=np.nan if keys.data_share is None else keys.data_share,
        max_sigma_px=_number(keys.max_sigma_px),
        max_sigma_m=_number(keys.max_sigma_m),
        mean_sigma_px=_number(keys.mean_sigma_px),
        residuals_px={MarkingKey.parse(name): _number(value) for name, value in (residuals.camera or {}).items()},
        point_residuals_px={MarkingKey.parse(name): as_array(off) for name, off in (residuals.points or {}).items()},
        theta=known.theta() if known.is_known else as_array(known.estimate),
        residual_correlation=_number(keys.residual_correlation),
        derived_points=tuple(map(_circle_point, keys.derived_points)),
        rejected=tuple(map(MarkingKey.parse, keys.rejected_observations)),
        named_lines=tuple(keys.named_lines),
        reference_m=_array_or(keys.reference_m, (0.0, 0.0)),
        reference_by_growth=_array_or(keys.reference_by_growth, (0.0, 0.0)),
        field_size=None if keys.field_size is None else FieldSize(**keys.field_size.model_dump()),
        region=None if record.region is None else _region(record.region),
    )


def _circle_point(point: DerivedPointRecord) -> DerivedPoint:
    return DerivedPoint(point.label, as_array(point.field_m), as_array(point.image_px), as_array(point.covariance))


def _region(region: RegionRecord) -> HomographyRegion:
    return HomographyRegion(
        as_array(region.field_m), as_array(region.image_px), as_array(region.covariance), region.directions
    )


def _homography(record: ResultRecord, H_image_field: Matrix | None) -> HomographyFit | None:
    if H_image_field is None:
        return None
    H = as_array(H_image_field)
    turned = next((a.H_image_field for a in record.alternatives if a.kind == "turned_field"), H_image_field)
    residuals = as_array((record.residuals_px and record.residuals_px.homography) or [])
    return HomographyFit(H, as_array(turned), residuals, condition=np.nan, null_ratio=np.nan)


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
    points = as_array(inliers.points_px if inliers else []).reshape(-1, 2)
    axes = as_array(keys.semi_axes_px)
    return EllipseFit(
        edge=edge,
        conic=as_array(keys.conic),
        covariance=as_array(keys.covariance),
        ellipse=Ellipse(as_array(keys.center_px), (axes[0], axes[1]), np.radians(_number(keys.angle_degrees))),
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
        conic=as_array(keys.conic),
        radius_m=_number(keys.radius_m),
        imaged_center=np.append(as_array(center), 1.0),
        center_source=record.imaged_center_source or "",
        vanishing_line=as_array(record.vanishing_line),
        points=tuple(
            PointCorrespondence(p.label, as_array(p.field_m), as_array(p.image_px), p.sigma_px) for p in keys.points
        ),
        tangents=tuple(
            LineCorrespondence(t.label, as_array(t.field_line), as_array(t.image_line)) for t in keys.tangents
        ),
    )
