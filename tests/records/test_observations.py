"""What was seen, into a record and back."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic_core import to_json

from circlecal.observations import CirclePoints, Keypoint, LineEnd, LinePoints, MarkPoint, Observations
from circlecal.records.parts import ImageRecord, ObservationsRecord
from circlecal.records.writing import write_observations

pixels = st.integers(0, 20).flatmap(lambda n: arrays(np.float64, (n, 2), elements=st.floats(-5000, 5000)))


def _with_sigma(points):
    return points, np.full(len(points), 0.25)


def written(seen):
    return to_json(write_observations(seen), fallback=np.ndarray.tolist)


def read_back(seen):
    image = ImageRecord(width=seen.width, height=seen.height)
    return ObservationsRecord.model_validate_json(written(seen)).observations(image)


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
    back = read_back(seen)
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
    assert to_json(write_observations(back), fallback=np.ndarray.tolist) == written(seen)


def test_a_keypoint_moves_with_the_field_as_before():
    shift = np.array([[0.0, 0.0], [-0.5, 0.0], [0.0, 0.5]])
    points = [Keypoint("corner", np.array([-52.5, 34.0]), np.array([1.0, 2.0]), 1.5, s) for s in (shift, None)]
    moved, fixed = read_back(Observations(640, 360, keypoints=tuple(points))).keypoints
    np.testing.assert_array_equal(moved.shift, shift)
    assert fixed.shift is None


def test_a_keypoint_of_an_older_record_does_not_move():
    old = b'{"keypoints": [{"name": "corner", "field_m": [-52.5, 34.0], "point_px": [1.0, 2.0], "sigma_px": 1.5}]}'
    record = ObservationsRecord.model_validate_json(old)
    assert record.observations(ImageRecord(width=640, height=360)).keypoints[0].shift is None


def test_nothing_seen_is_empty_and_reads_back():
    nothing = Observations(640, 360)
    assert write_observations(nothing) == {"circles": [], "lines": [], "marks": [], "keypoints": []}
    assert ObservationsRecord().observations(ImageRecord(width=640, height=360)) == nothing
    assert read_back(nothing) == nothing


def test_ends_of_lines():
    end = LineEnd(np.array([3.00004, 5.0]), crossed=False)
    line = LinePoints(None, *_with_sigma(np.zeros((2, 2))), ends=(end,))
    (found,) = read_back(Observations(640, 360, lines=(line,))).lines[0].ends
    assert not found.crossed
    np.testing.assert_allclose(found.point_px, end.point_px, atol=1e-4)
