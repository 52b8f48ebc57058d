"""Words for a predicted standard deviation, so that a reader knows whether 7.6 px is good."""

from __future__ import annotations

import math

WORDS = ((2.0, "excellent"), (5.0, "good"), (15.0, "usable"), (math.inf, "poor"))
"""Largest predicted sigma of each word, pixels at 1920 px width. 2 px is a thin painted line; with 5 px nineteen of
twenty points lie within the 10 px (5 px at 960 px width) at which SoccerNet's camera metric accepts a marking; beyond
15 px, some 0.3 m at the far touchline of a usual broadcast view, the workbench lists a frame as doubtful.
"""
USUAL_WIDTH = 1920.0
SCALE = ", ".join(f"{word} below {limit:g} px" for limit, word in WORDS if math.isfinite(limit)) + ", poor above"
"""The scale in words; pixels at 1920 px width."""


def rate_sigma(sigma_px: float | None, width: int) -> str:
    """The word for the largest predicted standard deviation of a frame.

    Parameters
    ----------
    sigma_px : float or None
        Pixels; None, or not finite, is "unknown".
    width : int
        Width of the frame, pixels.
    """
    if sigma_px is None or not math.isfinite(sigma_px) or width <= 0:
        return "unknown"
    usual = sigma_px * USUAL_WIDTH / width
    return next(word for limit, word in WORDS if usual < limit)
