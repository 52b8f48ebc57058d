"""A long batch of small frames: do memory, open files and temporary files stay what they are?"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from circlecal.batch import BatchProgress, run_batch
from circlecal.batch.frames import FrameRun
from circlecal.config import load_config
from circlecal.pictures.files import PictureFile
from circlecal.synthetic.sampling import SceneProfile, render_frame

_WIDTH = 320
_PICTURES = 4
_WARM_UP_SHARE = 0.2
"""Of the frames, before which caches fill and allocators find their size."""
_PROFILE: SceneProfile = "easy"


@dataclass(frozen=True, slots=True)
class SoakReport:
    """What a long run took.

    Attributes
    ----------
    frames : int
        How many.
    rate : float
        Frames per second.
    memory_mb : (float, float)
        Resident memory of this process and its workers after the warm-up and at the end, each the mean over a tenth of
        the run.
    files : (int, int)
        Open files of the same processes at these times, the most of each.
    temporary : int
        Files left in the temporary folder.
    """

    frames: int
    rate: float
    memory_mb: tuple[float, float]
    files: tuple[int, int]
    temporary: int

    @property
    def growth(self) -> float:
        """Share by which the memory grew."""
        return self.memory_mb[1] / self.memory_mb[0] - 1.0


def run_soak(
    count: int, workers: int, seed: int, advance: Callable[[str], None] = lambda _: None, samples: int = 200
) -> SoakReport:
    """Calibrate ``count`` small frames, and look at the processes ``samples`` times.

    Parameters
    ----------
    count, workers, seed, samples : int
        Frames, worker processes, seed of the pictures, and how often.
    advance : callable
        Called after every frame.
    """
    with (
        tempfile.TemporaryDirectory(prefix="circlecal-soak-") as name,
        _temporary_folder(Path(name) / "tmp") as scratch,
    ):
        paths = _render(Path(name) / "frames", seed)
        frames = (PictureFile(f"f{n:06d}", paths[n % len(paths)], f"f{n:06d}") for n in range(count))
        every = max(1, count // samples)
        seen: list[tuple[int, float, int]] = []

        def look(progress: BatchProgress) -> None:
            if progress.finished % every == 0 and progress.finished:
                processes = [os.getpid(), *_workers()]
                memory = sum(map(_resident_mb, processes))
                seen.append((progress.finished, memory, sum(map(_open_files, processes))))
            advance(f"{progress.finished}")

        start = time.monotonic()
        run_batch(frames, FrameRun(load_config()), Path(name) / "out", workers=workers, total=count, on_progress=look)
        took = time.monotonic() - start
        left = sum(1 for _ in scratch.iterdir())
    warm = [s for s in seen if _WARM_UP_SHARE * count <= s[0] < (_WARM_UP_SHARE + 0.1) * count]
    last = [s for s in seen if 0.9 * count <= s[0] < count] or seen[-1:]
    memory = tuple(float(np.mean([m for _, m, _ in part])) for part in (warm or seen[:1], last))
    files = tuple(max(f for _, _, f in part) for part in (warm or seen[:1], last))
    return SoakReport(count, count / took, (memory[0], memory[1]), (files[0], files[1]), left)


def _render(folder: Path, seed: int) -> list[Path]:
    folder.mkdir()
    rng = np.random.default_rng(seed)
    paths = []
    for number in range(_PICTURES):
        picture = render_frame(_PROFILE, rng).image
        height = round(picture.shape[0] * _WIDTH / picture.shape[1])
        small = cv2.resize(picture, (_WIDTH, height), interpolation=cv2.INTER_AREA)
        path = folder / f"{number}.jpg"
        path.write_bytes(cv2.imencode(".jpg", small)[1].tobytes())
        paths.append(path)
    return paths


@contextmanager
def _temporary_folder(folder: Path) -> Iterator[Path]:
    """Let this process and its workers put temporary files into a folder of their own."""
    folder.mkdir()
    before, told = os.environ.get("TMPDIR"), tempfile.tempdir
    os.environ["TMPDIR"], tempfile.tempdir = str(folder), str(folder)
    try:
        yield folder
    finally:
        tempfile.tempdir = told
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before


def _workers() -> list[int]:
    """Processes that this one has started."""
    listed = Path(f"/proc/self/task/{os.getpid()}/children")
    return [int(pid) for pid in listed.read_text().split()] if listed.is_file() else []


def _resident_mb(pid: int) -> float:
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20)


def _open_files(pid: int) -> int:
    try:
        return len(os.listdir(f"/proc/{pid}/fd"))  # noqa: PTH208 - the names are all that is wanted
    except OSError:
        return 0
