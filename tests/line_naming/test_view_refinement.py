"""Rough cameras are moved onto the lines and curves that have a name under them."""

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.camera_parameters import LOG_FOCAL, PAN, POSITION, ProjectionModel, project, theta_of
from circlecal.line_naming.view_refinement import SeenMarkings, refine_views
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080)
CAMERA = aim_camera(np.array([-1.0, 65.0, -17.0]), np.array([-24.0, -4.0, 0.0]), 1700.0, 0.0, 1920, 1080)
TRUTH = theta_of(CAMERA, MODEL, 0.0)
LINES = ("side_line_left", "big_rect_left_main", "big_rect_left_top", "side_line_top")
INDEX = {line.name: k for k, line in enumerate(SOCCER.lines)}
CIRCLE = next(k for k, curve in enumerate(SOCCER.round_ones) if curve.name == "centre_circle")
NO_CURVES = np.zeros((0, 12, 2)), np.zeros((1, 0), int)


def ends_of(name):
    """Ends (2, 2) of what the picture shows of a line."""
    points = CAMERA.project(np.linspace(*SOCCER.line_ends(SOCCER.line_by_name[name]), 400))
    with np.errstate(invalid="ignore"):
        inside = ((points >= 0) & (points <= (1919, 1079))).all(axis=1)
    return points[inside][[0, -1]]


def arc_of_circle():
    """Points (12, 2) of the part of the centre circle that is nearest to the left goal."""
    circle = SOCCER.round_ones[CIRCLE]
    return CAMERA.project(SOCCER.curve_points(circle, "center", np.radians(np.linspace(130.0, 230.0, 12))))


def rough():
    """A camera that is off in focal length, pan and place."""
    theta = TRUTH.copy()
    theta[LOG_FOCAL] += 0.06
    theta[PAN] += 0.02
    theta[POSITION] += (1.5, -2.0, 1.0)
    return theta[None]


def seen(names=LINES, with_circle=True):
    """What the picture shows, under given names for its lines."""
    points, rings = (arc_of_circle()[None], np.array([[CIRCLE]])) if with_circle else NO_CURVES
    segments = np.array([ends_of(name) for name in LINES])
    return SeenMarkings(segments, np.array([[INDEX.get(name, -1) for name in names]]), points, rings)


def off_px(theta):
    """Mean distance of the centre circle under a camera (1, P) from where it is, pixels."""
    circle = SOCCER.curve_points(SOCCER.round_ones[CIRCLE], "center", np.radians(np.arange(0.0, 360.0, 5.0)))
    found = project(theta, circle[None], MODEL).pixels[0]
    return float(np.linalg.norm(found - CAMERA.project(circle), axis=1).mean())


def test_lines_and_a_part_of_the_circle_move_a_rough_camera_to_its_place():
    found = refine_views(rough(), seen(), SOCCER, SOCCER.round_ones, MODEL)
    assert off_px(rough()) > 30.0
    assert off_px(found) < 3.0


def test_the_circle_tells_what_lines_of_one_end_do_not():
    alone = refine_views(rough(), seen(with_circle=False), SOCCER, SOCCER.round_ones, MODEL)
    both = refine_views(rough(), seen(), SOCCER, SOCCER.round_ones, MODEL)
    assert off_px(both) < 0.5 * off_px(alone)


def test_a_right_camera_stays_and_a_wrong_name_moves_it_little():
    right = refine_views(TRUTH[None], seen(), SOCCER, SOCCER.round_ones, MODEL)
    assert off_px(right) < 0.5
    wrong = ("side_line_left", "big_rect_left_main", "small_rect_left_top", "side_line_top")
    assert off_px(refine_views(TRUTH[None], seen(wrong), SOCCER, SOCCER.round_ones, MODEL)) < 60.0


def test_every_camera_is_moved_by_its_own_names():
    one = seen(("side_line_left", None, None, None), with_circle=False)
    names = np.concatenate([seen().markings, one.markings])
    rings = np.array([[CIRCLE], [-1]])
    both = SeenMarkings(one.segments, names, arc_of_circle()[None], rings)
    found = refine_views(np.repeat(rough(), 2, axis=0), both, SOCCER, SOCCER.round_ones, MODEL)
    assert found[0] == pytest.approx(refine_views(rough(), seen(), SOCCER, SOCCER.round_ones, MODEL)[0])
    assert off_px(found[:1]) < 3.0 < off_px(found[1:])
