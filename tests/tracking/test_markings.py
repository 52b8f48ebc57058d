"""What is taken for the paint of a marking."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.tracking.markings import Places, measure_markings
from circlecal.tracking.one_line import keep_one_line


@pytest.mark.parametrize(("beside", "is_two"), [(4, False), (20, True)])
def test_boards_behind_a_line_are_not_the_line(beside: int, is_two: bool) -> None:
    rng = np.random.default_rng(1)
    marking = np.repeat([0, 2], 40)
    # the camera is off by 3 px at one end of each line and not at the other
    offset = np.tile(np.linspace(0.0, 3.0, 40), 2) + rng.normal(0.0, 0.2, 80)
    offset[10 : 10 + beside] -= 6.0
    on = rng.random(80) > 0.1
    kept, is_double = keep_one_line(on, offset, marking, 2.5, 3)
    assert is_double.tolist() == [is_two, False, False]
    np.testing.assert_array_equal(kept[40:], on[40:])
    assert not kept[10 : 10 + beside].any()
    assert kept[:10].any() != is_two


@pytest.mark.parametrize(("blur_px", "missing"), [((0.0, 0.0), 1), ((4.0, 0.0), 1), ((14.0, 0.0), 0), ((0.0, 14.0), 1)])
def test_paint_that_a_pan_smears_need_not_be_seen(blur_px: tuple[float, float], missing: int) -> None:
    grass = np.random.default_rng(2).normal(90.0, 3.0, (360, 640)).astype(np.uint8)
    along = np.arange(20.0, 340.0, 8.0)
    count = len(along)
    pixels = np.column_stack([np.full(count, 300.0), along])
    places = Places(
        np.zeros(count, np.int_), np.zeros((count, 2)), pixels, np.tile([1.0, 0.0], (count, 1)), np.full(count, 6.0),
        np.full(count, 50.0), np.zeros(count), np.zeros((count, 1)),
    )  # fmt: skip
    measured = measure_markings(grass, places, np.ones(count), 1.0, 1, np.array(blur_px))
    assert measured.missing == missing
