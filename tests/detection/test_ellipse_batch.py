import numpy as np

from circlecal.detection.ellipse_batch import EllipseBatch, adjust_ellipses, convert_coefficients, ellipse_conic
from circlecal.geometry.conics import coefficients_from_conic
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse, ellipse_from_conic

ELLIPSE = Ellipse(np.array([0.2, -0.1]), (0.7, 0.25), 0.4)
TRUE = Ellipse(np.array([300.0, 150.0]), (180.0, 60.0), 0.1)


def batch_of(*ellipses: Ellipse) -> EllipseBatch:
    frames = np.stack([ellipse.frame() for ellipse in ellipses])
    return EllipseBatch(frames[:, :2, 2], frames[:, :2, 0], frames[:, :2, 1])


def test_adjustment_converges_on_exact_points() -> None:
    rough = batch_of(Ellipse(TRUE.center + 1.0, (178.0, 61.0), 0.1))
    points = TRUE.points(np.linspace(0.3, 5.0, 200))[None]
    for _ in range(6):
        rough = adjust_ellipses(rough, points, np.ones((1, 200)))
    np.testing.assert_allclose(rough.great_lengths[0], 180.0, atol=1e-3)
    np.testing.assert_allclose(rough.centers[0], TRUE.center, atol=1e-3)


def test_too_few_points_leave_the_ellipse_alone() -> None:
    rough = batch_of(Ellipse(TRUE.center, (178.0, 61.0), 0.1))
    same = adjust_ellipses(rough, TRUE.points(np.arange(5.0))[None], np.ones((1, 5)))
    np.testing.assert_array_equal(same.centers, rough.centers)
    np.testing.assert_array_equal(same.great, rough.great)


def test_ellipses_of_conics_match_the_geometry_and_skip_hyperbolas() -> None:
    hyperbola = np.diag([1.0, -2.0, -1.0])
    coefficients = np.stack([coefficients_from_conic(c) for c in (-3 * conic_from_ellipse(ELLIPSE), hyperbola)])
    batch, real = convert_coefficients(coefficients)
    assert real.tolist() == [True, False]
    np.testing.assert_allclose(batch.centers[0], ELLIPSE.center, atol=1e-12)
    np.testing.assert_allclose([batch.great_lengths[0], batch.small_lengths[0]], ELLIPSE.semi_axes, atol=1e-12)
    direction = np.arctan2(batch.great[0, 1], batch.great[0, 0]) % np.pi
    np.testing.assert_allclose(direction, ELLIPSE.angle_rad, atol=1e-12)


def test_conic_round_trip_of_the_batch() -> None:
    coefficients = coefficients_from_conic(conic_from_ellipse(ELLIPSE))[None]
    batch, _ = convert_coefficients(coefficients)
    again = ellipse_from_conic(ellipse_conic(batch))
    assert again is not None
    np.testing.assert_allclose(again.semi_axes, ELLIPSE.semi_axes, atol=1e-12)
