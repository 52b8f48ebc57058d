"""Observations become residuals: which radius, which sigma, how thinned."""

import numpy as np
import pytest

from circlecal.camera.observed import (
    NoiseModel,
    curves_from_observations,
    points_from_observations,
    with_model_noise,
)
from circlecal.camera.options import CameraConfig, relief_of
from circlecal.field import load_field
from circlecal.geometry.ellipses import Ellipse
from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkingKey, MarkPoint, Observations
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
ELLIPSE = Ellipse(np.array([900.0, 500.0]), (500.0, 150.0), 0.03)
EXACT = NoiseModel(10**6, 0.0, 0.0)


def ring(count, rng=None, sigma=0.0):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    points = ELLIPSE.points(angle)
    if rng is not None:
        points = points + rng.normal(0, sigma, count)[:, None] * ELLIPSE.normals(angle)
    return points


@pytest.mark.parametrize(
    ("edge", "radius", "by_width", "bloom"),
    [("outer", 9.15, 0.0, 1), ("center", 9.09, -0.5, 0), ("inner", 9.03, -1, -1)],
)
def test_edges_of_the_circle_follow_the_laws(edge, radius, by_width, bloom):
    points = ring(30)
    curves = curves_from_observations(
        Observations(1920, 1080, (CirclePoints("centre_circle", edge, points, np.full(30, 0.4)),)), SOCCER, EXACT
    )
    assert curves.keys == (MarkingKey("centre_circle", edge),)
    np.testing.assert_allclose(curves.radius, radius)
    np.testing.assert_allclose(curves.radius_by_width, by_width)
    np.testing.assert_allclose(curves.bloom_sign, bloom)
    np.testing.assert_array_equal(curves.points_px, points)
    np.testing.assert_allclose(curves.sigma_px, 0.4)


def test_what_the_template_does_not_know_is_left_out():
    line = np.stack([np.linspace(0, 100, 10), np.zeros(10)], axis=-1)
    one = np.ones(10)
    seen = Observations(
        1920,
        1080,
        (CirclePoints("no_such_circle", "outer", line, one),),
        (LinePoints(None, line, one), LinePoints("no_such_line", line, one), LinePoints("halfway_line", line, one)),
        (MarkPoint("no_such_mark", np.zeros(2), 1.0), MarkPoint("centre_mark", np.ones(2), 2.0)),
        (Keypoint("corner", np.array([52.5, 34.0]), np.array([5.0, 6.0]), 3.0),),
    )
    assert curves_from_observations(seen, SOCCER, EXACT).keys == (MarkingKey("halfway_line"),)
    points = points_from_observations(seen, SOCCER)
    assert points.keys == (MarkingKey("centre_mark"), MarkingKey("corner"))
    np.testing.assert_allclose(points.field_m, [[0.0, 0.0], [52.5, 34.0]])
    np.testing.assert_allclose(points.sigma_px, [2.0, 3.0])


def test_thinning_averages_and_keeps_the_information():
    rng = np.random.default_rng(1)
    sigma = 0.6
    points = ring(1200, rng, sigma)
    seen = Observations(1920, 1080, (CirclePoints("centre_circle", "outer", points, np.full(1200, sigma)),))
    curves = curves_from_observations(seen, SOCCER, NoiseModel(120, 0.0, 0.0))
    assert len(curves.points_px) == 120
    np.testing.assert_allclose(curves.sigma_px, sigma / np.sqrt(10))
    angle = ELLIPSE.parameter(curves.points_px)
    distance = np.sum((curves.points_px - ELLIPSE.points(angle)) * ELLIPSE.normals(angle), axis=-1)
    assert 0.75 < distance.std() / (sigma / np.sqrt(10)) < 1.25
    assert abs(distance.mean()) < 4 * sigma / np.sqrt(1200)


def test_thinning_of_an_arc_does_not_bridge_its_gap():
    angle = np.linspace(0.3, 2.6, 400)
    points = ELLIPSE.points(angle)
    seen = Observations(1920, 1080, (CirclePoints("centre_circle", "outer", points, np.ones(400)),))
    curves = curves_from_observations(seen, SOCCER, NoiseModel(60, 0.0, 0.0))
    foot = ELLIPSE.points(ELLIPSE.parameter(curves.points_px))
    assert np.linalg.norm(curves.points_px - foot, axis=-1).max() < 1e-6


