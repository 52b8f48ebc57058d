"""Pinhole camera with radial distortion, in SoccerNet's conventions (this folder's README)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.homography import scale_homography
from circlecal.geometry.projective import Array


def rotation_matrix(pan_rad: float, tilt_rad: float, roll_rad: float) -> Array:
    """World-to-camera rotation (3, 3): ``(Rz(pan) Rx(tilt) Rz(roll))^T``."""
    cp, sp, ct, st, cr, sr = (f(a) for a in (pan_rad, tilt_rad, roll_rad) for f in (np.cos, np.sin))
    rz_pan = np.array([[cp, -sp, 0.0], [sp, cp, 0.0], [0.0, 0.0, 1.0]])
    rx_tilt = np.array([[1.0, 0.0, 0.0], [0.0, ct, -st], [0.0, st, ct]])
    rz_roll = np.array([[cr, -sr, 0.0], [sr, cr, 0.0], [0.0, 0.0, 1.0]])
    return (rz_pan @ rx_tilt @ rz_roll).T


def pan_tilt_roll(R: ArrayLike) -> tuple[float, float, float]:
    """Angles of a world-to-camera rotation (3, 3); of the two solutions the one with the smaller absolute roll.

    Straight down only pan - or roll - is determined: the whole turn is then given to pan.
    """
    o = np.asarray(R, dtype=np.float64).T
    size = float(np.hypot(o[0, 2], o[1, 2]))
    if size < 1e-12:
        return float(np.arctan2(o[1, 0], o[0, 0])), float(np.arctan2(size, o[2, 2])), 0.0
    solutions = []
    for sign in (1.0, -1.0):
        pan = float(np.arctan2(sign * o[0, 2], -sign * o[1, 2]))
        # what pan and tilt leave of the rotation: exact also where the tilt is tiny
        cp, sp = np.cos(pan), np.sin(pan)
        roll = float(np.arctan2(-(cp * o[0, 1] + sp * o[1, 1]), cp * o[0, 0] + sp * o[1, 0]))
        solutions.append((pan, sign * float(np.arctan2(size, o[2, 2])), roll))
    return min(solutions, key=lambda s: abs(s[2]))


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole camera of one frame.

    Attributes
    ----------
    width, height : int
        Image size in pixels.
    focal_px : (2,) array
        Focal lengths along x and y.
    principal_point_px : (2,) array
        Principal point.
    angles_rad : (3,) array
        Pan, tilt, roll.
    position_m : (3,) array
        Position on the field; z is negative above the ground.
    kappa : (2,) array
        Radial distortion in half-widths.
    """

    width: int
    height: int
    focal_px: Array
    principal_point_px: Array
    angles_rad: Array
    position_m: Array
    kappa: Array

    @property
    def rotation(self) -> Array:
        """World-to-camera rotation (3, 3)."""
        return rotation_matrix(*self.angles_rad)

    @property
    def intrinsics(self) -> Array:
        """Calibration matrix K (3, 3)."""
        fx, fy = self.focal_px
        cx, cy = self.principal_point_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def homography(self) -> Array:
        """``H_image_field`` (3, 3) of the plane z = 0, to undistorted pixels."""
        R = self.rotation
        return scale_homography(self.intrinsics @ np.stack([R[:, 0], R[:, 1], -R @ self.position_m], axis=-1))

    def depth(self, points_m: ArrayLike) -> Array:
        """Depth (...,) along the optical axis of field points (..., 2 or 3), in metres."""
        return (self._lifted(points_m) - self.position_m) @ self.rotation[2]

    def project(self, points_m: ArrayLike, distort: bool = True) -> Array:
        """Pixels (..., 2) of field points (..., 2 or 3); nan behind the camera."""
        camera = (self._lifted(points_m) - self.position_m) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            normalised = np.where(camera[..., 2:] > 1e-3, camera[..., :2] / camera[..., 2:], np.nan)
        pixels = normalised * self.focal_px + self.principal_point_px
        return self.distort(pixels) if distort else pixels

    def distort(self, undistorted_px: ArrayLike) -> Array:
        """Distorted pixels (..., 2) of undistorted ones."""
        offset, r2 = self._radial(undistorted_px)
        return offset * (1.0 + self.kappa[0] * r2 + self.kappa[1] * r2 * r2)[..., None] + self.principal_point_px

    def undistort(self, distorted_px: ArrayLike) -> Array:
        """Undistorted pixels (..., 2), nan where the iteration runs away: Newton's on the radius."""
        offset, r2 = self._radial(distorted_px)
        target = np.sqrt(r2)
        r = target.copy()
        k1, k2 = self.kappa
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(20):
                squared = r * r
                value = r * (1 + squared * (k1 + k2 * squared)) - target
                slope = np.maximum(1 + squared * (3 * k1 + 5 * k2 * squared), 0.2)
                step = value / slope
                r = r - step
                if not (np.abs(step) > 1e-9 * r).any():  # the next one would be its square
                    break
        r = np.where(np.isfinite(r), r, np.nan)
        factor = np.where(target > 0, r / np.where(target > 0, target, 1.0), 1.0)
        return offset * factor[..., None] + self.principal_point_px

    def back_project(self, pixels: ArrayLike) -> Array:
        """Field points (..., 2) on the plane z = 0 seen at distorted pixels (..., 2); nan above the horizon."""
        undistorted = self.undistort(pixels)
        ray = np.concatenate(
            [(undistorted - self.principal_point_px) / self.focal_px, np.ones((*undistorted.shape[:-1], 1))], axis=-1
        )
        ray = ray @ self.rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.where(ray[..., 2] * -self.position_m[2] > 0, -self.position_m[2] / ray[..., 2], np.nan)
        return self.position_m[:2] + along[..., None] * ray[..., :2]

    def turned(self) -> Camera:
        """The same picture seen from the other side: the field turned by 180 degrees about the z axis."""
        pan = (self.angles_rad[0] + 2 * np.pi) % (2 * np.pi) - np.pi
        return replace(
            self,
            angles_rad=np.array([pan, self.angles_rad[1], self.angles_rad[2]]),
            position_m=self.position_m * np.array([-1.0, -1.0, 1.0]),
        )

    def soccernet(self) -> dict[str, Any]:
        """SoccerNet camera keys at the frame's own size."""
        pan, tilt, roll = np.degrees(self.angles_rad)
        scale = 2.0 * float(self.focal_px[0]) / self.width
        return {
            "pan_degrees": float(pan),
            "tilt_degrees": float(tilt),
            "roll_degrees": float(roll),
            "position_meters": [float(v) for v in self.position_m],
            "x_focal_length": float(self.focal_px[0]),
            "y_focal_length": float(self.focal_px[1]),
            "principal_point": [float(v) for v in self.principal_point_px],
            "radial_distortion": [float(self.kappa[0] * scale**2), float(self.kappa[1] * scale**4), 0.0, 0.0, 0.0, 0.0],
            "tangential_distortion": [0.0, 0.0],
            "thin_prism_distortion": [0.0, 0.0, 0.0, 0.0],
        }

    def _radial(self, pixels: ArrayLike) -> tuple[Array, Array]:
        # the radius is measured on the focal plane in units of half the width, so non-square pixels stay round
        offset = np.asarray(pixels, dtype=np.float64) - self.principal_point_px
        aspect = np.array([1.0, self.focal_px[0] / self.focal_px[1]])
        return offset, np.sum((offset * aspect) ** 2, axis=-1) / (self.width / 2.0) ** 2

    @staticmethod
    def _lifted(points_m: ArrayLike) -> Array:
        points = np.asarray(points_m, dtype=np.float64)
        if points.shape[-1] == 3:
            return points
        return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)


