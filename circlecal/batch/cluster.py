"""A run on a Dask cluster: frames on shared storage, results streamed back to the one process that writes.

The scheduler is one that runs already (``tcp://host:port``; Dask's own deployers start it by SSH, on Kubernetes, under
SLURM) or one for this machine (``local:N``). Every task carries what it needs, so nothing is lost with a worker but the
frames that it was working on, and those are given to another.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import queue
import re
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

from circlecal import __version__
from circlecal.batch.task import F, Named, Task, finish, limits_of, record_failure
from circlecal.batch.workers import prepare_surroundings
from circlecal.errors import InputError, MissingExtraError
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.records.log import Finished

if TYPE_CHECKING:
    from distributed import Client

_IN_FLIGHT_PER_THREAD = 2
_CONNECT_SECONDS = 10
_WORKER_SECONDS = 120
_RECOUNT_SECONDS = 5.0
_LOOK_SECONDS = 1.0
"""While nothing is finished, so often the workers are looked for."""
_ADDRESS = re.compile(r"tcp://(\[[0-9A-Fa-f:.]+\]|[^\s:/@\[\]]+):[0-9]{1,5}")
_LOCAL = re.compile(r"local:([1-9][0-9]{0,3})")

_log = logging.getLogger(__name__)
T = TypeVar("T")
R = TypeVar("R")


def finish_on_cluster(frames: Iterator[F], task: Task[F], scheduler: str) -> Generator[Finished]:
    """Frames in the order in which they are finished.

    Parameters
    ----------
    frames, task : iterator, Task
        As for :func:`circlecal.batch.run_batch`; not more than a few frames per worker are under way.
    scheduler : str
        ``tcp://host:port``, or ``local:N`` for N processes on this machine.

    Raises
    ------
    MissingExtraError
        Dask's distributed is not installed.
    InputError
        The scheduler cannot be reached, has no workers, or is lost; or circlecal there is another version.
    """
    with _connect(scheduler) as client:
        yield from _stream(client, frames, task, scheduler)


def map_on_cluster(function: Callable[[T], R], arguments: Sequence[T], scheduler: str) -> Generator[R]:
    """``map(function, arguments)`` on a cluster, in the order of the arguments; a few of them are under way at a time.

    Raises
    ------
    MissingExtraError, InputError
        As :func:`finish_on_cluster`, or several workers die on an argument.
    """
    from distributed import KilledWorker

    with _connect(scheduler) as client:
        waiting: deque[Any] = deque()
        patience = _Patience(client, scheduler, DEFAULT_LIMITS.server_seconds)
        rest = iter(arguments)
        more = True
        while more or waiting:
            room = max(1, sum(client.nthreads().values())) * _IN_FLIGHT_PER_THREAD
            while more and len(waiting) < room:
                argument = next(rest, None)
                more = argument is not None
                if argument is not None:
                    waiting.append(client.submit(function, argument, pure=False))
            if not waiting:
                return
            try:
                found: R = _await(waiting.popleft(), patience)
            except KilledWorker as error:
                died = "several workers died on the same part (out of memory, or a damaged file)"
                raise InputError(f"--scheduler {scheduler}: {died}; run the same command again to go on") from error
            yield found


@contextlib.contextmanager
def _connect(scheduler: str) -> Iterator[Client]:
    """A client with at least one worker."""
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("distributed", "distributed") from error
    lost_errors = (OSError, distributed.client.FutureCancelledError)
    with contextlib.ExitStack() as stack:
        cluster = _local_cluster(scheduler, stack)
        _leave_errors_to_us()
        try:
            client = distributed.Client(cluster or scheduler, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            hint = "start it with `dask scheduler`, or use local:N"
            raise InputError(f"--scheduler {scheduler}: cannot be reached ({_first_line(error)}); {hint}") from error
        try:
            _require_workers(client, scheduler)
            yield client
        except lost_errors as error:
            lost = f"--scheduler {scheduler}: the connection was lost ({_first_line(error)})"
            raise InputError(f"{lost}; run the same command again to go on") from error
        finally:
            client.close(timeout=_CONNECT_SECONDS)


def _leave_errors_to_us() -> None:
    """Dask logs every lost connection with a traceback; here it becomes one line."""
    if not _log.isEnabledFor(logging.DEBUG):
        loud = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
        for name in ("asyncio", *loud):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _local_cluster(scheduler: str, stack: contextlib.ExitStack) -> Any:
    """Scheduler and workers of this machine for ``local:N``, ended with the stack; None for an address."""
    if _ADDRESS.fullmatch(scheduler):
        return None
    count = _LOCAL.fullmatch(scheduler)
    if count is None:
        wanted = "must be local:N with the number of workers, or tcp://host:port"
        raise InputError(f"--scheduler {scheduler}: {wanted}")
    import dask
    from distributed import LocalCluster

    # Dask leaves its folder behind
    scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="circlecal-dask-", ignore_cleanup_errors=True))
    stack.enter_context(dask.config.set({"temporary-directory": scratch}))
    with prepare_surroundings():
        cluster = LocalCluster(
            n_workers=int(count[1]),
            threads_per_worker=1,
            dashboard_address=None,
            # without one its page about health asks for Dask's usual port, and says so where another run has that
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL,
            local_directory=scratch,
            host="127.0.0.1",
        )
    return stack.enter_context(cluster)


def _require_workers(client: Client, scheduler: str) -> None:
    """Wait for the first worker, and see that it runs this version."""
    try:
        client.wait_for_workers(1, timeout=_WORKER_SECONDS)
    except TimeoutError as error:
        waited = f"no worker in {_WORKER_SECONDS} s"
        raise InputError(f"--scheduler {scheduler}: {waited}; start some with `dask worker`") from error
    # by eval, since a function of this package could not even be unpickled where the package is missing
    versions = client.run(eval, "__import__('circlecal').__version__", on_error="return")
    for address, version in versions.items():
        if version != __version__:
            there = "has no circlecal" if isinstance(version, Exception) else f"has circlecal {version}"
            raise InputError(f"--scheduler {scheduler}: worker {address} {there}, not {__version__}; install it")


def _stream(client: Client, frames: Iterator[F], task: Task[F], scheduler: str) -> Generator[Finished]:
    """Keep each worker's queue short, and hand on what is finished."""
    packed = pickle.dumps(task)
    patience = _Patience(client, scheduler, limits_of(task).server_seconds)
    done: queue.SimpleQueue[Any] = queue.SimpleQueue()
    in_flight: dict[Any, tuple[F, Any]] = {}
    room, counted = 0, -_RECOUNT_SECONDS
    more = True
    while more or in_flight:
        if time.monotonic() - counted >= _RECOUNT_SECONDS:  # workers come and go
            room, counted = max(1, sum(client.nthreads().values())) * _IN_FLIGHT_PER_THREAD, time.monotonic()
        while more and len(in_flight) < room:
            frame = next(frames, None)
            more = frame is not None
            if frame is not None:
                future = client.submit(_finish_on_worker, frame, packed, pure=False)
                in_flight[future.key] = frame, future  # Dask forgets a task whose future nobody holds
                future.add_done_callback(done.put)
        if not in_flight:
            return
        try:
            future = done.get(timeout=_LOOK_SECONDS)
        except queue.Empty:
            patience.look()
        else:
            yield _result(future, in_flight.pop(future.key)[0], task, patience)


