"""Many frames: worker processes, append-only results, resume; one bad frame never stops the rest.

``results.jsonl`` has one line per finished frame, each flushed to the disk before the next frame is counted, so killing
a run loses at most the frames in flight; a line torn by a kill or a full disk is cut off when the run is resumed.
``summary.csv`` is rewritten from it as a whole.
"""

from __future__ import annotations

import contextlib
import json
import logging
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from circlecal.config import Config, config_digest
from circlecal.errors import CirclecalError, InputError
from circlecal.formats.atomic import write_error
from circlecal.formats.images import Frame
from circlecal.formats.result import failed_record, result_line
from circlecal.formats.summary import FrameSummary, summarise, write_summary
from circlecal.results import Verdict

RESULTS_NAME = "results.jsonl"
SUMMARY_NAME = "summary.csv"
_IN_FLIGHT_PER_WORKER = 2
_APPEND = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class BatchProgress:
    """How far a batch is: frames in all, finished before this run and in this run, and the verdicts of them all."""

    total: int
    resumed: int = 0
    finished: int = 0
    calibrated: int = 0
    refused: int = 0
    unreadable: int = 0
    last: FrameSummary | None = field(default=None)

    def count(self, summary: FrameSummary) -> None:
        """Take a frame into the counts."""
        self.last = summary
        self.finished += 1
        self.calibrated += summary.status == "calibrated"
        self.refused += summary.status != "calibrated"
        self.unreadable += summary.code == "unreadable_input"


def run_batch(
    frames: Sequence[Frame],
    config: Config,
    out: Path,
    *,
    workers: int,
    mask: Path | None = None,
    restart: bool = False,
    frame_files: bool = False,
    on_progress: Callable[[BatchProgress], None] = lambda progress: None,
) -> BatchProgress:
    """Calibrate many frames in worker processes.

    Parameters
    ----------
    frames : sequence of Frame
        The frames, with unique ids.
    config : Config
        Options.
    out : path
        Folder of ``results.jsonl`` and ``summary.csv``; frames that it already holds are skipped.
    workers : int
        Number of processes, each with one thread.
    mask : path, optional
        Mask folder; otherwise masks are looked for beside the frames.
    restart : bool
        Start over: drop what the folder holds.
    frame_files : bool
        Also write a result file and pictures per frame, as ``circlecal calibrate`` does.
    on_progress : callable
        Called after the start and after every frame, in this process.

    Returns
    -------
    BatchProgress
        The final counts, resumed frames included.

    Raises
    ------
    InputError
        The folder holds results of another configuration, is in use by another run, is damaged, or cannot be written;
        whatever was written before stays and is taken up again.
    """
    digest = config_digest(config)
    with ResultLog(out, restart) as log:
        finished = log.finished(digest)
        wanted = {frame.id for frame in frames}
        progress = BatchProgress(total=len(frames))
        for summary in finished.values():
            if summary.id in wanted:
                progress.count(summary)
        progress.resumed = progress.finished
        on_progress(progress)
        rows = dict(finished)
        task = _Task(config, out if frame_files else None, mask, digest)
        try:
            open_frames = [frame for frame in frames if frame.id not in finished]
            with contextlib.closing(_records(open_frames, task, workers)) as records:
                for record in records:
                    log.append(record)
                    rows[record["id"]] = summarise(record)
                    progress.count(rows[record["id"]])
                    on_progress(progress)
        finally:
            write_summary(out / SUMMARY_NAME, rows)
    return progress


class ResultLog:
    """The append-only ``results.jsonl`` of a folder, held by one run at a time."""

    def __init__(self, folder: Path, restart: bool = False) -> None:
        self.path = folder / RESULTS_NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(self.path, _APPEND, 0o666)
        except FileExistsError as error:
            raise InputError(f"{folder}: is a file, not a folder; choose another --out") from error
        except OSError as error:
            raise write_error(self.path, error) from error
        try:
            self._lock()
            if restart:
                os.ftruncate(self._descriptor, 0)
        except BaseException:
            os.close(self._descriptor)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        os.close(self._descriptor)

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:  # not on Windows
            return
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{self.path}: another run is writing to it; wait for it or use another --out") from error

    def finished(self, digest: str) -> dict[str, FrameSummary]:
        """Summaries by id of the frames in the file, after cutting off a torn last line.

        Raises
        ------
        InputError
            A damaged line before the last, or results of another configuration.
        """
        found: dict[str, FrameSummary] = {}
        for number, (start, line) in enumerate(self._lines(), start=1):
            try:
                record = json.loads(line)
                summary = summarise(record)
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                if line.endswith(b"\n"):
                    hint = "mend or remove that line, or start over with --restart"
                    raise InputError(f"{self.path}, line {number}: is no result; {hint}") from error
                _log.warning("%s: cutting off the torn last line", self.path)
                os.ftruncate(self._descriptor, start)
                break
            if not line.endswith(b"\n"):
                os.ftruncate(self._descriptor, start)
                break
            if record.get("config_digest") != digest:
                other = record.get("config_digest")
                raise InputError(
                    f"{self.path}: holds results of another configuration ({other}, now {digest}); "
                    "use another --out, or start over with --restart"
                )
            found[summary.id] = summary
        return found

    def _lines(self) -> Iterator[tuple[int, bytes]]:
        start = 0
        with self.path.open("rb") as file:
            for line in file:
                yield start, line
                start += len(line)

    def append(self, record: dict[str, Any]) -> None:
        """Write one line and wait until the disk has it.

        Raises
        ------
        InputError
            The disk is full or the like; the file ends with the last whole line.
        """
        line = (result_line(record) + "\n").encode()
        size = os.fstat(self._descriptor).st_size
        try:
            written = 0
            while written < len(line):
                written += os.write(self._descriptor, line[written:])
            os.fsync(self._descriptor)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, size)
            raise write_error(self.path, error) from error


