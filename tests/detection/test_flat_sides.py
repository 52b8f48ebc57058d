import numpy as np

from circlecal.detection.circle import conic_of, measure_circle
from circlecal.detection.flat_sides import onto_flat_sides
from circlecal.detection.hypotheses import EllipseBatch
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.paint.bands import RefinementConfig

from .conftest import Scene

RAISED_PX = 12.0


def beside(scene: Scene) -> EllipseBatch:
    """The circle with its far side too far up."""
    ellipse = ellipse_from_conic(scene.conic)
    assert ellipse is not None
    frame = ellipse.frame()[None, :2]
    up = np.array([0.0, -0.5 * RAISED_PX])
    great, small = frame[:, :, 0], frame[:, :, 1]
    return EllipseBatch(frame[:, :, 2] + up, great, small + np.sign(small[:, 1:]) * -up)


def far_side(scene: Scene) -> np.ndarray:
    """The straight run (1, 2, 2) that its far side looks like."""
    angle = np.radians([-110.0, -70.0])
    return scene.camera.project(9.09 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))[None]


def test_an_ellipse_beside_a_flat_side_is_moved_onto_it(main_view: Scene) -> None:
    grey, config = main_view.image[:, :, 1].copy(), RefinementConfig()
    wrong = measure_circle(grey, beside(main_view), 1.0, RefinementConfig(rounds=1))
    truth = main_view.circle_points()
    assert np.abs(sampson_distance(conic_of(wrong.ellipse), truth)).max() > 4.0
    right = onto_flat_sides(grey, wrong, far_side(main_view), config)
    assert np.abs(sampson_distance(conic_of(right.ellipse), truth)).max() < 1.0


def test_lines_elsewhere_and_on_the_circle_change_nothing(main_view: Scene) -> None:
    grey, config = main_view.image[:, :, 1].copy(), RefinementConfig()
    ellipse = ellipse_from_conic(main_view.conic)
    assert ellipse is not None
    frame = ellipse.frame()[None, :2]
    circle = measure_circle(grey, EllipseBatch(frame[:, :, 2], frame[:, :, 0], frame[:, :, 1]), 1.0, config)
    halfway = main_view.camera.project(np.array([[0.0, -15.0], [0.0, 15.0]]))[None]
    touchline = main_view.camera.project(np.array([[-20.0, -34.0], [20.0, -34.0]]))[None]
    for segments in (np.zeros((0, 2, 2)), far_side(main_view), np.concatenate([halfway, touchline])):
        assert onto_flat_sides(grey, circle, segments, config) is circle
