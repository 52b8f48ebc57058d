"""Pinhole camera with radial distortion, in SoccerNet's conventions (this folder's README)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.homography import scale_homography
from circlecal.geometry.projective import Array, lift
from circlecal.geometry.surface import FLAT, Surface

NEAREST_M = 0.1
"""Depth from which on a point counts as in front of the camera, metres: no camera stands nearer to a marking that it
shows, and closer to its own plane pixels run away to millions.
"""
_LENS_ROUNDS, _LENS_TOLERANCE = 60, 1e-9
"""Steps of Newton's iteration for the inverse of the lens, and the relative step that ends it; four or five are usual,
near the fold its convergence is linear.
"""
_LEAST_FACTOR = 4.0 / 9.0
"""Of its distance the lens leaves a point at least so much before it folds: ``1 - k1^2 / (4 k2)`` at
``9 k1^2 = 20 k2``.
"""


def rotation_matrix(pan_rad: ArrayLike, tilt_rad: ArrayLike, roll_rad: ArrayLike) -> Array:
    """World-to-camera rotations (..., 3, 3), ``(Rz(pan) Rx(tilt) Rz(roll))^T`` multiplied out, of angles (...)."""
    return rotations_by(np.stack(np.broadcast_arrays(pan_rad, tilt_rad, roll_rad), axis=-1).astype(np.float64))


def rotations_by(angles: Array) -> Array:
    """:func:`rotation_matrix` of pan, tilt and roll (..., 3), radians."""
    (cp, ct, cr), (sp, st, sr) = np.cos(angles.T), np.sin(angles.T)
    if angles.size == 3:
        # one camera: plain numbers, since numpy's calls take many times as long as what they work out
        cp, ct, cr, sp, st, sr = (value.item() for value in (cp, ct, cr, sp, st, sr))
    entries = (
        cr * cp - sr * ct * sp, cr * sp + sr * ct * cp, sr * st,
        -sr * cp - cr * ct * sp, -sr * sp + cr * ct * cp, cr * st,
        st * sp, -st * cp, ct,
    )  # fmt: skip
    if angles.size == 3:
        return np.array(entries).reshape(*angles.shape, 3)
    R = np.empty((*angles.shape[:-1], 9))
    for k, entry in enumerate(entries):
        R[..., k] = entry.T
    return R.reshape(*angles.shape, 3)


def lens_factor(r2: Array, k1: Array | float, k2: Array | float) -> tuple[Array, Array]:
    """By what the lens multiplies the distance from the principal point, and the derivative of that factor by ``r2``.

    Parameters
    ----------
    r2 : array
        Squared distance of the undistorted point, in half-widths of the picture, pixels made square.
    k1, k2 : float, or arrays that broadcast with it
        Radial distortion; the factor is ``1 + k1 r^2 + k2 r^4`` (Brown's model).
    """
    second = k2 * r2
    slope = k1 + second
    factor = 1.0 + r2 * slope
    return factor, slope + second


def lens_fold(k1: ArrayLike, k2: ArrayLike) -> Array:
    """Squared radius (in half-widths, undistorted) at which the lens model folds back; inf where it never does.

    ``r (1 + k1 r^2 + k2 r^4)`` grows up to the smallest positive root of its derivative ``1 + 3 k1 r^2 + 5 k2 r^4``; a
    barrel model puts what lies further out back into the picture, where no lens puts it.
    """
    k1, k2 = np.asarray(k1, dtype=np.float64), np.asarray(k2, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # the root a x^2 + b x + 1 = 0 as 2 / (-b + sqrt(b^2 - 4 a)), which is finite for a = 0 too
        toward = -3.0 * k1 + np.sqrt(9.0 * k1 * k1 - 20.0 * k2)
        return np.asarray(np.where(toward > 0.0, 2.0 / toward, np.inf))


@lru_cache(maxsize=64)
def _fold_of(k1: float, k2: float) -> float:
    """Where one lens folds back, which all pictures of points by a camera ask for."""
    return float(lens_fold(k1, k2))


def plane_homography(K: Array, R: Array, position_m: Array) -> Array:
    """``H_image_field = K [r1 r2 -R C]`` (..., 3, 3) of the plane z = 0, not scaled (H&Z 8.1.1).

    From calibration matrices K and rotations R (..., 3, 3) and positions C (..., 3).
    """
    local = R.copy()
    local[..., 2] = -(R @ position_m[..., None])[..., 0]
    return K @ local


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


@dataclass(frozen=True, slots=True, eq=False)
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
    def K(self) -> Array:
        """Calibration matrix (3, 3), as OpenCV takes it."""
        fx, fy = self.focal_px
        cx, cy = self.principal_point_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def R(self) -> Array:
        """World-to-camera rotation (3, 3), as OpenCV takes it."""
        return rotations_by(self.angles_rad)

    @property
    def t(self) -> Array:
        """Translation (3,), as OpenCV takes it: a point X of the field lies at ``R X + t`` before the camera."""
        return np.asarray(-self.R @ self.position_m)

    @property
    def dist(self) -> Array:
        """Distortion coefficients (k1, k2, p1, p2), as OpenCV takes them: on the plane at distance 1."""
        per_half_width = 2.0 * float(self.focal_px[0]) / self.width
        return np.array([self.kappa[0] * per_half_width**2, self.kappa[1] * per_half_width**4, 0.0, 0.0])

    @property
    def homography(self) -> Array:
        """``H_image_field`` (3, 3) of the plane z = 0, to undistorted pixels."""
        return scale_homography(plane_homography(self.K, self.R, self.position_m))

    def depth(self, points_m: ArrayLike) -> Array:
        """Depth (...,) along the optical axis of field points (..., 2 or 3), in metres."""
        return (self._add_height(points_m) - self.position_m) @ self.R[2]

    def project(self, points_m: ArrayLike, distort: bool = True) -> Array:
        """Pixels (..., 2) of field points (..., 2 or 3); nan behind the camera and where the lens folds back."""
        local = (self._add_height(points_m) - self.position_m) @ self.R.T
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            normalised = np.where(local[..., 2:] > NEAREST_M, local[..., :2] / local[..., 2:], np.nan)
        pixels = normalised * self.focal_px + self.principal_point_px
        return self.distort(pixels) if distort else pixels

    def distort(self, undistorted_px: ArrayLike) -> Array:
        """Distorted pixels (..., 2) of undistorted ones; nan where the lens model folds back."""
        offset, r2 = self._radial(undistorted_px)
        factor, _ = lens_factor(r2, *self.kappa)
        factor = np.where(r2 < self._fold, factor, np.nan)
        return offset * factor[..., None] + self.principal_point_px

    def undistort(self, distorted_px: ArrayLike) -> Array:
        """Undistorted pixels (..., 2); nan further out than the lens model puts any point.

        Newton's iteration on the radius r of ``r (1 + k1 r^2 + k2 r^4) = target``; where a step leaves the interval
        that holds the solution, or is not half as long as the last one, the interval is halved instead (Press et al.,
        Numerical Recipes, 9.4).
        """
        offset, r2 = self._radial(distorted_px)
        target, fold = np.sqrt(r2), np.sqrt(self._fold)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            reached = target < (fold * lens_factor(fold**2, *self.kappa)[0] if np.isfinite(fold) else np.inf)
            target = np.where(reached, target, 0.0)
            low, high = np.zeros_like(target), np.minimum(fold, target / _LEAST_FACTOR)
            r, last = np.minimum(target, high), high
            for _ in range(_LENS_ROUNDS):
                factor, by_r2 = lens_factor(r * r, *self.kappa)
                value = r * factor - target
                low, high = np.where(value < 0.0, r, low), np.where(value > 0.0, r, high)
                step = value / (factor + 2.0 * r * r * by_r2)
                slow = (np.abs(step) > 0.5 * np.abs(last)) | (r - step < low) | (r - step > high)
                last = np.where(slow, r - 0.5 * (low + high), step)
                r = r - last
                if not (np.abs(last) > _LENS_TOLERANCE * r).any():  # the next one would be its square
                    break
            factor = np.where(target > 0.0, r / target, 1.0)
        return offset * np.where(reached, factor, np.nan)[..., None] + self.principal_point_px

    def rays(self, pixels: ArrayLike) -> Array:
        """Directions (..., 3) on the field, of unit depth, in which distorted pixels (..., 2) are seen."""
        seen = (self.undistort(pixels) - self.principal_point_px) / self.focal_px
        return np.asarray(np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1) @ self.R)

    def back_project(self, pixels: ArrayLike, surface: Surface = FLAT) -> Array:
        """Field points (..., 2) that are seen at distorted pixels (..., 2); nan where none is.

        None is where the ray does not meet the surface: on and above the horizon, or over a crown's edge.
        """
        return surface.meet(self.position_m, self.rays(pixels))

    def turn_field(self) -> Camera:
        """The camera that shows this picture of a field turned by 180 degrees about the z axis."""
        pan = (self.angles_rad[0] + 2 * np.pi) % (2 * np.pi) - np.pi
        return replace(
            self,
            angles_rad=np.array([pan, self.angles_rad[1], self.angles_rad[2]]),
            position_m=self.position_m * np.array([-1.0, -1.0, 1.0]),
        )

    def soccernet(self) -> dict[str, Any]:
        """SoccerNet camera keys at the frame's own size."""
        pan, tilt, roll = np.degrees(self.angles_rad)
        return {
            "pan_degrees": float(pan),
            "tilt_degrees": float(tilt),
            "roll_degrees": float(roll),
            "position_meters": [float(v) for v in self.position_m],
            "x_focal_length": float(self.focal_px[0]),
            "y_focal_length": float(self.focal_px[1]),
            "principal_point": [float(v) for v in self.principal_point_px],
            "radial_distortion": [float(self.dist[0]), float(self.dist[1]), 0.0, 0.0, 0.0, 0.0],
            "tangential_distortion": [0.0, 0.0],
            "thin_prism_distortion": [0.0, 0.0, 0.0, 0.0],
        }

    @property
    def _fold(self) -> float:
        return _fold_of(*self.kappa.tolist())

    def _radial(self, pixels: ArrayLike) -> tuple[Array, Array]:
        # the radius is measured on the focal plane in units of half the width, so non-square pixels stay round
        offset = np.asarray(pixels, dtype=np.float64) - self.principal_point_px
        aspect = self.focal_px[0] / self.focal_px[1]
        with np.errstate(over="ignore"):  # a pixel that far out is beyond the fold, or above the horizon
            return offset, (offset[..., 0] ** 2 + (offset[..., 1] * aspect) ** 2) / (self.width / 2.0) ** 2

    @staticmethod
    def _add_height(points_m: ArrayLike) -> Array:
        points = np.asarray(points_m, dtype=np.float64)
        if points.shape[-1] == 3:
            return points
        return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneCamera:
    """A homography taken as a camera: it knows the flat field only, in a picture without distortion.

    Attributes
    ----------
    width, height : int
        Image size in pixels.
    homography : (3, 3) array
        ``H_image_field`` at any scale; its sign is that of an unmirrored view from above, det H > 0 in front.
    """

    width: int
    height: int
    homography: Array

    def project(self, points_m: ArrayLike) -> Array:
        """Pixels (..., 2) of field points (..., 2), or (..., 3) on the plane z = 0; nan behind the camera."""
        return self._map(self._front_positive, np.asarray(points_m, dtype=np.float64)[..., :2])

    def back_project(self, pixels: ArrayLike, surface: Surface = FLAT) -> Array:
        """Field points (..., 2) that are seen at pixels (..., 2); nan on and above the horizon.

        Raises
        ------
        ValueError
            Where the surface is not flat.
        """
        if not surface.is_flat:
            raise ValueError("a homography knows no crowned surface")
        H = self._front_positive
        # H^-1 is positive in front of the camera as well: the depth of its point is 1 over that of the pixel
        return self._map(np.asarray(np.linalg.inv(H)), np.asarray(pixels, dtype=np.float64))

    @property
    def _front_positive(self) -> Array:
        sign = np.sign(np.linalg.det(self.homography)) if np.isfinite(self.homography).all() else 1.0
        return np.asarray(self.homography * (sign or 1.0))

    @staticmethod
    def _map(H: Array, points: Array) -> Array:
        mapped = lift(points) @ H.T
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray(np.where(mapped[..., 2:] > 0.0, mapped[..., :2] / mapped[..., 2:], np.nan))


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
    section 8.6; weighted least squares of both constraints). None where no positive focal length fits. The view is
    taken to be an unmirrored one from above, det H > 0 in front, whatever part of the field it shows: of a mirrored one
    the camera has behind it what is seen.
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
    if np.linalg.det(columns) < 0:
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
