"""What is reported of a fit."""

import numpy as np
import pytest

from circlecal.camera.observed import curves_from_observations, points_from_observations
from circlecal.camera.options import CameraConfig, noise_model, priors_of
from circlecal.camera.problem import Problem, evaluate
from circlecal.camera.report import residuals_px
from circlecal.camera.residuals import ground_feet
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.observations import LinePoints, MarkingKey, Observations
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080, Surface("flat"))


def test_residuals_of_one_marking_count_together():
    """A touchline and, apart from it, the point where the halfway line ends on it."""
    camera = aim_camera(np.array([-4.0, 60.0, -16.0]), np.array([0.0, -10.0, 0.0]), 2600.0, 0.0, 1920, 1080)
    along = camera.project(np.stack([np.linspace(-15.0, 10.0, 99), np.full(99, -34.0)], axis=-1))
    end = camera.project(np.array([[0.0, -34.0]])) + np.array([0.0, 5.0])
    lines = tuple(LinePoints("side_line_top", p, np.full(len(p), 0.5)) for p in (along, end))
    config = CameraConfig()
    curves = curves_from_observations(Observations(1920, 1080, lines=lines), SOCCER, noise_model(config, 1920))
    priors = priors_of(config, SOCCER, SOCCER.circle_by_name["centre_circle"], MODEL)
    problem = Problem(curves, points_from_observations(Observations(1920, 1080), SOCCER), priors, MODEL)
    theta = theta_of(camera, MODEL)[None]
    state = evaluate(problem, theta, ground_feet(curves, theta, MODEL))
    assert residuals_px(problem, state) == {MarkingKey("side_line_top"): pytest.approx(0.5, abs=0.1)}
