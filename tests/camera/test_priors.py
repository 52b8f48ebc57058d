"""What other frames say of a frame, as a prior and as configuration."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from circlecal.camera.options import CameraConfig, priors_of, usual_kappa
from circlecal.camera.picture_shape import CUT_WIDTH_SQUARE
from circlecal.camera.priors import LINEAR, Priors, SharedPrior, SharedPriorConfig, ZoomLens
from circlecal.config import load_config
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1, LOG_FOCAL, PARAMETERS, ProjectionModel
from circlecal.geometry.surface import Surface
from circlecal.pipeline import field_of
from circlecal.rig.tripod import PLACE
from circlecal.tracking.tripod_fit import common_priors

from .conftest import STEPS, central_differences, random_thetas


def prior():
    names, zoomed = ("roll", "x", "y", "z", "pp_x", "kappa_1"), ("pp_x", "kappa_1")
    rng = np.random.default_rng(2)
    size = np.array([0.01, 0.2, 1.0, 0.3, 3.0, 0.002, 5.0, 0.004])
    root = rng.normal(size=(8, 8))
    covariance = np.outer(size, size) * (root @ root.T + 2 * np.eye(8))
    mean = np.array([0.0, 3.0, 62.0, -15.0, 1.0, 0.03, 4.0, 0.01])
    deviation_sd = np.array([1e-3, 0.05, 0.05, 0.05, 1.0, 0.001])
    return SharedPrior(names, zoomed, 8.0, mean, covariance, deviation_sd, LENS)


LENS = ZoomLens(0.035, 0.04, 1920)


def test_residuals_are_whitened():
    told = prior()
    rng = np.random.default_rng(0)
    mean, covariance, _ = told.at(np.array([8.3]))
    draws = rng.multivariate_normal(mean[0], covariance[0], 4000, method="cholesky")
    theta = random_thetas(1, rng).repeat(4000, axis=0)
    theta[:, 0] = 8.3
    theta[:, told.indices] = draws
    values, _ = told.residuals(theta)
    np.testing.assert_allclose(np.cov(values.T), np.eye(6), atol=0.12)


def test_a_frame_scatters_by_what_is_known_and_by_how_far_it_may_deviate():
    """At the focal length at which the parameters are quoted; away from it their changes with the zoom come on top."""
    told = prior()
    K, deviation_sd = len(told.indices), 1.0 + np.arange(len(told.indices))
    told = replace(told, deviation_sd=deviation_sd)
    _, (here, there), _ = told.at(told.log_focal + np.array([0.0, 0.5]))
    np.testing.assert_allclose(here, told.covariance[:K, :K] + np.diag(deviation_sd**2))
    np.testing.assert_allclose(np.sqrt(np.diag(here)), told.frame_sd)
    zoomed = [told.parameters.index(name) for name in told.zoomed]
    expected = here.copy()
    expected[np.ix_(zoomed, zoomed)] += 0.25 * told.covariance[K:, K:]
    expected[:, zoomed] += 0.5 * told.covariance[:K, K:]
    expected[zoomed] += 0.5 * told.covariance[K:, :K]
    np.testing.assert_allclose(there, expected)


def test_jacobian_but_for_the_spread_that_grows_with_the_zoom():
    told = prior()
    theta = random_thetas(1, np.random.default_rng(1))[0]
    theta[0] = 8.2
    _, jacobian = told.residuals(theta[None])
    numeric = central_differences(lambda t: told.residuals(t[None])[0][0], theta, STEPS)
    np.testing.assert_allclose(jacobian[0][:, 1:], numeric[:, 1:], rtol=1e-5, atol=1e-6)


def test_the_derivative_by_the_zoom_is_that_of_the_mean():
    told = prior()
    K = len(told.indices)
    covariance = told.covariance.copy()
    covariance[K:] = covariance[:, K:] = 0.0  # so the spread does not grow with the zoom
    covariance[K:, K:] = 1e-12 * np.eye(len(covariance) - K)
    told = replace(told, covariance=covariance)
    theta = random_thetas(1, np.random.default_rng(1))[0]
    theta[0] = 8.2
    _, jacobian = told.residuals(theta[None])
    numeric = central_differences(lambda t: told.residuals(t[None])[0][0], theta, STEPS)
    assert np.abs(numeric[:, 0]).max() > 0.1
    np.testing.assert_allclose(jacobian[0][:, 0], numeric[:, 0], rtol=1e-4, atol=1e-4)


def test_a_shared_prior_of_the_lens_alone_leaves_the_place_to_its_own_priors():
    template, circle = field_of(load_config())
    model = ProjectionModel(1920, 1080, Surface("roof", circle.radius_m))
    lens, whole = (SharedPriorConfig.of(told, 1920) for told in (prior().only(["pp_x", "kappa_1"]), prior()))
    usual, of_lens, of_all = (
        priors_of(CameraConfig(shared=shared), template, circle, model) for shared in (None, lens, whole)
    )
    assert of_lens.standing_m is None and np.isfinite(usual.distance_log_sd)
    assert (of_lens.distance_log_sd, of_lens.elevation_sd_rad) == (usual.distance_log_sd, usual.elevation_sd_rad)
    np.testing.assert_array_equal(of_all.standing_m, [3.0, 62.0, -15.0])
    assert not np.isfinite([of_all.distance_log_sd, of_all.elevation_sd_rad]).any()


def test_mean_follows_the_zoom():
    mean, _, slope = replace(prior(), lens=LINEAR).at(np.array([8.0, 8.5]))
    np.testing.assert_allclose(mean[1] - mean[0], 0.5 * slope[0])
    np.testing.assert_array_equal(slope[1], slope[0])
    assert slope[0, 4] == 4.0
    assert slope[0, 1] == 0.0


def test_the_lens_of_a_camera_follows_the_law_of_one_frame_where_it_is_told_nothing_else():
    """Offset and slope beside the law stay what they are, over the whole zoom and beyond it."""
    told, at = prior(), np.log([1300.0, 1900.0, 3000.0, 4400.0, 7000.0])
    mean = told.mean.copy()
    mean[5], mean[-1] = LENS.kappa(told.log_focal) + 0.004, LENS.slope(told.log_focal) - 0.006
    found, _, slope = replace(told, mean=mean).at(at)
    np.testing.assert_allclose(found[:, 5], LENS.kappa(at) + 0.004 - 0.006 * (at - told.log_focal), atol=1e-12)
    np.testing.assert_allclose(slope[:, 5], LENS.slope(at) - 0.006, atol=1e-12)
    fixed = replace(told, mean=mean).only(["x", "y"])
    np.testing.assert_allclose(fixed.at(at)[0], np.tile(mean[[1, 2]], (5, 1)))


def test_pixels_scale_with_the_width():
    told = prior()
    half = told.resize(0.5)
    theta = random_thetas(1, np.random.default_rng(1))
    smaller = theta.copy()
    smaller[:, 0] += np.log(0.5)
    smaller[:, 7:9] *= 0.5
    np.testing.assert_allclose(half.residuals(smaller)[0] ** 2 @ np.ones(6), told.residuals(theta)[0] ** 2 @ np.ones(6))


def test_marginal_of_some_parameters():
    told = prior()
    part = told.only(["x", "kappa_1"])
    assert part.parameters == ("x", "kappa_1")
    assert part.zoomed == ("kappa_1",)
    np.testing.assert_allclose(part.at(np.array([8.4]))[1][0], told.at(np.array([8.4]))[1][0][np.ix_([1, 5], [1, 5])])


def test_configuration_and_back():
    told = prior()
    written = SharedPriorConfig.of(told, 1920)
    read = SharedPriorConfig.model_validate_json(written.model_dump_json()).prior(1920)
    np.testing.assert_allclose(read.covariance, told.covariance)
    assert (read.parameters, read.zoomed) == (told.parameters, told.zoomed)
    assert written.prior(960).mean[4] == pytest.approx(0.5 * told.mean[4])
    at = np.log([1000.0, 6000.0])
    np.testing.assert_allclose(read.at(at)[0], told.at(at)[0])
    np.testing.assert_allclose(written.prior(960).at(at - np.log(2.0))[0][:, 5], told.at(at)[0][:, 5])


def test_files_of_earlier_versions_keep_their_linear_lens():
    told = prior()
    content = SharedPriorConfig.of(told, 1920).model_dump()
    del content["k1_by_focal"]
    at = np.log([1300.0, 7000.0])
    mean = SharedPriorConfig(**content).prior(1920).at(at)[0]
    np.testing.assert_allclose(mean[:, 5], told.mean[5] + told.mean[-1] * (at - told.log_focal))


@pytest.mark.parametrize(
    "change",
    [
        {"parameters": ("x", "tilt")},
        {"parameters": ("x", "x")},
        {"parameters": ("x", "y by zoom")},
        {"parameters": ("x", "roll by zoom")},
        {"parameters": ("pp_x by zoom", "pp_x")},
        {"covariance": ((1.0, 2.0), (2.0, 1.0))},
        {"mean": (1.0,)},
        {"covariance": ((1.0, 0.0), (0.5, 1.0))},
        {"covariance": ((1.0, 0.0), (0.0, 0.0))},
        {"deviation_sd": (0.1, -0.1)},
        {"deviation_sd": (0.1,)},
    ],
)
def test_contradictions_are_refused(change):
    right = {
        "width": 1920,
        "log_focal": 8.0,
        "parameters": ("x", "y"),
        "mean": (1.0, 60.0),
        "covariance": ((1.0, 0.0), (0.0, 1.0)),
        "deviation_sd": (0.0, 0.0),
    }
    SharedPriorConfig(**right)
    with pytest.raises(ValidationError):
        SharedPriorConfig(**(right | change))


@pytest.mark.parametrize(("distance_sd", "elevation_sd"), [(0.4, 0.2), (0.4, np.inf), (np.inf, 0.2), (np.inf, np.inf)])
def test_priors_of_parameters_and_place_have_the_right_derivatives_one_by_one_and_together(distance_sd, elevation_sd):
    sd = np.where(np.arange(len(PARAMETERS)) % 4 == 1, np.inf, 2.0)
    sd[11] = 0.0
    told = Priors(np.zeros(len(PARAMETERS)), sd, 80.0, distance_sd, 0.25, elevation_sd, np.array([0.5, -0.3]))
    theta = random_thetas(3, np.random.default_rng(4))
    values, jacobian = told.residuals(theta)
    assert values.shape[1] == 12 + np.isfinite(distance_sd) + np.isfinite(elevation_sd)
    for k in range(len(theta)):
        alone, by_alone = told.residuals(theta[k : k + 1])
        np.testing.assert_array_equal(alone[0], values[k])
        np.testing.assert_array_equal(by_alone[0], jacobian[k])
        numeric = central_differences(lambda t: told.residuals(t[None])[0][0], theta[k], STEPS)
        np.testing.assert_allclose(jacobian[k], numeric, rtol=1e-5, atol=1e-6)


def test_the_lens_of_a_zoom_follows_the_focal_length():
    """As single frames of real broadcasts have it: a barrel in wide views, a pincushion in long ones."""
    config, (template, circle) = CameraConfig(), field_of(load_config(None))
    model = ProjectionModel(1280, 720, surface=Surface("roof"))
    told = priors_of(config, template, circle, model)
    for widths, seen in ((0.8, -0.034), (0.95, -0.004), (1.5, 0.013), (2.0, 0.029), (3.0, 0.029)):
        assert told.usual_kappa(np.log(1280 * widths)) == pytest.approx(seen, abs=0.01)
        assert usual_kappa(config, widths) == pytest.approx(told.usual_kappa(np.log(1280 * widths)), abs=1e-12)
    assert told.usual_kappa(np.log(1280 * 0.3)) == told.usual_kappa(np.log(1280 * 0.7)), "other lenses are so wide"
    theta = random_thetas(4, np.random.default_rng(5))
    theta[:, LOG_FOCAL] = np.log(1280 * np.array([0.5, 0.9, 1.5, 3.0]))
    theta[:, INDEX["crown"]] = 0.05
    values, jacobian = told.residuals(theta)
    for k in range(len(theta)):
        numeric = central_differences(lambda t: told.residuals(t[None])[0][0], theta[k], STEPS)
        np.testing.assert_allclose(jacobian[k], numeric, rtol=1e-5, atol=1e-6)
    row = np.flatnonzero(jacobian[0][:, KAPPA_1])[0]
    usual = [told.usual_kappa(t) for t in theta[:, LOG_FOCAL]]
    np.testing.assert_allclose(values[:, row], (theta[:, KAPPA_1] - usual) / config.k1_sd, atol=1e-12)


@pytest.mark.parametrize(("left", "size"), [(0.5625, (1080, 1080)), (CUT_WIDTH_SQUARE**0.5, (1180, 707))])
def test_a_picture_that_was_cut_has_the_lens_of_the_larger_one(left, size):
    """Whose distortion is that of the focal length over its own width, and counts in half-widths of what is left."""
    config, (template, circle) = CameraConfig(), field_of(load_config(None))
    told = priors_of(config, template, circle, ProjectionModel(*size))
    for focal in np.array([0.8, 1.5, 4.0]) * size[0] / left:
        seen = left**2 * usual_kappa(config, focal * left / size[0])
        assert told.usual_kappa(np.log(focal)) == pytest.approx(seen, abs=1e-12)
        assert usual_kappa(config, focal / size[0], size) == pytest.approx(seen, abs=1e-12)
    mean, _ = common_priors(config, load_config().rig, template, size, 2.0)
    assert mean[PLACE["kappa_1"]] == pytest.approx(usual_kappa(config, 2.0, size))
    whole = CameraConfig(principal_point_sd_px=5.0)
    assert usual_kappa(whole, 4.0, size) == pytest.approx(usual_kappa(whole, 4.0))


def test_a_lens_that_is_told_follows_no_focal_length():
    config, (template, circle) = CameraConfig(k1_mean=-0.01), field_of(load_config(None))
    told = priors_of(config, template, circle, ProjectionModel(1280, 720))
    assert {told.usual_kappa(np.log(1280 * widths)) for widths in (0.8, 2.0, 4.0)} == {-0.01}
    undistorted = CameraConfig(distortion="none")
    assert priors_of(undistorted, template, circle, ProjectionModel(1280, 720)).lens is None


def test_priors_for_one_focal_length_have_the_lens_that_it_has():
    lens, one = ZoomLens(0.035, 0.04, 1920), np.ones(len(PARAMETERS))
    told = Priors(0.0 * one, one, 80.0, np.inf, 0.25, np.inf, np.zeros(2), lens=lens)
    at = told.at_focal(np.log(1920 * 1.25))
    assert at.lens is None and at.mean[KAPPA_1] == pytest.approx(0.035 - 0.04 / 1.25**2)


def test_shared_residuals_change_smoothly_with_the_zoom():
    """Their signs and their order are those of no eigenvectors, which swap as the covariance grows."""
    told, theta = prior(), random_thetas(1, np.random.default_rng(1)).repeat(200, axis=0)
    theta[:, 0] = np.linspace(7.0, 9.0, 200)
    values, _ = told.residuals(theta)
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    assert steps.max() < 0.1 * np.linalg.norm(values, axis=1).min()


def test_a_shared_prior_of_parameters_that_follow_each_other_is_told():
    told = replace(prior(), zoomed=(), mean=np.zeros(6), covariance=np.ones((6, 6)), deviation_sd=np.zeros(6))
    values, jacobian = told.residuals(random_thetas(1, np.random.default_rng(1)))
    assert np.isfinite(values).all()
    assert np.isfinite(jacobian).all()
