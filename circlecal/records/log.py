"""The append-only file of results, taking it up again, and reading the records of a run from wherever they lie."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import sqlite3
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, overload

from circlecal.errors import InputError
from circlecal.files import (
    folder_error,
    is_file,
    is_folder,
    list_folder,
    lock_file,
    read_file,
    read_lines,
    remove_left_over,
    replacement,
    write_error,
)
from circlecal.records.index import ResultIndex
from circlecal.records.json_text import (
    GIVE_A_RESULT,
    Record,
    is_record,
    parse_record,
    require_single_keys,
    result_line,
)
from circlecal.records.record import ResultRecord, ResultRow
from circlecal.records.summary import FrameSummary, summarise

RESULTS_NAME = "results.jsonl"
INDEX_NAME = "results.index"
_APPEND = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
_SYNC_SECONDS = 1.0
_ROWS_AT_ONCE = 1000
_MEND = "mend or remove it, or run the same command again"
_MEND_LINE = "mend or remove that line, or start the run over with --restart"
_GIVE = "give the folder that circlecal batch, track or calibrate wrote"

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
    def of(cls, record: ResultRecord) -> Self:
        """From a record."""
        return cls((result_line(record) + "\n").encode(), summarise(record), str(record.config_digest))


START_OVER = "use another --out, or start over with --restart"
"""What helps where a folder holds another run."""


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
            raise folder_error(folder, error) from error
        except OSError as error:
            raise write_error(self.path, error) from error
        status = os.fstat(self._descriptor)
        self._identity = status.st_dev, status.st_ino
        try:
            self._lock()
            remove_left_over(folder)
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
            lock_file(self._descriptor)
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
        covered, known = self.index.read_coverage()
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

    def drop(self, frame_ids: Collection[str]) -> None:
        """Take frames out, so that they are calibrated again; whatever happens, the file is the old or the new one.

        Raises
        ------
        InputError
            The file cannot be written, or another run took it meanwhile.
        """
        self._rewrite(dict.fromkeys(frame_ids, b""))

    def replace(self, frames: Collection[Finished]) -> None:
        """Put other lines in the place of those of some frames; whatever happens, the file is the old or the new one.

        Raises
        ------
        InputError
            The file cannot be written, or another run took it meanwhile.
        """
        self._rewrite({frame.row.id: frame.line for frame in frames})

    def _rewrite(self, lines: Mapping[str, bytes]) -> None:
        """Write the file anew with these lines in the place of those of their frames."""
        self.require_in_place()
        with replacement(self.path) as temporary, temporary.open("wb") as file:
            for _, line in self._lines(0):
                name = json.loads(line)["id"] if line.endswith(b"\n") else None
                file.write(lines.get(name, line) if name is not None else line)
            file.flush()
            os.fsync(file.fileno())
        os.close(self._descriptor)
        self._descriptor = os.open(self.path, _APPEND, 0o666)
        status = os.fstat(self._descriptor)
        self._identity = status.st_dev, status.st_ino
        self._lock()
        self.index.clear()

    def _ends_a_line(self, position: int) -> bool:
        if position == 0:
            return True
        with self.path.open("rb") as file:
            file.seek(position - 1)
            return file.read(1) == b"\n"

    def _read(self, start: int, line: bytes, digest: str) -> FrameSummary | None:
        """Row of a line; None for a torn last one."""
        if not line.endswith(b"\n"):
            _log.warning("%s: cutting off the torn last line", self.path)
            return None
        try:
            require_single_keys(line, "")
            record = parse_record(line, ResultRow, "", _MEND_LINE)
        except InputError as error:
            raise InputError(f"{self.path}, line {self._line_number(start)}{error}") from error
        self._require(str(record.config_digest), digest)
        return summarise(record)

    def _line_number(self, start: int) -> int:
        return 1 + sum(1 for position, _ in self._lines(0) if position < start)

    def _require(self, found: str, digest: str) -> None:
        if found != digest:
            raise OtherRunError(
                f"{self.path}: holds results of another configuration or other inputs ({found}, now {digest}); "
                "use another --out, or start over with --restart"
            )

    def _lines(self, start: int) -> Iterator[tuple[int, bytes]]:
        for line in read_lines(self.path, start):
            yield start, line
            start += len(line)

    def append(self, finished: Finished) -> None:
        """Write one line, which outlives this process at once. Lines are forced to the disk with the first that is
        written a second or more after those before it, and when the run ends: a machine that loses its power loses what
        its system still holds of the last ones.

        Raises
        ------
        InputError
            The disk is full or the like; the file ends with the last whole line.
        """
        line = finished.line
        size = os.fstat(self._descriptor).st_size
        now = time.monotonic()
        self.require_in_place()
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
        try:
            self.index.add([finished.row], size + len(line), finished.digest)
            if now - self._synced >= _SYNC_SECONDS:
                self.index.commit()
                self._synced = now
        except sqlite3.Error as error:  # the line itself is written; the index is made anew from it
            raise write_error(self.path.with_name(INDEX_NAME), error) from error

    @property
    def is_in_place(self) -> bool:
        """Whether the file that is written to is still the one of its name."""
        try:
            found = self.path.stat()
        except OSError:
            return False
        return (found.st_dev, found.st_ino) == self._identity

    def require_in_place(self) -> None:
        """See that the results are where they will be looked for.

        Raises
        ------
        InputError
            The file or its folder was removed, renamed or replaced meanwhile.
        """
        if not self.is_in_place:
            raise InputError(
                f"{self.path}: was removed, renamed or replaced during the run, and its {len(self.index)} results with "
                "it; move it back, or run the same command again to calibrate these frames anew"
            )


@dataclass(frozen=True, slots=True)
class Place:
    """Where a record stands: a file, its line (0 for a whole file), and the bytes of it."""

    file: Path
    line: int
    start: int
    length: int

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}" if self.line else str(self.file)

    def read(self) -> bytes:
        """The record's text."""
        with self.file.open("rb") as file:
            file.seek(self.start)
            return file.read(self.length)


