"""Priors, robust loss and the batched optimiser."""

import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.priors import Priors
from circlecal.camera.problem import BEHIND, COARSE, FINAL, Problem, bend_surface, evaluate, minimise, predict_step
from circlecal.camera.residuals import FixedPoints, sample_feet, stack_curves
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, project, theta_of
from circlecal.geometry.least_squares import LEAST_DAMPING
from circlecal.geometry.surface import Surface
from circlecal.observations import CirclePoints, LinePoints, MarkingKey, MarkPoint, Observations
from circlecal.synthetic.cameras import aim_camera

from .conftest import STEPS, central_differences, random_thetas

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080, Surface("parabola"))


def priors(**fixed_or_sd):
    mean, sd = np.zeros(len(PARAMETERS)), np.zeros(len(PARAMETERS))
    sd[:7] = np.inf
    sd[INDEX["roll"]] = 0.05
    for name, value in fixed_or_sd.items():
        sd[INDEX[name]] = value
    return Priors(mean, sd, 64.0, 0.6, np.radians(15), np.radians(10), np.zeros(2))


def observed(theta, rng, sigma=0.5, count=60):
    """Circle, halfway line and centre mark of a camera without crown, bloom or other sizes."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    circle = 9.15 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    line = np.stack([np.zeros(30), np.linspace(-11, 11, 30)], axis=-1)

    def pixels(field):
        seen = project(theta[None], field[None], MODEL).pixels[0]
        return seen + rng.normal(0, sigma, seen.shape)

    def stated(n):
        return np.full(n, max(sigma, 1e-3))

    return Observations(
        1920,
        1080,
        (CirclePoints("centre_circle", "outer", pixels(circle), stated(count)),),
        (LinePoints("halfway_line", pixels(line), stated(30)),),
        (MarkPoint("centre_mark", pixels(np.zeros((1, 2)))[0], max(sigma, 1e-3)),),
    )


def plain_theta(rng):
    theta = random_thetas(1, rng)[0]
    theta[7:] = 0.0
    return theta


def problem_of(seen, chosen, loss_scale=6.0):
    curves = curves_from_observations(seen, SOCCER, NoiseModel(10**6, 0.0, 0.0))
    return Problem(curves, points_from_observations(seen, SOCCER), chosen, MODEL, loss_scale)


def test_prior_residuals_and_their_jacobian():
    chosen = priors(pp_x=5.0, kappa_1=0.01, crown=0.03, width=0.02)
    theta = random_thetas(1, np.random.default_rng(1))[0]
    values, jacobian = chosen.residuals(theta[None])
    numeric = central_differences(lambda t: chosen.residuals(t[None])[0][0], theta, STEPS)
    np.testing.assert_allclose(jacobian[0], numeric, atol=1e-6)
    distance = np.linalg.norm(theta[4:7])
    assert values[0, -2] == pytest.approx(np.log(distance / 64.0) / 0.6)
    assert values[0, -1] == pytest.approx((np.arcsin(-theta[6] / distance) - np.radians(15)) / np.radians(10))
    np.testing.assert_allclose(values[0, :1], theta[3] / 0.05)


def test_gradient_of_the_cost():
    rng = np.random.default_rng(2)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng), priors(pp_x=5.0, pp_y=5.0), 3.0)
    near = theta + 1e-4 * rng.standard_normal(len(theta)) * (problem.priors.sd > 0)
    feet = sample_feet(problem.curves, near[None], MODEL)

    def cost(t):
        return evaluate(problem, t[None], feet, updates=12).cost

    state = evaluate(problem, near[None], feet, updates=12)
    numeric = central_differences(cost, near, STEPS / 50)[0]
    active = np.flatnonzero(problem.priors.sd > 0)
    # the cost is a sum of squares, the gradient that of half of it
    np.testing.assert_allclose(numeric[active], 2 * state.gradient[0, active], rtol=1e-3)


def test_minimise_finds_the_truth_from_aside_and_keeps_what_is_fixed():
    rng = np.random.default_rng(3)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, sigma=0.0), priors(), 1e3)
    start = theta + np.r_[0.05, 0.01, 0.01, 0.01, 1.5, -2.0, 1.0, np.full(len(theta) - 7, 0.3)]
    state = minimise(problem, start[None])
    assert (state.theta[0, 7:] == 0).all()
    field = np.random.default_rng(0).uniform(-12, 12, (1, 50, 2))
    departure = project(state.theta, field, MODEL).pixels - project(theta[None], field, MODEL).pixels
    assert np.abs(departure).max() < 1e-6


@pytest.mark.parametrize("y_m", [6.0, 1.0, -1.0, -6.0])
def test_minimise_finds_an_overhead_camera_on_whichever_side_of_the_centre_it_stands(y_m):
    theta = np.zeros(len(PARAMETERS))
    theta[:7] = [np.log(1200.0), 0.0, 0.15, 0.01, 2.0, y_m, -40.0]
    rng = np.random.default_rng(1)
    anywhere = replace(priors(), distance_log_sd=np.inf, elevation_sd_rad=np.inf)
    problem = problem_of(observed(theta, rng), anywhere)
    aside = theta.copy()
    aside[:7] += [0.01, 0.01, 0.005, 0.0, 0.3, 0.3, 0.3]
    found = minimise(problem, np.stack([aside, theta]), FINAL)
    assert found.cost[0] == pytest.approx(found.cost[1], abs=1e-2)


def test_cost_never_grows_with_more_iterations():
    rng = np.random.default_rng(4)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng), priors(pp_x=5.0, kappa_1=0.01))
    start = theta + np.r_[0.1, 0.02, 0.02, 0.02, 3.0, -4.0, 2.0, np.zeros(len(theta) - 7)]
    costs = [float(minimise(problem, start[None], replace(FINAL, iterations=n)).cost[0]) for n in (0, 1, 3, 10, 40)]
    assert all(later <= sooner for sooner, later in pairwise(costs))
    # chi-square of 60 + 30 points across the marking and 2 coordinates of the mark
    assert 50 < costs[-1] < 140


def test_an_outlying_third_of_the_circle_does_not_move_the_answer():
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    seen = observed(theta, rng)
    seen.circles[0].points_px[:20] += [0.0, 40.0]
    problem = problem_of(seen, priors())
    state = minimise(problem, theta[None])
    field = np.random.default_rng(0).uniform(-9, 9, (1, 50, 2))
    departure = project(state.theta, field, MODEL).pixels - project(theta[None], field, MODEL).pixels
    assert np.linalg.norm(departure, axis=-1).mean() < 3.0
    plain = minimise(replace(problem, loss_scale=np.inf), theta[None])
    spoilt = project(plain.theta, field, MODEL).pixels - project(theta[None], field, MODEL).pixels
    assert np.linalg.norm(spoilt, axis=-1).mean() > 10.0


def test_starts_do_not_disturb_each_other():
    rng = np.random.default_rng(6)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng), priors())
    starts = theta + rng.normal(0, 1, (4, len(theta))) * np.r_[0.05, 0.01, 0.01, 0.01, 2, 2, 1, np.zeros(10)]
    together = minimise(problem, starts)
    cost = evaluate(problem, together.theta, together.feet, updates=6).cost
    for k in range(4):
        alone = minimise(problem, starts[k : k + 1])
        assert cost[k] == pytest.approx(evaluate(problem, alone.theta, alone.feet, updates=6).cost[0], rel=1e-6)
    best = together.best(2)
    assert best.cost.tolist() == sorted(together.cost)[:2]


def test_a_start_that_looks_away_steps_by_metres_beside_one_that_sees_the_circle():
    rng = np.random.default_rng(6)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng), priors())
    starts = np.stack([theta, theta])
    starts[1, INDEX["pan"]] += np.pi
    state = evaluate(problem, starts, sample_feet(problem.curves, starts, MODEL))
    state.gradient[1], state.normal[1] = 0.0, np.eye(len(PARAMETERS))
    state.gradient[1, INDEX["x"]] = -2000.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        step = problem.step(state, np.full(2, LEAST_DAMPING))
    assert step.parameters[1, INDEX["x"]] - starts[1, INDEX["x"]] == pytest.approx(2000.0)


@pytest.mark.parametrize("seed", [3, 4])
def test_the_fit_to_the_other_profile_of_the_pitch_is_predicted(seed):
    rng = np.random.default_rng(seed)
    theta = plain_theta(rng)
    theta[INDEX["crown"]] = 0.08
    chosen = priors(pp_x=5.0, pp_y=5.0, crown=0.05)
    problem = replace(
        problem_of(observed(theta, rng, sigma=0.2), chosen), model=replace(MODEL, surface=Surface("roof"))
    )
    roof = minimise(problem, theta[None])
    curved, start = bend_surface(problem, roof)
    expected = predict_step(curved, start)
    found = minimise(curved, roof.theta)
    gain = roof.cost[0] - found.cost[0]
    assert gain > 10.0
    assert expected.cost[0] == pytest.approx(found.cost[0], abs=0.1 * gain)
    assert expected.theta[0, INDEX["crown"]] == pytest.approx(found.theta[0, INDEX["crown"]], abs=5e-3)


def test_a_camera_that_sees_one_end_goes_along_when_the_length_of_the_field_changes():
    theta = np.zeros(len(PARAMETERS))
    theta[:7] = np.log(1800.0), 0.5, np.arctan2(85.0, 16.0), 0.0, 3.0, 65.0, -16.0
    names = ["side_line_right", *(f"{box}_rect_right_{side}" for box in ("small", "big") for side in ("main", "top"))]
    ends = np.array([SOCCER.line_ends(SOCCER.line_by_name[name]) for name in names])
    field = ends[:, :1] + np.linspace(0.2, 0.8, 12)[:, None] * (ends[:, 1:] - ends[:, :1])
    pixels = project(theta[None], field.reshape(1, -1, 2), MODEL).pixels[0].reshape(len(names), -1, 2)
    lines = tuple(LinePoints(name, points, np.full(12, 0.2)) for name, points in zip(names, pixels, strict=True))
    problem = problem_of(Observations(1920, 1080, (), lines, ()), priors(length=8.0))
    by_growth = problem.curves.common_shift
    np.testing.assert_allclose(by_growth, [0.5, 0.0])
    # only the prior tells the length: all that is seen moves with it, and the camera has to follow
    longer = theta.copy()
    longer[INDEX["length"]], longer[INDEX["x"]] = 20.0, theta[INDEX["x"]] + 10.0
    middle_m = np.array([44.0, -10.0])

    def length_after(iterations, by_growth):
        looking = replace(problem.priors, center_m=middle_m, center_by_growth=by_growth)
        told = replace(problem, priors=replace(looking, distance_log_sd=np.inf, elevation_sd_rad=np.inf))
        rule = replace(COARSE, tolerance=1e-3, iterations=iterations)
        found = minimise(told, longer[None], rule, sample_feet(told.curves, longer[None], MODEL))
        return float(found.theta[0, INDEX["length"]])

    assert length_after(1, by_growth) == pytest.approx(0.0, abs=0.1)
    assert length_after(20, np.zeros(2)) > 1.0


@pytest.mark.parametrize(("place", "kappa"), [((52.5, 0.0), -0.1), ((0.0, 120.0), 0.0)])
def test_a_fixed_point_that_the_camera_does_not_show_tells_nothing(place, kappa):
    """Beyond the fold of the lens, or behind the camera: however near its pixel lies, it is as wrong as can be."""
    theta = theta_of(aim_camera(np.array([3.0, 60.0, -16.0]), np.zeros(3), 3000.0, 0.0, 1920, 1080, kappa), MODEL)
    field = np.array([[0.0, 0.0], place])
    seen = project(theta[None], field[None], MODEL)
    assert seen.visible[0].tolist() == [True, False]
    points = FixedPoints(field, seen.pixels[0] + 1.0, np.ones(2), (MarkingKey("right"), MarkingKey("wrong")))
    problem = Problem(stack_curves([]), points, priors(), MODEL, 6.0)
    state = evaluate(problem, theta[None], np.zeros((1, 0)))
    assert np.abs(state.point_values[0, :2]).max() < 1.1 and state.point_values[0, 2:].tolist() == [BEHIND] * 2
    assert state.jacobian[0, :2].any() and not state.jacobian[0, 2:].any()
