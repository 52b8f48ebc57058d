"""Whether the centre mark has the paint of its line: a player's shirt over the line may end as a disc does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.paint.colour import colours_at
from circlecal.results import Cues

__all__ = ["leave_out_other_mark"]

BESIDE_PX, LEAST_BESIDE_PX = 8.0, 4.0
"""How far from the line's middle its ground lies bare, pixels at 1920 px width and pixels of the picture."""
AROUND_PX = 12.0
"""The line's paint is looked at so far from the mark and farther, pixels at 1920 px width."""
ALONG_PX = np.linspace(-1.5, 1.5, 5)
"""Places along the line, pixels, at which the mark's colour is looked at."""
LEAST_ADDED = 16.0
"""Grey levels, over all three colours, that line and mark must add to the ground for the directions to be told."""
MOST_APART_DEG = 15.0
"""Largest angle between the colours that line and mark add to the ground. Of 26 real marks and 16 rendered ones the
largest is 8.7 degrees, of a light blue shirt, which was taken for the mark and left a camera 15 px off, 23.5.
"""


def leave_out_other_mark(image: NDArray[np.uint8], cues: Cues) -> Cues:
    """The cues without the centre mark where the picture (H, W, 3) has another colour there than the halfway line."""
    if cues.mark is None or cues.halfway is None:
        return cues
    unit = image.shape[1] / 1920.0
    across = cues.halfway.line[:2] / np.hypot(*cues.halfway.line[:2])
    points, mark_px = cues.halfway.points_px, cues.mark.point_px
    points = points[np.linalg.norm(points - mark_px, axis=1) > AROUND_PX * unit]
    if len(points) == 0:
        return cues
    beside = max(BESIDE_PX * unit, LEAST_BESIDE_PX) * across
    sides = np.stack([colours_at(image, points + side * beside) for side in (-1.0, 1.0)]).astype(np.float64)
    ground = sides.mean(axis=0)
    line = np.median(colours_at(image, points) - ground, axis=0)
    places = mark_px + ALONG_PX[:, None] * np.array([-across[1], across[0]])
    mark = np.median(colours_at(image, places), axis=0) - np.median(ground, axis=0)
    strength = np.linalg.norm(line), np.linalg.norm(mark)
    if min(strength) < LEAST_ADDED:
        return cues
    cosine = float(line @ mark) / float(np.prod(strength))
    return replace(cues, mark=None) if cosine < np.cos(np.radians(MOST_APART_DEG)) else cues
