"""Pictures without the circle: recognised by their straight markings and arcs, or refused."""

from importlib import import_module

import numpy as np
import pytest

from circlecal.config import Config, load_config
from circlecal.evaluation.bench.detect import compare
from circlecal.field import load_field
from circlecal.geometry.surface import FLAT
from circlecal.observations import LinePoints, Observations
from circlecal.pipeline import field_lines, run
from circlecal.results import Agreement, Attempt, Verdict
from circlecal.stages.verdict_on_picture import confirm_field_lines
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.renderer import render
from circlecal.synthetic.scene import RenderConfig, Scene

SOCCER = load_field("soccer")
SIZE = (1280, 720)
AREA = aim_camera(np.array([-2.0, 62.0, -16.0]), np.array([-42.0, -1.0, 0.0]), 2500.0, 0.01, *SIZE, kappa=0.02)
EMPTY = aim_camera(np.array([-2.0, 62.0, -16.0]), np.array([-22.0, 8.0, 0.0]), 4200.0, 0.0, *SIZE)


def rendered(camera):
    return render(Scene(camera, SOCCER, FLAT, RenderConfig(), kind="penalty_area"), np.random.default_rng(5))


@pytest.fixture(scope="module")
def picture():
    return rendered(AREA)


def test_a_penalty_area_is_calibrated_without_the_circle(picture):
    assert picture.truth.visible_circle_deg == 0.0
    found = run(picture.image, Config(), frame_id="area")
    assert found.status == "calibrated", found.verdict
    error, predicted, _ = compare(picture.truth, found.attempt.camera)
    assert error < 3.0
    # how far away the middle of the field is only its length tells, which is not in view
    assert found.attempt.camera.mean_sigma_px < 5.0 < predicted
    assert found.verdict.check("named_markings").value >= 5
    assert np.linalg.norm(found.attempt.camera.camera.position_m - AREA.position_m) < 2.0


def test_it_can_be_switched_off(picture):
    found = run(picture.image, load_config(None, ["cues.field_lines=false"]), frame_id="area")
    assert found.status == "refused"
    assert found.verdict.stage == "mask"


def test_bare_grass_with_hardly_a_line_stays_refused():
    assert run(rendered(EMPTY).image, Config(), frame_id="empty").status == "refused"


@pytest.fixture(scope="module")
def camera(picture):
    return run(picture.image, Config(), frame_id="area").attempt.camera


@pytest.mark.parametrize(
    ("used", "arcs", "expected", "share", "code"),
    [
        (4, (), 0.4, 1.0, "few_markings"),
        (2, ("penalty_arc_right",), 0.4, 1.0, "few_markings"),
        (3, ("penalty_arc_right",), 0.4, 1.0, None),
        (5, (), 0.4, 0.3, "markings_missing"),
        (5, (), 0.4, 0.8, None),
        (8, (), 0.4, 0.8, None),
        (5, (), 0.116, 0.11, "markings_missing"),
        (5, (), 0.03, 0.11, None),
    ],
)
def test_few_or_missing_markings_refuse(camera, used, arcs, expected, share, code):
    """Of markings that are expected over hardly any of the picture it says nothing that they are not found."""
    agreement = Agreement(("penalty_arc_left",), np.array([expected * camera.camera.width]), np.array([share]))
    names = frozenset((*(f"line {k}" for k in range(used)), *arcs))
    accepted = Verdict("calibrated", None, None, None)
    assert confirm_field_lines(accepted, camera, Observations(*SIZE), names, agreement, SOCCER).code == code


@pytest.mark.parametrize(("beyond_m", "code"), [(0.0, None), (1.0, None), (6.0, "line_beyond_field")])
def test_a_line_that_runs_on_beyond_its_end_is_another_one(camera, beyond_m, code):
    """What was taken for the front of a penalty area was only 32 m of it, on a rendered pitch."""
    y = np.arange(-20.16, 20.16 + beyond_m, 0.1)
    points = camera.view.project(np.stack([np.full_like(y, -36.0), y], axis=-1))
    seen = Observations(*SIZE, lines=(LinePoints("big_rect_left_main", points, np.ones(len(points))),))
    agreement = Agreement(("penalty_arc_left",), np.array([500.0]), np.array([1.0]))
    names = frozenset(f"line {k}" for k in range(6))
    accepted = Verdict("calibrated", None, None, None)
    assert confirm_field_lines(accepted, camera, seen, names, agreement, SOCCER).code == code


def test_lines_of_a_first_look_hold_where_no_circle_calibrates(picture, monkeypatch):
    """They leave some doubt, so the circle is looked for as well."""
    found = run(picture.image, Config(), frame_id="area")
    monkeypatch.setattr(field_lines, "SURE_PX", 0.0)
    tried = []

    def look_in_vain(setting, scene):
        tried.append(scene)
        return Attempt(verdict=Verdict("refused", "no_circle_found", None, "mask"))

    monkeypatch.setattr(import_module("circlecal.pipeline.run"), "_calibrate_circle", look_in_vain)
    kept = run(picture.image, Config(), frame_id="area")
    assert len(tried) == 1
    assert kept.status == "calibrated"
    assert kept.attempt.camera.max_sigma_px == pytest.approx(found.attempt.camera.max_sigma_px)
