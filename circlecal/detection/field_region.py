"""Playing surface: the dominant colour of the lower picture, its patches and their convex hull.

No colour is assumed. The peak of the a-b histogram (CIE Lab) is the surface, whatever it is made of.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.options import FieldRegionConfig
from circlecal.geometry.projective import Mask

__all__ = ["FieldRegion", "find_field_region", "uncover"]

WIDTH_PX = 240
"""Width of the reduced picture in which the colours are counted (does not scale); a study of 42 broadcast
frames took 320.
"""
UPPER_SHARE_SKIPPED = 0.25
"""Upper share of the picture that does not vote: there are the stands."""
DARK_LEVEL = 22
"""Pixels darker than this (8-bit L of Lab) never vote: borders, and boxes with text, have no colour."""
COLOUR_REACH = 22
"""Largest distance of a surface's colours from its commonest, in levels of a-b."""
HISTOGRAM_SIGMA = 2.0
"""Smoothing of the a-b histogram, in levels of a and b."""
PEAK_SHARE = 0.04
"""A colour belongs to the field above this share of the histogram's peak."""
PATCH_SHARE = 0.10
"""Further patches join the field above this share of the largest patch: lines and shadows cut it."""
LOCAL_SHARE, NEIGHBOURHOODS = 0.30, 14
"""Places of the hull whose neighbourhood, this many to a picture's width, holds less field colour than this share are
left out: a convex hull takes in what lies between two patches.
"""
LIGHT_PART_LEVELS = 60.0
"""By how many levels of L the light part of a surface exceeds the dark one on average, if these are two things: ice and
stands differ by 115 to 185 in 16 real and rendered rinks.
"""
MEDIAN_LEVEL, LARGEST_GAIN = 70.0, 6.0
"""Darker pictures are brightened to this median level first, by so much at most: their colours lie too close together.
"""


@dataclass(frozen=True, slots=True)
class FieldRegion:
    """The playing surface in the reduced picture.

    Attributes
    ----------
    hull : (h, w) uint8
        255 inside the hull of the field.
    area_share : float
        Share of the picture that the hull covers.
    """

    hull: NDArray[np.uint8]
    area_share: float

    def hull_at(self, width: int, height: int) -> NDArray[np.uint8]:
        """Hull at another picture size: (height, width) uint8, 0 or 255."""
        return resize_hull(self.hull, width, height)


