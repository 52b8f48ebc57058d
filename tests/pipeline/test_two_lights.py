"""Markings in the sun and in the shade, of one field."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.pipeline.two_lights import join_lights
from circlecal.results import MarkingMask, Segment

SUN, SHADE, TRACK = (42, 117, 81), (33, 72, 51), (60, 80, 150)
BOTTOM, TOP = np.arange(90) >= 45, np.arange(90) < 45


def segment(*ends: float) -> Segment:
    return Segment(np.array(ends[:2]), np.array(ends[2:]), 1.0)


def seen_on(rows: np.ndarray, *lines: Segment, polarity: float = 1.0) -> MarkingMask:
    region = np.repeat(rows[:, None], 160, axis=1)
    drawn = np.repeat(np.repeat(region, 4, axis=0), 4, axis=1) * np.uint8(17)
    return MarkingMask(drawn, "detector", lines=lines, field_region=region, polarity=polarity)


def picture(top: tuple[int, int, int]) -> np.ndarray:
    image = np.empty((360, 640, 3), np.uint8)
    image[:180], image[180:] = top, SUN
    return image


IN_SUN, IN_SHADE, GOES_ON = segment(10, 300, 600, 310), segment(10, 60, 600, 70), segment(300, 170, 320, 300)
AGAIN = segment(302, 183, 310, 235)  # a part of the line that goes on


@pytest.mark.parametrize(
    ("top", "polarity", "joins"),
    [(SHADE, 1.0, True), (TRACK, 1.0, False), ((90, 90, 90), 1.0, False), (SHADE, -1.0, False)],
)
def test_lines_in_the_shade_of_the_field_are_added(top, polarity, joins):
    first = seen_on(BOTTOM, IN_SUN, AGAIN)
    shaded = seen_on(TOP, IN_SHADE, GOES_ON, polarity=polarity)
    joined = join_lights(replace(first, sightings=(first, shaded)), picture(top))
    assert (joined is not None) is joins
    if joined is not None:
        assert [id(line) for line in joined.lines] == [id(line) for line in (IN_SUN, IN_SHADE, GOES_ON)]
        assert joined.field_region is not None
        assert joined.field_region.all()
        assert (joined.classes == 17).all()


def test_a_line_that_both_parts_show_is_taken_once():
    first = seen_on(BOTTOM, IN_SUN, GOES_ON)
    shaded = seen_on(TOP, AGAIN)
    assert join_lights(replace(first, sightings=(first, shaded)), picture(SHADE)) is None
    joined = join_lights(replace(first, sightings=(first, seen_on(TOP, AGAIN, IN_SHADE))), picture(SHADE))
    assert joined is not None
    assert [id(line) for line in joined.lines] == [id(line) for line in (IN_SUN, GOES_ON, IN_SHADE)]


def test_nothing_is_added_where_one_surface_was_searched():
    first = seen_on(BOTTOM, IN_SUN)
    assert join_lights(replace(first, sightings=(first,)), picture(SHADE)) is None
    assert join_lights(replace(first, field_region=None, sightings=(first, first)), picture(SHADE)) is None
