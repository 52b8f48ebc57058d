"""Measurement at full resolution: profiles across a curve, the marking's centre, contrast and width in each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from circlecal.geometry.projective import Array
from circlecal.paint.profiles import along_normals, highest_rows, nearest_gaps, row_numbers

__all__ = ["BandProfile", "local_width", "measure_band"]

_FEW = 5  # fewer samples than this do not make a median
_CENTROID_LEVEL = 0.4  # of the peak: the centroid is taken over what rises above it
_COHERENCE = 5  # samples on either side over which offsets and contrasts are compared

_WIDTH_REACH = 7  # samples on either side over which the width is smoothed


class RefinementConfig(BaseModel):
    """Profiles across the curve at full resolution."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    reach_px1280: float = Field(default=6.0, gt=1.0, le=40.0, description="Half length of the first profiles.")
    narrow_reach_px1280: float = Field(default=3.5, gt=1.0, le=40.0, description="Half length of the later profiles.")
    width_share: float = Field(
        default=0.02,
        ge=0.0,
        le=0.2,
        description="Circle: profiles are longer by this share of the distance from the centre.",
    )
    line_reach_px1280: float = Field(
        default=10.0, gt=1.0, le=40.0, description="Half length of the first profiles of a line."
    )
    spacing_px1280: float = Field(
        default=2.0, gt=0.2, le=20.0, description="Distance between profiles along the curve."
    )
    samples: int = Field(default=640, ge=64, le=4096, description="Most profiles on one curve.")
    rounds: int = Field(default=2, ge=1, le=10, description="Rounds of profiles and fit.")
    weakest: float = Field(
        default=0.35, gt=0.0, le=1.0, description="Weakest accepted contrast relative to the local median."
    )
    strongest: float = Field(default=2.5, ge=1.0, le=20.0, description="Strongest accepted contrast, likewise.")
    noise_factor: float = Field(
        default=3.0, ge=0.0, le=20.0, description="Smallest contrast in units of the surface's noise."
    )
    minimum_contrast: float = Field(default=0.6, ge=0.0, le=100.0, description="Smallest contrast in grey levels.")
    step_share: float = Field(
        default=0.8,
        gt=0.0,
        le=5.0,
        description="Largest brightness step between the two sides, in units of the contrast.",
    )


@dataclass(frozen=True, slots=True)
class BandProfile:
    """What the profiles across a curve show; all arrays have one entry per sample of the curve.

    Attributes
    ----------
    offset : (N,) float64
        Centre of the marking along the normal, px.
    contrast : (N,) float64
        Brightness of the marking over its surroundings, grey levels (negative for the wrong polarity).
    width : (N,) float64
        Width at half height, px.
    inside : (N,) bool
        The sample lies in the picture.
    supported : (N,) bool
        The picture shows a marking there.
    """

    offset: Array
    contrast: Array
    width: Array
    inside: NDArray[np.bool_]
    supported: NDArray[np.bool_]


