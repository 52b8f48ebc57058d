"""The heads of all frames of a shot at once: what each frame's paint says, and how the head moved between them.

The normal equations are block-tridiagonal: a frame meets only its neighbours. They are solved forward and backward, as
by the smoother of Rauch, Tung and Striebel (1965), in the form with information matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.geometry.projective import Array

CAUCHY, ROUNDS = 3.0, 3
"""Mahalanobis distance at which a motion counts half, and how often the weights are told anew. In a rendered clip a
motion that rests on 21 corners, of players perhaps, is off by four standard deviations and shakes frames by 0.5 pixels.
"""


@dataclass(frozen=True, slots=True)
class Smoothed:
    """Heads (N, 3) of a shot and their covariances (N, 3, 3)."""

    heads: Array
    covariances: Array


def smooth_heads(
    heads: Array, information: Array, toward: Array, changes: Array, precision: Array, anchor: float = 1e-9
) -> Smoothed:
    """Most likely heads of a chain of frames.

    Minimised is the sum over frames of ``(x - m)^T N (x - m)`` and over neighbours of
    ``(x' - x - d)^T W (x' - x - d)``.

    Parameters
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
    count = len(heads)
    diagonal = information + anchor * np.eye(3)
    right = toward.copy()
    # with x = head + y: y' - y = d - (head' - head)
    gap = changes - np.diff(heads, axis=0)
    pull = (precision @ gap[..., None])[..., 0]
    diagonal[:-1] += precision
    diagonal[1:] += precision
    right[:-1] -= pull
    right[1:] += pull
    left_matrix, left_right = np.empty_like(diagonal), np.empty_like(right)
    left_matrix[0], left_right[0] = diagonal[0], right[0]
    for k in range(1, count):
        gain = np.linalg.solve(left_matrix[k - 1], precision[k - 1]).T
        left_matrix[k] = diagonal[k] - gain @ precision[k - 1]
        left_right[k] = right[k] + gain @ left_right[k - 1]
    moved, covariances = np.empty_like(right), np.empty_like(diagonal)
    inverse = np.linalg.inv(left_matrix[-1])
    moved[-1], covariances[-1] = inverse @ left_right[-1], inverse
    for k in range(count - 2, -1, -1):
        inverse = np.linalg.inv(left_matrix[k])
        back = inverse @ precision[k]
        moved[k] = inverse @ left_right[k] + back @ moved[k + 1]
        covariances[k] = inverse + back @ covariances[k + 1] @ back.T
    return Smoothed(heads + moved, (covariances + np.swapaxes(covariances, 1, 2)) / 2)


def smooth_robustly(
    heads: Array, information: Array, toward: Array, changes: Array, precision: Array, anchor: float = 1e-9
) -> Smoothed:
    """Most likely heads of a chain of frames, where some motions may be those of players.

    Motions that lie further from what the paint of both frames says than their covariance allows get Cauchy's
    weight, and the chain is smoothed again. The arguments are those of :func:`smooth_heads`.
    """
    found = smooth_heads(heads, information, toward, changes, precision, anchor)
    for _ in range(ROUNDS):
        away = np.diff(found.heads, axis=0) - changes
        squared = np.einsum("ni,nij,nj->n", away, precision, away)
        if not (squared > CAUCHY**2).any():
            break
        weight = 1.0 / (1.0 + squared / CAUCHY**2)
        found = smooth_heads(heads, information, toward, changes, precision * weight[:, None, None], anchor)
    return found
