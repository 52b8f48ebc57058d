"""Directions of a field and focal lengths from two pairs of lines, and from three lines and a level camera."""

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.projective import lift
from circlecal.line_naming.field_views import three_line_views, two_pair_views
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
CAMERA = aim_camera(np.array([-2.0, 62.0, -16.0]), np.array([-43.0, -2.0, 0.0]), 4200.0, 0.0, 1920, 1080)
HALF_WIDTH_PX = 960.0


def see(names):
    """Normalised lines (S, 3) and ends (S, 2, 2), half picture widths from the principal point."""
    ends = np.array([CAMERA.project(SOCCER.line_ends(SOCCER.line_by_name[name])) for name in names])
    ends = (ends - CAMERA.principal_point_px) / HALF_WIDTH_PX
    lines = np.cross(lift(ends[:, 0]), lift(ends[:, 1]))
    return lines / np.hypot(lines[:, 0], lines[:, 1])[:, None], ends


def error_of(views):
    """How far the best of the views is from the camera: of its focal length, relative, and of its axes."""
    focal = np.abs(views.focal * HALF_WIDTH_PX / CAMERA.focal_px[0] - 1.0)
    # a direction and its opposite are one
    cosines = np.abs((views.axes * CAMERA.R).sum(axis=1))
    return float((focal + (1.0 - cosines).sum(axis=1)).min(initial=np.inf))


ACROSS, ALONG = ("big_rect_left_main", "small_rect_left_main"), ("big_rect_left_top", "small_rect_left_top")


def test_two_pairs_give_the_view():
    lines, _ = see(ACROSS + ALONG)
    assert error_of(two_pair_views(lines)) < 1e-9


@pytest.mark.parametrize("names", [(*ACROSS, ALONG[0]), (*ALONG, ACROSS[0])])
def test_a_pair_and_one_line_give_the_view_of_a_level_camera(names):
    lines, ends = see(names)
    views = three_line_views(lines, ends)
    assert error_of(views) < 1e-9
    is_pair_along, is_pair_across = views.directions
    assert (is_pair_along ^ is_pair_across).all()
    assert len(two_pair_views(lines).focal) == 0


def test_parallel_lines_give_no_view_and_no_warning():
    lines = np.array([[0.0, 1.0, y] for y in (-0.4, 0.0, 0.3)])
    ends = np.array([[[-0.9, -y], [0.9, -y]] for _, _, y in lines])
    assert len(three_line_views(lines, ends).focal) == 0
