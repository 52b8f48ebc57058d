"""The part of a picture that a camera took."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from circlecal.geometry.projective import Array


class Window(NamedTuple):
    """The part of a picture that a camera took, pixels: how many columns and rows lie before it, and its size."""

    left: float
    top: float
    width: float
    height: float

    def shift_of_middle(self, width: int, height: int) -> Array:
        """How far its middle lies from that of a picture of this size (2,), pixels."""
        middle = np.array([self.left + 0.5 * self.width, self.top + 0.5 * self.height])
        return np.asarray(middle - np.array([width, height]) / 2.0, np.float64)
