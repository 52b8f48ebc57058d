"""Observations: finding them by name, and their round trip through JSON."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkPoint, Observations

pixels = st.integers(0, 20).flatmap(lambda n: arrays(np.float64, (n, 2), elements=st.floats(-5000, 5000)))


def _with_sigma(points):
    return points, np.full(len(points), 0.25)


@given(pixels, pixels, st.sampled_from(["outer", "inner", "center"]), st.sampled_from(["halfway_line", None]))
def test_round_trip_through_json(circle_points, line_points, edge, line):
    seen = Observations(
        1920,
        1080,
        circles=(CirclePoints("centre_circle", edge, *_with_sigma(circle_points)),),
        lines=(LinePoints(line, *_with_sigma(line_points)),),
        marks=(MarkPoint("centre_mark", np.array([960.12345, 540.0]), 0.5),),
        keypoints=(Keypoint("corner", np.array([-52.5, 34.0]), np.array([1.0, 2.0]), 1.5),),
    )
    back = Observations.from_json(json.loads(json.dumps(seen.to_json(), allow_nan=False)), 1920, 1080)
    assert (back.width, back.height) == (1920, 1080)
    np.testing.assert_allclose(back.circles[0].points_px, circle_points, atol=1e-4)
    np.testing.assert_allclose(back.circles[0].sigma_px, np.full(len(circle_points), 0.25))
    assert back.circles[0].points_px.shape == circle_points.shape
    assert (back.circles[0].circle, back.circles[0].edge) == ("centre_circle", edge)
    np.testing.assert_allclose(back.lines[0].points_px, line_points, atol=1e-4)
    assert back.lines[0].line == line
    np.testing.assert_allclose(back.marks[0].point_px, (960.12345, 540.0), atol=1e-4)
    assert back.marks[0].sigma_px == 0.5
    np.testing.assert_allclose(back.keypoints[0].field_m, (-52.5, 34.0))
    assert back.keypoints[0].name == "corner"
    assert back.to_json() == seen.to_json()


def test_nothing_seen_is_empty_and_reads_back():
    nothing = Observations(640, 360)
    assert nothing.to_json() == {"circles": [], "lines": [], "marks": [], "keypoints": []}
    assert Observations.from_json({}, 640, 360) == nothing


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
