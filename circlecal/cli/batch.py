"""``circlecal batch``."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options


def batch(
    inputs: options.Inputs,
    out: options.Out = Path("circlecal-out"),
    workers: Annotated[
        int | None, typer.Option("--workers", "-w", min=1, help="Worker processes. [default: one per CPU]")
    ] = None,
    files: Annotated[
        bool, typer.Option("--files", help="Also write a result file and pictures per frame, like calibrate.")
    ] = False,
    restart: Annotated[bool, typer.Option("--restart", help="Start over instead of going on.")] = False,
    mask: options.Mask = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    camera_prior: options.CameraPrior = None,
    solver: options.Solver = None,
    field: options.FieldName = None,
    seed: options.Seed = None,
    radar: options.Radar = False,
    no_overlay: options.NoOverlay = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the counts as JSON.")] = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Calibrate many pictures in parallel into results.jsonl and summary.csv; run it again to go on after a stop."""
    from circlecal.batch import RESULTS_NAME, run_batch
    from circlecal.cli import console

    console.configure_logging(quiet=quiet, verbose=verbose)
    chosen = options.chosen_config(
        config, settings, field, seed, radar=radar, no_overlay=no_overlay, camera_prior=camera_prior, solver=solver
    )
    frames = options.chosen_frames(inputs, out, mask)
    with console.progress_display(quiet=quiet) as show:
        counts = run_batch(
            frames,
            chosen,
            out,
            workers=workers or _cpu_count(),
            mask=mask,
            restart=restart,
            frame_files=files,
            on_progress=show,
        )
    if as_json:
        numbers = {name: value for name, value in asdict(counts).items() if name != "last"}
        console.print_line(json.dumps({**numbers, "results": str(out / RESULTS_NAME)}))
    elif not quiet:
        console.print_line(
            f"{counts.total} frames: {counts.calibrated} calibrated, {counts.refused} refused"
            f"{f' ({counts.unreadable} of them unreadable)' if counts.unreadable else ''}; see {out / RESULTS_NAME}"
        )
    if counts.refused:
        raise typer.Exit(1)


def _cpu_count() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
