"""From the light to the stored picture: blur, vignette, edge enhancement, noise, 8 bits."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.synthetic.backdrop import Float32
from circlecal.synthetic.scene import RenderConfig

_SHARPENING_PX = 1.4
_CHROMA_NOISE = 0.6


def develop(light: Float32, config: RenderConfig, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Stored picture (H, W, 3) BGR of what fell on the sensor, in grey levels.

    The order is that of a camera: defocus, motion, vignette, noise, edge enhancement.
    """
    picture: NDArray[Any] = light
    if config.defocus_px > 0:
        picture = cv2.GaussianBlur(picture, (0, 0), config.defocus_px)
    if config.motion_px > 0:
        picture = cv2.filter2D(
            picture, -1, motion_kernel(config.motion_px, config.motion_rad), borderType=cv2.BORDER_REPLICATE
        )
    if config.vignette > 0:
        picture = picture * _vignette(picture.shape[0], picture.shape[1], config.vignette)[..., None]
    if config.noise > 0:
        luma = rng.standard_normal(picture.shape[:2], dtype=np.float32)
        chroma = rng.standard_normal((picture.shape[0] // 2 + 1, picture.shape[1] // 2 + 1, 3), dtype=np.float32)
        color = cv2.resize(chroma, (picture.shape[1], picture.shape[0]), interpolation=cv2.INTER_LINEAR)
        picture = picture + config.noise * (luma[..., None] + _CHROMA_NOISE * color)
    if config.sharpening > 0:
        picture = picture + config.sharpening * (picture - cv2.GaussianBlur(picture, (0, 0), _SHARPENING_PX))
    return np.asarray(np.clip(np.rint(picture), 0, 255), dtype=np.uint8)


def motion_kernel(length_px: float, angle_rad: float) -> Float32:
    """Normalised kernel (K, K) of a straight, even motion, anti-aliased by its distance to the path."""
    half = int(np.ceil(length_px / 2.0)) + 1
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    along = x * np.cos(angle_rad) + y * np.sin(angle_rad)
    across = y * np.cos(angle_rad) - x * np.sin(angle_rad)
    past = np.maximum(np.abs(along) - length_px / 2.0, 0.0)
    kernel = np.clip(1.0 - np.hypot(past, across), 0.0, 1.0)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def _vignette(height: int, width: int, loss: float) -> Float32:
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    return np.asarray(1.0 - loss * (0.7 * x * x + 0.3 * y * y), dtype=np.float32)
