"""The maximum a posteriori camera under noise: efficient, and honest about its error."""

import numpy as np
import pytest

from circlecal.evaluation.bench.accuracy import mahalanobis
from circlecal.evaluation.bench.bounds import bound_covariance, bound_errors
from circlecal.evaluation.bench.reprojection import grid_in_view
from circlecal.evaluation.bench.scenarios import KNOWN, Draw, select_rows
from circlecal.geometry.camera_parameters import ProjectionModel, theta_of
from circlecal.geometry.homography import transfer_errors
from circlecal.geometry.surface import Surface
from circlecal.stages.camera import estimate_camera

from .camera_views import CIRCLE, EXACT, MAIN, SOCCER, WIDE, seen


@pytest.fixture(scope="module")
def pooled():
    """Errors over bounds, and draws inside the 90 % regions, of several rows of the benchmark: 48 draws in all."""
    ratios, inside = [], {}
    for name in ("5", "6", "17"):
        scenario = next(s for s in select_rows([name]) if s.row == name)
        for index in range(16):
            rng = np.random.default_rng([11, index])
            draw = scenario.draw(rng)
            grid = grid_in_view(draw.camera, scenario.template)
            fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
            bound = bound_errors(draw.camera, bound_of(draw, scenario), grid, 200, rng).mean()
            error = transfer_errors(fit.H_image_field, grid, draw.camera.project(grid)).mean()
            ratios.append(error / bound)
            for quantity, held in mahalanobis(draw, fit, scenario.circle).items():
                inside.setdefault(quantity, []).append(held)
    return np.array(ratios), inside


def bound_of(draw: Draw, scenario):
    return bound_covariance(draw.camera, 0.0, draw.observations, scenario.template, scenario.circle, draw.config)


def test_error_is_that_of_the_bound_from_both_sides(pooled):
    """Clearly better than the bound would be a bug, too: of the noise, of the bound, or of the truth that leaks in."""
    ratios, _ = pooled
    assert 0.85 < ratios.mean() < 1.15
    # nor by a few good and many bad draws
    assert 0.6 < np.median(ratios) < 1.1


def test_parameters_scatter_as_their_covariance_says():
    """Twenty noises on one view: chi-square of seven degrees of freedom each, so their mean is 7 +- 0.85."""
    truth = theta_of(WIDE, ProjectionModel(WIDE.width, WIDE.height, Surface("flat")))[:7]
    distances, errors = [], []
    for seed in range(20):
        given = seen(WIDE, lines=("side_line_top", "big_rect_left_main"), mark=True, sigma=0.3, seed=seed, count=80)
        fit = estimate_camera(given, SOCCER, CIRCLE, EXACT)
        scale = np.sqrt(np.diag(fit.covariance)[:7])
        error = (fit.theta[:7] - truth) / scale
        distances.append(error @ np.linalg.solve(fit.covariance[:7, :7] / np.outer(scale, scale), error))
        errors.append(error)
    assert 4.6 < np.mean(distances) < 9.6
    assert (np.abs(np.mean(errors, axis=0)) < 0.8).all()


def test_ninety_percent_regions_hold_about_ninety_percent(pooled):
    _, inside = pooled
    assert {"homography", "imaged centre", "position", "point right", "point top_left"} <= set(inside)
    for quantity in ("homography", "imaged centre", "position"):
        assert 0.80 <= np.mean(inside[quantity]) <= 0.99, quantity
    points = [np.mean(held) for quantity, held in inside.items() if quantity.startswith("point ")]
    assert len(points) == 8
    assert 0.82 <= np.mean(points) <= 0.97


def test_reported_sigma_grows_with_the_noise_and_falls_with_the_number_of_points():
    def sigma(noise, count):
        given = seen(MAIN, edges=("outer", "inner"), sigma=noise, count=count)
        return estimate_camera(given, SOCCER, CIRCLE, EXACT).max_sigma_px

    base = sigma(0.3, 100)
    assert 1.6 < sigma(0.6, 100) / base < 2.4
    assert 0.4 < sigma(0.3, 400) / base < 0.75


def test_known_position_helps():
    plain = estimate_camera(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, KNOWN)
    told = KNOWN.model_copy(update={"position_m": tuple(MAIN.position_m), "position_sd_m": (0.1, 0.1, 0.1)})
    better = estimate_camera(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, told)
    assert better.max_sigma_px < 0.7 * plain.max_sigma_px
    assert better.data_share < plain.data_share


def test_few_and_noisy_points_are_prior_dominated():
    certain = estimate_camera(seen(MAIN, edges=("outer", "inner"), mark=True, sigma=0.3), SOCCER, CIRCLE, KNOWN)
    assert certain.data_share > 0.8
    assert not certain.prior_dominated
    vague = estimate_camera(seen(MAIN, sigma=15.0, count=10), SOCCER, CIRCLE, KNOWN)
    assert vague.data_share < 0.5
    assert vague.prior_dominated
