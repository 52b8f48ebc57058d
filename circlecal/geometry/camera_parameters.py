"""The camera's parameters, and projection with its analytic Jacobian, for a batch of cameras at once.

A field point (x, y) becomes a pixel u in five steps; the derivatives refer to them by number.

1. ``X = (x, y, c d(x, y))``: on the surface, whose crown c drops by ``d(x, y)`` per metre.
2. ``p = R o``, ``o = X - C``: before the camera at C with the rotation ``R = Rz(roll)^T Rx(tilt)^T Rz(pan)^T``.
3. ``n = (p1, p2) / p3``: on the plane at distance 1.
4. ``L = 1 + k1 r^2 + k2 r^4``, ``r^2 = s^2 |n|^2``, ``s = 2 f / W``: the lens, in half-widths of the picture.
5. ``u = F L n + u0``, ``F = diag(f, a f)``: pixels, with the aspect a.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from circlecal.geometry.camera import (
    NEAREST_M,
    Camera,
    image_center,
    lens_factor,
    lens_fold,
    plane_homography,
    rotations_by,
)
from circlecal.geometry.projective import Array, freeze
from circlecal.geometry.surface import Surface

PARAMETERS = (
    "log_focal", "pan", "tilt", "roll", "x", "y", "z",
    "pp_x", "pp_y", "kappa_1", "kappa_2", "log_aspect", "crown", "width", "bloom", "length", "breadth",
)  # fmt: skip
"""Order of the parameter vector.

Focal length as its logarithm; angles in radians; position in metres; principal point as an offset from the image
centre in pixels; kappa in half-widths; aspect as the logarithm of fy / fx; crown in metres; marking width as an offset
from the template's in metres; bloom in pixels (how far blur moves each edge outwards); length and breadth of the field
as offsets from the template's in metres.
"""
INDEX = {name: k for k, name in enumerate(PARAMETERS)}
LOG_FOCAL, PAN, TILT, ROLL, KAPPA_1, KAPPA_2 = (INDEX[k] for k in (*PARAMETERS[:4], "kappa_1", "kappa_2"))
ANGLES, POSITION, PRINCIPAL, KAPPA = slice(1, 4), slice(4, 7), slice(7, 9), slice(9, 11)
LOG_ASPECT, CROWN = INDEX["log_aspect"], INDEX["crown"]


@dataclass(frozen=True, slots=True)
class ProjectionModel:
    """What every candidate camera of a frame has in common: the picture's size and the profile of the surface.

    With a parameter vector it says where each point of the field is seen. The surface has a crown of one metre here,
    since the crown is one of the parameters.
    """

    width: int
    height: int
    surface: Surface = field(default_factory=Surface)

    @staticmethod
    def of(camera: Camera, surface: Surface) -> ProjectionModel:
        """The model that a camera and a surface with its crown come from."""
        return ProjectionModel(camera.width, camera.height, replace(surface, crown_m=1.0))

    @property
    def center(self) -> Array:
        """Image centre (2,), not to be written to."""
        return _center_of(self.width, self.height)


@lru_cache(maxsize=64)
def _center_of(width: int, height: int) -> Array:
    """Centre of pictures of a size, which each projection asks for."""
    return freeze(image_center(width, height))


def camera_of(theta: Array, model: ProjectionModel) -> Camera:
    """Camera of one parameter vector (P,)."""
    focal = np.exp(theta[LOG_FOCAL])
    return Camera(
        width=model.width,
        height=model.height,
        focal_px=np.array([focal, focal * np.exp(theta[LOG_ASPECT])]),
        principal_point_px=model.center + theta[PRINCIPAL],
        angles_rad=theta[ANGLES].copy(),
        position_m=theta[POSITION].copy(),
        kappa=theta[KAPPA].copy(),
    )


def theta_of(camera: Camera, model: ProjectionModel, crown_m: float = 0.0) -> Array:
    """Parameter vector (P,) of a camera over a surface with a crown; the sizes of the markings are the template's."""
    theta = np.zeros(len(PARAMETERS))
    theta[LOG_FOCAL] = np.log(camera.focal_px[0])
    theta[ANGLES] = camera.angles_rad
    theta[POSITION] = camera.position_m
    theta[PRINCIPAL] = camera.principal_point_px - model.center
    theta[KAPPA] = camera.kappa
    theta[LOG_ASPECT] = np.log(camera.focal_px[1] / camera.focal_px[0])
    theta[CROWN] = crown_m
    return theta


