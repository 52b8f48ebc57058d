"""Observations: finding them by name."""

import numpy as np
import pytest

from circlecal.observations import CirclePoints, LinePoints, Observations


def _with_sigma(points):
    return points, np.full(len(points), 0.25)


def test_observations_are_found_by_name():
    points = np.zeros((3, 2))
    outer = CirclePoints("centre_circle", "outer", *_with_sigma(points))
    halfway = LinePoints("halfway_line", *_with_sigma(points))
    seen = Observations(640, 360, circles=(outer,), lines=(LinePoints(None, *_with_sigma(points)), halfway))
    assert seen.circle("centre_circle", "outer") is outer
    assert seen.circle("centre_circle", "inner") is None
    assert seen.circle("other", "outer") is None
    assert seen.line("halfway_line") is halfway
    assert seen.line("side_line_top") is None


def test_observations_cannot_be_changed():
    with pytest.raises(AttributeError):
        Observations(640, 360).width = 3
