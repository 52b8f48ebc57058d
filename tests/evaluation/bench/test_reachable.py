"""The bound of a rendered frame, from its truth."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import Config, load_config
from circlecal.evaluation.bench.detect import predict_error_px, profile_config
from circlecal.evaluation.bench.reachable import bound_px, visible_observations
from circlecal.field import load_field
from circlecal.observations import Observations
from circlecal.pipeline import run_observations
from circlecal.synthetic.paint import CIRCLE_CLASS, HALFWAY_CLASS
from circlecal.synthetic.sampling import SCENE_PROFILES, render_frame

SOCCER = load_field("soccer")


@pytest.fixture(scope="module")
def truth():
    return render_frame("hidden_mark", np.random.default_rng(5), 1280, 720).truth


def test_only_uncovered_paint_inside_the_picture_is_observed(truth):
    seen = visible_observations(truth, SOCCER)
    circle = seen.circle("centre_circle", "center")
    column, row = np.rint(circle.points_px).astype(int).T
    assert (truth.classes[row, column] == CIRCLE_CLASS).all()
    column, row = np.rint(seen.line("halfway_line").points_px).astype(int).T
    assert (truth.classes[row, column] == HALFWAY_CLASS).all()
    assert seen.marks == ()
    surface = truth.surface
    radius = SOCCER.radius(SOCCER.circle_by_name["centre_circle"], "center")
    angle = np.linspace(0, 2 * np.pi, 20000)
    ring = truth.camera.project(surface.lift(radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)))
    off = np.linalg.norm(circle.points_px[:, None] - ring[None], axis=-1).min(axis=1)
    assert off.max() < 0.2


def test_exact_observations_lead_to_the_truth(truth):
    seen = visible_observations(truth, SOCCER)
    assert isinstance(seen, Observations)
    found = run_observations(seen, Config(), frame_id="exact", convention="paint")
    assert found.attempt.camera is not None
    np.testing.assert_allclose(found.attempt.camera.camera.position_m, truth.camera.position_m, atol=1.5)


def test_less_in_view_is_less_to_expect(truth):
    whole = predict_error_px(truth, Config())
    assert 0 < whole < 20
    visible = replace(truth, center_mark="visible")
    assert predict_error_px(visible, Config()) <= whole
    columns = np.arange(truth.classes.shape[1])
    half = replace(truth, classes=np.where(columns < truth.imaged_center_px[0] + 40, truth.classes, 0).astype(np.uint8))
    assert predict_error_px(half, Config()) > whole
    known = load_config(None, ["camera.position_m=[0,60,-15]", "camera.position_sd_m=[0.1,0.1,0.1]"])
    assert predict_error_px(truth, known) < whole


def test_a_circle_alone_leaves_the_rotation_free(truth):
    alone = np.where(truth.classes == CIRCLE_CLASS, truth.classes, 0).astype(np.uint8)
    assert predict_error_px(replace(truth, classes=alone), Config()) == float("inf")
    assert predict_error_px(replace(truth, classes=np.zeros_like(alone)), Config()) == float("inf")


@pytest.fixture(scope="module")
def rink():
    """A rink of which a goal line's paint lies beside the template's."""
    return render_frame("rink", np.random.default_rng([8282, 69, SCENE_PROFILES.index("rink")]), 1280, 720).truth


def test_displaced_paint_is_seen_where_it_lies(rink):
    assert rink.painted != rink.template
    seen = visible_observations(rink, rink.template)
    beside = visible_observations(replace(rink, painted=rink.template), rink.template)
    assert sum(len(c.points_px) for c in (*seen.circles, *seen.lines)) > 1.1 * sum(
        len(c.points_px) for c in (*beside.circles, *beside.lines)
    )


def test_painters_errors_limit_what_can_be_expected(rink):
    config = profile_config("rink", rink)
    known = replace(
        rink, painted=rink.painted.model_copy(update={"placement_sd_m": 0.0, "radius_sd_m": 0.0, "wander_sd_m": 0.0})
    )
    grid = np.array([rink.template.circle_by_name[rink.template.default_circle].center])
    unknown_px, known_px = (bound_px(truth, grid, truth.template, config.camera) for truth in (rink, known))
    assert 2 * known_px < unknown_px < 3.0
