"""Coordinates in which the camera's weak direction is straight: where the circle's centre is seen, and from where it
is looked at.

Zooming in while stepping back hardly changes the picture of a circle. In focal length, angles and position that path
is strongly bent, and an optimiser creeps along it; in the logarithms of focal length and distance, the two viewing
angles, and the pixel of the circle's centre it is nearly a line.

An overhead camera may look past its nadir, so that the circle's centre lies behind the point that it stands above. Its
elevation then goes on beyond 90 degrees, with the azimuth of the other side: every camera has coordinates of its own.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from circlecal.geometry.camera_parameters import rotations
from circlecal.geometry.projective import Array, Mask, freeze

VIEWING = 7
"""The first seven parameters are replaced: log focal length, u, v, roll, log distance, azimuth, elevation."""
LEAST_BEFORE = 0.1
"""Of its distance the centre lies at least so much before or behind the nadir, the way the camera is panned, for steps
in these coordinates: beside the nadir they fold back, and no step leads across.
"""


def to_viewing(theta: Array, center_m: Array) -> Array:
    """Viewing coordinates (B, 7) of parameter vectors (B, P) about a centre (2,), or one for each (B, 2); not finite
    where it lies behind the camera.
    """
    _, offset, seen = _toward(theta, center_m)
    return _viewing_coordinates(theta, offset, seen)


def to_viewing_with_jacobian(theta: Array, center_m: Array) -> tuple[Array, Array, Mask]:
    """:func:`to_viewing`, :func:`viewing_jacobian` and whether both are finite (B,), not to be written to."""
    return _look_from(theta.tobytes(), theta.shape[1], center_m.astype(np.float64, copy=False).tobytes())


@lru_cache(maxsize=4)
def _look_from(theta: bytes, width: int, center_m: bytes) -> tuple[Array, Array, Mask]:
    """Viewing coordinates and their Jacobian, kept for the next steps: two of five begin where the last one did."""
    rows, center = np.frombuffer(theta).reshape(-1, width), np.frombuffer(center_m).reshape(-1, 2)
    R, offset, seen = _toward(rows, center)
    viewing, by_viewing = _viewing_coordinates(rows, offset, seen), _jacobian(rows, R, offset, seen)
    usable: Mask = np.isfinite(viewing.sum(axis=1) + by_viewing.sum(axis=(1, 2)))
    return freeze(viewing), freeze(by_viewing), freeze(usable)


def _toward(theta: Array, center_m: Array) -> tuple[Array, Array, Array]:
    """Rotations (B, 3, 3), offsets (B, 3) from the circle's centre to the cameras, and the centre (B, 3) as seen."""
    R = rotations(theta)
    offset = theta[:, 4:7].copy()
    offset[:, :2] -= center_m
    return R, offset, -(R @ offset[..., None])[..., 0]


def _viewing_coordinates(theta: Array, offset: Array, seen: Array) -> Array:
    log_focal, pan, _, roll = columns_of(theta[:, :4])
    x, y, z = columns_of(offset)
    right, down, depth = columns_of(np.where(seen[:, 2:] > 0, seen, np.nan))
    level2, focal = x * x + y * y, np.exp(log_focal)
    viewing = np.empty((len(theta), VIEWING))
    viewing[:, 0], viewing[:, 3] = log_focal, roll
    viewing[:, 1], viewing[:, 2] = focal * right / depth, focal * down / depth
    viewing[:, 4] = 0.5 * np.log(level2 + z * z)
    side = np.copysign(1.0, _before_nadir(pan, x, y))
    viewing[:, 5] = np.arctan2(side * x, side * y)
    viewing[:, 6] = np.arctan2(-z, side * np.sqrt(level2))
    return viewing


def _before_nadir(pan: Array | float, x: Array | float, y: Array | float) -> Array:
    """How far the centre lies before the nadir of a camera with an offset from it, the way this is panned, metres."""
    return np.asarray(np.cos(pan) * y - np.sin(pan) * x)


def columns_of(rows: Array) -> list[Array] | list[float]:
    """Columns of (B, K); those of a single row as plain numbers, since numpy's calls take many times as long as what
    they work out there.
    """
    return rows[0].tolist() if len(rows) == 1 else list(rows.T)


