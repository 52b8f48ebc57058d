"""The picture of the search, reduced or enlarged, and the way back to the full one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.ellipse_batch import EllipseBatch
from circlecal.detection.lines import StraightRun
from circlecal.geometry.projective import Array, Mask

__all__ = ["Picture", "Scaling", "reduce_picture"]


@dataclass(frozen=True, slots=True)
class Picture:
    """The full picture: its colours (H, W, 3) in the order blue, green, red, its gray levels (H, W), and where graphics
    cover it (H, W), if they do anywhere.
    """

    image_bgr: NDArray[np.uint8]
    gray: NDArray[np.uint8]
    covered: Mask | None = None


@dataclass(frozen=True, slots=True)
class Scaling:
    """Detection picture <-> full picture, with pixel centres at whole numbers in both."""

    factor: Array  # full pixels per detection pixel, (2,)

    def full(self, points: Array) -> Array:
        """Points (..., 2) of the detection picture in the full one."""
        return (points + 0.5) * self.factor - 0.5

    def reduce(self, points: Array) -> Array:
        """Points (..., 2) of the full picture in the detection picture."""
        return np.asarray((points + 0.5) / self.factor - 0.5)

    def reduce_conic(self, conic: Array) -> Array:
        """A conic (3, 3) of the full picture in the detection picture."""
        x, y = self.factor
        into_full = np.array([[x, 0.0, 0.5 * x - 0.5], [0.0, y, 0.5 * y - 0.5], [0.0, 0.0, 1.0]])
        return into_full.T @ conic @ into_full

    def full_segments(self, runs: list[StraightRun]) -> Array:
        """Ends (K, 2, 2) of the runs in pixels of the full picture."""
        return self.full(np.array([[run.start, run.end] for run in runs]).reshape(-1, 2, 2))

    def full_ellipses(self, batch: EllipseBatch) -> EllipseBatch:
        """Ellipses of the detection picture in the full one."""
        return EllipseBatch(self.full(batch.centers), batch.great * self.factor, batch.small * self.factor)

    def detection_ellipses(self, batch: EllipseBatch) -> EllipseBatch:
        """Ellipses of the full picture in the detection picture."""
        return EllipseBatch(self.reduce(batch.centers), batch.great / self.factor, batch.small / self.factor)


def reduce_picture(gray: NDArray[np.uint8], largest: int, smallest: int) -> tuple[NDArray[np.uint8], Scaling]:
    """Gray picture (H, W), reduced to the largest or enlarged to the smallest width (px) of the search, and the way
    back.
    """
    height, width = gray.shape
    wanted = max(min(width, largest), smallest)
    if width == wanted:
        return gray, Scaling(np.ones(2))
    size = (wanted, max(1, round(height * wanted / width)))
    # area averaging is slow for factors other than two; below two, linear interpolation loses nothing
    while gray.shape[1] >= 2 * wanted:
        half = (gray.shape[1] // 2, max(1, gray.shape[0] // 2))
        gray = np.asarray(cv2.resize(gray, half, interpolation=cv2.INTER_AREA), np.uint8)
    reduced = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_LINEAR), np.uint8)
    return reduced, Scaling(np.array([width / size[0], height / size[1]]))
