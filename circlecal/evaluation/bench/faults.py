"""A batch that is killed at random moments, and taken up again: is anything that was finished lost, or there twice?"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import circlecal
from circlecal.records.log import RESULTS_NAME

_SIDE = (120, 80)
_PATIENCE_S = 600.0


@dataclass(slots=True)
class KillRow:
    """What kills in one phase of a run did.

    Attributes
    ----------
    phase : str
        Before the first new frame, among the frames, or after the last one.
    kills : int
        How many.
    lost, doubled, damaged : int
        Finished frames that were no longer there afterwards; frames that were there twice; lines that are no records,
        other than a torn last one.
    """

    phase: str
    kills: int = 0
    lost: int = 0
    doubled: int = 0
    damaged: int = 0


@dataclass(frozen=True, slots=True)
class KillReport:
    """All kills, and the runs that were left to end.

    Attributes
    ----------
    rows : list of KillRow
        One for each phase.
    finished_runs, wrong_ends : int
        Runs that ended by themselves, and those of them whose exit code, last line or results were wrong.
    """

    rows: list[KillRow]
    finished_runs: int
    wrong_ends: int


def run_kills(
    kills: int, frames: int, workers: int, seed: int, advance: Callable[[str], None] = lambda _: None
) -> KillReport:
    """Start a batch, kill it with SIGKILL at a random moment, take it up again, and so on; a run that ends is checked.

    Parameters
    ----------
    kills, frames, workers, seed : int
        How often, frames of a run, worker processes, and seed of the moments.
    advance : callable
        Called after each kill.
    """
    rng = np.random.default_rng(seed)
    rows = {phase: KillRow(phase) for phase in ("before the first frame", "among the frames", "after the last frame")}
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="circlecal-faults-") as name:
        folder = Path(name)
        pictures = _paint(folder / "frames", frames)
        span = _measure_span(pictures, folder / "measured", workers)
        out, number = folder / "out0", 0
        done = 0
        while done < kills:
            before = _ids(out)[0]
            run = _start(pictures, out, workers)
            try:
                said, _ = run.communicate(timeout=float(rng.uniform(0.0, span)))
            except subprocess.TimeoutExpired:
                run.send_signal(signal.SIGKILL)
                run.communicate()
                done += 1
                advance(_note_kill(rows, out, before, frames).phase)
                continue
            wrong += not _is_right_end(run.returncode, said, out, frames)
            number += 1
            out = folder / f"out{number}"
        run = _start(pictures, out, workers)
        said, _ = run.communicate(timeout=_PATIENCE_S)
        wrong += not _is_right_end(run.returncode, said, out, frames)
    return KillReport(list(rows.values()), number + 1, wrong)


def _note_kill(rows: dict[str, KillRow], out: Path, before: list[str], frames: int) -> KillRow:
    """The row of the phase of a kill, with what that did."""
    after, damaged = _ids(out)
    first, among, last = rows
    phase = first if len(after) == len(before) < frames else last if len(after) == frames else among
    row = rows[phase]
    row.kills += 1
    row.lost += len(set(before) - set(after))
    row.doubled += sum(count - 1 for count in Counter(after).values())
    row.damaged += damaged
    return row


def _is_right_end(code: int, said: bytes, out: Path, frames: int) -> bool:
    ids, damaged = _ids(out)
    told = said.decode().strip().splitlines()
    return (
        code == 1  # the pictures show no field, so every frame is refused
        and bool(told)
        and told[-1].startswith(f"{frames} frames: 0 calibrated, {frames} refused")
        and sorted(ids) == [f"f{number:04d}" for number in range(frames)]
        and not damaged
    )


def _ids(out: Path) -> tuple[list[str], int]:
    """Frames of the whole lines of the results, and how many of these are no records."""
    path = out / RESULTS_NAME
    if not path.is_file():
        return [], 0
    ids, damaged = [], 0
    for line in path.read_bytes().splitlines(keepends=True):
        if not line.endswith(b"\n"):
            continue
        try:
            ids.append(json.loads(line)["id"])
        except (ValueError, KeyError, TypeError):
            damaged += 1
    return ids, damaged


def _paint(folder: Path, count: int) -> Path:
    """Small pictures without a field."""
    folder.mkdir()
    for number in range(count):
        picture = np.full((_SIDE[1], _SIDE[0], 3), number % 256, np.uint8)
        (folder / f"f{number:04d}.png").write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    return folder


def _start(pictures: Path, out: Path, workers: int) -> subprocess.Popen[bytes]:
    surroundings = {**os.environ, "PYTHONPATH": str(Path(circlecal.__file__).parents[1])}
    command = [sys.executable, "-m", "circlecal", "batch", str(pictures), "--out", str(out)]
    return subprocess.Popen(
        [*command, "--workers", str(workers)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=surroundings
    )


def _measure_span(pictures: Path, out: Path, workers: int) -> float:
    """Seconds of a whole run, and a little more."""
    start = time.monotonic()
    _start(pictures, out, workers).communicate(timeout=_PATIENCE_S)
    return 1.1 * (time.monotonic() - start)
