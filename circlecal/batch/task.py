"""What is done with each frame of a run, wherever it runs."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

from circlecal.formats.result import failed_record
from circlecal.results import Verdict

Record = dict[str, Any]


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

    def record(self, frame: F_contra) -> Record:
        """The finished frame's record; a :class:`circlecal.errors.CirclecalError` makes it an unreadable one."""


def failed(task: Task[F], frame: F, code: str, reason: str) -> Record:
    """Record of a frame that never reached the pipeline."""
    verdict = Verdict("refused", code, reason, "input")
    time_s = getattr(frame, "time_s", None)  # of a video
    return failed_record(frame.id, task.source(frame), verdict, task.seed, task.digest, time_s)
