"""One run over many frames: what is finished already, what the workers bring, what the folder holds in the end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from circlecal.batch.learning import LearnedRun, learn_from
from circlecal.batch.task import FAILED_CODES, F, Task
from circlecal.pictures.files import PictureFile
from circlecal.pictures.remote import is_url
from circlecal.pictures.video import clip_of
from circlecal.records.index import ResultIndex
from circlecal.records.log import Finished, ResultLog, read_records
from circlecal.records.parts import SourceRecord
from circlecal.records.record import ResultRow
from circlecal.records.sources import require_own
from circlecal.records.summary import write_summary

SUMMARY_NAME = "summary.csv"
FIRST_ROWS = 10_000
"""Frames that a folder holds, the first ones, whose files are compared with those that are given: another folder's
pictures differ from the first one on.
"""
FEWEST_AT_ONCE, SHARE_AT_ONCE = 200, 0.1
"""Frames that were calibrated again, and share of the run's, that are written to the results together, since the whole
file is written anew."""


@dataclass(slots=True)
class BatchProgress:
    """How far a batch is: frames in all, finished before this run and in this run, and the verdicts of them all.

    ``total`` is an estimate where the frames come from a video; ``learnt`` are those of the calibrated ones that were
    refused until the others of the run told them something.
    """

    total: int
    resumed: int = 0
    finished: int = 0
    calibrated: int = 0
    refused: int = 0
    unreadable: int = 0

    learnt: int = 0

    def count(self, status: str, code: str | None) -> None:
        """Take a frame into the counts."""
        self.finished += 1
        self.calibrated += status == "calibrated"
        self.refused += status != "calibrated"
        self.unreadable += code == "unreadable_input"
        self.total = max(self.total, self.finished)

    def count_again(self, before: str, after: str) -> None:
        """Move a frame from one verdict to another."""
        self.calibrated += (after == "calibrated") - (before == "calibrated")
        self.refused = self.finished - self.calibrated
        self.learnt += after == "calibrated" and before != "calibrated"


def run_batch(
    frames: Iterable[F],
    task: Task[F],
    out: Path,
    *,
    workers: int,
    scheduler: str | None = None,
    total: int | None = None,
    restart: bool = False,
    annotations: Mapping[str, str | None] | None = None,
    masks: Mapping[str, str] | None = None,
    on_progress: Callable[[BatchProgress], None] = lambda progress: None,
    on_again: Callable[[int, int], None] = lambda done, total: None,
) -> BatchProgress:
    """Calibrate many frames in worker processes or on a cluster.

    Parameters
    ----------
    frames : iterable of frames
        With unique ids; taken one after the other as workers become free, so a generator need not end soon.
    task : Task
        What is done with each, such as :class:`circlecal.batch.frames.FrameRun`.
    out : path
        Folder of ``results.jsonl``, ``results.index`` and ``summary.csv``; frames that it already holds are skipped.
    workers : int
        Number of processes, each with one thread.
    scheduler : str, optional
        Instead of ``workers``: address of a Dask scheduler, or ``local:N``; see :mod:`circlecal.batch.cluster`.
    total : int, optional
        How many frames are expected, where ``frames`` has no length.
    restart : bool
        Start over: drop what the folder holds.
    annotations : mapping, optional
        Digests of annotations by the id of their frame, None where nobody annotated it: frames that were finished with
        another one are calibrated again.
    masks : mapping, optional
        Masks beside pictures by the id of their frame, as :func:`circlecal.batch.frames.label_masks` tells them: frames
        that were finished with another one are calibrated again.
    on_progress : callable
        Called after the start and after every frame, in this process.
    on_again : callable
        Called with how many of how many refused frames were calibrated again, by what the others tell.

    Returns
    -------
    BatchProgress
        The final counts, resumed frames included.

    Raises
    ------
    OtherRunError
        The folder holds results of another configuration.
    InputError
        The folder is in use by another run, is damaged, or cannot be written, or the scheduler cannot be reached or
        is lost; whatever was written before stays and is taken up again.
    """
    with ResultLog(out, restart) as log:
        log.take_up(task.digest)
        _drop_frames(log, task.digest, {row.id for row in log.index.rows() if row.code in FAILED_CODES})
        _drop_frames(log, task.digest, _find_old_frames(log.index, annotations or {}, masks or {}))
        expected = len(frames) if isinstance(frames, Sized) else total or 0
        progress = BatchProgress(total=expected)
        waiting = _skip_finished(_require_own(frames, task, log), log.index, progress, on_progress)
        try:
            with contextlib.closing(_finish_frames(waiting, task, workers, scheduler)) as finished:
                for frame in finished:
                    log.append(frame)
                    progress.count(frame.row.status, frame.row.code)
                    on_progress(progress)
                log.require_in_place()
            again = learn_from(task, read_records(log.path, ResultRow))
            if again is not None:
                _calibrate_again(log, again, workers, scheduler, progress, on_again)
                on_progress(progress)
        finally:
            if log.is_in_place:  # a folder that was moved away does not come back empty
                write_summary(out / SUMMARY_NAME, log.index.rows())
        progress.total = progress.finished
    return progress


def _calibrate_again(
    log: ResultLog,
    task: LearnedRun,
    workers: int,
    scheduler: str | None,
    progress: BatchProgress,
    on_again: Callable[[int, int], None],
) -> None:
    """Calibrate refused frames with what the others agree on, and put the new lines in the place of the old ones.

    What is finished stays, whatever ends the run.
    """
    total = sum(task.lesson_of(row) is not None for row in read_records(log.path, ResultRow))
    frames = task.choose(read_records(log.path))
    done: list[Finished] = []

    def write() -> None:
        if done:
            log.replace(done)
            log.take_up(task.digest)
            done.clear()

    try:
        with contextlib.closing(_finish_frames(frames, task, workers, scheduler)) as finished:
            for count, frame in enumerate(finished, start=1):
                on_again(count, total)
                before = log.index.find(frame.row.id)
                if before is None or frame.row.code in FAILED_CODES:  # it keeps its first record
                    continue
                progress.count_again(before[0], frame.row.status)
                done.append(frame)
                if len(done) >= max(FEWEST_AT_ONCE, SHARE_AT_ONCE * len(log.index)):
                    write()
    finally:
        if log.is_in_place:
            write()


def _find_old_frames(index: ResultIndex, annotations: Mapping[str, str | None], masks: Mapping[str, str]) -> set[str]:
    """The frames that were calibrated with another annotation or another mask beside their picture than there is now;
    those of older versions, of which no mask is known, stay.
    """
    used, seen = index.annotations(), index.masks()
    changed = {name for name, now in annotations.items() if now != used.get(name)}
    changed |= {name for name, now in masks.items() if now != seen.get(name, now)}
    return {name for name in changed if index.find(name) is not None}


def _drop_frames(log: ResultLog, digest: str, names: Collection[str]) -> None:
    """Take frames out, so that they are done again: those that never reached the end of the pipeline too, whose file or
    limits may have been mended since.
    """
    if names:
        log.drop(names)
        log.take_up(digest)


def _require_own(frames: Iterable[F], task: Task[F], log: ResultLog) -> Iterator[F]:
    """The frames, of which none has the name of another one among the first that the folder holds.

    A picture that the folder holds under another name, since others of its name were not yet given, keeps that. Videos
    are compared with all that the folder holds of their names, once.

    Raises
    ------
    OtherRunError
        One has: its file is still there, and is another one, or it has changed.
    """
    folder, is_taken_up = log.path.parent, len(log.index) > 0
    clips: dict[str, list[SourceRecord]] | None = None
    first = islice(read_records(log.path, ResultRow), FIRST_ROWS) if is_taken_up else ()
    rows = {row.id: row.source for row in first if row.source is not None and row.source.path is not None}
    pictures = {_place(row.path): name for name, row in rows.items() if row.time_s is None and row.path is not None}
    for frame in frames:
        row, source = rows.get(frame.id), task.source(frame)
        if isinstance(frame, PictureFile) and frame.time_s is not None:
            if clips is None:
                clips = _read_clips(log.path) if is_taken_up else {}
            for before in clips.pop(clip_of(frame.id), ()):
                require_own(before, source, folder, "frames")
        elif row is not None:
            require_own(row, source, folder, "the result")
        elif isinstance(frame, PictureFile) and _place(source) in pictures:
            frame = replace(frame, id=pictures[_place(source)])
        yield frame


def _read_clips(results: Path) -> dict[str, list[SourceRecord]]:
    """What the records of each video, by its name, say of their file; mostly all say one thing."""
    found: dict[str, dict[tuple[str | None, int | None], SourceRecord]] = {}
    for row in read_records(results, ResultRow):
        if row.source is not None and row.source.time_s is not None:
            found.setdefault(clip_of(row.id), {})[row.path, row.source.bytes] = row.source
    return {name: list(sources.values()) for name, sources in found.items()}


def _place(path: str) -> str:
    """A picture by its whole path, or its URL."""
    return path if is_url(path) else str(Path(path).absolute())


def _skip_finished(
    frames: Iterable[F], index: ResultIndex, progress: BatchProgress, on_progress: Callable[[BatchProgress], None]
) -> Iterator[F]:
    """Frames without a record; the others are counted as they are met."""
    before = len(index) > 0
    shown = False
    for frame in frames:
        found = index.find(frame.id) if before else None
        if found is None:
            if not shown:
                on_progress(progress)
            shown = True
            yield frame
        else:
            progress.count(*found)
            progress.resumed += 1
    if not shown:
        on_progress(progress)


def _finish_frames(frames: Iterator[F], task: Task[F], workers: int, scheduler: str | None) -> Generator[Finished]:
    if scheduler is None:
        from circlecal.batch.workers import finish_on_workers

        return finish_on_workers(frames, task, workers)
    from circlecal.batch.cluster import finish_on_cluster

    return finish_on_cluster(frames, task, scheduler)
