"""``circlecal bench batch``, ``fuzz``, ``faults`` and ``soak``: many frames, damaged files, kills and long runs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli.bench.tables import Json, Seed, print_record, print_rows

if TYPE_CHECKING:
    from circlecal.evaluation.bench.batch import Scaling
    from circlecal.evaluation.bench.fuzz import FuzzRow

Workers = Annotated[int, typer.Option("--workers", "-w", min=1, help="Worker processes.")]


def time_batch(
    count: Annotated[int, typer.Option(min=2, help="Rendered frames per run.")] = 24,
    workers: Annotated[int, typer.Option("--workers", "-w", min=2, help="Worker processes beside one.")] = 2,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each; the best counts.")] = 2,
    tasks: Annotated[int, typer.Option(min=0, help="Simulated frames, which take no time; 0 for none.")] = 100_000,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Time a batch: throughput, what it adds to the calibrations, how time and memory grow with the frames."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.batch import run_scaling, run_throughput

    with count_steps("run", 2 * repeats + (3 if tasks else 0)) as advance:
        rates = run_throughput(count, workers, repeats, seed, advance)
        scaling = run_scaling(tasks, workers, advance) if tasks else None
    if as_json:
        print_record({"throughput": [asdict(r) for r in rates], "scaling": scaling and asdict(scaling)})
        return
    print_rows(
        "Rendered frames, steady state",
        rates,
        {
            "workers": lambda r: str(r.workers),
            "frames/s": lambda r: f"{r.rate:.2f}",
            "times one worker": lambda r: f"{r.speedup:.2f}",
            "time added": lambda r: f"{r.overhead:.1%}",
            "CPU s a calibration": lambda r: f"{r.cpu_s:.3f}",
            "CPU added": lambda r: f"{r.cpu_overhead:.1%}",
        },
    )
    if scaling is not None:
        _print_scaling(scaling)


def _print_scaling(scaling: Scaling) -> None:
    from circlecal.cli.console import print_table

    early, late, taken = scaling.memory_mb
    print_table(
        f"{scaling.frames} simulated frames, {scaling.megabytes:.0f} MB of results",
        ["what", "s", "MB in memory"],
        [
            ["run, first tenth", "", f"{early:.0f}"],
            ["run, whole", f"{scaling.seconds:.1f}", f"{late:.0f}"],
            ["taken up: results scanned", f"{scaling.index_seconds:.3f}", ""],
            ["taken up: every frame passed over, summary written", f"{scaling.skip_seconds:.1f}", f"{taken:.0f}"],
            ["taken up without an index", f"{scaling.rebuild_seconds:.1f}", ""],
        ],
    )


def fuzz(
    context: typer.Context,
    count: Annotated[int, typer.Option(min=1, help="Damaged files in all.")] = 10_000,
    seed: Seed = 0,
    only: Annotated[str, typer.Option(help="Part of the name of the readers that are wanted.")] = "",
    keep: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Keep files here on which something goes wrong.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Give damaged files to every reader and command, and count tracebacks, hangs and wrong exit codes."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.cli.invoke import run_command
    from circlecal.errors import InputError
    from circlecal.evaluation.bench.fuzz import is_supported, run_fuzz

    if not is_supported():
        raise InputError("bench fuzz: needs the timers of a Unix system")
    with count_steps("file", count) as advance:
        rows = run_fuzz(count, seed, partial(run_command, context.find_root().command), only, keep, advance)
    if as_json:
        print_record([asdict(row) for row in rows])
    else:
        _print_fuzz(rows)
    for row in rows:
        for example in row.examples:
            typer.echo(f"{row.name}: {example}", err=True)
    if any(row.failures for row in rows):
        raise typer.Exit(1)


def _print_fuzz(rows: list[FuzzRow]) -> None:
    from circlecal.evaluation.bench.fuzz import HANG_S, MOST_MB, add_rows

    print_rows(
        "Damaged files",
        [*rows, add_rows("all", rows)],
        {
            "reader": lambda r: r.name,
            "files": lambda r: str(r.inputs),
            "read": lambda r: str(r.read),
            "refused": lambda r: str(r.refused),
            "tracebacks": lambda r: str(r.tracebacks),
            f"over {HANG_S:g} s": lambda r: str(r.hangs),
            f"over {MOST_MB:g} MB": lambda r: str(r.over_memory),
            "wrong exit codes": lambda r: str(r.wrong_exits),
            "slowest s": lambda r: f"{r.slowest_s:.1f}",
            "most MB": lambda r: f"{r.most_mb:.0f}",
        },
    )


def faults(
    kills: Annotated[int, typer.Option(min=1, help="How often a batch is killed.")] = 100,
    frames: Annotated[int, typer.Option(min=1, help="Frames of a batch.")] = 200,
    workers: Workers = 2,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Kill a batch with SIGKILL at random moments, take it up again, and count what is lost or there twice."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps
    from circlecal.evaluation.bench.faults import run_kills

    with count_steps("kill", kills) as advance:
        report = run_kills(kills, frames, workers, seed, advance)
    if as_json:
        print_record(asdict(report))
    else:
        print_rows(
            f"Killed at random moments; of {report.finished_runs} runs that ended {report.wrong_ends} ended wrongly",
            report.rows,
            {
                "killed": lambda r: r.phase,
                "times": lambda r: str(r.kills),
                "finished frames lost": lambda r: str(r.lost),
                "frames twice": lambda r: str(r.doubled),
                "damaged lines": lambda r: str(r.damaged),
            },
        )
    if report.wrong_ends or any(r.lost or r.doubled or r.damaged for r in report.rows):
        raise typer.Exit(1)


def soak(
    count: Annotated[int, typer.Option(min=20, help="Small frames.")] = 20_000,
    workers: Workers = 2,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Run a long batch of small frames: memory, open files and temporary files after a fifth of it and at its end."""
    from dataclasses import asdict

    from circlecal.cli.console import count_steps, print_table
    from circlecal.evaluation.bench.soak import run_soak

    with count_steps("frame", count) as advance:
        report = run_soak(count, workers, seed, advance)
    if as_json:
        print_record({**asdict(report), "growth": report.growth})
        return
    (memory, later), (files, open_later) = report.memory_mb, report.files
    print_table(
        f"{report.frames} small frames on {workers} workers, {report.rate:.1f} frames/s",
        ["", "after a fifth", "at the end", "growth"],
        [
            ["resident memory, MB", f"{memory:.0f}", f"{later:.0f}", f"{report.growth:+.1%}"],
            ["open files", str(files), str(open_later), f"{open_later - files:+d}"],
            ["temporary files", "", str(report.temporary), ""],
        ],
    )
