"""The playing surface: flat, or falling from the long axis to its borders, as real pitches do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.projective import Array

SurfaceShape = Literal["parabola", "roof", "hip", "flat"]
_RIDGE = 2.0
"""Half the length of a hipped roof's ridge, in reference lengths: 18.3 m on a soccer field, whose corners lie 18.5 m
further along it than across it, so that all four sides fall alike. Before a real pitch that is hipped a fit costs twice
as much with no ridge and ends that fall less steeply than the sides, and 2.4 times as much with half a ridge of 26 m.
"""
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
    shape : {"parabola", "roof", "hip", "flat"}
        ``z = crown (y / reference)^2``, ``z = crown |y| / reference``, a roof whose ends fall as its sides do,
        ``z = crown max(|y|, |x| - ridge) / reference`` with the ridge of 2 reference lengths to both sides, or 0.
    reference_m : float
        The ``|y|`` at which the crown is quoted, metres: the radius of the circle.
    crown_m : float
        Drop there, metres. One metre unless given, for those who estimate the crown and multiply by it.
    """

    shape: SurfaceShape = "parabola"
    reference_m: float = 9.15
    crown_m: float = 1.0

    def drop(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Depth z (...) of the surface below the middle of the field, metres, at field coordinates x and y (...)."""
        t = np.asarray(y_m, dtype=np.float64) / self.reference_m
        if self.shape == "parabola":
            return self.crown_m * (t * t)
        if self.shape == "hip":
            return self.crown_m * np.maximum(np.abs(t), self._beyond_ridge(x_m))
        return self.crown_m * np.abs(t) if self.shape == "roof" else np.zeros_like(t)

    def slope(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[Array | None, Array]:
        """Derivatives dz / dx (None where the surface is the same all along the field) and dz / dy (...) of
        :meth:`drop`.
        """
        t = np.asarray(y_m, dtype=np.float64) / self.reference_m
        if self.shape == "parabola":
            return None, self.crown_m * (2 * t / self.reference_m)
        if self.shape == "flat":
            return None, np.zeros_like(t)
        steepness = self.crown_m / self.reference_m
        if self.shape == "roof":
            return None, steepness * np.sign(t)
        is_end = self._beyond_ridge(x_m) > np.abs(t)
        return steepness * np.where(is_end, np.sign(x_m), 0.0), steepness * np.where(is_end, 0.0, np.sign(t))

    def fall(self, x_m: ArrayLike, y_m: ArrayLike, along_m: Array | float, across_m: Array | float) -> Array:
        """How far the surface falls (...), metres, over ways along and across the field (...), as steeply as at the
        places x and y (...).
        """
        by_x, by_y = self.slope(x_m, y_m)
        across = by_y * across_m
        return np.asarray(across if by_x is None else across + by_x * along_m)

    def _beyond_ridge(self, x_m: ArrayLike) -> Array:
        """How far beyond the ridge's end places at x (...) lie, in reference lengths."""
        return np.abs(np.asarray(x_m, dtype=np.float64)) / self.reference_m - _RIDGE

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0."""
        return self.shape == "flat" or self.crown_m == 0.0

    def lift(self, points_m: ArrayLike) -> Array:
        """Points (..., 3) of the surface above or below field points (..., 2)."""
        points = np.asarray(points_m, dtype=np.float64)
        return np.concatenate([points, self.drop(points[..., 0], points[..., 1])[..., None]], axis=-1)

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
                x, y = np.moveaxis(flat + share[..., None] * toward, -1, 0)
                falling = self.fall(x, y, toward[..., 0], toward[..., 1])
                step = (share * height - self.drop(x, y)) / (height - falling)
                share = share - step
                if not (np.abs(step) > _STEP).any():
                    break
            field = flat + share[..., None] * toward
            missed = ~(np.abs(share * height - self.drop(field[..., 0], field[..., 1])) < _TOLERANCE_M) | (share >= 1.0)
        return np.where(missed[..., None], np.nan, field)


FLAT = Surface("flat", crown_m=0.0)
