"""From the covariance of the camera to that of what follows from it."""

import numpy as np
import pytest

from circlecal.camera.covariance import (
    correlation_factor,
    count_from_seen,
    data_share,
    homography_vectors,
    imaged_points,
    posterior_covariance,
    push_forward,
    spread_cameras,
)
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, camera_of, homographies, project
from circlecal.geometry.projective import apply_homography
from circlecal.geometry.surface import Surface

from .conftest import random_thetas

MODEL = ProjectionModel(1920, 1080, Surface("flat"))
SIZE = len(PARAMETERS)


def small_covariance(rng):
    """A covariance (P, P) of realistic sizes for focal length, angles and position; the rest is fixed."""
    scale = np.array([1e-4, 1e-4, 1e-4, 1e-4, 0.02, 0.02, 0.02])
    mix = rng.standard_normal((7, 7)) * scale[:, None]
    covariance = np.zeros((SIZE, SIZE))
    covariance[:7, :7] = mix @ mix.T
    return covariance


def samples_of(theta, covariance, count, rng):
    values, vectors = np.linalg.eigh(covariance)
    return theta + rng.standard_normal((count, SIZE)) @ (vectors * np.sqrt(np.maximum(values, 0))).T


def plain_theta(seed):
    theta = random_thetas(1, np.random.default_rng(seed))[0]
    theta[7:] = 0.0
    return theta


def test_covariance_is_the_inverse_over_what_is_free():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((SIZE, SIZE)) * 10.0 ** rng.uniform(-3, 3, SIZE)
    normal = root.T @ root
    sd = np.ones(SIZE)
    sd[[3, 9]] = 0.0
    covariance = posterior_covariance(normal, sd)
    free = np.flatnonzero(sd)
    product = covariance[np.ix_(free, free)] @ normal[np.ix_(free, free)]
    np.testing.assert_allclose(product, np.eye(len(free)), atol=1e-5)
    assert (covariance[[3, 9]] == 0).all()
    assert (covariance[:, [3, 9]] == 0).all()


def test_a_direction_that_nothing_determines_costs_no_other_its_uncertainty():
    """Two parameters that only their sum is known of beside two that are all but one: these stay as uncertain."""
    normal, nearly = np.zeros((SIZE, SIZE)), 1.0 - 1e-8
    normal[:2, :2] = 1.0
    normal[2:4, 2:4] = [[1.0, nearly], [nearly, 1.0]]
    covariance = posterior_covariance(normal, np.r_[np.ones(4), np.zeros(SIZE - 4)])
    np.testing.assert_allclose(covariance[:2, :2], 0.25, atol=1e-6)
    assert covariance[2, 2] == pytest.approx(1.0 / (1.0 - nearly**2), rel=1e-3)


def test_covariances_of_several_matrices_are_those_of_each():
    """One of which is singular, and does not take the others' precision with it."""
    rows = np.random.default_rng(2).normal(size=(3, 2 * SIZE, SIZE))
    rows[1, :, 4] = rows[1, :, 5]
    normals, sd = rows.swapaxes(1, 2) @ rows, np.r_[np.full(SIZE - 1, np.inf), 0.0]
    alone = np.array([posterior_covariance(normal, sd) for normal in normals])
    np.testing.assert_array_equal(posterior_covariance(normals, sd), alone)
    assert np.isfinite(alone).all()


def test_pushed_forward_covariances_are_those_of_samples():
    rng = np.random.default_rng(2)
    theta, covariance = plain_theta(2), small_covariance(rng)
    samples = samples_of(theta, covariance, 6000, rng)
    spread = spread_cameras(theta, covariance, np.zeros(2))
    for function in (
        lambda t: imaged_points(homographies(t, MODEL), np.array([[3.0, -4.0]]))[:, 0],
        lambda t: homography_vectors(homographies(t, MODEL)),
    ):
        predicted = push_forward(function(theta[None])[0], function(spread))
        drawn = np.cov(function(samples).T)
        ratio = np.sqrt(np.diag(drawn) / np.diag(predicted))
        assert (np.abs(ratio - 1) < 0.06).all(), ratio


def test_spread_cameras_hold_the_covariance():
    """A linear function of the parameters gets its exact covariance, wherever the directions are straight."""
    rng = np.random.default_rng(9)
    theta, covariance = plain_theta(9), small_covariance(rng)
    spread = spread_cameras(theta, covariance, np.zeros(2))
    found = push_forward(theta, spread)
    scale = np.sqrt(np.diag(covariance)[:7])
    departure = (found - covariance)[:7, :7] / np.outer(scale, scale)
    assert np.abs(departure).max() < 1e-2
    assert (found[7:] == 0).all()


