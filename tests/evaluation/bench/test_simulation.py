"""The simulation behind ``circlecal simulate`` and ``circlecal bench solvers``."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from circlecal.errors import ConfigError, MissingExtraError
from circlecal.evaluation.bench import simulation_plots, solvers
from circlecal.evaluation.bench.simulation import (
    COLUMNS,
    SimulationPlan,
    parse_noises,
    simulate,
    simulation_plan,
    summarise,
    write_csv,
)
from circlecal.evaluation.bench.solver_scenarios import PAPER_SCENARIOS, select_scenarios, solver_scenarios
from circlecal.evaluation.bench.solvers import paper_statements, run_focals, run_solvers
from circlecal.geometry.conics import circle_conic, sampson_distance, transform_conic
from circlecal.solvers import solver_names

PLAN = SimulationPlan(("great_axis", "magera_case3", "pnl_like"), ("true_centre", "keypoints"), (0.0, 2.0), 2, 4)


@pytest.fixture(scope="module")
def rows():
    return simulate(PLAN)


def timeless(rows):
    return [replace(row, seconds=0.0) for row in rows]


def test_the_same_rows_whatever_the_worker_count(rows):
    assert timeless(simulate(PLAN, workers=2)) == timeless(rows)


def test_a_draw_does_not_depend_on_the_other_solvers_or_cameras(rows):
    alone = simulate(replace(PLAN, solvers=("pnl_like",), scenarios=("keypoints",), noises_px=(2.0,)))
    assert timeless(alone) == timeless(
        [r for r in rows if (r.solver, r.scenario, r.noise_px) == ("pnl_like", "keypoints", 2.0)]
    )


def test_rows_say_what_happened(rows, tmp_path):
    assert len(rows) == 3 * 2 * 2 * 2
    assert all((row.status == "ok") == (row.mre_px is not None) for row in rows)
    assert {r.status for r in rows if r.solver == "pnl_like" and r.scenario == "true_centre"} == {"too_few_keypoints"}
    assert all((row.bound_px == 0) == (row.noise_px == 0) for row in rows)
    with write_csv(rows, tmp_path / "new").open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert tuple(read[0]) == COLUMNS
    assert [r["status"] for r in read] == [r.status for r in rows]
    assert [r["mre_px"] == "" for r in read] == [r.mre_px is None for r in rows]


def test_summaries_count_failures_and_reasons(rows):
    found = {(s.solver, s.scenario, s.noise_px): s for s in summarise(rows)}
    silent = found["pnl_like", "true_centre", 2.0]
    assert silent.failed == 1.0
    assert silent.median_px is None
    assert silent.codes == {"too_few_keypoints": 2}
    exact = found["pnl_like", "keypoints", 0.0]
    assert exact.failed == 0.0
    assert exact.p90_px < 1e-6


def test_every_scenario_shows_what_it_says():
    for index, scenario in enumerate(solver_scenarios().values()):
        rng = np.random.default_rng([11, index])
        camera = scenario.camera(rng)
        seen = scenario.observe(camera, 0.0, rng)
        assert seen.observations.circles
        for points in seen.informative.circles:
            circle = scenario.template.circle_by_name[points.circle]
            width = 0.12 if scenario.name == "wrong_width" else None
            radius = scenario.template.radius(circle, points.edge, width)
            conic = transform_conic(camera.homography, circle_conic(circle.center, radius))
            assert np.abs(sampson_distance(conic, camera.undistort(points.points_px))).max() < 1e-6
        kept = sum(len(c.points_px) for c in seen.informative.circles)
        given = sum(len(c.points_px) for c in seen.observations.circles)
        assert kept == (pytest.approx(0.7 * given) if scenario.name == "outliers" else given)


def test_plans_are_checked():
    plan = simulation_plan([], [], [0.0, 1.0, 1.0], 3, 0)
    assert plan.solvers == solver_names()
    assert plan.scenarios == PAPER_SCENARIOS
    assert plan.noises_px == (0.0, 1.0)
    assert parse_noises("0, 1,2.5") == [0.0, 1.0, 2.5]
    with pytest.raises(ConfigError, match="--noise"):
        parse_noises("0;1")
    for wrong in ([-1.0], [float("nan")], [float("inf")], []):
        with pytest.raises(ConfigError, match="--noise"):
            simulation_plan([], [], wrong, 1, 0)
    with pytest.raises(ConfigError, match="known"):
        simulation_plan(["nobody"], [], [1.0], 1, 0)
    with pytest.raises(ConfigError, match="--scenario"):
        select_scenarios(("nowhere",))


def test_plots_are_whole_and_reproducible(rows, tmp_path):
    pytest.importorskip("matplotlib")
    summaries = summarise(rows)
    first = simulation_plots.write_plots(summaries, tmp_path / "a")
    one = [summary for summary in summaries if summary.scenario == "true_centre"]
    second = simulation_plots.write_plots(one, tmp_path / "b")
    assert sorted(p.name for p in first) == [
        f"simulate_{name}.{kind}" for name in ("keypoints", "true_centre") for kind in ("png", "svg")
    ]
    assert sorted(p.name for p in second) == ["simulate_true_centre.png", "simulate_true_centre.svg"]
    assert all(p.read_bytes() == (tmp_path / "a" / p.name).read_bytes() for p in second)
    assert b"Cramer-Rao" in (tmp_path / "a" / "simulate_true_centre.svg").read_bytes() or first[0].stat().st_size > 9000


def test_every_solver_has_a_colour_and_a_marker_of_its_own():
    assert len(set(simulation_plots.COLORS)) == len(simulation_plots.COLORS) >= len(solver_names())
    markers = [simulation_plots._MARKERS[k % len(simulation_plots._MARKERS)] for k in range(len(solver_names()))]
    assert len(set(markers)) == len(markers)


def test_solvers_without_an_answer_are_in_the_legend(rows, tmp_path):
    pytest.importorskip("matplotlib")
    silent = [
        replace(s, q10_px=None, median_px=None, p90_px=None, failed=1.0) if s.solver == rows[0].solver else s
        for s in summarise(rows)
        if s.scenario == "keypoints"
    ]
    drawn = [path for path in simulation_plots.write_plots(silent, tmp_path) if path.suffix == ".svg"]
    for path in drawn:
        assert path.read_text().count(f"<!-- {rows[0].solver} (no answer) -->") == 1


def test_without_matplotlib_it_is_one_line(monkeypatch):
    monkeypatch.setattr(simulation_plots.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"matplotlib is not installed; .*'.\[plot\]'"):
        simulation_plots.require_matplotlib()


def test_table_at_the_usual_noise():
    found = run_solvers(["great_axis", "huang_self_polar"], ["hockey_pair"], 2, 0)
    assert [(s.solver, s.noise_px, s.draws) for s in found] == [("great_axis", 0.3, 2), ("huang_self_polar", 0.3, 2)]


def test_focal_lengths_and_statements(monkeypatch):
    monkeypatch.setattr(solvers, "FIGURE_NOISES_PX", (1.0, 5.0))
    monkeypatch.setattr(solvers, "FOCAL_NOISES_PX", (0.0, 1.0))
    focals = run_focals(2, 0)
    exact = [f for f in focals if f.noise_px == 0]
    assert {f.method for f in exact} == {"huang_concentric", "chen_wu"}
    assert all(f.median_percent < 0.01 for f in exact if f.median_percent is not None)
    statements = paper_statements(1, 0)
    assert len(statements) == 5
    printed = statements[-1]
    assert "v = E l1" in printed.says
    assert not printed.confirmed
    assert "inverse" in printed.found
