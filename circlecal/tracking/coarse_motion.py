"""How a smeared picture moved, at a fixed low resolution: a fast pan leaves no corners that could be followed.

The levels of a small picture are divided by their own scatter nearby, so that what little contrast the smear leaves
counts as much as a sharp board. The picture is shifted as a whole at first; from there a grid of large windows is
followed, whose ways say how the head turned, as those of corners do.
"""

from __future__ import annotations

import cv2
import numpy as np

from circlecal.geometry.projective import Array
from circlecal.rig.tripod import TripodModel
from circlecal.tracking.motion import (
    NO_FLOW,
    Flow,
    HeadMotion,
    SmallPicture,
    estimate_motion,
    follow_corners,
    move_of_middle,
)

WIDTH_PX = 320
"""Width of the coarse picture: a smear of 60 px at 1920 px width is 10 px there."""
NEARBY_PX = 12
"""Reach over which levels are taken from their mean and divided by their scatter, coarse pixels."""
LEAST_SCATTER, GAIN, MIDDLE_LEVEL = 4.0, 40.0, 128.0
"""What is added to the scatter, levels, so that the noise of grass does not count; how many levels one scatter becomes;
and the level of the mean.
"""
GRID, BORDER_PX = (16, 9), 16.0
"""Windows across and down the picture, and how far their middles stay from its border, coarse pixels."""
WINDOW, LEVELS = (21, 21), 1
"""Size of a window, coarse pixels, and how often the pictures are halved to look for it."""
REACH_PX, REACH_SHARE = (10.0, 8.0), 0.25
"""How far from the expected shift the picture is looked for, across and down, coarse pixels, and by what share of that
shift further: a strip of graphics, which stands still, must not be met while the picture moves fast.
"""
UNTOLD_REACH_PX = (60.0, 16.0)
"""How far the picture is looked for where no shift is expected, coarse pixels: 360 px at 1920 px width across."""
LEAST_WINDOWS, LEAST_AGREEING = 25, 0.35
"""Windows that one motion explains at least, and their share of those that come back to where they began: in a rendered
pan of up to 280 px a frame at 1920 px width at least 63 windows and 0.77, in one that zooms by 3 % a frame besides and
shows players 35 and 0.39; nothing explains a quarter of those of 1,127 pairs of pictures that do not follow each other.
"""
LEAST_OVERLAP_PX = 60
"""Height and width of what both pictures must show, coarse pixels."""


def coarsen(small: SmallPicture) -> SmallPicture:
    """A small picture reduced further, with levels that are alike where it is dull and where it is rich."""
    height, width = small.gray.shape
    size = WIDTH_PX, round(WIDTH_PX * height / width)
    gray = np.asarray(cv2.resize(small.gray, size, interpolation=cv2.INTER_AREA), np.float32)
    around = 2 * NEARBY_PX + 1, 2 * NEARBY_PX + 1
    gray -= cv2.blur(gray, around)
    # running sums of what is flat may end a little below zero
    scatter = np.sqrt(np.maximum(cv2.blur(gray * gray, around), 0.0)) + LEAST_SCATTER
    levels = np.clip(MIDDLE_LEVEL + GAIN * gray / scatter, 0, 255).astype(np.uint8)
    return SmallPicture(levels, small.factor * width / WIDTH_PX)


def find_shift(first: SmallPicture, second: SmallPicture, expected: Array | None) -> Array | None:
    """How far (2,) what a coarse picture shows lies from there in the second one, coarse pixels, near where that is
    expected (2,), or wherever it may be; None where the two hardly overlap.
    """
    size = np.array(first.gray.shape[::-1])
    if expected is None:
        middle, reach = np.zeros(2, int), np.array(UNTOLD_REACH_PX, int)
    else:
        middle = np.round(expected).astype(int)
        reach = np.ceil(np.array(REACH_PX) + REACH_SHARE * np.abs(expected)).astype(int)
    low, high = np.maximum(0, reach - middle), np.minimum(size, size - reach - middle)
    if (high - low < LEAST_OVERLAP_PX).any():
        return None
    part = first.gray[low[1] : high[1], low[0] : high[0]]
    start, end = low + middle - reach, high + middle + reach
    alike = cv2.matchTemplate(second.gray[start[1] : end[1], start[0] : end[0]], part, cv2.TM_CCOEFF_NORMED)
    return np.array(cv2.minMaxLoc(alike)[3]) - reach + middle


def follow_windows(first: SmallPicture, second: SmallPicture, expected: Array | None) -> Flow:
    """Follow a grid of windows from one coarse picture to the next.

    Parameters
    ----------
    first, second : SmallPicture
        As of :func:`coarsen`.
    expected : (2,) array or None
        How far the picture is expected to move, pixels of the whole one, if that is known.
    """
    shift = find_shift(first, second, None if expected is None else expected / first.factor)
    if shift is None:
        return NO_FLOW
    height, width = first.gray.shape
    across, down = (
        np.linspace(BORDER_PX, side - BORDER_PX, count) for side, count in zip((width, height), GRID, strict=True)
    )
    grid = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    ahead = grid + shift
    is_seen = ((ahead > 0) & (ahead < (width, height))).all(axis=1)
    windows = np.asarray(grid[is_seen], np.float32)
    return follow_corners(first, second, windows, shift * first.factor, WINDOW, LEVELS)


def estimate_coarsely(
    first: SmallPicture,
    second: SmallPicture,
    expected: Array | None,
    head: Array,
    model: TripodModel,
    common: Array,
    rng: np.random.Generator,
) -> HeadMotion | None:
    """The change of the head that explains how most windows moved; None where they agree too little.

    Parameters
    ----------
    first, second : SmallPicture
        As of :func:`coarsen`.
    expected : (3,) array or None
        The change of the head about which it is looked for, if any is expected.
    head : (3,) array
        Of the first picture.
    model, common, rng : TripodModel, (K,) array, numpy.random.Generator
        As for :func:`circlecal.tracking.motion.estimate_motion`.
    """
    moved = None if expected is None else move_of_middle(expected, head, model, common)
    flow = follow_windows(first, second, moved)
    found = estimate_motion(flow, head, model, common, rng, first.factor)
    if found is None or found.inliers < LEAST_WINDOWS or found.share < LEAST_AGREEING:
        return None
    return found