def from_viewing(viewing: Array, center_m: Array) -> Array:
    """Inverse of :func:`to_viewing`: log focal length, pan, tilt, roll, x, y, z (B, 7) of an upright camera."""
    log_focal, u, v, roll, log_distance, azimuth, elevation = columns_of(viewing)
    center_x, center_y = columns_of(center_m.reshape(-1, 2))
    distance, level = np.exp(log_distance), np.cos(elevation)
    towards_x, towards_y, towards_z = -np.sin(azimuth) * level, -np.cos(azimuth) * level, np.sin(elevation)
    focal = np.exp(log_focal)
    unit = 1.0 / np.sqrt(u * u + v * v + focal * focal)
    # undo the roll, then pan and tilt turn the direction to the centre into this ray
    c, s = np.cos(roll) * unit, np.sin(roll) * unit
    x, y, z = c * u - s * v, s * u + c * v, focal * unit
    ahead = np.copysign(np.sqrt(np.maximum(level * level - x * x, 0.0)), -level)
    theta = np.empty((len(viewing), VIEWING))
    theta[:, 0], theta[:, 3] = log_focal, roll
    theta[:, 1] = _wrap_angle(np.arctan2(towards_y, towards_x) - np.arctan2(ahead, x))
    theta[:, 2] = _wrap_angle(np.arctan2(towards_z, ahead) - np.arctan2(z, y))
    theta[:, 4] = center_x - distance * towards_x
    theta[:, 5] = center_y - distance * towards_y
    theta[:, 6] = -distance * towards_z
    return theta


def viewing_jacobian(theta: Array, center_m: Array) -> Array:
    """Derivative (B, 7, 7) of :func:`from_viewing` at the viewing coordinates of theta (B, P).

    It is the inverse of that of :func:`to_viewing`: the identity where the centre lies behind the camera, nan where
    there is none (straight above it) and near there, by :data:`LEAST_BEFORE`.
    """
    return _jacobian(theta, *_toward(theta, center_m))


def _jacobian(theta: Array, R: Array, offset: Array, local: Array) -> Array:
    ahead = local[:, 2] > 0
    is_ahead = bool(ahead.all())
    log_focal, pan, _, roll = columns_of(theta[:, :4])
    x, y, z = columns_of(offset)
    right, down, depth = columns_of(local if is_ahead else np.where(ahead[:, None], local, 1.0))
    level2 = np.maximum(x * x + y * y, 1e-12)
    distance2 = level2 + z * z
    before = _before_nadir(pan, x, y)
    level = np.copysign(np.sqrt(level2), before)
    focal, c, s = np.exp(log_focal), np.cos(roll), np.sin(roll)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = columns_of(R.reshape(-1, 9))
    # of the centre before the camera by pan, tilt, roll, x, y, z: to the right, down, and ahead
    change = (
        (r01 * x - r00 * y, s * depth, down, -r00, -r01, -r02),
        (r11 * x - r10 * y, c * depth, -right, -r10, -r11, -r12),
        (r21 * x - r20 * y, -(s * right + c * down), 0.0, -r20, -r21, -r22),
    )
    forward = np.zeros((len(theta), VIEWING, VIEWING))
    scale = focal / depth
    for row, normalised in ((1, right / depth), (2, down / depth)):
        forward[:, row, 0] = focal * normalised
        for column in range(1, VIEWING):
            forward[:, row, column] = scale * (change[row - 1][column - 1] - normalised * change[2][column - 1])
    forward[:, 0, 0] = forward[:, 3, 3] = 1.0
    forward[:, 4, 4], forward[:, 4, 5], forward[:, 4, 6] = x / distance2, y / distance2, z / distance2
    forward[:, 5, 4], forward[:, 5, 5] = y / level2, -x / level2
    rise = z / (level * distance2)
    forward[:, 6, 4], forward[:, 6, 5], forward[:, 6, 6] = x * rise, y * rise, -level / distance2
    if not is_ahead:
        forward[~ahead] = np.eye(VIEWING)
    try:
        inverse = np.linalg.inv(forward)
    except np.linalg.LinAlgError:
        singular = ~(np.abs(np.linalg.det(forward)) > 0)
        forward[singular] = np.eye(VIEWING)
        inverse = np.linalg.inv(forward)
        inverse[singular] = np.nan
    inverse[ahead & (np.abs(before) < LEAST_BEFORE * np.sqrt(distance2))] = np.nan
    return np.asarray(inverse, dtype=np.float64)


def _wrap_angle(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi
