"""What is done with each frame of a run, wherever it runs."""

from __future__ import annotations

import logging
from typing import Any, Protocol, TypeVar

from circlecal.batch.limits import TimeLimitError, limit_time
from circlecal.errors import CirclecalError, OutputError
from circlecal.pictures.limits import DEFAULT_LIMITS, LimitsConfig
from circlecal.records.log import Finished
from circlecal.records.record import ResultRecord
from circlecal.records.writing import failure_record
from circlecal.results import Verdict

_log = logging.getLogger(__name__)
FAILED_CODES = frozenset({"unreadable_input", "time_limit", "out_of_memory", "worker_died", "internal_error"})
"""Of frames that never reached the end of the pipeline."""
_NO_MEMORY = "Insufficient memory"
"""How OpenCV says it."""


class Named(Protocol):
    """Anything with the id that its record will have."""

    @property
    def id(self) -> str:
        """Unique in a run."""


F = TypeVar("F", bound=Named)
F_contra = TypeVar("F_contra", bound=Named, contravariant=True)


class Task(Protocol[F_contra]):
    """Calibrating a frame, or what stands for it in a test; picklable, and it may run in any process."""

    @property
    def digest(self) -> str:
        """Digest of everything but the frame that can change its record; stands in every record."""

    @property
    def seed(self) -> int:
        """Seed of the random draws; stands in every record."""

    def source(self, frame: F_contra) -> str:
        """File of a frame, for messages and records."""

    def record(self, frame: F_contra) -> ResultRecord:
        """The finished frame's record; a :class:`circlecal.errors.CirclecalError` makes it an unreadable one."""


def limits_of(task: Task[Any]) -> LimitsConfig:
    """The limits of a task; the usual ones where it has none of its own."""
    limits: LimitsConfig = getattr(task, "limits", DEFAULT_LIMITS)
    return limits


def finish(task: Task[F], frame: F, end_process: bool = False) -> Finished:
    """Do what is to be done with a frame, also with one that cannot be read or on which we make a mistake.

    A frame that takes too long or too much memory is a record too; ``end_process`` as of
    :func:`circlecal.batch.limits.limit_time`.

    Raises
    ------
    OutputError
        What belongs to the frame cannot be written: it is not finished, and the next start takes it up.
    """
    seconds = limits_of(task).frame_seconds
    try:
        with limit_time(seconds, end_process):
            return Finished.of(task.record(frame))
    except TimeLimitError:
        reason = f"{task.source(frame)}: took longer than {seconds:g} s; raise limits.frame_seconds, or scale it down"
        return Finished.of(record_failure(task, frame, "time_limit", reason))
    except OutputError:
        raise
    except CirclecalError as error:
        return Finished.of(record_failure(task, frame, "unreadable_input", str(error)))
    except OSError as error:
        reason = f"{task.source(frame)}: cannot be read: {error.strerror or error}"
        return Finished.of(record_failure(task, frame, "unreadable_input", reason))
    except Exception as error:  # noqa: BLE001 - one bad frame never stops the rest
        if isinstance(error, MemoryError) or _NO_MEMORY in str(error):
            limit = limits_of(task).memory_mb
            told = "the machine has" if limit is None else f"its limit of {limit} MB (limits.memory_mb)"
            reason = f"{task.source(frame)}: takes more memory than {told}; scale it down, or use fewer workers"
            return Finished.of(record_failure(task, frame, "out_of_memory", reason))
        _log.exception("%s: internal error", task.source(frame))
        reason = f"{task.source(frame)}: {type(error).__name__}: {error}"
        return Finished.of(record_failure(task, frame, "internal_error", reason))


def record_failure(task: Task[F], frame: F, code: str, reason: str) -> ResultRecord:
    """Record of a frame that never reached the pipeline."""
    verdict = Verdict("refused", code, reason, "input")
    time_s = getattr(frame, "time_s", None)  # of a video
    return failure_record(frame.id, task.source(frame), verdict, task.seed, task.digest, time_s)