def measure_band(
    grey: NDArray[np.uint8],
    points: Array,
    normals: Array,
    reach_px: Array,
    pieces: NDArray[np.int64],
    sign: float,
    config: RefinementConfig,
) -> BandProfile:
    """Measure a marking across a curve, or across several curves one after the other.

    Parameters
    ----------
    grey : (H, W) uint8
        Full picture.
    points, normals : (N, 2) array
        Samples of the curve, in order, and unit normals.
    reach_px : (N,) array
        Half length of each profile; more than the marking's width, so that both ends see the bare surface.
    pieces : (N,) int64
        Number 0, 1, ... of the piece of the curve within which a sample's contrast must be usual.
    sign : float
        +1 for a light marking, -1 for a dark one.
    config : RefinementConfig

    Returns
    -------
    BandProfile
    """
    height, width = grey.shape
    x, y = points.T
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    profile, step = _profiles(grey, points, normals, reach_px, sign)
    taps = len(profile)
    rim = max(2, taps // 6)
    left, right = profile[:rim].mean(axis=0), profile[-rim:].mean(axis=0)
    share = np.linspace(0.0, 1.0, taps, dtype=np.float32)
    raised = profile - np.stack([1.0 - share, share], axis=-1) @ np.stack([left, right])
    at, contrast = highest_rows(raised[rim:-rim])
    at += rim
    offset, full_width = _centroid(raised, at, contrast, step)
    noise = _background_noise(profile, left, right, rim, inside)
    supported = inside & (contrast > max(config.minimum_contrast, config.noise_factor * noise))
    supported &= np.abs(right - left) <= config.step_share * contrast + noise
    tolerance = np.maximum(0.8, 0.12 * reach_px)
    # the noise of bare surface is no paint, and must not be what is usual
    supported = _coherent(supported, offset, tolerance)
    supported = _locally_usual(supported, contrast, pieces, config.weakest, config.strongest)
    supported = _coherent(supported, offset, tolerance)
    return BandProfile(offset, contrast.astype(np.float64) * sign, full_width, inside, supported)


def _profiles(
    grey: NDArray[np.uint8], points: Array, normals: Array, reach_px: Array, sign: float
) -> tuple[NDArray[np.float32], Array]:
    """Brightness (taps, N) across the curve, a little smoothed along it, and the distance (N,) between taps, px."""
    half = max(6, int(np.ceil(_median(reach_px) / 0.75)))
    step = reach_px / half
    x, y = along_normals(points.T, normals.T * step, np.arange(-half, half + 1.0))
    sampled = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = sampled.astype(np.float32)
    smooth = np.asarray(cv2.blur(profile, (3, 1), borderType=cv2.BORDER_REPLICATE), np.float32)
    return smooth * np.float32(sign), step


def _centroid(
    raised: NDArray[np.float32], at: NDArray[np.int_], contrast: NDArray[np.float32], step: Array
) -> tuple[Array, Array]:
    """Centre and width at half height of the hump around the peak, px."""
    taps = len(raised)
    index = row_numbers(taps)
    level = np.float32(_CENTROID_LEVEL) * contrast
    before, after = nearest_gaps(raised < level, at, index)
    hump = (index - 1 > before) & (index - 1 < after)
    # nothing jumps where a tap enters or leaves the hump
    weight = (raised - level) * hump
    total = np.maximum(weight.sum(axis=0), np.float32(1e-6))
    offset = (np.arange(taps, dtype=np.float32) @ weight / total - (taps - 1) / 2) * step
    high = hump & (raised >= np.maximum(np.float32(0.5) * contrast, np.float32(1e-6)))
    return offset, np.count_nonzero(high, axis=0) * step


def _background_noise(
    profile: NDArray[np.float32],
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    rim: int,
    inside: NDArray[np.bool_],
) -> float:
    """Typical scatter of the surface beside the marking: median over samples, grey levels."""
    if not inside.any():
        return 0.0
    scatter = np.abs(profile[:rim] - left).sum(axis=0) + np.abs(profile[-rim:] - right).sum(axis=0)
    return 1.25 * _median(scatter[inside]) / (2 * rim)


def _median(values: NDArray[np.floating[Any]]) -> float:
    """Upper median; np.median takes much longer over its checks than over a few hundred values."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _wrapped(values: Array, reach: int) -> Array:
    """Values with so many of the other end's on either side."""
    return values.take(np.arange(-reach, len(values) + reach), mode="wrap")


def _locally_usual(
    supported: NDArray[np.bool_],
    contrast: NDArray[np.float32],
    pieces: NDArray[np.int64],
    weakest: float,
    strongest: float,
) -> NDArray[np.bool_]:
    """Drop samples much weaker or stronger than the median contrast of the samples in their piece."""
    on = np.flatnonzero(supported)
    if len(on) < _FEW:
        return supported
    order = on[np.lexsort((contrast[on], pieces[on]))]
    count = np.bincount(pieces[on], minlength=int(pieces.max()) + 1)
    middle = np.cumsum(count) - count + count // 2
    overall = _median(contrast[on])
    typical = np.where(count >= _FEW, contrast[order[np.minimum(middle, len(order) - 1)]], np.float32(overall))
    typical = np.clip(typical, overall / 3, overall * 3)[pieces]
    return supported & (contrast >= weakest * typical) & (contrast <= strongest * typical)


def _coherent(supported: NDArray[np.bool_], offset: Array, tolerance: Array) -> NDArray[np.bool_]:
    """Drop samples whose offset is unlike that of most of their neighbours."""
    if len(offset) <= 2 * _COHERENCE:
        return supported
    filled = np.where(supported, offset, np.inf)
    neighbours = np.lib.stride_tricks.sliding_window_view(_wrapped(filled, _COHERENCE), 2 * _COHERENCE + 1).T
    with np.errstate(invalid="ignore"):
        alike = np.count_nonzero(np.abs(neighbours - filled) <= tolerance, axis=0)
    return supported & (alike >= 1 + _COHERENCE)


def local_width(band: BandProfile) -> Array:
    """Width of the marking (N,), px: mean over supported neighbours, the overall one where there are none."""
    weight = band.supported.astype(np.float64)
    if not band.supported.any():
        return np.zeros(len(weight))
    kernel = np.ones(2 * _WIDTH_REACH + 1)
    total = np.convolve(_wrapped(band.width * weight, _WIDTH_REACH), kernel, mode="valid")
    count = np.convolve(_wrapped(weight, _WIDTH_REACH), kernel, mode="valid")
    overall = float((band.width * weight).sum() / weight.sum())
    return np.where(count > 0, total / np.maximum(count, 1), overall)
