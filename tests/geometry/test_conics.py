"""Conics and ellipses: conversions, poles and polars, tangents, distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from skimage.measure import EllipseModel

from circlecal.geometry import conics
from circlecal.geometry.projective import dehomogenise, join, lift, line_distance, meet, normalise_line

scales = st.floats(1e-6, 1e6).flatmap(lambda s: st.sampled_from([s, -s]))


@st.composite
def ellipses(draw, smallest_ratio=0.05):
    """Ellipses as a frame of up to 4K may show them."""
    major = draw(st.floats(20.0, 2000.0))
    ratio = draw(st.floats(smallest_ratio, 1.0))
    center = np.array([draw(st.floats(-500.0, 4000.0)), draw(st.floats(-500.0, 2500.0))])
    return conics.Ellipse(center, (major, major * ratio), draw(st.floats(0.0, np.pi)))


@st.composite
def homographies(draw):
    """Well-behaved maps of the unit square's neighbourhood."""
    a, b, c, d = (draw(st.floats(-1.0, 1.0)) for _ in range(4))
    g, h = draw(st.floats(-0.2, 0.2)), draw(st.floats(-0.2, 0.2))
    return np.array([[2.5 + a, b, 3 * c], [d, 2.5 - a, 3 * d], [g, h, 1.0]])


def _dense(ellipse, count=40001):
    return ellipse.points(np.linspace(-np.pi, np.pi, count))


@given(ellipses())
def test_conic_and_ellipse_round_trip(ellipse):
    found = conics.ellipse_from_conic(conics.conic_from_ellipse(ellipse))
    np.testing.assert_allclose(found.center, ellipse.center, atol=1e-6)
    np.testing.assert_allclose(found.semi_axes, ellipse.semi_axes, rtol=1e-7)
    if ellipse.axis_ratio < 0.999:
        turn = (found.angle_rad - ellipse.angle_rad + np.pi / 2) % np.pi - np.pi / 2
        assert abs(turn) < 1e-6


@given(ellipses(), scales)
def test_scale_and_sign_of_a_conic_do_not_matter(ellipse, scale):
    conic = conics.conic_from_ellipse(ellipse)
    scaled = scale * conic
    np.testing.assert_allclose(conics.normalise_conic(scaled), conic, rtol=1e-9)
    assert conics.is_ellipse(scaled)
    points = ellipse.points(np.linspace(0, 6, 7)) + 1.5
    np.testing.assert_allclose(
        conics.sampson_distance(conics.normalise_conic(scaled), points),
        conics.sampson_distance(conic, points),
        atol=1e-7,
    )
    far = ellipse.center + 3 * ellipse.semi_axes[0]
    line = join(lift(ellipse.center), lift(far))
    both = dehomogenise(conics.line_conic_meet(scaled, line))
    again = dehomogenise(conics.line_conic_meet(conic, scale * line))
    np.testing.assert_allclose(both, again[:: int(np.sign(scale))], atol=1e-6)
    contacts = [
        dehomogenise(conics.pole(conic, tangent))
        for tangents in (
            conics.tangents_from_point(scaled, lift(far)),
            conics.tangents_from_point(conic, scale * lift(far)),
        )
        for tangent in tangents
    ]
    distances = np.linalg.norm(np.array(contacts[:2])[:, None] - np.array(contacts[2:]), axis=-1)
    assert distances.min(axis=0).max() < 1e-4


def test_normalised_conic_is_negative_inside():
    conic = conics.normalise_conic(-7.0 * conics.circle_conic((3.0, 4.0), 2.0))
    assert np.linalg.det(conic) == pytest.approx(-1.0)
    inside, outside = np.array([3.0, 4.0, 1.0]), np.array([9.0, 4.0, 1.0])
    assert inside @ conic @ inside < 0 < outside @ conic @ outside


@pytest.mark.parametrize(
    "coefficients",
    [
        (1.0, 0.0, -1.0, 0.0, 0.0, -1.0),  # hyperbola
        (1.0, 0.0, 0.0, 0.0, -1.0, 0.0),  # parabola
        (1.0, 0.0, 1.0, 0.0, 0.0, 1.0),  # imaginary ellipse
        (1.0, 0.0, 1.0, 0.0, 0.0, 0.0),  # one point
        (1.0, 0.0, -1.0, 0.0, 0.0, 0.0),  # two lines
        (0.0, 0.0, 0.0, 0.0, 1.0, 1.0),  # one line
    ],
)
def test_other_conics_are_no_ellipse(coefficients):
    conic = conics.conic_from_coefficients(coefficients)
    assert not conics.is_ellipse(conic)
    assert not conics.is_ellipse(-conic)
    assert conics.ellipse_from_conic(conic) is None
    np.testing.assert_allclose(conics.coefficients_from_conic(conic), coefficients)


