"""Observations: finding them by name."""

import numpy as np
import pytest

from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkingKey, MarkPoint, Observations


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


@pytest.mark.parametrize(
    ("key", "text"),
    [
        (MarkingKey("centre_circle", "outer"), "centre_circle outer"),
        (MarkingKey("Circle central", "center"), "Circle central center"),
        (MarkingKey("halfway_line"), "halfway_line"),
        (MarkingKey("center"), "center"),
        (MarkingKey("corner 1"), "corner 1"),
    ],
)
def test_keys_of_markings_are_texts_and_back(key, text):
    assert str(key) == text
    assert MarkingKey.parse(text) == key


def test_what_is_seen_has_its_key():
    points, sigma = np.zeros((2, 2)), np.ones(2)
    assert str(CirclePoints("centre_circle", "inner", points, sigma).key) == "centre_circle inner"
    assert LinePoints(None, points, sigma).key is None
    assert LinePoints("halfway_line", points, sigma).key == MarkingKey("halfway_line")
    assert MarkPoint("centre_mark", points[0], 1.0).key == MarkingKey("centre_mark")
    assert Keypoint("corner 1", points[0], points[0], 1.0).key == MarkingKey("corner 1")


def test_without_some_markings_all_others_stay_as_they_are():
    points, sigma = np.zeros((2, 2)), np.ones(2)
    outer, inner = (CirclePoints("center", edge, points, sigma) for edge in ("outer", "inner"))
    line, nameless = (LinePoints(name, points, sigma) for name in ("halfway_line", None))
    mark, point = MarkPoint("center_mark", points[0], 1.0), Keypoint("corner", points[0], points[0], 1.0)
    seen = Observations(64, 64, (outer, inner), (line, nameless), (mark,), (point,))
    assert seen.without({inner.key, line.key}) == Observations(64, 64, (outer,), (nameless,), (mark,), (point,))
    assert seen.without({mark.key, point.key}) == Observations(64, 64, (outer, inner), (line, nameless))
    assert seen.without(()) == seen
