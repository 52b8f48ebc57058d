"""Clicked points: options that suit them are taken where none are named, and every single point is judged."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import Config, load_config
from circlecal.field import load_field
from circlecal.observations import MarkingKey, Observations
from circlecal.overlay.frame_overlay import verdict_facts
from circlecal.pipeline import run_observations
from circlecal.records.stored import calibration_of_record
from circlecal.records.writing import result_record
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points

TEMPLATE = load_field("soccer", {"marking": 1e-6})
CAMERA = aim_camera(np.array([3.0, 66.0, -15.0]), np.array([2.0, -3.0, 0.0]), 2300.0, 0.0, 1920, 1080, 0.03)


def clicks(lines, count=6, circle=8):
    rng = np.random.default_rng(1)
    ring = (circle_points(CAMERA, TEMPLATE, "outer", circle, 1.0, rng),) if circle else ()
    straight = tuple(line_points(CAMERA, TEMPLATE, name, count, 1.0, rng) for name in lines)
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