def resize_hull(hull: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """A hull (h, w), 0 or 255, at another picture size: (height, width) uint8."""
    return np.asarray(cv2.resize(hull, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)


def uncover(region: FieldRegion, covered: Mask | None) -> FieldRegion:
    """The field without what graphics cover (H, W) of the picture."""
    if covered is None:
        return region
    height, width = region.hull.shape
    hidden = cv2.resize(covered.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
    hull = np.where(hidden > 0, 0, region.hull).astype(np.uint8)
    return FieldRegion(hull=hull, area_share=region.area_share)


def find_field_region(
    picture: NDArray[np.uint8], config: FieldRegionConfig, beside: FieldRegion | None = None
) -> FieldRegion:
    """Find the playing surface by its dominant colour.

    Parameters
    ----------
    picture : (H, W, 3) uint8
        BGR picture of any size.
    config : FieldRegionConfig
    beside : FieldRegion, optional
        Of this picture, and not the field: the stands, or the track before it. Its pixels do not vote.

    Returns
    -------
    FieldRegion
        In a picture of at most :data:`WIDTH_PX` columns; empty (area share 0) when no colour dominates.
    """
    height, width = picture.shape[:2]
    factor = min(1.0, WIDTH_PX / width)
    size = (max(16, round(width * factor)), max(16, round(height * factor)))
    # every second pixel of the small picture's grid is enough for the averaging, and much faster to fetch
    fetched = cv2.resize(picture, (2 * size[0], 2 * size[1]), interpolation=cv2.INTER_NEAREST)
    small = cv2.resize(fetched, size, interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(_brighten(np.asarray(small, np.uint8)), cv2.COLOR_BGR2LAB)
    voting = np.asarray(lab[:, :, 0] >= DARK_LEVEL, np.bool_)
    voting[: int(UPPER_SHARE_SKIPPED * size[1])] = False
    if beside is not None:
        voting &= beside.hull_at(*size) == 0
    surface = _find_field_colour(np.asarray(lab, np.uint8), voting)
    if config.light:
        surface = _keep_light_part(surface, np.asarray(lab[:, :, 0], np.uint8))
    patches = _keep_large_patches(surface)
    hull = _convex_hull(patches)
    share = cv2.boxFilter(surface, cv2.CV_32F, (_odd_length(size[0] / NEIGHBOURHOODS),) * 2)
    hull[share < 255.0 * LOCAL_SHARE] = 0
    return FieldRegion(hull=hull, area_share=float(np.count_nonzero(hull)) / hull.size)


def _brighten(small: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture, or a brighter copy where the voting part is dark."""
    skipped = int(UPPER_SHARE_SKIPPED * small.shape[0])
    level = float(np.median(small[skipped::4, ::4].max(axis=-1)))
    gain = min(LARGEST_GAIN, MEDIAN_LEVEL / max(level, 1.0))
    return small if gain <= 1.0 else np.asarray(cv2.convertScaleAbs(small, alpha=gain), np.uint8)


def _odd_length(length: float) -> int:
    return 2 * (int(length) // 2) + 1


def _find_field_colour(lab: NDArray[np.uint8], voting: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Pixels whose a-b colour belongs to the main peak of the histogram (bins of two levels) of the voting ones: (h, w)
    uint8, 0 or 255.
    """
    colour = (lab[:, :, 1] >> 1).astype(np.int32) * 128 + (lab[:, :, 2] >> 1)
    histogram = np.bincount(colour[voting], minlength=128 * 128).reshape(128, 128).astype(np.float32)
    histogram = np.asarray(cv2.GaussianBlur(histogram, (0, 0), HISTOGRAM_SIGMA / 2), np.float32)
    peak_a, peak_b = (int(i) for i in np.unravel_index(int(histogram.argmax()), histogram.shape))
    if histogram[peak_a, peak_b] <= 0:
        return np.zeros(lab.shape[:2], np.uint8)
    a, b = np.ogrid[:128, :128]
    near = 4 * ((a - peak_a) ** 2 + (b - peak_b) ** 2) <= COLOUR_REACH**2
    member = (near & (histogram > PEAK_SHARE * histogram[peak_a, peak_b])).astype(np.uint8)
    _, labels = cv2.connectedComponents(member, connectivity=8)
    colours = (labels == labels[peak_a, peak_b]).astype(np.uint8) * 255
    coloured = colours.ravel()[colour]
    coloured[lab[:, :, 0] < DARK_LEVEL // 2] = 0
    return np.ascontiguousarray(coloured)


def _keep_light_part(surface: NDArray[np.uint8], level: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Of a surface (h, w), 0 or 255, what is lighter than Otsu's threshold of its levels L (h, w); all of it where it
    has no two parts.
    """
    on = surface > 0
    levels = level[on]
    if levels.size == 0:
        return surface
    threshold, _ = cv2.threshold(levels.reshape(-1, 1), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    light = levels > threshold
    if not light.any() or light.all() or levels[light].mean() - levels[~light].mean() < LIGHT_PART_LEVELS:
        return surface
    return np.asarray(np.where(on & (level > threshold), surface, 0), np.uint8)


def _keep_large_patches(surface: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Largest patch and those above a share of it, closed and opened: (h, w) uint8, 0 or 255."""
    small, large = np.ones((3, 3), np.uint8), np.ones((7, 7), np.uint8)
    closed = cv2.morphologyEx(surface, cv2.MORPH_CLOSE, small)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, large)
    count, labels = cv2.connectedComponents(opened, connectivity=4)
    if count < 2:
        return np.zeros_like(surface)
    area = np.bincount(labels.ravel())
    area[0] = 0
    keep = (area >= PATCH_SHARE * area.max()).astype(np.uint8) * 255
    keep[0] = 0
    return np.asarray(keep[labels], np.uint8)


def _convex_hull(patches: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Filled convex hull of all set pixels: (h, w) uint8, 0 or 255."""
    hull = np.zeros_like(patches)
    rows = np.flatnonzero(patches.any(axis=1))
    if len(rows):
        first = patches[rows].argmax(axis=1)
        last = patches.shape[1] - 1 - patches[rows, ::-1].argmax(axis=1)
        ends = np.concatenate([np.stack([first, rows], axis=-1), np.stack([last, rows], axis=-1)])
        cv2.fillConvexPoly(hull, cv2.convexHull(ends.astype(np.int32)), 255)
    return hull
