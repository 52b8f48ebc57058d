"""What painters' errors leave open of a camera."""

import importlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.evaluation.bench.scenarios import select_rows
from circlecal.pipeline import field_of, run_observations
from circlecal.pipeline.painters import cover_painters
from circlecal.pipeline.setting import Setting, frame_generator
from circlecal.results import EdgePoints, MarkingMask

RUN = importlib.import_module("circlecal.pipeline.run")  # the package has a function of that name


@pytest.fixture
def without(monkeypatch):
    """Two face-off circles of a rink, before painters' errors are counted."""
    (scenario,) = select_rows(["17"])
    seen = scenario.draw(np.random.default_rng(3)).observations
    config = load_config("ice-hockey", ["field.circle=faceoff_left_top"])
    monkeypatch.setattr(RUN, "cover_painters", lambda setting, attempt: attempt)
    setting = Setting(config, *field_of(config), seen.width, seen.height, frame_generator(0))
    return seen, config, setting, run_observations(seen, config, frame_id="rink").attempt


def test_they_widen_what_is_told_and_move_the_camera_within_it(without, monkeypatch):
    seen, config, setting, before = without
    monkeypatch.setattr(RUN, "cover_painters", cover_painters)
    after = run_observations(seen, config, frame_id="rink").attempt
    corners = np.asarray(setting.circle.center) + setting.circle.radius_m * np.array([[1, 1], [-1, 1], [-1, -1]])
    moved_px = np.linalg.norm(after.camera.view.project(corners) - before.camera.view.project(corners), axis=1)
    assert (moved_px > 0.0).all()
    assert moved_px.max() < 3.0 * after.camera.max_sigma_px
    np.testing.assert_array_equal(after.camera.theta, before.camera.beside_errors.theta)
    assert after.camera.max_sigma_px > 1.5 * before.camera.max_sigma_px
    assert after.camera.max_sigma_m > 1.3 * before.camera.max_sigma_m
    assert np.trace(after.camera.region.covariance) > 1.3**2 * np.trace(before.camera.region.covariance)
    assert after.camera.beside_errors is None
    assert after.verdict.check("sigma_px").value == after.camera.max_sigma_px
    assert after.verdict.check("sigma_m").value == after.camera.max_sigma_m


def test_a_camera_that_they_leave_too_uncertain_is_refused(without):
    *_, setting, before = without
    assert before.is_calibrated
    open_to = replace(before.camera.beside_errors, covariance=before.camera.beside_errors.covariance * 1e6)
    after = cover_painters(setting, replace(before, camera=replace(before.camera, beside_errors=open_to)))
    assert (after.verdict.status, after.verdict.code) == ("refused", "too_uncertain")
    assert len(after.verdict.checks) == len(before.verdict.checks)


def test_other_markings_are_looked_for_where_painters_errors_leave_them(without, monkeypatch):
    *_, setting, before = without
    attempts = importlib.import_module("circlecal.pipeline.attempts")
    looked = []
    monkeypatch.setattr(attempts, "lighten_markings", lambda picture, *_: picture)
    for name in ("measure_evidence", "measure_surroundings"):
        monkeypatch.setattr(attempts, name, lambda *_: None)
    monkeypatch.setattr(attempts, "weigh_evidence", lambda verdict, *_: verdict)
    monkeypatch.setattr(attempts, "confirm", lambda verdict, *_: verdict)
    monkeypatch.setattr(attempts, "look_for_markings", lambda picture, fit, *_: looked.append(fit))
    nothing = np.zeros((4, 4), np.uint8)
    edges = EdgePoints(*(np.zeros(0) for _ in range(4)), noise=1.0, blur_px=1.0, thresholds=(1.0, 2.0))
    attempt = replace(before, mask=MarkingMask(nothing, "file"), edges=edges)
    attempts.look_again(setting, SimpleNamespace(marked=nothing, relief=None, gray=nothing), attempt)
    (fit,) = looked
    np.testing.assert_array_equal(fit.covariance, before.camera.beside_errors.covariance)
