"""Worker processes on this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import chain
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from circlecal import ONE_THREAD
from circlecal.batch.limits import limit_memory
from circlecal.batch.task import F, Named, Task, finish, limits_of, record_failure
from circlecal.errors import CirclecalError
from circlecal.records.log import Finished

_IN_FLIGHT_PER_WORKER = 2
"""Frames that are handed out: one in the works and one that waits, so that no worker idles and memory is small."""
_STARTS = 2
"""So often a pool is started before it is said that it cannot be."""
T = TypeVar("T")
R = TypeVar("R")


class WorkersError(CirclecalError):
    """Worker processes die, and it is not the frames that they die on."""


def cpu_count() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def finish_on_workers(frames: Iterator[F], task: Task[F], workers: int) -> Generator[Finished]:
    """Frames in the order in which they are finished; frames whose worker died are tried once more, each alone.

    Raises
    ------
    WorkersError
        Worker processes cannot be started at all.
    """
    suspects: list[F] = []
    for first in frames:  # a new pool for what is left when a worker died
        yield from _finish_in_pool(chain([first], frames), suspects, task, workers)
        for frame in suspects:
            died: list[F] = []
            yield from _finish_in_pool(iter([frame]), died, task, 1)
            if died:
                reason = "the worker process died on it (out of memory, far beyond the time limit, or a damaged file)"
                yield Finished.of(record_failure(task, frame, "worker_died", f"{task.source(frame)}: {reason}"))
        suspects.clear()


def map_on_workers(function: Callable[[T], R], arguments: Iterable[T], workers: int) -> Generator[R]:
    """``map(function, arguments)`` by worker processes, in the order of the arguments.

    Raises
    ------
    WorkersError
        One died.
    """
    executor = _executor(workers, None)
    try:
        with prepare_surroundings():
            futures = [executor.submit(function, argument) for argument in arguments]
        for future in futures:  # Executor.map would cancel them when closed, which its own thread stumbles over
            yield future.result()
    except BrokenProcessPool as error:
        executor.shutdown()
        raise WorkersError(
            "a worker process died (killed, or out of memory); run it again, with fewer --workers"
        ) from error
    except BaseException:
        _stop(executor)
        raise
    executor.shutdown()


def _executor(workers: int, task: Task[Any] | None) -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker, initargs=(task,))


def _finish_in_pool(frames: Iterator[F], died: list[F], task: Task[F], workers: int) -> Generator[Finished]:
    """Take frames until there are no more or a worker dies; those then in flight go to ``died``."""
    executor = _start_workers(workers, task)
    in_flight: dict[Future[Finished], F] = {}
    try:
        more = True
        while more or in_flight:
            while more and len(in_flight) < workers * _IN_FLIGHT_PER_WORKER:
                frame = next(frames, None)
                more = frame is not None
                if frame is not None and not _submit(executor, frame, in_flight):
                    died.extend((frame, *in_flight.values()))
                    executor.shutdown()
                    return
            if not in_flight:
                break
            for future in wait(in_flight, return_when=FIRST_COMPLETED).done:
                try:
                    finished = future.result()
                except BrokenProcessPool:
                    died.extend(in_flight.values())
                    executor.shutdown()
                    return
                del in_flight[future]
                yield finished
    except BaseException:
        _stop(executor)
        raise
    executor.shutdown()


def _submit(executor: ProcessPoolExecutor, frame: F, in_flight: dict[Future[Finished], F]) -> bool:
    """Hand a frame to the workers; False where one has died."""
    try:
        with prepare_surroundings():
            in_flight[executor.submit(_finish_in_worker, frame)] = frame
    except BrokenProcessPool:
        return False
    return True


def _start_workers(workers: int, task: Task[Any]) -> ProcessPoolExecutor:
    """A pool whose first worker has started, which tells one that cannot even start from one that died on a frame: what
    kills a worker once, such as a machine short of memory, need not do so again.

    Raises
    ------
    WorkersError
        It died twice.
    """
    for _ in range(_STARTS):
        executor = _executor(workers, task)
        try:
            with prepare_surroundings():
                started = executor.submit(os.getpid)
            started.result()
        except BrokenProcessPool:
            executor.shutdown()
        except BaseException:
            _stop(executor)
            raise
        else:
            return executor
    raise WorkersError(
        "worker processes die as they start (killed, or out of memory); run the same command again, with fewer "
        "--workers; a script that calls run_batch needs `if __name__ == '__main__':`"
    )


@contextlib.contextmanager
def prepare_surroundings() -> Iterator[None]:
    """What a worker inherits when it is started: no Ctrl-C (the parent ends it) and one thread for linear algebra."""
    with _hold_interrupt(), _one_thread():
        yield


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    threads = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in threads.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _hold_interrupt() -> Iterator[None]:
    """Hold a Ctrl-C back until the block ends; processes and threads started inside never get one.

    Ignoring it instead would lose it, and with it the user's wish to stop.
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or handler is None:  # only there it can be held
        yield
        return
    held: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: held.append(number))  # another thread may receive it
    if mask := getattr(signal, "pthread_sigmask", None):  # not on Windows
        resource_tracker.ensure_running()  # its start unblocks SIGINT in the thread that needs it first
        before = mask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, before)  # one that waited arrives here
        signal.signal(signal.SIGINT, handler)
        if held:
            signal.raise_signal(signal.SIGINT)


def _stop(executor: ProcessPoolExecutor) -> None:
    """End the workers at once, also those in the middle of a frame."""
    processes = list((executor._processes or {}).values())
    executor.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join()


_worker_task: Task[Any] | None = None


def _start_worker(task: Task[Any] | None) -> None:
    global _worker_task
    _worker_task = task
    if task is not None and (memory_mb := limits_of(task).memory_mb) is not None:
        limit_memory(memory_mb)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # on Windows nothing is inherited
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import cv2

    cv2.setNumThreads(1)


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _finish_in_worker(frame: Named) -> Finished:
    if _worker_task is None:
        raise RuntimeError("the worker was not started")
    return finish(_worker_task, frame, end_process=True)
