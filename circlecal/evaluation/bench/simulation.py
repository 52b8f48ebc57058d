"""``circlecal simulate``: every solver on the same draws of every view, beside the Cramer-Rao bound.

A draw depends on the seed, the camera's number and the scenario only: neither the order of solvers nor the number of
workers changes a figure. All noise levels use the same noise, scaled.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from circlecal.batch.workers import map_on_workers
from circlecal.errors import ConfigError
from circlecal.evaluation.bench.bounds import bound_covariance, bound_errors
from circlecal.evaluation.bench.reprojection import grid_in_view, mean_reprojection_error
from circlecal.evaluation.bench.solver_scenarios import PAPER_SCENARIOS, Seen, SolverScenario, select_scenarios
from circlecal.files import write_atomic
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.solvers import load_solver, solver_names

CSV_NAME = "simulate.csv"
COLUMNS = ("solver", "scenario", "noise_px", "camera", "status", "mre_px", "bound_px")
LARGEST_NOISE_PX = 1000.0
BOUND_DRAWS = 64
"""Errors that are drawn at the bound for each truth; their median is taken."""
OK = "ok"


@dataclass(frozen=True, slots=True)
class SimulationPlan:
    """What is run: solvers x scenarios x noise levels (pixels; None takes each scenario's usual one) x cameras."""

    solvers: tuple[str, ...]
    scenarios: tuple[str, ...]
    noises_px: tuple[float | None, ...]
    cameras: int
    seed: int


@dataclass(frozen=True, slots=True)
class SimulationRow:
    """One solver on one draw; ``status`` is ``ok`` or the reason of the failure, ``mre_px`` then None."""

    solver: str
    scenario: str
    noise_px: float
    camera: int
    status: str
    mre_px: float | None
    bound_px: float
    seconds: float


def simulation_plan(
    solvers: Sequence[str], scenarios: Sequence[str], noises_px: Sequence[float], cameras: int, seed: int
) -> SimulationPlan:
    """Checked plan: all solvers where none is named, the paper's scenarios where none is named.

    Raises
    ------
    ConfigError
        Unknown names, or a noise that is negative, not finite or above 1000 px.
    """
    for name in solvers:
        load_solver(name)
    chosen = tuple(scenarios) or PAPER_SCENARIOS
    select_scenarios(chosen)
    wrong = [n for n in noises_px if not 0.0 <= n <= LARGEST_NOISE_PX]
    if wrong or not noises_px:
        raise ConfigError(f"--noise: give numbers from 0 to {LARGEST_NOISE_PX:g} separated by commas, e.g. 0,1,5")
    return SimulationPlan(
        tuple(dict.fromkeys(solvers)) or solver_names(),
        tuple(dict.fromkeys(chosen)),
        tuple(dict.fromkeys(float(n) for n in noises_px)),
        cameras,
        seed,
    )


def parse_noises(text: str) -> list[float]:
    """Noise levels from ``0,1,5``.

    Raises
    ------
    ConfigError
        Where a part is no number.
    """
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError as error:
        raise ConfigError(f"--noise {text!r}: give numbers separated by commas, e.g. 0,1,5") from error


def simulate(
    plan: SimulationPlan, workers: int = 1, advance: Callable[[str], None] = lambda _: None
) -> list[SimulationRow]:
    """Run a plan; rows are ordered by scenario, camera, noise and solver, whatever the number of workers.

    Parameters
    ----------
    plan : SimulationPlan
        From :func:`simulation_plan`.
    workers : int
        Processes; 1 runs in this one.
    advance : callable
        Called after each camera of each scenario with the scenario's name.
    """
    tasks = [(plan, name, index) for name in plan.scenarios for index in range(plan.cameras)]
    rows: list[SimulationRow] = []
    found_in_order = map(rows_of_camera, tasks) if workers == 1 else map_on_workers(rows_of_camera, tasks, workers)
    for (_, name, _), found in zip(tasks, found_in_order, strict=True):
        rows += found
        advance(name)
    return rows


def rows_of_camera(task: tuple[SimulationPlan, str, int]) -> list[SimulationRow]:
    """All noise levels and solvers on one camera of one scenario."""
    plan, name, index = task
    scenario = select_scenarios((name,))[0]
    camera = scenario.camera(np.random.default_rng([plan.seed, index]))
    grid = grid_in_view(camera, scenario.template)
    rows = []
    for noise in plan.noises_px:
        noise_px = scenario.usual_noise_px if noise is None else noise
        seen = scenario.observe(camera, noise_px, np.random.default_rng([plan.seed, index, crc32(name.encode())]))
        bound = 0.0 if noise_px == 0 else bound_px(scenario, camera, seen, grid, [plan.seed, index])
        for solver in plan.solvers:
            status, error, seconds = measure_error(solver, scenario, camera, seen, grid, [plan.seed, index])
            rows.append(SimulationRow(solver, name, noise_px, index, status, error, bound, seconds))
    return rows


def bound_px(scenario: SolverScenario, camera: Camera, seen: Seen, grid: Array, seed: list[int]) -> float:
    """Error of an estimator at the Cramer-Rao bound of a pinhole camera under the scenario's priors.

    The median over its noise, to be compared with medians: one or two soft directions make up most of the error, so
    its mean is a quarter larger.
    """
    covariance = bound_covariance(camera, 0.0, seen.informative, scenario.template, scenario.circle, scenario.told)
    rng = np.random.default_rng([*seed, crc32(b"bound")])
    return float(np.median(bound_errors(camera, covariance, grid, BOUND_DRAWS, rng)))


def measure_error(
    solver: str, scenario: SolverScenario, camera: Camera, seen: Seen, grid: Array, seed: list[int]
) -> tuple[str, float | None, float]:
    """Status, mean reprojection error and seconds of one call."""
    solve = load_solver(solver)
    rng = np.random.default_rng([*seed, crc32(solver.encode())])
    start = time.perf_counter()
    result = solve(seen.observations, scenario.template, scenario.circle, rng)
    seconds = time.perf_counter() - start
    if result.H_image_field is None:
        return result.code, None, seconds
    error = mean_reprojection_error(camera.homography, result.H_image_field, grid)
    return (OK, error, seconds) if np.isfinite(error) else ("not_finite", None, seconds)


def write_csv(rows: Sequence[SimulationRow], folder: Path) -> Path:
    """Write ``simulate.csv``, one line per solver and draw."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        error = "" if row.mre_px is None else f"{row.mre_px:.6g}"
        writer.writerow(
            (row.solver, row.scenario, f"{row.noise_px:g}", row.camera, row.status, error, f"{row.bound_px:.6g}")
        )
    path = folder / CSV_NAME
    write_atomic(path, text.getvalue().encode())
    return path


@dataclass(frozen=True, slots=True)
class Summary:
    """One solver on one scenario at one noise: quantiles of the answered draws' errors, and the share without answer.

    ``codes`` counts the reasons of the failures.
    """

    solver: str
    scenario: str
    noise_px: float
    draws: int
    q10_px: float | None
    median_px: float | None
    p90_px: float | None
    failed: float
    codes: dict[str, int]
    ms: float
    bound_median_px: float
    bound_p90_px: float


def summarise(rows: Sequence[SimulationRow]) -> list[Summary]:
    """Summaries in the order in which scenario, noise and solver first appear."""
    groups: dict[tuple[str, float, str], list[SimulationRow]] = {}
    for row in rows:
        groups.setdefault((row.scenario, row.noise_px, row.solver), []).append(row)
    found = []
    for (scenario, noise, solver), group in groups.items():
        errors = [row.mre_px for row in group if row.mre_px is not None]
        quantiles = np.percentile(errors, (10, 50, 90)) if errors else None
        codes: dict[str, int] = {}
        for row in group:
            if row.status != OK:
                codes[row.status] = codes.get(row.status, 0) + 1
        bounds = np.array([row.bound_px for row in group])
        found.append(
            Summary(
                solver=solver,
                scenario=scenario,
                noise_px=noise,
                draws=len(group),
                q10_px=None if quantiles is None else float(quantiles[0]),
                median_px=None if quantiles is None else float(quantiles[1]),
                p90_px=None if quantiles is None else float(quantiles[2]),
                failed=1.0 - len(errors) / len(group),
                codes=codes,
                ms=float(np.median([row.seconds for row in group]) * 1e3),
                bound_median_px=float(np.median(bounds)),
                bound_p90_px=float(np.percentile(bounds, 90)),
            )
        )
    return found