def test_thinned_lines_stay_on_their_line():
    rng = np.random.default_rng(2)
    along = rng.uniform(0, 800, 1000)
    points = np.stack([100 + along, 50 + 0.3 * along], axis=-1)
    seen = Observations(1920, 1080, lines=(LinePoints("halfway_line", points, np.full(1000, 0.5)),))
    curves = curves_from_observations(seen, SOCCER, NoiseModel(50, 0.0, 0.0))
    assert len(curves.points_px) == 50
    np.testing.assert_allclose(curves.points_px[:, 1], 50 + 0.3 * (curves.points_px[:, 0] - 100), atol=1e-9)
    np.testing.assert_allclose(curves.sigma_px, 0.5 / np.sqrt(20))


def test_more_points_do_not_outvote_the_model_error():
    """The information of a whole marking is bounded by its number of correlation lengths."""
    information = []
    for count in (100, 400, 1600):
        seen = Observations(1920, 1080, (CirclePoints("centre_circle", "outer", ring(count), np.full(count, 1e-3)),))
        curves = curves_from_observations(seen, SOCCER, NoiseModel(10**6, 0.3, 60.0))
        information.append(float(np.sum(1 / curves.sigma_px**2)))
    assert information[1] == pytest.approx(information[0], rel=0.01)
    assert information[2] == pytest.approx(information[0], rel=0.01)
    # about 2100 px of outline are some 35 independent lengths of 0.3 px each
    assert 25 < information[0] * 0.3**2 < 45


def test_the_error_of_the_model_can_be_exchanged():
    line = LinePoints("halfway_line", np.stack([np.linspace(0, 900, 300), np.zeros(300)], axis=-1), np.full(300, 0.2))
    seen = Observations(1920, 1080, (CirclePoints("centre_circle", "center", ring(400), np.full(400, 0.1)),), (line,))
    loud, quiet = NoiseModel(240, 0.3, 60.0), NoiseModel(240, 0.05, 60.0)
    curves = curves_from_observations(seen, SOCCER, loud)
    np.testing.assert_allclose(
        with_model_noise(curves, curves.sigma_px, loud, 0.05),
        curves_from_observations(seen, SOCCER, quiet).sigma_px,
        rtol=0.05,
    )
    assert (with_model_noise(curves, 0.1 * curves.sigma_px, loud, 0.0) > 0.0).all()


def test_a_mark_on_grass_may_lie_higher_or_lower_than_the_profile():
    camera = aim_camera(np.array([-4.0, 60.0, -16.0]), np.zeros(3), 2600.0, 0.0, 1920, 1080)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim = camera.project(9.09 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    seen = Observations(
        1920,
        1080,
        (CirclePoints("centre_circle", "center", rim, np.ones(200)),),
        marks=(MarkPoint("centre_mark", camera.project([0.0, 0.0]), 0.4),),
        keypoints=(Keypoint("corner", np.array([52.5, 34.0]), np.array([5.0, 6.0]), 3.0),),
    )
    points = points_from_observations(seen, SOCCER, relief_m=0.02)
    higher = camera.project(np.array([[0.0, 0.0, -0.02], [0.0, 0.0, 0.0]]))
    rise_px = np.linalg.norm(higher[0] - higher[1])
    np.testing.assert_allclose(points.sigma_px, [0.4, 3.0])
    np.testing.assert_allclose(points.upright_px, [np.hypot(0.4, rise_px), 3.0], rtol=0.01)
    np.testing.assert_allclose(points.across[:, 0], [1.0 / 0.4, 0.0])
    np.testing.assert_allclose(points.across[:, 1], [0.0, 1.0 / points.upright_px[0]])
    assert points_from_observations(seen, SOCCER).upright_px is None
    assert relief_of(CameraConfig(), SOCCER) > 0.0
    assert relief_of(CameraConfig(crown_shape="flat"), SOCCER) == relief_of(CameraConfig(), load_field("futsal")) == 0.0
