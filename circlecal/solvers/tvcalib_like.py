"""Gradient refinement of a pinhole camera from prior starts on segment distances, after Theiner and Ewerth 2023
(TVCalib).

As there, the camera's pose and field of view are standardised by the ranges of broadcast cameras, the loss is the
mean squared distance of the points of each marking from its projection, averaged over markings, and AdamW follows
its gradient from the middle of the ranges and from beside it. Unlike there, the points are those of the observations
(no segmentation network), distances go along the marking's normal, and fewer steps are made.
"""

from __future__ import annotations

import numpy as np

from circlecal.camera.observed import NoiseModel, curves_from_observations
from circlecal.camera.residuals import CurvePoints, curve_residuals, sample_feet
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, camera_of
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, solver

RANGES = {
    "log_focal": (np.log(0.5), np.log(7.0)),
    "pan": (np.radians(-45.0), np.radians(45.0)),
    "tilt": (np.radians(45.0), np.radians(90.0)),
    "roll": (np.radians(-10.0), np.radians(10.0)),
    "x": (-36.0, 36.0),
    "y": (40.0, 110.0),
    "z": (-40.0, -5.0),
}
"""Six standard deviations of each parameter; the focal length in widths of the picture (fields of view of 8 to 90
degrees), the position in metres.
"""
STARTS = ((0.0, 0.0), (-1.0, 0.0), (1.0, 0.0))
"""Camera x, in standard deviations, and pan so that the camera looks at the circle."""
STEPS = 400
LEARNING_RATE = 0.05
MAXIMUM_POINTS = 48
"""Steps of the optimiser, the first one's size in standard deviations of the parameters, and points of a marking."""
SEARCH_EVERY = 40
"""Steps after which the nearest points are looked for along the whole marking again."""
DECAYS = (0.9, 0.999)
"""Of the running means of gradient and squared gradient: the usual ones of Adam."""


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """AdamW from all starts at once; the camera with the smallest loss."""
    model = ProjectionModel(observations.width, observations.height, Surface("flat", circle.radius_m))
    curves = curves_from_observations(observations, template, NoiseModel(MAXIMUM_POINTS, 0.0, 0.0))
    if len(curves.keys) < 2:
        raise failure("needs_two_markings", "one marking alone leaves the camera undetermined")
    if len(curves.points_px) < len(RANGES):
        raise failure("too_few_points", f"{len(RANGES)} points are needed, {len(curves.points_px)} seen")
    mean, sd = standardisation(model)
    z = np.zeros((len(STARTS), len(mean)))
    z[:, INDEX["x"]] = [start[0] for start in STARTS]
    position = mean[4:6] + z[:, 4:6] * sd[4:6] - np.asarray(circle.center)
    z[:, INDEX["pan"]] = (np.arctan2(-position[:, 0], position[:, 1]) - mean[INDEX["pan"]]) / sd[INDEX["pan"]]
    theta, loss = descend(curves, model, mean, sd, z)
    best = int(np.argmin(loss))
    if not np.isfinite(loss[best]):
        raise failure("no_convergence", "every start ended behind the camera")
    return camera_of(theta[best], model).homography


def standardisation(model: ProjectionModel) -> tuple[Array, Array]:
    """Mean and standard deviation (P,) of the parameters; those that are not estimated have sd 0."""
    mean, sd = np.zeros(len(PARAMETERS)), np.zeros(len(PARAMETERS))
    for name, (low, high) in RANGES.items():
        mean[INDEX[name]], sd[INDEX[name]] = (low + high) / 2, (high - low) / 6
    mean[INDEX["log_focal"]] += np.log(model.width)
    return mean, sd


def descend(curves: CurvePoints, model: ProjectionModel, mean: Array, sd: Array, z: Array) -> tuple[Array, Array]:
    """Parameters (B, P) and losses (B,) after ``STEPS`` steps of AdamW with a cosine schedule."""
    first, second = np.zeros_like(z), np.zeros_like(z)
    share = 1.0 / (np.bincount(curves.group)[curves.group] * len(curves.keys))
    unit = curves.sigma_px / (model.width / 2.0)
    best, best_loss = mean + sd * z, np.full(len(z), np.inf)
    feet = np.zeros((len(z), len(curves.points_px)))
    for step in range(STEPS):
        theta = mean + sd * z
        if step % SEARCH_EVERY == 0:
            feet = sample_feet(curves, theta, model)
        seen = curve_residuals(curves, theta, feet, model, updates=1)
        feet = seen.feet
        values = np.where(seen.behind, 0.0, seen.values * unit)
        loss = np.where(seen.behind.any(axis=1), np.inf, np.sum(share * values**2, axis=1))
        better = loss < best_loss
        best, best_loss = np.where(better[:, None], theta, best), np.where(better, loss, best_loss)
        gradient = 2.0 * np.einsum("bn,bnp->bp", share * values * unit, seen.jacobian) * sd
        first = DECAYS[0] * first + (1 - DECAYS[0]) * gradient
        second = DECAYS[1] * second + (1 - DECAYS[1]) * gradient**2
        rate = LEARNING_RATE * 0.5 * (1 + np.cos(np.pi * step / STEPS))
        scale = np.sqrt(second / (1 - DECAYS[1] ** (step + 1))) + 1e-8
        z = z - rate * first / (1 - DECAYS[0] ** (step + 1)) / scale
    return best, best_loss
