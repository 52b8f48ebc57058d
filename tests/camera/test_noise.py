"""Noise as the residuals show it."""

import numpy as np
import pytest

from circlecal.camera.noise import leave_out_stray_points, noise_of_misfit, rescale_and_reject, rescale_sigmas
from circlecal.camera.observed import points_from_observations
from circlecal.camera.problem import Problem, State
from circlecal.camera.residuals import circle_curve, line_curve, stack_curves
from circlecal.field import load_field
from circlecal.observations import MarkingKey, Observations

from .test_problem import MODEL, plain_theta, priors

SOCCER = load_field("soccer")
STATED_PX, LEAST_PX = 2.0, 0.2


def fitted(residuals_px, few_px=()):
    """A problem whose circle, and a line of few points, have these residuals; and the curves with the least sigma."""
    count, few = len(residuals_px), len(few_px)
    rng = np.random.default_rng(0)
    parts = [
        circle_curve(
            MarkingKey("circle"), np.zeros((count, 2)), np.full(count, STATED_PX), np.zeros(2), 9.15, 0.0, 0.0
        ),
        line_curve("line", np.zeros((few, 2)), np.full(few, STATED_PX), np.array([[0.0, 0], [1, 0]]), np.zeros((3, 2))),
    ]
    curves = stack_curves(parts)
    order = rng.permutation(count + few)
    feet = np.concatenate([np.arange(count), np.arange(few)])[order].astype(float)
    residuals = np.concatenate([residuals_px, few_px])[order] / STATED_PX
    curves = curves.select(order)
    theta = plain_theta(rng)[None]
    slopes, no_priors = np.zeros((1, count + few, theta.shape[1])), (np.zeros((1, 0)), np.zeros((1, 0, theta.shape[1])))
    state = State(theta, feet[None], residuals[None], slopes, *no_priors, np.zeros(1), theta, slopes)
    problem = Problem(curves, points_from_observations(Observations(1920, 1080), SOCCER), priors(), MODEL, 6.0)
    return problem, state, curves.with_sigma(np.full(count + few, LEAST_PX))


def test_quiet_points_keep_the_least_sigma():
    residuals = np.random.default_rng(1).normal(0, 0.05, 200)
    problem, state, scale, least = rescale_and_reject(*fitted(residuals))
    assert len(problem.curves.points_px) > 190
    assert state.feet.shape == state.residuals.shape == (1, len(problem.curves.points_px))
    np.testing.assert_allclose(problem.curves.sigma_px, LEAST_PX)
    np.testing.assert_array_equal(least.points_px, problem.curves.points_px)
    assert scale == 1.0


def test_noise_grows_to_the_scatter_and_its_repetition():
    white = np.random.default_rng(2).normal(0, 0.8, 240)
    assert rescale_and_reject(*fitted(white))[0].curves.sigma_px[0] == pytest.approx(0.8, rel=0.25)
    waves = 0.8 * np.sin(np.arange(240) / 6.0)
    assert rescale_and_reject(*fitted(waves))[0].curves.sigma_px[0] > 1.5


def test_points_on_something_else_are_left_out_and_a_bend_is_not():
    bend = np.linspace(-1.5, 1.5, 200) ** 2
    residuals = bend + np.random.default_rng(3).normal(0, 0.03, 200)
    residuals[80:85] += 1.2
    _, state, _, _ = rescale_and_reject(*fitted(residuals))
    left = np.setdiff1d(np.arange(200), state.feet[0])
    assert set(range(80, 85)) <= set(left)
    assert len(left) < 15


def test_strays_are_left_out_whatever_moves_all_points():
    bend = 3.0 * np.linspace(-1.5, 1.5, 200) ** 2
    residuals = bend + np.random.default_rng(3).normal(0, 0.03, 200)
    residuals[90:94] += 2.0
    problem, state, _ = fitted(residuals, np.full(9, 5.0))
    nearer, fewer, kept = leave_out_stray_points(problem, state)
    left = np.sort(state.feet[0, kept][problem.curves.group[kept] == 0])
    assert not set(left) & {90.0, 91.0, 92.0, 93.0}
    assert len(left) > 185
    assert (nearer.curves.group == 1).sum() == 9  # too few to tell
    assert len(nearer.curves.points_px) == fewer.residuals.shape[1] == len(kept)


def test_few_points_tell_nothing():
    few = np.array([5.0, -5.0, 4.0])
    problem, _, _, _ = rescale_and_reject(*fitted(np.zeros(100), few))
    assert np.count_nonzero(problem.curves.group == 1) == 3
    np.testing.assert_allclose(problem.curves.sigma_px, LEAST_PX)


def test_what_the_fit_takes_of_errors_that_repeat_themselves_is_noise_too():
    """Errors along a circle that repeat themselves over 12 of 240 points, after an ellipse has passed near them."""
    turn = np.arange(240) * (2.0 * np.pi / 240)
    ellipse = np.stack([np.ones(240), *(f(k * turn) for k in (1, 2) for f in (np.cos, np.sin))], axis=1)
    told = []
    for seed in range(20):
        white = np.random.default_rng(seed).normal(0.0, 0.1, 240)
        errors = np.real(np.fft.ifft(np.fft.fft(white) * np.fft.fft(np.full(12, 1.0), 240)))
        left = errors - ellipse @ np.linalg.lstsq(ellipse, errors, rcond=None)[0]
        told.append(rescale_and_reject(*fitted(left))[0].curves.sigma_px[0])
    # averaged over a long piece, the sum of 12 white errors has the standard deviation of one, 12 times over
    assert np.median(told) == pytest.approx(12 * 0.1, rel=0.2)


@pytest.mark.parametrize("count", [8, 12, 200])
def test_the_scatter_of_few_points_holds_what_the_fit_takes_to_place_their_marking(count):
    """Three of n residuals are free to vanish: sigma grows by sqrt(n / (n - 3)) more than their mean square says."""
    residuals = 1.5 * STATED_PX * np.resize([1.0, -1.0], count)
    problem, state, _ = fitted(residuals)
    expected = 1.5 * STATED_PX * np.sqrt(count / (count - 3))
    grown, _, scale = rescale_sigmas(problem, state)
    np.testing.assert_allclose(grown.curves.sigma_px, expected)
    assert scale == pytest.approx(expected / STATED_PX)
    told, _ = noise_of_misfit(problem, state, np.full(count, STATED_PX))
    np.testing.assert_allclose(told.curves.sigma_px, expected)


def test_fewer_points_than_can_tell_their_scatter_keep_their_noise():
    problem, state, _ = fitted(9.0 * np.resize([1.0, -1.0], 7))
    grown, _, scale = rescale_sigmas(problem, state)
    np.testing.assert_allclose(grown.curves.sigma_px, STATED_PX)
    assert scale == 1.0
