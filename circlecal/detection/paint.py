"""How much of a circle hypothesis is painted, however faintly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.hypotheses import EllipseBatch
from circlecal.paint.matched_filter import CLEAR, LEAST_WIDTH_PX, SAMPLES, SECTORS, sectors_standing_out

__all__ = ["painted_share"]

_WIDTH_RADII = 0.013  # usual width of the paint in radii of its circle


def painted_share(grey: NDArray[np.uint8], ellipse: EllipseBatch, sign: float) -> tuple[float, int]:
    """Share of the sectors of the first ellipse of a batch that are painted, and how many the picture shows.

    Parameters
    ----------
    grey : (H, W) uint8
        Full picture.
    ellipse : EllipseBatch
    sign : float
        +1 for light paint, -1 for dark paint.
    """
    angle = (np.arange(SECTORS * SAMPLES) + 0.5) * (2 * np.pi / (SECTORS * SAMPLES))
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    great, small = ellipse.great[0], ellipse.small[0]
    offset = cosine * great + sine * small
    along = cosine * small - sine * great
    normals = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    reach = np.abs((offset * normals).sum(axis=-1))
    width = np.maximum(_WIDTH_RADII * reach, LEAST_WIDTH_PX * grey.shape[1] / 1920.0)
    picture = grey if sign > 0 else ~grey
    sectors = sectors_standing_out(picture, ellipse.centers[0] + offset, width[:, None] * normals)
    return (float(np.mean(sectors > CLEAR)) if len(sectors) else 0.0), len(sectors)
