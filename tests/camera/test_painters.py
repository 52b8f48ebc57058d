"""Markings that lie elsewhere than the template has them."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera import painters
from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.painters import follow_errors
from circlecal.camera.problem import minimise
from circlecal.geometry.camera_parameters import PARAMETERS, project

from .test_problem import MODEL, SOCCER, observed, plain_theta, priors, problem_of


def test_markings_that_lie_elsewhere_move_the_camera_as_far_as_its_covariance_says():
    theta = plain_theta(np.random.default_rng(4))
    seen, chosen = observed(theta, np.random.default_rng(5), sigma=0.05), priors()
    base = problem_of(seen, chosen, loss_scale=np.inf)
    state = minimise(base, theta[None])
    step_m = 1e-3
    grid = np.stack(np.meshgrid(np.linspace(-12, 12, 5), np.linspace(-12, 12, 5)), axis=-1).reshape(-1, 2)

    def pixels(parameters):
        return project(parameters[None], grid[None], MODEL).pixels[0].ravel()

    moved, residuals = [], []
    for name in ("centre_circle", "halfway_line", "centre_mark"):
        for shift in ((step_m, 0.0), (0.0, step_m)):
            template = SOCCER.move_markings(
                lambda other, name=name, shift=shift: shift if other == name else (0.0, 0.0)
            )
            curves = curves_from_observations(seen, template, NoiseModel(10**6, 0.0, 0.0))
            problem = replace(base, curves=curves, points=points_from_observations(seen, template))
            there = minimise(problem, state.theta)
            moved.append(pixels(there.theta[0]) - pixels(state.theta[0]))
            residuals.append((there.values - state.values)[0, : len(base.curves.sigma_px)] * base.curves.sigma_px)
    expected = (np.array(moved) ** 2).sum(axis=0)
    covariance = posterior_covariance(state.normal[0], chosen.sd)
    added = follow_errors(base, state, covariance, SOCCER.model_copy(update={"placement_sd_m": step_m}))
    by_theta = project(state.theta[:1], grid[None], MODEL).jacobians()[0][0].reshape(-1, len(PARAMETERS))
    np.testing.assert_allclose(((by_theta @ added.covariance) * by_theta).sum(axis=1), expected, rtol=0.05, atol=1e-5)
    squared = (np.array(residuals) ** 2).sum(axis=0)
    for group, key in enumerate(base.curves.keys):
        own = base.curves.group == group
        assert added.residual_px[key] == pytest.approx(np.sqrt(squared[own].mean()), rel=0.05)
    assert follow_errors(base, state, covariance, SOCCER) is None


def test_paint_that_wanders_all_around_a_circle_is_a_larger_circle(monkeypatch):
    theta = plain_theta(np.random.default_rng(4))
    seen, chosen = observed(theta, np.random.default_rng(5), sigma=0.05), priors()
    seen = replace(seen, marks=())
    base = problem_of(seen, chosen, loss_scale=np.inf)
    state = minimise(base, theta[None])
    step_m = 1e-3
    straight, across = base.curves.straight, np.array([step_m, 0.0])
    curves = replace(base.curves, radius=np.where(straight, 0.0, base.curves.radius + step_m))
    larger = minimise(replace(base, curves=curves), state.theta).theta[0]
    beside = replace(base.curves, origin=base.curves.origin + straight[:, None] * across)
    moved = minimise(replace(base, curves=beside), state.theta).theta[0]
    covariance = posterior_covariance(state.normal[0], chosen.sd)
    wandering = SOCCER.model_copy(update={"wander_sd_m": step_m})
    monkeypatch.setattr(painters, "PIECE_M", 1e3)
    added = follow_errors(base, state, covariance, wandering).covariance
    grid = np.array([[10.0, 0.0], [-10.0, 5.0], [0.0, -12.0], [0.0, 12.0]])
    pixels = [project(t[None], grid[None], MODEL).pixels[0].ravel() for t in (state.theta[0], larger, moved)]
    by_theta = project(state.theta[:1], grid[None], MODEL).jacobians()[0][0].reshape(-1, len(PARAMETERS))
    expected = (pixels[1] - pixels[0]) ** 2 + (pixels[2] - pixels[0]) ** 2
    np.testing.assert_allclose(((by_theta @ added) * by_theta).sum(axis=1), expected, rtol=0.05, atol=1e-5)
    # pieces that wander each for itself do so less together
    monkeypatch.setattr(painters, "PIECE_M", 0.5)
    pieces = follow_errors(base, state, covariance, wandering).covariance
    assert np.trace(by_theta @ pieces @ by_theta.T) < 0.5 * np.trace(by_theta @ added @ by_theta.T)
