"""How far a camera is open along the valley in which zoom and distance make up for each other.

The Gauss-Newton matrix tells how steep the cost is at one place. Along the valley, with all else following, the cost
may be flat to one side, where lens, crown and principal point give way: then the optimum lies further off than the
optimiser went, and the camera is less certain than the matrix says. So the cost is looked at to both sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.problem import Problem, State, evaluate, resume, with_priors
from circlecal.geometry.camera_parameters import LOG_FOCAL
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array

OPEN_SD, LOST_SD = 0.03, 0.5
"""Standard deviation of the logarithm of the focal length from which on the valley is looked at, and from which on it
has no other side: such a camera is refused.
"""
REACH = 1.5
"""Standard deviations to either side."""
LEAST_GROWTH, MOST_GROWTH = 1.5, 9.0
"""Of a variance. Of 18 rendered views of worn circles that are so open, 15 have 1.05 to 1.25 and errors within 1.5 of
their standard deviations, one has 3.7 and was 4.5 of them off; what skew leaves below a half is not counted.
"""
MOST_MOVES, GAINS = 2, (0.02, 2.0)
"""How often a better optimum is taken over, and by how much lower its cost (chi-square) must be and may be at most:
what is lower by more is no optimum of this valley, but one that explains other points.
"""
SIDES = StoppingRule(0.003, contraction=0.03)
"""For the sides, whose cost tells a growth from 1.5 on: it rises by 2.25 where the variance is what the matrix says."""


def explore_valley(problem: Problem, state: State, rule: StoppingRule) -> tuple[State, float]:
    """The optimum of the first start along its valley, and how many times the variance along it is what the
    Gauss-Newton matrix says there: 1 where the cost rises as that says.

    Parameters
    ----------
    problem, state : Problem, State
        A fit.
    rule : StoppingRule
        When an optimum is reached.
    """
    best = state.best()
    for moves in range(MOST_MOVES + 1):
        covariance = posterior_covariance(best.normal[0], problem.priors.sd)
        sd = float(np.sqrt(covariance[LOG_FOCAL, LOG_FOCAL]))
        if not OPEN_SD < sd < LOST_SD:
            return best, 1.0
        sides = _hold_focal(problem, best, REACH * covariance[LOG_FOCAL] / sd)
        lower = sides.best()
        if moves == MOST_MOVES or not GAINS[0] <= float(best.cost[0] - lower.cost[0]) <= GAINS[1]:
            break
        problem, moved = with_priors(problem, lower, problem.priors)
        best = resume(problem, moved, rule)
    rises = sides.cost - best.cost[0]
    rise = float(np.where(rises > -GAINS[1], rises, np.inf).min())
    growth = REACH**2 / max(rise, REACH**2 / MOST_GROWTH)
    return best, growth if growth > LEAST_GROWTH else 1.0


def _hold_focal(problem: Problem, best: State, step: Array) -> State:
    """The best cameras with the focal lengths a step (P,) to either side; their costs have the focal length's prior."""
    mean, sd = problem.priors.mean[LOG_FOCAL], problem.priors.sd.copy()
    by_prior = 1.0 / sd[LOG_FOCAL]
    sd[LOG_FOCAL] = 0.0
    held = replace(problem, priors=replace(problem.priors, sd=sd))
    theta = best.theta + np.array([[-1.0], [1.0]]) * step
    sides = resume(held, evaluate(held, theta, np.repeat(best.feet, 2, axis=0)), SIDES)
    # a parameter that is held has no prior of its own
    return replace(sides, cost=sides.cost + (by_prior * (theta[:, LOG_FOCAL] - mean)) ** 2)


def widen_valley(covariance: Array, growth: float) -> Array:
    """A covariance (P, P) whose variance along the valley is so many times as large."""
    along = covariance[LOG_FOCAL] / np.sqrt(max(covariance[LOG_FOCAL, LOG_FOCAL], 1e-300))
    return np.asarray(covariance + (growth - 1.0) * np.outer(along, along))