@given(ellipses())
def test_points_parameter_and_normals_of_an_ellipse(ellipse):
    t = np.linspace(-3.1, 3.1, 41)
    points = ellipse.points(t)
    conic = conics.conic_from_ellipse(ellipse)
    np.testing.assert_allclose(conics.sampson_distance(conic, points), 0.0, atol=1e-7)
    np.testing.assert_allclose(ellipse.parameter(points), t, atol=1e-7)
    _, gradient = conics.algebraic_residuals(conic, points)
    np.testing.assert_allclose(
        gradient / np.linalg.norm(gradient, axis=-1, keepdims=True), ellipse.normals(t), atol=1e-6
    )


@given(ellipses(), homographies())
def test_transformed_conic_passes_through_the_transformed_points(ellipse, H):
    unit = conics.Ellipse(ellipse.center / 4000.0, (0.3, 0.3 * ellipse.axis_ratio), ellipse.angle_rad)
    moved = dehomogenise(lift(unit.points(np.linspace(0, 6, 13))) @ H.T)
    conic = conics.transform_conic(H, conics.conic_from_ellipse(unit))
    np.testing.assert_allclose(conics.sampson_distance(conic, moved), 0.0, atol=1e-9)
    back = conics.transform_conic(np.linalg.inv(H), conic)
    np.testing.assert_allclose(back, conics.conic_from_ellipse(unit), atol=1e-8 * np.abs(back).max())


@given(ellipses(), st.floats(-1000, 5000), st.floats(-1000, 5000))
def test_pole_and_polar_are_inverse(ellipse, x, y):
    conic = conics.conic_from_ellipse(ellipse)
    point = np.array([x, y, 1.0])
    back = conics.pole(conic, conics.polar(conic, point))
    np.testing.assert_allclose(back / back[2], point, rtol=1e-6, atol=1e-5)


def test_the_pole_needs_the_inverse():
    conic = conics.circle_conic((3.0, 1.0), 2.0)
    line = np.array([1.0, 0.0, -4.0])  # x = 4, whose pole lies on y = 1 beyond the circle: 3 + 2^2 / 1
    np.testing.assert_allclose(dehomogenise(conics.pole(conic, line)), (7.0, 1.0))
    assert np.abs(dehomogenise(conics.polar(conic, line)) - (7.0, 1.0)).max() > 1.0


@given(ellipses(), st.floats(1.05, 20.0), st.floats(-3.1, 3.1))
def test_tangents_touch_the_ellipse_and_meet_in_the_point(ellipse, factor, t):
    conic = conics.conic_from_ellipse(ellipse)
    point = ellipse.center + factor * (ellipse.points(t) - ellipse.center)
    tangents = conics.tangents_from_point(conic, lift(point))
    np.testing.assert_allclose(line_distance(tangents[0], point[None]), 0.0, atol=1e-5)
    np.testing.assert_allclose(line_distance(tangents[1], point[None]), 0.0, atol=1e-5)
    for tangent in tangents:
        touch = dehomogenise(conics.pole(conic, tangent))
        assert abs(conics.sampson_distance(conic, touch[None])[0]) < 1e-5
        distances = line_distance(tangent, _dense(ellipse, 721))
        assert distances.max() < 1e-4 or distances.min() > -1e-4
    assert conics.tangents_from_point(conic, lift(ellipse.center)) is None


@given(ellipses(), st.floats(-0.98, 0.98), st.floats(0.0, 2 * np.pi))
def test_line_meets_the_ellipse_in_points_of_both(ellipse, offset, angle):
    conic = conics.conic_from_ellipse(ellipse)
    local = np.array([np.cos(angle), np.sin(angle), -offset])
    line = local @ np.linalg.inv(ellipse.frame())
    both = dehomogenise(conics.line_conic_meet(conic, line))
    np.testing.assert_allclose(line_distance(line, both), 0.0, atol=1e-6)
    np.testing.assert_allclose(conics.sampson_distance(conic, both), 0.0, atol=1e-5)
    assert np.linalg.norm(both[1] - both[0]) > 1.0
    direction = normalise_line(line)
    assert (both[1] - both[0]) @ (direction[1], -direction[0]) > 0
    outside = (local - (0, 0, 2.0 * np.copysign(1.0, offset))) @ np.linalg.inv(ellipse.frame())
    assert conics.line_conic_meet(conic, outside) is None


