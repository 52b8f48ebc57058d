"""Clicked points: options that suit them are taken where none are named, and every single point is judged."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import circlecal
from circlecal.api.calls import calibrate_annotation
from circlecal.config import Config, load_config, suit_pixels
from circlecal.field import load_field
from circlecal.formats.annotation import parse_annotation
from circlecal.observations import MarkingKey, MarkPoint, Observations
from circlecal.overlay.frame_overlay import verdict_facts
from circlecal.pipeline import run_observations
from circlecal.records.json_text import result_line
from circlecal.records.stored import calibration_of_record
from circlecal.records.writing import result_record
from circlecal.rig.frames import frame_of_calibration, frame_of_record
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points

TEMPLATE = load_field("soccer", {"marking": 1e-6})
CAMERA = aim_camera(np.array([3.0, 66.0, -15.0]), np.array([2.0, -3.0, 0.0]), 2300.0, 0.0, 1920, 1080, 0.03)


def clicks(lines, count=6, circle=8, camera=CAMERA):
    rng = np.random.default_rng(1)
    ring = (circle_points(camera, TEMPLATE, "outer", circle, 1.0, rng),) if circle else ()
    straight = tuple(line_points(camera, TEMPLATE, name, count, 1.0, rng) for name in lines)
    coarse = tuple(replace(line, sigma_px=np.full(len(line.points_px), 1.5)) for line in straight)
    rings = tuple(replace(c, sigma_px=np.full(len(c.points_px), 1.5)) for c in ring)
    return Observations(1920, 1080, rings, coarse)


def moved(seen, line, number, by_px):
    lines = []
    for given in seen.lines:
        points = given.points_px.copy()
        if given.line == line:
            points[number - 1, 1] += by_px
        lines.append(replace(given, points_px=points))
    return replace(seen, lines=tuple(lines))


def test_a_click_that_contradicts_the_rest_is_named():
    seen = clicks(("halfway_line", "side_line_top"))
    good = run_observations(seen, Config(), frame_id="good")
    assert good.attempt.camera.contradicting_points == ()
    found = run_observations(moved(seen, "side_line_top", 3, 17.0), Config(), frame_id="moved")
    (key, number, off), *more = found.attempt.camera.contradicting_points
    assert (str(key), number, more) == ("side_line_top", 3, [])
    assert off == pytest.approx(17.0, abs=6.0)
    assert any("side_line_top: point 3 lies" in fact for fact in verdict_facts(found))


def test_a_wrong_click_on_a_line_of_two_does_not_bend_the_camera():
    """From the circle alone the fit ended beside the right one, with right clicks for outliers."""
    points = {
        "centre_circle": [
            (952.8, 452.9),
            (941.8, 441.8),
            (935.7, 431.0),
            (934.3, 420.5),
            (935.3, 415.5),
            (940.5, 405.8),
            (949.9, 396.8),
        ],
        "penalty_arc_left": [
            (90.9, 285.9),
            (109.2, 294.5),
            (122.1, 307.5),
            (122.4, 318.2),
            (109.3, 333.4),
            (89.1, 345.0),
            (48.4, 360.1),
            (8.2, 370.8),
        ],
    }
    lines = {
        "big_rect_left_main": [(258.3, 214.7), (10.3, 319.7)],
        "big_rect_left_top": [(5.0, 200.9), (259.2, 215.1)],
        "side_line_left": [(29.6, 139.0), (6.4, 145.8)],
        "side_line_top": [(27.7, 139.1), (950.2, 182.9)],
    }

    def calibrated(off_px):
        moved = {**lines, "side_line_top": [lines["side_line_top"][0], (950.2, 182.9 + off_px)]}
        return circlecal.calibrate_points(
            size=(960, 540), circle=points, lines=moved, sigma_px=0.75, convention="paint"
        )

    right = calibrated(0.0)
    assert right.ok and right.position_m == pytest.approx((-0.3, 62.1, -16.2), abs=0.5)
    for off_px in (15.0, 30.0, 45.0):
        found = calibrated(off_px)
        assert found.ok and found.position_m == pytest.approx(right.position_m, abs=0.6)
        assert MarkingKey("side_line_top") in found.attempt.camera.rejected


def test_the_distance_of_a_mark_is_that_from_where_it_is_drawn():
    """The ground at a mark may be higher, so that it counts less along the picture's vertical."""
    seen = clicks(("halfway_line", "side_line_top"), circle=40)
    place = CAMERA.project(np.zeros((1, 2)))[0] + (0.3, 1.5)
    found = run_observations(replace(seen, marks=(MarkPoint("centre_mark", place, 0.3),)), Config(), frame_id="mark")
    camera = found.attempt.camera
    off_px = np.linalg.norm(camera.view.project(np.zeros((1, 2)))[0] - place)
    assert off_px > 0.8
    assert camera.residuals_px[MarkingKey("centre_mark")] == pytest.approx(off_px, abs=0.01)


