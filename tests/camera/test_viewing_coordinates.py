"""Viewing coordinates: exact inverse of each other, right derivative, and the optimiser's use of them."""

import numpy as np
import pytest

from circlecal.camera.viewing_coordinates import (
    LEAST_BEFORE,
    VIEWING,
    from_viewing,
    to_viewing,
    to_viewing_with_jacobian,
    viewing_jacobian,
)
from circlecal.geometry.camera_parameters import PARAMETERS


def _cameras(rng, count=20, azimuth=0.0):
    theta = np.zeros((count, len(PARAMETERS)))
    theta[:, 0] = rng.uniform(7.2, 9.0, count)
    theta[:, 1] = -azimuth + rng.normal(0, 0.15, count)
    theta[:, 2] = rng.uniform(1.15, 1.45, count)
    theta[:, 3] = rng.normal(0, 0.05, count)
    direction = np.stack([np.sin(azimuth) * np.ones(count), np.cos(azimuth) * np.ones(count)], axis=-1)
    theta[:, 4:6] = direction * rng.uniform(40, 90, (count, 1)) + rng.normal(0, 3, (count, 2))
    theta[:, 6] = -rng.uniform(6, 25, count)
    return theta


@pytest.mark.parametrize("azimuth", [0.0, 1.5, 3.0, -1.5], ids=["main", "right goal", "opposite", "left goal"])
def test_round_trip(azimuth):
    theta = _cameras(np.random.default_rng(0), azimuth=azimuth)
    center = np.array([0.3, -0.2])
    back = from_viewing(to_viewing(theta, center), center)
    difference = back - theta[:, :VIEWING]
    difference[:, 1] = (difference[:, 1] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)


def _overhead_cameras(rng, count=40):
    """Cameras above the circle, most of whose nadirs it surrounds, that pan anywhere."""
    theta = np.zeros((count, len(PARAMETERS)))
    theta[:, 0] = rng.uniform(6.8, 7.4, count)
    theta[:, 1] = rng.uniform(-np.pi, np.pi, count)
    theta[:, 2] = rng.uniform(0.05, 0.4, count)
    theta[:, 3] = rng.normal(0, 0.3, count)
    theta[:, 4:6] = rng.uniform(-15, 15, (count, 2))
    theta[:, 6] = -rng.uniform(30, 60, count)
    return theta


def test_overhead_cameras_come_back_on_whichever_side_of_the_centre_they_stand():
    theta, center = _overhead_cameras(np.random.default_rng(4)), np.array([0.3, -0.2])
    viewing = to_viewing(theta, center)
    assert 10 < (viewing[:, 6] > np.pi / 2).sum() < 30
    difference = from_viewing(viewing, center) - theta[:, :VIEWING]
    difference[:, 1] = (difference[:, 1] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)


def test_jacobian_of_overhead_cameras_predicts_small_steps_and_is_none_beside_the_nadir():
    rng = np.random.default_rng(5)
    theta, center = _overhead_cameras(rng), np.zeros(2)
    toward = np.stack([np.sin(theta[:, 1]), -np.cos(theta[:, 1])], axis=-1)
    before = -(toward * theta[:, 4:6]).sum(axis=1) / np.linalg.norm(theta[:, 4:7], axis=1)
    jacobian, look = viewing_jacobian(theta, center), to_viewing(theta, center)
    np.testing.assert_array_equal(np.isnan(jacobian).any(axis=(1, 2)), np.abs(before) < LEAST_BEFORE)
    step = rng.normal(size=look.shape) * np.array([1e-4, 1e-2, 1e-2, 1e-5, 1e-4, 1e-5, 1e-5])
    predicted = np.einsum("bij,bj->bi", jacobian, step)
    actual = from_viewing(look + step, center) - from_viewing(look, center)
    kept = np.isfinite(predicted).all(axis=1)
    assert 5 < kept.sum() < len(kept)
    np.testing.assert_allclose(predicted[kept], actual[kept], rtol=1e-2, atol=2e-6)


def test_circle_behind_the_camera_is_not_finite():
    theta = _cameras(np.random.default_rng(1))
    theta[:, 1] += np.pi
    assert not np.isfinite(to_viewing(theta, np.zeros(2))[:, 1]).any()


def test_jacobian_predicts_small_steps():
    rng = np.random.default_rng(2)
    theta = _cameras(rng)
    look = to_viewing(theta, np.zeros(2))
    step = rng.normal(size=look.shape) * np.array([1e-4, 1e-1, 1e-1, 1e-5, 1e-4, 1e-5, 1e-5])
    predicted = np.einsum("bij,bj->bi", viewing_jacobian(theta, np.zeros(2)), step)
    actual = from_viewing(look + step, np.zeros(2)) - from_viewing(look, np.zeros(2))
    np.testing.assert_allclose(predicted, actual, rtol=1e-2, atol=1e-6)


def test_zoom_with_distance_moves_along_a_line():
    """Doubling focal length and distance leaves the other viewing coordinates where they are."""
    theta = _cameras(np.random.default_rng(3), count=1)
    further = theta.copy()
    look = to_viewing(theta, np.zeros(2))
    look[:, [0, 4]] += np.log(2.0)
    further[:, :VIEWING] = from_viewing(look, np.zeros(2))
    np.testing.assert_allclose(further[:, 4:7], 2 * theta[:, 4:7], rtol=1e-9)
    np.testing.assert_allclose(
        to_viewing(further, np.zeros(2))[:, [1, 2, 3, 5, 6]], look[:, [1, 2, 3, 5, 6]], atol=1e-7
    )


def test_straight_above_the_centre_there_is_no_derivative():
    theta = np.zeros((2, len(PARAMETERS)))
    theta[:, 0], theta[:, 6] = np.log(900.0), -30.0
    theta[1, 2], theta[1, 5] = 1.2, 60.0
    found = viewing_jacobian(theta, np.zeros(2))
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1]).all()


def test_one_camera_by_itself_gives_what_it_gives_among_others():
    theta, center = _cameras(np.random.default_rng(3)), np.array([0.3, -0.2])
    theta[7, 5] = -60.0  # what it looks at lies behind it
    viewing, jacobian, _ = to_viewing_with_jacobian(theta, center)
    assert np.isnan(viewing[7]).any()
    for k in range(len(theta)):
        alone, by_alone, _ = to_viewing_with_jacobian(theta[k : k + 1], center)
        np.testing.assert_allclose(alone[0], viewing[k], rtol=1e-14)
        np.testing.assert_allclose(by_alone[0], jacobian[k], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(from_viewing(alone, center)[0], from_viewing(viewing, center)[k], rtol=1e-13)
