"""Points and lines of the projective plane."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry import projective as homogeneous

coordinates = st.tuples(st.floats(-4000, 4000), st.floats(-4000, 4000)).map(np.array)


@given(coordinates, coordinates, coordinates)
def test_join_and_meet_are_dual(p, q, r):
    if np.abs(np.cross(np.append(q - p, 0), np.append(r - p, 0))[2]) < 1.0:
        return
    first, second = (homogeneous.join(homogeneous.lift(p), homogeneous.lift(x)) for x in (q, r))
    back = homogeneous.dehomogenise(homogeneous.meet(first, second))
    np.testing.assert_allclose(back, p, atol=1e-3)
    np.testing.assert_allclose(homogeneous.line_distance(first, np.stack([p, q])), 0.0, atol=1e-6)


def test_parallel_lines_meet_at_infinity():
    point = homogeneous.meet([1.0, 0.0, -1.0], [1.0, 0.0, -2.0])
    assert point[2] == 0
    assert not np.isfinite(homogeneous.dehomogenise(point)).all()


@given(st.floats(0, np.pi), coordinates)
def test_line_through_points_by_total_least_squares(angle, base):
    direction = np.array([np.cos(angle), np.sin(angle)])
    points = base + np.linspace(-300, 300, 20)[:, None] * direction
    line = homogeneous.fit_line(points)
    assert np.hypot(line[0], line[1]) == pytest.approx(1.0)
    np.testing.assert_allclose(homogeneous.line_distance(line, points), 0.0, atol=1e-6)
    weighted = homogeneous.fit_line(np.vstack([points, base + 500.0]), np.r_[np.ones(20), 0.0])
    np.testing.assert_allclose(homogeneous.line_distance(weighted, points), 0.0, atol=1e-6)


def test_line_needs_two_points():
    with pytest.raises(ValueError, match="two points"):
        homogeneous.fit_line(np.zeros((1, 2)))


def test_similarity_normalisation_centres_and_scales():
    points = np.random.default_rng(0).uniform(-50, 2000, (30, 2))
    moved = homogeneous.apply_homography(homogeneous.similarity_normalisation(points), points)
    np.testing.assert_allclose(moved.mean(axis=0), 0.0, atol=1e-12)
    assert np.linalg.norm(moved, axis=1).mean() == pytest.approx(np.sqrt(2.0))
    np.testing.assert_allclose(homogeneous.similarity_normalisation(np.full((3, 2), 7.0))[:2, 2], -7.0)


@given(coordinates, coordinates)
def test_lines_move_with_their_points(p, q):
    if np.linalg.norm(p - q) < 1.0:
        return
    H = np.array([[1.2, 0.1, 30.0], [-0.2, 0.8, -5.0], [1e-5, 2e-5, 1.0]])
    line = homogeneous.transform_lines(H, homogeneous.join(homogeneous.lift(p), homogeneous.lift(q)))
    moved = homogeneous.apply_homography(H, np.stack([p, q]))
    np.testing.assert_allclose(homogeneous.line_distance(line, moved), 0.0, atol=1e-5)


def test_points_at_infinity_are_not_finite_and_warn_of_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = homogeneous.dehomogenise([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0], [1e300, 1.0, 1e-300], [2.0, 4.0, 2.0]])
    assert not np.isfinite(found[:3]).all(axis=1).any()
    np.testing.assert_array_equal(found[3], [1.0, 2.0])
