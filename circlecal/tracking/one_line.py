"""Which places along a marking show one line, where another one runs beside it."""

from __future__ import annotations

import numpy as np

from circlecal.geometry.projective import Array, Indices, Mask

JUMP_PX, LEAST_ALIKE = 2.5, 0.75
"""Step between neighbouring places along a thin marking, pixels at 1920 px width, that no camera makes, and share of
the places on one side of such steps below which a marking is two things: in a real clip 45 places of a far touchline
and 40 on the foot of the boards 6 px behind it.
"""


def keep_one_line(on: Mask, offset_px: Array, marking: Indices, jump_px: float, count: int) -> tuple[Mask, Mask]:
    """Which places (M,) with paint lie on the one line of their marking, and which markings (K,) are two lines.

    Along a marking the paint's offsets from the prediction change slowly, whatever is wrong with the camera. The sum of
    all steps up to a place tells on which line it lies.
    """
    at = np.flatnonzero(on)
    is_double = np.zeros(count, np.bool_)
    if len(at) < 2:
        return on, is_double
    step = np.diff(offset_px[at])
    is_jump = (np.abs(step) > jump_px) & (np.diff(marking[at]) == 0)
    level = np.concatenate([[0.0], np.cumsum(np.where(is_jump, step, 0.0))])
    kept = on.copy()
    for k in np.unique(marking[at[1:]][is_jump]):
        own = np.flatnonzero(marking[at] == k)
        alike = np.abs(level[own][:, None] - level[own]) < jump_px
        best = alike[int(np.argmax(alike.sum(axis=1)))]
        is_double[k] = best.mean() < LEAST_ALIKE
        kept[at[own]] = False if is_double[k] else best
    return kept, is_double
