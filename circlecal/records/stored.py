"""A result file's content as the stages' results that it was written from, as far as the file holds them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from circlecal.geometry.camera import camera_from_soccernet
from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations
from circlecal.results import (
    Attempt,
    Calibration,
    CameraFit,
    Check,
    Correspondences,
    DerivedPoint,
    EllipseFit,
    EllipseFits,
    HomographyFit,
    LineCorrespondence,
    PointCorrespondence,
    Verdict,
)

_Record = Mapping[str, Any]


def stored_calibration(record: _Record) -> Calibration:
    """The calibration of a record, without mask, edges, rays and cues, and with the inliers as the only edge points.

    A refused frame has the estimate that the verdict did not trust.

    Parameters
    ----------
    record : mapping
        Content of a result file, or a line of ``results.jsonl``.
    """
    image, field = record.get("image") or {}, record.get("field") or {}
    estimate = record if record["status"] == "calibrated" else record.get("rejected_estimate") or {}
    width, height = image.get("width", 0), image.get("height", 0)
    observations = record.get("observations")
    camera = _camera(record, estimate, width, height)
    attempt = Attempt(
        ellipses=_ellipses(record),
        observations=None if observations is None else Observations.from_json(observations, width, height),
        correspondences=_correspondences(record),
        homography=None if camera is not None else _homography(record, estimate),
        camera=camera,
        verdict=Verdict(
            record["status"],
            record.get("code"),
            record.get("reason"),
            record.get("stage"),
            tuple(Check(**check) for check in record.get("checks", ())),
        ),
    )
    return Calibration(
        id=record["id"],
        width=width,
        height=height,
        field_name=field.get("template", ""),
        circle_name=field.get("circle", ""),
        attempt=attempt,
        seed=record.get("seed", 0),
        config_digest=record.get("config_digest", ""),
        timings_ms=record.get("timings_ms") or {},
        source=(record.get("source") or {}).get("path"),
    )


def _array(value: Any) -> Array:
    """Null, which stands for what is not finite, becomes nan."""
    return np.array(value, dtype=np.float64)


def _camera(record: _Record, estimate: _Record, width: int, height: int) -> CameraFit | None:
    keys, H_image_field = estimate.get("camera"), estimate.get("H_image_field")
    if keys is None or H_image_field is None:
        return None
    covariance = keys["covariance"]
    H_covariance, center_covariance = record.get("H_covariance"), record.get("imaged_center_covariance")
    return CameraFit(
        camera=camera_from_soccernet(keys, width, height),
        surface=Surface(keys["crown_shape"], keys["crown_radius_m"], keys["crown_m"]),
        parameters=tuple(covariance["parameters"]),
        covariance=_array(covariance["matrix"]),
        H_image_field=_array(H_image_field),
        H_field_image=_array(record.get("H_field_image") or np.linalg.inv(_array(H_image_field))),
        H_covariance=np.full((8, 8), np.nan) if H_covariance is None else _array(H_covariance),
        imaged_center_px=_array(record["imaged_center"]),
        imaged_center_covariance=np.full((2, 2), np.nan) if center_covariance is None else _array(center_covariance),
        noise_scale=_number(keys["noise_scale"]),
        data_share=_number(keys["data_share"]),
        max_sigma_px=_number(keys["max_sigma_px"]),
        max_sigma_m=_number(keys["max_sigma_m"]),
        residuals_px={name: _number(value) for name, value in (record["residuals_px"]["camera"] or {}).items()},
        theta=_array(covariance["estimate"]),
        residual_correlation=_number(keys["residual_correlation"]),
        derived_points=tuple(
            DerivedPoint(p["label"], _array(p["field_m"]), _array(p["image_px"]), _array(p["covariance"]))
            for p in keys["derived_points"]
        ),
        rejected=tuple(keys["rejected_observations"]),
        named_lines=tuple(keys["named_lines"]),
        reference_m=_array(keys["reference_m"]),
    )


def _number(value: float | None) -> float:
    return np.inf if value is None else value


def _homography(record: _Record, estimate: _Record) -> HomographyFit | None:
    H_image_field = estimate.get("H_image_field")
    if H_image_field is None:
        return None
    H, inverse = _array(H_image_field), _array(np.linalg.inv(_array(H_image_field)))
    turned = next((a["H_image_field"] for a in record["alternatives"] if a["kind"] == "turned_field"), H_image_field)
    residuals = _array(record["residuals_px"]["homography"] or [])
    return HomographyFit(H, inverse, _array(turned), residuals, condition=np.nan, null_ratio=np.nan)


def _ellipses(record: _Record) -> EllipseFits | None:
    written, inliers = record.get("ellipses"), record.get("inliers") or {}
    if written is None:
        return None
    return EllipseFits(
        *(_ellipse(edge, written[edge], inliers.get(edge) or {}) for edge in ("outer", "inner", "center"))
    )


def _ellipse(edge: Any, keys: _Record | None, inliers: _Record) -> EllipseFit | None:
    if keys is None:
        return None
    points = _array(inliers.get("points_px", [])).reshape(-1, 2)
    return EllipseFit(
        edge=edge,
        conic=_array(keys["conic"]),
        covariance=_array(keys["covariance"]),
        ellipse=Ellipse(_array(keys["center_px"]), tuple(keys["semi_axes_px"]), math.radians(keys["angle_degrees"])),
        method=keys["method"],
        points_px=points,
        sigma_px=np.full(len(points), np.nan),
        inliers=np.ones(len(points), np.bool_),
        rms_px=_number(keys["rms_px"]),
        arc_deg=_number(keys["arc_degrees"]),
        hypotheses=keys["hypotheses"],
    )


def _correspondences(record: _Record) -> Correspondences | None:
    keys, center = record.get("correspondences"), record.get("imaged_center")
    if keys is None or center is None:
        return None
    return Correspondences(
        case=record["case"],
        conic=_array(keys["conic"]),
        radius_m=keys["radius_m"],
        imaged_center=np.append(_array(center), 1.0),
        center_source=record["imaged_center_source"],
        vanishing_line=_array(record["vanishing_line"]),
        points=tuple(
            PointCorrespondence(p["label"], _array(p["field_m"]), _array(p["image_px"]), p["sigma_px"])
            for p in keys["points"]
        ),
        tangents=tuple(
            LineCorrespondence(t["label"], _array(t["field_line"]), _array(t["image_line"])) for t in keys["tangents"]
        ),
    )
