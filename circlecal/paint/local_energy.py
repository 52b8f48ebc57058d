"""A picture in which lines and edges both stand out as light bands: the rim of a painted disc, or of a logo, has no
line.

The local energy of a picture, the sum of the squares of an even and an odd filter, has one peak at the middle of a line
and one at a step (Morrone and Owens 1987, *Feature detection from local energy*; Perona and Malik 1990, *Detecting and
localizing edges composed of steps, peaks and roofs*). With Gaussian derivatives of standard deviation ``s`` the even
part is the Laplacian ``s^2 L``, the odd one the gradient ``s G``: a step of height 1 gives at ``u = x / s`` from it
``s^4 L^2 + k s^2 G^2 = (k + u^2) exp(-u^2) / (2 pi)``, which has one maximum, at the step, for every ``k >= 1``.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["local_energy", "widest_band_px"]

SIGMA_PX = 1.3
"""Of the derivatives, pixels at 1920 px width and of the picture at least."""
WIDEST_BAND = 3.0
"""Width of the widest line that is one band, in these standard deviations, 4 px at 1920 px width: a wider one is two,
one at each of its edges.
"""
ODD_WEIGHT = 1.3
"""Weight ``k`` of the squared gradient: with 1 the peak at a step is flat, from 2 on a thin line has two."""
GAIN = 2.2
"""Grey levels of the result per level of the amplitude, which is ``sqrt(k / (2 pi)) = 0.45`` of a step's height: whole
numbers would lose half of it, and a step of all 255 levels just fits."""


def local_energy(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Amplitude (H, W) of the local energy of a BGR picture (H, W, 3): at each pixel that of the strongest colour."""
    sigma = _sigma_px(image.shape[1])
    kernel = 2 * int(np.ceil(3.0 * sigma)) + 1
    smooth = cv2.GaussianBlur(image.astype(np.float32), (kernel, kernel), sigma)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    even = cv2.Laplacian(smooth, cv2.CV_32F, ksize=1)
    energy = np.float32(sigma**4) * even * even + np.float32(ODD_WEIGHT * sigma**2) * (across * across + down * down)
    amplitude = np.sqrt(energy.max(axis=2))
    return np.rint(np.float32(GAIN) * amplitude).clip(0, 255).astype(np.uint8)


def widest_band_px(width: int) -> float:
    """Width, pixels, of the widest line that shows as one band in a picture that is so many pixels wide."""
    return WIDEST_BAND * _sigma_px(width)


def _sigma_px(width: int) -> float:
    return max(SIGMA_PX, SIGMA_PX * width / 1920.0)
