"""The playing surface: flat, or falling from the long axis to both touchlines, as real pitches do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.projective import Array

SurfaceShape = Literal["parabola", "roof", "flat"]
_ROUNDS = 30
"""Steps of Newton's iteration for where a ray meets the surface; three or four are usual."""
_STEP = 1e-12
"""Step of it, as a share of the way to the camera, that ends it."""
_TOLERANCE_M = 1e-9
"""A ray that still is so far from the surface then does not meet it."""


@dataclass(frozen=True, slots=True)
class Surface:
    """Playing surface; z points down, so that a positive crown drops towards the touchlines.

    Attributes
    ----------
    shape : {"parabola", "roof", "flat"}
        ``z = crown (y / reference)^2``, ``z = crown |y| / reference`` or 0.
    reference_m : float
        The ``|y|`` at which the crown is quoted, metres: the radius of the circle.
    crown_m : float
        Drop there, metres. One metre unless given, for those who estimate the crown and multiply by it.
    """

    shape: SurfaceShape = "parabola"
    reference_m: float = 9.15
    crown_m: float = 1.0

    def drop(self, y_m: ArrayLike) -> Array:
        """Depth z (...) of the surface below the long axis, metres, at field coordinate y (...)."""
        t = np.asarray(y_m, dtype=np.float64) / self.reference_m
        if self.shape == "parabola":
            return self.crown_m * (t * t)
        return self.crown_m * np.abs(t) if self.shape == "roof" else np.zeros_like(t)

    def slope(self, y_m: ArrayLike) -> Array:
        """Derivative dz / dy (...) of :meth:`drop`."""
        t = np.asarray(y_m, dtype=np.float64) / self.reference_m
        if self.shape == "parabola":
            return self.crown_m * (2 * t / self.reference_m)
        return self.crown_m * (np.sign(t) / self.reference_m) if self.shape == "roof" else np.zeros_like(t)

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0."""
        return self.shape == "flat" or self.crown_m == 0.0

    def lift(self, points_m: ArrayLike) -> Array:
        """Points (..., 3) of the surface above or below field points (..., 2)."""
        points = np.asarray(points_m, dtype=np.float64)
        return np.concatenate([points, self.drop(points[..., 1])[..., None]], axis=-1)

    def meet(self, origin_m: ArrayLike, directions: ArrayLike) -> Array:
        """Field points (..., 2) where rays from ``origin_m`` (3,) along ``directions`` (..., 3) meet the surface.

        nan where a ray does not: it leads away from the plane z = 0, or passes over the surface.

        Newton's iteration on the share of the way back from the point where the ray meets the plane z = 0 to its
        origin; at share s it is ``flat + s (origin - flat)``, at depth ``s z_origin``.
        """
        origin, d = np.asarray(origin_m, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        height = origin[2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            reach = np.where(d[..., 2] * -height > 0.0, -height / d[..., 2], np.nan)
            flat = origin[:2] + reach[..., None] * d[..., :2]
            if self.is_flat:
                return flat
            toward = origin[:2] - flat
            share = np.zeros_like(reach)
            for _ in range(_ROUNDS):
                y = flat[..., 1] + share * toward[..., 1]
                step = (share * height - self.drop(y)) / (height - self.slope(y) * toward[..., 1])
                share = share - step
                if not (np.abs(step) > _STEP).any():
                    break
            field = flat + share[..., None] * toward
            missed = ~(np.abs(share * height - self.drop(field[..., 1])) < _TOLERANCE_M) | (share >= 1.0)
        return np.where(missed[..., None], np.nan, field)


FLAT = Surface("flat", crown_m=0.0)
