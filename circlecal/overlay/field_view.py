"""The field as a calibration sees it: field points to the frame's pixels, and nothing where they cannot be seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from circlecal.camera.covariance import field_sigma
from circlecal.camera.parameters import INDEX, PARAMETERS, ProjectionModel
from circlecal.field import FieldTemplate
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array, lift
from circlecal.geometry.surface import Surface
from circlecal.overlay.canvas import Canvas
from circlecal.overlay.palette import CIRCLE, TEMPLATE, Color
from circlecal.results import Calibration, CameraFit

_MARGIN = 0.6
"""How far beyond the picture points are kept, in its size; far beyond it the lens model folds back."""


@dataclass(frozen=True, slots=True)
class FieldView:
    """A way from field points (N, 2) in metres to pixels (N, 2) of the stored frame, nan where they are not visible.

    ``growth_m`` (2,) is by how much this field is longer and broader than its template.
    """

    pixels: Callable[[Array], Array]
    growth_m: Array

    def markings(self, template: FieldTemplate) -> dict[str, Array]:
        """Centrelines of all markings and rims of all marks as polylines (N, 2) in metres, at the field's own size."""
        drawn = template.polylines(template.length_m / 420.0)
        angle = np.linspace(0.0, 2 * np.pi, 25)
        rim = 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        drawn.update({mark.name: np.asarray(mark.position) + mark.diameter_m * rim for mark in template.marks})
        return {name: _grown(polyline, template, self.growth_m) for name, polyline in drawn.items()}

    def draw_template(
        self, canvas: Canvas, template: FieldTemplate, circle: str, color: Color = TEMPLATE, dashed: bool = False
    ) -> None:
        """Draw every marking's centreline, the circle that carried the calibration in its own colour."""
        for name, polyline in self.markings(template).items():
            own = CIRCLE if name == circle and color == TEMPLATE else color
            canvas.polyline(self.pixels(polyline), own, 1.4, dashed=dashed and name not in template.mark_by_name)


def _grown(polyline: Array, template: FieldTemplate, growth_m: Array) -> Array:
    """A marking of a longer and broader field: what bounds the field stretches, what belongs to one end moves."""
    size = np.array([template.length_m, template.width_m])
    low, high = polyline.min(axis=0), polyline.max(axis=0)
    reaches = np.maximum(-low, high) >= size / 2 - template.marking_width_m
    moved = polyline * np.where(reaches & (low * high <= 0), 1.0 + growth_m / size, 1.0)
    if low[0] * high[0] > 0:
        moved[:, 0] += np.sign(low[0]) * growth_m[0] / 2
    if reaches[1] and low[1] * high[1] > 0:
        moved[:, 1] += np.sign(low[1]) * growth_m[1] / 2
    return moved


def camera_view(fit: CameraFit, template: FieldTemplate, circle: str) -> FieldView:
    """Through the camera, with its lens and the crown of the surface."""
    known = fit.theta.shape == (len(PARAMETERS),)
    growth = fit.theta[[INDEX["length"], INDEX["breadth"]]] if known else np.zeros(2)
    return surface_view(fit.camera, fit.crown_m, _model(fit, template, circle), growth)


def surface_view(camera: Camera, crown_m: float, model: ProjectionModel, growth_m: Array) -> FieldView:
    """Through a camera onto a surface that drops by ``crown_m`` at the frame's reference distance."""

    def pixels(points_m: Array) -> Array:
        depth = crown_m * model.surface.drop(points_m[:, 1])
        undistorted = camera.project(np.column_stack([points_m, depth]), distort=False)
        near = _near(undistorted, camera.width, camera.height) & _unfolded(camera, undistorted)
        return np.where(near[:, None], camera.distort(undistorted), np.nan)

    return FieldView(pixels, growth_m)


def homography_view(H_image_field: Array, width: int, height: int) -> FieldView:
    """Through a homography, with the sign that an unmirrored view from above has in front of the camera."""
    H = np.asarray(H_image_field, dtype=np.float64)
    H = H * (np.sign(np.linalg.det(H)) or 1.0) if np.isfinite(H).all() else H

    def pixels(points_m: Array) -> Array:
        mapped = lift(points_m) @ H.T
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            flat = np.where(mapped[:, 2:] > 0, mapped[:, :2] / mapped[:, 2:], np.nan)
        return np.where(_near(flat, width, height)[:, None], flat, np.nan)

    return FieldView(pixels, np.zeros(2))


def best_view(calibration: Calibration, template: FieldTemplate) -> FieldView | None:
    """Through the camera where there is one, else through the homography of the closed form."""
    if calibration.camera is not None:
        return camera_view(calibration.camera, template, calibration.circle_name)
    if calibration.homography is not None:
        return homography_view(calibration.homography.H_image_field, calibration.width, calibration.height)
    return None


def predicted_sigma(fit: CameraFit, template: FieldTemplate, circle: str, columns: int = 96) -> Array | None:
    """Predicted standard deviation in pixels on a coarse grid (R, columns) of the frame; nan off the field.

    None where the covariance is not that of the camera's parameters.
    """
    size = len(PARAMETERS)
    if fit.covariance.shape != (size, size) or fit.theta.shape != (size,):
        return None
    camera = fit.camera
    rows = max(2, round(columns * camera.height / camera.width))
    x, y = np.meshgrid(
        (np.arange(columns) + 0.5) * camera.width / columns, (np.arange(rows) + 0.5) * camera.height / rows
    )
    field = camera.back_project(np.stack([x, y], axis=-1).reshape(-1, 2))
    half = np.array([template.length_m, template.width_m]) / 2 + 1.0
    with np.errstate(invalid="ignore"):
        seen = np.flatnonzero((np.abs(field) <= half).all(axis=1))
    sigma = np.full(len(field), np.nan)
    if len(seen):
        sigma[seen] = field_sigma(fit.theta, fit.covariance, field[seen], _model(fit, template, circle))[0]
    return sigma.reshape(rows, columns)


def _model(fit: CameraFit, template: FieldTemplate, circle: str) -> ProjectionModel:
    known = template.circle_by_name.get(circle, template.circle_by_name[template.default_circle])
    return ProjectionModel(fit.camera.width, fit.camera.height, Surface(fit.crown_shape, known.radius_m))


def _near(pixels: Array, width: int, height: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    size = np.array([width, height])
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(pixels - size / 2) <= (0.5 + _MARGIN) * size).all(axis=1))


def _unfolded(camera: Camera, undistorted: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Where the lens still moves points outwards as they lie further out."""
    r2 = np.sum((undistorted - camera.principal_point_px) ** 2, axis=1) / (camera.width / 2.0) ** 2
    with np.errstate(invalid="ignore"):
        return np.asarray(1.0 + 3.0 * camera.kappa[0] * r2 + 5.0 * camera.kappa[1] * r2**2 > 0.0)
