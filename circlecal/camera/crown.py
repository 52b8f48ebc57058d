"""From one profile of the pitch across its length to the other, without looking at a marking again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.optimise import Problem, State, weighed
from circlecal.camera.residuals import curve_points
from circlecal.geometry.camera_parameters import INDEX


def on_parabola(problem: Problem, state: State, loss_scale: float) -> tuple[Problem, State]:
    """The problem with a parabolic pitch instead of a roof, and the state in it to first order of the surface's height.

    The parabola falls about as the roof does where points were seen.
    """
    index, count = INDEX["crown"], state.hidden.shape[1]
    y = np.empty_like(state.values)
    y[:, :count] = curve_points(problem.curves, state.hidden, state.theta)[0][..., 1]
    y[:, count:] = problem.points.twice[0][1]
    # so many times as far as the roof with the same crown has the parabola fallen there
    further = np.abs(y) / problem.model.surface.reference_m
    by_crown, crown = state.jacobian[..., index], state.theta[:, index, None]
    like = crown * (further**3).sum(axis=1, keepdims=True) / np.maximum((further**4).sum(axis=1, keepdims=True), 1e-12)
    theta, jacobian = state.theta.copy(), state.jacobian.copy()
    theta[:, index], jacobian[..., index] = like[:, 0], by_crown * further
    values = state.values + by_crown * (like * further - crown)
    curved = replace(problem, model=replace(problem.model, surface=replace(problem.model.surface, shape="parabola")))
    return curved, weighed(theta, state.hidden, values, jacobian, *problem.priors.residuals(theta), loss_scale)