def test_four_common_tangents_of_a_square_meet_on_its_diagonals():
    conic = conics.circle_conic((0, 0), 2.0)
    sides = [conics.polar(conic, lift(p)) for p in ((2.0, 0.0), (0.0, 2.0))]
    np.testing.assert_allclose(dehomogenise(meet(*sides)), (2.0, 2.0))


@given(ellipses(smallest_ratio=0.3), st.floats(-0.5, 0.5))
def test_sampson_equals_the_orthogonal_distance_for_small_offsets(ellipse, offset):
    t = np.linspace(0, 6, 25)
    points = ellipse.points(t) + offset * ellipse.normals(t)
    exact = conics.orthogonal_distance(ellipse, points)
    np.testing.assert_allclose(exact, offset, atol=1e-6)
    curvature = ellipse.semi_axes[0] / ellipse.semi_axes[1] ** 2
    first_order = conics.sampson_distance(conics.conic_from_ellipse(ellipse), points)
    np.testing.assert_allclose(first_order, exact, atol=2.0 * offset**2 * curvature + 1e-6)


def test_sampson_is_batched_over_conics():
    stack = np.stack([conics.circle_conic((0, 0), r) for r in (1.0, 2.0, 3.0)])
    points = np.array([[2.0, 0.0], [0.0, 2.5]])
    expected = np.stack([conics.sampson_distance(c, points) for c in stack])
    np.testing.assert_allclose(conics.sampson_distance(stack, points), expected)


@pytest.mark.parametrize("axes", [(500.0, 499.0), (500.0, 200.0), (500.0, 40.0)])
def test_orthogonal_distance_against_scikit_image_near_the_ellipse(axes):
    rng = np.random.default_rng(5)
    ellipse = conics.Ellipse(np.array([960.0, 540.0]), axes, 0.3)
    t = rng.uniform(-np.pi, np.pi, 60)
    points = ellipse.points(t) + rng.uniform(-2, 2, (60, 1)) * ellipse.normals(t)
    peer = EllipseModel((960.0, 540.0), axes, 0.3).residuals(points)
    np.testing.assert_allclose(np.abs(conics.orthogonal_distance(ellipse, points)), peer, atol=1e-4)


@pytest.mark.parametrize("axes", [(500.0, 400.0), (500.0, 100.0), (500.0, 10.0)])
def test_orthogonal_distance_is_the_nearest_of_all_points(axes):
    # scikit-image ends in local minima here, so the reference is a dense search
    rng = np.random.default_rng(6)
    ellipse = conics.Ellipse(np.array([10.0, -20.0]), axes, 1.0)
    points = ellipse.center + rng.uniform(-700, 700, (500, 2))
    nearest = cKDTree(_dense(ellipse)).query(points)[0]
    np.testing.assert_allclose(np.abs(conics.orthogonal_distance(ellipse, points)), nearest, atol=0.05)


def test_foot_points_of_the_centre_and_of_a_circle():
    circle = conics.Ellipse(np.array([5.0, 5.0]), (3.0, 3.0), 0.0)
    np.testing.assert_allclose(conics.orthogonal_distance(circle, [[5.0, 5.0], [5.0, 9.0]]), [-3.0, 1.0], atol=1e-9)
    ellipse = conics.Ellipse(np.array([5.0, 5.0]), (30.0, 4.0), 0.4)
    assert conics.orthogonal_distance(ellipse, [[5.0, 5.0]])[0] == pytest.approx(-4.0)


@given(ellipses(), st.integers(1, 71))
def test_arc_coverage_counts_the_bins_that_have_points(ellipse, bins):
    t = np.radians(2.5 + 5.0 * np.arange(bins))
    assert conics.arc_coverage_deg(ellipse, ellipse.points(np.repeat(t, 3))) == pytest.approx(5.0 * bins)


def _flat(x, y, great=100.0, small=40.0):
    return conics.conic_from_ellipse(conics.Ellipse(np.array([x, y]), (great, small), 0.0))


@pytest.mark.parametrize("scale", [1.0, -3.0])
def test_one_ellipse_about_another(scale):
    outer, hyperbola = scale * _flat(200.0, 150.0), np.diag([1.0, -1.0, 1.0])
    assert conics.encloses(outer, _flat(220.0, 155.0, 60.0, 20.0))
    assert not conics.encloses(_flat(220.0, 155.0, 60.0, 20.0), outer)
    assert not conics.encloses(outer, _flat(250.0, 150.0, 60.0, 20.0))  # they cross
    assert not conics.encloses(outer, _flat(500.0, 150.0, 60.0, 20.0))  # beside it
    assert not conics.encloses(outer, hyperbola)
    assert not conics.encloses(hyperbola, outer)
