"""How rough a picture is around places: bare ground is smooth, crowds, players, boards and letters are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array

__all__ = ["measure_roughness"]

ROUGH_SIDE_PX, ROUGH_POINTS = 16.0, 3
"""Side of the neighbourhood whose roughness is measured, pixels at 1920 px width, and points to each side of its
middle.
"""


def measure_roughness(picture: NDArray[np.uint8], places: Array) -> Array:
    """Standard deviation (N,) of the gray levels around places (N, 2), at points that blur does not make alike."""
    height, width = picture.shape
    side = np.arange(-ROUGH_POINTS, ROUGH_POINTS + 1) * (ROUGH_SIDE_PX * width / 1920.0 / (2 * ROUGH_POINTS))
    # of the square around a place each row and each column is looked up once
    columns, rows = (
        np.minimum(np.maximum(np.rint(places[:, k, None] + side), 0.0), size - 1.0).astype(np.int64)
        for k, size in enumerate((width, height))
    )
    at = rows[:, :, None] * width + columns[:, None]
    return np.asarray(picture.ravel().take(at.reshape(len(places), len(side) ** 2)).std(axis=1), np.float64)
