"""Thousands of damaged files for every reader and command: no traceback, no hang, no gigabyte, no wrong exit code."""

from __future__ import annotations

import faulthandler
import os
import shutil
import signal
import tempfile
import time
import traceback
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from circlecal.errors import CirclecalError
from circlecal.evaluation.bench.fuzz_readers import Command, Reader, WrongExitError, readers
from circlecal.evaluation.bench.mutation import damage, draw_name

HANG_S = 30.0
MOST_MB = 1000.0
_STUCK_S = 120.0
"""A reader that does not even come back to Python for so long ends the process, with its stack on stderr."""


class HangError(BaseException):
    """A reader took longer than :data:`HANG_S`."""


@dataclass(slots=True)
class FuzzRow:
    """What one reader made of its damaged files.

    Attributes
    ----------
    name : str
        The reader.
    inputs, read, refused : int
        Files; those that were taken as sound, and those that were refused in one line.
    tracebacks, hangs, over_memory, wrong_exits : int
        What must not happen.
    slowest_s, most_mb : float
        Longest time of a file, and most memory that one added.
    examples : list of str
        Number and last line of each file where something of that kind happened.
    """

    name: str
    inputs: int = 0
    read: int = 0
    refused: int = 0
    tracebacks: int = 0
    hangs: int = 0
    over_memory: int = 0
    wrong_exits: int = 0
    slowest_s: float = 0.0
    most_mb: float = 0.0
    examples: list[str] = field(default_factory=list)

    @property
    def failures(self) -> int:
        """Files where something happened that must not."""
        return self.tracebacks + self.hangs + self.over_memory + self.wrong_exits


def add_rows(name: str, rows: Sequence[FuzzRow]) -> FuzzRow:
    """What all readers together made of their files, without examples."""
    total = FuzzRow(name)
    for count in ("inputs", "read", "refused", "tracebacks", "hangs", "over_memory", "wrong_exits"):
        setattr(total, count, sum(getattr(row, count) for row in rows))
    total.slowest_s, total.most_mb = max(row.slowest_s for row in rows), max(row.most_mb for row in rows)
    return total


def run_fuzz(
    count: int,
    seed: int,
    command: Command | None,
    only: str = "",
    keep: Path | None = None,
    advance: Callable[[str], None] = lambda _: None,
) -> list[FuzzRow]:
    """Damage ``count`` files, each drawn from ``default_rng([seed, number])``, and let the readers read them in turn.

    Parameters
    ----------
    count, seed : int
        How many, and the seed.
    command : callable or None
        Runs a command line in this process; None leaves the commands out.
    only : str
        Part of the names of the readers that are wanted.
    keep : path, optional
        Folder for the files where something happened that must not.
    advance : callable
        Called with the reader's name after each file.
    """
    known = [reader for reader in readers(command) if only in reader.name and reader.seeds()]
    rows = {reader.name: FuzzRow(reader.name) for reader in known}
    turns = _turns(known)
    with tempfile.TemporaryDirectory(prefix="circlecal-fuzz-") as name:
        for number in range(count):
            reader = next(turns)
            folder = Path(name) / "one"
            folder.mkdir()
            path = _write_damage(reader, np.random.default_rng([seed, number]), folder)
            row = rows[reader.name]
            before = row.failures
            _read(reader, path, folder / "out", row, number)
            if keep is not None and row.failures > before:
                keep.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, keep / f"{number:06d}{path.suffix}")
            shutil.rmtree(folder, ignore_errors=True)
            advance(reader.name)
    return list(rows.values())


def _turns(known: list[Reader]) -> Iterator[Reader]:
    """The readers in turn, for ever."""
    turn = 0
    while True:
        turn += 1
        yield from (reader for reader in known if turn % reader.every == 0)


def _write_damage(reader: Reader, rng: np.random.Generator, folder: Path) -> Path:
    seeds = reader.seeds()
    chosen = seeds[int(rng.integers(len(seeds)))]
    path = folder / draw_name(chosen.suffix, rng)
    path.write_bytes(damage(chosen.content, rng))
    return path


def _read(reader: Reader, path: Path, out: Path, row: FuzzRow, number: int) -> None:
    """Let a reader read a file, and take what happens into its row."""
    row.inputs += 1
    memory = _Memory()
    start = time.monotonic()
    try:
        with _time_limit():
            reader.read(path, out)
        row.read += 1
    except CirclecalError as error:
        row.refused += 1
        said = str(error).replace(str(path), "").strip()
        if "\n" in said and not reader.name.startswith("circlecal"):
            row.wrong_exits += 1
            row.examples.append(f"{number}: more than one line: {said[:200]!r}")
    except HangError:
        row.hangs += 1
        row.examples.append(f"{number}: hangs")
    except WrongExitError as error:
        row.wrong_exits += 1
        row.examples.append(f"{number}: {error}")
    except Exception as error:  # noqa: BLE001 - every error that is none of ours is what is looked for
        row.tracebacks += 1
        where = traceback.extract_tb(error.__traceback__)[-1]
        row.examples.append(f"{number}: {type(error).__name__}: {str(error)[:200]} ({where.filename}:{where.lineno})")
    row.slowest_s = max(row.slowest_s, time.monotonic() - start)
    added = memory.growth_mb()
    row.most_mb = max(row.most_mb, added)
    if added > MOST_MB:
        row.over_memory += 1
        row.examples.append(f"{number}: {added:.0f} MB")


@contextmanager
def _time_limit() -> Iterator[None]:
    def stop(number: int, frame: types.FrameType | None) -> None:
        raise HangError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, HANG_S)
    faulthandler.dump_traceback_later(_STUCK_S, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class _Memory:
    """How far the resident memory of this process rises above what it was; 0 where the system does not tell."""

    def __init__(self) -> None:
        self._before = self._value("VmRSS")
        try:
            Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
        except OSError:
            self._before = float("inf")

    def growth_mb(self) -> float:
        return max(0.0, (self._value("VmHWM") - self._before) / 1024)

    def _value(self, key: str) -> float:
        try:
            text = Path("/proc/self/status").read_text()
        except OSError:
            return 0.0
        return float(text.partition(f"{key}:")[2].split()[0])


def is_supported() -> bool:
    """Whether this system has the timer that ends a hang."""
    return hasattr(signal, "setitimer") and os.name == "posix"
