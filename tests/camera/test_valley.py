"""Along the valley of zoom and distance the optimum is found, and how flat it is."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera import valley
from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.problem import FINAL, evaluate, minimise
from circlecal.camera.valley import explore_valley, widen_valley
from circlecal.geometry.camera_parameters import LOG_FOCAL

from .test_problem import observed, plain_theta, priors, problem_of


@pytest.fixture(scope="module")
def fitted():
    """A problem and its optimum."""
    rng = np.random.default_rng(4)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, sigma=2.0), priors())
    return problem, minimise(problem, theta[None], FINAL)


def test_an_optimiser_that_stopped_early_is_led_to_the_optimum(fitted, monkeypatch):
    problem, state = fitted
    monkeypatch.setattr(valley, "OPEN_SD", 0.0)
    covariance = posterior_covariance(state.normal[0], problem.priors.sd)
    aside = state.theta + 0.8 * covariance[LOG_FOCAL] / np.sqrt(covariance[LOG_FOCAL, LOG_FOCAL])
    stopped = evaluate(problem, aside, state.feet, 2)
    found, growth = explore_valley(problem, stopped, FINAL)
    assert found.cost[0] == pytest.approx(state.cost[0], abs=0.01)
    assert growth == 1.0


def test_where_no_move_is_left_the_growth_is_that_of_the_sides_of_what_is_returned(fitted, monkeypatch):
    problem, state = fitted
    monkeypatch.setattr(valley, "OPEN_SD", 0.0)
    monkeypatch.setattr(valley, "MOST_MOVES", 0)
    covariance = posterior_covariance(state.normal[0], problem.priors.sd)
    aside = state.theta + 0.8 * covariance[LOG_FOCAL] / np.sqrt(covariance[LOG_FOCAL, LOG_FOCAL])
    stopped = evaluate(problem, aside, state.feet, 2)
    found, growth = explore_valley(problem, stopped, FINAL)
    np.testing.assert_array_equal(found.theta, stopped.theta)
    assert growth > 2.0


def test_a_valley_that_is_flatter_than_its_matrix_says_widens_the_covariance(fitted, monkeypatch):
    problem, state = fitted
    monkeypatch.setattr(valley, "OPEN_SD", 0.0)
    # a matrix that is four times as large as the cost's curvature
    steep = replace(state, normal=4.0 * state.normal)
    found, growth = explore_valley(problem, steep, FINAL)
    assert found.theta[0] == pytest.approx(state.theta[0])
    assert growth == pytest.approx(4.0, rel=0.2)


def test_both_sides_are_followed_at_once_with_their_focal_lengths_held(fitted):
    problem, state = fitted
    covariance = posterior_covariance(state.normal[0], problem.priors.sd)
    step = covariance[LOG_FOCAL] / np.sqrt(covariance[LOG_FOCAL, LOG_FOCAL])
    sides = valley._hold_focal(problem, state, step)
    expected = state.theta[0, LOG_FOCAL] + np.array([-1.0, 1.0]) * step[LOG_FOCAL]
    np.testing.assert_allclose(sides.theta[:, LOG_FOCAL], expected, rtol=1e-12)
    # one standard deviation off chi-square is higher by one, but for how the valley bends
    assert sides.cost - state.cost[0] == pytest.approx(1.0, abs=0.25)


def test_what_is_known_of_the_focal_length_beforehand_makes_the_sides_rise_too(fitted, monkeypatch):
    problem, state = fitted
    monkeypatch.setattr(valley, "OPEN_SD", 0.0)
    covariance = posterior_covariance(state.normal[0], problem.priors.sd)
    mean, sd = problem.priors.mean.copy(), problem.priors.sd.copy()
    # twice as narrow as what is seen tells, and a little beside it
    sd[LOG_FOCAL] = 0.5 * np.sqrt(covariance[LOG_FOCAL, LOG_FOCAL])
    mean[LOG_FOCAL] = state.theta[0, LOG_FOCAL] + 0.5 * sd[LOG_FOCAL]
    known = replace(problem, priors=replace(problem.priors, mean=mean, sd=sd))
    optimum = minimise(known, state.theta, FINAL)
    found, growth = explore_valley(known, optimum, FINAL)
    assert growth == 1.0
    assert found.theta[0] == pytest.approx(optimum.theta[0])
    step = posterior_covariance(optimum.normal[0], sd)[LOG_FOCAL]
    sides = valley._hold_focal(known, optimum, step / np.sqrt(step[LOG_FOCAL]))
    assert sides.cost - optimum.cost[0] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("limit", "sd"), [("OPEN_SD", 10.0), ("LOST_SD", 0.0)])
def test_a_camera_that_is_well_known_or_lost_is_not_looked_at(limit, sd, fitted, monkeypatch):
    problem, state = fitted
    monkeypatch.setattr(valley, "OPEN_SD", 0.0)
    monkeypatch.setattr(valley, limit, sd)
    monkeypatch.setattr(valley, "_hold_focal", None)
    found, growth = explore_valley(problem, state, FINAL)
    np.testing.assert_array_equal(found.theta, state.theta)
    assert growth == 1.0


def test_only_what_goes_along_with_the_focal_length_becomes_less_certain():
    covariance = np.diag([0.04, 1.0, 2.0])
    covariance[0, 1] = covariance[1, 0] = 0.1
    wider = widen_valley(covariance, 3.0)
    assert wider[LOG_FOCAL, LOG_FOCAL] == pytest.approx(3.0 * covariance[LOG_FOCAL, LOG_FOCAL])
    assert wider[0, 1] == pytest.approx(3.0 * covariance[0, 1])
    assert wider[1, 1] == pytest.approx(1.0 + 2.0 * 0.1**2 / 0.04)
    assert wider[2, 2] == covariance[2, 2]
