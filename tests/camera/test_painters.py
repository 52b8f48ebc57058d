"""Markings that lie elsewhere than the template has them."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera import painters
from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.options import priors_of
from circlecal.camera.painters import follow_errors, measure_displacements, weigh_errors
from circlecal.camera.problem import Problem, minimise
from circlecal.config import load_config
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, project, theta_of
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points
from circlecal.synthetic.painters import displace_markings

from .test_problem import MODEL, SOCCER, observed, plain_theta, priors, problem_of

WIDE = aim_camera(np.array([-4.0, 62.0, -17.0]), np.array([4.0, -4.0, 0.0]), 1700.0, 0.01, 1920, 1080)
FLAT = ProjectionModel(1920, 1080, Surface())


def test_markings_that_lie_elsewhere_move_the_camera_as_far_as_its_covariance_says():
    theta = plain_theta(np.random.default_rng(4))
    seen, chosen = observed(theta, np.random.default_rng(5), sigma=0.05), priors()
    base = problem_of(seen, chosen, loss_scale=np.inf)
    state = minimise(base, theta[None])
    step_m = 1e-3
    grid = np.stack(np.meshgrid(np.linspace(-12, 12, 5), np.linspace(-12, 12, 5)), axis=-1).reshape(-1, 2)

    def pixels(parameters):
        return project(parameters[None], grid[None], MODEL).pixels[0].ravel()

    moved, residuals = [], []
    for name in ("centre_circle", "halfway_line", "centre_mark"):
        for shift in ((step_m, 0.0), (0.0, step_m)):
            template = SOCCER.move_markings(
                lambda other, name=name, shift=shift: shift if other == name else (0.0, 0.0)
            )
            curves = curves_from_observations(seen, template, NoiseModel(10**6, 0.0, 0.0))
            problem = replace(base, curves=curves, points=points_from_observations(seen, template))
            there = minimise(problem, state.theta)
            moved.append(pixels(there.theta[0]) - pixels(state.theta[0]))
            residuals.append((there.values - state.values)[0, : len(base.curves.sigma_px)] * base.curves.sigma_px)
    expected = (np.array(moved) ** 2).sum(axis=0)
    covariance = posterior_covariance(state.normal[0], chosen.sd)
    added = follow_errors(base, state, covariance, SOCCER.model_copy(update={"placement_sd_m": step_m}))
    by_theta = project(state.theta[:1], grid[None], MODEL).jacobians()[0][0].reshape(-1, len(PARAMETERS))
    np.testing.assert_allclose(((by_theta @ added.covariance) * by_theta).sum(axis=1), expected, rtol=0.05, atol=1e-5)
    squared = (np.array(residuals) ** 2).sum(axis=0)
    for group, key in enumerate(base.curves.keys):
        own = base.curves.group == group
        assert added.residual_px[key] == pytest.approx(np.sqrt(squared[own].mean()), rel=0.05)
    assert follow_errors(base, state, covariance, SOCCER) is None


def test_paint_that_wanders_all_around_a_circle_is_a_larger_circle(monkeypatch):
    theta = plain_theta(np.random.default_rng(4))
    seen, chosen = observed(theta, np.random.default_rng(5), sigma=0.05), priors()
    seen = replace(seen, marks=())
    base = problem_of(seen, chosen, loss_scale=np.inf)
    state = minimise(base, theta[None])
    step_m = 1e-3
    straight, across = base.curves.straight, np.array([step_m, 0.0])
    curves = replace(base.curves, radius=np.where(straight, 0.0, base.curves.radius + step_m))
    larger = minimise(replace(base, curves=curves), state.theta).theta[0]
    beside = replace(base.curves, origin=base.curves.origin + straight[:, None] * across)
    moved = minimise(replace(base, curves=beside), state.theta).theta[0]
    covariance = posterior_covariance(state.normal[0], chosen.sd)
    wandering = SOCCER.model_copy(update={"wander_sd_m": step_m})
    monkeypatch.setattr(painters, "PIECE_M", 1e3)
    added = follow_errors(base, state, covariance, wandering).covariance
    grid = np.array([[10.0, 0.0], [-10.0, 5.0], [0.0, -12.0], [0.0, 12.0]])
    pixels = [project(t[None], grid[None], MODEL).pixels[0].ravel() for t in (state.theta[0], larger, moved)]
    by_theta = project(state.theta[:1], grid[None], MODEL).jacobians()[0][0].reshape(-1, len(PARAMETERS))
    expected = (pixels[1] - pixels[0]) ** 2 + (pixels[2] - pixels[0]) ** 2
    np.testing.assert_allclose(((by_theta @ added) * by_theta).sum(axis=1), expected, rtol=0.05, atol=1e-5)
    # pieces that wander each for itself do so less together
    monkeypatch.setattr(painters, "PIECE_M", 0.5)
    pieces = follow_errors(base, state, covariance, wandering).covariance
    assert np.trace(by_theta @ pieces @ by_theta.T) < 0.5 * np.trace(by_theta @ added @ by_theta.T)


PAINTED_SD_M = 0.04
"""Of the displaced markings: many times what noise leaves of them."""


def draw_painted(seed, names=("side_line_top", "big_rect_right_main")):
    """A camera, the fit to markings that were painted elsewhere, its problem, and the template that knows it."""
    rng = np.random.default_rng(seed)
    painted = SOCCER.model_copy(update={"placement_sd_m": PAINTED_SD_M})
    moved = displace_markings(painted, rng)
    circle = circle_points(WIDE, moved, "center", 200, 0.05, rng)
    lines = tuple(line_points(WIDE, moved, name, 60, 0.05, rng) for name in ("halfway_line", *names))
    seen = Observations(1920, 1080, (circle,), lines)
    start = theta_of(WIDE, FLAT)
    chosen = replace(priors(), distance_log_sd=np.inf, elevation_sd_rad=np.inf)
    problem = replace(problem_of(seen, chosen, loss_scale=np.inf), model=FLAT)
    return problem, minimise(problem, start[None]), painted


def test_a_painters_error_moves_a_marking_across_itself_by_so_many_pixels():
    problem, state, painted = draw_painted(0)
    moved_px = measure_displacements(problem, state, painted)
    number = next(k for k, key in enumerate(problem.curves.keys) if key.name == "side_line_top")
    seen = problem.curves.points_px[problem.curves.group == number]
    ground = np.linspace(seen[0], seen[-1], 30)
    places = np.stack([np.zeros(30), np.full(30, -SOCCER.width_m / 2)], axis=-1)
    places[:, 0] = np.linspace(*WIDE.back_project(ground[[0, -1]])[:, 0], 30)
    shifted = WIDE.project(places + np.array([0.0, PAINTED_SD_M])) - WIDE.project(places)
    along = WIDE.project(places + np.array([0.1, 0.0])) - WIDE.project(places)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.linalg.norm(along, axis=1, keepdims=True)
    assert moved_px[number] == pytest.approx(np.sqrt(np.mean((shifted * normal).sum(axis=1) ** 2)), rel=0.1)
    assert not measure_displacements(problem, state, SOCCER).any()


GRID = np.stack(np.meshgrid(np.linspace(-20, 20, 9), np.linspace(-30, 20, 9)), axis=-1).reshape(-1, 2)


def error_px(theta):
    """Differences (81, 2) from the true camera over the field, pixels."""
    return project(theta[None], GRID[None], FLAT).pixels[0] - WIDE.project(GRID)


def test_a_fit_that_weighs_painters_errors_is_nearer_to_the_truth_and_knows_how_near():
    names = ("side_line_top", "big_rect_right_main", "big_rect_right_top", "big_rect_left_top")
    plain, weighed, inside = [], [], []
    for seed in range(40):
        problem, state, painted = draw_painted(seed, names)
        found, added = weigh_errors(problem, state, painted)
        plain.append(np.sqrt(np.mean(error_px(state.theta[0]) ** 2)))
        off = error_px(found.theta[0])
        weighed.append(np.sqrt(np.mean(off**2)))
        covariance = posterior_covariance(state.normal[0], problem.priors.sd) + added
        by_theta = project(found.theta[:1], GRID[None], FLAT).jacobians()[0][0]
        spread = by_theta @ covariance @ np.swapaxes(by_theta, 1, 2)
        inside.append(np.mean(np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off) < 4.605))
    assert np.median(weighed) < 0.75 * np.median(plain)
    assert np.mean(np.array(weighed) < plain) > 0.75
    # of the points 90 % lie in their regions, and points of one frame do so together
    assert 0.8 < np.mean(inside) < 0.97


def test_small_painters_errors_leave_the_fit_where_it_is():
    problem, state, painted = draw_painted(3)
    found, added = weigh_errors(problem, state, painted.model_copy(update={"placement_sd_m": 1e-6}))
    np.testing.assert_allclose(error_px(found.theta[0]), error_px(state.theta[0]), atol=0.02)
    assert np.abs(added).max() < 1e-3 * np.abs(posterior_covariance(state.normal[0], problem.priors.sd)).max()


def test_radii_that_are_all_larger_are_one_error():
    """Two circles 4 cm larger than the rules have them, and two lines where they belong."""
    rink = load_field("ice-hockey").model_copy(update={"marking_width_sd_m": 0.0})
    rng = np.random.default_rng(7)
    view = aim_camera(np.array([-18.0, 34.0, -11.0]), np.array([-20.0, 0.0, 0.0]), 1500.0, 0.0, 1920, 1080)
    drawn = rink.move_markings(lambda _: (0.0, 0.0), lambda _: 0.04)
    circles = ("faceoff_left_top", "faceoff_left_bottom")
    seen = Observations(
        1920,
        1080,
        tuple(circle_points(view, drawn, "center", 200, 0.1, rng, circle=name) for name in circles),
        tuple(line_points(view, drawn, name, 60, 0.1, rng) for name in ("goal_line_left", "blue_line_left")),
    )
    model = ProjectionModel(1920, 1080, Surface())
    chosen = priors_of(load_config(None, ["field.template=ice-hockey"]).camera, rink, rink.circles[1], model)
    curves = curves_from_observations(seen, rink, NoiseModel(10**6, 0.0, 0.0))
    problem = Problem(curves, points_from_observations(seen, rink), chosen, model)
    state = minimise(problem, theta_of(view, model)[None])
    known = rink.model_copy(update={"placement_sd_m": 0.003})
    found, _ = weigh_errors(problem, state, known)
    ignorant, _ = weigh_errors(problem, state, known.model_copy(update={"radius_sd_m": 0.0}))
    there = np.array([[-26.0, -6.0], [-26.0, 6.0], [-12.0, 0.0], [-18.0, 10.0]])
    errors = [
        np.linalg.norm(project(theta[None], there[None], model).pixels[0] - view.project(there), axis=1).mean()
        for theta in (state.theta[0], ignorant.theta[0], found.theta[0])
    ]
    assert errors[2] < 0.5 * min(errors[0], errors[1])


def test_a_step_that_leads_nowhere_leaves_the_fit_where_it_is(monkeypatch):
    theta = plain_theta(np.random.default_rng(4))
    seen, chosen = observed(theta, np.random.default_rng(5), sigma=0.05), priors()
    base = problem_of(seen, chosen, loss_scale=np.inf)
    state = minimise(base, theta[None])
    nowhere = replace(state, values=np.full_like(state.values, np.nan), jacobian=np.full_like(state.jacobian, np.nan))
    monkeypatch.setattr(Problem, "follow", lambda self, state, step: nowhere)
    found, added = weigh_errors(base, state, SOCCER.model_copy(update={"placement_sd_m": 0.02}))
    np.testing.assert_array_equal(found.theta[0], state.theta[0])
    assert np.isfinite(added).all()
