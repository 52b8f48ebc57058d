"""What is reported of a fit."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.observed import curves_from_observations, points_from_observations
from circlecal.camera.options import CameraConfig, noise_model, priors_of
from circlecal.camera.problem import Problem, evaluate
from circlecal.camera.report import _miss_ends, bulk_residuals_px, residuals_px, spread_quadrilateral, weigh_painters
from circlecal.camera.residuals import ground_feet
from circlecal.evaluation.bench.scenarios import select_rows
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.observations import LinePoints, MarkingKey, Observations
from circlecal.results import PaintersFit
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080, Surface("flat"))


@pytest.mark.parametrize(("off_px", "stated", "missed"), [(1.0, False, 0), (80.0, False, 1), (80.0, True, 0)])
def test_an_end_that_the_loss_leaves_no_say_is_no_marking_that_was_seen(off_px, stated, missed):
    """It stood among the residuals with up to 25,456 px, and confirmed cameras that it contradicts."""
    camera = aim_camera(np.array([-4.0, 60.0, -16.0]), np.array([0.0, -10.0, 0.0]), 2600.0, 0.0, 1920, 1080)
    end = camera.project(np.array([[0.0, -34.0]])) + np.array([0.0, off_px])
    line = LinePoints("side_line_top", end, np.full(1, 1.0))
    config = CameraConfig()
    curves = curves_from_observations(Observations(1920, 1080, lines=(line,)), SOCCER, noise_model(config, 1920))
    priors = priors_of(config, SOCCER, SOCCER.circle_by_name["centre_circle"], MODEL)
    nothing = points_from_observations(Observations(1920, 1080), SOCCER)
    problem = Problem(curves, nothing, priors, MODEL, config.loss_scale)
    theta = theta_of(camera, MODEL)[None]
    state = evaluate(problem, theta, ground_feet(curves, theta, MODEL))
    key = MarkingKey("side_line_top")
    found = _miss_ends(problem, state, {key} if stated else ())
    assert len(found) == missed and all(off == pytest.approx(off_px, rel=0.05) for off in found.values())


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


@pytest.mark.parametrize(("strays", "is_left_out"), [(0, True), (5, True), (6, True), (12, False)])
def test_bulk_of_a_marking_leaves_out_a_few_points_that_stand_apart(strays, is_left_out):
    """Points of a touchline with 0.4 px of noise, and some measured on a player, 10 px off."""
    camera = aim_camera(np.array([-4.0, 60.0, -16.0]), np.array([0.0, -10.0, 0.0]), 2600.0, 0.0, 1920, 1080)
    along = camera.project(np.stack([np.linspace(-15.0, 10.0, 200), np.full(200, -34.0)], axis=-1))
    along[:, 1] += np.random.default_rng(1).normal(0.0, 0.4, 200)
    along[:strays, 1] += 10.0
    lines = (LinePoints("side_line_top", along, np.full(200, 0.5)),)
    config = CameraConfig()
    curves = curves_from_observations(Observations(1920, 1080, lines=lines), SOCCER, noise_model(config, 1920))
    priors = priors_of(config, SOCCER, SOCCER.circle_by_name["centre_circle"], MODEL)
    problem = Problem(curves, points_from_observations(Observations(1920, 1080), SOCCER), priors, MODEL)
    theta = theta_of(camera, MODEL)[None]
    state = evaluate(problem, theta, ground_feet(curves, theta, MODEL))
    key = MarkingKey("side_line_top")
    if strays == 0:
        assert bulk_residuals_px(problem, state)[key] == residuals_px(problem, state)[key]
    else:
        assert residuals_px(problem, state)[key] > 1.4
        assert (bulk_residuals_px(problem, state)[key] < 0.5) == is_left_out


def test_region_of_short_arcs_holds_the_truth():
    """Zoom can stand for distance there: in the entries of H the truth lay in the 90 % region in two of three draws."""
    (scenario,) = select_rows(["8c"])
    draws = [scenario.draw(np.random.default_rng([3, index])) for index in range(24)]
    distances = []
    for draw in draws:
        fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
        assert fit.region is not None
        assert fit.region.directions == 7
        assert fit.region.distance(fit.H_image_field) == pytest.approx(0.0, abs=1e-9)
        distances.append(fit.region.distance(draw.camera.homography))
    # of a chi-square variable with 7 degrees of freedom: median 6.35, 90 % below 12.0
    assert np.sum(np.array(distances) < 12.017) >= 18
    assert 3.5 < np.median(distances) < 9.0


@pytest.mark.filterwarnings("error")
def test_a_camera_that_painters_leave_open_is_told_as_that_without_a_warning():
    (scenario,) = select_rows(["8c"])
    draw = scenario.draw(np.random.default_rng([3, 0]))
    fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
    wide = np.diag(np.where(np.diag(fit.covariance) > 0.0, 1e12, 0.0))
    open_to = replace(fit, painters=PaintersFit(fit.theta, wide, fit.residuals_px, fit.point_residuals_px))
    assert weigh_painters(open_to, scenario.circle, scenario.template).max_sigma_px > 1e4


def test_four_points_of_a_region_lie_far_apart():
    grid = np.stack(np.meshgrid(np.arange(0.0, 160.0, 10.0), np.arange(0.0, 90.0, 10.0)), axis=-1).reshape(-1, 2)
    corners = grid[spread_quadrilateral(grid)]
    assert sorted(map(tuple, corners.tolist())) == [(0.0, 0.0), (0.0, 80.0), (150.0, 0.0), (150.0, 80.0)]
    triangle = grid[grid[:, 0] <= 1.8 * grid[:, 1]]
    a, b, c, d = triangle[spread_quadrilateral(triangle)]
    for p, q, r in ((a, b, c), (a, b, d), (a, c, d), (b, c, d)):
        assert abs(np.linalg.det(np.stack([q - p, r - p]))) > 2000.0


def test_a_hall_field_whose_size_is_free_tells_it():
    """Where no rule leaves a field a choice of sizes, the user may: its length stood in the table as 40 m."""
    fixed = {"length_range_m": None, "width_range_m": None}
    free = load_field("futsal").model_copy(update={"length_sd_m": 1.0, **fixed})
    longer = load_field("futsal", {"length": 40.8})
    circle = free.circle_by_name[free.default_circle]
    camera = aim_camera(np.array([3.0, 20.0, -9.0]), np.array([0.0, 0.0, 0.0]), 900.0, 0.0, 1280, 720)
    rng = np.random.default_rng(2)
    names = ("halfway_line", "side_line_top", "side_line_left", "side_line_right")
    lines = tuple(line_points(camera, longer, name, 60, 0.3, rng) for name in names)
    ring = circle_points(camera, longer, "center", 200, 0.3, rng, circle=circle.name)
    seen = Observations(1280, 720, (ring,), lines)
    fit = estimate_camera(seen, free, circle, CameraConfig(crown_shape="flat", distortion="none"))
    size, place = fit.field_size, INDEX["length"]
    assert size.is_usual and size.usual_share == 1.0
    assert size.length_m == pytest.approx(40.0 + fit.theta[place])
    assert size.length_sd_m == pytest.approx(np.sqrt(fit.covariance[place, place]))
    # painters' errors, which move the camera, move the size with it
    moved = fit.theta.copy()
    moved[place] += 0.3
    painters = PaintersFit(moved, np.zeros_like(fit.covariance), {}, {})
    weighed = weigh_painters(replace(fit, painters=painters), circle, free)
    assert weighed.field_size.length_m == pytest.approx(size.length_m + 0.3)
