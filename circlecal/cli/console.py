"""What the commands print: results on stdout, progress and logs on stderr; rich on a terminal, plain in a pipe."""

from __future__ import annotations

import contextlib
import csv
import io
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Protocol

from circlecal.errors import InterruptedCommandError
from circlecal.names import show, show_json

if TYPE_CHECKING:
    from rich.console import Console

    from circlecal.batch import BatchProgress
    from circlecal.records.summary import FrameSummary

_PLAIN_SECONDS = 5.0
_PLAIN_SHARE = 0.05
_PLAIN_SECONDS_MOST = 60.0
"""In a pipe the next line comes after 5 s, of a long run after a twentieth of the time so far, but after a minute."""
_NAMED = 3
"""So many frames are named beside what helps them."""
_COLOURS = {"calibrated": "green", "refused": "yellow"}


def configure_logging(*, quiet: bool = False, verbose: bool = False) -> None:
    """Log to stderr: warnings, everything with ``verbose``, errors only with ``quiet``."""
    from rich.logging import RichHandler

    logger = logging.getLogger("circlecal")
    logger.setLevel(logging.ERROR if quiet else logging.DEBUG if verbose else logging.WARNING)
    handler = RichHandler(console=stderr_console(), show_path=False, show_time=verbose, markup=False)
    handler.addFilter(_show_names)
    logger.handlers = [handler]


def _show_names(record: logging.LogRecord) -> bool:
    """Make the names in a log message harmless."""
    record.msg, record.args = "\n".join(map(show, record.getMessage().split("\n"))), None
    return True


def print_table(title: str | None, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a rich table on a terminal, lines with tabs in a pipe."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        if title:
            print(f"# {show(title)}")  # noqa: T201
        for cells in (columns, *rows):
            print("\t".join(map(show, cells)))  # noqa: T201
        return
    table = Table(title=title)
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(Text(show(cell), style=_COLOURS.get(cell, "")) for cell in row))
    console.print(table)


def print_line(text: str) -> None:
    """Print one line on stdout."""
    print(show(text))  # noqa: T201


def print_row(cells: Sequence[str], delimiter: str = ",") -> None:
    """Print a row of a CSV table on stdout: into a file or a pipe with its cells as they are, on a terminal with what
    would command it as escapes.
    """
    text = io.StringIO()
    # the line end of this writer is what it quotes in cells, so that a cell with one comes back as it was
    writer = csv.writer(text, delimiter=delimiter, lineterminator="\r\n")
    writer.writerow([show(cell) for cell in cells] if sys.stdout.isatty() else cells)
    print(text.getvalue().removesuffix("\r\n"))  # noqa: T201


def print_text(text: str) -> None:
    """Print a text of several lines on stdout."""
    for line in text.split("\n"):
        print_line(line)


def print_json(text: str) -> None:
    """Print JSON on stdout, in the characters that it can show."""
    encoding = (sys.stdout.encoding or "ascii").lower().replace("_", "-")
    print(show_json(text, only_ascii=not encoding.startswith("utf")))  # noqa: T201


def print_error(text: str) -> None:
    """Print one line on stderr, above a running progress bar."""
    stderr_console().print(f"circlecal: error: {show(text)}", soft_wrap=True, highlight=False, markup=False)


def print_note(text: str) -> None:
    """Print one line on stderr that is no error, such as where the results are."""
    stderr_console().print(f"circlecal: {show(text)}", soft_wrap=True, highlight=False, markup=False)


def error_reporter(failures: list[Exception]) -> Callable[[Exception], None]:
    """A function that prints an error as one line, and keeps it."""

    def report(error: Exception) -> None:
        print_error(str(error))
        failures.append(error)

    return report


