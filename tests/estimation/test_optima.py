"""Two cameras that explain a frame alike: how the likelier one is widened by the other."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from circlecal.camera.problem import FINAL, minimise
from circlecal.camera.spike_and_slab import Posterior
from circlecal.camera.world import World
from circlecal.estimation import optima as module
from circlecal.estimation.task import Fit
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
