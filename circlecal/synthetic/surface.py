"""The playing surface: flat, or falling from the long axis to the touchlines (a crown), as real pitches do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape

_NEWTON_ROUNDS = 6


@dataclass(frozen=True, slots=True)
class CrownedSurface:
    """A playing surface with its crown; z points down, so a positive crown drops towards the touchlines.

    Attributes
    ----------
    crown_m : float
        Drop at ``|y| = reference_m``, metres.
    shape : {"parabola", "roof", "flat"}
        Profile, as of :class:`circlecal.geometry.surface.Surface`.
    reference_m : float
        Where the drop is quoted: the radius of the centre circle.
    """

    crown_m: float = 0.0
    shape: SurfaceShape = "parabola"
    reference_m: float = 9.15

    @property
    def profile(self) -> Surface:
        """The surface with a crown of one metre."""
        return Surface(self.shape, self.reference_m)

    def drop(self, y_m: ArrayLike) -> Array:
        """Drop (...,) below the centre mark at y, metres."""
        return self.crown_m * self.profile.drop(np.asarray(y_m, dtype=np.float64))

    def slope(self, y_m: ArrayLike) -> Array:
        """Derivative (...,) of :meth:`drop` by y."""
        return self.crown_m * self.profile.slope(np.asarray(y_m, dtype=np.float64))

    def lift(self, points_m: ArrayLike) -> Array:
        """Points (..., 3) of the surface above or below field points (..., 2)."""
        points = np.asarray(points_m, dtype=np.float64)
        return np.concatenate([points, self.drop(points[..., 1])[..., None]], axis=-1)

    def meet(self, origin_m: ArrayLike, directions: ArrayLike) -> Array:
        """Field points (..., 2) where rays from ``origin_m`` (3,) along ``directions`` (..., 3) meet the surface.

        Newton's iteration on the position along the ray from the plane z = 0; nan where the ray does not descend.
        """
        origin = np.asarray(origin_m, dtype=np.float64)
        d = np.asarray(directions, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.where(d[..., 2] > 1e-9, -origin[2] / d[..., 2], np.nan)
            for _ in range(_NEWTON_ROUNDS if self.crown_m else 0):
                y = origin[1] + along * d[..., 1]
                above = origin[2] + along * d[..., 2] - self.drop(y)
                along = along - above / (d[..., 2] - self.slope(y) * d[..., 1])
        return origin[:2] + along[..., None] * d[..., :2]


FLAT = CrownedSurface()


def seen_pixels(camera: Camera, points_m: ArrayLike) -> Array:
    """Pixels (..., 2) of field points (..., 2 or 3); nan behind the camera and where a barrel lens would fold back."""
    pixels = camera.project(points_m, distort=False)
    if camera.kappa[0] < 0:
        aspect = np.array([1.0, camera.focal_px[0] / camera.focal_px[1]])
        r2 = np.sum(((pixels - camera.principal_point_px) * aspect) ** 2, axis=-1) / (camera.width / 2.0) ** 2
        with np.errstate(invalid="ignore"):
            pixels = np.where((1.0 + 3.0 * camera.kappa[0] * r2 > 0.0)[..., None], pixels, np.nan)
    return camera.distort(pixels)


def ray_directions(camera: Camera, pixels: ArrayLike) -> Array:
    """Field-frame directions (..., 3) of the rays through distorted pixels (..., 2), with unit depth."""
    undistorted = camera.undistort(pixels)
    ray = (undistorted - camera.principal_point_px) / camera.focal_px
    lifted = np.concatenate([ray, np.ones((*ray.shape[:-1], 1))], axis=-1)
    return np.asarray(lifted @ camera.rotation)


def back_project(camera: Camera, surface: CrownedSurface, pixels: ArrayLike) -> Array:
    """Field points (..., 2) of the surface seen at distorted pixels (..., 2); nan above the horizon."""
    return surface.meet(camera.position_m, ray_directions(camera, pixels))
