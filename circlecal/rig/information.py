"""What the frames of a camera say of what they share, of any other frame, and of each other."""

from __future__ import annotations

import numpy as np

from circlecal.camera.priors import SharedPrior
from circlecal.geometry.camera_parameters import ANGLES, PARAMETERS, POSITION
from circlecal.geometry.least_squares import invert_normal
from circlecal.geometry.projective import Array
from circlecal.rig.joint import JointProblem, JointState


def frame_information(state: JointState) -> tuple[Array, Array]:
    """What each frame says of the common parameters: precisions (F, C, C) and gradients (F, C), with C = K + Z + T,
    after its own parameters are eliminated.
    """
    solved = np.linalg.solve(state.H_oo, np.concatenate([state.H_oc, state.g_o[..., None]], axis=2))
    precision = state.H_cc - np.swapaxes(state.H_oc, 1, 2) @ solved[..., :-1]
    gradient = state.g_c - (np.swapaxes(state.H_oc, 1, 2) @ solved[..., -1:])[..., 0]
    return precision, gradient


def estimate_common(state: JointState, without: int | None = None) -> tuple[Array, Array]:
    """Mean (C,) and covariance (C, C) of the common parameters from all frames, or from all but one.

    A frame that is fitted under what the others say, linearised at the joint optimum, is fitted as in the joint
    problem: the others' gradient at the optimum is what balances its own.
    """
    precision, gradient = frame_information(state)
    kept = np.arange(len(state.costs)) != (-1 if without is None else without)
    covariance = invert_normal(state.H_common + precision[kept].sum(axis=0))
    mean = state.common - covariance @ (state.g_common + gradient[kept].sum(axis=0))
    return mean, covariance


def shared_prior(
    problem: JointProblem, state: JointState, without: int | None = None, theta: Array | None = None
) -> SharedPrior:
    """What the frames say of the camera; of all frames, or of all but one.

    Parameters
    ----------
    problem, state : JointProblem, JointState
        The joint optimum.
    without : int, optional
        The frame that is left out, and that the prior is for.
    theta : (P,) array, optional
        A camera that points about where the one does that the prior is for. A camera on a tripod moves while it turns:
        without any of both, how much it moved among the frames is part of the covariance.
    """
    mean, covariance = estimate_common(state, without)
    K, Z = len(problem.shared), len(problem.zoomed)
    if problem.is_on_tripod:
        if theta is not None:
            heads = problem.heads_of(theta[None], mean)
        else:
            heads = problem.on_head(state.own if without is None else state.own[[without]], mean)
        heads[:, problem.shared] = mean[:K]
        mean, covariance = _carry_to_heads(problem, mean, covariance, heads)
    deviation = np.zeros(len(PARAMETERS))
    deviation[problem.deviating] = problem.deviation_sd
    return SharedPrior(
        parameters=tuple(PARAMETERS[k] for k in problem.shared),
        zoomed=tuple(PARAMETERS[k] for k in problem.zoomed),
        log_focal=problem.log_focal,
        mean=mean[: K + Z],
        covariance=covariance[: K + Z, : K + Z],
        deviation_sd=deviation[problem.shared],
        lens=problem.lens,
    )


def _carry_to_heads(problem: JointProblem, mean: Array, covariance: Array, heads: Array) -> tuple[Array, Array]:
    """Shared parameters and slopes of the camera itself, mean (K + Z,) and covariance, over heads (F, P)."""
    K, Z = len(problem.shared), len(problem.zoomed)
    model, head, shared = problem.tripod(heads, mean)
    turned = heads.copy()
    found = model.thetas(head, shared)
    turned[:, ANGLES], turned[:, POSITION] = found[:, ANGLES], found[:, POSITION]
    by_head, by_turning = problem.turn(heads, mean)
    rows = np.zeros((len(heads), K + Z, len(mean)))
    rows[:, :K, :K] = by_head[:, problem.shared][:, :, problem.shared]
    rows[:, K:, K : K + Z] = np.eye(Z)
    rows[:, :K, K + Z :] = by_turning[:, problem.shared]
    means = np.concatenate([turned[:, problem.shared], np.tile(mean[K : K + Z], (len(heads), 1))], axis=1)
    total = (rows @ covariance @ np.swapaxes(rows, 1, 2)).mean(axis=0)
    if len(means) > 1:
        total = total + np.cov(means.T, bias=True)
    return means.mean(axis=0), (total + total.T) / 2


def deletion_gains(state: JointState) -> Array:
    """By how much the cost of all the others falls, to first order, where one frame is left out (F,)."""
    precision, gradient = frame_information(state)
    total = state.H_common + precision.sum(axis=0)
    return np.asarray(np.einsum("fc,fcd,fd->f", gradient, invert_normal(total - precision), gradient))
