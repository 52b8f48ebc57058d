"""Ends of the halfway line's paint on bare ground: a pitch's lie at other lines, at a player's feet or outside."""

import cv2
import numpy as np
import pytest

from circlecal.field.view import FieldView
from circlecal.results import Verdict
from circlecal.stages.bare_ends import count_bare_ends
from circlecal.stages.verdict_on_picture import judge_ends

from .conftest import SOCCER, view

CAMERA = view(position=(3.0, 75.0, -28.0), target=(0.0, 0.0, 0.0), focal=1150.0)
CLOSE = view(position=(3.0, 75.0, -28.0), target=(0.0, 0.0, 0.0), focal=2600.0)
GROUND, PAINT = 90.0, 110.0
FAR, NEAR = -24.0, 22.0
"""Where the line of a drawn picture ends, metres."""


def paint(camera, far, near, crossed=()):
    """Grass with the circle, the halfway line between two places, and lines that cross it."""
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    circle = 9.15 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lines = [((0.0, far), (0.0, near)), *(((-40.0, y), (40.0, y)) for y in crossed)]
    picture = np.zeros((camera.height, camera.width))
    for points in (circle, *(np.linspace(*map(np.asarray, ends), 400) for ends in lines)):
        pixels = np.round(16 * camera.project(points)).astype(np.int32)
        cv2.polylines(picture, [pixels.reshape(-1, 1, 2)], False, (PAINT,), 3, cv2.LINE_AA, 4)
    ground = np.random.default_rng(0).normal(GROUND, 3, picture.shape)
    return (ground + cv2.GaussianBlur(picture, (0, 0), 0.8)).clip(0, 255).astype(np.uint8)


def count(picture, camera=CAMERA):
    return count_bare_ends(picture, FieldView(camera), SOCCER)


def test_a_line_that_is_drawn_on_bare_ground_has_two_bare_ends():
    assert count(paint(CAMERA, FAR, NEAR)) == 2


@pytest.mark.parametrize("crossed", [(-34.0, 34.0), (-30.0, 30.0)])
def test_a_pitch_s_line_ends_at_its_touchlines_where_the_camera_expects_others_too(crossed):
    assert count(paint(CAMERA, *crossed, crossed)) == 0


def test_a_line_that_leaves_the_picture_has_no_bare_end():
    assert count(paint(CLOSE, -34.0, 34.0), CLOSE) == 0


def test_an_end_that_something_hides_is_not_bare():
    picture = paint(CAMERA, FAR, NEAR)
    x, y = CAMERA.project(np.array([(0.0, NEAR + 0.5)]))[0].astype(int)
    picture[y - 25 : y + 25, x - 25 : x + 25] = np.random.default_rng(1).integers(20, 230, (50, 50))
    assert count(picture) == 1


def test_a_picture_without_the_line_has_no_bare_end():
    assert count(np.full((CAMERA.height, CAMERA.width), int(GROUND), np.uint8)) == 0


def test_one_end_may_be_worn_off_and_two_speak_against_the_camera():
    calibrated = Verdict("calibrated", None, None, None)
    assert [judge_ends(calibrated, ends).code for ends in (0, 1, 2)] == [None, None, "markings_missing"]
