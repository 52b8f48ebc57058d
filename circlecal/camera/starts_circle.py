"""Starts of the optimiser: the closed forms where they apply, and a grid over distance, height and side."""

from __future__ import annotations

import numpy as np

from circlecal.geometry.camera import camera_from_homography, image_center
from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.circle_pose import pinhole_centers
from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.homography import SIDES, camera_side_of, homography_from_circle, turn_homography
from circlecal.geometry.projective import Array

GRID_DISTANCES = (4.0, 7.0, 11.0)
"""In radii of the circle."""
GRID_TILT_FACTORS = (0.7, 1.0, 1.4)
GRID_AZIMUTHS = 24


def closed_form_starts(
    conic: Array,
    center: Array | None,
    line: Array | None,
    direction: Array,
    field_center: Array,
    radius: float,
    model: ProjectionModel,
    side: str,
) -> Array:
    """Upright cameras (B, P) from the circle, a line of known direction through its centre and, where seen, the
    imaged centre.

    Parameters
    ----------
    conic : (3, 3) array
        Image of the circle of ``radius``.
    center : (3,) array or None
        Imaged centre where a mark shows it; otherwise, or where it allows no camera, every centre that a pinhole
        camera allows is a start.
    line : (3,) array or None
        Image of the line; without one there is no closed form.
    direction : (2,) array
        Its direction on the field.
    field_center, radius : (2,) array, float
        The circle.
    model : ProjectionModel
        Picture size.
    side : str
        Prior on the camera's side.
    """
    if line is None:
        return np.zeros((0, len(PARAMETERS)))
    starts = _cameras([] if center is None else [center], conic, line, direction, field_center, radius, model, side)
    if not starts:
        centers = pinhole_centers(conic, line, image_center(model.width, model.height), model.width)
        starts = _cameras([c.center for c in centers], conic, line, direction, field_center, radius, model, side)
    return np.array(starts).reshape(-1, len(PARAMETERS))


def _cameras(
    centers: list[Array],
    conic: Array,
    line: Array,
    direction: Array,
    field_center: Array,
    radius: float,
    model: ProjectionModel,
    side: str,
) -> list[Array]:
    """The upright ones of the cameras with these imaged centres."""
    starts = []
    for candidate in centers:
        H = homography_from_circle(conic, candidate, line, field_center, radius, direction)
        if H is None:
            continue
        if camera_side_of(H, side) < 0:
            H = turn_homography(H, field_center)
        camera = camera_from_homography(H, model.width, model.height)
        if camera is not None and camera.position_m[2] < 0 and camera.angles_rad[1] > 0:
            starts.append(theta_of(camera, model))
    return starts


def grid_starts(ellipse: Ellipse, field_center: Array, radius: float, model: ProjectionModel, side: str) -> Array:
    """Level cameras (B, P) all around the circle that see it about as large, as flat and in the same place as an
    ellipse.

    The distance is free without more knowledge, the height follows from the axis ratio, the focal length from the
    longer axis.
    """
    lower = np.clip(ellipse.axis_ratio, 0.03, 0.95)
    distance, factor, azimuth = (
        g.ravel()
        for g in np.meshgrid(
            np.array(GRID_DISTANCES) * radius,
            np.array(GRID_TILT_FACTORS),
            np.linspace(-np.pi, np.pi, GRID_AZIMUTHS, endpoint=False),
            indexing="ij",
        )
    )
    elevation = np.arcsin(np.clip(lower * factor, 0.03, 0.97))
    horizontal = distance * np.cos(elevation)
    # azimuth 0 is the main camera's side, +y
    position = np.stack(
        [np.sin(azimuth) * horizontal, np.cos(azimuth) * horizontal, -distance * np.sin(elevation)], axis=-1
    )
    theta = np.zeros((len(distance), len(PARAMETERS)))
    focal = ellipse.semi_axes[0] * distance / radius
    look = -position / distance[:, None]
    shift = (ellipse.center - model.center) / focal[:, None]
    tilt = np.arccos(look[:, 2])
    theta[:, 0] = np.log(focal)
    theta[:, 1] = np.arctan2(look[:, 0], -look[:, 1]) - np.arctan(shift[:, 0]) / np.sin(tilt)
    theta[:, 2] = tilt + np.arctan(shift[:, 1])
    theta[:, 4:7] = position + np.r_[field_center, 0.0]
    return theta[position[:, :2] @ np.array(SIDES[side]) >= -1e-9]


def standing_start(
    points_px: Array, field_center: Array, radius: float, position_m: Array, roll_rad: float, model: ProjectionModel
) -> Array:
    """The camera (1, P) of a known position that sees points (N, 2) of a circle; none (0, P) where they are too few.

    Position and roll fix the direction of the imaged circle's axes and their ratio. Its middle and size are then linear
    in the points, so that a short arc gives them as well as a long one.
    """
    offset = position_m - np.r_[field_center, 0.0]
    distance = float(np.linalg.norm(offset))
    ratio = -offset[2] / max(distance, 1e-6)
    if len(points_px) < 3 or ratio <= 0:
        return np.zeros((0, len(PARAMETERS)))
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    upright = (points_px - model.center) @ np.array([[c, s], [-s, c]]) / np.array([1.0, ratio])
    scale = np.abs(upright).max() + 1e-9
    x, y = (upright / scale).T
    # x^2 + y^2 = 2 u x + 2 v y + w
    solved = np.linalg.lstsq(np.column_stack([2 * x, 2 * y, np.ones(len(x))]), x * x + y * y, rcond=None)[0]
    u, v = solved[:2]
    size = float(np.sqrt(max(solved[2] + u * u + v * v, 1e-12)) * scale)
    focal = size * distance / radius
    look = -offset / distance
    tilt = np.arccos(look[2])
    theta = np.zeros((1, len(PARAMETERS)))
    theta[0, 0] = np.log(focal)
    theta[0, 1] = np.arctan2(look[0], -look[1]) - np.arctan(u * scale / focal) / np.sin(tilt)
    theta[0, 2] = tilt + np.arctan(v * scale * ratio / focal)
    theta[0, 3] = roll_rad
    theta[0, 4:7] = position_m
    return theta
