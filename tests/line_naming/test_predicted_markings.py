"""What a named picture should show and does not, and what it shows beyond the markings."""

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.camera_parameters import ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.line_naming.predicted_markings import missing_px, overhang_px
from circlecal.synthetic.cameras import aim_camera, inside_frame

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080, Surface("flat"))
CAMERA = aim_camera(np.array([-10.0, 62.0, -18.0]), np.array([-31.0, -8.0, 0.0]), 2400.0, 0.01, 1920, 1080)
THETA = theta_of(CAMERA, MODEL)
LONG = (
    "side_line_top",
    "side_line_left",
    "big_rect_left_main",
    "big_rect_left_top",
    "big_rect_left_bottom",
    "small_rect_left_main",
)


def visible(name):
    ends = SOCCER.line_ends(SOCCER.line_by_name[name])
    points = CAMERA.project(np.linspace(ends[0], ends[1], 2000))
    return points[inside_frame(points, 1920, 1080)][[0, -1]]


def length(segment):
    return float(np.linalg.norm(segment[1] - segment[0]))


def unseen(names, segments):
    return missing_px(names, np.array(segments).reshape(-1, 2, 2), THETA, SOCCER, MODEL)


def test_everything_long_is_seen():
    names = dict(enumerate(LONG))
    assert unseen(names, [visible(name) for name in LONG]) == 0.0


@pytest.mark.parametrize("missing", LONG[:3])
def test_a_line_that_is_not_seen_counts_with_its_length(missing):
    names = dict(enumerate(name for name in LONG if name != missing))
    expected = length(visible(missing))
    assert expected > 0.15 * 1920
    assert unseen(names, [visible(name) for name in names.values()]) == pytest.approx(expected, rel=0.05)


def test_a_third_of_a_line_is_enough_and_a_tenth_is_not():
    others = [visible(name) for name in LONG[1:]]
    names = dict(enumerate(LONG))
    first, last = visible(LONG[0])
    for share, nothing in ((0.35, True), (0.1, False)):
        assert (unseen(names, [[first, first + share * (last - first)], *others]) == 0.0) == nothing


def test_lines_outside_the_picture_and_short_ones_are_not_expected():
    assert unseen({}, []) < sum(length(visible(name)) for name in LONG) + 0.15 * 1920
    away = aim_camera(np.array([0.0, 62.0, -18.0]), np.array([0.0, 0.0, 0.0]), 9000.0, 0.0, 1920, 1080)
    shown = missing_px({}, np.zeros((0, 2, 2)), theta_of(away, MODEL), SOCCER, MODEL)
    assert shown == pytest.approx(1080.0, rel=0.1)  # the halfway line from the top of the picture to its bottom


def test_paint_too_thin_to_be_seen_is_not_expected():
    """A pitchside camera sees the touchline on the other side half a pixel wide, the penalty area's lines wider."""
    low = aim_camera(np.array([-10.0, 62.0, -4.0]), np.array([-36.0, 10.0, 0.0]), 2400.0, 0.0, 1920, 1080)
    missing = missing_px({}, np.zeros((0, 2, 2)), theta_of(low, MODEL), SOCCER, MODEL)
    high = aim_camera(np.array([-10.0, 62.0, -18.0]), np.array([-36.0, 10.0, 0.0]), 2400.0, 0.0, 1920, 1080)
    far = high.project(np.linspace([-52.5, -34.0], [52.5, -34.0], 2000))
    assert length(far[inside_frame(far, 1920, 1080)][[0, -1]]) > 800
    assert missing < missing_px({}, np.zeros((0, 2, 2)), theta_of(high, MODEL), SOCCER, MODEL) - 800


def test_lines_end_with_their_markings():
    segment = visible("big_rect_left_main")
    assert overhang_px({0: "big_rect_left_main"}, segment[None], THETA, SOCCER, MODEL) == 0.0
    longer = np.array([segment[0], segment[0] + 1.5 * (segment[1] - segment[0])])
    beyond = overhang_px({0: "big_rect_left_main"}, longer[None], THETA, SOCCER, MODEL)
    assert 0.3 * length(segment) < beyond < 0.55 * length(segment)
