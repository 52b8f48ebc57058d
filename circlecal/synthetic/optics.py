"""From the light to the stored picture: blur, vignette, edge enhancement, noise, 8 bits."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.synthetic.rays import Float32
from circlecal.synthetic.scene import RenderConfig

_SHARPENING_PX = 1.4
_CHROMA_NOISE = 0.6
_KNEE, _KNEE_SLOPE = np.float32(195.0), np.float32(0.4)
_VEIL_BGR = np.array([172.0, 174.0, 170.0], dtype=np.float32)
_DROP_BGR = np.array([225.0, 225.0, 225.0], dtype=np.float32)


def develop(light: Float32, config: RenderConfig, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Stored picture (H, W, 3) BGR of what fell on the sensor, in grey levels.

    The order is that of a camera: veil of the air, defocus, motion, vignette, exposure, noise, edge enhancement.
    """
    picture: NDArray[Any] = light
    if config.precipitation:
        _fall(picture, config, rng)
    if config.veil > 0:
        picture = picture + np.float32(config.veil) * (_VEIL_BGR - picture)
    if config.defocus_px > 0:
        picture = cv2.GaussianBlur(picture, (0, 0), config.defocus_px)
    if config.motion_px > 0:
        picture = cv2.filter2D(
            picture, -1, motion_kernel(config.motion_px, config.motion_rad), borderType=cv2.BORDER_REPLICATE
        )
    gain = np.float32(config.exposure) * np.asarray(config.cast_bgr, dtype=np.float32)
    if config.vignette > 0:
        picture = picture * _vignette(picture.shape[0], picture.shape[1], config.vignette)[..., None]
    if np.any(gain != 1.0):
        picture = picture * gain
        # a camera's knee: highlights are pressed together before they are cut off
        if gain.max() > 1.0:
            picture = np.minimum(picture, _KNEE + _KNEE_SLOPE * (picture - _KNEE))
    if config.noise > 0:
        picture = picture + np.float32(config.noise) * _sensor_noise(picture.shape[0], picture.shape[1], rng)
    if config.sharpening > 0:
        blurred = cv2.GaussianBlur(picture, (0, 0), _SHARPENING_PX)
        picture = cv2.addWeighted(picture, 1.0 + config.sharpening, blurred, -config.sharpening, 0.0)
    return np.asarray(np.clip(np.rint(picture), 0, 255), dtype=np.uint8)


def _sensor_noise(height: int, width: int, rng: np.random.Generator) -> Float32:
    """Noise (H, W, 3) of unit deviation in brightness, coarser and weaker in colour."""
    luma = rng.standard_normal((height, width), dtype=np.float32)
    chroma = rng.standard_normal((height // 2 + 1, width // 2 + 1, 3), dtype=np.float32)
    color = cv2.resize(chroma * np.float32(_CHROMA_NOISE), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(color + luma[..., None], dtype=np.float32)


def _fall(picture: NDArray[Any], config: RenderConfig, rng: np.random.Generator) -> None:
    """Lay streaks of rain or flakes of snow over the picture, in place."""
    height, width = picture.shape[:2]
    unit = width / 1920.0
    count = int(3500 * config.precipitation)
    drops: NDArray[Any] = np.zeros((height, width), dtype=np.float32)
    x, y = rng.integers(0, width, count), rng.integers(0, height, count)
    drops[y, x] = rng.uniform(0.3, 1.0, count)
    if rng.random() < 0.5:
        drops = cv2.GaussianBlur(drops, (0, 0), max(0.7, 1.6 * unit))
    else:
        drops = cv2.filter2D(drops, -1, motion_kernel(max(3.0, 26.0 * unit), float(rng.uniform(1.2, 1.9))))
    drops = drops * (0.45 / max(float(drops.max()), 1e-6))
    picture += drops[..., None] * (_DROP_BGR - picture)


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
