"""What the lens polynomial alone makes of a point, also where it folds back."""

import numpy as np

from circlecal.geometry.camera import Camera


def projected_without_fold(camera: Camera, points_m) -> np.ndarray:
    """Pixels (..., 2) of field points, which no lens shows there beyond the fold."""
    offset = camera.project(points_m, distort=False) - camera.principal_point_px
    r2 = np.sum((offset * [1.0, camera.focal_px[0] / camera.focal_px[1]]) ** 2, axis=-1) / (camera.width / 2.0) ** 2
    factor = 1.0 + camera.kappa[0] * r2 + camera.kappa[1] * r2 * r2
    return offset * factor[..., None] + camera.principal_point_px
