"""The record of a frame from its calibration: the one place that knows both."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from pydantic_core import to_json

from circlecal import __version__
from circlecal.field import FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.paint.profiles import BRIGHTNESS_BGR
from circlecal.records.parts import SourceRecord
from circlecal.records.record import SCHEMA_VERSION, ResultRecord
from circlecal.results import CameraFit, Correspondences, EllipseFit, EllipseFits, FrameCalibration, Verdict

POINT_DECIMALS, OBSERVATION_DECIMALS = 3, 4


def result_record(
    calibration: FrameCalibration, template: FieldTemplate, *, time_s: float | None = None, digest: str | None = None
) -> ResultRecord:
    """The record of a frame.

    Parameters
    ----------
    calibration : FrameCalibration
        What the pipeline returned.
    template : FieldTemplate
        The field that it ran with.
    time_s : float, optional
        Time of the frame in its video.
    digest : str, optional
        Digest of everything that the answer depends on beside the frame; that of the configuration when None.
    """
    accepted = calibration.status == "calibrated"
    fit = calibration.attempt.camera
    H_image_field, H_field_image = _homographies(calibration)
    camera = None if fit is None else _camera(fit)
    reached = H_image_field is not None or camera is not None
    content = {
        "schema_version": SCHEMA_VERSION,
        "version": __version__,
        "id": "",
        "image": image_part(calibration.width, calibration.height, calibration.aspect),
        "field": {"template": template.name, "circle": calibration.circle_name, "sizes": template.sizes},
        "fields": [asdict(candidate) for candidate in calibration.fields] or None,
        "sport": calibration.sport and asdict(calibration.sport),
        "status": calibration.status,
        "H_image_field": H_image_field if accepted else None,
        "H_field_image": H_field_image if accepted else None,
        "H_covariance": fit.H_covariance if accepted and fit is not None else None,
        "region": fit.region if accepted and fit is not None else None,
        "camera": camera if accepted else None,
        "rejected_estimate": {"H_image_field": H_image_field, "camera": camera} if reached and not accepted else None,
        **_circle_findings(calibration),
        "alternatives": _alternatives(calibration),
        "residuals_px": _residuals(calibration),
        "observations": calibration.attempt.observations and write_observations(calibration.attempt.observations),
        "timings_ms": {stage: round(time, 3) for stage, time in calibration.timings_ms.items()},
        "seed": calibration.seed,
        "config_digest": digest or calibration.config_digest,
        "checks": calibration.verdict.checks,
        "paint": _paint(calibration),
        "rig": None if calibration.camera_name is None else {"camera": calibration.camera_name},
    }
    # what is not finite becomes null on this way; names need not be text, and stay out of it
    numbers = ResultRecord.model_validate_json(to_json(content, inf_nan_mode="null", fallback=_plain))
    return numbers.model_copy(
        update={
            "id": calibration.id,
            "source": SourceRecord(path=calibration.source, time_s=time_s),
            **_verdict(calibration.verdict),
        }
    )


def image_part(width: int, height: int, aspect: float) -> dict[str, float]:
    """Size of a picture as a record has it, with the shape of its pixels where they are not square."""
    return {"width": width, "height": height} | ({} if aspect == 1.0 else {"aspect": aspect})


def failure_record(
    frame_id: str, source: str, verdict: Verdict, seed: int, digest: str, time_s: float | None = None
) -> ResultRecord:
    """Record of a frame of a batch that never reached the pipeline, e.g. refused with ``unreadable_input``."""
    return ResultRecord(
        schema_version=SCHEMA_VERSION,
        version=__version__,
        id=frame_id,
        source=SourceRecord(path=source, time_s=time_s),
        image=None,
        **_verdict(verdict),
        checks=[],
        H_image_field=None,
        H_field_image=None,
        camera=None,
        seed=seed,
        config_digest=digest,
    )


def _paint(calibration: FrameCalibration) -> dict[str, Any] | None:
    """Colour and polarity of the paint, and the colours of the others where it was told apart from them."""
    added, others = calibration.paint_bgr, calibration.other_paints_bgr
    if added is None:
        return None
    polarity = "light" if np.dot(BRIGHTNESS_BGR, added) > 0.0 else "dark"
    return {"added_bgr": added, "polarity": polarity} | ({"others_bgr": others} if others else {})


def _verdict(verdict: Verdict) -> dict[str, Any]:
    return {
        "status": verdict.status,
        "code": verdict.code,
        "stage": verdict.stage,
        "reason": verdict.reason,
        "help": verdict.help,
    }


def write_observations(seen: Observations) -> dict[str, Any]:
    """What was seen as the record has it, rounded to 1e-4 px."""
    return {
        "circles": [
            {"circle": c.circle, "edge": c.edge, "points_px": _round(c.points_px), "sigma_px": _round(c.sigma_px)}
            for c in seen.circles
        ],
        "lines": [
            {"line": s.line, "points_px": _round(s.points_px), "sigma_px": _round(s.sigma_px)}
            | ({"ends": [{"point_px": _round(e.point_px), "crossed": e.crossed} for e in s.ends]} if s.ends else {})
            for s in seen.lines
        ],
        "marks": [{"mark": m.mark, "point_px": _round(m.point_px), "sigma_px": m.sigma_px} for m in seen.marks],
        "keypoints": [
            {"name": k.name, "field_m": _round(k.field_m), "point_px": _round(k.point_px), "sigma_px": k.sigma_px}
            | ({} if k.shift is None else {"shift": k.shift})
            for k in seen.keypoints
        ],
    }


def _homographies(calibration: FrameCalibration) -> tuple[Array | None, Array | None]:
    camera, homography = calibration.attempt.camera, calibration.attempt.homography
    estimate = camera if camera is not None else homography
    return (None, None) if estimate is None else (estimate.H_image_field, estimate.H_field_image)


def _camera(fit: CameraFit) -> dict[str, Any]:
    return {
        **fit.camera.soccernet(),
        "crown_m": fit.surface.crown_m,
        "crown_shape": fit.surface.shape,
        "crown_radius_m": fit.surface.reference_m,
        "covariance": {"parameters": fit.parameters, "estimate": fit.theta, "matrix": fit.covariance},
        "derived_points": fit.derived_points,
        "named_lines": fit.named_lines,
        "rejected_observations": tuple(map(str, fit.left_out)),
        "noise_scale": fit.noise_scale,
        "data_share": fit.data_share,
        "prior_dominated": fit.prior_dominated,
        "residual_correlation": fit.residual_correlation,
        "position_sigma_m": np.sqrt(np.diag(fit.covariance)[4:7]),
        "reference_m": fit.reference_m,
        "reference_by_growth": fit.reference_by_growth,
        "max_sigma_px": fit.max_sigma_px,
        "mean_sigma_px": fit.mean_sigma_px,
        "max_sigma_m": fit.max_sigma_m,
        "field_size": fit.field_size,
    }


def _circle_findings(calibration: FrameCalibration) -> dict[str, Any]:
    """Case, ellipses, imaged centre, vanishing line, correspondences and inliers."""
    attempt = calibration.attempt
    found, fit, ellipses = attempt.correspondences, attempt.camera, attempt.ellipses
    center = fit.imaged_center_px if fit is not None else None if found is None else found.imaged_center[:2]
    return {
        "case": None if found is None else found.case,
        "ellipses": None if ellipses is None else _ellipses(ellipses),
        "imaged_center": center,
        "imaged_center_source": "camera" if fit is not None else None if found is None else found.center_source,
        "imaged_center_covariance": None if fit is None else fit.imaged_center_covariance,
        "vanishing_line": None if found is None else found.vanishing_line,
        "correspondences": None if found is None else _correspondences(found),
        "no_correspondences": attempt.no_correspondences,
        "inliers": None if ellipses is None else _inliers(ellipses),
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
        "angle_degrees": np.degrees(fit.ellipse.angle_rad),
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
            "points_px": _round(fit.points_px[fit.inliers], POINT_DECIMALS),
        }
        for fit in fits.all()
    }


def _correspondences(found: Correspondences) -> dict[str, Any]:
    return {
        "conic": found.conic,
        "radius_m": found.radius_m,
        "points": found.points,
        "tangents": found.tangents,
    }


def _alternatives(calibration: FrameCalibration) -> list[dict[str, Any]]:
    """Other solutions of real ambiguities: the turned field, and what else the circle may be."""
    others = [
        {
            "kind": "other_circle",
            "circle": rival.circle_name,
            "evidence": rival.evidence,
            "H_image_field": rival.camera.H_image_field,
            "camera": rival.camera.camera.soccernet(),
        }
        for rival in calibration.attempt.rivals
    ]
    return [*_turn_field(calibration), *others]


def _turn_field(calibration: FrameCalibration) -> list[dict[str, Any]]:
    """The field turned by 180 degrees, which circle and halfway line cannot tell from the answer; only a prior can."""
    camera, homography = calibration.attempt.camera, calibration.attempt.homography
    if camera is not None:
        turned = camera.camera.turn_field()
        return [{"kind": "turned_field", "H_image_field": turned.homography, "camera": turned.soccernet()}]
    if homography is not None:
        return [{"kind": "turned_field", "H_image_field": homography.H_image_field_turned, "camera": None}]
    return []


def _residuals(calibration: FrameCalibration) -> dict[str, Any]:
    camera, homography, ellipses = (
        calibration.attempt.camera,
        calibration.attempt.homography,
        calibration.attempt.ellipses,
    )
    fits = () if ellipses is None else ellipses.all()
    return {
        "ellipses": {fit.edge: fit.rms_px for fit in fits},
        "homography": None if homography is None else homography.residuals_px,
        "camera": None if camera is None else {str(key): rms for key, rms in camera.residuals_px.items()},
        "points": None
        if camera is None
        else {str(key): _round(off, POINT_DECIMALS).tolist() for key, off in camera.point_residuals_px.items()},
    }


def _plain(value: Any) -> Any:
    """Arrays and numpy's numbers as JSON knows them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a record")


def _round(values: Array, decimals: int = OBSERVATION_DECIMALS) -> Array:
    return np.asarray(np.round(values, decimals), dtype=np.float64)
