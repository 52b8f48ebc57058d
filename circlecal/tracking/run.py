"""A run over clips: a survey of each, then every frame, appended to the results as it is finished.

A clip is worked on in stretches, so the answers are the same however many processes work on them, and after a stop.
Records are written in the order of time, clip after clip: the last one tells how far a run has come.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from circlecal.batch import SUMMARY_NAME, BatchProgress
from circlecal.batch.workers import WorkersError
from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.files import is_file
from circlecal.pictures.video import Video, clip_of, frame_time
from circlecal.pipeline import field_of
from circlecal.records.cameras_table import CAMERAS_NAME, write_cameras
from circlecal.records.json_text import GIVE_A_RESULT, parse_record
from circlecal.records.log import Finished, Place, ResultLog, read_records, scan_records
from circlecal.records.parts import SourceRecord
from circlecal.records.record import ResultRecord, ResultRow
from circlecal.records.sources import require_own
from circlecal.records.summary import write_summary
from circlecal.rig.tripod import PLACE, Venue
from circlecal.rig.venue import VENUE_NAME, read_venue, read_venue_file, write_venue
from circlecal.tracking.stretches import (
    ClipRun,
    OnMissing,
    Stretch,
    StretchResult,
    Tracked,
    list_frames,
    number_shot,
    stretches_of,
    survey_video,
    track_alone,
    track_stretch,
)
from circlecal.tracking.survey_steps import UNTOLD, OnStep, SurveySteps

_log = logging.getLogger(__name__)
T = TypeVar("T")
R = TypeVar("R")
_Sources = dict[tuple[str | None, int | None], SourceRecord]
"""What the frames of a clip say of its file, by its path and size; mostly all say one thing."""


@dataclass(slots=True)
class TrackReport:
    """What a run brought: the counts of frames, and the venue of each clip by its name."""

    progress: BatchProgress
    venues: dict[str, Venue] = field(default_factory=dict)


def run_track(
    videos: Sequence[Video],
    run: ClipRun,
    out: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    restart: bool = False,
    on_progress: Callable[[BatchProgress], None] = lambda progress: None,
    on_survey: Callable[[str], None] = lambda name: None,
    on_step: OnStep = UNTOLD.on_step,
    on_note: Callable[[str], None] = _log.warning,
    on_error: Callable[[Exception], None] = lambda error: None,
) -> TrackReport:
    """Find the cameras of clips, and track every frame.

    Parameters
    ----------
    videos : sequence of Video
        The clips, with different names.
    run : ClipRun
        How.
    out : path
        Folder of ``results.jsonl``, ``summary.csv``, ``cameras.csv`` and a venue file per clip; what it already holds
        is not done again.
    workers : int
        Number of processes; where there is one stretch only, this process does everything.
    scheduler : str, optional
        Instead of ``workers``: address of a Dask scheduler, or ``local:N``.
    restart : bool
        Start over: drop what the folder holds.
    on_progress, on_survey, on_step, on_note, on_error : callables
        Called after every frame with the counts; with the name of each clip whose cameras are looked for; with how far
        that is, as :data:`circlecal.tracking.survey_steps.OnStep` says, or with how many of the clips it is finished
        where other processes do it; with one line about what a clip lacks, once for each clip; and with the error of a
        clip that cannot be worked on, while the others go on.

    Raises
    ------
    OtherRunError
        The folder holds results of another configuration.
    InputError
        The folder is in use by another run, is damaged, or cannot be written, or a process died, or the scheduler
        cannot be reached or is lost; what was written before stays and is taken up again.
    """
    with ResultLog(out, restart) as log:
        log.take_up(run.digest)
        report = TrackReport(BatchProgress(total=sum(video.estimate_count(run.sampling) for video in videos)))
        ends_s: dict[str, float] = {}
        for row in log.index.rows():
            report.progress.count(row.status, row.code)
            report.progress.resumed += 1
            clip = clip_of(row.id)
            ends_s[clip] = max(ends_s.get(clip, 0.0), frame_time(row.id))
        shots, sources = _read_clips(out)
        for video in videos:
            for source in sources.get(video.name, {}).values():
                require_own(source, video.path, out, "frames")
        paths = {video.name: _venue_path(out, video, len(videos) == 1, restart) for video in videos}
        parts = {
            video.name: stretches_of(video, run, list_frames(video, run), ends_s.get(video.name)) for video in videos
        }
        try:
            before = {} if restart else _venues_before(videos, paths, run)
            with contextlib.closing(
                _surveys(videos, parts, before, run, paths, workers, scheduler, on_survey, on_step)
            ) as surveys:
                for video, venue in surveys:
                    if isinstance(venue, Venue):
                        report.venues[video.name] = venue
                    else:
                        on_error(InputError(venue))
            known = [(part, venue) for name, venue in report.venues.items() for part in parts[name]]
            on_progress(report.progress)
            writer = _Writer(log, shots, report.progress, on_progress)
            _track_all(known, run, workers, scheduler, writer, on_note, on_error)
            log.require_in_place()
        except WorkersError as error:
            died = "a worker process died (out of memory, or a damaged file)"
            raise InputError(f"{died}; run the same command again to go on, or with --workers 1") from error
        finally:
            if log.is_in_place:
                write_summary(out / SUMMARY_NAME, log.index.rows())
                write_cameras(out / CAMERAS_NAME, records_in_order(out))
        report.progress.total = report.progress.finished
    return report


def _venue_path(out: Path, video: Video, is_alone: bool, restart: bool) -> Path:
    """The venue file of a clip: ``venue.yaml``, and with its name before it where there are several clips, or where
    another clip has that file.
    """
    plain, own = out / VENUE_NAME, out / f"{video.name}.{VENUE_NAME}"
    if not is_alone:
        return own
    try:
        clip = read_venue_file(plain).clip if is_file(plain) and not restart else None
    except InputError:  # it is written again
        clip = None
    return plain if clip in (None, video.name) else own


def _read_clips(out: Path) -> tuple[dict[str, int], dict[str, _Sources]]:
    """Of each clip in the results by its name: the last shot, and the file."""
    shots: dict[str, int] = {}
    sources: dict[str, _Sources] = {}
    for row in read_records(out, ResultRow):
        if row.track is not None and row.source is not None:
            clip = clip_of(row.id)
            shots[clip] = row.track.shot
            sources.setdefault(clip, {})[row.path, row.source.bytes] = row.source
    return shots, sources


def records_in_order(results: Path) -> Iterator[ResultRecord]:
    """Records of a run by clip and time, one at a time in memory.

    Raises
    ------
    InputError
        They are damaged.
    """
    places: list[tuple[str, Place]] = [(row.id, place) for place, row in scan_records(results, ResultRow)]
    for _, place in sorted(places, key=lambda entry: entry[0]):
        yield parse_record(place.read(), ResultRecord, str(place), GIVE_A_RESULT)


def tripod_facts(venue: Venue, template: FieldTemplate) -> Iterator[dict[str, Any]]:
    """Of each camera of a venue: name, frames that determined it, where its pan axis stands (mean and standard
    deviation by axis, metres), and the size of the pitch and its standard deviations, metres.
    """
    for tripod in venue.tripods:
        sds = np.sqrt(np.diag(tripod.whole_covariance))
        at = {f"{axis}_m": PLACE[f"axis_{axis}"] for axis in "xyz"}
        place = {name: [float(tripod.mean[k]), float(sds[k])] for name, k in at.items()}
        pitch = np.array([template.length_m, template.width_m]) + tripod.growth_m
        pitch_sd = sds[[PLACE["length"], PLACE["breadth"]]]
        size = {"pitch_m": pitch.tolist(), "pitch_sd_m": pitch_sd.tolist()}
        yield {"camera": tripod.name, "frames": len(tripod.used), **place, **size}


class _Writer:
    """Appends frames to the results, with their shots counted over each whole clip, from the last one of each clip by
    its name that is written: a clip that could not be read to its end goes on after others were finished.
    """

    def __init__(
        self,
        log: ResultLog,
        shots: dict[str, int],
        progress: BatchProgress,
        on_progress: Callable[[BatchProgress], None],
    ) -> None:
        self._log, self._shots, self._progress, self._on_progress = log, shots, progress, on_progress

    def write(self, tracked: Tracked) -> None:
        """Append a frame, unless it is written already."""
        record = tracked.record
        if self._log.index.find(record.id) is not None:
            return
        clip = clip_of(record.id)
        before = self._shots.get(clip)
        shot = self._shots[clip] = 0 if before is None else before + tracked.is_cut
        record = number_shot(record, shot)
        self._log.append(Finished.of(record))
        self._progress.count(record.status, record.code)
        self._on_progress(self._progress)


def _surveys(
    videos: Sequence[Video],
    parts: dict[str, list[Stretch]],
    before: Mapping[str, Venue],
    run: ClipRun,
    paths: Mapping[str, Path],
    workers: int,
    scheduler: str | None,
    on_survey: Callable[[str], None],
    on_step: OnStep,
) -> Generator[tuple[Video, Venue | str]]:
    """The venue of each clip, or why there is none; those that were found before are not looked for again."""
    todo = []
    for video in videos:
        if video.name in before:
            yield video, before[video.name]
        elif parts[video.name]:
            on_survey(video.name)
            todo.append(video)
    for video, found in zip(todo, _survey_all(todo, run, workers, scheduler, on_step), strict=True):
        if isinstance(found, Venue):
            write_venue(paths[video.name], found, field_of(run.config)[0], run.digest, video.name, video.bytes)
        yield video, found


def _survey_all(
    videos: Sequence[Video], run: ClipRun, workers: int, scheduler: str | None, on_step: OnStep
) -> Iterator[Venue | str]:
    """The venues of clips, in order."""
    if scheduler is None and (workers == 1 or len(videos) == 1):
        for video in videos:
            yield survey_video(run, video, _name_steps(f"{video.name}: " if len(videos) > 1 else "", on_step))
        return
    elsewhere = _map(partial(survey_video, run), videos, workers, scheduler)
    yield from SurveySteps(on_step).count("clips whose cameras are found", elsewhere, len(videos))


def _name_steps(name: str, on_step: OnStep) -> OnStep:
    """Tells the steps of a clip with its name before them."""
    return lambda stage, done, total: on_step(name + stage, done, total)


def _venues_before(videos: Sequence[Video], paths: Mapping[str, Path], run: ClipRun) -> dict[str, Venue]:
    """The venues of clips, by their names, that this run found before it was stopped."""
    found = {video.name: _read_venue(paths[video.name], run, video) for video in videos}
    return {clip: venue for clip, venue in found.items() if venue is not None}


def _read_venue(path: Path, run: ClipRun, video: Video) -> Venue | None:
    """The venue of a clip that this run wrote before; None where there is none, or one of another run or clip, or of
    this clip before it was replaced or written to its end.
    """
    if not is_file(path):
        return None
    try:
        stored = read_venue_file(path)
        is_of_clip = stored.clip == video.name and stored.clip_bytes in (None, video.bytes)
        if stored.config_digest == run.digest and is_of_clip:
            return read_venue(path, field_of(run.config)[0])
    except InputError as error:
        _log.warning("%s; it is written again", error)
    return None


def _track_all(
    known: Sequence[tuple[Stretch, Venue]],
    run: ClipRun,
    workers: int,
    scheduler: str | None,
    writer: _Writer,
    on_note: Callable[[str], None],
    on_error: Callable[[Exception], None],
) -> None:
    """Track stretches, and write their frames in order."""
    told: set[str] = set()
    failed: set[str] = set()

    def on_missing(video: Video, text: str) -> None:
        if video.name not in told:
            on_note(text)
        told.add(video.name)

    def readable(frames: Iterator[Tracked], name: str) -> Iterator[Tracked]:
        try:
            yield from frames
        except InputError as error:
            failed.add(name)
            on_error(error)

    with contextlib.closing(_stretch_frames(known, run, workers, scheduler, on_missing)) as parts:
        for stretch, frames in parts:
            name = stretch.video.name
            if name in failed:  # what follows would leave a gap, and the run could not be taken up
                continue
            for tracked in readable(frames, name):
                writer.write(tracked)


def _stretch_frames(
    known: Sequence[tuple[Stretch, Venue]],
    run: ClipRun,
    workers: int,
    scheduler: str | None,
    on_missing: OnMissing,
) -> Generator[tuple[Stretch, Iterator[Tracked]]]:
    """The frames of each stretch, as they are tracked in this process, or as other processes bring them."""
    if scheduler is None and (workers == 1 or len(known) < 2):
        for stretch, venue in known:
            yield stretch, track_stretch(run, stretch, venue, on_missing)
        return
    for (stretch, _), result in zip(known, _map(partial(track_alone, run), known, workers, scheduler), strict=True):
        yield stretch, _frames_of(result, stretch, on_missing)


def _frames_of(result: StretchResult, stretch: Stretch, on_missing: OnMissing) -> Iterator[Tracked]:
    yield from result.frames
    if result.missing is not None:
        on_missing(stretch.video, result.missing)
    if result.error is not None:
        raise InputError(result.error)


def _map(function: Callable[[T], R], arguments: Sequence[T], workers: int, scheduler: str | None) -> Generator[R]:
    """``map(function, arguments)``, in this process or in others."""
    if scheduler is not None:
        from circlecal.batch.cluster import map_on_cluster

        yield from map_on_cluster(function, arguments, scheduler)
    elif workers > 1 and len(arguments) > 1:
        from circlecal.batch.workers import map_on_workers

        yield from map_on_workers(function, arguments, min(workers, len(arguments)))
    else:
        yield from map(function, arguments)
