"""From starts to optima: few points tell where to go, all points where it ends."""

import numpy as np
import pytest

from circlecal.camera.multistart import COARSE_POINTS, FEW_STARTS, best_fit
from circlecal.camera.optimise import COARSE
from circlecal.camera.options import CameraConfig
from circlecal.errors import EstimationError
from circlecal.geometry.camera_parameters import PARAMETERS

from .test_optimise import observed, plain_theta, priors, problem_of

CONFIG = CameraConfig()
NONE = np.zeros((0, len(PARAMETERS)))


def test_many_starts_end_where_the_true_one_does():
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, count=4 * COARSE_POINTS), priors(pp_x=5.0, pp_y=5.0))
    alone = best_fit(problem, theta[None], NONE, False, CONFIG, "main")
    starts = np.repeat(theta[None], 4, axis=0)
    starts[1:, :7] += np.array([0.2, 0.02, 0.02, 0.01, 4.0, 8.0, 2.0]) * rng.standard_normal((3, 7))
    many = best_fit(problem, starts[:0], starts, True, CONFIG, "main")
    assert len(many.theta) <= FEW_STARTS
    assert many.values.shape[1] == alone.values.shape[1]
    assert many.cost[0] == pytest.approx(alone.cost[0], abs=2 * COARSE)


def test_without_a_start_there_is_no_camera():
    rng = np.random.default_rng(6)
    problem = problem_of(observed(plain_theta(rng), rng), priors())
    with pytest.raises(EstimationError) as refused:
        best_fit(problem, NONE, NONE, False, CONFIG, "main")
    assert refused.value.code == "no_camera"
