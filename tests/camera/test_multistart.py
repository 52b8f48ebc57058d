"""From starts to optima: few points tell where to go, all points where it ends."""

import numpy as np
import pytest

from circlecal.camera import multistart
from circlecal.camera.multistart import COARSE_POINTS, FEW_STARTS, Starts, find_optima
from circlecal.camera.options import CameraConfig
from circlecal.camera.problem import COARSE
from circlecal.errors import EstimationError
from circlecal.geometry.camera_parameters import PARAMETERS

from .test_problem import observed, plain_theta, priors, problem_of

CONFIG = CameraConfig()
NONE = np.zeros((0, len(PARAMETERS)))


def test_many_starts_end_where_the_true_one_does():
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, count=4 * COARSE_POINTS), priors(pp_x=5.0, pp_y=5.0))
    alone = find_optima(problem, Starts(theta[None], NONE), CONFIG, "main")
    starts = np.repeat(theta[None], 4, axis=0)
    starts[1:, :7] += np.array([0.2, 0.02, 0.02, 0.01, 4.0, 8.0, 2.0]) * rng.standard_normal((3, 7))
    many = find_optima(problem, Starts(NONE, starts, follow_grid=True), CONFIG, "main")
    assert len(many.theta) <= FEW_STARTS
    assert many.values.shape[1] == alone.values.shape[1]
    assert many.cost[0] == pytest.approx(alone.cost[0], abs=2 * COARSE.tolerance)


def test_without_a_start_there_is_no_camera():
    rng = np.random.default_rng(6)
    problem = problem_of(observed(plain_theta(rng), rng), priors())
    with pytest.raises(EstimationError) as refused:
        find_optima(problem, Starts(NONE, NONE), CONFIG, "main")
    assert refused.value.code == "no_camera"


def test_a_weak_camera_is_followed_again_only_where_there_is_a_grid(monkeypatch):
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng), priors())
    followed, follow = [], multistart._follow
    monkeypatch.setattr(multistart, "WEAK_SIGMA_PX", 0.0)
    monkeypatch.setattr(multistart, "_follow", lambda *given: followed.append(len(given[1])) or follow(*given))
    find_optima(problem, Starts(theta[None], NONE), CONFIG, "main")
    assert followed == [1]
    find_optima(problem, Starts(theta[None], theta[None]), CONFIG, "main")
    assert followed == [1, 1, 2]
