"""A clip in stretches: what is tracked how, and the frames of each stretch in order.

A stretch is a minute long. It begins a little before its first frame and goes on a little beyond its last, so that it
knows their neighbours; where the stretches lie depends on nothing but time.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from circlecal.config import Config, aspect_of, config_digest, suit_pixels
from circlecal.errors import CirclecalError, InputError
from circlecal.formats.annotation import digest_annotations
from circlecal.pictures.video import Sampling, Video, frame_id, pictures_at
from circlecal.pipeline import field_of
from circlecal.records.record import ResultRecord
from circlecal.rig.tripod import Venue
from circlecal.tracking.anchors import read_anchors
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.frame_times import FrameTimes
from circlecal.tracking.records import RecordForm, record_of_track
from circlecal.tracking.survey import survey_clip
from circlecal.tracking.survey_steps import UNTOLD, OnStep, SurveySteps
from circlecal.tracking.twins import measure_period

DEFAULT_EVERY = "1"
"""Of a clip every frame is tracked."""
STRETCH_S = 60.0
"""Length of the stretches, seconds: a stop costs at most as much, and the frames at their ends that are done twice are
a fifteenth of all.
"""
MARGIN_S = 2.0
"""How far a stretch looks beyond its ends, seconds: more than a smoother remembers, and enough to be found again."""
FOLLOWED_STEP_S = 0.05
"""Longest time between wanted frames at which those between them are not followed too, seconds. In a rendered clip of
25 frames per second whose camera pans from side to side all 75 frames are answered, of every second one 30 of 38, and
of every fifth 4 of 15, in three shots for one: nothing carries the camera over a turn that leaves little in common.
"""
_TOLERANCE_S = 0.001
"""Containers round times to milliseconds."""
_FOREVER_S = 1e9
"""Longer than any clip, seconds."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a clip: its frames from ``start_s`` on, before ``end_s``, seconds.

    Attributes
    ----------
    video, start_s, end_s : Video, float, float
        The clip, and times in it.
    frames : FrameTimes
        Of its frames, and those of its margins.
    origin : int
        Number of the first frame of the clip that is wanted.
    """

    video: Video
    start_s: float
    end_s: float
    frames: FrameTimes
    origin: int


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
        """Twelve hexadecimal digits over everything that the records depend on beside the clips."""
        known = self.known and [
            (t.name, t.size, t.log_focal, t.mean.tolist(), t.covariance.tolist()) for t in self.known.tripods
        ]
        told: list[object] = [config_digest(self.config), self.sampling.seconds, self.sampling.frames, known]
        told += [self.known.paint_bgr] if self.known and self.known.paint_bgr else []
        painters = [t.whole_covariance.tolist() for t in self.known.tripods if t.painters] if self.known else []
        told += [painters] if painters else []
        named = digest_annotations(self.annotations)
        told += [named] if named else []
        span = self.sampling.start_s, self.sampling.end_s
        told += [span] if span != (0.0, None) else []
        told += ["full"] if self.full else []
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:12]

    def form(self, video: Video) -> RecordForm:
        """What all records of a video have in common."""
        aspect = aspect_of(self.config_of(video))
        return RecordForm(*field_of(self.config), self.config.seed, self.digest, self.full, aspect, video.bytes)

    def config_of(self, video: Video) -> Config:
        """The configuration for the pictures of a video, which may tell that its pixels are not square."""
        return suit_pixels(self.config, video.aspect)

    def step_s(self, video: Video) -> float:
        """Time between two frames that are wanted, seconds; by the mean rate where these are counted."""
        if self.sampling.seconds is not None:
            return self.sampling.seconds
        return (self.sampling.frames or 1) / video.rate

    def follows_all(self, video: Video) -> bool:
        """Whether frames that are not wanted are followed too: too much changes between those that are."""
        return self.sampling.frames == 1 or self.step_s(video) > FOLLOWED_STEP_S

    def count_steps(self, number: int, time_s: float, origin: int) -> int:
        """Steps from the first wanted frame, whose number is ``origin``, to a frame, by its number or its time: the
        first frame after each of them is wanted.
        """
        if self.sampling.seconds is not None:
            return math.floor((time_s - self.sampling.start_s + _TOLERANCE_S) / self.sampling.seconds)
        return (number - origin) // (self.sampling.frames or 1)

    def step_start_s(self, frames: FrameTimes, time_s: float, origin: int) -> float:
        """Where the step begins to which a time belongs, seconds."""
        start = self.sampling.start_s
        steps = max(0, self.count_steps(frames.number_at(time_s), time_s - _TOLERANCE_S, origin))
        if self.sampling.seconds is not None:
            return start + steps * self.sampling.seconds
        return max(start, frames.time_of(origin + steps * (self.sampling.frames or 1)))

    def sampling_of(self, stretch: Stretch) -> Sampling:
        """Which frames are decoded for a stretch: those that are wanted, also in its margins, of which it has one at
        least, and those between them where they are followed too.
        """
        every = self.follows_all(stretch.video)
        before = max(self.sampling.start_s, stretch.start_s - MARGIN_S)
        last = self.step_start_s(stretch.frames, stretch.start_s if every else before, stretch.origin)
        end = stretch.end_s + MARGIN_S
        if self.sampling.end_s is not None:
            end = min(end, self.sampling.end_s)
        return Sampling(
            None if every else self.sampling.seconds,
            1 if every else self.sampling.frames,
            min(before, last) if every else last,
            end if math.isfinite(end) else None,
        )

    def stretch_of(self, video: Video, frames: FrameTimes, start_s: float, end_s: float) -> Stretch:
        """A part of a clip, with the times of its frames, seconds."""
        origin = frames.number_from(self.sampling.start_s)
        first_s = self.step_start_s(frames, max(self.sampling.start_s, start_s - MARGIN_S), origin)
        low, high = (frames.number_at(time_s) for time_s in (first_s, min(end_s + MARGIN_S, _FOREVER_S)))
        return Stretch(video, start_s, end_s, frames.cut(low - 1, high), origin)

    def is_finished(self, video: Video, frames: FrameTimes, reached_s: float) -> bool:
        """Whether no frame of a clip is wanted after one that is written."""
        end = self.end_s(video)
        if not frames.times_s:
            return reached_s + 1.5 * self.step_s(video) >= end
        origin = frames.number_from(self.sampling.start_s)
        last = frames.number_from(_FOREVER_S if self.sampling.end_s is None else self.sampling.end_s) - 1
        done = self.count_steps(frames.number_at(reached_s), reached_s, origin)
        return self.count_steps(last, frames.time_of(last), origin) <= done

    def end_s(self, video: Video) -> float:
        """Where the last stretch of a video ends, seconds, as far as the header tells."""
        end = math.inf if self.sampling.end_s is None else self.sampling.end_s
        return min(end, video.duration_s) if video.duration_s > 0 else end


@dataclass(frozen=True, slots=True)
class Tracked:
    """A frame's record, and whether a new shot begins with it."""

    record: ResultRecord
    is_cut: bool


