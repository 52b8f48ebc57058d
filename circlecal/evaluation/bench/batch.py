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

from circlecal.batch import BatchProgress, run_batch
from circlecal.batch.frames import FrameRun
from circlecal.batch.task import record_failure
from circlecal.config import load_config
from circlecal.pictures.files import PictureFile, find_frames
from circlecal.records.log import INDEX_NAME, RESULTS_NAME, ResultLog
from circlecal.records.record import ResultRecord
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
        Time per frame and worker over the time inside the calibration, minus 1; least of the repeats.
    cpu_s, cpu_overhead : float
        Processor time of a calibration, and that of the batch over it; what other programs do hardly shows in these.
    """

    workers: int
    rate: float
    speedup: float
    overhead: float
    cpu_s: float
    cpu_overhead: float


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

    def source(self, frame: PictureFile) -> str:
        return self.run.source(frame)

    def record(self, frame: PictureFile) -> ResultRecord:
        start, cpu = time.perf_counter(), time.process_time()
        record = self.run.record(frame)
        return record.model_copy(update={"busy_s": time.perf_counter() - start, "cpu_s": time.process_time() - cpu})


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

    def record(self, frame: _Simulated) -> ResultRecord:
        return record_failure(self, frame, "simulated", "simulated")


def run_throughput(
    count: int, workers: int, repeats: int, seed: int, advance: Callable[[str], None] = lambda _: None
) -> list[Throughput]:
    """Calibrate ``count`` rendered frames with one worker and with several, in turn."""
    with tempfile.TemporaryDirectory(prefix="circlecal-bench-") as name:
        folder = Path(name)
        frames = _render(folder / "frames", count, seed)
        runs: dict[int, list[_Run]] = {1: [], workers: []}
        for _ in range(repeats):
            for number in runs:
                runs[number].append(_one_run(frames, folder / "out", number))
                advance(f"{number} workers")
    ratios = [several.rate / one.rate for one, several in zip(runs[1], runs[workers], strict=True)]
    return [
        Throughput(
            workers=number,
            rate=max(run.rate for run in found),
            speedup=1.0 if number == 1 else max(ratios),
            overhead=min(number / run.rate / run.busy_s - 1.0 for run in found),
            cpu_s=min(run.cpu_s for run in found),
            cpu_overhead=min(run.own_cpu_s / run.cpu_s for run in found),
        )
        for number, found in runs.items()
    ]


def _render(folder: Path, count: int, seed: int) -> list[PictureFile]:
    """A few rendered pictures under many names."""
    folder.mkdir()
    generator = np.random.default_rng(seed)
    pictures = [render_frame(_PROFILE, generator).image for _ in range(_PICTURES)]
    encoded = [cv2.imencode(".jpg", picture)[1].tobytes() for picture in pictures]
    for number in range(count + _WARM_UP_FRAMES):
        (folder / f"f{number:05d}.jpg").write_bytes(encoded[number % _PICTURES])
    return find_frames([folder])


@dataclass(frozen=True, slots=True)
class _Run:
    """Frames per second after the start of the workers; means per frame of the workers, and of this process."""

    rate: float
    busy_s: float
    cpu_s: float
    own_cpu_s: float


def _one_run(frames: list[PictureFile], out: Path, workers: int) -> _Run:
    finished: list[tuple[float, float]] = []
    run_batch(
        frames,
        _Timed(FrameRun(load_config())),
        out,
        workers=workers,
        restart=True,
        on_progress=lambda _: finished.append((time.perf_counter(), time.process_time())),
    )
    lines = (out / RESULTS_NAME).read_bytes().splitlines()[_WARM_UP_FRAMES:]
    records = [json.loads(line) for line in lines]
    wall, cpu = np.subtract(finished[-1], finished[_WARM_UP_FRAMES])
    return _Run(
        rate=len(records) / float(wall),
        busy_s=float(np.mean([record["busy_s"] for record in records])),
        cpu_s=float(np.mean([record["cpu_s"] for record in records])),
        own_cpu_s=float(cpu) / len(records),
    )


def run_scaling(count: int, workers: int, advance: Callable[[str], None] = lambda _: None) -> Scaling:
    """Take ``count`` simulated frames through workers and results, and take the run up again in three ways."""
    early: list[float] = []

    def watch(progress: BatchProgress) -> None:
        if not early and progress.finished >= _SIMULATED_SHARE * count:
            early.append(_memory_mb())

    with tempfile.TemporaryDirectory(prefix="circlecal-bench-") as name:
        out = Path(name)
        start = time.perf_counter()
        run_batch(_simulate(count), _Nothing(), out, workers=workers, total=count, on_progress=watch)
        seconds, late = time.perf_counter() - start, _memory_mb()
        advance("simulated")
        indexed = _resume(out)
        start = time.perf_counter()
        run_batch(_simulate(count), _Nothing(), out, workers=workers, total=count)
        skipped = time.perf_counter() - start
        taken = _memory_mb()
        advance("taken up")
        (out / INDEX_NAME).unlink()
        rebuilt = _resume(out)
        advance("index made anew")
        size = (out / RESULTS_NAME).stat().st_size / _MEGABYTE
    return Scaling(count, seconds, size, (early[0], late, taken), indexed, skipped, rebuilt)


def _simulate(count: int) -> Iterator[_Simulated]:
    return (_Simulated(f"match_{number:08d}") for number in range(count))


def _resume(out: Path) -> float:
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