def test_field_sigma_is_the_length_of_the_error_in_the_picture_and_on_the_ground():
    rng = np.random.default_rng(3)
    theta, covariance = plain_theta(3), small_covariance(rng)
    field = np.array([[0.0, 0.0], [12.0, -9.0], [-10.0, 8.0]])
    sigma_px, sigma_m = project(theta[None], field[None], MODEL).sigma(covariance)
    samples = samples_of(theta, covariance, 3000, rng)
    truth = project(theta[None], field[None], MODEL).pixels[0]
    seen = project(samples, np.broadcast_to(field, (len(samples), 3, 2)), MODEL).pixels
    np.testing.assert_allclose(np.sqrt(((seen - truth) ** 2).sum(-1).mean(0)), sigma_px, rtol=0.06)
    ground = np.array([camera_of(t, MODEL).back_project(truth) for t in samples])
    np.testing.assert_allclose(np.sqrt(((ground - field) ** 2).sum(-1).mean(0)), sigma_m, rtol=0.06)


def test_homographies_and_their_points_are_those_of_the_cameras():
    thetas = random_thetas(3, np.random.default_rng(4))
    H, points = homographies(thetas, MODEL), np.array([[2.0, 5.0], [-3.0, 1.0]])
    for theta, vector, pixels in zip(thetas, homography_vectors(H), imaged_points(H, points), strict=True):
        expected = camera_of(theta, MODEL).homography
        np.testing.assert_allclose(np.append(vector, 1.0).reshape(3, 3), expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(pixels, apply_homography(expected, points))


def test_cameras_that_lose_a_point_leave_it_to_the_others():
    values = np.array([[1.0, 0.0], [-1.0, 0.0], [np.nan, 0.0], [0.0, np.inf]])
    np.testing.assert_allclose(push_forward(np.zeros(2), values), [[4 / 6, 0.0], [0.0, 0.0]])


@pytest.mark.parametrize(("prior_weight", "low", "high"), [(0.0, 1.0, 1.0), (1.0, 0.49, 0.51), (99.0, 0.009, 0.011)])
def test_data_share_is_the_share_of_the_precision(prior_weight, low, high):
    theta = plain_theta(5)
    precision = np.linalg.pinv(small_covariance(np.random.default_rng(6)))
    prior = prior_weight * precision
    covariance = np.linalg.pinv(precision + prior, rcond=1e-30)
    seen = project(theta[None], np.array([[[5.0, 5.0], [-5.0, 2.0]]]), MODEL)
    found = data_share(seen, covariance, prior)
    assert low - 1e-6 <= found <= high + 1e-6


def test_data_share_of_a_well_and_a_badly_seen_direction():
    theta = plain_theta(7)
    by_data, by_prior = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    by_data[INDEX["pan"], INDEX["pan"]] = 1e8
    by_prior[INDEX["roll"], INDEX["roll"]] = 1e2
    covariance = np.zeros((SIZE, SIZE))
    covariance[1, 1], covariance[3, 3] = 1e-8, 1e-2
    seen = project(theta[None], np.array([[[9.0, 0.0]]]), MODEL)
    assert data_share(seen, covariance, by_prior) < 0.1


def test_correlation_factor_counts_repeats():
    rng = np.random.default_rng(8)
    white = rng.standard_normal(600)
    assert 1.0 <= correlation_factor(white) < 1.4
    smooth = np.convolve(rng.standard_normal(620), np.ones(10) / 10, mode="valid")
    # a running mean over ten is ten values that repeat each other
    assert 6.0 < correlation_factor(smooth) < 14.0
    # of few values as well, whose first quarter of lags is looked at
    short = [correlation_factor(smooth[start : start + 60]) for start in range(0, 540, 20)]
    assert 7.0 < np.mean(short) < 10.0
    assert correlation_factor(white[:10]) == 1.0
    assert correlation_factor(np.zeros(100)) == 1.0


def test_homographies_of_cameras_level_with_the_origin_say_nothing():
    """Their last entry is 0; pushed forward, they are left to the others."""
    H = np.stack([np.eye(3), np.diag([1.0, 1.0, 0.0]), np.diag([1e200, 1.0, 1e-200]), np.eye(3) + 0.1])
    vectors = homography_vectors(H)
    assert np.isfinite(vectors[[0, 3]]).all() and not np.isfinite(vectors[1:3]).all(axis=1).any()
    assert np.isfinite(push_forward(vectors[0], vectors[1:])).all()


def test_places_counted_from_what_was_seen_do_not_ask_how_long_the_field_is():
    """A camera that stands fast beside one end of a field of unknown length: half the length is in its place only."""
    rng = np.random.default_rng(12)
    beside, length_sd, breadth_sd = small_covariance(rng), 3.0, 2.0
    by_growth = np.array([0.5, -0.5])
    length, breadth = INDEX["length"], INDEX["breadth"]
    moves = np.eye(SIZE)
    moves[INDEX["x"], length], moves[INDEX["y"], breadth] = by_growth
    beside[length, length], beside[breadth, breadth] = length_sd**2, breadth_sd**2
    turn = count_from_seen(by_growth)
    counted = turn @ (moves @ beside @ moves.T) @ turn.T
    np.testing.assert_allclose(counted, beside, atol=1e-12)
    assert (moves @ beside @ moves.T)[INDEX["x"], INDEX["x"]] > 0.25 * length_sd**2
    np.testing.assert_allclose(np.linalg.inv(turn), 2.0 * np.eye(SIZE) - turn, atol=1e-15)
