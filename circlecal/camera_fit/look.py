"""Coordinates in which the camera's weak direction is straight: where the circle's centre is seen, and from where it
is looked at.

Zooming in while stepping back hardly changes the picture of a circle. In focal length, angles and position that path
is strongly bent, and an optimiser
creeps along it; in the logarithms of focal length and distance, the two viewing angles, and the pixel of the circle's
centre it is nearly a line.
"""

from __future__ import annotations

import numpy as np

from circlecal.camera_fit.model import rotations
from circlecal.geometry.homogeneous import Array

LOOK = 7
"""The first seven parameters are replaced: log focal length, u, v, roll, log distance, azimuth, elevation."""


def to_look(theta: Array, center_m: Array) -> Array:
    """Look coordinates (B, 7) of parameter vectors (B, P); not finite where the circle's centre lies behind the
    camera.
    """
    offset = theta[:, 4:7] - np.r_[center_m, 0.0]
    distance = np.linalg.norm(offset, axis=1)
    seen = -(rotations(theta) @ offset[..., None])[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixel = np.exp(theta[:, :1]) * np.where(seen[:, 2:] > 0, seen[:, :2] / seen[:, 2:], np.nan)
        return np.column_stack(
            [
                theta[:, 0],
                pixel,
                theta[:, 3],
                np.log(distance),
                np.arctan2(offset[:, 0], offset[:, 1]),
                np.arcsin(np.clip(-offset[:, 2] / distance, -1.0, 1.0)),
            ]
        )


def from_look(look: Array, center_m: Array) -> Array:
    """Inverse of :func:`to_look`: log focal length, pan, tilt, roll, x, y, z (B, 7) of an upright camera."""
    log_focal, u, v, roll, log_distance, azimuth, elevation = look.T
    distance, level = np.exp(log_distance), np.cos(elevation)
    offset = distance[:, None] * np.stack(
        [np.sin(azimuth) * level, np.cos(azimuth) * level, -np.sin(elevation)], axis=-1
    )
    towards = -offset / distance[:, None]
    ray = np.stack([u, v, np.exp(log_focal)], axis=-1)
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    # undo the roll, then pan and tilt turn the direction to the centre into this ray
    c, s = np.cos(roll), np.sin(roll)
    x, y, z = c * ray[:, 0] - s * ray[:, 1], s * ray[:, 0] + c * ray[:, 1], ray[:, 2]
    ahead = -np.sqrt(np.maximum(towards[:, 0] ** 2 + towards[:, 1] ** 2 - x**2, 0.0))
    tilt = np.arctan2(towards[:, 2], ahead) - np.arctan2(z, y)
    pan = np.arctan2(towards[:, 1], towards[:, 0]) - np.arctan2(ahead, x)
    return np.column_stack([log_focal, _wrapped(pan), _wrapped(tilt), roll, offset + np.r_[center_m, 0.0]])


def look_jacobian(theta: Array, center_m: Array) -> Array:
    """Derivative (B, 7, 7) of :func:`from_look` at the look coordinates of theta (B, P): the inverse of that of
    :func:`to_look`. Identity where the centre lies behind the camera, nan where it has no inverse (straight above it).
    """
    R = rotations(theta)
    offset = theta[:, 4:7] - np.r_[center_m, 0.0]
    x, y, z = offset.T
    level2 = np.maximum(x * x + y * y, 1e-12)
    distance2 = level2 + z * z
    local = -(R @ offset[..., None])[..., 0]
    ahead = local[:, 2] > 0
    c, s = np.cos(theta[:, 3]), np.sin(theta[:, 3])
    change = np.zeros((len(theta), 3, LOOK))
    change[:, :, 1] = R[:, :, 1] * x[:, None] - R[:, :, 0] * y[:, None]
    change[:, 0, 2], change[:, 1, 2] = s * local[:, 2], c * local[:, 2]
    change[:, 2, 2] = -(s * local[:, 0] + c * local[:, 1])
    change[:, 0, 3], change[:, 1, 3] = local[:, 1], -local[:, 0]
    change[:, :, 4:7] = -R
    normalised = local[:, :2] / np.where(ahead, local[:, 2], 1.0)[:, None]
    per_depth = (np.exp(theta[:, 0]) / np.where(ahead, local[:, 2], 1.0))[:, None, None]
    forward = np.zeros((len(theta), LOOK, LOOK))
    forward[:, 1:3] = per_depth * (change[:, :2] - normalised[..., None] * change[:, 2:])
    forward[:, 1:3, 0] = np.exp(theta[:, :1]) * normalised
    forward[:, 0, 0] = forward[:, 3, 3] = 1.0
    forward[:, 4, 4:7] = offset / distance2[:, None]
    forward[:, 5, 4], forward[:, 5, 5] = y / level2, -x / level2
    level = np.sqrt(level2)
    forward[:, 6, 4:6] = offset[:, :2] * (z / (level * distance2))[:, None]
    forward[:, 6, 6] = -level / distance2
    forward[~ahead] = np.eye(LOOK)
    singular = ~(np.abs(np.linalg.det(forward)) > 0)
    forward[singular] = np.eye(LOOK)
    inverse = np.linalg.inv(forward)
    inverse[singular] = np.nan
    return np.asarray(inverse, dtype=np.float64)


def _wrapped(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi
