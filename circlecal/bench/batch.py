"""``circlecal bench batch``: what the machinery around the calibrations costs, and how it grows."""

from __future__ import annotations

import json
import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from circlecal.api import FrameRun
from circlecal.batch import INDEX_NAME, RESULTS_NAME, BatchProgress, ResultLog, run_batch
from circlecal.batch.task import Record, failed
from circlecal.config import load_config
from circlecal.formats.images import Frame, find_frames
from circlecal.synthetic.sampling import SceneProfile, render_frame

_PROFILE: SceneProfile = "easy"
_PICTURES = 4
_WARM_UP_FRAMES = 4
_MEGABYTE = 1e6
_SIMULATED_SHARE = 0.1
"""Memory is compared with that after this share of the simulated frames."""


@dataclass(frozen=True, slots=True)
class Throughput:
    """Rates in steady state, frames per second, and what the batch adds to the calibrations themselves.

    Attributes
    ----------
    workers, rate : int, float
        Best of the repeats.
    speedup : float
        Best ratio to one worker among the repeats, each run right after the other.
    overhead : float
        Of one worker: time per frame over the time inside the calibration, minus 1.
    """

    workers: int
    rate: float
    speedup: float
    overhead: float


@dataclass(frozen=True, slots=True)
class Scaling:
    """A run over frames that take no time, and taking it up again.

    ``memory_mb`` is what this process holds after ``_SIMULATED_SHARE`` of the frames, at the end, and when the run has
    been taken up.
    """

    frames: int
    seconds: float
    megabytes: float
    memory_mb: tuple[float, float, float]
    index_seconds: float
    skip_seconds: float
    rebuild_seconds: float


@dataclass(frozen=True)
class _Timed:
    """A run whose records tell how long the worker was busy with them."""

    run: FrameRun

    @property
    def digest(self) -> str:
        return self.run.digest

    @property
    def seed(self) -> int:
        return self.run.seed

    def source(self, frame: Frame) -> str:
        return self.run.source(frame)

    def record(self, frame: Frame) -> Record:
        start = time.perf_counter()
        record = self.run.record(frame)
        return {**record, "busy_s": time.perf_counter() - start}


@dataclass(frozen=True, slots=True)
class _Simulated:
    id: str


@dataclass(frozen=True, slots=True)
class _Nothing:
    """A task that takes no time."""

    digest: str = "0" * 12
    seed: int = 0

    def source(self, frame: _Simulated) -> str:
        return f"{frame.id}.jpg"

    def record(self, frame: _Simulated) -> Record:
        return failed(self, frame, "simulated", "simulated")


def run_throughput(
    count: int, workers: int, repeats: int, seed: int, advance: Callable[[str], None] = lambda _: None
) -> list[Throughput]:
    """Calibrate ``count`` rendered frames with one worker and with several, in turn."""
    with tempfile.TemporaryDirectory(prefix="circlecal-bench-") as name:
        folder = Path(name)
        frames = _rendered(folder / "frames", count, seed)
        rates: dict[int, list[float]] = {1: [], workers: []}
        overheads: dict[int, list[float]] = {1: [], workers: []}
        for _ in range(repeats):
            for number in rates:
                rate, busy = _one_run(frames, folder / "out", number)
                rates[number].append(rate)
                overheads[number].append(number / rate / busy - 1.0)
                advance(f"{number} workers")
    ratios = [several / one for one, several in zip(rates[1], rates[workers], strict=True)]
    return [
        Throughput(1, max(rates[1]), 1.0, min(overheads[1])),
        Throughput(workers, max(rates[workers]), max(ratios), min(overheads[workers])),
    ]


def _rendered(folder: Path, count: int, seed: int) -> list[Frame]:
    """A few rendered pictures under many names."""
    folder.mkdir()
    generator = np.random.default_rng(seed)
    pictures = [render_frame(_PROFILE, generator).image for _ in range(_PICTURES)]
    encoded = [cv2.imencode(".jpg", picture)[1].tobytes() for picture in pictures]
    for number in range(count + _WARM_UP_FRAMES):
        (folder / f"f{number:05d}.jpg").write_bytes(encoded[number % _PICTURES])
    return find_frames([folder])


def _one_run(frames: list[Frame], out: Path, workers: int) -> tuple[float, float]:
    """Frames per second after the start of the workers, and a worker's mean time per frame."""
    finished: list[float] = []
    task = _Timed(FrameRun(load_config()))
    run_batch(
        frames, task, out, workers=workers, restart=True, on_progress=lambda _: finished.append(time.perf_counter())
    )
    busy = [json.loads(line)["busy_s"] for line in (out / RESULTS_NAME).read_bytes().splitlines()]
    first = _WARM_UP_FRAMES
    return (len(frames) - first) / (finished[-1] - finished[first]), float(np.mean(busy[first:]))


def run_scaling(count: int, workers: int, advance: Callable[[str], None] = lambda _: None) -> Scaling:
    """Take ``count`` simulated frames through workers and results, and take the run up again in three ways."""
    early: list[float] = []

    def watch(progress: BatchProgress) -> None:
        if not early and progress.finished >= _SIMULATED_SHARE * count:
            early.append(_memory_mb())

    with tempfile.TemporaryDirectory(prefix="circlecal-bench-") as name:
        out = Path(name)
        start = time.perf_counter()
        run_batch(_simulated(count), _Nothing(), out, workers=workers, total=count, on_progress=watch)
        seconds, late = time.perf_counter() - start, _memory_mb()
        advance("simulated")
        indexed = _taken_up(out)
        start = time.perf_counter()
        run_batch(_simulated(count), _Nothing(), out, workers=workers, total=count)
        skipped = time.perf_counter() - start
        taken = _memory_mb()
        advance("taken up")
        (out / INDEX_NAME).unlink()
        rebuilt = _taken_up(out)
        advance("index made anew")
        size = (out / RESULTS_NAME).stat().st_size / _MEGABYTE
    return Scaling(count, seconds, size, (early[0], late, taken), indexed, skipped, rebuilt)


def _simulated(count: int) -> Iterator[_Simulated]:
    return (_Simulated(f"match_{number:08d}") for number in range(count))


def _taken_up(out: Path) -> float:
    start = time.perf_counter()
    with ResultLog(out) as log:
        log.take_up(_Nothing().digest)
    return time.perf_counter() - start


def _memory_mb() -> float:
    """What this process holds now; the most that it ever held where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return pages * os.sysconf("SC_PAGE_SIZE") / _MEGABYTE
