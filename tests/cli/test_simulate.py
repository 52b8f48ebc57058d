"""``circlecal simulate`` and ``circlecal bench solvers``."""

import csv
import json

import pytest


def simulate(run_circlecal, out, *more):
    given = ("--solver", "great_axis", "--solver", "alvarez_caselles", "--noise", "0,1", "--cameras", 2, "--seed", 3)
    return run_circlecal("simulate", *given, "--scenario", "true_centre", "--out", out, *more)


def test_table_and_pictures(run_circlecal, tmp_path):
    pytest.importorskip("matplotlib")
    outcome = simulate(run_circlecal, tmp_path)
    assert outcome.code == 0, outcome
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "simulate.csv",
        "simulate_true_centre.png",
        "simulate_true_centre.svg",
    ]
    with (tmp_path / "simulate.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    assert {r["status"] for r in rows} == {"ok"}
    assert "true_centre" in outcome.out
    assert "2/2 cameras" in outcome.err


def test_without_pictures(run_circlecal, tmp_path):
    assert simulate(run_circlecal, tmp_path, "--no-plots").code == 0
    assert [p.name for p in tmp_path.iterdir()] == ["simulate.csv"]


@pytest.mark.parametrize(
    "wrong", [("--solver", "nobody"), ("--noise", "a"), ("--noise", "-1"), ("--scenario", "nowhere")]
)
def test_wrong_use_is_one_line(run_circlecal, tmp_path, wrong):
    outcome = run_circlecal("simulate", *wrong, "--cameras", 1, "--out", tmp_path / "none")
    assert outcome.code == 2
    assert len(outcome.err.strip().splitlines()) == 1
    assert not (tmp_path / "none").exists()


def test_bench_solvers(run_circlecal):
    given = ("--draws", 2, "--scenario", "hockey_pair", "--solver", "huang_self_polar", "--no-statements", "--json")
    outcome = run_circlecal("bench", "solvers", *given)
    assert outcome.code == 0, outcome
    found = json.loads(outcome.out)["solvers"]
    assert found[0]["median_px"] < 1.0
