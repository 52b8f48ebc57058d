"""A run over clips: a survey of each, then every frame, appended to the results as it is finished.

A clip is worked on in stretches of a minute. Each begins a little before its first frame and goes on a little beyond
its last, so that it knows their neighbours; where the stretches lie depends on nothing but time. So the answers are the
same however many processes work on them, and after a stop. Records are written in the order of time, clip after clip:
the last one tells how far a run has come.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import math
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from circlecal.batch import SUMMARY_NAME, BatchProgress
from circlecal.config import Config, config_digest
from circlecal.errors import CirclecalError, InputError
from circlecal.field import FieldTemplate
from circlecal.files import is_file
from circlecal.formats.annotation import digest_annotations
from circlecal.pictures.video import Sampling, Video, frame_id, frame_time, pictures_at
from circlecal.pipeline import field_of
from circlecal.records.cameras_table import CAMERAS_NAME, write_cameras
from circlecal.records.json_text import GIVE_A_RESULT, parse_record
from circlecal.records.log import Finished, Place, ResultLog, scan_records
from circlecal.records.record import ResultRecord, ResultRow
from circlecal.records.summary import write_summary
from circlecal.rig.tripod import PLACE, Venue
from circlecal.rig.venue import VENUE_NAME, read_venue, read_venue_file, write_venue
from circlecal.tracking.anchors import read_anchors
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.records import RecordForm, record_of_track
from circlecal.tracking.survey import survey_clip

DEFAULT_EVERY = "1"
"""Of a clip every frame is tracked."""
STRETCH_S = 60.0
"""Length of the stretches, seconds: a stop costs at most as much, and the frames at their ends that are done twice are
a fifteenth of all.
"""
MARGIN_S = 2.0
"""How far a stretch looks beyond its ends, seconds: more than a smoother remembers, and enough to be found again."""

_log = logging.getLogger(__name__)
T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a clip: its frames from ``start_s`` on, before ``end_s``, seconds."""

    video: Video
    start_s: float
    end_s: float


@dataclass(frozen=True)
class ClipRun:
    """How clips are tracked; picklable, and the same in every process.

    Attributes
    ----------
    config : Config
        Options.
    sampling : Sampling
        Which frames, and from where to where.
    known : Venue, optional
        Cameras and pitch that are known from elsewhere.
    full : bool
        Whether records hold everything that follows from a camera.
    annotations : path, optional
        Folder of annotations of the workbench: the frames that a person named.
    """

    config: Config
    sampling: Sampling
    known: Venue | None = None
    full: bool = False
    annotations: Path | None = None

    @cached_property
    def digest(self) -> str:
        """Twelve hexadecimal digits over everything that the answers depend on beside the clips."""
        known = self.known and [
            (t.name, t.size, t.log_focal, t.mean.tolist(), t.covariance.tolist()) for t in self.known.tripods
        ]
        told: list[object] = [config_digest(self.config), self.sampling.seconds, self.sampling.frames, known]
        named = digest_annotations(self.annotations)
        told += [named] if named else []
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:12]

    def form(self) -> RecordForm:
        """What all records have in common."""
        return RecordForm(*field_of(self.config), self.config.seed, self.digest, self.full)

    def config_of(self, video: Video) -> Config:
        """The configuration for the pictures of a video, which may tell that its pixels are not square."""
        if video.aspect is None or self.config.camera.aspect != 1.0:
            return self.config
        camera = self.config.camera.model_copy(update={"aspect": video.aspect})
        return self.config.model_copy(update={"camera": camera})

    def step_s(self, video: Video) -> float:
        """Time between two frames that are wanted, seconds."""
        if self.sampling.seconds is not None:
            return self.sampling.seconds
        return (self.sampling.frames or 1) / video.rate

    def sampling_of(self, stretch: Stretch) -> Sampling:
        """Which frames are decoded for a stretch: those that are wanted, also in its margins."""
        first, step = self.sampling.start_s, self.step_s(stretch.video)
        every = self.sampling.frames == 1
        before = max(first, stretch.start_s - MARGIN_S)
        start = before if every else first + math.floor((before - first) / step) * step
        end = stretch.end_s + MARGIN_S
        if self.sampling.end_s is not None:
            end = min(end, self.sampling.end_s)
        return Sampling(None if every else step, 1 if every else None, start, end if math.isfinite(end) else None)

    def end_s(self, video: Video) -> float:
        """Where the last stretch of a video ends, seconds, as far as the header tells."""
        end = math.inf if self.sampling.end_s is None else self.sampling.end_s
        return min(end, video.duration_s) if video.duration_s > 0 else end


