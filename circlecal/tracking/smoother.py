"""The heads of all frames of a shot at once: what each frame's paint says, how the head moved, and that it has inertia.

A frame meets only its neighbours, so the normal equations are banded, and are solved by Cholesky's factorisation of the
band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.ndimage import uniform_filter1d

from circlecal.geometry.projective import Array

CAUCHY, ROUNDS = 3.0, 3
"""Mahalanobis distance at which a motion, or a change of the acceleration, counts half, and how often the weights are
told anew. In a rendered clip a motion that rests on 21 corners, of players perhaps, is off by four standard deviations
and shakes frames by 0.5 pixels.
"""
JERK = np.array([-1.0, 3.0, -3.0, 1.0])
"""Third difference of four neighbours: the change of the acceleration."""
LEAST_JERK_SHARE = 0.3
"""Least variance of the change of the acceleration, as a share of what the noise of the measured motions alone makes of
it: noise that is faster than some five frames is told from slower pans. Over three rendered clips the median jitter
falls from 0.022 to 0.044 px without it to 0.013 to 0.017; with 0.1 fast pans lag, and their jitter is 1.2 times that.
"""
JERK_FRAMES, CLEAR_SHARE = 7, 1.5
"""Frames about one from which the head's own change of acceleration is told, and by how many times that of the noise
their mean square must be exceeded: a zoom that begins at once must not be smoothed. Told from the whole shot, 90 % of
the jitter lay below 0.18 px in a clip of zooms, so 0.09, and 0.11 without inertia.
"""
LEAST_INFORMATION = 1e-3
"""Of a frame that shows nothing, so that its root can be taken."""
CHI2_MEDIAN = 0.455
"""Median of chi-square with one degree of freedom."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Frames of a shot that follow each other.

    Attributes
    ----------
    heads : (N, 3) array
        Any heads near the solution: the information refers to them.
    information : (N, 3, 3) array
        N, of what each frame shows; 0 where it shows nothing.
    toward : (N, 3) array
        ``N (m - head)``, the pull of what each frame shows.
    changes, precision : (N - 1, 3), (N - 1, 3, 3) arrays
        Motions d between neighbours and their information W; 0 where the motion is not known.
    anchor : float
        Share of a unit of information about ``heads`` that keeps frames without any where they are.
    """

    heads: Array
    information: Array
    toward: Array
    changes: Array
    precision: Array
    anchor: float = 1e-9

    def solve(self, steadiness: Array, weight: Array | None = None) -> Solution:
        """Most likely heads.

        Minimised is the sum over frames of ``(x - m)^T N (x - m)``, over neighbours of
        ``(x' - x - d)^T W (x' - x - d)``, and over four frames in a row of ``S (x''' - 3 x'' + 3 x' - x)^2`` for each
        component.

        Parameters
        ----------
        steadiness : (N - 3, 3) array
            S, what is known of the third differences; an empty one where nothing is.
        weight : (N - 1,) array, optional
            Share of its information that each motion is left; all of it without.
        """
        precision = self.precision if weight is None else self.precision * weight[:, None, None]
        count = len(self.heads)
        # blocks[d, k] couples frames k and k + d
        blocks = np.zeros((len(JERK), count, 3, 3))
        blocks[0] = self.information + self.anchor * np.eye(3)
        right = self.toward.copy()
        # with x = head + y: y' - y = d - (head' - head)
        pull = (precision @ (self.changes - np.diff(self.heads, axis=0))[..., None])[..., 0]
        blocks[0, :-1] += precision
        blocks[0, 1:] += precision
        blocks[1, :-1] -= precision
        right[:-1] -= pull
        right[1:] += pull
        if len(steadiness):
            jerk = steadiness * np.diff(self.heads, 3, axis=0)
            last, axes = len(steadiness), np.arange(3)
            for a, first in enumerate(JERK):
                right[a : a + last] -= first * jerk
                for b in range(a, len(JERK)):
                    blocks[b - a, a : a + last, axes, axes] += first * JERK[b] * steadiness.T
        solution = Solution(self.heads, cholesky_banded(_to_band(blocks), check_finite=False))
        return Solution(self.heads + solution.follow(right[..., None])[..., 0], solution.factor)


@dataclass(frozen=True, slots=True)
class Solution:
    """Heads (N, 3) of a chain, and the factor (U + 1, 3 N) of its banded normal equations."""

    heads: Array
    factor: Array

    @property
    def covariances(self) -> Array:
        """Covariances (N, 3, 3) of the heads, where frames and motions are off by what their information says."""
        return _make_symmetric(_blocks_of_heads(_invert_factor(self.factor)))

    def follow(self, pull: Array) -> Array:
        """How the heads follow (N, 3, K) what pulls what the frames show (N, 3, K)."""
        columns = pull.reshape(3 * len(self.heads), -1)
        return np.asarray(cho_solve_banded((self.factor, False), columns, check_finite=False)).reshape(pull.shape)


@dataclass(frozen=True, slots=True)
class Smoothed:
    """Heads (N, 3) of a shot, their covariances (N, 3, 3), and how they follow what all of them share (N, 3, K)."""

    heads: Array
    covariances: Array
    by_common: Array


def _invert_factor(factor: Array) -> Array:
    """Inverse (3 N, 3 N) of the normal equations that have this factor (U + 1, 3 N)."""
    return np.asarray(cho_solve_banded((factor, False), np.eye(factor.shape[1]), overwrite_b=True, check_finite=False))


def _blocks_of_heads(inverse: Array) -> Array:
    """Blocks (N, 3, 3) on the diagonal of a matrix (3 N, 3 N)."""
    count = len(inverse) // 3
    at = np.arange(count)
    return np.asarray(inverse.reshape(count, 3, count, 3)[at, :, at])


def _make_symmetric(covariances: Array) -> Array:
    return np.asarray((covariances + np.swapaxes(covariances, 1, 2)) / 2)


def _spread_chain(factor: Array, information: Array, spread: float) -> Array:
    """Covariances (N, 3, 3) of the heads, where what frames show has another variance than the information says, and
    may be off alike in all of them.

    With A the normal equations and N the information of the frames, noise of covariance s N^-1 moves the heads by
    ``A^-1 N``, so that ``A^-1 - (1 - s) A^-1 N A^-1`` is left of it. Where all frames are off by the same number of
    their standard deviations, they are moved by ``A^-1 N^(1/2)``.
    """
    count = factor.shape[1] // 3
    inverse = _invert_factor(factor)
    by_frame = inverse.reshape(3 * count, count, 3)
    moved = np.einsum("kni,nij->knj", by_frame, information).reshape(3 * count, 3 * count)
    root = np.linalg.cholesky(information + LEAST_INFORMATION * np.eye(3))
    alike = np.einsum("kni,nij->kj", by_frame, root).reshape(count, 3, 3)
    by_paint = np.einsum("nik,njk->nij", moved.reshape(count, 3, -1), inverse.reshape(count, 3, -1))
    left = _blocks_of_heads(inverse) - (1.0 - spread) * by_paint
    return _make_symmetric(left + spread * alike @ np.swapaxes(alike, 1, 2))


def _to_band(blocks: Array) -> Array:
    """Upper band (U + 1, 3 N) of a symmetric matrix, in LAPACK's order, of blocks (D, N, 3, 3) on and above its
    diagonal.
    """
    reach, count = blocks.shape[:2]
    widest = 3 * reach - 1
    band = np.zeros((widest + 1, count, 3))
    for d in range(reach):
        for i in range(3):
            for j in range(i if d == 0 else 0, 3):
                band[widest - (3 * d + j - i), d:, j] = blocks[d, : count - d, i, j]
    return band.reshape(widest + 1, 3 * count)


def smooth_robustly(chain: Chain, pull: Array, spread: float | None = None) -> Smoothed:
    """Most likely heads of a chain of frames, where some motions may be those of players, of a head with inertia.

    Motions that lie further from what the paint of both frames says than their covariance allows get Cauchy's weight,
    as do changes of the acceleration where a pan begins or ends, and the chain is smoothed again.

    Parameters
    ----------
    chain : Chain
        The frames.
    pull : (N, 3, K) array
        How what each frame shows changes ``toward`` with the parameters that all frames share.
    spread : float, optional
        Variance of what the frames show, as a share of what ``information`` has. All of it counts twice: as noise of
        each frame, and as what frames repeat of paint, surface and lens, which no number of them lowers. Without it
        the covariances are those of ``information``, all of which is noise.
    """
    found = chain.solve(np.zeros((0, 3)))
    steadiness = _estimate_steadiness(found.heads, chain.precision)
    for _ in range(ROUNDS):
        away = np.diff(found.heads, axis=0) - chain.changes
        squared = np.einsum("ni,nij,nj->n", away, chain.precision, away)
        jerk = steadiness * np.diff(found.heads, 3, axis=0) ** 2
        found = chain.solve(steadiness / (1.0 + jerk / CAUCHY**2), 1.0 / (1.0 + squared / CAUCHY**2))
    covariances = found.covariances if spread is None else _spread_chain(found.factor, chain.information, spread)
    return Smoothed(found.heads, covariances, found.follow(pull))


def _estimate_steadiness(heads: Array, precision: Array) -> Array:
    """Information (N - 3, 3) about the third differences of a chain's heads (N, 3).

    Their variance less what the noise of the motions, with information (N - 1, 3, 3), makes of it is that of the head.
    A third difference is a second difference of motions: ``n = c + 4 c' + c''``.
    """
    if len(heads) < len(JERK):
        return np.zeros((0, 3))
    variance = 1.0 / np.maximum(np.diagonal(precision, axis1=1, axis2=2), 1e-9)
    noise = variance[:-2] + 4.0 * variance[1:-1] + variance[2:]
    third = np.diff(heads, 3, axis=0) ** 2
    # motions may be better than they say
    noise *= np.clip(np.median(third, axis=0) / CHI2_MEDIAN / np.median(noise, axis=0), 1e-3, 1.0)
    around = uniform_filter1d(third, JERK_FRAMES, axis=0, mode="nearest")
    return np.asarray(1.0 / (np.maximum(around - CLEAR_SHARE * noise, 0.0) + LEAST_JERK_SHARE * noise))
