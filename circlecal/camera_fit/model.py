"""The camera's parameters, and projection with its analytic Jacobian, for a batch of cameras at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.homogeneous import Array
from circlecal.geometry.pinhole import Camera, image_center

PARAMETERS = (
    "log_focal", "pan", "tilt", "roll", "x", "y", "z",
    "pp_x", "pp_y", "kappa_1", "kappa_2", "log_aspect", "crown", "width", "bloom", "length", "breadth",
)  # fmt: skip
"""Order of the parameter vector.

Focal length as its logarithm; angles in radians; position in metres; principal point as an offset from the image
centre in pixels; kappa in half-widths; aspect
as the logarithm of fy / fx; crown in metres; marking width as an offset from the template's in metres; bloom in
pixels (how far blur moves each edge outwards); length and
breadth of the field as offsets from the template's in metres.
"""
INDEX = {name: k for k, name in enumerate(PARAMETERS)}
CROWN_SHAPES = ("parabola", "roof", "flat")


@dataclass(frozen=True, slots=True)
class Frame:
    """What is the same for every candidate camera of a frame: picture size, crown profile and the |y| at which it is
    quoted.
    """

    width: int
    height: int
    crown_shape: str = "parabola"
    crown_reference_m: float = 9.15

    @property
    def center(self) -> Array:
        """Image centre (2,)."""
        return image_center(self.width, self.height)

    def sag(self, y: Array) -> tuple[Array, Array]:
        """Drop of the surface per metre of crown at y, and its derivative by y; the shapes of the names in
        CROWN_SHAPES.
        """
        t = y / self.crown_reference_m
        if self.crown_shape == "parabola":
            return t * t, 2 * t / self.crown_reference_m
        if self.crown_shape == "roof":
            return np.abs(t), np.sign(t) / self.crown_reference_m
        return np.zeros_like(t), np.zeros_like(t)


def camera_of(theta: Array, frame: Frame) -> Camera:
    """Camera of one parameter vector (P,)."""
    focal = np.exp(theta[INDEX["log_focal"]])
    return Camera(
        width=frame.width,
        height=frame.height,
        focal_px=np.array([focal, focal * np.exp(theta[INDEX["log_aspect"]])]),
        principal_point_px=frame.center + theta[7:9],
        angles_rad=theta[1:4].copy(),
        position_m=theta[4:7].copy(),
        kappa=theta[9:11].copy(),
    )


def theta_of(camera: Camera, frame: Frame) -> Array:
    """Parameter vector (P,) of a camera; crown, width and bloom are zero."""
    theta = np.zeros(len(PARAMETERS))
    theta[0] = np.log(camera.focal_px[0])
    theta[1:4] = camera.angles_rad
    theta[4:7] = camera.position_m
    theta[7:9] = camera.principal_point_px - frame.center
    theta[9:11] = camera.kappa
    theta[INDEX["log_aspect"]] = np.log(camera.focal_px[1] / camera.focal_px[0])
    return theta


_ABOUT_Z = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
_ABOUT_X = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def rotations(theta: Array) -> Array:
    """World-to-camera rotations (B, 3, 3): ``Rz(roll)^T Rx(tilt)^T Rz(pan)^T``."""
    cp, ct, cr = np.cos(theta[:, 1:4]).T
    sp, st, sr = np.sin(theta[:, 1:4]).T
    R = np.empty((len(theta), 3, 3))
    R[:, 0, 0], R[:, 0, 1], R[:, 0, 2] = cr * cp - sr * ct * sp, cr * sp + sr * ct * cp, sr * st
    R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = -sr * cp - cr * ct * sp, -sr * sp + cr * ct * cp, cr * st
    R[:, 2, 0], R[:, 2, 1], R[:, 2, 2] = st * sp, -st * cp, ct
    return R


def rotation_derivatives(theta: Array, R: Array) -> Array:
    """Derivatives (B, 3, 3, 3) of the rotations by pan, tilt and roll, through the generators of the two axes."""
    c, s = np.cos(theta[:, 3]), np.sin(theta[:, 3])
    rolled = np.zeros((len(theta), 3, 3))
    rolled[:, 0, 0] = rolled[:, 1, 1] = c
    rolled[:, 0, 1], rolled[:, 1, 0], rolled[:, 2, 2] = s, -s, 1.0
    by_tilt = rolled @ _ABOUT_X @ np.swapaxes(rolled, 1, 2) @ R
    return np.stack([R @ _ABOUT_Z, by_tilt, _ABOUT_Z @ R], axis=1)


@dataclass(frozen=True, slots=True)
class Projection:
    """Pixels (B, N, 2), depths (B, N), derivative by the parameters (B, N, 2, P) and by the field position (B, N, 2,
    2).
    """

    pixels: Array
    depth: Array
    by_theta: Array
    by_field: Array


def project(theta: Array, field_m: Array, frame: Frame) -> Projection:
    """Project field points, on the crowned surface, with the lens, for a batch of cameras.

    Parameters
    ----------
    theta : (B, P) array
        Parameter vectors.
    field_m : (B, N, 2) array
        Points on the field.
    frame : Frame
        Picture size and crown.
    """
    B, N = field_m.shape[:2]
    crown = theta[:, INDEX["crown"], None]
    sag, slope = frame.sag(field_m[..., 1])
    world = np.concatenate([field_m, (crown * sag)[..., None]], axis=-1)
    R = rotations(theta)
    dR = rotation_derivatives(theta, R)
    offset = world - theta[:, None, 4:7]
    local = offset @ np.swapaxes(R, 1, 2)
    depth = np.where(np.abs(local[..., 2]) < 1e-6, 1e-6, local[..., 2])
    normalised = local[..., :2] / depth[..., None]
    # derivative of the camera's coordinates by (pan, tilt, roll, x, y, z, crown) and by the field's (x, y)
    by = np.empty((B, N, 3, 9))
    by[..., 0:3] = np.einsum("bkij,bnj->bnik", dR, offset)
    by[..., 3:6] = -R[:, None]
    by[..., 6] = R[:, None, :, 2] * sag[..., None]
    by[..., 7] = R[:, None, :, 0]
    by[..., 8] = R[:, None, :, 1] + R[:, None, :, 2] * (crown * slope)[..., None]
    dn = (by[..., :2, :] - normalised[..., None] * by[..., 2:, :]) / depth[..., None, None]
    focal = np.exp(theta[:, 0])[:, None]
    aspect = np.exp(theta[:, INDEX["log_aspect"]])[:, None]
    scales = np.stack([focal, focal * aspect], axis=-1)
    half = frame.width / 2.0
    n2 = np.sum(normalised**2, axis=-1)
    r2 = n2 * (focal / half) ** 2
    k1, k2 = theta[:, 9, None], theta[:, 10, None]
    lens = 1.0 + k1 * r2 + k2 * r2 * r2
    by_r2 = k1 + 2 * k2 * r2
    dr2 = 2 * (focal / half)[..., None] ** 2 * np.einsum("bni,bnik->bnk", normalised, dn)
    undistorted = scales * normalised
    pixels = undistorted * lens[..., None] + (frame.center + theta[:, None, 7:9])
    moved = (
        scales[..., None] * dn * lens[..., None, None] + undistorted[..., None] * (by_r2[..., None] * dr2)[..., None, :]
    )
    jacobian = np.zeros((B, N, 2, len(PARAMETERS)))
    jacobian[..., 0] = undistorted * (lens + 2 * by_r2 * r2)[..., None]
    jacobian[..., 1:7] = moved[..., 0:6]
    jacobian[..., 0, 7] = jacobian[..., 1, 8] = 1.0
    jacobian[..., 9] = undistorted * r2[..., None]
    jacobian[..., 10] = undistorted * (r2 * r2)[..., None]
    jacobian[..., 1, INDEX["log_aspect"]] = undistorted[..., 1] * lens
    jacobian[..., INDEX["crown"]] = moved[..., 6]
    return Projection(pixels, local[..., 2], jacobian, moved[..., 7:9])


@dataclass(frozen=True, slots=True)
class Seen:
    """Pixels (B, N, 2) and depths (B, N), and where asked the derivative by the field position (B, N, 2, 2)."""

    pixels: Array
    depth: Array
    by_field: Array | None


def project_pixels(theta: Array, field_m: Array, frame: Frame, derivative: bool = False) -> Seen:
    """:func:`project` without the derivatives by the parameters, for scanning and for moving along a marking."""
    sag, slope = frame.sag(field_m[..., 1])
    crown = theta[:, INDEX["crown"], None]
    R = rotations(theta)
    local = np.empty((*field_m.shape[:2], 3))
    offset_x, offset_y = field_m[..., 0] - theta[:, 4, None], field_m[..., 1] - theta[:, 5, None]
    offset_z = crown * sag - theta[:, 6, None]
    for k in range(3):
        local[..., k] = R[:, k, 0, None] * offset_x + R[:, k, 1, None] * offset_y + R[:, k, 2, None] * offset_z
    depth = np.where(np.abs(local[..., 2]) < 1e-6, 1e-6, local[..., 2])
    x, y = local[..., 0] / depth, local[..., 1] / depth
    focal = np.exp(theta[:, 0])[:, None]
    focal_y = focal * np.exp(theta[:, INDEX["log_aspect"], None])
    scale = (2 * focal / frame.width) ** 2
    r2 = (x * x + y * y) * scale
    k1, k2 = theta[:, 9, None], theta[:, 10, None]
    lens = 1.0 + k1 * r2 + k2 * r2 * r2
    pixels = np.empty((*field_m.shape[:2], 2))
    pixels[..., 0] = focal * x * lens + (frame.center[0] + theta[:, 7, None])
    pixels[..., 1] = focal_y * y * lens + (frame.center[1] + theta[:, 8, None])
    if not derivative:
        return Seen(pixels, local[..., 2], None)
    by_field = np.empty((*field_m.shape[:2], 2, 2))
    by_r2 = k1 + 2 * k2 * r2
    for k in range(2):
        d = [R[:, row, k, None] + (R[:, row, 2, None] * crown * slope if k == 1 else 0.0) for row in range(3)]
        dx, dy = (d[0] - x * d[2]) / depth, (d[1] - y * d[2]) / depth
        bend = by_r2 * 2 * scale * (x * dx + y * dy)
        by_field[..., 0, k] = focal * (dx * lens + x * bend)
        by_field[..., 1, k] = focal_y * (dy * lens + y * bend)
    return Seen(pixels, local[..., 2], by_field)


def active_parameters(sd: Array) -> NDArray[np.int_]:
    """Indices of the parameters that are estimated: those whose prior standard deviation is not zero."""
    return np.flatnonzero(sd > 0)
