"""How surely one method is better than another on the same frames: paired bootstrap intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.geometry.projective import Array

RESAMPLES = 4000
SHARE = 0.95  # of the resampled means inside the interval


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean with the bounds of its interval."""

    mean: float
    low: float
    high: float


def bootstrap_mean(values: Array, rng: np.random.Generator) -> Interval:
    """95 % percentile interval of the mean of one value per frame.

    For the paired comparison of two methods give the differences of their scores, frame by frame.

    Parameters
    ----------
    values : (N,) array
        One per frame, at least one.
    rng : numpy.random.Generator
        Source of the resamples.
    """
    if len(values) == 0:
        raise ValueError("an interval needs at least one frame")
    counts = rng.multinomial(len(values), np.full(len(values), 1.0 / len(values)), size=RESAMPLES)
    means = counts @ values / len(values)
    low, high = np.quantile(means, [(1 - SHARE) / 2, (1 + SHARE) / 2])
    return Interval(float(values.mean()), float(low), float(high))