@dataclass(frozen=True, slots=True)
class _Task:
    """What a worker needs beside the frame; ``out`` only where it writes files per frame."""

    config: Config
    out: Path | None
    mask: Path | None
    digest: str


def _records(frames: Sequence[Frame], task: _Task, workers: int) -> Generator[dict[str, Any]]:
    """Records in the order in which they are finished; frames whose worker died are tried once more, each alone."""
    suspects: list[Frame] = []
    waiting = deque(frames)
    while waiting:
        yield from _pooled(waiting, suspects, task, min(workers, len(waiting)))
    for frame in suspects:
        alone, died = deque([frame]), list[Frame]()
        yield from _pooled(alone, died, task, 1)
        if died:
            reason = f"{frame.path}: the worker process died on it (out of memory, or a damaged file)"
            yield _failed(frame, "worker_died", reason, task)


def _failed(frame: Frame, code: str, reason: str, task: _Task) -> dict[str, Any]:
    verdict = Verdict("refused", code, reason, "input")
    return failed_record(frame.id, str(frame.path), verdict, task.config.seed, task.digest)


def _pooled(waiting: deque[Frame], died: list[Frame], task: _Task, workers: int) -> Generator[dict[str, Any]]:
    """Take frames from ``waiting`` until it is empty or a worker dies; the frames then in flight go to ``died``."""
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker, initargs=(task,))
    in_flight: dict[Future[dict[str, Any]], Frame] = {}
    try:
        _require_workers(executor)
        while waiting or in_flight:
            try:
                while waiting and len(in_flight) < workers * _IN_FLIGHT_PER_WORKER:
                    with _worker_surroundings():
                        in_flight[executor.submit(_calibrate_in_worker, waiting[0])] = waiting[0]
                    waiting.popleft()
                for future in wait(in_flight, return_when=FIRST_COMPLETED).done:
                    record = future.result()
                    del in_flight[future]
                    yield record
            except BrokenProcessPool:
                died.extend(in_flight.values())
                break
    except BaseException:
        _stop(executor)
        raise
    executor.shutdown()


def _require_workers(executor: ProcessPoolExecutor) -> None:
    """Tell a worker that cannot even start from one that died on a frame."""
    try:
        with _worker_surroundings():
            started = executor.submit(os.getpid)
        started.result()
    except BrokenProcessPool as error:
        raise RuntimeError(
            "worker processes cannot start; a script that calls run_batch needs `if __name__ == '__main__':`"
        ) from error


@contextlib.contextmanager
def _worker_surroundings() -> Iterator[None]:
    """What a worker inherits when it is started: no Ctrl-C (the parent ends it) and one thread for linear algebra."""
    threads = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    in_main_thread = threading.current_thread() is threading.main_thread()
    interrupt = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main_thread else None
    os.environ.update(dict.fromkeys(threads, "1"))
    try:
        yield
    finally:
        for name, value in threads.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if in_main_thread:
            signal.signal(signal.SIGINT, interrupt)


def _stop(executor: ProcessPoolExecutor) -> None:
    """End the workers at once, also those in the middle of a frame."""
    processes = list((executor._processes or {}).values())
    executor.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join()


_worker_task: _Task | None = None


def _start_worker(task: _Task) -> None:
    global _worker_task
    _worker_task = task
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import cv2

    cv2.setNumThreads(1)


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _calibrate_in_worker(frame: Frame) -> dict[str, Any]:
    from circlecal.api import calibrate_frame, field_template, write_outputs
    from circlecal.formats.result import result_record

    task = _worker_task
    if task is None:
        raise RuntimeError("the worker was not started")
    try:
        image, calibration = calibrate_frame(frame, task.config, task.mask)
    except CirclecalError as error:
        return _failed(frame, "unreadable_input", str(error), task)
    except Exception as error:  # noqa: BLE001 - one bad frame never stops the rest
        _log.exception("%s: internal error", frame.path)
        return _failed(frame, "internal_error", f"{frame.path}: {type(error).__name__}: {error}", task)
    if task.out is None:
        return result_record(calibration, field_template(task.config))
    return write_outputs(image, calibration, task.config, task.out)
