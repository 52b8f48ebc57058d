"""Straight markings that are no paint of this field: of another paint, or before the end of the halfway line."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.surface import FLAT
from circlecal.observations import CirclePoints, LineEnd, LinePoints
from circlecal.pipeline.false_lines import leave_out_short_borders, leave_out_streaks
from circlecal.synthetic.cameras import aim_camera
from tests.stages.conftest import paint_field

FIELD = load_field("futsal")
CAMERA = aim_camera(np.array([-0.5, 26.0, -9.0]), np.array([0.0, 0.0, 0.0]), 1700.0, 0.0, 1280, 720)
VIEW = FieldView(CAMERA, FLAT)
BORDER = FIELD.line_by_name["side_line_top"]
AWAY_M = 1.2


def seen_line(name, away_m=0.0):
    """Points of a line in the picture, or so far before it, with its name."""
    ends = FIELD.line_ends(FIELD.line_by_name[name])
    points = VIEW.project(ends[0] + np.linspace(0.0, 1.0, 400)[:, None] * (ends[1] - ends[0]) + (0.0, away_m))
    points = points[VIEW.shows(points, -20.0)]
    return LinePoints(name, points, np.full(len(points), 0.2))


def seen_circle():
    circle = FIELD.circle_by_name["centre_circle"]
    angle = np.linspace(0.0, 2 * np.pi, 90)
    ring = FIELD.radius(circle, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return CirclePoints(circle.name, "center", VIEW.project(ring), np.full(90, 0.2))


def paint_streak(picture, grey, colour=(1.0, 1.0, 1.0)):
    """The picture with a line that is lighter than its floor by so many grey levels, before the far touchline."""
    first, last = seen_line(BORDER.name, AWAY_M).points_px[[0, -1]].round().astype(int).tolist()
    drawn = np.zeros(picture.shape, np.float32)
    cv2.line(drawn, first, last, tuple(grey * share for share in colour), 4)
    return np.clip(picture + cv2.GaussianBlur(drawn, (0, 0), 1.0), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("grey", "colour", "is_kept"),
    [(90.0, (1.0, 1.0, 1.0), True), (8.0, (1.0, 1.0, 1.0), False), (150.0, (0.0, 0.0, 1.0), False)],
)
def test_a_faint_streak_and_a_line_in_another_colour_are_no_marking(grey, colour, is_kept):
    picture = paint_streak(paint_field(CAMERA, FIELD), grey, colour)
    halfway, border, streak = seen_line("halfway_line"), seen_line(BORDER.name), seen_line(BORDER.name, AWAY_M)
    assert leave_out_streaks(picture, VIEW, FIELD, (seen_circle(),), (halfway, border), 1.0) == (halfway, border)
    kept = leave_out_streaks(picture, VIEW, FIELD, (seen_circle(),), (halfway, streak), 1.0)
    assert kept == ((halfway, streak) if is_kept else (halfway,))
    # nothing tells the paint
    assert leave_out_streaks(picture, VIEW, FIELD, (), (streak,), 1.0) == (streak,)
    assert leave_out_streaks(picture, VIEW, FIELD, (seen_circle(),), (), 1.0) == ()


def test_a_border_before_the_end_of_the_halfway_line_is_left_out():
    halfway, border, streak = seen_line("halfway_line"), seen_line(BORDER.name), seen_line(BORDER.name, 2 * AWAY_M)
    ends, center = (LineEnd(VIEW.project(np.array([0.0, -10.0])), False),), np.zeros(2)
    other = replace(streak, line="area_left_main")
    assert leave_out_short_borders(VIEW, FIELD, center, (halfway, border), ends) == (halfway, border)
    assert leave_out_short_borders(VIEW, FIELD, center, (halfway, streak, other), ends) == (halfway, other)
    assert leave_out_short_borders(VIEW, FIELD, center, (streak,), ()) == (streak,)
    no_halfway = FIELD.model_copy(update={"halfway_line": None})
    assert leave_out_short_borders(VIEW, no_halfway, center, (streak,), ends) == (streak,)
