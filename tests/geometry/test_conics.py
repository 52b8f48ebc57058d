"""Conics and ellipses: conversions, poles and polars, meets with lines, first-order distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry import conics
from circlecal.geometry.ellipses import (
    Ellipse,
    conic_from_ellipse,
    ellipse_from_conic,
)
from circlecal.geometry.projective import dehomogenise, join, lift, line_distance, meet, normalise_line

from .shapes import ellipses

scales = st.floats(1e-6, 1e6).flatmap(lambda s: st.sampled_from([s, -s]))


@st.composite
def homographies(draw):
    """Well-behaved maps of the unit square's neighbourhood."""
    a, b, c, d = (draw(st.floats(-1.0, 1.0)) for _ in range(4))
    g, h = draw(st.floats(-0.2, 0.2)), draw(st.floats(-0.2, 0.2))
    return np.array([[2.5 + a, b, 3 * c], [d, 2.5 - a, 3 * d], [g, h, 1.0]])


@given(ellipses(), scales)
def test_scale_and_sign_of_a_conic_do_not_matter(ellipse, scale):
    conic = conic_from_ellipse(ellipse)
    scaled = scale * conic
    np.testing.assert_allclose(conics.normalise_conic(scaled), conic, rtol=1e-9, atol=1e-300)
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


def test_normalised_conic_is_negative_inside():
    conic = conics.normalise_conic(-7.0 * conics.circle_conic((3.0, 4.0), 2.0))
    assert np.linalg.det(conic) == pytest.approx(-1.0)
    inside, outside = np.array([3.0, 4.0, 1.0]), np.array([9.0, 4.0, 1.0])
    assert inside @ conic @ inside < 0 < outside @ conic @ outside


@pytest.mark.parametrize(
    "coefficients",
    [
        (1.0, 0.0, -1.0, 0.0, 0.0, -1.0),  # hyperbola
        (1.0, 3.0, 1.0, 0.0, 0.0, 1.0),  # hyperbola whose squares have one sign
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
    assert ellipse_from_conic(conic) is None
    np.testing.assert_allclose(conics.coefficients_from_conic(conic), coefficients)


@given(ellipses(), homographies())
def test_transformed_conic_passes_through_the_transformed_points(ellipse, H):
    unit = Ellipse(ellipse.center / 4000.0, (0.3, 0.3 * ellipse.axis_ratio), ellipse.angle_rad)
    moved = dehomogenise(lift(unit.points(np.linspace(0, 6, 13))) @ H.T)
    conic = conics.transform_conic(H, conic_from_ellipse(unit))
    np.testing.assert_allclose(conics.sampson_distance(conic, moved), 0.0, atol=1e-9)
    back = conics.transform_conic(np.linalg.inv(H), conic)
    np.testing.assert_allclose(back, conic_from_ellipse(unit), atol=1e-8 * np.abs(back).max())


@given(ellipses(), st.floats(-1000, 5000), st.floats(-1000, 5000))
def test_pole_and_polar_are_inverse(ellipse, x, y):
    conic = conic_from_ellipse(ellipse)
    point = np.array([x, y, 1.0])
    back = conics.pole(conic, conics.polar(conic, point))
    np.testing.assert_allclose(back / back[2], point, rtol=1e-6, atol=1e-5)


def test_the_pole_needs_the_inverse():
    conic = conics.circle_conic((3.0, 1.0), 2.0)
    line = np.array([1.0, 0.0, -4.0])  # x = 4, whose pole lies on y = 1 beyond the circle: 3 + 2^2 / 1
    np.testing.assert_allclose(dehomogenise(conics.pole(conic, line)), (7.0, 1.0))
    assert np.abs(dehomogenise(conics.polar(conic, line)) - (7.0, 1.0)).max() > 1.0


@given(ellipses(), st.floats(-0.98, 0.98), st.floats(0.0, 2 * np.pi))
def test_line_meets_the_ellipse_in_points_of_both(ellipse, offset, angle):
    conic = conic_from_ellipse(ellipse)
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


@pytest.mark.parametrize("away", [0.0, 3e5])
def test_a_line_far_away_meets_a_conic_there_and_the_line_at_infinity_none(away):
    conic = conics.circle_conic((away, 0.0), 2.0)
    both = dehomogenise(conics.line_conic_meet(conic, np.array([1.0, 0.0, -away])))
    np.testing.assert_allclose(both[:, 0], away)
    np.testing.assert_allclose(np.sort(both[:, 1]), [-2.0, 2.0], atol=1e-3)
    assert conics.line_conic_meet(conic, np.array([1e-16, 0.0, 1.0])) is None


def test_four_common_tangents_of_a_square_meet_on_its_diagonals():
    conic = conics.circle_conic((0, 0), 2.0)
    sides = [conics.polar(conic, lift(p)) for p in ((2.0, 0.0), (0.0, 2.0))]
    np.testing.assert_allclose(dehomogenise(meet(*sides)), (2.0, 2.0))


def test_sampson_is_batched_over_conics():
    stack = np.stack([conics.circle_conic((0, 0), r) for r in (1.0, 2.0, 3.0)])
    points = np.array([[2.0, 0.0], [0.0, 2.5]])
    expected = np.stack([conics.sampson_distance(c, points) for c in stack])
    np.testing.assert_allclose(conics.sampson_distance(stack, points), expected)