def is_log(path: Path) -> bool:
    """Whether a file is the ``results.jsonl`` of a batch, by its first line; one without a line by its name."""
    if path.suffix != ".jsonl":
        return False
    try:
        first = next(read_lines(path), None)
    except InputError:
        return False
    return path.name == RESULTS_NAME if first is None else bool(is_record(first))


def leave_out_copies(files: Sequence[Path]) -> list[Path]:
    """The files without those that lie beside or below the ``results.jsonl`` of a run: its frames in other formats, and
    runs that were made of it, as that of its rig.
    """
    runs = {path.parent for path in files if path.name == RESULTS_NAME}
    return [path for path in files if runs.isdisjoint(path.parents[1 if path.name == RESULTS_NAME else 0 :])]


def find_results(path: Path) -> list[Path]:
    """The files of a run: its ``results.jsonl``, else the result files of the folder, else the one file that is named.

    Raises
    ------
    InputError
        There is none, or the folder cannot be read.
    """
    if not is_folder(path):
        return [path]
    log = path / RESULTS_NAME
    files = [log] if is_file(log) else [file for file in list_folder(path) if file.suffix == ".json"]
    if not files:
        raise InputError(f"{path}: holds no {RESULTS_NAME} and no result files; {_GIVE}")
    return files


def holds_result_files(folder: Path) -> bool:
    """Whether a folder, which need not be there, holds a result file that can be read."""
    try:
        return is_folder(folder) and next(read_records(folder, ResultRow), None) is not None
    except InputError:
        return False


@overload
def read_records(path: Path) -> Iterator[ResultRecord]: ...


@overload
def read_records(path: Path, model: type[Record]) -> Iterator[Record]: ...


def read_records(path: Path, model: type[ResultRow] = ResultRecord) -> Iterator[ResultRow]:
    """Records of a run, one at a time; parameters and errors as :func:`scan_records`."""
    return (record for _, record in scan_records(path, model))


def scan_records(path: Path, model: type[Record]) -> Iterator[tuple[Place, Record]]:
    """Records of a run and where each stands, one at a time.

    In a folder of files those that are no results are passed over; a torn last line of a run that goes on is left out.

    Parameters
    ----------
    path : path
        Folder of a run, a ``results.jsonl``, or a result file.
    model : type
        How much is read of each: :class:`ResultRecord` or :class:`ResultRow`.

    Raises
    ------
    InputError
        Nothing there, or damaged, with file and line.
    """
    for file in find_results(path):
        if file.suffix == ".jsonl":
            yield from _scan_log(file, model)
            continue
        try:
            content = read_file(file)
        except InputError as error:
            raise InputError(f"{error}; {_GIVE}") from error
        if file == path or is_record(content) is not False:
            mend = GIVE_A_RESULT if file == path else _MEND
            yield Place(file, 0, 0, len(content)), parse_record(content, model, str(file), mend)


def _scan_log(log: Path, model: type[Record]) -> Iterator[tuple[Place, Record]]:
    start = 0
    for number, line in enumerate(read_lines(log), start=1):
        place = Place(log, number, start, len(line))
        start += len(line)
        if line.endswith(b"\n"):
            yield place, parse_record(line, model, str(place), _MEND_LINE)
        else:
            _log.warning("%s: left out the torn last line", log)
