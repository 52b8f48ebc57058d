"""Whether a straight run is painted on one surface, or is the border between two (the foot of a board, a track)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.homogeneous import Array

__all__ = ["painted_on_one_surface"]

_SAMPLES = 48  # along each segment
_NEAR_PX1280, _FAR_PX1280 = 3.5, 5.5  # where the surface beside a marking is looked at
_ALIKE = 0.06  # largest difference of a colour's share of the sum of the three


def painted_on_one_surface(image_bgr: NDArray[np.uint8], segments: Array) -> NDArray[np.bool_]:
    """Whether the colour beside each segment, whatever its brightness, is the same on both sides.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8
    segments : (K, 2, 2) array
        Ends, px.

    Returns
    -------
    (K,) bool
    """
    if len(segments) == 0:
        return np.zeros(0, np.bool_)
    height, width = image_bgr.shape[:2]
    span = segments[:, 1] - segments[:, 0]
    normal = np.stack([span[:, 1], -span[:, 0]], axis=-1)
    normal /= np.maximum(np.hypot(normal[:, :1], normal[:, 1:]), 1e-9)
    along = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    points = segments[:, None, 0] + along[:, None] * span[:, None]
    steps = np.array([[-1.0], [1.0]]) * np.linspace(_NEAR_PX1280, _FAR_PX1280, 3) * max(1.0, width / 1280.0)
    places = points[:, :, None, None] + steps[..., None] * normal[:, None, None, None]
    x, y = np.clip(np.rint(places), 0, (width - 1, height - 1)).astype(np.int64).reshape(-1, 2).T
    beside = image_bgr.reshape(-1, 3).take(y * width + x, axis=0).reshape(*places.shape[:-1], 3)
    colour = beside.sum(axis=-2, dtype=np.float64) / 3 + 1.0  # of each sample and side
    share = np.median(colour / colour.sum(axis=-1, keepdims=True), axis=1)
    return np.asarray(np.abs(share[:, 0] - share[:, 1]).max(axis=-1) <= _ALIKE, np.bool_)
