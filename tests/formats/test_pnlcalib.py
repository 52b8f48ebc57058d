"""PnLCalib's keypoints: where they are, the traps, and our own virtual ones in their place."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.formats.format import json_bytes
from circlecal.formats.meaning import SourcesConfig, observe
from circlecal.formats.pnlcalib import (
    GOAL_TOPS,
    VIRTUAL_CIRCLE_POINTS,
    derive,
    keypoint_table,
    read,
    tangency_points,
    write,
)

FILE = Path("101.json")


def prediction(keypoints, lines=None):
    points = {str(n): dict(zip("xyp", value, strict=False)) for n, value in keypoints.items()}
    keys = ("x_1", "y_1", "p_1", "x_2", "y_2", "p_2")
    held = {str(n): dict(zip(keys, value, strict=True)) for n, value in (lines or {}).items()}
    return json_bytes({"kp": points, "lines": held})


def read_prediction(path, content, size):
    (frame,) = read(path, content, size)
    return frame


def keypoints_record(frame, original=None):
    return json.loads(write([derive(frame, original)]))


def observed(content, soccer, sources=SourcesConfig()):
    return observe(read_prediction(FILE, content, (1920, 1080)), soccer, sources, "pnlcalib", str(FILE))


def test_known_places(soccer):
    table = keypoint_table(soccer)
    known = {
        1: (-52.5, -34), 3: (52.5, -34), 5: (-36, -20.16), 9: (-47, -9.16), 13: (-52.5, -3.66), 22: (47, 9.16),
        26: (36, 20.16), 30: (52.5, 34), 32: (0, -9.15), 33: (36, -7.3125), 35: (0, 9.15), 45: (-41.5, 0),
        47: (-32.35, 0), 50: (-9.15, 0), 51: (0, 0), 54: (6.4700, 6.4700), 58: (-47, -34), 63: (47, -20.16),
        64: (-36, -9.16), 73: (47, 34),
    }  # fmt: skip
    for number, place in known.items():
        assert table[number] == pytest.approx(place, abs=1e-3), number
    assert not GOAL_TOPS & set(table)
    assert set(table) | GOAL_TOPS | set(range(37, 45)) == set(range(1, 74))


def test_keypoint_52_is_at_nine_metres_and_no_point_of_the_circle(soccer):
    found = observed(prediction({50: (0.3, 0.5, 0.9), 52: (0.7, 0.5, 0.9)}), soccer).observations
    places = {k.name: k.field_m.tolist() for k in found.keypoints}
    assert places == {"kp_50": pytest.approx([-9.15, 0.0]), "kp_52": pytest.approx([9.0, 0.0])}
    assert found.circles[0].points_px.tolist() == [[576.0, 540.0]]


def test_tangency_points_lie_on_the_circle_but_nowhere_on_it(soccer):
    found = observed(prediction({38: (0.3, 0.5, 0.9), 41: (0.1, 0.5, 0.9)}), soccer).observations
    assert not found.keypoints
    assert sorted(c.circle for c in found.circles) == ["centre_circle", "penalty_arc_left"]


def test_tangency_points_belong_to_a_pitch_of_68_metres():
    touch = tangency_points(9.15)
    assert touch[38] == pytest.approx([-8.8124, -2.4624], abs=1e-4)
    for number, point in touch.items():
        end = np.array([0.0, -34.0 if number < 40 else 34.0])
        assert abs(point @ (point - end)) < 1e-9


def test_goal_tops_low_confidence_and_unknown_numbers(soccer):
    content = prediction({12: (0.1, 0.1, 0.9), 32: (0.5, 0.4, 0.05), 35: (0.5, 0.6, 0.5), 99: (0.5, 0.5, 0.5)})
    frame = observed(content, soccer)
    assert [k.name for k in frame.observations.keypoints] == ["kp_35"]
    assert len(frame.warnings) == 1
    assert "kp.99" in frame.warnings[0]


def test_what_was_computed_from_the_lines_is_left_out(soccer):
    lines = {13: (0.5, 0.1, 0.8, 0.5, 0.9, 0.7), 17: (0.1, 0.2, 0.2, 0.9, 0.2, 0.9)}
    content = prediction({2: (0.5, 0.2, 1.0), 29: (0.5, 0.8, 0.6), 60: (0.4, 0.2, 1.0)}, lines)
    found = observed(content, soccer).observations
    assert [k.name for k in found.keypoints] == ["kp_29"]
    assert [line.line for line in found.lines] == ["halfway_line"]
    alone = observed(prediction({2: (0.5, 0.2, 1.0)}), soccer).observations
    assert [k.name for k in alone.keypoints] == ["kp_2"]


def test_sigma_grows_with_the_picture_and_with_doubt(soccer):
    sources = SourcesConfig(sigma_px={"pnlcalib": 4.0})
    sure, unsure = observed(
        prediction({29: (0.5, 0.5, 1.0), 30: (0.5, 0.5, 0.25)}), soccer, sources
    ).observations.keypoints
    assert (sure.sigma_px, unsure.sigma_px) == pytest.approx((4.0, 8.0))
    small = replace(read_prediction(FILE, prediction({29: (0.5, 0.5, 1.0)}), (960, 540)))
    assert observe(small, soccer, sources, "pnlcalib", "f").observations.keypoints[0].sigma_px == pytest.approx(2.0)


def test_corners_follow_the_size_of_the_pitch():
    narrow = load_field("soccer", {"length": 100, "width": 64, "marking": 1e-9})
    assert keypoint_table(narrow)[30] == pytest.approx([50.0, 32.0])


def test_with_paint_keypoints_are_meets_of_centrelines():
    table = keypoint_table(load_field("soccer"))
    assert table[30] == pytest.approx([52.44, 33.94])
    assert table[26] == pytest.approx([36.06, 20.10])
    assert table[32] == pytest.approx([0.0, -9.09])
    assert table[52] == pytest.approx([9.00 * 9.09 / 9.15, 0.0])
    assert np.linalg.norm(table[33] - [41.5, 0.0]) == pytest.approx(9.09)


def test_other_sports_have_no_such_keypoints():
    content = prediction({30: (0.5, 0.5, 0.9)})
    with pytest.raises(InputError, match="soccer pitch"):
        observed(content, load_field("ice-hockey"))


def test_virtual_keypoints_are_replaced_and_the_others_untouched(calibrated, frame_camera):
    content = prediction(
        {
            2: (0.123456789, 0.1, 0.7),
            32: (0.4, 0.4, 0.6),
            50: (0.9, 0.9, 0.4),
            52: (0.1, 0.1, 0.4),
            60: (0.4, 0.2, 1.0),
        },
        {13: (0.5, 0.1, 0.8, 0.5, 0.9, 0.7)},
    )
    original = read_prediction(FILE, content, (960, 540)).original
    record = keypoints_record(calibrated, original)
    assert record["lines"] == original["lines"]
    for number in ("2", "32", "60"):
        assert record["kp"][number] == original["kp"][number]
    assert {int(n) for n in record["kp"]} == {2, 32, 60, *VIRTUAL_CIRCLE_POINTS}
    assert list(record["kp"]) == sorted(record["kp"], key=int)
    left, wrong = (frame_camera.project([[x, 0.0]])[0] / [960, 540] for x in (-9.15, 9.00))
    assert (record["kp"]["50"]["x"], record["kp"]["50"]["y"]) == pytest.approx(tuple(left))
    assert (record["kp"]["52"]["x"], record["kp"]["52"]["y"]) == pytest.approx(tuple(wrong))


def test_without_an_original_the_circle_alone(calibrated):
    record = keypoints_record(calibrated)
    assert {int(n) for n in record["kp"]} == {32, 35, *VIRTUAL_CIRCLE_POINTS}
    assert record["lines"] == {}


def test_virtual_keypoints_outside_the_picture_are_removed(calibrated, frame_camera):
    aside = replace(frame_camera, principal_point_px=frame_camera.principal_point_px + np.array([600.0, 0.0]))
    frame = replace(calibrated, view=FieldView(aside))
    original = {"kp": {"39": {"x": 0.5, "y": 0.5, "p": 0.5}, "52": {"x": 0.5, "y": 0.5, "p": 0.5}}, "lines": {}}
    record = keypoints_record(frame, original)
    assert "52" not in record["kp"]
    assert "50" in record["kp"]


def test_on_the_middle_of_the_paint(calibrated, frame_camera):
    paint = replace(calibrated, template=load_field("soccer"))
    record = keypoints_record(paint)
    left = frame_camera.project([[-9.09, 0.0]])[0] / [960, 540]
    assert record["kp"]["50"]["x"] == pytest.approx(left[0])


def test_predictions_come_back_exactly(close):
    content = prediction({51: (0.503, 0.412, 0.71), 1: (0.1, 0.2, 0.3)}, {13: (0.51, 0.02, 0.84, 0.49, 0.98, 0.77)})
    frame = read_prediction(FILE, content, (1919, 1077))
    again = read_prediction(FILE, write([frame]), (1919, 1077))
    close(frame, again)
    assert [s.confidence for s in again.shapes] == [s.confidence for s in frame.shapes]