@dataclass(frozen=True, slots=True)
class StretchResult:
    """What a process hands back of a stretch: its frames, why there are no more, and what could not be read."""

    frames: tuple[Tracked, ...]
    error: str | None
    missing: str | None


OnMissing = Callable[[Video, str], None]


def stretches_of(video: Video, run: ClipRun, frames: FrameTimes, reached_s: float | None = None) -> list[Stretch]:
    """The stretches of a clip that are not finished, in order.

    Parameters
    ----------
    video, run, frames : Video, ClipRun, FrameTimes
        The clip, from where to where it is wanted, and the times of its frames.
    reached_s : float, optional
        Time of the last frame that is written.
    """
    start, end = run.sampling.start_s, run.end_s(video)
    if reached_s is not None and run.is_finished(video, frames, reached_s):
        return []
    first = math.floor(start / STRETCH_S) if reached_s is None else math.floor(reached_s / STRETCH_S)
    stated = math.ceil(end / STRETCH_S) if math.isfinite(end) else first + 1
    edges = [k * STRETCH_S for k in range(first, max(stated, first + 1) + 1)]
    edges[0] = max(edges[0], start)
    # a video may go on beyond what its header tells
    edges[-1] = math.inf if run.sampling.end_s is None else run.sampling.end_s
    return [run.stretch_of(video, frames, low, high) for low, high in pairwise(edges)]


