"""What the residuals of a fit say of the observations' standard deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from circlecal.camera.covariance import correlation_factor
from circlecal.camera.problem import Problem, State, reweight
from circlecal.camera.residuals import CurvePoints
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Indices, Mask

LARGEST_RESIDUAL = 6.0
"""Standard deviations at which a residual is cut off before its scatter is measured: the scale of the robust loss,
beyond which a point is no measurement of the marking.
"""
FEWEST_POINTS, PLACED_BY_FIT = 8, 3.0
"""Of a marking, points that can tell their scatter; and how many of them the fit takes to place the marking."""
PLACED_CIRCLE, PLACED_LINE = 5.0, 2.0
"""Constraints of an ellipse and of a straight line: so many points that do not repeat each other lie on it anyway."""
MOST_TAKEN = 0.5
"""Largest share of such points that the fit is thought to take: of fewer, scatter tells nothing."""
NEIGHBOURS = 15
"""Points along a marking whose median its middle one is compared with: a sixteenth of a marking of 240 points."""
OFF_SIGMAS, OFF_PX = 4.0, 0.15
"""Points further from their neighbours than so many robust standard deviations and, beside them, pixels at 1920 px
width lie on something else: of 10,000 normal residuals less than one.
"""


def rescale_sigmas(problem: Problem, state: State) -> tuple[Problem, State, float]:
    """Standard deviations grown by the scatter of their residuals and by how much neighbours repeat each other.

    Parameters
    ----------
    problem, state : Problem, State
        A fit, of which the first start counts.

    Returns
    -------
    problem, state : Problem, State
        With the new standard deviations.
    scale : float
        By how much they have grown, root mean square.
    """
    curves = problem.curves
    factor = np.ones(len(curves.sigma_px))
    for ordered, scatter, repetition in _scatter_of_markings(curves, state):
        factor[ordered] = max(1.0, scatter) * repetition
    scale = float(np.sqrt(np.mean(factor**2))) if len(factor) else 1.0
    return *reweight(problem, state, curves.sigma_px * factor), scale


def noise_of_misfit(problem: Problem, state: State, given_px: Array) -> tuple[Problem, State]:
    """Given standard deviations (N,), grown only where residuals and their correlation show more than these.

    Neighbours that repeat each other's small residuals are no noise beyond what was given, which holds them already;
    by :func:`rescale_sigmas` they are, which is careful for a result and hides from a comparison what is explained.
    """
    problem, state = reweight(problem, state, given_px)
    factor = np.ones(len(given_px))
    for ordered, scatter, repetition in _scatter_of_markings(problem.curves, state):
        factor[ordered] = max(1.0, scatter * repetition)
    return reweight(problem, state, given_px * factor)


def _scatter_of_markings(curves: CurvePoints, state: State) -> Iterator[tuple[Indices, float, float]]:
    """Of each marking with enough points: their indices in order, how many standard deviations their residuals scatter
    by, and how many times that counts since neighbours repeat each other.
    """
    for ordered in _along_markings(curves, state):
        residual = np.clip(state.residuals[0, ordered], -LARGEST_RESIDUAL, LARGEST_RESIDUAL)
        if len(residual) >= FEWEST_POINTS:
            power = np.mean(residual**2) * len(residual) / max(len(residual) - PLACED_BY_FIT, 1.0)
            yield ordered, float(np.sqrt(power)), float(np.sqrt(correlation_factor(residual)))


def rescale_and_reject(problem: Problem, state: State, least: CurvePoints) -> tuple[Problem, State, float, CurvePoints]:
    """The noise that the residuals show, without the points that leave their neighbours.

    Of n points each of which repeats k others, n / k tell something of their own, and the fit passes near as many of
    them as the marking has constraints p: the mean square of the residuals is that of the errors times 1 - p k / n.

    Parameters
    ----------
    problem, state : Problem, State
        A fit, of which the first start counts.
    least : CurvePoints
        The points of ``problem`` with the least standard deviations that they can have.

    Returns
    -------
    problem, state : Problem, State
        With fewer points and the new standard deviations.
    scale : float
        By how much these are greater than the least, root mean square.
    least : CurvePoints
        Those given that are left.
    """
    off_px = state.residuals[0] * problem.curves.sigma_px
    markings = _along_markings(least, state)
    factor, kept = np.ones(len(off_px)), _lie_near(problem, off_px, markings)
    for ordered in markings:
        if len(ordered) < 2 * NEIGHBOURS:
            continue
        values = (off_px / least.sigma_px)[ordered[kept[ordered]]]
        repeated, placed = correlation_factor(values), PLACED_LINE if least.straight[ordered[0]] else PLACED_CIRCLE
        left = 1.0 - min(placed * repeated / len(values), MOST_TAKEN)
        power = np.mean(np.clip(values, -LARGEST_RESIDUAL, LARGEST_RESIDUAL) ** 2) / left
        factor[ordered] = max(1.0, float(np.sqrt(power * repeated)))
    nearer, fewer, chosen = _keep_points(problem, state, kept)
    scale = float(np.sqrt(np.mean(factor**2)))
    least = least.select(chosen)
    return *reweight(nearer, fewer, least.sigma_px * factor[chosen]), scale, least


def leave_out_stray_points(problem: Problem, state: State) -> tuple[Problem, State, Indices]:
    """The problem without the points that leave their neighbours, and the indices of those that are left.

    It is the distance from the neighbours that counts: a camera that is wrong moves them all.
    """
    off_px = state.residuals[0] * problem.curves.sigma_px
    return _keep_points(problem, state, _lie_near(problem, off_px, _along_markings(problem.curves, state)))


def _lie_near(problem: Problem, off_px: Array, markings: list[Indices]) -> Mask:
    """Which points (N,), so far off, lie as near to their neighbours along their markings as most do; all of a marking
    that has too few.
    """
    kept = np.ones(len(off_px), dtype=np.bool_)
    for ordered in markings:
        if len(ordered) >= 2 * NEIGHBOURS:
            beside = np.abs(off_px[ordered] - _running_median(off_px[ordered], NEIGHBOURS))
            near_px = OFF_SIGMAS * 1.4826 * float(median_of_rows(beside)) + OFF_PX * problem.model.width / 1920.0
            kept[ordered] = beside < near_px
    return kept


def _keep_points(problem: Problem, state: State, kept: Mask) -> tuple[Problem, State, Indices]:
    chosen, rows = np.flatnonzero(kept), np.ones(state.values.shape[1], dtype=np.bool_)
    rows[: len(kept)] = kept
    fewer = replace(state, feet=state.feet[:, kept], values=state.values[:, rows], jacobian=state.jacobian[:, rows])
    return replace(problem, curves=problem.curves.select(chosen)), fewer, chosen


def _along_markings(curves: CurvePoints, state: State) -> list[Indices]:
    """Indices of the points of each marking, ordered along it."""
    groups = [np.flatnonzero(curves.group == group) for group in range(len(curves.keys))]
    return [index[np.argsort(state.feet[0, index], kind="stable")] for index in groups]


def _running_median(values: Array, count: int) -> Array:
    padded = np.pad(values, count // 2, mode="reflect")
    return median_of_rows(np.lib.stride_tricks.sliding_window_view(padded, count).T)
