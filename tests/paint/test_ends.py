"""Where the paint of a line ends: found to a pixel, and never where it is merely covered or cut."""

import cv2
import numpy as np
import pytest

from circlecal.paint.ends import paint_ends

SIZE = (1080, 1920)
MIDDLE = np.array([960.0, 540.0])


def picture_of(end, crossing=True, bend=0.0, seed=0):
    """A light line from the lower border up to the row ``end``, and another one across its end."""
    rng = np.random.default_rng(seed)
    fine = np.full((SIZE[0] * 4, SIZE[1]), 90.0, np.float32)
    rows = np.arange(len(fine)) / 4.0 - 0.375
    x = 960.0 + 0.1 * (rows - 540.0) + bend * ((rows - 540.0) / 500.0) ** 2
    columns = np.arange(SIZE[1])
    paint = (np.abs(columns - x[:, None]) < 2.5) & (rows >= end)[:, None]
    if crossing:
        paint |= ((rows < end) & (rows >= end - 3.0))[:, None]
    fine[paint] = 170.0
    picture = cv2.resize(fine, SIZE[::-1], interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(picture, (0, 0), 0.8) + rng.normal(0, 2.0, SIZE).astype(np.float32)


def points_of(bend=0.0, first=300.0):
    rows = np.arange(first, 1075.0, 4.0)
    return np.stack([960.0 + 0.1 * (rows - 540.0) + bend * ((rows - 540.0) / 500.0) ** 2, rows], axis=-1)


@pytest.mark.parametrize("bend", [0.0, 6.0])
@pytest.mark.parametrize("end", [201.25, 180.0])
def test_an_end_on_another_line(end, bend):
    (found,) = paint_ends(picture_of(end, bend=bend), points_of(bend), MIDDLE, 150.0)
    assert found.point_px[1] == pytest.approx(end, abs=1.0)
    assert found.crossed


def test_an_end_at_which_nothing_crosses():
    (found,) = paint_ends(picture_of(190.0, crossing=False), points_of(), MIDDLE, 150.0)
    assert found.point_px[1] == pytest.approx(190.0, abs=1.0)
    assert not found.crossed


def test_a_covered_piece_is_no_end():
    picture = picture_of(150.0)
    picture[260:300, 900:1000] = 60.0
    (found,) = paint_ends(picture, points_of(), MIDDLE, 150.0)
    assert found.point_px[1] == pytest.approx(150.0, abs=1.0)


def test_a_line_cut_by_the_border_has_no_end():
    assert paint_ends(picture_of(-50.0), points_of(), MIDDLE, 150.0) == ()


def test_nothing_is_found_behind_a_line_that_was_lost():
    """Stands behind the field are full of stripes."""
    picture = picture_of(700.0, crossing=False)
    picture[100:330] = picture_of(120.0)[100:330]
    found = paint_ends(picture, points_of(first=720.0), np.array([980.0, 800.0]), 40.0)
    assert all(end.point_px[1] > 600.0 for end in found)


def test_points_that_run_on_over_something_else_do_not_matter():
    picture = picture_of(240.0)
    points = points_of(first=120.0)
    points[points[:, 1] < 240.0] += [9.0, 0.0]
    (found,) = paint_ends(picture, points, MIDDLE, 150.0)
    assert found.point_px[1] == pytest.approx(240.0, abs=1.0)


def test_feet_on_the_end_are_no_crossing_line():
    """Two light boots beside the end of a line 5 px wide, as a player wears them who stands there."""
    picture = picture_of(200.0, crossing=False)
    for x in (915, 923):
        picture[197:202, x - 4 : x + 4] = 170.0
    picture[197:202, 933:941] = 170.0
    (found,) = paint_ends(picture, points_of(), MIDDLE, 150.0, np.array([0.0, 0.0, 5.0]))
    assert not found.crossed
    (true,) = paint_ends(picture_of(200.0), points_of(), MIDDLE, 150.0, np.array([0.0, 0.0, 5.0]))
    assert true.crossed


def test_letters_on_a_board_behind_a_player_are_no_crossing_line():
    """They are a hundred levels lighter than what is beside them here, and ten there."""
    picture = picture_of(200.0, crossing=False)
    for away, contrast in zip((7, *range(15, 45, 5)), (90.0, 9.0, 120.0, 60.0, 8.0, 120.0, 8.0), strict=True):
        for x in (926 - away, 926 + away):
            picture[196:203, x - 3 : x + 3] = 90.0 + contrast
    (found,) = paint_ends(picture, points_of(), MIDDLE, 150.0, np.array([0.0, 0.0, 5.0]))
    assert not found.crossed
