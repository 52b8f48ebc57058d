"""Robust conic: the score, the samples and the whole."""

import numpy as np
import pytest

from circlecal.geometry.conic_fits import FIT_METHODS
from circlecal.geometry.conics import is_ellipse, normalise_conic, sampson_distance
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse
from circlecal.geometry.projective import similarity_normalisation
from circlecal.geometry.ransac import msac_costs, ransac_conic, sample_conics

TRUE = Ellipse(np.array([900.0, 500.0]), (600.0, 160.0), 0.1)


def _scene(rng, inliers=300, outliers=300, sigma=0.5):
    t = rng.uniform(0, 2 * np.pi, inliers)
    near = TRUE.points(t) + rng.normal(0, sigma, (inliers, 1)) * TRUE.normals(t)
    return np.vstack([near, rng.uniform((200, 250), (1600, 750), (outliers, 2))])


def test_score_is_the_truncated_sampson_distance():
    rng = np.random.default_rng(31)
    points = _scene(rng)
    T = similarity_normalisation(points)
    local = points * T[0, 0] + T[:2, 2]
    inverse = np.linalg.inv(T)
    conics = np.stack(
        [
            normalise_conic(inverse.T @ conic_from_ellipse(e) @ inverse)
            for e in (TRUE, Ellipse(TRUE.center, (500.0, 200.0), 0.0))
        ]
    )
    threshold = 3.0 * T[0, 0]
    expected = np.minimum((sampson_distance(conics, local) / threshold) ** 2, 1.0).mean(axis=1)
    np.testing.assert_allclose(msac_costs(conics, local, threshold), expected, rtol=1e-3)
    np.testing.assert_allclose(msac_costs(-5.0 * conics, local, np.full(len(local), threshold)), expected, rtol=1e-3)


def test_samples_are_ellipses_and_fewer_than_asked_for():
    rng = np.random.default_rng(32)
    local = rng.normal(size=(40, 2))
    sampled = sample_conics(local, 500, rng)
    assert 0 < len(sampled) < 500
    assert is_ellipse(sampled).all()


@pytest.mark.parametrize("method", FIT_METHODS)
@pytest.mark.parametrize("threshold", [2.0, np.full(600, 2.0)])
def test_finds_the_ellipse_among_as_many_outliers(method, threshold):
    points = _scene(np.random.default_rng(33))
    found = ransac_conic(points, threshold, np.random.default_rng(1), method=method)
    departure = sampson_distance(found.conic, TRUE.points(np.linspace(0, 6.28, 100)))
    assert np.abs(departure).max() < 1.0
    np.testing.assert_array_equal(found.inliers, np.abs(sampson_distance(found.conic, points)) < 2.0)
    assert found.inliers[:300].mean() > 0.98
    assert found.inliers[300:].mean() < 0.1
    assert 0 < found.cost < 1


def test_same_generator_same_answer_and_a_moved_picture_moves_it():
    points = _scene(np.random.default_rng(34))
    first, second = (ransac_conic(points, 2.0, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.conic, second.conic)
    moved = ransac_conic(points + 1000.0, 2.0, np.random.default_rng(5))
    np.testing.assert_array_equal(moved.inliers, first.inliers)


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 2)), TRUE.points(np.arange(5.0)), np.zeros((30, 2)), np.full((30, 2), np.nan)],
)
def test_too_little_gives_none(points):
    assert ransac_conic(points, 2.0, np.random.default_rng(0)) is None


def test_points_on_a_line_do_not_stop_it():
    x = np.linspace(0, 1000, 50)
    found = ransac_conic(np.column_stack([x, 0.3 * x]), 2.0, np.random.default_rng(0))
    assert found is None or np.isfinite(found.conic).all()


def test_sampling_stops_when_sure():
    """Few samples where nearly all points agree, more where half of them do; the answer stays."""
    clean, half = _scene(np.random.default_rng(35), 300, 6), _scene(np.random.default_rng(36), 300, 300)
    few, more = (ransac_conic(p, 2.0, np.random.default_rng(1), confidence=0.999) for p in (clean, half))
    assert few.hypotheses < 60 < more.hypotheses <= 1000
    for points, found in ((clean, few), (half, more)):
        every = ransac_conic(points, 2.0, np.random.default_rng(1))
        assert every.hypotheses == 1000
        np.testing.assert_array_equal(found.inliers[:300], every.inliers[:300])
