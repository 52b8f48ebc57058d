"""Starts of the optimiser: the closed forms where they apply, and a grid over distance, height and side."""

from __future__ import annotations

import numpy as np

from circlecal.camera_fit.model import PARAMETERS, Frame, theta_of
from circlecal.geometry.conics import Ellipse
from circlecal.geometry.homogeneous import Array
from circlecal.geometry.homography import SIDES, camera_side_of, homography_from_circle, turn_homography
from circlecal.geometry.pinhole import camera_from_homography, image_center
from circlecal.geometry.single_circle import pinhole_centers

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
    frame: Frame,
    side: str,
) -> Array:
    """Upright cameras (B, P) from the circle, a line of known direction through its centre and, where seen, the
    imaged centre.

    Parameters
    ----------
    conic : (3, 3) array
        Image of the circle of ``radius``.
    center : (3,) array or None
        Imaged centre where a mark shows it; otherwise every centre that a pinhole camera allows is a start.
    line : (3,) array or None
        Image of the line; without one there is no closed form.
    direction : (2,) array
        Its direction on the field.
    field_center, radius : (2,) array, float
        The circle.
    frame : Frame
        Picture size.
    side : str
        Prior on the camera's side.
    """
    if line is None:
        return np.zeros((0, len(PARAMETERS)))
    centers = [c.center for c in pinhole_centers(conic, line, image_center(frame.width, frame.height), frame.width)]
    if center is not None:
        centers.insert(0, center)
    starts = []
    for candidate in centers:
        H = homography_from_circle(conic, candidate, line, field_center, radius, direction)
        if H is None:
            continue
        if camera_side_of(H, side) < 0:
            H = turn_homography(H, field_center)
        camera = camera_from_homography(H, frame.width, frame.height)
        if camera is not None and camera.position_m[2] < 0 and camera.angles_rad[1] > 0:
            starts.append(theta_of(camera, frame))
    return np.array(starts).reshape(-1, len(PARAMETERS))


def grid_starts(ellipse: Ellipse, field_center: Array, radius: float, frame: Frame, side: str) -> Array:
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
    shift = (ellipse.center - frame.center) / focal[:, None]
    tilt = np.arccos(look[:, 2])
    theta[:, 0] = np.log(focal)
    theta[:, 1] = np.arctan2(look[:, 0], -look[:, 1]) - np.arctan(shift[:, 0]) / np.sin(tilt)
    theta[:, 2] = tilt + np.arctan(shift[:, 1])
    theta[:, 4:7] = position + np.r_[field_center, 0.0]
    return theta[position[:, :2] @ np.array(SIDES[side]) >= -1e-9]
