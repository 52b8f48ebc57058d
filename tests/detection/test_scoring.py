import numpy as np

from circlecal.detection.hypotheses import EllipseBatch
from circlecal.detection.ridges import RidgePoints
from circlecal.detection.scoring import RidgeRaster, adjusted, best_distinct, refitted, support_of
from circlecal.geometry.ellipses import Ellipse

TRUE = Ellipse(np.array([300.0, 150.0]), (180.0, 60.0), 0.1)
REGION = np.full((300, 600), 255, np.uint8)


def batch_of(*ellipses: Ellipse) -> EllipseBatch:
    frames = np.stack([ellipse.frame() for ellipse in ellipses])
    return EllipseBatch(frames[:, :2, 2], frames[:, :2, 0], frames[:, :2, 1])


def drawn_part(first: float, last: float, turned: bool = False) -> RidgePoints:
    angle = np.linspace(first, last, 1500)
    normals = TRUE.normals(angle)
    if turned:
        normals = np.stack([-normals[:, 1], normals[:, 0]], axis=-1)
    return RidgePoints(TRUE.points(angle), normals, np.full(1500, 99))


def test_support_is_the_drawn_share() -> None:
    support = support_of(batch_of(TRUE), RidgeRaster(drawn_part(0, np.pi), REGION))
    assert abs(support.whole[0] - 0.5) < 0.03


def test_what_lies_outside_the_field_counts_against_the_whole_only() -> None:
    region = REGION.copy()
    lower = TRUE.points(np.linspace(0, np.pi, 200))
    region[: int(lower[:, 1].min())] = 0
    support = support_of(batch_of(TRUE), RidgeRaster(drawn_part(0, np.pi), region))
    assert abs(support.whole[0] - 0.5) < 0.05
    assert support.field[0] > 0.8


def test_points_of_another_direction_do_not_count() -> None:
    support = support_of(batch_of(TRUE), RidgeRaster(drawn_part(0, 2 * np.pi, turned=True), REGION))
    assert support.whole[0] == 0.0


def test_refit_pulls_an_ellipse_onto_the_points() -> None:
    rough = Ellipse(TRUE.center + np.array([2.0, -2.0]), (183.0, 58.0), 0.11)
    raster = RidgeRaster(drawn_part(0, 2 * np.pi), REGION)
    fitted = refitted(batch_of(rough), raster, (5.0, 3.0, 1.5, 1.0))
    np.testing.assert_allclose(fitted.centers[0], TRUE.center, atol=0.1)
    np.testing.assert_allclose(fitted.great_lengths[0], 180.0, atol=0.15)
    np.testing.assert_allclose(fitted.small_lengths[0], 60.0, atol=0.1)


def test_adjustment_converges_on_exact_points() -> None:
    rough = batch_of(Ellipse(TRUE.center + 1.0, (178.0, 61.0), 0.1))
    points = TRUE.points(np.linspace(0.3, 5.0, 200))[None]
    for _ in range(6):
        rough = adjusted(rough, points, np.ones((1, 200)))
    np.testing.assert_allclose(rough.great_lengths[0], 180.0, atol=1e-3)
    np.testing.assert_allclose(rough.centers[0], TRUE.center, atol=1e-3)


def test_too_few_points_leave_the_ellipse_alone() -> None:
    rough = batch_of(Ellipse(TRUE.center, (178.0, 61.0), 0.1))
    same = adjusted(rough, TRUE.points(np.arange(5.0))[None], np.ones((1, 5)))
    np.testing.assert_array_equal(same.centers, rough.centers)
    np.testing.assert_array_equal(same.great, rough.great)


def test_best_distinct_drops_repetitions_and_puts_the_best_first() -> None:
    other = Ellipse(np.array([250.0, 180.0]), (120.0, 50.0), 0.0)
    nearly = Ellipse(TRUE.center + 0.3, (180.5, 60.2), 0.1)
    best = best_distinct(batch_of(other, nearly, TRUE), RidgeRaster(drawn_part(0, 2 * np.pi), REGION), 5)
    assert len(best) == 2
    np.testing.assert_allclose(best.great_lengths[0], 180.0, atol=1.0)
