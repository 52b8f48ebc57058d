"""From starts to the best of the optima that they lead to: all of them with few points, the best with all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import thinned_curves
from circlecal.camera.optimise import COARSE, Problem, State, best_of, continued, minimise, reweighted
from circlecal.camera.options import CameraConfig, realism_of
from circlecal.camera.residuals import curve_residuals, ground_hidden
from circlecal.geometry.camera_parameters import INDEX, project
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array
from circlecal.refusals import refuse

COARSE_POINTS = 48
"""Points per marking while starts or hypotheses are only compared."""
SCREENING_POINTS = 24
"""About so many points of all markings tell which starts of a grid are followed."""
FEW_STARTS = 2
"""More are followed with few points of each marking, and the best of them again with all."""
WEAK_SIGMA_PX = 25.0
"""Where the closed forms leave the field around the circle less certain than this (at 1920 px width), the grid is
followed too.
"""


def best_fit(problem: Problem, closed: Array, grid: Array, short: bool, config: CameraConfig, side: str) -> State:
    """The optima that starts lead to, coarsely, the best first: of the closed forms, and where they are missing or
    leave the field uncertain, of the grid too.

    Parameters
    ----------
    problem : Problem
        What the camera has to explain.
    closed, grid : (K, P), (L, P) arrays
        Starts.
    short : bool
        Whether so little of the circle is seen that there are local minima: the grid is always followed.
    config, side : CameraConfig, str
        Options, and the side of the field from which the camera looks.

    Raises
    ------
    EstimationError
        ``no_camera`` where no start leads to an upright camera above the ground.
    """
    if len(closed) and not short:
        state = _follow(problem, closed, config, side)
        covariance = posterior_covariance(state.normal[0], problem.priors.sd)
        rim = problem.priors.center_m + problem.model.surface.reference_m * np.array(
            [[2.0, 0.0], [-2.0, 0.0], [0.0, -2.0]]
        )
        sigma, _ = project(state.theta[:1], rim[None], problem.model).sigma(covariance)
        if sigma.max() < WEAK_SIGMA_PX * problem.model.width / 1920.0:
            return state
        closed = state.theta[:2]
    return _follow(problem, np.concatenate([closed, _screened(problem, grid, config.starts)]), config, side)


def _follow(problem: Problem, starts: Array, config: CameraConfig, side: str) -> State:
    """Optimise from every start with a wide, then with the final loss; the best first, those on the stated side
    before the others.
    """
    if len(starts) == 0:
        raise refuse("camera", "no_camera")
    few = problem if len(starts) <= FEW_STARTS else _with_few_points(problem, config)
    hidden = ground_hidden(few.curves, starts, problem.model)
    wide = minimise(few, starts, 100.0 * config.loss_scale, min(30, config.iterations), hidden, COARSE)
    chosen = best_of(wide, max(2, min(len(starts), 3 * config.starts // 4)))
    _, state = reweighted(few, chosen, few.curves.sigma_px, config.loss_scale)
    state = continued(few, state, config.loss_scale, config.iterations, COARSE)
    # a camera hanging upside down sees a circle and a line just as well
    above = (state.theta[:, INDEX["z"]] < 0) & (np.sin(state.theta[:, INDEX["tilt"]]) > 0)
    if not above.any():
        raise refuse("camera", "no_camera")
    offset = state.theta[:, 4:6] - problem.priors.center_m
    stated = offset @ np.array(SIDES[side]) >= 0
    # the side decides between the two cameras of the turned field, not against what was seen
    stated &= above & (state.cost < state.cost[above].min() + config.loss_scale**2)
    kept = above & stated if stated.any() else above
    state = best_of(state.select(kept), int(kept.sum()))
    if few is problem:
        return state
    best = state.theta[:FEW_STARTS]
    hidden = ground_hidden(problem.curves, best, problem.model)
    return best_of(minimise(problem, best, config.loss_scale, config.iterations, hidden, COARSE), len(best))


def _with_few_points(problem: Problem, config: CameraConfig) -> Problem:
    order = np.arange(len(problem.curves.points_px))
    least_px = realism_of(config, problem.model.width).model_sigma_px
    return replace(problem, curves=thinned_curves(problem.curves, order, COARSE_POINTS, least_px))


def _screened(problem: Problem, grid: Array, count: int) -> Array:
    """The starts of a grid (L, P) that already lie nearest to what was seen, at most ``count``."""
    if len(grid) <= count:
        return grid
    stride = max(1, len(problem.curves.points_px) // SCREENING_POINTS)
    few = problem.curves.select(np.arange(0, len(problem.curves.points_px), stride))
    candidates = grid.copy()
    fixed = problem.priors.sd == 0
    candidates[:, fixed] = problem.priors.mean[fixed]
    hidden = ground_hidden(few, candidates, problem.model)
    seen = curve_residuals(few, candidates, hidden, problem.model, 0, problem.points)
    on_curves = np.abs(seen.values[:, : hidden.shape[1]]) * few.sigma_px
    offsets = seen.values[:, hidden.shape[1] :].reshape(len(candidates), -1, 2) * problem.points.sigma_px[:, None]
    distance = np.concatenate([on_curves, np.linalg.norm(offsets, axis=-1)], axis=1)
    penalty = np.sum(problem.priors.residuals(candidates)[0] ** 2, axis=1)
    score = np.mean(np.minimum(distance, 200.0), axis=1) + 2.0 * penalty
    return grid[np.argsort(score, kind="stable")[:count]]
