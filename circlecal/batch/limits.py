"""Limits of the time and the memory that one frame may take."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from collections.abc import Iterator
from pathlib import Path

STUCK_EXIT_CODE = 75
"""Of a process whose frame did not end: ``EX_TEMPFAIL`` of ``sysexits.h``."""


class TimeLimitError(BaseException):
    """A frame took longer than its limit; no ``except Exception`` on the way holds it up."""


@contextlib.contextmanager
def limit_time(seconds: float, end_process: bool = False) -> Iterator[None]:
    """Raise :class:`TimeLimitError` in this thread where the block takes longer than its limit.

    It is raised between two steps of Python. A library that does not come back to Python for as long again ends the
    process, where that is wanted.

    Parameters
    ----------
    seconds : float
        The limit.
    end_process : bool
        Whether this process may be ended: a worker's, whose frame is then a record.
    """
    lock, ended, over = threading.Lock(), threading.Event(), False
    thread = ctypes.c_ulong(threading.get_ident())

    def watch() -> None:
        if ended.wait(seconds):
            return
        with lock:
            if not over:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, ctypes.py_object(TimeLimitError))
        if end_process and not ended.wait(seconds):
            os._exit(STUCK_EXIT_CODE)

    threading.Thread(target=watch, daemon=True, name="time limit").start()
    try:
        yield
        with lock:  # from here on nothing is raised any more; what was raised before arrives inside this block
            over = True
    finally:
        over = True
        ended.set()


def limit_memory(megabytes: int) -> None:
    """Let this process take no more than this beyond what it has; what asks for more gets a ``MemoryError``.

    Only Linux counts what a process has taken for data; elsewhere there is no limit.
    """
    try:
        import resource

        taken = int(Path("/proc/self/status").read_text().partition("VmData:")[2].split()[0]) * 1024
        resource.setrlimit(resource.RLIMIT_DATA, (taken + (megabytes << 20), resource.RLIM_INFINITY))
    except (ImportError, OSError, ValueError, IndexError):
        return
