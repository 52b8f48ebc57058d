"""The playing surface: flat, or falling from the long axis to both touchlines, as real pitches do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from circlecal.geometry.projective import Array

SurfaceShape = Literal["parabola", "roof", "flat"]


@dataclass(frozen=True, slots=True)
class Surface:
    """Profile of the playing surface across its length, for a crown of one metre.

    The crown itself is a number beside it, ``crown_m``, since it is estimated and this is not: a surface with that
    crown lies ``crown_m * drop(y)`` below the plane z = 0, which it touches at the long axis.

    Attributes
    ----------
    shape : {"parabola", "roof", "flat"}
        ``drop = (y / reference)^2``, ``|y| / reference`` or 0.
    reference_m : float
        The ``|y|`` at which the crown is quoted, metres: the radius of the circle.
    """

    shape: SurfaceShape = "parabola"
    reference_m: float = 9.15

    def drop(self, y_m: Array) -> Array:
        """Drop of the surface per metre of crown, in the shape of ``y_m``."""
        t = y_m / self.reference_m
        if self.shape == "parabola":
            return t * t
        return np.abs(t) if self.shape == "roof" else np.zeros_like(t)

    def slope(self, y_m: Array) -> Array:
        """Derivative of :meth:`drop` by y, per metre."""
        if self.shape == "parabola":
            return 2 * (y_m / self.reference_m) / self.reference_m
        return np.sign(y_m) / self.reference_m if self.shape == "roof" else np.zeros_like(y_m)
