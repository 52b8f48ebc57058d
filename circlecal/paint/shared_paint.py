"""The paint that several frames of one place have in common, by what it adds to the colour of its surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from circlecal.paint.colour import match_paint

__all__ = ["Colour", "agree_on_paint", "is_coloured"]

AGREEING_SHARE = 0.75
"""Least share of frames that show the paint which they are taken to share."""
GRAY_COSINE = 0.9
"""Cosine to gray of a paint's colour up to which it tells more than brightness: white lines on grass in 35 real
broadcast frames have 0.95 to 1 (0.89 in a blurred one), where the contrast over the noise is the same; blue and yellow
lines on wood below 0.3.
"""
Colour = tuple[float, float, float]
"""Blue, green and red, levels of 8 bits."""
_GRAY = np.full(3, 3**-0.5)


def agree_on_paint(colours: Sequence[Colour], least: int) -> tuple[Colour, int] | None:
    """What the paint adds to blue, green and red of its surface in frames that agree, and how many agree.

    Parameters
    ----------
    colours : sequence of (float, float, float)
        What the paint adds in each frame; their order changes nothing.
    least : int
        Frames that must agree at least.

    Returns
    -------
    tuple or None
        None where too few agree.
    """
    if len(colours) < least:
        return None
    added = np.array(sorted(colours))
    lengths = np.linalg.norm(added, axis=1, keepdims=True)
    middle = np.median(added / np.maximum(lengths, 1e-9), axis=0) * float(np.median(lengths))
    agree = match_paint(added, middle)
    if agree.sum() < max(least, AGREEING_SHARE * len(colours)):
        return None
    blue, green, red = np.round(np.median(added[agree], axis=0), 1).tolist()
    return (blue, green, red), int(agree.sum())


def is_coloured(added_bgr: Colour) -> bool:
    """Whether what a paint adds to its surface tells it better by colour than by brightness."""
    colour = np.asarray(added_bgr)
    return bool(colour @ _GRAY < GRAY_COSINE * np.linalg.norm(colour))
