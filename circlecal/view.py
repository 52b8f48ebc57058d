"""Field points to pixels and back, with the standard deviation that the camera's covariance gives.

With a camera the lens and the crown of the surface are in the answer; with a homography alone the picture is taken as
free of distortion and the field as flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from circlecal.camera.covariance import field_sigma
from circlecal.camera.parameters import INDEX, ProjectionModel, theta_of
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.records.record import StoredResult

_SURFACE_ROUNDS = 30
_SURFACE_TOLERANCE_M = 1e-9


@dataclass(frozen=True, slots=True)
class Projected:
    """Points (N, 2) in the other frame and the standard deviation (N,) of the length of their error.

    A point is nan where there is no answer: a pixel on or above the horizon, or a field point behind the camera.
    ``sigma`` is None where the result carries no covariance.
    """

    points: Array
    sigma: Array | None


def field_to_image(result: StoredResult, points_m: ArrayLike) -> Projected:
    """Pixels of the stored frame (N, 2) for field points (N, 2) in metres; sigma in pixels."""
    field = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
    if result.camera is not None:
        pixels = result.camera.project(np.column_stack([field, surface_depth(result, field[:, 1])]))
    else:
        pixels = _through(_front_positive(result), field)
    return Projected(pixels, _sigma(result, field, to_field=False))


def image_to_field(result: StoredResult, pixels: ArrayLike) -> Projected:
    """Field points (N, 2) in metres for pixels (N, 2) of the stored frame; sigma in metres."""
    given = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    if result.camera is not None:
        field = _on_surface(result, result.camera, given)
    else:
        H = _front_positive(result)
        field = _through(np.asarray(np.linalg.inv(H), dtype=np.float64), given, front=H)
    return Projected(field, _sigma(result, field, to_field=True))


def surface_depth(result: StoredResult, y_m: Array) -> Array:
    """How far the surface lies below the centre mark, metres (z points down), at field coordinate y."""
    return result.crown_m * _model(result).surface.drop(y_m)


def _on_surface(result: StoredResult, camera: Camera, pixels: Array) -> Array:
    """Where the rays of the pixels meet the crowned surface; nan for a ray that passes over it.

    A ray is ``flat + share (foot - flat)`` on the map and at depth ``share z`` (z of the camera, negative), from the
    point where it would meet the flat field; Newton's iteration on the share.
    """
    flat = camera.back_project(pixels)
    if result.crown_m == 0:
        return flat
    foot, height = camera.position_m[:2], camera.position_m[2]
    model = _model(result)
    share = np.zeros(len(flat))
    for _ in range(_SURFACE_ROUNDS):
        y = flat[:, 1] + share * (foot[1] - flat[:, 1])
        drop, slope = result.crown_m * model.surface.drop(y), result.crown_m * model.surface.slope(y)
        share = share - (share * height - drop) / (height - slope * (foot[1] - flat[:, 1]))
    field = flat + share[:, None] * (foot - flat)
    missed = ~(np.abs(share * height - surface_depth(result, field[:, 1])) < _SURFACE_TOLERANCE_M) | (share >= 1)
    field[missed] = np.nan
    return field


def _front_positive(result: StoredResult) -> Array:
    """``H_image_field`` scaled so that the third coordinate is positive in front of the camera (then det H > 0)."""
    if result.H_image_field is None:
        raise ValueError("the result has neither a camera nor a homography")
    return result.H_image_field * float(np.sign(np.linalg.det(result.H_image_field)))


def _through(H: Array, points: Array, front: Array | None = None) -> Array:
    lifted = np.column_stack([points, np.ones(len(points))]) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        mapped = lifted[:, :2] / lifted[:, 2:]
    depth = lifted[:, 2] if front is None else np.column_stack([mapped, np.ones(len(mapped))]) @ front[2]
    mapped[(depth <= 0) | ~np.isfinite(mapped).all(axis=1)] = np.nan
    return mapped


def _sigma(result: StoredResult, field: Array, *, to_field: bool) -> Array | None:
    """Standard deviation of the length of each point's error, from the covariance of the camera."""
    if result.covariance is None or result.camera is None:
        return None
    model = _model(result)
    theta = theta_of(result.camera, model)
    theta[INDEX["crown"]] = result.crown_m
    seen = np.isfinite(field).all(axis=1)
    sigma = np.full(len(field), np.nan)
    if seen.any():
        sigma[seen] = field_sigma(theta, result.covariance, field[seen], model)[int(to_field)]
    return sigma


def _model(result: StoredResult) -> ProjectionModel:
    return ProjectionModel(result.width, result.height, Surface(result.crown_shape, result.crown_radius_m))