def _await(future: Any, patience: _Patience) -> Any:
    """The result of a future, also of a finished one: what it found may have been lost with its worker."""
    while True:
        try:
            return future.result(timeout=_LOOK_SECONDS)
        except TimeoutError:
            if future.status == "error":  # the function's own
                raise
            patience.look()


class _Patience:
    """Looks after workers and scheduler while nothing is finished, and loses patience when they stay away."""

    def __init__(self, client: Client, scheduler: str, seconds: float) -> None:
        self._client, self._scheduler, self._seconds = client, scheduler, seconds
        self._alone_since: float | None = None

    def look(self) -> None:
        """See that there are a scheduler and workers.

        Raises
        ------
        InputError
            There have been none for too long.
        """
        running = self._client.status == "running"
        if running and self._client.nthreads():
            self._alone_since = None
            return
        what = "all workers are lost" if running else "the scheduler is lost"
        now = time.monotonic()
        if self._alone_since is None:
            self._alone_since = now
            _log.warning("--scheduler %s: %s; waiting %g s for them", self._scheduler, what, self._seconds)
        if now - self._alone_since > self._seconds:
            mend = "start some with `dask worker` and run the same command again to go on"
            raise InputError(f"--scheduler {self._scheduler}: {what}, and none came in {self._seconds:g} s; {mend}")


def _result(future: Any, frame: F, task: Task[F], patience: _Patience) -> Finished:
    from distributed import KilledWorker

    try:
        finished: Finished = _await(future, patience)
        return finished
    except KilledWorker as error:
        _log.info("%s: %s", task.source(frame), error)
        reason = "several workers died on it (out of memory, or a damaged file)"
        return Finished.of(record_failure(task, frame, "worker_died", f"{task.source(frame)}: {reason}"))


def _finish_on_worker(frame: Named, packed: bytes) -> Finished:
    return finish(_unpack(packed), frame)


@lru_cache(maxsize=4)
def _unpack(packed: bytes) -> Task[Any]:
    import cv2

    cv2.setNumThreads(1)
    task: Task[Any] = pickle.loads(packed)
    return task


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