@dataclass(frozen=True, slots=True)
class _Tracked:
    """A frame's record, and whether a new shot begins with it."""

    record: ResultRecord
    is_cut: bool


@dataclass(frozen=True, slots=True)
class _StretchResult:
    """What a process hands back of a stretch: its frames, why there are no more, and what could not be read."""

    frames: tuple[_Tracked, ...]
    error: str | None
    missing: str | None


OnMissing = Callable[[Video, str], None]


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
    on_progress, on_survey, on_note, on_error : callables
        Called after every frame with the counts; with the name of each clip whose cameras are looked for; with one line
        about what a clip lacks, once for each clip; and with the error of a clip that cannot be worked on, while the
        others go on.

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
        for row in log.index.rows():
            report.progress.count(row.status, row.code)
            report.progress.resumed += 1
        last = _last_record(log)
        parts = {video.name: stretches_of(video, run, _last_time_s(log, video)) for video in videos}
        try:
            with contextlib.closing(_surveys(videos, parts, run, out, workers, scheduler, on_survey)) as surveys:
                for video, venue in surveys:
                    if isinstance(venue, Venue):
                        report.venues[video.name] = venue
                    else:
                        on_error(InputError(venue))
            known = [(part, venue) for name, venue in report.venues.items() for part in parts[name]]
            on_progress(report.progress)
            writer = _Writer(log, last, report.progress, on_progress)
            _track_all(known, run, workers, scheduler, writer, on_note, on_error)
            log.require_in_place()
        except BrokenProcessPool as error:
            died = "a worker process died (out of memory, or a damaged file)"
            raise InputError(f"{died}; run the same command again to go on, or with --workers 1") from error
        finally:
            if log.is_in_place:
                write_summary(out / SUMMARY_NAME, log.index.rows())
                write_cameras(out / CAMERAS_NAME, records_in_order(out))
        report.progress.total = report.progress.finished
    return report


