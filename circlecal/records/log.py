"""The append-only file of results, and taking it up again."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from circlecal.errors import InputError
from circlecal.files import write_error
from circlecal.records.index import ResultIndex
from circlecal.records.record import result_line
from circlecal.records.summary import FrameSummary, summarise

RESULTS_NAME = "results.jsonl"
INDEX_NAME = "results.index"
_APPEND = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
_SYNC_SECONDS = 1.0
_ROWS_AT_ONCE = 1000

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Finished:
    """A finished frame as a worker hands it over: written out there, so that the one who collects has little to do.

    Attributes
    ----------
    line : bytes
        Its line of ``results.jsonl``.
    row : FrameSummary
        Its row of ``summary.csv``.
    digest : str
        Of everything that the answer depends on beside the frame.
    """

    line: bytes
    row: FrameSummary
    digest: str

    @classmethod
    def of(cls, record: dict[str, Any]) -> Self:
        """From a record."""
        line = (result_line(record) + "\n").encode("utf-8", "backslashreplace")  # names need not be text
        return cls(line, summarise(record), str(record.get("config_digest")))


class OtherRunError(InputError):
    """The folder holds results of another configuration or other inputs; nothing was changed in it."""


class ResultLog:
    """``results.jsonl`` and ``results.index`` of a folder, held by one run at a time.

    Parameters
    ----------
    folder : Path
        Where; made where it is missing.
    restart : bool
        Drop what it holds.

    Raises
    ------
    InputError
        The folder cannot be written to, or another run writes to it.
    """

    def __init__(self, folder: Path, restart: bool = False) -> None:
        self.path = folder / RESULTS_NAME
        self._synced = time.monotonic()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(self.path, _APPEND, 0o666)
        except FileExistsError as error:
            raise InputError(f"{folder}: is a file, not a folder; choose another --out") from error
        except OSError as error:
            raise write_error(self.path, error) from error
        try:
            self._lock()
            self.index = ResultIndex(folder / INDEX_NAME)
            if restart:
                os.ftruncate(self._descriptor, 0)
                self.index.clear()
        except BaseException:
            os.close(self._descriptor)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.index.close()
        with contextlib.suppress(OSError):
            os.fsync(self._descriptor)
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

    def take_up(self, digest: str) -> None:
        """Bring the index up to the file, after cutting off a torn last line.

        Raises
        ------
        OtherRunError
            Results of another configuration.
        InputError
            A damaged line before the last.
        """
        covered, known = self.index.covered()
        if not self._ends_a_line(covered):
            self.index.clear()
            covered, known = 0, None
        if known is not None:
            self._require(known, digest)
        rows: list[FrameSummary] = []
        end = covered
        for start, line in self._lines(covered):
            row = self._read(start, line, digest)
            if row is None:
                os.ftruncate(self._descriptor, start)
                break
            end = start + len(line)
            rows.append(row)
            if len(rows) >= _ROWS_AT_ONCE:
                self.index.add(rows, end, digest)
                rows.clear()
        self.index.add(rows, end, digest)
        self.index.commit()

    def _ends_a_line(self, position: int) -> bool:
        if position == 0:
            return True
        with self.path.open("rb") as file:
            file.seek(position - 1)
            return file.read(1) == b"\n"

    def _read(self, start: int, line: bytes, digest: str) -> FrameSummary | None:
        """Row of a line; None for a torn last one."""
        whole = line.endswith(b"\n")
        try:
            record = json.loads(line)
            row = summarise(record)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if whole:
                number = self._line_number(start)
                hint = "mend or remove that line, or start over with --restart"
                raise InputError(f"{self.path}, line {number}: is no result; {hint}") from error
            _log.warning("%s: cutting off the torn last line", self.path)
            return None
        if not whole:
            return None
        self._require(str(record.get("config_digest")), digest)
        return row

    def _line_number(self, start: int) -> int:
        return 1 + sum(1 for position, _ in self._lines(0) if position < start)

    def _require(self, found: str, digest: str) -> None:
        if found != digest:
            raise OtherRunError(
                f"{self.path}: holds results of another configuration or other inputs ({found}, now {digest}); "
                "use another --out, or start over with --restart"
            )

    def _lines(self, start: int) -> Iterator[tuple[int, bytes]]:
        with self.path.open("rb") as file:
            file.seek(start)
            for line in file:
                yield start, line
                start += len(line)

    def append(self, finished: Finished) -> None:
        """Write one line; it outlives this process at once, and the machine after a second at most.

        Raises
        ------
        InputError
            The disk is full or the like; the file ends with the last whole line.
        """
        line = finished.line
        size = os.fstat(self._descriptor).st_size
        now = time.monotonic()
        try:
            written = 0
            while written < len(line):
                written += os.write(self._descriptor, line[written:])
            if now - self._synced >= _SYNC_SECONDS:
                os.fsync(self._descriptor)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, size)
            raise write_error(self.path, error) from error
        self.index.add([finished.row], size + len(line), finished.digest)
        if now - self._synced >= _SYNC_SECONDS:
            self.index.commit()
            self._synced = now
