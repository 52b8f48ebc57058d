"""``circlecal bench accuracy``, ``ransac`` and ``solvers``: methods on synthetic observations, without pictures."""

from __future__ import annotations

from functools import partial
from math import isinf
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli.bench.tables import Json, Seed, format_figure, print_record, print_rows, split_names

if TYPE_CHECKING:
    from circlecal.evaluation.bench.accuracy import Row
    from circlecal.evaluation.bench.simulation import Summary


def accuracy(
    rows: Annotated[str, typer.Option(help="Rows to run, separated by commas, e.g. 3,5,8; all when empty.")] = "",
    draws: Annotated[int, typer.Option(min=2, help="Random cameras per row.")] = 100,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Measure the camera's error on synthetic observations, beside the Cramer-Rao bound on these draws."""
    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.accuracy import all_row_names, as_records, run_rows
    from circlecal.evaluation.bench.many_frames import select_rigs
    from circlecal.evaluation.bench.scenarios import select_rows

    names = split_names(rows, "--rows", all_row_names())
    with count_steps("draw", (len(select_rows(names)) + len(select_rigs(names))) * draws) as advance:
        found, closed = run_rows(names, draws, seed, advance)
    if as_json:
        print_record({"rows": as_records(found), "closed_forms": dict(closed)})
        return
    if found:
        _print_accuracy(found)
    if closed:
        print_rows(
            "Closed forms (mean reprojection error, px)",
            closed,
            {"row": lambda c: c[0], "px": lambda c: f"{c[1]:.3g}"},
        )


def _print_accuracy(rows: list[Row]) -> None:
    print_rows(
        "Mean reprojection error, px at 1920 x 1080: median (90th percentile)",
        rows,
        {
            "row": lambda r: r.row,
            "scenario": lambda r: r.title,
            "draws": lambda r: str(r.draws),
            "circlecal": lambda r: f"{r.median_px:.2f} ({r.p90_px:.2f})",
            "bound": lambda r: f"{r.bound_median_px:.2f} ({r.bound_p90_px:.2f})",
            "mean / bound": lambda r: f"{r.efficiency:.2f} +- {r.efficiency_error:.2f}",
            "wrong": lambda r: f"{r.wrong:.1%}",
            "failed": lambda r: f"{r.failed:.1%}",
            "to reach": _format_reach,
            "H in 90 %": lambda r: f"{r.coverage.get('homography', float('nan')):.0%}",
            "ms": lambda r: f"{r.ms:.0f}",
        },
    )
    offsets = rows[0].by_offset.keys()
    print_rows(
        "Median, px, by the camera's offset from the halfway plane",
        [r for r in rows if r.by_offset.keys() == offsets],
        {"row": lambda r: r.row, **{offset: partial(_format_offset, offset) for offset in offsets}},
    )


def _format_offset(offset: str, row: Row) -> str:
    return f"{row.by_offset[offset]:.2f}"


def _format_reach(row: Row) -> str:
    if isinf(row.reach_median_px):
        return "-"
    return f"{row.reach_median_px:.3g}" + (f" ({row.reach_p90_px:.3g})" if row.reach_p90_px is not None else "")


def ransac(
    draws: Annotated[int, typer.Option(min=2, help="Draws per outlier share.")] = 200,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Fit ellipses under outliers, and compare speed with OpenCV and scikit-image."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.ransac import OUTLIER_SHARES, robustness, speed

    with count_steps("draw", len(OUTLIER_SHARES) * draws) as advance:
        good = robustness(draws, seed, advance)
    fast = speed(seed)
    if as_json:
        print_record({"robustness": [asdict(r) for r in good], "speed": [asdict(s) for s in fast]})
        return
    print_rows(
        "Within 1.5 x of the fit on the true inliers (400 points, row 14)",
        good,
        {
            "outliers": lambda r: f"{r.outliers:.0%}",
            "sigma px": lambda r: f"{r.sigma_px:g}",
            "draws": lambda r: str(r.draws),
            "good": lambda r: f"{r.good:.1%}",
        },
    )
    print_rows(
        "1000 hypotheses on 800 points, one thread (row 15)",
        fast,
        {"what": lambda s: s.name, "ms": lambda s: f"{s.ms:.1f}", "times circlecal's": lambda s: f"{s.ratio:.1f}"},
    )


def solvers(
    solver: Annotated[
        list[str] | None, typer.Option("--solver", metavar="NAME", help="Solver; repeatable. (default: all)")
    ] = None,
    scenario: Annotated[
        list[str] | None, typer.Option("--scenario", metavar="NAME", help="View; repeatable. (default: all)")
    ] = None,
    draws: Annotated[int, typer.Option(min=2, help="Random cameras per view.")] = 100,
    seed: Seed = 0,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes; with more than one the times are not to be read.")
    ] = 1,
    no_statements: Annotated[
        bool, typer.Option("--no-statements", help="Leave out focal lengths and the paper's statements.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Run every published solver on every view, and list the paper's statements that the runs do not confirm."""
    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.solvers import as_records, paper_statements, run_focals, run_solvers, scenario_count

    with count_steps("camera", scenario_count(scenario or ()) * draws) as advance:
        found = run_solvers(solver or (), scenario or (), draws, seed, workers, advance)
    focals, statements = [], []
    if not no_statements:
        with count_steps("camera", 6 * draws) as advance:
            focals = run_focals(draws, seed, advance)
            statements = paper_statements(draws, seed, workers, advance)
    if as_json:
        print_record(as_records(found, focals, statements))
        return
    _print_solvers(found)
    if no_statements:
        return
    print_rows(
        "Focal length, methods that find nothing else: median relative error",
        focals,
        {
            "method": lambda f: f.method,
            "from": lambda f: f.view,
            "noise px": lambda f: f"{f.noise_px:g}",
            "draws": lambda f: str(f.draws),
            "error": lambda f: "-" if f.median_percent is None else f"{f.median_percent:.2g} %",
            "no answer": lambda f: f"{f.failed:.0%}",
        },
    )
    print_rows(
        "Statements of the paper that these runs do not confirm",
        [s for s in statements if not s.confirmed],
        {"where": lambda s: s.where, "it says": lambda s: s.says, "here": lambda s: s.found},
    )


def _print_solvers(found: list[Summary]) -> None:
    """Combinations in which nothing is answered are named below the table instead of filling it."""
    print_rows(
        "Mean reprojection error, px at 1920 x 1080, of the answered draws",
        [s for s in found if s.median_px is not None],
        {
            "scenario": lambda s: s.scenario,
            "noise px": lambda s: f"{s.noise_px:g}",
            "solver": lambda s: s.solver,
            "draws": lambda s: str(s.draws),
            "median": lambda s: format_figure(s.median_px, ".3g"),
            "p90": lambda s: format_figure(s.p90_px, ".3g"),
            "no answer": lambda s: f"{s.failed:.0%}",
            "bound": lambda s: f"{s.bound_median_px:.3g} ({s.bound_p90_px:.3g})",
            "ms": lambda s: f"{s.ms:.1f}",
        },
    )
    silent = [s for s in found if s.median_px is None]
    if silent:
        print_rows(
            "No answer on any draw",
            silent,
            {
                "scenario": lambda s: s.scenario,
                "solver": lambda s: s.solver,
                "reason": lambda s: ", ".join(s.codes),
            },
        )
