"""From starts to optima: few points tell where to go, all points where it ends."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera import multistart
from circlecal.camera.multistart import COARSE_POINTS, FEW_STARTS, Starts, find_optima
from circlecal.camera.options import CameraConfig
from circlecal.camera.problem import COARSE
from circlecal.errors import EstimationError
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, project

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


def test_a_start_is_screened_by_how_many_pixels_off_its_points_lie_however_uneven_the_ground():
    """A mark below its place counts by its distance, and not by a fifth of it since the ground may be uneven there."""
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    mark_alone = replace(observed(theta, rng, sigma=0.0), circles=(), lines=())
    problem = problem_of(mark_alone, priors(x=100.0, y=100.0, z=100.0, roll=10.0))
    problem = replace(problem, points=replace(problem.points, sigma_px=np.ones(1), upright_px=np.full(1, 8.0)))
    focal_px = np.exp(theta[0])
    grid = np.repeat(theta[None], 2, axis=0)
    grid[0, INDEX["tilt"]] += 40.0 / focal_px
    grid[1, INDEX["pan"]] += 12.0 / focal_px / np.sin(theta[INDEX["tilt"]])
    off_px = project(grid, np.zeros((2, 1, 2)), problem.model).pixels[:, 0] - problem.points.points_px
    assert np.abs(off_px[0]) == pytest.approx([0.0, 40.0], abs=1.5)
    assert np.abs(off_px[1]) == pytest.approx([12.0, 0.0], abs=1.5)
    np.testing.assert_array_equal(multistart._screen(problem, grid, 1), grid[1:])
