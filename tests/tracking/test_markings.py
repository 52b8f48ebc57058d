"""What is taken for the paint of a marking."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.tracking.markings import _keep_one_line


@pytest.mark.parametrize(("beside", "is_two"), [(4, False), (20, True)])
def test_boards_behind_a_line_are_not_the_line(beside: int, is_two: bool) -> None:
    rng = np.random.default_rng(1)
    marking = np.repeat([0, 2], 40)
    # the camera is off by 3 px at one end of each line and not at the other
    offset = np.tile(np.linspace(0.0, 3.0, 40), 2) + rng.normal(0.0, 0.2, 80)
    offset[10 : 10 + beside] -= 6.0
    on = rng.random(80) > 0.1
    kept, is_double = _keep_one_line(on, offset, marking, 2.5, 3)
    assert is_double.tolist() == [is_two, False, False]
    np.testing.assert_array_equal(kept[40:], on[40:])
    assert not kept[10 : 10 + beside].any()
    assert kept[:10].any() != is_two