def rotations(theta: Array) -> Array:
    """World-to-camera rotations (B, 3, 3), not to be written to."""
    return _rotations_of(theta[:, ANGLES].tobytes())


@lru_cache(maxsize=16)
def _rotations_of(angles: bytes) -> Array:
    """Rotations by angles (B, 3), kept since half of them are asked for again: by a step after what led to it."""
    return freeze(rotations_by(np.frombuffer(angles).reshape(-1, 3)))


def homographies(theta: Array, model: ProjectionModel) -> Array:
    """``H_image_field`` (B, 3, 3) of the plane z = 0, to undistorted pixels; not scaled."""
    K = np.zeros((len(theta), 3, 3))
    K[:, 0, 0] = np.exp(theta[:, LOG_FOCAL])
    K[:, 1, 1] = K[:, 0, 0] * np.exp(theta[:, LOG_ASPECT])
    K[:, :2, 2] = model.center + theta[:, PRINCIPAL]
    K[:, 2, 2] = 1.0
    return plane_homography(K, rotations(theta), theta[:, POSITION])


@dataclass(frozen=True, slots=True)
class Projection:
    """Field points before a batch of cameras, and what their pixels and all derivatives are made of.

    Arrays run over (B cameras, coordinates, N points), so that every operation works on whole rows.

    Attributes
    ----------
    theta : (B, P) array
        Parameter vectors.
    model : ProjectionModel
        Picture size and surface.
    rotation : (B, 3, 3) array
        R, world to camera.
    offset, local : (B, 3, N) arrays
        o and p, from the camera to the points in world and in camera coordinates.
    drop, slope : (B, N) arrays
        d, drop of the surface per metre of crown, and ``c d_y``, its slope dz / dy.
    inverse_depth : (B, N) array
        ``1 / p3``, bounded away from infinity.
    normalised : (B, 2, N) array
        n, on the plane at distance 1, before the lens.
    r2, lens, lens_slope : (B, N) arrays
        r^2, L and ``L' = dL / dr^2``.
    focal : (B, 2, 1) array
        Diagonal of F, focal lengths in pixels.
    squared_focal : (B, 1) array
        s^2.
    slope_along : (B, N) array, optional
        ``c d_x``, the surface's slope dz / dx; None where it is the same all along the field.
    """

    theta: Array
    model: ProjectionModel
    rotation: Array
    offset: Array
    local: Array
    drop: Array
    slope: Array
    inverse_depth: Array
    normalised: Array
    r2: Array
    lens: Array
    lens_slope: Array
    focal: Array
    squared_focal: Array
    slope_along: Array | None

    @property
    def depth(self) -> Array:
        """Depths (B, N) along the optical axis."""
        return np.asarray(self.local[:, 2])

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Where (B, N) the point lies in front of the camera, and the lens model has not folded back yet."""
        fold = lens_fold(self.theta[:, KAPPA_1], self.theta[:, KAPPA_2])
        return np.asarray((self.depth > NEAREST_M) & (self.r2 < fold[:, None]), np.bool_)

    @property
    def xy(self) -> Array:
        """Pixels (B, 2, N) with the lens, as whole rows of columns x and of rows y."""
        principal = self.model.center + self.theta[:, PRINCIPAL]
        return self.focal * self.normalised * self.lens[:, None] + principal[..., None]

    @property
    def pixels(self) -> Array:
        """Pixels (B, N, 2) with the lens."""
        return np.swapaxes(self.xy, 1, 2)

    @property
    def upward(self) -> NDArray[np.bool_]:
        """Where (B, N) the derivative of the pixels by the field position has no negative determinant: circles run
        clockwise on the field and in the picture.
        """
        above = self.offset[:, 2] - self._fall(self.offset[:, 0], self.offset[:, 1])
        return np.asarray((above >= 0) == (self.inverse_depth >= 0), np.bool_)

    def _fall(self, x: Array, y: Array) -> Array:
        """How far the surface falls (B, N) over ways (x, y) on the field, each (B, N), as steeply as at the points."""
        across = self.slope * y
        return across if self.slope_along is None else across + self.slope_along * x

    def along(self, x: Array, y: Array) -> Array:
        """Derivative (B, 2, N) of the pixels in directions (x, y) on the field, each broadcast to (B, N)."""
        world = np.empty_like(self.offset)
        world[:, 0], world[:, 1] = x, y
        world[:, 2] = self._fall(world[:, 0], world[:, 1])  # 1: dX = (dx, dy, c d_x dx + c d_y dy)
        local = self.rotation @ world  # 2: dp = R dX
        # 3: dn = ((dp1, dp2) - n dp3) / p3
        change = (local[:, :2] - self.normalised * local[:, 2:]) * self.inverse_depth[:, None]
        outward = self.normalised[:, 0] * change[:, 0] + self.normalised[:, 1] * change[:, 1]
        bend = 2.0 * self.squared_focal * self.lens_slope * outward  # 4: dL = L' 2 s^2 n . dn
        return self.focal * (change * self.lens[:, None] + self.normalised * bend[:, None])  # 5: du = F (L dn + n dL)

    def gradient(self, toward: Array) -> tuple[Array, Array]:
        """Derivatives of ``v . u`` for image vectors v (B, 2, N): by the parameters (B, P, N), where sizes of the
        markings do not enter, and by the field position (B, 2, N).

        The chain rule from the pixel back to the field, each step of the projection transposed.
        """
        theta, n, lens, r2 = self.theta, self.normalised, self.lens, self.r2
        local, offset = self.local, self.offset
        rows = np.empty((len(theta), len(PARAMETERS), local.shape[2]))
        rows[:, CROWN + 1 :] = 0.0  # sizes and bloom come last
        # 5: u = F L n + u0, so d(v.u) = L w.dn + w.n dL + v.du0 with w = F v
        scaled = toward * self.focal
        outward = scaled * n
        total = outward[:, 0] + outward[:, 1]  # w.n
        rows[:, PRINCIPAL] = toward
        np.multiply(outward[:, 1], lens, out=rows[:, LOG_ASPECT])  # d(a f) = a f dlog(a): w2 n2 L
        # 4: dL = r^2 dk1 + r^4 dk2 + L' dr^2, and r^2 = s^2 |n|^2 with s ~ f, so dr^2 = 2 s^2 n.dn + 2 r^2 dlog(f)
        np.multiply(total, r2, out=rows[:, KAPPA_1])
        np.multiply(rows[:, KAPPA_1], r2, out=rows[:, KAPPA_2])
        rows[:, LOG_FOCAL] = total * (lens + 2.0 * self.lens_slope * r2)
        bend = 2.0 * self.squared_focal * self.lens_slope * total
        by_normalised = scaled * lens[:, None] + bend[:, None] * n  # L w + 2 s^2 L' (w.n) n
        # 3: dn = ((dp1, dp2) - n dp3) / p3
        g = np.empty_like(local)
        np.multiply(by_normalised, self.inverse_depth[:, None], out=g[:, :2])
        g[:, 2] = -(g[:, 0] * n[:, 0] + g[:, 1] * n[:, 1])
        # 2: dp = R (dX - dC) and dR; a rotation R^T about an axis e changes p by -e x p, with e before the camera
        world = self.rotation.swapaxes(1, 2) @ g
        np.negative(world, out=rows[:, POSITION])
        # pan: e = R (0, 0, 1), so -g.(e x p) = -(R^T g).((0, 0, 1) x o)
        rows[:, PAN] = world[:, 0] * offset[:, 1] - world[:, 1] * offset[:, 0]
        # tilt: e = Rz(roll)^T (1, 0, 0) = (cos, -sin, 0)
        c, s = np.cos(theta[:, ROLL, None]), np.sin(theta[:, ROLL, None])
        rows[:, TILT] = local[:, 2] * (s * g[:, 0] + c * g[:, 1]) - g[:, 2] * (s * local[:, 0] + c * local[:, 1])
        # roll: e = (0, 0, 1)
        rows[:, ROLL] = g[:, 0] * local[:, 1] - g[:, 1] * local[:, 0]
        # 1: dX = (dx, dy, c d_x dx + c d_y dy + d dc)
        np.multiply(self.drop, world[:, 2], out=rows[:, CROWN])
        field = world[:, :2]
        field[:, 1] += self.slope * world[:, 2]
        if self.slope_along is not None:
            field[:, 0] += self.slope_along * world[:, 2]
        return rows, field

    def sigma(self, covariance: Array, point_sigma_px: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Standard deviations of the places of the first camera's points: (N,) pixels, and (N,) metres on the ground.

        Of the length of the error, that is, the root of the sum of both variances. The variance in the picture is
        ``trace(J S J^T)`` with the covariance S (P, P) of the parameters; on the ground it is that of the field point
        that is seen at a given pixel, ``trace(F^-1 (J S J^T + s^2 I) F^-T)`` with the derivative F by the field
        position, where the pixel itself is known to a standard deviation s along x and along y, a number or (N,).
        """
        (xx, xy, yy), ((a, b), (c, d)) = self._push(covariance)
        given_xx, given_yy = (variance + np.square(point_sigma_px) for variance in (xx, yy))
        with np.errstate(divide="ignore", invalid="ignore"):
            # F^-1 = [[d, -b], [-c, a]] / det F
            ground = (d * d + c * c) * given_xx - 2.0 * (b * d + a * c) * xy + (a * a + b * b) * given_yy
            ground /= (a * d - b * c) ** 2
        return np.sqrt(xx + yy), np.sqrt(np.maximum(ground, 0.0))

    def covariances(self, covariance: Array, point_sigma_px: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Covariances of the places of the first camera's points: (N, 2, 2) in pixels, and (N, 2, 2) in metres of the
        field point that is seen at a given pixel: ``J S J^T`` and ``F^-1 (J S J^T + s^2 I) F^-T``, as of :meth:`sigma`.
        """
        (xx, xy, yy), ((a, b), (c, d)) = self._push(covariance)
        determinant = a * d - b * c
        determinant[determinant == 0.0] = np.nan
        back = np.array([[d, -b], [-c, a]] / determinant).transpose(2, 0, 1)
        image = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
        given = image + np.square(np.asarray(point_sigma_px, dtype=np.float64))[..., None, None] * np.eye(2)
        return image, back @ given @ np.swapaxes(back, -1, -2)

    def _push(self, covariance: Array) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
        """Of the first camera's points, the entries xx, xy and yy (N,) of J S J^T, and the rows (2, N) of F."""
        (by_x, field_x), (by_y, field_y) = (self.gradient(axis) for axis in self._axes())
        # the sizes of the markings, which come last, move no point
        own = slice(0, INDEX["width"])
        by_x, by_y = by_x[0, own], by_y[0, own]
        pushed_x, pushed_y = covariance[own, own] @ by_x, covariance[own, own] @ by_y
        entries = (pushed_x * by_x).sum(axis=0), (pushed_x * by_y).sum(axis=0), (pushed_y * by_y).sum(axis=0)
        return entries, (field_x[0], field_y[0])

    def _axes(self) -> Array:
        """Unit vectors (2, B, 2, N) of the picture at every point."""
        axes = np.zeros((2, *self.normalised.shape))
        axes[0, :, 0] = axes[1, :, 1] = 1.0
        return axes

    def jacobians(self) -> tuple[Array, Array]:
        """Derivatives of the pixels by the parameters (B, N, 2, P) and by the field position (B, N, 2, 2)."""
        rows, fields = zip(*(self.gradient(axis) for axis in self._axes()), strict=True)
        return np.stack(rows, axis=1).transpose(0, 3, 1, 2), np.stack(fields, axis=1).transpose(0, 3, 1, 2)


LEAST_DEPTH_M = 1e-6
"""A point nearer to the camera's own plane counts as so far before it, metres: it keeps all numbers finite, no more."""
LEAST_DESCENT = 1e-2
"""Of a ray of unit depth, in metres: what is seen at the horizon lies a hundred times as far away as the camera is
high.
"""
_SECOND = np.array([[0.0], [1.0]])


def project(theta: Array, field_m: Array, model: ProjectionModel) -> Projection:
    """Project field points, on the crowned surface, with the lens, for a batch of cameras.

    Parameters
    ----------
    theta : (B, P) array
        Parameter vectors.
    field_m : (B, N, 2) or (1, N, 2) array
        Points on the field, metres; of a single row every camera is shown the same points.
    model : ProjectionModel
        Picture size and surface.
    """
    x, y = field_m[..., 0], field_m[..., 1]
    crown = theta[:, CROWN, None]
    drop, (along, slope) = model.surface.drop(x, y), model.surface.slope(x, y)
    offset = np.empty((len(theta), 3, x.shape[1]))
    offset[:, 0], offset[:, 1], offset[:, 2] = x, y, crown * drop  # 1
    offset -= theta[:, POSITION, None]
    R = rotations(theta)
    local = R @ offset  # 2
    depth = local[:, 2]
    inverse_depth = 1.0 / np.where(np.abs(depth) < LEAST_DEPTH_M, LEAST_DEPTH_M, depth)
    normalised = local[:, :2] * inverse_depth[:, None]  # 3
    focal = np.exp(theta[:, LOG_FOCAL, None, None] + theta[:, LOG_ASPECT, None, None] * _SECOND)
    squared_focal = (2.0 / model.width * focal[:, 0]) ** 2
    r2 = (normalised[:, 0] ** 2 + normalised[:, 1] ** 2) * squared_focal
    lens, lens_slope = lens_factor(r2, theta[:, KAPPA_1, None], theta[:, KAPPA_2, None])  # 4
    return Projection(
        theta, model, R, offset, local, drop, crown * slope, inverse_depth, normalised, r2, lens, lens_slope, focal,
        squared_focal, None if along is None else crown * along,
    )  # fmt: skip


def level_points(theta: Array, pixels: Array, model: ProjectionModel) -> Array:
    """About where pixels (N, 2), or (B, N, 2), lie on level ground, (B, N, 2) for the cameras of ``theta`` (B, P).

    Always a point: a ray at or above the horizon is taken to descend by one in a hundred. The lens is taken back by its
    first coefficient in one step, which is near enough to start from; :meth:`Camera.back_project` is exact.
    """
    focal = np.exp(theta[:, LOG_FOCAL, None])
    offset = np.swapaxes(pixels, -1, -2) - (model.center + theta[:, PRINCIPAL])[..., None]
    offset[:, 1] *= np.exp(-theta[:, LOG_ASPECT, None])
    r2 = (offset[:, 0] ** 2 + offset[:, 1] ** 2) * (2.0 / model.width) ** 2
    rays = np.empty((len(theta), 3, offset.shape[-1]))
    rays[:, :2] = offset / (focal * lens_factor(r2, theta[:, KAPPA_1, None], 0.0)[0])[:, None]
    rays[:, 2] = 1.0
    world = np.swapaxes(rotations(theta), 1, 2) @ rays
    reach = -theta[:, POSITION.start + 2, None] / np.maximum(world[:, 2], LEAST_DESCENT)
    return np.swapaxes(theta[:, POSITION.start : POSITION.start + 2, None] + reach[:, None] * world[:, :2], 1, 2)


def parameters_between(theta: Array, other: Array) -> Array:
    """From parameter vectors (..., P) to others, with angles the shorter way round: cameras that look to both sides of
    -x have pans of nearly pi and nearly -pi.
    """
    between = other - theta
    between[..., ANGLES] = (between[..., ANGLES] + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(between)


def active_parameters(sd: Array) -> NDArray[np.int_]:
    """Indices of the parameters that are estimated: those whose prior standard deviation is not zero."""
    return np.flatnonzero(sd > 0)
