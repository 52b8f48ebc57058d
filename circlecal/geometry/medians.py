"""Medians of some hundred values: ``np.median`` takes five to ten times as long over its checks as over the values,
``np.quantile`` twenty times.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array


def upper_median(values: NDArray[np.floating[Any]]) -> float:
    """The median, or the greater one of the two values in the middle."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def median_of_rows(rows: NDArray[np.floating[Any]]) -> Array:
    """Medians (...) over the rows (K, ...) of finite numbers, as ``np.median`` has them; nan of no rows."""
    half = len(rows) // 2
    if len(rows) == 0:
        return np.full(rows.shape[1:], np.nan)
    if len(rows) % 2:
        return np.asarray(np.partition(rows, half, axis=0)[half])
    ordered = np.partition(rows, (half - 1, half), axis=0)
    return np.asarray(0.5 * (ordered[half - 1] + ordered[half]))


def quantile(values: Array, share: float) -> float:
    """What a share of the values (N,) lies below, linear between the two next to it, as ``np.quantile`` has it."""
    place = share * (len(values) - 1)
    low = int(place)
    high = min(low + 1, len(values) - 1)
    ordered = np.partition(values, (low, high))
    return float(ordered[low] + (place - low) * (ordered[high] - ordered[low]))