def list_frames(video: Video, run: ClipRun) -> FrameTimes:
    """When the frames of a clip are shown, as far as it is wanted."""
    end = math.inf if run.sampling.end_s is None else run.sampling.end_s
    return FrameTimes.of_video(video, end + MARGIN_S)


def survey_video(run: ClipRun, video: Video, on_step: OnStep = UNTOLD.on_step) -> Venue | str:
    """The cameras of a clip, or what is wrong with it; a function may be told how far it is."""
    start, end = run.sampling.start_s, run.end_s(video)
    length = (end if math.isfinite(end) else start + STRETCH_S) - start

    def shift_times(times_s: Sequence[float]) -> Iterator[Any]:
        return pictures_at(video.path, [start + time for time in times_s], exact=False)

    try:
        config = run.config_of(video)
        named = (a for a in read_anchors(video, run.annotations, config) if start <= a.time_s < end)
        anchors = tuple(replace(anchor, time_s=anchor.time_s - start) for anchor in named)
        known = _suit_known(run, video)
        period_s = measure_period(shift_times, length / 2.0, 1.0 / video.rate)
        return survey_clip(shift_times, length, config, known, anchors, period_s, SurveySteps(on_step))
    except CirclecalError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - one bad clip never stops the rest
        _log.debug("internal error", exc_info=True)
        return f"{video.path}: internal error: {type(error).__name__}: {error}"


def _suit_known(run: ClipRun, video: Video) -> Venue | None:
    """What is known of the cameras from elsewhere, for the pictures of a video.

    Raises
    ------
    InputError
        They show another shape than the clip's.
    """
    if run.known is None:
        return None
    try:
        return run.known.suit_pictures((video.width, video.height), aspect_of(run.config_of(video)))
    except InputError as error:
        raise InputError(f"{video.path}: {error}") from error


def track_alone(run: ClipRun, known: tuple[Stretch, Venue]) -> StretchResult:
    """All of a stretch, in a process that writes nothing."""
    stretch, venue = known
    missing: list[str] = []
    frames: list[Tracked] = []
    error = None
    try:
        frames += track_stretch(run, stretch, venue, lambda _, text: missing.append(text))
    except InputError as found:
        error = str(found)
    return StretchResult(tuple(frames), error, missing[0] if missing else None)


def track_stretch(run: ClipRun, stretch: Stretch, venue: Venue, on_missing: OnMissing) -> Iterator[Tracked]:
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
    video, form = stretch.video, run.form(stretch.video)
    before: int | None = None
    steps, now = -1, stretch.start_s
    try:
        for frame in track_frames(_decode(run, stretch, on_missing), venue, run.config_of(video)):
            now = frame.time_s
            step = run.count_steps(frame.index, now, stretch.origin)
            if step == steps:
                continue
            is_cut = before is not None and frame.shot != before
            before, steps = frame.shot, step
            if stretch.start_s <= frame.time_s < stretch.end_s:
                record = record_of_track(frame, frame_id(video.name, frame.time_s), str(video.path), frame.shot, form)
                yield Tracked(record, is_cut)
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
    venue = survey_video(run, video)
    if not isinstance(venue, Venue):
        raise InputError(venue)
    end = math.inf if run.sampling.end_s is None else run.sampling.end_s
    whole = run.stretch_of(video, list_frames(video, run), run.sampling.start_s, end)
    shot = 0
    for tracked in track_stretch(run, whole, venue, lambda _, missing: on_note(missing)):
        shot += tracked.is_cut
        yield number_shot(tracked.record, shot)


def number_shot(record: ResultRecord, shot: int) -> ResultRecord:
    """The record with the number of its shot in the whole clip."""
    if record.track is None:
        return record
    return record.model_copy(update={"track": record.track.model_copy(update={"shot": shot})})


def _decode(run: ClipRun, stretch: Stretch, on_missing: OnMissing) -> Iterator[ClipFrame]:
    """Pictures of a stretch and of its margins; frames that cannot be decoded are left out."""
    video, number = stretch.video, -1
    for frame in video.frames(run.sampling_of(stretch), lambda text: on_missing(video, text)):
        if frame.picture is not None and frame.time_s is not None:
            # no two have one number, also where the times of packets and those of frames differ
            number = max(stretch.frames.number_at(frame.time_s), number + 1)
            yield ClipFrame(number, frame.time_s, frame.picture)
