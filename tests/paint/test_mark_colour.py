"""The centre mark has the paint of its line: what is coloured over it is a player's shirt."""

import numpy as np
import pytest

from circlecal.paint.mark_colour import leave_out_other_mark
from circlecal.results import Cues, LineCue, MarkCue, Segment

GRASS, PAINT = (40, 120, 60), (180, 230, 190)


def look_at(colour: tuple[int, int, int], paint: tuple[int, int, int] = PAINT) -> Cues:
    """A vertical line, a patch of some colour on it, and a mark that was found there."""
    image = np.full((360, 640, 3), GRASS, np.uint8)
    image[:, 319:322] = paint
    image[170:190, 310:331] = colour
    y = np.arange(60.0, 300.0, 4.0)
    points = np.stack([np.full(len(y), 320.0), y], axis=-1)
    along = Segment(points[0], points[-1])
    line = LineCue("halfway_line", np.array([1.0, 0.0, -320.0]), points, np.full(len(y), 0.1), along, 0.1)
    return leave_out_other_mark(image, Cues(line, MarkCue("centre_mark", np.array([320.0, 180.0]), 0.3, 20.0)))


@pytest.mark.parametrize(
    ("colour", "is_kept"),
    [(PAINT, True), ((120, 185, 130), True), ((230, 170, 90), False), ((60, 60, 220), False)],
    ids=["paint", "worn paint", "light blue", "red"],
)
def test_a_mark_of_another_colour_than_its_line_is_left_out(colour, is_kept):
    assert (look_at(colour).mark is not None) == is_kept


def test_a_mark_whose_line_adds_too_little_colour_is_kept():
    assert look_at((60, 60, 220), (44, 126, 66)).mark is not None


def test_without_a_mark_nothing_changes():
    cues = Cues(None, None)
    assert leave_out_other_mark(np.zeros((9, 16, 3), np.uint8), cues) is cues
