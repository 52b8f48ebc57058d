"""Ellipses: conversions, points and normals, foot points and distances, arcs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from skimage.measure import EllipseModel

from circlecal.geometry.conics import algebraic_residuals, sampson_distance
from circlecal.geometry.ellipses import (
    Ellipse,
    arc_coverage_deg,
    conic_from_ellipse,
    ellipse_from_conic,
    encloses,
    orthogonal_distance,
)

from .shapes import ellipses


def _dense(ellipse, count=40001):
    return ellipse.points(np.linspace(-np.pi, np.pi, count))


@given(ellipses())
def test_conic_and_ellipse_round_trip(ellipse):
    found = ellipse_from_conic(conic_from_ellipse(ellipse))
    np.testing.assert_allclose(found.center, ellipse.center, atol=1e-6)
    np.testing.assert_allclose(found.semi_axes, ellipse.semi_axes, rtol=1e-7)
    if ellipse.axis_ratio < 0.999:
        turn = (found.angle_rad - ellipse.angle_rad + np.pi / 2) % np.pi - np.pi / 2
        assert abs(turn) < 1e-6


@given(ellipses())
def test_points_parameter_and_normals_of_an_ellipse(ellipse):
    t = np.linspace(-3.1, 3.1, 41)
    points = ellipse.points(t)
    conic = conic_from_ellipse(ellipse)
    np.testing.assert_allclose(sampson_distance(conic, points), 0.0, atol=1e-7)
    np.testing.assert_allclose(ellipse.parameter(points), t, atol=1e-7)
    _, gradient = algebraic_residuals(conic, points)
    np.testing.assert_allclose(
        gradient / np.linalg.norm(gradient, axis=-1, keepdims=True), ellipse.normals(t), atol=1e-6
    )


@given(ellipses(smallest_ratio=0.3), st.floats(-0.5, 0.5))
def test_sampson_equals_the_orthogonal_distance_for_small_offsets(ellipse, offset):
    t = np.linspace(0, 6, 25)
    points = ellipse.points(t) + offset * ellipse.normals(t)
    exact = orthogonal_distance(ellipse, points)
    np.testing.assert_allclose(exact, offset, atol=1e-6)
    curvature = ellipse.semi_axes[0] / ellipse.semi_axes[1] ** 2
    first_order = sampson_distance(conic_from_ellipse(ellipse), points)
    np.testing.assert_allclose(first_order, exact, atol=2.0 * offset**2 * curvature + 1e-6)


@pytest.mark.parametrize("axes", [(500.0, 499.0), (500.0, 200.0), (500.0, 40.0)])
def test_orthogonal_distance_against_scikit_image_near_the_ellipse(axes):
    rng = np.random.default_rng(5)
    ellipse = Ellipse(np.array([960.0, 540.0]), axes, 0.3)
    t = rng.uniform(-np.pi, np.pi, 60)
    points = ellipse.points(t) + rng.uniform(-2, 2, (60, 1)) * ellipse.normals(t)
    peer = EllipseModel((960.0, 540.0), axes, 0.3).residuals(points)
    np.testing.assert_allclose(np.abs(orthogonal_distance(ellipse, points)), peer, atol=1e-4)


@pytest.mark.parametrize("axes", [(500.0, 400.0), (500.0, 100.0), (500.0, 10.0)])
def test_orthogonal_distance_is_the_nearest_of_all_points(axes):
    # scikit-image ends in local minima here, so the reference is a dense search
    rng = np.random.default_rng(6)
    ellipse = Ellipse(np.array([10.0, -20.0]), axes, 1.0)
    points = ellipse.center + rng.uniform(-700, 700, (500, 2))
    nearest = cKDTree(_dense(ellipse)).query(points)[0]
    np.testing.assert_allclose(np.abs(orthogonal_distance(ellipse, points)), nearest, atol=0.05)


def test_foot_points_of_the_centre_and_of_a_circle():
    circle = Ellipse(np.array([5.0, 5.0]), (3.0, 3.0), 0.0)
    np.testing.assert_allclose(orthogonal_distance(circle, [[5.0, 5.0], [5.0, 9.0]]), [-3.0, 1.0], atol=1e-9)
    ellipse = Ellipse(np.array([5.0, 5.0]), (30.0, 4.0), 0.4)
    assert orthogonal_distance(ellipse, [[5.0, 5.0]])[0] == pytest.approx(-4.0)


@given(ellipses(), st.integers(1, 71))
def test_arc_coverage_counts_the_bins_that_have_points(ellipse, bins):
    t = np.radians(2.5 + 5.0 * np.arange(bins))
    assert arc_coverage_deg(ellipse, ellipse.points(np.repeat(t, 3))) == pytest.approx(5.0 * bins)


def _flat(x, y, great=100.0, small=40.0):
    return conic_from_ellipse(Ellipse(np.array([x, y]), (great, small), 0.0))


@pytest.mark.parametrize("scale", [1.0, -3.0])
def test_one_ellipse_about_another(scale):
    outer, hyperbola = scale * _flat(200.0, 150.0), np.diag([1.0, -1.0, 1.0])
    assert encloses(outer, _flat(220.0, 155.0, 60.0, 20.0))
    assert not encloses(_flat(220.0, 155.0, 60.0, 20.0), outer)
    assert not encloses(outer, _flat(250.0, 150.0, 60.0, 20.0))  # they cross
    assert not encloses(outer, _flat(500.0, 150.0, 60.0, 20.0))  # beside it
    assert not encloses(outer, hyperbola)
    assert not encloses(hyperbola, outer)
