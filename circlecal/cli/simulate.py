"""``circlecal simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def simulate(
    solver: Annotated[
        list[str] | None, typer.Option("--solver", metavar="NAME", help="Solver to run; repeatable. (default: all)")
    ] = None,
    scenario: Annotated[
        list[str] | None,
        typer.Option("--scenario", metavar="NAME", help="View to draw; repeatable. (default: the paper's three)"),
    ] = None,
    noise: Annotated[str, typer.Option("--noise", metavar="PX,PX", help="Noise levels in pixels.")] = "0,1,2,5,10,25",
    cameras: Annotated[int, typer.Option("--cameras", min=1, help="Random cameras per view.")] = 100,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed; a draw depends on it and its number only.")] = 0,
    out: Annotated[Path, typer.Option("--out", help="Folder for simulate.csv and the plots.")] = Path(
        "circlecal-simulate"
    ),
    workers: Annotated[int, typer.Option("--workers", min=1, help="Processes; the figures do not depend on it.")] = 1,
    no_plots: Annotated[bool, typer.Option("--no-plots", help="Write the table only (needs no matplotlib).")] = False,
) -> None:
    """Run the paper's synthetic study, and the views that it leaves out, for any set of solvers."""
    from circlecal.cli import console
    from circlecal.evaluation.bench import simulation
    from circlecal.evaluation.bench.simulation_plots import require_matplotlib, write_plots
    from circlecal.files import prepare_folder

    plan = simulation.simulation_plan(solver or (), scenario or (), simulation.parse_noises(noise), cameras, seed)
    if not no_plots:
        require_matplotlib()
    prepare_folder(out)
    with console.count_steps("camera", len(plan.scenarios) * cameras) as advance:
        rows = simulation.simulate(plan, workers, advance)
    written = [simulation.write_csv(rows, out)]
    summaries = simulation.summarise(rows)
    if not no_plots:
        written += write_plots(summaries, out)
    console.print_table(
        "Mean reprojection error, px, of the answered draws",
        ["scenario", "noise px", "solver", "median", "p90", "no answer", "bound"],
        [
            [
                s.scenario,
                f"{s.noise_px:g}",
                s.solver,
                "-" if s.median_px is None else f"{s.median_px:.3g}",
                "-" if s.p90_px is None else f"{s.p90_px:.3g}",
                f"{s.failed:.0%}",
                f"{s.bound_median_px:.3g}",
            ]
            for s in summaries
        ],
    )
    console.print_line(
        f"{console.count_of(len(rows), 'row')} and {console.count_of(len(written) - 1, 'picture')} written to {out}"
    )
