"""A simpler camera that shows a flat field where another camera, over a crowned field, was found to show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.projective import Array

_MIN_POINTS = 8
_POINTS = 400


def flat_camera(camera: Camera, points_m: Array, pixels: Array, *, centred: bool = False) -> Camera:
    """The pinhole camera over the plane z = 0 nearest to given pixels, in least squares.

    Focal length, angles, position and the first coefficient of distortion are adjusted; principal point, aspect and the
    second coefficient stay, or are those of the simplest model.

    Parameters
    ----------
    camera : Camera
        The start, and the size of the picture.
    points_m, pixels : (N, 2) arrays
        Points of the field and where they are seen (distorted).
    centred : bool
        Square pixels, the principal point at the image centre, no second coefficient.

    Returns
    -------
    Camera
        The start itself (with the simplest model's constants) where fewer than eight points are given.
    """
    if centred:
        focal = np.full(2, camera.focal_px[0])
        camera = replace(
            camera,
            focal_px=focal,
            principal_point_px=image_center(camera.width, camera.height),
            kappa=np.array([camera.kappa[0], 0.0]),
        )
    stride = max(1, len(points_m) // _POINTS)
    field, seen = points_m[::stride], pixels[::stride]
    if len(field) < _MIN_POINTS:
        return camera

    def adjusted(change: Array) -> Camera:
        return replace(
            camera,
            focal_px=camera.focal_px * np.exp(change[0]),
            angles_rad=camera.angles_rad + change[1:4],
            position_m=camera.position_m + change[4:7],
            kappa=camera.kappa + np.array([change[7], 0.0]),
        )

    def residuals(change: Array) -> Array:
        projected = adjusted(change).project(field)
        return np.nan_to_num((projected - seen).ravel(), nan=1e4, posinf=1e4, neginf=-1e4)

    scale = np.array([0.01, 0.01, 0.01, 0.01, 1.0, 1.0, 1.0, 0.01])
    found = least_squares(residuals, np.zeros(8), x_scale=scale, max_nfev=60)
    return adjusted(found.x) if found.cost <= np.sum(residuals(np.zeros(8)) ** 2) / 2 else camera
