"""The record of a tracked frame: as short as a frame's answer is, since a match has 135,000 of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic_core import to_json

from circlecal import __version__
from circlecal.camera.covariance import homography_vectors, imaged_points, push_forward, spread_cameras
from circlecal.camera.report import derive_points, field_about, homography_region
from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, homographies, theta_of
from circlecal.geometry.homography import scale_homography
from circlecal.geometry.projective import Array
from circlecal.records.parts import RigRecord, SourceRecord
from circlecal.records.record import SCHEMA_VERSION, ResultRecord
from circlecal.records.writing import image_part
from circlecal.refusals import explain
from circlecal.tracking.results import Head, TrackedFrame

STAGE = "track"
"""The stage that frames of a clip are refused by."""
_DIGITS, _SIGMA_DIGITS = 11, 5
"""Significant digits of estimates, which leaves a pixel exact to 1e-6, and of standard deviations."""
_USUAL = 3.0
"""Standard deviations of its own within which a pitch is taken to have its template's size. A real one, told as 66.40
+- 0.14 m broad, shows its far touchline beside where one of 68 m would have it, though grounds vary by as much.
"""
_LEAST_EIGENVALUE = 1e-12
"""Of a correlation matrix: less comes from rounding, and is raised to it before the Cholesky factor is taken."""


@dataclass(frozen=True, slots=True)
class RecordForm:
    """What all records of a clip have in common.

    Attributes
    ----------
    template, circle : FieldTemplate, Circle
        The field, and its circle.
    seed, digest : int, str
        Seed of the random draws, and digest of everything that the answers depend on beside the clip.
    full : bool
        Whether everything that follows from a camera is written out: covariance matrices, derived points, checks.
    aspect : float
        Width of a pixel over its height.
    bytes : int or None
        Size of the clip's file, by which a later start knows another one of its name.
    """

    template: FieldTemplate
    circle: Circle
    seed: int
    digest: str
    full: bool = False
    aspect: float = 1.0
    bytes: int | None = None


def record_of_track(frame: TrackedFrame, frame_id: str, source: str, shot: int, form: RecordForm) -> ResultRecord:
    """The record of a tracked frame.

    Parameters
    ----------
    frame : TrackedFrame
        What tracking says of it.
    frame_id, source : str
        Its name, and the clip as it was given.
    shot : int
        Number of its shot in the whole clip.
    form : RecordForm
        What all records of the clip have in common.
    """
    content: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "version": __version__,
        "id": "",
        "image": image_part(*frame.size, form.aspect),
        "field": {"template": form.template.name, "circle": form.circle.name, "sizes": form.template.sizes},
        "status": frame.status,
        "seed": form.seed,
        "config_digest": form.digest,
        "track": {
            "frame": frame.index,
            "shot": shot,
            "carried_by": frame.carriers,
            "head": None if frame.head is None else _head(frame.head),
        },
        **({} if frame.view is None else _estimate(frame, frame.view, form)),
        **({"checks": frame.checks} if form.full else {}),
    }
    numbers = ResultRecord.model_validate_json(to_json(content, inf_nan_mode="null", fallback=_plain))
    told: dict[str, Any] = {} if form.bytes is None else {"bytes": form.bytes}
    words: dict[str, Any] = {"id": frame_id, "source": SourceRecord(path=source, time_s=frame.time_s, **told)}
    if frame.tripod is not None:
        words["rig"] = RigRecord(camera=frame.tripod)
    return numbers.model_copy(update=words | _refusal(frame))


def _refusal(frame: TrackedFrame) -> dict[str, Any]:
    """Why a frame is refused; none of one that is answered."""
    if frame.status == "calibrated":
        return dict.fromkeys(("code", "stage", "reason", "help"))
    code = frame.code or "lost"
    refusal = explain(code, STAGE)
    return {"code": code, "stage": STAGE, "reason": frame.reason or refusal.words, "help": refusal.help}


def _estimate(frame: TrackedFrame, view: FieldView, form: RecordForm) -> dict[str, Any]:
    """The camera of a frame and what follows from it, as its answer or as an estimate that is rejected."""
    H_image_field, H_field_image = _homographies(view)
    camera = _camera(frame, view, form)
    if frame.status != "calibrated":
        return {"rejected_estimate": {"H_image_field": H_image_field, "camera": camera}}
    details = _details(view, form) if form.full else {}
    if camera is not None and details:
        camera["derived_points"] = details.pop("derived_points")
    return {"H_image_field": H_image_field, "H_field_image": H_field_image, "camera": camera, **details}


def _homographies(view: FieldView) -> tuple[Array, Array]:
    H = view.camera.homography
    return _round(H), _round(scale_homography(np.linalg.inv(H)))


def _camera(frame: TrackedFrame, view: FieldView, form: RecordForm) -> dict[str, Any] | None:
    if not isinstance(view.camera, Camera):
        return None
    theta = theta_of_view(view)
    written = {
        **{key: _round(value) for key, value in view.camera.soccernet().items()},
        "crown_m": view.surface.crown_m,
        "crown_shape": view.surface.shape,
        "crown_radius_m": view.surface.reference_m,
        "max_sigma_px": None if frame.sigma_px is None else _round(frame.sigma_px, _SIGMA_DIGITS),
    }
    if view.covariance is None:
        return written
    return {
        **written,
        "field_size": _field_size(view, view.covariance, form.template),
        "covariance": _covariance(theta, view.covariance, form.full),
        "position_sigma_m": _round(np.sqrt(np.diag(view.covariance)[INDEX["x"] : INDEX["z"] + 1]), _SIGMA_DIGITS),
        "max_sigma_m": None if frame.sigma_m is None else _round(frame.sigma_m, _SIGMA_DIGITS),
        "reference_m": [_round(frame.end * (form.template.length_m + float(view.growth_m[0])) / 2.0), 0.0],
        "reference_by_growth": [frame.end / 2.0, 0.0],
    }


def _field_size(view: FieldView, covariance: Array, template: FieldTemplate) -> dict[str, Any]:
    """How long and broad the pitch is, which need not be what its template says; usual is what differs by chance."""
    variance = np.diag(covariance)[[INDEX["length"], INDEX["breadth"]]]
    sizes = _round(np.array([template.length_m, template.width_m]) + view.growth_m)
    sds = _round(np.sqrt(variance), _SIGMA_DIGITS)
    is_usual = bool((np.abs(view.growth_m) <= _USUAL * np.sqrt(variance)).all())
    names = ("length_m", "width_m", "length_sd_m", "width_sd_m")
    return {
        **dict(zip(names, (*sizes, *sds), strict=True)),
        "is_usual": is_usual,
        "usual_share": float(is_usual),
    }


def theta_of_view(view: FieldView) -> Array:
    """Parameter vector (P,) of a view's camera, its surface and the sizes of its pitch.

    Raises
    ------
    ValueError
        The view has a homography only.
    """
    if not isinstance(view.camera, Camera):
        raise ValueError("a homography alone has no parameters")
    theta = theta_of(view.camera, ProjectionModel.of(view.camera, view.surface), view.surface.crown_m)
    theta[[INDEX["length"], INDEX["breadth"]]] = view.growth_m
    return theta


def _covariance(theta: Array, covariance: Array, full: bool) -> dict[str, Any]:
    if full:
        return {"parameters": PARAMETERS, "estimate": theta, "matrix": covariance}
    own = np.flatnonzero((np.diag(covariance) > 0) | (theta != 0))
    lower = np.tril_indices(len(own))
    values = _round(_cholesky(covariance[np.ix_(own, own)])[lower], _SIGMA_DIGITS)
    return {
        "parameters": [PARAMETERS[k] for k in own],
        "estimate": _round(theta[own]),
        "factor": np.split(values, np.cumsum(np.arange(1, len(own)))),
    }


def _cholesky(covariance: Array) -> Array:
    """Lower triangular factor (K, K) of a covariance that may be singular, and have parameters without any variance."""
    sd = np.sqrt(np.diag(covariance))
    free = sd > 0
    correlation = covariance[np.ix_(free, free)] / np.outer(sd[free], sd[free])
    factor = np.zeros_like(covariance)
    correlation[np.diag_indices_from(correlation)] += _LEAST_EIGENVALUE
    try:
        lower = np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(correlation)
        # A = V D V^T = (D^(1/2) V^T)^T (D^(1/2) V^T) = R^T R with D^(1/2) V^T = Q R
        root = np.sqrt(np.maximum(values, _LEAST_EIGENVALUE))[:, None] * vectors.T
        lower = np.asarray(np.linalg.qr(root, mode="r")).T
    factor[np.ix_(free, free)] = sd[free, None] * lower
    return factor


def _head(head: Head) -> dict[str, Any]:
    sigma = np.sqrt(np.diag(head.covariance))
    return {
        "pan_degrees": _round(np.degrees(head.pan_rad)),
        "tilt_degrees": _round(np.degrees(head.tilt_rad)),
        "log_focal": _round(head.log_focal),
        "log_focal_sigma": _round(sigma[0], _SIGMA_DIGITS),
        "pan_sigma_degrees": _round(np.degrees(sigma[1]), _SIGMA_DIGITS),
        "tilt_sigma_degrees": _round(np.degrees(sigma[2]), _SIGMA_DIGITS),
    }


def _details(view: FieldView, form: RecordForm) -> dict[str, Any]:
    """What follows from the camera and its covariance about the circle."""
    if not isinstance(view.camera, Camera) or view.covariance is None:
        return {}
    theta, center = theta_of_view(view), view.center_of(form.circle, form.template)
    model = ProjectionModel.of(view.camera, view.surface)
    thetas = np.concatenate([theta[None], spread_cameras(theta, view.covariance, center)])
    cameras = homographies(thetas, model)
    vectors, centers = homography_vectors(cameras), imaged_points(cameras, center[None])[:, 0]
    turned = view.camera.turn_field()
    grid = field_about(view, form.template, form.circle, center)
    return {
        "region": homography_region(cameras, grid, view.covariance),
        "H_covariance": push_forward(vectors[0], vectors[1:]),
        "imaged_center": centers[0],
        "imaged_center_source": "camera",
        "imaged_center_covariance": push_forward(centers[0], centers[1:]),
        "derived_points": derive_points(thetas, model, form.circle, center[None]),
        "alternatives": [{"kind": "turned_field", "H_image_field": turned.homography, "camera": turned.soccernet()}],
    }


def _round(values: Any, digits: int = _DIGITS) -> Any:
    """Numbers, also in lists and arrays, to so many significant digits; what is not finite stays."""
    array = np.asarray(values, dtype=np.float64)
    # text rounds to digits that are exact decimals, and is faster than scaling for the few numbers of a camera
    rounded = np.array([float(f"{value:.{digits}g}") for value in array.ravel().tolist()]).reshape(array.shape)
    return float(rounded) if rounded.ndim == 0 else rounded


def _plain(value: Any) -> Any:
    """Arrays and numpy's numbers as JSON knows them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a record")