def venue_path(out: Path, video: Video, videos: Sequence[Video]) -> Path:
    """The venue file of a clip: ``venue.yaml``, and with its name before it where there are several clips."""
    return out / (VENUE_NAME if len(videos) == 1 else f"{video.name}.{VENUE_NAME}")


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
    deviation by axis, metres), and the size of the pitch, metres.
    """
    for tripod in venue.tripods:
        place = {
            f"{axis}_m": [float(tripod.mean[PLACE[f"axis_{axis}"]]), tripod.sigma(f"axis_{axis}")] for axis in "xyz"
        }
        pitch = np.array([template.length_m, template.width_m]) + tripod.growth_m
        yield {"camera": tripod.name, "frames": len(tripod.used), **place, "pitch_m": pitch.tolist()}


def stretches_of(video: Video, run: ClipRun, reached_s: float | None = None) -> list[Stretch]:
    """The stretches of a clip that are not finished, in order.

    Parameters
    ----------
    video, run : Video, ClipRun
        The clip, and from where to where it is wanted.
    reached_s : float, optional
        Time of the last frame that is written.
    """
    start, end = run.sampling.start_s, run.end_s(video)
    step = run.step_s(video)
    if reached_s is not None and reached_s + 1.5 * step >= end:
        return []
    first = math.floor(start / STRETCH_S) if reached_s is None else math.floor(reached_s / STRETCH_S)
    stated = math.ceil(end / STRETCH_S) if math.isfinite(end) else first + 1
    edges = [k * STRETCH_S for k in range(first, max(stated, first + 1) + 1)]
    edges[0] = max(edges[0], start)
    # a video may go on beyond what its header tells
    edges[-1] = math.inf if run.sampling.end_s is None else run.sampling.end_s
    return [Stretch(video, low, high) for low, high in pairwise(edges)]


class _Writer:
    """Appends frames to the results, with their shots counted over each whole clip."""

    def __init__(
        self,
        log: ResultLog,
        last: ResultRow | None,
        progress: BatchProgress,
        on_progress: Callable[[BatchProgress], None],
    ) -> None:
        self._log, self._progress, self._on_progress = log, progress, on_progress
        self._path = None if last is None else last.path
        self._shot = 0 if last is None or last.track is None else last.track.shot

    def write(self, tracked: _Tracked) -> None:
        """Append a frame, unless it is written already."""
        record = tracked.record
        if self._log.index.find(record.id) is not None:
            return
        self._shot = 0 if record.path != self._path else self._shot + tracked.is_cut
        self._path = record.path
        record = _with_shot(record, self._shot)
        self._log.append(Finished.of(record))
        self._progress.count(record.status, record.code)
        self._on_progress(self._progress)


def _last_record(log: ResultLog) -> ResultRow | None:
    """The record that was written last."""
    line = log.last_line()
    return None if line is None else parse_record(line, ResultRow, str(log.path), GIVE_A_RESULT)


def _last_time_s(log: ResultLog, video: Video) -> float | None:
    """Time of the last frame of a clip that is written, seconds."""
    name = log.index.last_id(f"{video.name}_")
    return None if name is None else frame_time(name)


def _surveys(
    videos: Sequence[Video],
    parts: dict[str, list[Stretch]],
    run: ClipRun,
    out: Path,
    workers: int,
    scheduler: str | None,
    on_survey: Callable[[str], None],
) -> Generator[tuple[Video, Venue | str]]:
    """The venue of each clip that is not finished, or why there is none; from the file where it was found before."""
    todo = []
    for video in videos:
        venue = _read_venue(venue_path(out, video, videos), run)
        if venue is not None:
            yield video, venue
        elif parts[video.name]:
            on_survey(video.name)
            todo.append(video)
    for video, found in zip(todo, _map(partial(_survey, run), todo, workers, scheduler), strict=True):
        if isinstance(found, Venue):
            write_venue(venue_path(out, video, videos), found, field_of(run.config)[0], run.digest)
        yield video, found


def _read_venue(path: Path, run: ClipRun) -> Venue | None:
    """The venue that this run wrote before; None where there is none, or one of another run."""
    if not is_file(path):
        return None
    try:
        if read_venue_file(path).config_digest == run.digest:
            return read_venue(path, field_of(run.config)[0])
    except InputError as error:
        _log.warning("%s; it is written again", error)
    return None


def _survey(run: ClipRun, video: Video) -> Venue | str:
    """The cameras of a clip, or what is wrong with it."""
    start, end = run.sampling.start_s, run.end_s(video)
    length = (end if math.isfinite(end) else start + STRETCH_S) - start

    def shift_times(times_s: Sequence[float]) -> Iterator[Any]:
        return pictures_at(video.path, [start + time for time in times_s], exact=False)

    try:
        config = run.config_of(video)
        named = (a for a in read_anchors(video, run.annotations, config) if start <= a.time_s < end)
        anchors = tuple(replace(anchor, time_s=anchor.time_s - start) for anchor in named)
        return survey_clip(shift_times, length, config, run.known, anchors)
    except CirclecalError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - one bad clip never stops the rest
        _log.debug("internal error", exc_info=True)
        return f"{video.path}: internal error: {type(error).__name__}: {error}"


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

    with contextlib.closing(_stretch_frames(known, run, workers, scheduler, on_missing)) as parts:
        for stretch, frames in parts:
            name = stretch.video.name
            if name in failed:  # what follows would leave a gap, and the run could not be taken up
                continue
            try:
                for tracked in frames:
                    writer.write(tracked)
            except InputError as error:
                failed.add(name)
                on_error(error)


def _stretch_frames(
    known: Sequence[tuple[Stretch, Venue]],
    run: ClipRun,
    workers: int,
    scheduler: str | None,
    on_missing: OnMissing,
) -> Generator[tuple[Stretch, Iterator[_Tracked]]]:
    """The frames of each stretch, as they are tracked in this process, or as other processes bring them."""
    if scheduler is None and (workers == 1 or len(known) < 2):
        for stretch, venue in known:
            yield stretch, track_stretch(run, stretch, venue, on_missing)
        return
    for (stretch, _), result in zip(known, _map(partial(_track_alone, run), known, workers, scheduler), strict=True):
        yield stretch, _frames_of(result, stretch, on_missing)


def _frames_of(result: _StretchResult, stretch: Stretch, on_missing: OnMissing) -> Iterator[_Tracked]:
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


def _track_alone(run: ClipRun, known: tuple[Stretch, Venue]) -> _StretchResult:
    """All of a stretch, in a process that writes nothing."""
    stretch, venue = known
    missing: list[str] = []
    frames: list[_Tracked] = []
    error = None
    try:
        frames += track_stretch(run, stretch, venue, lambda _, text: missing.append(text))
    except InputError as found:
        error = str(found)
    return _StretchResult(tuple(frames), error, missing[0] if missing else None)


def track_stretch(run: ClipRun, stretch: Stretch, venue: Venue, on_missing: OnMissing) -> Iterator[_Tracked]:
    """The frames of a stretch in order, each as soon as it is known.

    Parameters
    ----------
    run, stretch, venue : ClipRun, Stretch, Venue
        How, what, and the cameras that may have taken it.
    on_missing : callable
        Called at the end with one line that says what of the video could not be read.

    Raises
    ------
    InputError
        The video cannot be read, or a mistake of the program, in one line that names the clip and the time.
    """
    video, form = stretch.video, run.form()
    before: int | None = None
    now = stretch.start_s
    try:
        for frame in track_frames(_decode(run, stretch, on_missing), venue, run.config_of(video)):
            is_cut = before is not None and frame.shot != before
            before, now = frame.shot, frame.time_s
            if stretch.start_s <= frame.time_s < stretch.end_s:
                record = record_of_track(frame, frame_id(video.name, frame.time_s), str(video.path), frame.shot, form)
                yield _Tracked(record, is_cut)
    except CirclecalError as error:
        raise InputError(str(error)) from error
    except (ArithmeticError, LookupError, TypeError, ValueError, RuntimeError) as error:
        _log.debug("internal error", exc_info=True)
        where = frame_id("", now)[1:].replace("-", ":")
        raise InputError(f"{video.path}: internal error after {where}: {type(error).__name__}: {error}") from error


def track_video(run: ClipRun, video: Video, on_note: Callable[[str], None] = _log.warning) -> Iterator[ResultRecord]:
    """Records of a clip in the order of time, each as soon as it is known, without a folder and in this process.

    Raises
    ------
    InputError
        The clip cannot be read, or as :func:`track_stretch`.
    """
    venue = _survey(run, video)
    if not isinstance(venue, Venue):
        raise InputError(venue)
    end = math.inf if run.sampling.end_s is None else run.sampling.end_s
    shot = 0
    for tracked in track_stretch(
        run, Stretch(video, run.sampling.start_s, end), venue, lambda _, missing: on_note(missing)
    ):
        shot += tracked.is_cut
        yield _with_shot(tracked.record, shot)


def _with_shot(record: ResultRecord, shot: int) -> ResultRecord:
    """The record with the number of its shot in the whole clip."""
    if record.track is None:
        return record
    return record.model_copy(update={"track": record.track.model_copy(update={"shot": shot})})


def _decode(run: ClipRun, stretch: Stretch, on_missing: OnMissing) -> Iterator[ClipFrame]:
    """Pictures of a stretch and of its margins; frames that cannot be decoded are left out."""
    video = stretch.video
    for frame in video.frames(run.sampling_of(stretch), lambda text: on_missing(video, text)):
        if frame.picture is not None and frame.time_s is not None:
            yield ClipFrame(round(frame.time_s * video.rate), frame.time_s, frame.picture)