def image_center(width: int, height: int) -> Array:
    """Centre of the image in pixels: ``((W-1)/2, (H-1)/2)``."""
    return np.array([(width - 1) / 2.0, (height - 1) / 2.0])


def camera_from_soccernet(record: dict[str, Any], width: int, height: int) -> Camera:
    """Camera from SoccerNet's keys at the frame's own size (two radial coefficients are read)."""
    focal = np.array([record["x_focal_length"], record["y_focal_length"]], dtype=np.float64)
    scale = 2.0 * focal[0] / width
    radial = list(record.get("radial_distortion") or [0.0, 0.0])
    return Camera(
        width=width,
        height=height,
        focal_px=focal,
        principal_point_px=np.asarray(record["principal_point"], dtype=np.float64),
        angles_rad=np.radians([record["pan_degrees"], record["tilt_degrees"], record["roll_degrees"]]),
        position_m=np.asarray(record["position_meters"], dtype=np.float64),
        kappa=np.array([radial[0] / scale**2, radial[1] / scale**4]),
    )


def camera_from_homography(H_image_field: ArrayLike, width: int, height: int) -> Camera | None:
    """Camera with square pixels and the principal point at the image centre from a homography.

    The focal length follows from the orthogonality and the equal length of the first two columns of ``K^-1 H`` (H&Z
    section 8.6; weighted least squares of both constraints). None where no positive focal length fits.
    """
    center = image_center(width, height)
    shift = np.array([[1.0, 0.0, -center[0]], [0.0, 1.0, -center[1]], [0.0, 0.0, 1.0]])
    h = shift @ np.asarray(H_image_field, dtype=np.float64)
    h = h / np.linalg.norm(h[:2])
    a, b = h[:, 0], h[:, 1]
    # inverse squared focal length w: w (a0 b0 + a1 b1) + a2 b2 = 0 and w (|a01|^2 - |b01|^2) + a2^2 - b2^2 = 0
    lhs = np.array([a[:2] @ b[:2], a[:2] @ a[:2] - b[:2] @ b[:2]])
    rhs = -np.array([a[2] * b[2], a[2] ** 2 - b[2] ** 2])
    if not lhs @ lhs > 0:
        return None
    w = (lhs @ rhs) / (lhs @ lhs)
    if not w > 0:
        return None
    focal = 1.0 / np.sqrt(w)
    columns = np.diag([1 / focal, 1 / focal, 1.0]) @ h
    columns = columns / np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
    if columns[2, 2] < 0:
        columns = -columns
    u, _, vt = np.linalg.svd(columns[:, :2], full_matrices=False)
    r12 = u @ vt
    R = np.column_stack([r12, np.cross(r12[:, 0], r12[:, 1])])
    position = -R.T @ columns[:, 2]
    return Camera(
        width=width,
        height=height,
        focal_px=np.array([focal, focal]),
        principal_point_px=center,
        angles_rad=np.array(pan_tilt_roll(R)),
        position_m=position,
        kappa=np.zeros(2),
    )
