"""Gray profiles across a curve in a picture: sampled, smoothed along the curve, and the picture's noise."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array

GrayPicture = NDArray[np.uint8 | np.float32]
"""Gray levels (H, W): as they are decoded, or with fractions."""
BRIGHTNESS_BGR = (0.114, 0.587, 0.299)
"""Weights of blue, green and red in the brightness (ITU-R BT.601)."""
MOST_COLUMNS = 32_000
"""Places that OpenCV looks up in one row: its limit is 32766."""
NOISE_STEPS = 8, 4
"""Rows and columns from one pixel to the next at which a whole picture's noise is measured: those of 1280 by 720 pixels
are 29,000, from which the noise is known to 1 %.
"""
Profiles = NDArray[np.float32]
"""Gray levels (N, S) of N profiles; they are stored side by side, so that ``.T`` is contiguous."""


def to_gray(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Gray picture (H, W) of a BGR one (H, W, 3), as ITU-R BT.601 weighs the three colours."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def interpolate(picture: NDArray[Any], x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[Any]:
    """A picture (H, W) at any number of places (S, N), bilinearly; beyond its border it repeats its outer pixels."""

    def look_up(part: slice) -> NDArray[Any]:
        return np.asarray(cv2.remap(picture, x[:, part], y[:, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    count = x.shape[1]
    if count <= MOST_COLUMNS:
        return look_up(slice(None))
    return np.concatenate([look_up(slice(k, k + MOST_COLUMNS)) for k in range(0, count, MOST_COLUMNS)], axis=1)


def sample_profiles(
    picture: GrayPicture, points_px: Array, normals: Array, offsets: Array, *, repeat_border: bool = False
) -> Profiles:
    """Sample gray levels (N, S) at ``points + offset * normal``, bilinearly.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
    points_px, normals : (N, 2) array
        Where the profiles cross the curve, and their directions; the length of a normal is the unit of the offsets.
    offsets : (S,) array
    repeat_border : bool
        Whether places outside the picture look like its nearest pixel; they are nan otherwise.
    """
    height, width = picture.shape
    if len(points_px) == 0:
        return np.zeros((0, len(offsets)), np.float32)
    lever = np.ones((len(offsets), 2), np.float32)
    lever[:, 0] = offsets
    x, y = (lever @ np.array(pair, np.float32) for pair in zip(normals.T, points_px.T, strict=True))
    values = interpolate(picture, x, y).astype(np.float32, copy=False)
    ends = ((x[0], width), (x[-1], width), (y[0], height), (y[-1], height))
    if not repeat_border and any(end.min() < 0 or end.max() > size - 1 for end, size in ends):
        values[(x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)] = np.nan
    return values.T


def smooth_along(profiles: Profiles, sigma_samples: float) -> Profiles:
    """Gaussian mean of neighbouring profiles (N, S); rows with nan stay nan and lend nothing to their neighbours."""
    if sigma_samples <= 0 or len(profiles) < 3:
        return profiles
    values = np.ascontiguousarray(profiles.T, np.float32)
    kernel = _gaussian(sigma_samples)
    known = np.isfinite(values)
    if known.all():
        return _filter_rows(values, kernel).T
    total = _filter_rows(np.where(known, values, np.float32(0)), kernel)
    weight = _filter_rows(known.astype(np.float32), kernel)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(known, total / weight, np.float32(np.nan)).T


@lru_cache(maxsize=32)
def _gaussian(sigma: float) -> cv2.typing.MatLike:
    """Kernel (K, 1), of which few are asked for again and again."""
    return cv2.getGaussianKernel(2 * int(np.ceil(2.5 * sigma)) + 1, sigma, cv2.CV_32F)


def _filter_rows(values: NDArray[np.float32], kernel: cv2.typing.MatLike) -> NDArray[np.float32]:
    one = np.ones((1, 1), np.float32)
    return np.asarray(cv2.sepFilter2D(values, -1, kernel, one, borderType=cv2.BORDER_REFLECT), np.float32)


def estimate_noise(picture: GrayPicture, places: NDArray[np.int_] | None = None) -> float:
    """Estimate the standard deviation of a picture's noise, gray levels, at least 0.5 (a picture of 8 bits is rounded).

    The filter ``[1 -2 1]^T [1 -2 1]`` sees neither planes nor straight edges along rows or columns, and multiplies the
    standard deviation of noise by 6 (Immerkaer 1996, *Fast noise variance estimation*, equations 1 to 3). Its median
    size instead of its mean, over 0.6745 of a standard deviation, ignores what structure it does see.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
    places : (N,) array of int, optional
        Flat indices of the pixels that are looked at, none of them at the picture's border; without them, or where
        they are few, those of every so many rows and columns.
    """
    if places is None or len(places) < 100:
        last, (row, column) = picture.shape[0] - 2, NOISE_STEPS
        before, here, after = (picture[k : k + last : row].astype(np.float32) for k in range(3))
        rows = before + after - 2 * here
        values = np.abs(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:])[:, ::column].ravel()
    else:
        flat, width = picture.ravel(), picture.shape[1]
        around = places + np.array([-width, 0, width])[:, None, None] + np.array([-1, 0, 1])[:, None]
        before, here, after = np.moveaxis(flat.take(around).astype(np.float32), 1, 0)
        rows = before + after - 2 * here
        values = np.abs(rows[0] - 2 * rows[1] + rows[2])
    return float(max(0.5, 1.4826 / 6 * np.median(values)))
