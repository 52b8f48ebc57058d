"""What painters' errors leave open of a camera."""

import importlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.evaluation.bench.scenarios import select_rows
from circlecal.pipeline import clicks, field_of, run_observations
from circlecal.pipeline.painters import cover_painters
from circlecal.pipeline.setting import Setting, frame_generator
from circlecal.results import EdgePoints, MarkingMask


@pytest.fixture
def without(monkeypatch):
    """Two face-off circles of a rink, before painters' errors are counted."""
    (scenario,) = select_rows(["17"])
    seen = scenario.draw(np.random.default_rng(3)).observations
    config = load_config("ice-hockey", ["field.circle=faceoff_left_top"])
    monkeypatch.setattr(clicks, "cover_painters", lambda setting, attempt: attempt)
    setting = Setting(config, *field_of(config), seen.width, seen.height, frame_generator(0))
    return seen, config, setting, run_observations(seen, config, frame_id="rink").attempt


def test_they_are_weighed_in_what_is_told_and_in_the_answer(without, monkeypatch):
    seen, config, _, before = without
    monkeypatch.setattr(clicks, "cover_painters", cover_painters)
    after = run_observations(seen, config, frame_id="rink").attempt
    np.testing.assert_array_equal(after.camera.theta, before.camera.painters.theta)
    assert not np.array_equal(after.camera.H_image_field, before.camera.H_image_field)
    np.testing.assert_allclose(after.camera.H_image_field, after.camera.camera.homography)
    there_and_back = after.camera.H_field_image @ after.camera.H_image_field
    np.testing.assert_allclose(there_and_back / there_and_back[2, 2], np.eye(3), atol=1e-8)
    assert after.camera.residuals_px == before.camera.painters.residuals_px
    assert after.camera.max_sigma_px > 1.1 * before.camera.max_sigma_px
    assert after.camera.max_sigma_m > 1.1 * before.camera.max_sigma_m
    assert np.trace(after.camera.region.covariance) > 1.1**2 * np.trace(before.camera.region.covariance)
    assert after.camera.painters is None
    assert after.verdict.check("sigma_px").value == after.camera.max_sigma_px
    assert after.verdict.check("sigma_m").value == after.camera.max_sigma_m


def test_a_camera_that_they_leave_too_uncertain_is_refused(without):
    *_, setting, before = without
    assert before.is_calibrated
    painters = replace(before.camera.painters, covariance=before.camera.painters.covariance * 1e6)
    camera = replace(before.camera, painters=painters)
    after = cover_painters(setting, replace(before, camera=camera))
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
    single = replace(setting, template=setting.template.model_copy(update={"circles": (setting.circle,)}))
    for given in (single, setting):
        scene = SimpleNamespace(marked=nothing, relief=None, covered=None, unseen=None, gray=nothing, image=nothing)
        attempts.look_again(given, scene, attempt)
    fit, plain = looked
    assert plain is before.camera
    np.testing.assert_allclose(fit.covariance, before.camera.covariance + before.camera.painters.covariance)
