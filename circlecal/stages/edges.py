"""Stage ``edges``: sub-pixel Canny points in the neighbourhood of the circle's marking (Canny 1986)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array
from circlecal.paint.bands import SIGMA_FLOOR_PX
from circlecal.paint.profiles import estimate_noise, interpolate
from circlecal.refusals import refuse
from circlecal.results import CIRCLE_ID, EdgePoints, MarkingMask

MARGIN_PX = 8
"""Kept around the mask, so that filters see what lies beside it."""
GRADIENT_UNIT = 128.0
"""Steps of the derivatives per grey level and pixel: whole numbers of 16 bits, which Canny takes."""
ENOUGH_SAMPLES = 3000
"""Pixels from which noise and thresholds are read."""
SOBEL_SIGMA_PX = 0.7
"""Smoothing that the 3 x 3 Sobel kernel itself brings."""


class EdgesConfig(BaseModel):
    """Options of the stage ``edges``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    thresholds: Literal["auto"] | tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = Field(
        "auto",
        description="Canny's low and high threshold in grey levels per pixel, or auto (from the noise of the picture).",
    )
    smoothing_px: float = Field(0.8, ge=0.3, le=5, description="Gaussian smoothing before the gradient, pixels.")
    dilate_px: float = Field(
        7, ge=0, le=200, description="How far the mask is dilated before edges are looked for, pixels at 1920 px width."
    )

    @model_validator(mode="after")
    def _check_order(self) -> EdgesConfig:
        if self.thresholds != "auto" and self.thresholds[0] >= self.thresholds[1]:
            raise ValueError("thresholds: the low one must be below the high one")
        return self


@dataclass(frozen=True, slots=True)
class SearchRegion:
    """Where edges of the circle can be: ``inside`` (h, w) bool in the window of the picture whose first pixel is
    ``left``, ``top``.
    """

    left: int
    top: int
    inside: NDArray[np.bool_]

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the window."""
        height, width = self.inside.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)


def search_region(mask: MarkingMask, shape: tuple[int, ...], dilate_px: float) -> SearchRegion | None:
    """The circle's marking, dilated, together with a band about the rough ellipse, in a picture of this shape.

    None where there is neither.
    """
    size = max(1, round(dilate_px))
    corners = []
    marked = None
    if mask.band_px is None:
        marked = (mask.classes == CIRCLE_ID).view(np.uint8)
        left, top, width, height = cv2.boundingRect(marked)
        if width:
            corners.append(np.array([[left, top], [left + width, top + height]]))
    ellipse = None if mask.conic is None else ellipse_from_conic(mask.conic)
    outline = np.zeros((0, 2))
    if ellipse is not None:
        limit = 8.0 * max(shape)
        outline = np.clip(ellipse.points(np.linspace(0.0, 2 * np.pi, 361)), -limit, limit)
        corners.append(np.stack([outline.min(axis=0), outline.max(axis=0)]))
    if not corners:
        return None
    half = size + round(0.5 * (mask.band_px or 0.0))
    low = np.maximum(np.floor(np.min(corners, axis=(0, 1))) - half - MARGIN_PX, 0).astype(int)
    high = np.minimum(np.ceil(np.max(corners, axis=(0, 1))) + half + MARGIN_PX, shape[1::-1]).astype(int)
    if (low >= high).any():
        return None
    if marked is None:
        inside = np.zeros(high[::-1] - low[::-1], np.uint8)
    else:
        kernel = np.ones((2 * size + 1, 2 * size + 1), np.uint8)
        inside = np.asarray(cv2.dilate(marked[low[1] : high[1], low[0] : high[0]], kernel), np.uint8)
    if ellipse is not None:
        fixed = np.round((outline - low) * 16).astype(np.int32)
        cv2.polylines(inside, [fixed], True, 1, 2 * half + 1, cv2.LINE_8, 4)
    return SearchRegion(int(low[0]), int(low[1]), inside.view(np.bool_))


def detect_edges(picture: NDArray[np.uint8], mask: MarkingMask, config: EdgesConfig) -> EdgePoints:
    """Canny points of the picture inside the dilated mask, moved to the sub-pixel maximum of the gradient.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field (:func:`circlecal.paint.profiles.to_gray`).
    mask : MarkingMask
        From the stage ``mask``.
    config : EdgesConfig
        Options.

    Raises
    ------
    EstimationError
        ``no_edges`` where fewer than ten points are found.
    """
    searched = search_region(mask, picture.shape, config.dilate_px * picture.shape[1] / 1920)
    if searched is None:
        raise refuse("edges", "no_edges")
    picture, region = picture[searched.window], searched.inside
    gx, gy = _gradients(picture, config.smoothing_px)
    places = _sample_pixels(region)
    noise = estimate_noise(picture, places)
    low, high = _thresholds(config, noise, gx, gy, places)
    found = (cv2.Canny(gx, gy, low * GRADIENT_UNIT, high * GRADIENT_UNIT, L2gradient=True) > 0) & region
    found[[0, -1], :] = False
    found[:, [0, -1]] = False
    places = np.flatnonzero(found)
    y, x = np.divmod(places, found.shape[1])
    if len(x) < 10:
        raise refuse("edges", "no_edges")
    pixels = np.stack([x, y], axis=-1).astype(np.float64)
    gradient = np.stack([g.ravel().take(places) for g in (gx, gy)], axis=-1) / GRADIENT_UNIT
    strength = np.hypot(gradient[:, 0], gradient[:, 1])
    normals = gradient / strength[:, None]
    shift, curvature = _sub_pixel(gx, gy, pixels, normals)
    blur = float(np.clip(np.sqrt(np.median(strength / np.maximum(curvature, 1e-6))), config.smoothing_px, 6.0))
    contrast = strength * blur * np.sqrt(2 * np.pi)
    # a gradient maximum moves by the noise of the second derivative over the gradient's curvature
    scale = np.hypot(config.smoothing_px, SOBEL_SIGMA_PX)
    second_derivative_noise = noise * np.sqrt(3 / (16 * np.pi)) / scale**3
    sigma = np.hypot(second_derivative_noise / np.maximum(curvature, 1e-6), SIGMA_FLOOR_PX)
    keep = (np.abs(shift) <= 1.0) & (sigma < 2.0)
    points = pixels + shift[:, None] * normals + (searched.left, searched.top)
    return EdgePoints(points[keep], normals[keep], contrast[keep], sigma[keep], noise, blur, (low, high))


def _gradients(picture: NDArray[np.uint8], smoothing_px: float) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Derivatives of the smoothed picture by x and by y, as Gaussian and Sobel filters in one."""
    smooth = cv2.getGaussianKernel(2 * int(np.ceil(3.5 * smoothing_px)) + 1, smoothing_px).ravel()
    along, across = np.convolve(smooth, [-1.0, 0.0, 1.0]) * (GRADIENT_UNIT / 8), np.convolve(smooth, [1.0, 2.0, 1.0])
    gx, gy = (cv2.sepFilter2D(picture, cv2.CV_16S, *kernels) for kernels in ((along, across), (across, along)))
    return np.asarray(gx, np.int16), np.asarray(gy, np.int16)


