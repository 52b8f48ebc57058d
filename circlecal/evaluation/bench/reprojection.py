"""Reprojection error of a homography over the field in view."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from circlecal.field import FieldTemplate
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array, apply_homography, lift


def reprojection_grid(
    H: ArrayLike, width: int, height: int, half_length_m: float, half_width_m: float, step_m: float = 0.5
) -> Array:
    """Grid of field points (N, 2) that a homography shows inside a ``width`` x ``height`` image.

    Only points with the sign of w that the image's lower centre sees count as in front of the camera.
    """
    # from the middle outwards, so that a turned field has these points too
    x, y = (
        step_m * np.arange(-int(h / step_m + 1e-9), int(h / step_m + 1e-9) + 1) for h in (half_length_m, half_width_m)
    )
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    image = lift(grid) @ np.asarray(H, dtype=np.float64).T
    sign = (
        np.sign(np.linalg.inv(np.asarray(H, dtype=np.float64))[2] @ np.array([(width - 1) / 2, height - 1.0, 1.0]))
        or 1.0
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = image[:, :2] / image[:, 2:]
    inside = (image[:, 2] * sign > 0) & (uv >= 0).all(axis=1) & (uv[:, 0] <= width - 1) & (uv[:, 1] <= height - 1)
    return grid[inside]


def grid_in_view(camera: Camera, template: FieldTemplate) -> Array:
    """The points (N, 2) of :func:`reprojection_grid` for a camera over a field."""
    half = template.length_m / 2, template.width_m / 2
    return reprojection_grid(camera.homography, camera.width, camera.height, *half)


def mean_reprojection_error(H_true: ArrayLike, H_estimate: ArrayLike, field_points: ArrayLike) -> float:
    """Mean distance (MRE) in pixels between the images of field points (N, 2) under two homographies.

    Source: Magera et al. 2025, section 4.4.
    """
    difference = apply_homography(H_true, field_points) - apply_homography(H_estimate, field_points)
    return float(np.mean(np.linalg.norm(difference, axis=-1)))
