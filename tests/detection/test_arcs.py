import numpy as np
import pytest

from circlecal.detection import circle as circle_module
from circlecal.detection.arcs import find_longest_arc, lie_near_conics, move_onto_straight_arcs, select_arcs
from circlecal.detection.circle import CircleHypothesis, describe_circle, measure_circle
from circlecal.detection.ellipse_batch import EllipseBatch, ellipse_conic
from circlecal.detection.options import ProfilesConfig
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse, ellipse_from_conic

from .conftest import RADIUS_M, Scene, level, paint_scene, ring, upright


def arc_of(scene: Scene) -> CircleHypothesis | None:
    frame = ellipse_from_conic(scene.conic).frame()
    start = EllipseBatch(frame[None, :2, 2] + 1.0, frame[None, :2, 0] * 1.01, frame[None, :2, 1])
    circle = measure_circle(scene.image[:, :, 1].copy(), start, 1.0, ProfilesConfig())
    return find_longest_arc(circle, describe_circle(circle, 1.0, 960), 960)


def test_the_drawn_part_of_a_circle_is_its_arc() -> None:
    """As of a penalty arc: the picture shows where the whole circle would lie, a third of it is drawn."""
    scene = paint_scene(markings=(ring(0.0, RADIUS_M, -5.5), upright(-5.5, 20.0)), noise=1.5)
    arc = arc_of(scene)
    assert arc is not None
    x, _ = scene.camera.back_project(arc.points).T
    assert len(arc.points) > 40
    assert x.max() < -5.0
    assert np.abs(sampson_distance(scene.conic, arc.points)).max() < 1.2


def test_a_line_and_scattered_pieces_are_no_arc() -> None:
    assert arc_of(paint_scene(markings=(level(9.0),), noise=1.5)) is None
    assert arc_of(paint_scene(markings=tuple(upright(x) for x in (-8.0, -4.0, 0.0, 4.0, 8.0)), noise=1.5)) is None


def arc_on(ellipse: Ellipse, angles: np.ndarray, rms: float, share: float = 0.4) -> CircleHypothesis:
    return CircleHypothesis(conic_from_ellipse(ellipse), 1.0, 0.3, share, share, share, rms, ellipse.points(angles))


def test_of_arcs_along_one_marking_the_clean_one_is_kept() -> None:
    ellipse, other = (Ellipse(np.array([x, 300.0]), (200.0, 60.0), 0.0) for x in (500.0, 900.0))
    angles = np.linspace(0.0, 2.0, 100)
    clean, longer = arc_on(ellipse, angles[:60], 0.1), arc_on(ellipse, angles, 0.9)
    beside = arc_on(other, angles[:30], 0.1)
    assert select_arcs([longer, beside, clean], None, 1920) == (clean, beside)
    assert select_arcs([longer, beside, clean], longer, 1920) == (beside,)
    gapless = arc_on(ellipse, angles, 0.9, 0.7)
    assert select_arcs([longer, clean, gapless], None, 1920) == (gapless,)


def test_points_near_a_conic() -> None:
    ellipse = Ellipse(np.array([500.0, 300.0]), (200.0, 60.0), 0.0)
    points = np.concatenate([ellipse.points(np.linspace(0, 6, 50)), [[500.0, 300.0], [50.0, 50.0]]])
    near = lie_near_conics(points, [conic_from_ellipse(ellipse)], 3.0)
    assert near[:50].all()
    assert not near[50:].any()
    assert not lie_near_conics(points, [], 3.0).any()


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


def test_an_ellipse_beside_a_flat_side_is_moved_onto_it(main_view: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    gray, config = main_view.image[:, :, 1].copy(), ProfilesConfig()
    with monkeypatch.context() as patch:
        patch.setattr(circle_module, "ROUNDS", 1)
        wrong = measure_circle(gray, beside(main_view), 1.0, config)
    truth = main_view.circle_points()
    assert np.abs(sampson_distance(ellipse_conic(wrong.ellipse), truth)).max() > 4.0
    right = move_onto_straight_arcs(gray, wrong, far_side(main_view), config)
    assert np.abs(sampson_distance(ellipse_conic(right.ellipse), truth)).max() < 1.0


def test_lines_elsewhere_and_on_the_circle_change_nothing(main_view: Scene) -> None:
    gray, config = main_view.image[:, :, 1].copy(), ProfilesConfig()
    ellipse = ellipse_from_conic(main_view.conic)
    assert ellipse is not None
    frame = ellipse.frame()[None, :2]
    circle = measure_circle(gray, EllipseBatch(frame[:, :, 2], frame[:, :, 0], frame[:, :, 1]), 1.0, config)
    halfway = main_view.camera.project(np.array([[0.0, -15.0], [0.0, 15.0]]))[None]
    touchline = main_view.camera.project(np.array([[-20.0, -34.0], [20.0, -34.0]]))[None]
    for segments in (np.zeros((0, 2, 2)), far_side(main_view), np.concatenate([halfway, touchline])):
        assert move_onto_straight_arcs(gray, circle, segments, config) is circle