def _sample_pixels(region: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Flat indices of about as many pixels inside the region as are needed, evenly spread."""
    step = max(1, int(np.sqrt(cv2.countNonZero(region.view(np.uint8)) / ENOUGH_SAMPLES)))
    y, x = np.nonzero(region[2:-2:step, 2:-2:step])
    return (step * y + 2) * region.shape[1] + step * x + 2


def _thresholds(
    config: EdgesConfig,
    noise: float,
    gx: NDArray[np.int16],
    gy: NDArray[np.int16],
    places: NDArray[np.int_],
) -> tuple[float, float]:
    if config.thresholds != "auto":
        return config.thresholds
    # gradient noise of a smoothed picture, and a share of the strong gradients of the marking itself
    floor = noise / (config.smoothing_px**2 * np.sqrt(8 * np.pi))
    magnitude = np.hypot(gx.ravel().take(places).astype(np.float32), gy.ravel().take(places).astype(np.float32))
    strong = float(np.percentile(magnitude, 97)) / GRADIENT_UNIT if magnitude.size else 0.0
    high = max(4.0 * floor, 0.25 * strong, 0.8)
    return 0.5 * high, high


def _sub_pixel(gx: NDArray[np.int16], gy: NDArray[np.int16], pixels: Array, normals: Array) -> tuple[Array, Array]:
    """Offset along the normal to the parabola's top through the gradient's size in three samples, and the curvature
    there.
    """
    steps = np.array([-1.0, 0.0, 1.0], np.float32)[:, None]
    (x0, y0), (nx, ny) = pixels.T.astype(np.float32), normals.T.astype(np.float32)
    x, y = x0 + steps * nx, y0 + steps * ny
    across, down = (interpolate(g, x, y).astype(np.float32) for g in (gx, gy))
    before, here, after = np.sqrt(across * across + down * down).astype(np.float64) / GRADIENT_UNIT
    curvature = 2 * here - before - after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curvature > 0, 0.5 * (after - before) / curvature, 9.0)
    return shift, np.maximum(curvature, 0.0)
