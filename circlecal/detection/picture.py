"""The picture of the search, reduced or enlarged, and the way back to the full one."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.hypotheses import EllipseBatch
from circlecal.detection.lines import StraightRun
from circlecal.detection.options import DetectorConfig
from circlecal.geometry.projective import Array

__all__ = ["Frame", "Scaling", "Stopwatch", "detection_picture"]


@dataclass(slots=True)
class Stopwatch:
    """Milliseconds that each step took, summed over the passes."""

    timings_ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, name: str) -> None:
        """Count the time since the last call for this step."""
        now = time.perf_counter()
        self.timings_ms[name] = self.timings_ms.get(name, 0.0) + (now - self._last) * 1e3
        self._last = now


@dataclass(frozen=True, slots=True)
class Frame:
    """The full picture (H, W, 3) and its brightness (H, W)."""

    image_bgr: NDArray[np.uint8]
    grey: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Scaling:
    """Detection picture <-> full picture, with pixel centres at whole numbers in both."""

    factor: Array  # full pixels per detection pixel, (2,)

    def full(self, points: Array) -> Array:
        """Points (..., 2) of the detection picture in the full one."""
        return (points + 0.5) * self.factor - 0.5

    def full_segments(self, runs: list[StraightRun]) -> Array:
        """Ends (K, 2, 2) of the runs in pixels of the full picture."""
        return self.full(np.array([[run.start, run.end] for run in runs]).reshape(-1, 2, 2))

    def full_ellipses(self, batch: EllipseBatch) -> EllipseBatch:
        """Ellipses of the detection picture in the full one."""
        return EllipseBatch(self.full(batch.centers), batch.great * self.factor, batch.small * self.factor)

    def detection_ellipses(self, batch: EllipseBatch) -> EllipseBatch:
        """Ellipses of the full picture in the detection picture."""
        centers = (batch.centers + 0.5) / self.factor - 0.5
        return EllipseBatch(centers, batch.great / self.factor, batch.small / self.factor)


def detection_picture(grey: NDArray[np.uint8], config: DetectorConfig) -> tuple[NDArray[np.uint8], Scaling]:
    """Grey picture reduced (or enlarged) to the width of the search, and the way back."""
    height, width = grey.shape
    wanted = max(min(width, config.detection_width_px), config.enlarged_width_px)
    if width == wanted:
        return grey, Scaling(np.ones(2))
    size = (wanted, max(1, round(height * wanted / width)))
    # area averaging is slow for factors other than two; below two, linear interpolation loses nothing
    while grey.shape[1] >= 2 * wanted:
        half = (grey.shape[1] // 2, max(1, grey.shape[0] // 2))
        grey = np.asarray(cv2.resize(grey, half, interpolation=cv2.INTER_AREA), np.uint8)
    reduced = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR), np.uint8)
    return reduced, Scaling(np.array([width / size[0], height / size[1]]))
