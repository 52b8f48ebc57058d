"""Where wide paint lies across a curve, by its two edges at the distance that is known: worn paint is lighter here and
darker there between them, which draws a middle that is taken from its flux aside, and shadows that fall across it do
the same.
"""

from __future__ import annotations

import numpy as np

from circlecal.geometry.projective import Array, Mask
from circlecal.paint.profiles import GrayPicture, sample_profiles, smooth_along

__all__ = ["measure_edge_pairs"]

TAP, BLUR, MOST_AWAY = 1 / 32, 0.06, 1.5
"""Distance of the samples along a profile, standard deviation of the filter for edges, and how far from the curve the
middle is looked for at most; all in widths of the paint.
"""
STRONGEST = 2.0
"""Steps in brightness count as so many times the usual edge of the paint at most: robots have stronger ones."""
TOGETHER = 4.0
"""Standard deviation, in profiles, over which neighbours say together where the edges are."""
LEAST_PEAK, PEAK_SPREADS, LEAST_EDGE = 0.35, 3.0, 0.2
"""Of the usual height of a peak, and of the spread of what is no peak, without which there is no paint; and of the
usual edge, without which one of the two is missing.
"""


def measure_edge_pairs(
    picture: GrayPicture, points: Array, normals: Array, widths: Array, search_px: float
) -> tuple[Array, Mask]:
    """Find the middle between the edges of a light band across each place of a curve.

    With the brightness ``g(x)`` along the normal, smoothed, and the width ``w``, the middle is the ``c`` at which
    ``g'(c - w/2) - g'(c + w/2)`` is largest.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the paint lighter than the surface.
    points, normals : (N, 2) array
        Places in order along the curve, and unit normals.
    widths : (N,) array
        Of the paint, pixels.
    search_px : float
        How far from the curve some of the paint may lie.

    Returns
    -------
    offset_px : (N,) array
        Of the middle along the normal.
    found : (N,) bool
        Whether both edges are there.
    """
    from scipy.ndimage import gaussian_filter1d

    away, half = round(MOST_AWAY / TAP), round(0.5 / TAP)
    reach = away + half + round(3 * BLUR / TAP)
    offsets = TAP * np.arange(-reach, reach + 1.0)
    stretched = np.asarray(widths[:, None] * normals, np.float64)
    profiles = sample_profiles(picture, points, stretched, offsets, repeat_border=True)
    slope = gaussian_filter1d(smooth_along(profiles, 1.0), BLUR / TAP, axis=1, order=1)
    first = reach - away
    rise = slope[:, first - half : first - half + 2 * away + 1]
    fall = -slope[:, first + half : first + half + 2 * away + 1]
    usual = max(float(np.median((rise + fall).max(axis=1))) / 2, 1e-6)
    limits = -STRONGEST * usual, STRONGEST * usual
    rise, fall = (smooth_along(np.clip(edge, *limits), TOGETHER) for edge in (rise, fall))
    score = rise + fall
    spread = 1.4826 * float(np.median(np.abs(score)))
    shift = TAP * np.arange(-away, away + 1)
    score = np.where(np.abs(shift) * widths[:, None] <= search_px + 0.5 * widths[:, None], score, -np.inf)
    rows, best = np.arange(len(points)), score.argmax(axis=1)
    peak = score[rows, best]
    inner = np.clip(best, 1, 2 * away - 1)
    before, here, after = (score[rows, inner + k] for k in (-1, 0, 1))
    is_peak = (best == inner) & np.isfinite(before) & np.isfinite(after)
    with np.errstate(invalid="ignore"):
        turn = np.where(is_peak, 0.5 * (before - after) / np.minimum(before - 2 * here + after, -1e-9), 0.0)
    found = is_peak & (np.minimum(rise, fall)[rows, best] > LEAST_EDGE * usual)
    found &= peak > max(LEAST_PEAK * float(np.median(peak)), PEAK_SPREADS * spread)
    return widths * (shift[best] + TAP * np.clip(turn, -1.0, 1.0)), np.asarray(found, np.bool_)
