"""Painters' errors: markings that lie elsewhere than the template has them, and what that leaves open of the camera."""

from __future__ import annotations

import numpy as np

from circlecal.camera.problem import Problem, State
from circlecal.camera.residuals import curve_residuals
from circlecal.geometry.projective import Array


def placement_covariance(problem: Problem, state: State, covariance: Array, placement_sd_m: float) -> Array | None:
    """What painters' errors add to the covariance (P, P) of the camera.

    Each marking, with all its edges, lies elsewhere than the template has it by a normal error along x and along y. No
    number of points on it tells that, so it comes on top of their noise: with the weighted Jacobian J of the residuals
    and their derivatives R by these errors the camera follows by ``C J^T R``, C its covariance.

    Parameters
    ----------
    problem, state : Problem, State
        A fit, of which the first start counts.
    covariance : (P, P) array
        Of the camera's parameters, from noise and priors.
    placement_sd_m : float
        Standard deviation of where a marking lies, metres along each axis.

    Returns
    -------
    (P, P) array or None
        None where painters make no errors.
    """
    if placement_sd_m == 0.0:
        return None
    curves, points = problem.curves, problem.points
    seen = curve_residuals(curves, state.theta[:1], state.feet[:1], problem.model, 0, points)
    names = [curves.keys[group].name for group in curves.group.tolist()]
    names += [key.name for key in points.keys for _ in range(2)]
    _, marking = np.unique(names, return_inverse=True)
    weight = 1.0 / (1.0 + seen.values[0] ** 2 / problem.loss_scale**2) ** 2
    of_marking = marking[:, None] == np.arange(marking.max(initial=-1) + 1)
    by_error = (of_marking[:, :, None] * (weight * seen.by_place[0]).T[:, None]).reshape(len(marking), -1)
    moved = placement_sd_m * covariance @ seen.jacobian[0].T @ by_error
    return np.asarray(moved @ moved.T)
