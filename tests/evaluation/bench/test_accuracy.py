"""The tables of accuracy: rows, bounds and closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from circlecal.cli.app import app
from circlecal.evaluation.bench import accuracy
from circlecal.evaluation.bench.accuracy import as_records, closed_forms, mahalanobis, run_rows
from circlecal.evaluation.bench.bounds import bound_covariance, bound_errors
from circlecal.evaluation.bench.reprojection import reprojection_grid
from circlecal.evaluation.bench.scenarios import KNOWN, row_names, scenarios, select_rows, soccer
from circlecal.geometry.camera_parameters import INDEX
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.markings import circle_points, line_points

TEMPLATE, CIRCLE = soccer()
EXACTLY = np.diag([1e-6, 1e-6])
"""Covariance of a point known to a thousandth of a pixel."""
CAMERA = sample_camera("main", np.random.default_rng(4))
GRID = reprojection_grid(CAMERA.homography, 1920, 1080, TEMPLATE.length_m / 2, TEMPLATE.width_m / 2)


def seen(count, sigma, edges=("outer", "inner")):
    rng = np.random.default_rng(1)
    return Observations(
        1920,
        1080,
        tuple(circle_points(CAMERA, TEMPLATE, edge, count, sigma, rng) for edge in edges),
        (line_points(CAMERA, TEMPLATE, "halfway_line", count, sigma, rng),),
    )


def bound_px(count, sigma=0.5, edges=("outer", "inner"), config=KNOWN):
    covariance = bound_covariance(CAMERA, 0.0, seen(count, sigma, edges), TEMPLATE, CIRCLE, config)
    return float(bound_errors(CAMERA, covariance, GRID, 400, np.random.default_rng(2)).mean())


@pytest.fixture(scope="module")
def command():
    """What ``circlecal bench accuracy`` finds, for which draws, and prints."""
    found, started = [], []

    def run(names, draws, seed, advance):
        def count(row):
            started.append(row)
            advance(row)

        found.extend(run_rows(names, draws, seed, count))
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(accuracy, "run_rows", run)
        ended = CliRunner().invoke(app, ["bench", "accuracy", "--rows", "1,6,9a", "--draws", "3"])
    assert ended.exit_code == 0, ended.output
    return *found, started, ended.stdout


@pytest.fixture(scope="module")
def table(command):
    return command[:3]


def test_the_command_prints_every_row(command):
    rows, closed, _, told = command
    for row in rows:
        assert f"{row.median_px:.2f} ({row.p90_px:.2f})" in told
    assert all(f"{value:.3g}" in told for _, value in closed)


def test_rows_are_finite_and_complete(table):
    rows, _, started = table
    assert [row.row for row in rows] == ["6", "9a"]
    assert started == ["6"] * 3 + ["9a"] * 3
    for row in rows:
        assert row.draws == 3
        assert row.failed == 0.0
        assert 0.0 <= row.wrong <= 1.0
        numbers = (row.median_px, row.p90_px, row.bound_median_px, row.bound_p90_px, row.efficiency, row.ms)
        assert np.isfinite(numbers).all()
        assert min(numbers) > 0
        assert row.median_px <= row.p90_px
        assert set(row.coverage) >= {"homography", "imaged centre", "position"}
        assert row.by_offset
    assert json.loads(json.dumps(as_records(rows)))[0]["row"] == "6"


def test_same_seed_same_table(table):
    rows, _, _ = table
    again, closed = run_rows(["9a"], 3, seed=0)
    assert closed == []
    assert again[0].median_px == rows[1].median_px
    assert again[0].bound_median_px == rows[1].bound_median_px


def test_closed_forms_are_exact_without_noise(table):
    _, closed, _ = table
    exact = [value for name, value in closed if name.startswith("1:")]
    assert len(exact) == 3
    assert max(exact) < 1e-8
    paper = [value for name, value in closed if name.startswith("2:")]
    assert paper
    assert all(0.2 < value < 15.0 for value in paper)
    assert closed_forms(3, 0) == closed


def test_names_select_rows():
    assert [s.row for s in select_rows(["8"])] == ["8a", "8b", "8c"]
    assert [s.row for s in select_rows(["8b", "17"])] == ["8b", "17"]
    assert select_rows(["moon"]) == []
    assert len(select_rows([])) == len(scenarios())
    rows = [s.row for s in scenarios()]
    assert len(set(rows)) == len(rows)
    assert {"1", "2", "8", *rows} <= set(row_names())


@pytest.mark.parametrize("scenario", scenarios(), ids=lambda s: s.row)
def test_a_draw_is_fixed_by_its_seed(scenario):
    one, other = (scenario.draw(np.random.default_rng([3, 1])) for _ in range(2))
    np.testing.assert_array_equal(one.camera.position_m, other.camera.position_m)
    for first, second in zip(one.observations.circles, other.observations.circles, strict=True):
        np.testing.assert_array_equal(first.points_px, second.points_px)
    assert one.config == other.config
    assert one.observations.circles
    assert one.camera.width == 1920


def test_bound_falls_with_more_points_and_grows_with_noise():
    base = bound_px(50)
    # the priors hold a little of both
    assert 1.6 < base / bound_px(200) < 2.05
    assert 1.7 < bound_px(50, 1.0) / base < 2.05
    assert bound_px(50, edges=("outer",)) > 1.1 * base


def test_bound_grows_with_what_is_not_known():
    base = bound_px(100)
    lens = KNOWN.model_copy(update={"distortion": "radial", "k1_sd": 0.02})
    assert bound_px(100, config=lens) > 1.05 * base
    point = KNOWN.model_copy(update={"principal_point_sd_px": 20.0})
    assert bound_px(100, config=point) > 1.05 * base
    position = tuple(float(v) for v in CAMERA.position_m)
    told = KNOWN.model_copy(update={"position_m": position, "position_sd_m": (0.1, 0.1, 0.1)})
    assert bound_px(100, config=told) < 0.9 * base


def test_bound_leaves_fixed_parameters_at_nothing():
    covariance = bound_covariance(CAMERA, 0.0, seen(50, 0.5), TEMPLATE, CIRCLE, KNOWN)
    for name in ("pp_x", "kappa_1", "crown", "width", "bloom"):
        assert covariance[INDEX[name], INDEX[name]] == 0.0
    assert (np.diag(covariance)[:7] > 0).all()


def test_the_true_points_of_the_circle_lie_on_the_crowned_pitch():
    scenario = next(s for s in scenarios() if "crown and principal point drawn" in s.title)
    draw = scenario.draw(np.random.default_rng(5))
    fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
    surface = Surface("roof", 9.15, draw.crown_m)
    exact = tuple(
        replace(point, image_px=draw.camera.project(surface.lift(point.field_m), distort=False), covariance=EXACTLY)
        for point in fit.derived_points
    )
    found = mahalanobis(draw, replace(fit, derived_points=exact), scenario.circle)
    held = [value for name, value in found.items() if name.startswith("point")]
    assert abs(draw.crown_m) > 0.01 and len(held) == len(exact) and all(held)
