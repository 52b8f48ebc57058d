"""Straight markings alone: the same ones are not tried twice."""

from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.pipeline import field_lines
from circlecal.pipeline.setting import Looks
from circlecal.results import Attempt, MarkingMask, Segment


def see_lines(shift=0.0):
    """Four straight markings, seen in one more look at the picture."""
    ends = np.array([[[0.0, 0.0], [9.0, 1.0]], [[0, 5], [9, 6]], [[1, 0], [1, 9]], [[7, 0], [8, 9]]]) + shift
    lines = tuple(Segment(start, end) for start, end in ends)
    return MarkingMask(np.zeros((10, 10), np.uint8), "detector", lines=lines, field_region=np.ones((5, 5), bool))


@pytest.fixture
def tries(monkeypatch):
    """What was tried, each of which leads to an attempt of its own."""
    tried = []

    def try_namings(setting, scene, mask):
        tried.append(mask)
        yield Attempt(mask=mask)

    monkeypatch.setattr(field_lines, "_try_namings", try_namings)
    return tried


def test_lines_that_were_tried_are_not_tried_again(tries):
    setting, scene = SimpleNamespace(), SimpleNamespace(looks=Looks())
    first = field_lines.calibrate_by_lines(setting, scene, see_lines())
    assert field_lines.calibrate_by_lines(setting, scene, see_lines()) is first
    again = see_lines()
    (taken,) = field_lines.take_field_lines(setting, scene, Attempt(mask=again))
    assert taken.mask is again
    assert len(tries) == 1


def test_other_lines_and_other_fields_are_tried(tries):
    setting, scene = SimpleNamespace(), SimpleNamespace(looks=Looks())
    for tried in ((setting, see_lines()), (setting, see_lines(0.5)), (SimpleNamespace(), see_lines(0.5))):
        field_lines.calibrate_by_lines(tried[0], scene, tried[1])
    assert len(tries) == 3
