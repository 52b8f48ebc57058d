"""From starts to the best of the optima that they lead to: all of them with few points, the best with all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import thin_curves
from circlecal.camera.options import CameraConfig, noise_model
from circlecal.camera.problem import COARSE, FAR_LOSS, Problem, State, minimise, resume, with_loss
from circlecal.camera.residuals import curve_residuals, ground_feet
from circlecal.errors import EstimationError
from circlecal.geometry.camera_parameters import INDEX, project
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array
from circlecal.refusals import refuse

COARSE_POINTS = 48
"""Points per marking while starts or hypotheses are only compared: a fifth of what the result is fitted to."""
SCREENING_POINTS = 24
"""About so many points of all markings tell which starts of a grid are followed."""
SCREENING_CAP_PX, PENALTY_PX = 200.0, 2.0
"""Distance of a point at which a start is merely wrong, and how many pixels of mean distance one unit of the priors'
chi-square stands for.
"""
FEW_STARTS = 2
"""More are followed with few points of each marking, and the best of them again with all."""
COARSE_ITERATIONS = 30
"""Most steps under the wide loss, whose optimum is a start again."""
WEAK_SIGMA_PX = 25.0
"""Where the closed forms leave the field around the circle less certain than this (at 1920 px width), the grid is
followed too.
"""
BETTER = 1.0
"""Chi-square by which another optimum must cost less to be a better one."""
STRANGE = 0.5
"""Share of the loss's scale, standard deviations, from which on a point asks for another optimum: three of them, which
few right clicks exceed. Of 293 clicks on real frames that were moved by 30 px 8 bent the camera by 20 px and 3 sigma
without that, 4 with it.
"""
SEVERAL, MOST_POINTS = 2, 40
"""Outliers among points of known field position from which on each of these is left out in turn: a single one is the
wrong one itself. Of 118 simulated frames with some 13 keypoints, three of them wrong, 115 are calibrated with that and
107 without. And up to how many points there is the time for it.
"""
RIM_RADII = np.array([[2.0, 0.0], [-2.0, 0.0], [0.0, -2.0]])
"""Where that is asked, in radii about the middle of what was seen: to both sides and on the far one."""


@dataclass(frozen=True, slots=True)
class Starts:
    """Starts of the optimiser.

    Attributes
    ----------
    closed : (K, P) array
        Of closed forms, or cameras that are known: followed first.
    grid : (L, P) array
        All around: the best of them are followed where the others are missing or weak.
    follow_grid : bool
        Whether the grid is followed in any case: there are local minima.
    """

    closed: Array
    grid: Array
    follow_grid: bool = False

    def continue_from(self, state: State) -> Starts:
        """The starts once some have been followed: from where they led, too."""
        return replace(self, closed=np.concatenate([state.theta[:FEW_STARTS], self.closed]))


def find_optima(problem: Problem, starts: Starts, config: CameraConfig, side: str) -> State:
    """The optima that starts lead to, coarsely, the best first.

    Parameters
    ----------
    problem : Problem
        What the camera has to explain.
    starts : Starts
        From where.
    config, side : CameraConfig, str
        Options, and the side of the field from which the camera looks.

    Raises
    ------
    EstimationError
        ``no_camera`` where no start leads to an upright camera above the ground.
    """
    closed = starts.closed
    if len(closed) and not starts.follow_grid:
        state = _follow(problem, closed, config, side)
        if len(starts.grid) == 0:  # nothing else to follow
            return state
        covariance = posterior_covariance(state.normal[0], problem.priors.sd)
        rim = problem.priors.center_m + problem.model.surface.reference_m * RIM_RADII
        sigma, _ = project(state.theta[:1], rim[None], problem.model).sigma(covariance)
        if sigma.max() < WEAK_SIGMA_PX * problem.model.width / 1920.0:
            return state
        closed = state.theta[:FEW_STARTS]
    return _follow(problem, np.concatenate([closed, _screen(problem, starts.grid, config.starts)]), config, side)


def leave_local_optimum(problem: Problem, state: State, config: CameraConfig, side: str) -> State:
    """The optima, or the better one to which the camera leads that explains all but one marking.

    Under a loss that forgets outliers a wrongly clicked point bends the camera to itself, and the right ones of other
    markings are taken for outliers. Without the marking of that point the camera goes back, and stays there with it.

    Parameters
    ----------
    problem, state : Problem, State
        The optima (B, P) that were found, the best first; of a few points, such as people click.
    config, side : CameraConfig, str
        As for :func:`find_optima`.
    """
    rule = replace(COARSE, iterations=config.iterations)
    for others in _leave_out_each(problem, state):
        try:
            start = _follow(others, state.theta[:1], config, side).theta[:1]
        except EstimationError:
            continue
        again = minimise(problem, start, rule, ground_feet(problem.curves, start, problem.model))
        if again.cost[0] < state.cost[0] - BETTER:
            state = again
    return state


def _leave_out_each(problem: Problem, state: State) -> Iterator[Problem]:
    """The problem without each marking that has an outlier; and where several points of known field position are
    outliers, without each of these points: the wrong one may be the one that the camera passes through.
    """
    curves, points = problem.curves, problem.points
    is_outlier = np.abs(state.values[0]) > STRANGE * problem.loss_scale
    on_curves, at_points = is_outlier[: len(curves.group)], is_outlier[len(curves.group) :].reshape(-1, 2).any(axis=1)
    for key in dict.fromkeys(curves.keys[group] for group in np.unique(curves.group[on_curves])):
        is_other = np.array([other != key for other in curves.keys])
        yield replace(problem, curves=curves.select(np.flatnonzero(is_other[curves.group])))
    if at_points.sum() >= SEVERAL and len(at_points) <= MOST_POINTS:
        for own in np.eye(len(at_points), dtype=np.bool_):
            yield replace(problem, points=points.select(~own))


def _follow(problem: Problem, starts: Array, config: CameraConfig, side: str) -> State:
    """Optimise from every start with a wide, then with the final loss; the best first, those on the stated side
    before the others.
    """
    if len(starts) == 0:
        raise refuse("camera", "no_camera")
    few = problem if len(starts) <= FEW_STARTS else _take_few_points(problem, config)
    feet = ground_feet(few.curves, starts, problem.model)
    rule = replace(COARSE, iterations=min(COARSE_ITERATIONS, config.iterations))
    wide = minimise(replace(few, loss_scale=FAR_LOSS * few.loss_scale), starts, rule, feet)
    best = wide.best(max(2, min(len(starts), 3 * config.starts // 4)))
    rule = replace(COARSE, iterations=config.iterations)
    state = resume(few, with_loss(few, best, few.loss_scale)[1], rule)
    # a camera hanging upside down sees a circle and a line just as well
    above = (state.theta[:, INDEX["z"]] < 0) & (np.sin(state.theta[:, INDEX["tilt"]]) > 0)
    if not above.any():
        raise refuse("camera", "no_camera")
    offset = state.theta[:, 4:6] - problem.priors.center_m
    stated = offset @ np.array(SIDES[side]) >= 0
    # the side decides between the two cameras of the turned field, not against what was seen
    stated &= above & (state.cost < state.cost[above].min() + problem.loss_scale**2)
    kept = above & stated if stated.any() else above
    state = state.select(kept).best(int(kept.sum()))
    if few is problem:
        return state
    nearest = state.theta[:FEW_STARTS]
    return minimise(problem, nearest, rule, ground_feet(problem.curves, nearest, problem.model)).best(len(nearest))


def _take_few_points(problem: Problem, config: CameraConfig) -> Problem:
    order = np.arange(len(problem.curves.points_px))
    least_px = noise_model(config, problem.model.width).model_sigma_px
    return replace(problem, curves=thin_curves(problem.curves, order, COARSE_POINTS, least_px))


def _screen(problem: Problem, grid: Array, count: int) -> Array:
    """The starts of a grid (L, P) that already lie nearest to what was seen, at most ``count``."""
    if len(grid) <= count:
        return grid
    stride = max(1, len(problem.curves.points_px) // SCREENING_POINTS)
    few = problem.curves.select(np.arange(0, len(problem.curves.points_px), stride))
    candidates = grid.copy()
    fixed = problem.priors.sd == 0
    candidates[:, fixed] = problem.priors.mean[fixed]
    feet = ground_feet(few, candidates, problem.model)
    seen = curve_residuals(few, candidates, feet, problem.model, 0, problem.points)
    on_curves = np.abs(seen.values[:, : feet.shape[1]]) * few.sigma_px
    offsets = seen.values[:, feet.shape[1] :].reshape(len(candidates), -1, 2) * problem.points.sigmas_px
    beside = np.where(seen.behind[:, feet.shape[1] :: 2], np.inf, np.linalg.norm(offsets, axis=-1))
    distance = np.concatenate([on_curves, beside], axis=1)
    penalty = np.sum(problem.priors.residuals(candidates)[0] ** 2, axis=1)
    mean_px = np.minimum(distance, SCREENING_CAP_PX).sum(axis=1) / max(distance.shape[1], 1)
    score = mean_px + PENALTY_PX * penalty
    return grid[np.argsort(score, kind="stable")[:count]]
