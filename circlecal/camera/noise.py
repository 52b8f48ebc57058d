"""What the residuals say of the observations' standard deviations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.covariance import correlation_factor
from circlecal.camera.optimise import Problem, State, reweighted
from circlecal.camera.residuals import CurvePoints
from circlecal.geometry.projective import Array


def inflated(problem: Problem, state: State) -> tuple[CurvePoints, float]:
    """Curves with sigmas grown by the scatter of their residuals and by how much neighbours repeat each other."""
    curves, values = problem.curves, state.residuals[0]
    factor = np.ones(len(values))
    for group in range(len(curves.names)):
        index = np.flatnonzero(curves.group == group)
        ordered = index[np.argsort(state.hidden[0, index], kind="stable")]
        residual = np.clip(values[ordered], -6, 6)
        if len(residual) < 8:
            continue
        scatter = np.sqrt(np.mean(residual**2) * len(residual) / max(len(residual) - 3.0, 1.0))
        factor[index] = max(1.0, scatter) * np.sqrt(correlation_factor(residual))
    scale = float(np.sqrt(np.mean(factor**2))) if len(factor) else 1.0
    return curves.with_sigma(curves.sigma_px * factor), scale


NEIGHBOURS = 15
"""Points along a marking whose median its middle one is compared with."""
OFF_SIGMAS, OFF_PX = 4.0, 0.15
"""Points further from their neighbours, in robust standard deviations and pixels beside, lie on something else."""


def as_measured(
    problem: Problem, state: State, curves: CurvePoints, loss_scale: float
) -> tuple[Problem, State, float, CurvePoints]:
    """The problem with the noise that its own residuals show, and without the points that leave their neighbours.

    Parameters
    ----------
    problem, state : Problem, State
        A fit, of which the first start counts.
    curves : CurvePoints
        The points of ``problem`` with the least standard deviations that they can have.
    loss_scale : float
        Scale of the robust loss, standard deviations.

    Returns
    -------
    problem, state : Problem, State
        The same start, for fewer points.
    scale : float
        By how much the standard deviations have grown.
    curves : CurvePoints
        Those given that are left.
    """
    off_px = state.residuals[0] * problem.curves.sigma_px
    factor, kept = np.ones(len(off_px)), np.ones(len(off_px), dtype=np.bool_)
    for group in range(len(curves.names)):
        index = np.flatnonzero(curves.group == group)
        ordered = index[np.argsort(state.hidden[0, index], kind="stable")]
        if len(ordered) < 2 * NEIGHBOURS:
            continue
        beside = np.abs(off_px[ordered] - _running_median(off_px[ordered], NEIGHBOURS))
        near = beside < OFF_SIGMAS * 1.4826 * np.median(beside) + OFF_PX * problem.model.width / 1920.0
        kept[ordered] = near
        values = (off_px / curves.sigma_px)[ordered[near]]
        scatter = np.sqrt(np.mean(np.clip(values, -6, 6) ** 2))
        factor[index] = max(1.0, scatter * np.sqrt(correlation_factor(values)))
    chosen, rows = np.flatnonzero(kept), np.ones(state.values.shape[1], dtype=np.bool_)
    rows[: len(kept)] = kept
    fewer = replace(state, hidden=state.hidden[:, kept], values=state.values[:, rows], jacobian=state.jacobian[:, rows])
    nearer = replace(problem, curves=problem.curves.select(chosen))
    scale = float(np.sqrt(np.mean(factor**2)))
    least = curves.select(chosen)
    return *reweighted(nearer, fewer, least.sigma_px * factor[chosen], loss_scale), scale, least


def _running_median(values: Array, count: int) -> Array:
    padded = np.pad(values, count // 2, mode="reflect")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, count), axis=-1))
