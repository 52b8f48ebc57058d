"""When pictures are looked at once more because no tripod that was found explains them: another camera took them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

import numpy as np

MOST_OF_STRETCH, MOST_STRETCHES = 6, 4
"""Pictures of a stretch that are calibrated alone, of which three that agree make a camera, and stretches in which this
is done, the longest ones. Of a camera behind the goal two of four pictures were calibrated.
"""


def times_of_others(is_left: Mapping[str, bool], period_s: float) -> list[float]:
    """Growing times, seconds, at which the stretches of a clip that no tripod explains are looked at, spread evenly
    over each and, within the clip, a little beyond its first and last picture.

    Parameters
    ----------
    is_left : mapping
        Whether a picture, which its time names, is not explained and shows enough of a playing surface.
    period_s : float
        Time between two pictures of the clip, seconds: no picture is looked at twice.
    """
    names = sorted(is_left, key=float)
    if len(names) < 2:
        return []
    start, end = float(names[0]), float(names[-1])
    beyond = (end - start) / (len(names) - 1) / 4.0
    stretches = [[float(name) for name in group] for left, group in groupby(names, is_left.__getitem__) if left]
    times: list[float] = []
    for stretch in sorted(stretches, key=len, reverse=True)[:MOST_STRETCHES]:
        first, last = max(stretch[0] - beyond, start), min(stretch[-1] + beyond, end)
        count = min(MOST_OF_STRETCH, 1 + int((last - first) / period_s))
        times += np.linspace(first, last, count).tolist()
    return sorted(times)
