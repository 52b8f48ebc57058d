"""Two cameras that explain a frame alike: how the likelier one is widened by the other."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.problem import FINAL, minimise
from circlecal.camera.spike_and_slab import Answer, Posterior, mix
from circlecal.camera.world import World
from circlecal.estimation import optima as module
from circlecal.estimation.task import Fit
from circlecal.geometry.camera_parameters import PARAMETERS
from tests.camera.test_problem import observed, plain_theta, priors, problem_of

AWAY_M = 5.0
USUAL, ANY = World("usual", False, 0.5), World("any", False, 0.5)


@pytest.fixture(scope="module")
def fits() -> tuple[Fit, Fit]:
    """Two cameras 5 m apart: the first on a field that may be of any size, the second where nothing was asked."""
    rng = np.random.default_rng(6)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, sigma=0.3), priors())
    state = minimise(problem, theta[None], FINAL)
    others = np.zeros_like(state.normal[0])
    apart = np.zeros_like(state.theta)
    apart[0, 4] = AWAY_M
    asked = Fit(problem, state, posterior=Posterior(USUAL, 0.75, others, {"usual": 0.75, "any": 0.25}))
    return asked, Fit(problem, replace(state, theta=state.theta + apart))


def choose(fits: tuple[Fit, Fit], evidence: tuple[float, float], monkeypatch, names=({}, {})) -> tuple[Any, Fit]:
    told = iter(evidence)
    monkeypatch.setattr(module, "log_evidence", lambda *given: next(told))
    tasks = [cast("Any", SimpleNamespace(template=None, number=k, names=names[k])) for k in range(2)]
    return module.choose_optimum(list(zip(tasks, fits, strict=True)), 0)


def test_shares_of_sizes_are_mixed_by_the_odds_of_the_cameras(fits, monkeypatch):
    task, fit = choose(fits, (np.log(3.0), 0.0), monkeypatch)
    assert task.number == 0
    assert fit.posterior.share == pytest.approx(0.75 * 0.75)
    assert fit.posterior.size_shares == pytest.approx({"usual": 0.75 * 0.75 + 0.25, "any": 0.75 * 0.25})
    assert sum(fit.posterior.size_shares.values()) == pytest.approx(1.0)
    assert fit.posterior.others[4, 4] > 0.25 * AWAY_M**2


def test_the_likelier_camera_is_taken_whichever_was_followed_first(fits, monkeypatch):
    task, fit = choose(fits, (0.0, np.log(3.0)), monkeypatch)
    assert task.number == 1
    assert fit.posterior.share == pytest.approx(0.75)
    assert fit.posterior.size_shares == pytest.approx({"usual": 0.75 + 0.25 * 0.75, "any": 0.25 * 0.25})


def test_an_unlikely_camera_widens_nothing(fits, monkeypatch):
    task, fit = choose(fits, (10.0, 0.0), monkeypatch)
    assert task.number == 0
    assert fit is fits[0]


def test_a_camera_on_a_field_of_another_size_is_told_as_that(fits, monkeypatch):
    other = replace(fits[1], posterior=Posterior(ANY, 1.0, np.zeros_like(fits[1].state.normal[0]), {"any": 1.0}))
    _, fit = choose((fits[0], other), (np.log(3.0), 0.0), monkeypatch)
    assert fit.posterior.resized_share == pytest.approx(0.75 * 0.25 + 0.25)


def test_two_cameras_on_fields_of_different_kinds_of_size_mix_as_their_answers_do(fits, monkeypatch):
    """Without the moment of the other one nothing asks what it would change if the field were of another size."""
    own, other = (replace(fit, posterior=posterior_on(world)) for fit, world in zip(fits, (USUAL, ANY), strict=True))
    _, fit = choose((own, other), (0.2, 0.0), monkeypatch)
    answers = [Answer(f.posterior.world, f.problem, f.state, evidence) for f, evidence in ((own, 0.2), (other, 0.0))]
    mixed = mix(answers, answers[0], own.state.theta[0])
    assert fit.posterior.resized_share == pytest.approx(mixed.resized_share) == pytest.approx(0.450, abs=1e-3)
    np.testing.assert_allclose(fit.posterior.resized, mixed.resized)
    np.testing.assert_allclose(fit.posterior.others, mixed.others)
    assert np.sqrt(fit.posterior.resized[4, 4]) == pytest.approx(AWAY_M, abs=0.1)


def posterior_on(world: World, resized_share: float = 0.0, resized_m: float = 0.0) -> Posterior:
    """Of an answer on one kind of field, and of others, so far off along x, on the other kind."""
    nothing = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    if resized_share == 0.0:
        return Posterior(world, 1.0, nothing, {world.size: 1.0})
    resized = nothing.copy()
    resized[4, 4] = resized_m**2
    shares = {world.size: 1.0 - resized_share, "any" if world is USUAL else "usual": resized_share}
    return Posterior(world, 1.0 - resized_share, resized_share * resized, shares, resized)


def test_answers_of_other_sizes_of_both_cameras_count_by_their_shares(fits, monkeypatch):
    own, other = (
        replace(fit, posterior=posterior_on(USUAL, share, away_m))
        for fit, share, away_m in zip(fits, (0.1, 0.4), (2.0, 3.0), strict=True)
    )
    _, fit = choose((own, other), (np.log(3.0), 0.0), monkeypatch)
    weights = 0.75 * 0.1, 0.25 * 0.4
    assert fit.posterior.resized_share == pytest.approx(sum(weights))
    expected = (weights[0] * 2.0**2 + weights[1] * (3.0**2 + AWAY_M**2)) / sum(weights)
    assert fit.posterior.resized[4, 4] == pytest.approx(expected)


def test_answers_of_the_other_camera_on_a_field_like_that_of_the_likelier_one_are_none_of_another_size(
    fits, monkeypatch
):
    own, other = (
        replace(fit, posterior=posterior)
        for fit, posterior in zip(fits, (posterior_on(USUAL, 0.1, 2.0), posterior_on(ANY, 0.4, 3.0)), strict=True)
    )
    _, fit = choose((own, other), (np.log(3.0), 0.0), monkeypatch)
    weights = 0.75 * 0.1, 0.25 * 0.6
    assert fit.posterior.resized_share == pytest.approx(sum(weights))
    x_variance = posterior_covariance(other.state.normal[0], other.problem.priors.sd)[4, 4]
    about_it = 0.6 * x_variance + 0.4 * 3.0**2
    expected = (weights[0] * 2.0**2 + weights[1] * (about_it + AWAY_M**2)) / sum(weights)
    assert fit.posterior.resized[4, 4] == pytest.approx(expected)


def test_two_cameras_of_which_neither_may_be_on_another_field_have_no_moment_of_such(fits, monkeypatch):
    own, other = (replace(fit, posterior=None) for fit in fits)
    _, fit = choose((own, other), (0.2, 0.0), monkeypatch)
    assert fit.posterior.resized is None
    assert fit.posterior.resized_share == 0.0


@pytest.mark.parametrize(("turns", "count"), [(True, 1), (False, 2)])
def test_the_camera_of_the_turned_field_is_no_distinct_optimum(fits, turns, count):
    """It explains the circle as well, from the other side of the field: the side that is asked for tells them apart."""
    first = fits[0]
    other = first.state.theta.copy()
    if turns:
        other[:, 4:6] *= -1.0
        other[:, 1] += np.pi
    else:
        other[:, 4] += AWAY_M
    state = replace(
        first.state.select(np.array([0, 0])),
        theta=np.concatenate([first.state.theta, other]),
        cost=first.state.cost[0] + np.array([0.0, 1.0]),
    )
    found = module.distinct_optima(first.problem, state)
    assert len(found) == count
    np.testing.assert_array_equal(found[0].theta, first.state.theta)
    np.testing.assert_array_equal(found[-1].theta, other if count == 2 else first.state.theta)


@pytest.mark.parametrize(("others", "taken"), [({1: "side_line_top"}, 0), ({1: "side_line_top", 2: "goal"}, 1)])
def test_several_more_lines_outweigh_what_noise_each_leaves(others, taken, monkeypatch, fits):
    task, _ = choose(fits, (10.0, 0.0), monkeypatch, ({}, others))
    assert task.number == taken


@pytest.mark.parametrize(("moved_m", "names", "left"), [(0.0, {}, 1), (AWAY_M, {}, 2), (0.0, {1: "side_line_top"}, 2)])
def test_an_optimum_that_has_come_to_where_the_first_one_is_is_followed_no_further(fits, moved_m, names, left):
    first = fits[0]
    apart = np.zeros_like(first.state.theta)
    apart[0, 4] = moved_m
    other = replace(first, state=replace(first.state, theta=first.state.theta + apart))
    tasks = [cast("Any", SimpleNamespace(names=given)) for given in ({}, names)]
    completed = [(fit, (task, fit)) for task, fit in zip(tasks, (first, other), strict=True)]
    assert module.leave_out_repetitions(completed) == completed[:left]
