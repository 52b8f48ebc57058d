"""Which frames were taken by one camera: groups of estimated positions, each with its covariance.

A seed is as good as what it makes likely: precise positions that agree count for much, vague ones for little, and a
precise one that agrees with nobody for nothing. So a wrong camera neither founds a group nor joins one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from circlecal.geometry.projective import Array

_SEEDS = 200
_ROUNDS = 5
"""The best determined positions are tried as the middle of a group, and moved to the mean of its members so often."""
_LIMIT = float(chdtri(3, 1e-3))
"""Squared Mahalanobis distance within which positions agree."""
_ANYWHERE = 1.0 / (300.0 * 300.0 * 60.0)
"""Density of a position of which nothing is known, per cubic metre."""
_TURN = np.array([-1.0, -1.0, 1.0])


def group_positions(
    positions: Array, covariances: Array, least_members: int = 2
) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
    """Group frames by the position of their cameras, the largest group first.

    Parameters
    ----------
    positions : (N, 3) array
        Metres. A field looks the same turned by 180 degrees, so a position and the turned one agree.
    covariances : (N, 3, 3) array
        Of the positions.
    least_members : int
        Smaller groups are none.

    Returns
    -------
    (N,) int array
        Number of the group; -1 for none.
    (N,) bool array
        Whether the position has to be turned to agree with most of its group.
    """
    groups = np.full(len(positions), -1)
    turned = np.zeros(len(positions), dtype=bool)
    centers: list[tuple[Array, Array]] = []
    open_frames = np.arange(len(positions))
    while len(open_frames) >= least_members:
        center, covariance, agree = _find_largest_group(positions[open_frames], covariances[open_frames])
        if agree.sum() < least_members:
            break
        centers.append((center, covariance))
        open_frames = open_frames[~agree]
    if not centers:
        return groups, turned
    # a vague position may agree with several cameras: the one under which it is most likely has it
    gains = [_gains(positions, covariances, center, covariance) for center, covariance in centers]
    gain = np.stack([g for g, _ in gains], axis=1)
    best = np.argmax(gain, axis=1)
    found = np.take_along_axis(gain, best[:, None], axis=1)[:, 0] > 0
    turned = np.take_along_axis(np.stack([t for _, t in gains], axis=1), best[:, None], axis=1)[:, 0] & found
    sizes = np.bincount(best[found], minlength=len(centers))
    order = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= least_members]
    for number, k in enumerate(order):
        own = found & (best == k)
        groups[own] = number
        if 2 * np.count_nonzero(turned[own]) > sizes[k]:  # the seed was one of few that see the field turned
            turned[own] = ~turned[own]
    return groups, turned & (groups >= 0)


def _find_largest_group(positions: Array, covariances: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fused position of the group with the best seed, its covariance, and who agrees with it (N,)."""
    volume = np.linalg.slogdet(covariances)[1]
    seeds = np.argsort(volume, kind="stable")[:_SEEDS]
    scores = [np.maximum(_gains(positions, covariances, positions[s], covariances[s])[0], 0.0).sum() for s in seeds]
    seed = seeds[int(np.argmax(scores))]
    center, covariance = positions[seed], covariances[seed]
    gain, turned = _gains(positions, covariances, center, covariance)
    for _ in range(_ROUNDS):
        agree = gain > 0
        precision = np.linalg.inv(covariances[agree])
        seen = np.where(turned[agree, None], positions[agree] * _TURN, positions[agree])
        precision = np.where(turned[agree, None, None], precision * np.outer(_TURN, _TURN), precision)
        covariance = np.linalg.inv(precision.sum(axis=0))
        center = covariance @ np.einsum("nij,nj->i", precision, seen)
        gain, turned = _gains(positions, covariances, center, covariance)
        if np.array_equal(gain > 0, agree) or not (gain > 0).any():
            break
    return center, covariance, gain > 0


def _gains(positions: Array, covariances: Array, center: Array, covariance: Array) -> tuple[Array, NDArray[np.bool_]]:
    """How much likelier positions (N,) are at a camera than anywhere, as a logarithm (-inf where they disagree), and
    whether they are turned.
    """
    best = np.full(len(positions), -np.inf)
    turned = np.zeros(len(positions), dtype=bool)
    for turn in (np.ones(3), _TURN):
        total = covariances * np.outer(turn, turn) + covariance
        offset = positions * turn - center
        distance = np.einsum("ni,ni->n", offset, np.linalg.solve(total, offset[..., None])[..., 0])
        density = -0.5 * (distance + np.linalg.slogdet(total)[1] + 3 * np.log(2 * np.pi))
        gain = np.where(distance < _LIMIT, np.maximum(density - np.log(_ANYWHERE), 1e-6), -np.inf)
        turned = np.where(gain > best, bool(turn[0] < 0), turned)
        best = np.maximum(best, gain)
    return best, turned
