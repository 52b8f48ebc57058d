"""How long a field is, where lines at one end carry the camera and a piece of the circle is in view."""

import cv2
import numpy as np
import pytest

from circlecal.camera.options import CameraConfig
from circlecal.config import Config
from circlecal.geometry.camera_parameters import INDEX
from circlecal.pipeline import field_of
from circlecal.pipeline.size_by_circle import HALF_CIRCLE, find_size_by_circle, misses_circle
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera
from tests.stages.camera_views import CIRCLE, SOCCER, seen

LINES = ("big_rect_left_main", "big_rect_left_top", "side_line_left", "side_line_top", "small_rect_left_main")


def see_end(length_m, target_m=(-24.0, -10.0, 0.0)):
    """A camera by the lines at one end of a field of some length, and the picture with the circle drawn."""
    camera = aim_camera(np.array([-12.0, 62.0, -17.0]), np.array(target_m), 1300.0, 0.01, 1280, 720)
    template, _ = field_of(Config.model_validate({"field": {"sizes": {"length": length_m}}}))
    picture = np.random.default_rng(3).normal(90.0, 2.0, (720, 1280)).astype(np.uint8)
    ring = camera.project(template.curve_points(template.circles[0], "center", np.linspace(0.0, 2 * np.pi, 721)))
    fixed = np.rint(ring * 16.0).astype(np.int32)
    cv2.polylines(picture, [fixed[:, None]], True, 200, 3, cv2.LINE_AA, shift=4)
    given = seen(camera, line=None, circles=(), lines=LINES, template=template)
    return estimate_camera(given, SOCCER, CIRCLE, CameraConfig()), picture


@pytest.mark.parametrize("length_m", [101.0, 104.0, 108.0])
def test_the_circle_tells_how_long_the_field_is(length_m):
    fit, picture = see_end(length_m)
    found = find_size_by_circle(picture, fit, SOCCER, CIRCLE)
    assert found is not None
    # as well as lines at one end tell where the circle is seen
    assert found.theta[INDEX["length"]] + SOCCER.length_m == pytest.approx(length_m, abs=1.0)
    # what was seen is seen where it was
    line = np.array([[-found.theta[INDEX["length"]] / 2 - 36.0, 4.0]])
    before = np.array([[-fit.theta[INDEX["length"]] / 2 - 36.0, 4.0]])
    np.testing.assert_allclose(found.camera.project(line), fit.camera.project(before), atol=0.1)


def test_bare_grass_and_a_circle_out_of_view_tell_nothing():
    fit, picture = see_end(101.0)
    assert find_size_by_circle(np.full_like(picture, 90), fit, SOCCER, CIRCLE) is None
    away, picture = see_end(101.0, (-52.0, -10.0, 0.0))
    assert find_size_by_circle(picture, away, SOCCER, CIRCLE) is None


def test_a_field_of_known_length_is_not_asked():
    fit, picture = see_end(101.0)
    known = SOCCER.model_copy(update={"length_range_m": None})
    assert find_size_by_circle(picture, fit, known, CIRCLE) is None


def test_a_circle_in_view_is_missed_by_lines_at_one_end():
    fit, _ = see_end(101.0)
    assert misses_circle(fit, SOCCER, CIRCLE)
    whole, _ = see_end(101.0, (-14.0, -4.0, 0.0))
    assert misses_circle(whole, SOCCER, CIRCLE, HALF_CIRCLE)
    away, _ = see_end(101.0, (-52.0, -10.0, 0.0))
    assert not misses_circle(away, SOCCER, CIRCLE)
    assert not misses_circle(fit, SOCCER.model_copy(update={"length_range_m": None}), CIRCLE)