@contextlib.contextmanager
def resumable(*, restart: bool) -> Iterator[None]:
    """While this lasts a Ctrl-C loses only the frames in the works, and says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedCommandError(f"the same command{' without --restart' if restart else ''} goes on") from None


def can_ask() -> bool:
    """Whether there is somebody at a terminal to answer."""
    return sys.stdin.isatty() and sys.stderr.isatty()


@cache
def stderr_console() -> Console:
    """The one console for stderr, so that lines and a running progress bar keep clear of each other."""
    from rich.console import Console

    return Console(stderr=True)


LEAST_COLUMNS = 70
"""Columns of a terminal below which frames are told in sentences: with names of sixteen letters the table would break
words in its last column.
"""


def print_summaries(summaries: Sequence[FrameSummary]) -> None:
    """Print one row per frame, pixels at 1920 px width, and what helps against the refusals: once for each reason, in a
    pipe in every row.
    """
    from rich.console import Console

    from circlecal.refusals import explain

    columns = ("id", "verdict", "case", "sigma px at 1920", "rms px at 1920", "reason")
    rows = [
        (s.id, s.status, number(s.case, 0), number(s.sigma_1920_px), number(s.rms_1920_px), s.reason or "")
        for s in summaries
    ]
    helps = [explain(s.code).help if s.code else "" for s in summaries]
    console = Console()
    if not console.is_terminal:
        print_table(None, (*columns, "what helps"), [(*row, text) for row, text in zip(rows, helps, strict=True)])
        return
    if console.width < LEAST_COLUMNS:
        for name, status, case, sigma, rms, reason in rows:
            sure = f"sigma {sigma} px, rms {rms} px at 1920 px width"
            told = f"{name}: {status}, case {case}, {sure}{': ' * bool(reason)}{reason}"
            console.print(show(told), highlight=False, markup=False)
    else:
        print_table(None, [name.replace(" at ", "\nat ") for name in columns], rows)
    for text in dict.fromkeys(filter(None, helps)):
        frames = [s.id for s, its in zip(summaries, helps, strict=True) if its == text]
        named = ", ".join(frames[:_NAMED]) + f" and {len(frames) - _NAMED} more" * (len(frames) > _NAMED)
        console.print(show(f"What helps ({named}): {text}"), highlight=False, markup=False)


def number(value: float | None, decimals: int = 2) -> str:
    """Text of a number that may be missing."""
    return "-" if value is None else f"{value:z.{decimals}f}"


class ProgressDisplay(Protocol):
    """Shows how far a run is: by the counts of its frames, or by the steps of another stage."""

    def __call__(self, state: BatchProgress) -> None:
        """Show the counts of frames."""

    def step(self, stage: str, done: int, total: int, unit: str = "frame") -> None:
        """Show how far another stage is: what is done, with how many of how many; of 0 where these are not counted."""


@contextlib.contextmanager
def progress_display(*, quiet: bool, stage: str = "") -> Iterator[ProgressDisplay]:
    """Show how far a run is: a bar with stage, rate and time left on a terminal, a line now and then in a pipe.

    ``stage`` names what is done with the frames that are counted.
    """
    console = stderr_console()
    if quiet:
        yield _Unseen()
    elif console.is_terminal:
        with _bar(console, stage) as update:
            yield _Shown(stage, update)
    else:
        yield _Shown(stage, _write_lines())


class _Unseen:
    def __call__(self, state: BatchProgress) -> None:
        pass

    def step(self, stage: str, done: int, total: int, unit: str = "frame") -> None:
        pass


class _Shown:
    """Tells a stage, its steps and their rate to what shows them."""

    def __init__(self, stage: str, update: _Update) -> None:
        self._stage, self._update = stage, update
        self._measure_rate = _pace()
        self._step_stage, self._began = "", 0.0

    def __call__(self, state: BatchProgress) -> None:
        rate = self._measure_rate(state)
        self._update(_Steps(self._stage, state.finished, state.total, "frame", _counts(state), rate))
        self._step_stage = ""

    def step(self, stage: str, done: int, total: int, unit: str = "frame") -> None:
        now = time.monotonic()
        if stage != self._step_stage or done == 0:
            self._step_stage, self._began = stage, now
        rate = done / (now - self._began) if now > self._began else 0.0
        self._update(_Steps(stage, done, total, unit, "", rate, is_goal=False))


@dataclass(frozen=True, slots=True)
class _Steps:
    """How far a stage is: done of a total of units, what is said of them, units per second, and whether these are what
    the whole run is for.
    """

    stage: str
    done: int
    total: int
    unit: str
    label: str
    rate: float
    is_goal: bool = True

    def words(self) -> str:
        """In one line."""
        counted = [f"{self.done}/{count_of(self.total, self.unit)}"] if self.total else []
        said = [*counted, *([show(self.label)] if self.label else [])]
        if self.rate > 0 and self.total:
            said += [f"{self.rate:.1f} {self.unit}s/s", _time_left(self.total - self.done, self.rate)]
        return f"{show(self.stage)}: {', '.join(said)}" if self.stage and said else show(self.stage) or ", ".join(said)


_Update = Callable[[_Steps], None]


def count_of(count: int, noun: str) -> str:
    """A number with its noun: ``1 frame``, ``2 frames``."""
    return f"{count} {noun}{'s' * (count != 1)}"


@contextlib.contextmanager
def _bar(console: Console, stage: str = "") -> Iterator[_Update]:
    from rich import progress as rich_progress

    bar = rich_progress.Progress(
        rich_progress.TextColumn("{task.fields[stage]}"),
        rich_progress.TextColumn("{task.fields[done]}"),
        rich_progress.BarColumn(),
        rich_progress.TextColumn("{task.fields[counts]}"),
        rich_progress.TextColumn("{task.fields[rate]}"),
        rich_progress.TextColumn("{task.fields[left]}"),
        console=console,
        transient=True,
    )
    with bar:
        task = bar.add_task("", total=None, stage=show(stage), done="", counts="", rate="", left="")

        def update(steps: _Steps) -> None:
            bar.update(
                task,
                total=steps.total or None,
                completed=steps.done,
                stage=show(steps.stage),
                done=f"{steps.done}/{count_of(steps.total, steps.unit)}" if steps.total else "",
                counts=show(steps.label),
                rate=f"{steps.rate:.1f} {steps.unit}s/s" if steps.rate > 0 else "",
                left=_time_left(steps.total - steps.done, steps.rate),
            )

        yield update


@contextlib.contextmanager
def count_steps(unit: str, total: int, *, quiet: bool = False, stage: str = "") -> Iterator[Callable[[str], None]]:
    """Show how far a run of ``total`` steps is; each call advances it by one and names what is worked on.

    ``unit`` names one step, in the singular, ``stage`` what is done.
    """
    console = stderr_console()
    start = time.monotonic()
    done = 0

    def advance(update: _Update, label: str) -> None:
        nonlocal done
        done += 1
        update(_Steps(stage, done, total, unit, label, done / max(time.monotonic() - start, 1e-9)))

    if quiet:
        yield lambda label: None
    elif console.is_terminal:
        with _bar(console, stage) as update:
            yield partial(advance, update)
    else:
        yield partial(advance, _write_lines())


def _time_left(steps: int, rate: float) -> str:
    if rate <= 0:
        return ""
    minutes, seconds = divmod(round(steps / rate), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d} left" if hours else f"{minutes}:{seconds:02d} left"


def _is_due(now: float, last: float, start: float) -> bool:
    """Whether a plain line may follow the last one."""
    return now - last >= min(max(_PLAIN_SECONDS, _PLAIN_SHARE * (now - start)), _PLAIN_SECONDS_MOST)


def _write_lines() -> _Update:
    """A line now and then, and one at the end."""
    start = last = time.monotonic()
    is_told = False

    def update(steps: _Steps) -> None:
        nonlocal last, is_told
        now = time.monotonic()
        is_end = steps.is_goal and steps.done == steps.total
        if (is_end and not is_told) or _is_due(now, last, start):
            last, is_told = now, is_end
            print(steps.words(), file=sys.stderr, flush=True)  # noqa: T201

    return update


def _pace() -> Callable[[BatchProgress], float]:
    """A function that tells frames per second since the first one was finished, and 0 until that is a second ago: what
    comes before it, such as the survey of a clip, is in no rate.
    """
    start: float | None = None
    first = 0

    def measure(state: BatchProgress) -> float:
        nonlocal start, first
        now = time.monotonic()
        if start is None and state.finished > state.resumed:
            start, first = now, state.finished
        return 0.0 if start is None or now - start < 1.0 else (state.finished - first) / (now - start)

    return measure


def _counts(state: BatchProgress) -> str:
    resumed = f" ({state.resumed} from before)" if state.resumed else ""
    return f"{state.calibrated} calibrated, {state.refused} refused{resumed}"
