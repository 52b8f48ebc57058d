"""The Cramer-Rao bound of a scenario: the error that no unbiased estimator can beat with these observations and
priors.
"""

from __future__ import annotations

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.options import CameraConfig, priors_of
from circlecal.camera.painters import knows_painters_errors, weigh_errors
from circlecal.camera.problem import Problem, evaluate
from circlecal.camera.residuals import sample_feet
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import ProjectionModel, project, theta_of
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations


def bound_covariance(
    camera: Camera,
    crown_m: float,
    observations: Observations,
    template: FieldTemplate,
    circle: Circle,
    config: CameraConfig,
    with_painters: bool = False,
) -> Array:
    """Covariance (P, P) of the parameters at the truth: inverse of the Fisher information of the data plus the
    priors' precision; ``with_painters`` for paint that lies elsewhere than the template has it, which nobody knows.
    """
    model = ProjectionModel(camera.width, camera.height, Surface(config.usual_crown, circle.radius_m))
    theta = theta_of(camera, model, crown_m)
    curves = curves_from_observations(observations, template, NoiseModel(10**6, 0.0, 0.0))
    priors = priors_of(config, template, circle, model)
    problem = Problem(curves, points_from_observations(observations, template), priors, model)
    feet = sample_feet(curves, theta[None], model)
    state = evaluate(problem, theta[None], feet, updates=6)
    covariance = posterior_covariance(state.normal[0], priors.sd)
    if not (with_painters and knows_painters_errors(template)):
        return covariance
    return covariance + weigh_errors(problem, state, template)[1]


def bound_errors(camera: Camera, covariance: Array, grid_m: Array, draws: int, rng: np.random.Generator) -> Array:
    """Mean reprojection errors (draws,) of an estimator that reaches the bound, to first order, in undistorted pixels.

    Parameters
    ----------
    camera : Camera
        The truth.
    covariance : (P, P) array
        From :func:`bound_covariance`.
    grid_m : (N, 2) array
        Field points over which the error is averaged.
    draws : int
        How many errors are drawn.
    rng : numpy.random.Generator
        Source of the draws.
    """
    model = ProjectionModel(camera.width, camera.height, Surface("flat"))
    theta = theta_of(camera, model)
    theta[9:11] = 0.0
    jacobian = project(theta[None], grid_m[None], model).jacobians()[0][0]
    # the homography is that of the tangent plane in undistorted pixels: lens and crown are no part of its error
    jacobian[..., 9:11] = 0.0
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    deltas = rng.standard_normal((draws, len(covariance))) @ root.T
    errors = np.einsum("nip,dp->dni", jacobian, deltas)
    return np.asarray(np.linalg.norm(errors, axis=-1).mean(axis=1))
