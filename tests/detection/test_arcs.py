import numpy as np

from circlecal.detection.arcs import SAME_ARC, distinct_arcs, drawn_arc, near_conics
from circlecal.detection.circle import CircleHypothesis, hypothesis_of, measure_circle
from circlecal.detection.hypotheses import EllipseBatch
from circlecal.detection.options import LikelyConfig
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse, ellipse_from_conic
from circlecal.paint.bands import RefinementConfig

from .conftest import RADIUS_M, Scene, level, paint_scene, ring, upright


def arc_of(scene: Scene) -> CircleHypothesis | None:
    frame = ellipse_from_conic(scene.conic).frame()
    start = EllipseBatch(frame[None, :2, 2] + 1.0, frame[None, :2, 0] * 1.01, frame[None, :2, 1])
    circle = measure_circle(scene.image[:, :, 1].copy(), start, 1.0, RefinementConfig())
    return drawn_arc(circle, hypothesis_of(circle, 1.0, 960), 960, LikelyConfig())


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
    assert distinct_arcs([longer, beside, clean], None, SAME_ARC * 1920, 0.65) == (clean, beside)
    assert distinct_arcs([longer, beside, clean], longer, SAME_ARC * 1920, 0.65) == (beside,)
    gapless = arc_on(ellipse, angles, 0.9, 0.7)
    assert distinct_arcs([longer, clean, gapless], None, SAME_ARC * 1920, 0.65) == (gapless,)


def test_points_near_a_conic() -> None:
    ellipse = Ellipse(np.array([500.0, 300.0]), (200.0, 60.0), 0.0)
    points = np.concatenate([ellipse.points(np.linspace(0, 6, 50)), [[500.0, 300.0], [50.0, 50.0]]])
    near = near_conics(points, [conic_from_ellipse(ellipse)], 3.0)
    assert near[:50].all()
    assert not near[50:].any()
    assert not near_conics(points, [], 3.0).any()
