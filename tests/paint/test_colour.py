"""Colour of paint, and of the surface beside it."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.paint.bands import MeasuredCurve
from circlecal.paint.colour import lie_on_one_surface, measure_paint_colour, segments_match_paint

SEGMENTS = np.array([[[20.0, 100.0], [620.0, 100.0]], [[20.0, 200.0], [620.0, 210.0]]])


def picture(below: tuple[int, int, int]) -> np.ndarray:
    """Grass with a white line at y = 100; another surface from y = 200 ... 210 on, with a white line above it."""
    image = np.full((360, 640, 3), (60, 130, 70), np.uint8)
    x = np.arange(640)
    border = np.rint(200 + (x - 20) / 60.0).astype(int)
    image[np.arange(360)[:, None] > border] = below
    image[np.abs(np.arange(360)[:, None] - border) <= 1] = 230
    image[99:102] = 230
    return image


def level_line(width: float, first: float, last: float) -> MeasuredCurve:
    """A marking of this width along y = 100 that is seen at 90 places."""
    points = np.stack([np.linspace(first, last, 90), np.full(90, 100.0)], axis=-1)
    normals, seen = np.tile([0.0, 1.0], (90, 1)), np.ones(90, np.bool_)
    return MeasuredCurve(points, normals, np.zeros(90), np.full(90, 100.0), np.full(90, width), seen, seen)


def test_the_foot_of_a_board_is_no_marking() -> None:
    assert lie_on_one_surface(picture((150, 60, 200)), SEGMENTS).tolist() == [True, False]


def test_shade_beside_a_line_changes_nothing() -> None:
    assert lie_on_one_surface(picture((30, 65, 35)), SEGMENTS).all()


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("away_px", [3, 5, 7])
def test_a_line_of_another_sport_may_run_right_beside_a_marking(side: int, away_px: int) -> None:
    image = np.full((720, 1280, 3), (60, 130, 70), np.uint8)
    image[99:102] = 230
    image[99 + side * away_px : 102 + side * away_px] = (140, 100, 40)
    image[599:602] = 230
    image[602:630] = (140, 100, 40)  # a board is higher than a line is wide
    lines = np.array([[[20.0, y], [1260.0, y]] for y in (100.0, 600.0)])
    assert lie_on_one_surface(image, lines).tolist() == [True, False]


def test_no_segments() -> None:
    assert lie_on_one_surface(picture((0, 0, 0)), np.zeros((0, 2, 2))).shape == (0,)


def test_another_paint_than_the_circle_s_is_no_marking_of_the_field() -> None:
    image = np.full((360, 640, 3), (60, 130, 70), np.uint8)
    image[99:102] = (230, 230, 230)
    image[199:202] = (50, 190, 200)
    image[149:152] = (80, 145, 88)
    line = level_line(3.0, 20, 620)
    white = measure_paint_colour(image, line)
    assert white == pytest.approx([170, 100, 160], abs=1)
    lines = np.array([[[20.0, y], [620.0, y]] for y in (100.0, 150.0, 200.0, 300.0)])
    assert segments_match_paint(image, lines, white).tolist() == [True, True, False, True]
    assert segments_match_paint(image, lines, np.zeros(3)).all()
    assert segments_match_paint(image, lines[:0], white).shape == (0,)
    nowhere = replace(line, supported=np.zeros(90, np.bool_))
    assert measure_paint_colour(image, nowhere).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("width", [3, 9, 25])
def test_wide_paint_is_told_from_the_surface_beyond_it(width: int) -> None:
    image = np.full((720, 1280, 3), (60, 130, 70), np.uint8)
    image[100 - width // 2 : 101 + width // 2] = (230, 230, 230)
    image[300 - width // 2 : 301 + width // 2] = (50, 190, 200)
    white = measure_paint_colour(image, level_line(width, 20, 1260))
    assert white == pytest.approx([170, 100, 160], abs=1)
    lines = np.array([[[20.0, y], [1260.0, y]] for y in (100.0, 300.0)])
    # too faint beside the middle to tell
    assert segments_match_paint(image, lines, white).tolist() == [True, width == 25]
