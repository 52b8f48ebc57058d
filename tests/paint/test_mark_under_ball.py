"""The centre mark on which a ball lies, where its place is known."""

import cv2
import numpy as np
import pytest

from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse
from circlecal.paint.centre_mark import find_centre_mark
from circlecal.paint.mark_under_ball import find_mark_under_ball

MIDDLE = np.array([300.0, 200.0])
AXES_PX = np.array([260.0, 62.0])
MARK, WIDTH = 0.045, 0.015
"""Diameter of the mark halved, and width of the line's paint, in radii of the circle."""
RADIUS_PX = 0.9 * MARK * AXES_PX[0]
BLUR_PX = 1.0


def paint(ball_m: float | None, is_marked: bool = True, level: float = 190.0) -> np.ndarray:
    """A vertical line with the mark, and a ball that touches the ground so far (half chords) towards the camera."""
    y, x = np.mgrid[:400, :600] - MIDDLE[::-1, None, None]
    painted = np.abs(x) < 0.5 * WIDTH * AXES_PX[0]
    if is_marked:
        painted |= np.hypot(x / AXES_PX[0], y / AXES_PX[1]) < MARK
    soft = cv2.GaussianBlur(painted.astype(np.float32), (0, 0), BLUR_PX)
    picture = 90.0 + 60.0 * soft + np.random.default_rng(0).normal(0.0, 2.0, x.shape)
    if ball_m is None:
        return picture.astype(np.float32)
    above = RADIUS_PX * np.sqrt(1.0 - (AXES_PX[1] / AXES_PX[0]) ** 2) - ball_m * AXES_PX[1]
    ball = cv2.GaussianBlur((np.hypot(x, y + above) < RADIUS_PX).astype(np.float32), (0, 0), BLUR_PX)
    return (picture * (1.0 - ball) + level * ball).astype(np.float32)


def given(picture: np.ndarray) -> tuple:
    points = MIDDLE + np.linspace(-0.98, 0.98, 90)[:, None] * (0.0, AXES_PX[1])
    conic = conic_from_ellipse(Ellipse(MIDDLE, tuple(AXES_PX), 0.0))
    line = np.array([1.0, 0.0, -MIDDLE[0]])
    return picture, line, points, conic, 2.0 * MARK, WIDTH, BLUR_PX, (-0.3, 0.3)


@pytest.mark.parametrize("level", [160.0, 190.0, 230.0])
def test_a_mark_is_found_below_the_ball_that_lies_on_it(level):
    seen = given(paint(0.0, level=level))
    found = find_mark_under_ball(*seen)
    assert found is not None
    assert found.point_px == pytest.approx(MIDDLE, abs=0.5)
    # which the search for a whole mark does not find
    assert find_centre_mark(*seen, 4.0) is None


@pytest.mark.parametrize(
    "picture",
    [paint(None), paint(None, is_marked=False), paint(0.0, is_marked=False), paint(0.25)],
    ids=["no ball", "bare line", "no mark", "ball before the mark"],
)
def test_no_mark_is_told_where_no_ball_lies_on_one(picture):
    assert find_mark_under_ball(*given(picture)) is None


def test_a_mark_of_which_too_little_is_seen_is_not_looked_for():
    """A half axis of 0.6 px along the line."""
    picture, line, points, _, *rest = given(paint(0.0))
    flat = conic_from_ellipse(Ellipse(MIDDLE, (AXES_PX[0], 14.0), 0.0))
    assert find_mark_under_ball(picture, line, points, flat, *rest) is None