def test_single_distances_stand_in_the_record_and_come_back():
    found = run_observations(clicks(("halfway_line", "side_line_top")), Config(), frame_id="clicked")
    record = result_record(found, TEMPLATE)
    distances = record.residuals_px.points
    assert {"side_line_top", "halfway_line"} <= set(distances)
    assert len(distances["side_line_top"]) == 6
    rms = np.sqrt(np.mean(np.square(distances["side_line_top"])))
    assert rms == pytest.approx(record.residuals_px.camera["side_line_top"], abs=1e-3)
    kept = found.attempt.camera.point_residuals_px[MarkingKey("side_line_top")]
    np.testing.assert_allclose(kept, distances["side_line_top"], atol=1e-3)
    back = calibration_of_record(record).attempt.camera.point_residuals_px[MarkingKey("side_line_top")]
    np.testing.assert_allclose(back, distances["side_line_top"])


def test_few_clicks_are_answered_with_the_options_for_clicks_where_none_are_named():
    few = clicks(("halfway_line",), count=3, circle=6)
    chosen = run_observations(few, Config(), frame_id="few")
    assert chosen.status == "calibrated"
    preset = load_config("annotations")
    named = run_observations(few, preset, frame_id="few")
    np.testing.assert_allclose(chosen.attempt.camera.theta, named.attempt.camera.theta)
    # whoever sets a limit means it
    strict = load_config(None, ["verdict.max_sigma_px=50"])
    assert run_observations(few, strict, frame_id="few").status == "refused"
    assert run_observations(few, Config(), frame_id="few", convention="paint").status == "refused"
    # what is assumed stands among the checks, and is none of the limits of whoever named the configuration
    assumed = chosen.verdict.check("assumed_place")
    assert assumed.passed and 0.0 <= assumed.value < 3.0
    assert named.verdict.check("assumed_place") is None
    record = result_record(chosen, TEMPLATE)
    assert "assumed_place" in {check.name for check in record.checks}


def test_few_clicks_of_a_camera_that_stands_elsewhere_are_refused():
    """Taken for a main camera it would be 47 to 83 px off, and would tell 17 to 31."""
    elsewhere = aim_camera(np.array([12.0, 110.0, -35.0]), np.array([0.0, 0.0, 0.0]), 6000.0, 0.07, 1920, 1080, 0.03)
    found = run_observations(
        clicks(("halfway_line",), count=3, circle=6, camera=elsewhere), Config(), frame_id="elsewhere"
    )
    assert (found.status, found.attempt.code) == ("refused", "too_uncertain")
    assert not found.verdict.check("assumed_place").passed


def test_a_record_keeps_the_shape_of_pixels_where_they_are_not_square():
    seen = clicks(("halfway_line", "side_line_top"))
    for aspect, told in ((1.0, {"width": 1920, "height": 1080}), (1.2, {"width": 1920, "height": 1080, "aspect": 1.2})):
        found = run_observations(seen, suit_pixels(Config(), aspect), frame_id="frame")
        record = result_record(found, TEMPLATE)
        assert json.loads(result_line(record))["image"] == told
        assert frame_of_record(record, Path("run")).aspect == frame_of_calibration(found).aspect == aspect


def test_an_annotation_is_calibrated_with_the_pixels_of_its_picture():
    told = {"annotation_version": 1, "id": "x", "width": 1920, "height": 1080, "pixel_aspect": 1.2}
    annotation = parse_annotation(Path("x.json"), json.dumps(told).encode())
    assert calibrate_annotation(annotation, Config()).aspect == 1.2
    assert calibrate_annotation(annotation, suit_pixels(Config(), 1.5)).aspect == 1.5
