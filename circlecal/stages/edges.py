"""Stage ``edges``: sub-pixel Canny points in the neighbourhood of the circle's marking (Canny 1986)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from circlecal.errors import EstimationError
from circlecal.geometry.conics import ellipse_from_conic
from circlecal.geometry.homogeneous import Array
from circlecal.profiles import SIGMA_FLOOR_PX, Brightness, picture_noise
from circlecal.results import CIRCLE_ID, EdgePoints, MarkingMask

NO_EDGES = "no edges in the mask of the circle; is the mask that of this picture?"
MARGIN_PX = 8
"""Kept around the mask, so that filters see what lies beside it."""
GREY_UNIT, GRADIENT_UNIT = 16.0, 128.0
"""Steps per grey level of the smoothed picture, and per grey level and pixel of its Sobel derivatives (times 8)."""
ENOUGH_SAMPLES = 6000
"""Pixels from which noise and thresholds are read."""
SOBEL_SIGMA_PX = 0.7
"""Smoothing that the 3 x 3 Sobel kernel itself brings."""
_SHIFT = 4
"""Binary places of the sub-pixel corners."""


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
    def _ordered(self) -> EdgesConfig:
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
    limit = 8.0 * max(shape)
    outlines = list(mask.outlines or ())
    marked = (mask.classes == CIRCLE_ID).view(np.uint8) if mask.outlines is None else None
    ellipse = None if mask.conic is None else ellipse_from_conic(mask.conic)
    band = [] if ellipse is None else [np.clip(ellipse.points(np.linspace(0.0, 2 * np.pi, 361)), -limit, limit)]
    corners = [np.stack([points.min(axis=0), points.max(axis=0)]) for points in (*outlines, *band)]
    left, top, width, height = (0, 0, 0, 0) if marked is None else cv2.boundingRect(marked)
    if width:
        corners.append(np.array([[left, top], [left + width, top + height]]))
    if not corners:
        return None
    reach = size + MARGIN_PX
    low = np.maximum(np.floor(np.min(corners, axis=(0, 1))) - reach, 0).astype(int)
    high = np.minimum(np.ceil(np.max(corners, axis=(0, 1))) + reach, shape[1::-1]).astype(int)
    if (low >= high).any():
        return None
    if marked is None:
        inside = np.zeros(high[::-1] - low[::-1], np.uint8)
        for polygon in outlines:
            cv2.fillPoly(inside, _fixed(polygon - low), 1, cv2.LINE_8, _SHIFT)
    else:
        inside = marked[low[1] : high[1], low[0] : high[0]]
    inside = np.asarray(cv2.dilate(inside, np.ones((2 * size + 1, 2 * size + 1), np.uint8)), np.uint8)
    for outline in band:
        cv2.polylines(inside, _fixed(outline - low), True, 1, 2 * size + 1, cv2.LINE_8, _SHIFT)
    return SearchRegion(int(low[0]), int(low[1]), inside.view(np.bool_))


def _fixed(points: Array) -> list[NDArray[np.int32]]:
    return [np.round(points * (1 << _SHIFT)).astype(np.int32)]


def detect_edges(picture: Brightness, mask: MarkingMask, config: EdgesConfig) -> EdgePoints:
    """Canny points of the picture inside the dilated mask, moved to the sub-pixel maximum of the gradient.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field (:func:`circlecal.profiles.grey`).
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
        raise EstimationError("edges", "no_edges", NO_EDGES)
    picture, region = picture[searched.window], searched.inside
    # whole numbers of 16 bits: sixteenths of a grey level, and what Canny takes
    fine = np.asarray(cv2.multiply(picture, GREY_UNIT, dtype=cv2.CV_16S), np.int16)  # type: ignore[call-overload]
    smooth = cv2.GaussianBlur(fine, (0, 0), config.smoothing_px)
    gx, gy = (np.asarray(cv2.Sobel(smooth, cv2.CV_16S, i, 1 - i, ksize=3), np.int16) for i in (1, 0))
    places = _sampled(region)
    noise = picture_noise(picture, places)
    low, high = _thresholds(config, noise, gx, gy, places)
    found = (cv2.Canny(gx, gy, low * GRADIENT_UNIT, high * GRADIENT_UNIT, L2gradient=True) > 0) & region
    found[[0, -1], :] = False
    found[:, [0, -1]] = False
    y, x = np.divmod(np.flatnonzero(found), found.shape[1])
    if len(x) < 10:
        raise EstimationError("edges", "no_edges", NO_EDGES)
    pixels = np.stack([x, y], axis=-1).astype(np.float64)
    gradient = np.stack([gx[y, x], gy[y, x]], axis=-1) / GRADIENT_UNIT
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


def _sampled(region: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Flat indices of pixels inside the region, every other one both ways and not more than are needed."""
    y, x = np.nonzero(region[2:-1:2, 2:-1:2])
    places = (2 * y + 2) * region.shape[1] + 2 * x + 2
    return places[:: max(1, len(places) // ENOUGH_SAMPLES)]


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
    magnitude = np.hypot(gx.ravel()[places].astype(np.float32), gy.ravel()[places].astype(np.float32))
    strong = float(np.percentile(magnitude, 97)) / GRADIENT_UNIT if magnitude.size else 0.0
    high = max(4.0 * floor, 0.25 * strong, 0.8)
    return 0.5 * high, high


def _sub_pixel(gx: NDArray[np.int16], gy: NDArray[np.int16], pixels: Array, normals: Array) -> tuple[Array, Array]:
    """Offset along the normal to the parabola's top through the gradient's size in three samples, and the curvature
    there.
    """
    steps = np.array([-1.0, 0.0, 1.0])[:, None]
    x, y = ((pixels[:, i] + steps * normals[:, i]).astype(np.float32) for i in range(2))
    across, down = (cv2.remap(g, x, y, cv2.INTER_LINEAR).astype(np.float64) for g in (gx, gy))
    before, here, after = np.hypot(across, down) / GRADIENT_UNIT
    curvature = 2 * here - before - after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curvature > 0, 0.5 * (after - before) / curvature, 9.0)
    return shift, np.maximum(curvature, 0.0)
