"""Videos: which of their frames are wanted, and decoding just these, one after the other.

A frame is known by its presentation time, counted from the first frame that is shown, never by a number: edit lists
(clips cut by stream copy), reordered frames, variable rates and late starts make numbers lie. FFmpeg decodes, through
PyAV, which is loaded when the first video is opened.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.files import file_size, require_regular
from circlecal.pictures.files import PictureFile
from circlecal.pictures.headers import MIN_SIDE
from circlecal.pictures.limits import LimitsConfig, suggest_limit

if TYPE_CHECKING:
    import av
    from av.container import InputContainer

_log = logging.getLogger(__name__)

DEFAULT_EVERY = "1s"
_TOLERANCE_S = 0.001
"""Containers round times to milliseconds."""
_SEEK_GAP_S = 8.0
"""Shorter stretches are decoded: key frames of broadcasts lie up to this far apart."""
_SEEK_MARGINS_S = (3.0, 12.0)
"""A seek aims this much before the time that is wanted, since containers without an index (transport streams) lead to
any packet, and decoding begins at the next key frame; tried in this order."""
_REORDER_S = 5.0
"""Longest time by which a packet may stand in the file behind one that is shown after it, seconds: 16 frames at 4
frames per second."""
_SHORTEST_PERIOD_S = 0.001
_FALLBACK_RATE = 25.0
_MAX_RATE = 1000.0
_EDITED = "mov"
"""The format whose files have edit lists: not all frames that they hold are shown."""
_MISSING_SHARE, _MISSING_S = 0.02, 1.0
"""A video that ends by more than this share of its stated length and this many seconds early, or begins this late, is
said to lack something; headers round, or tell the length of the sound, by less."""
_CLOCK = re.compile(r"(?:(?:(\d{1,6}):)?(\d{1,6}):)?(\d{1,9}(?:\.\d{1,9})?)", re.ASCII)
_DURATION = re.compile(r"(\d{1,9}(?:\.\d{1,9})?)\s*(ms|s|min|m|h)", re.ASCII)
_COUNT = re.compile(r"\d{1,9}", re.ASCII)
_FRAME_TIME = re.compile(r"_(\d{2,})-(\d{2})-(\d{2}\.\d{3})$")
_UNITS = {"ms": 0.001, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0}


@dataclass(frozen=True, slots=True)
class Sampling:
    """Which frames of a video are wanted: one every ``seconds``, or every ``frames``-th, between two times.

    Attributes
    ----------
    seconds, frames : float or None, int or None
        One of the two.
    start_s, end_s : float, float or None
        Times in the video; a frame at ``end_s`` itself is not wanted.
    """

    seconds: float | None
    frames: int | None
    start_s: float = 0.0
    end_s: float | None = None

    @classmethod
    def parse(
        cls,
        every: str | int = DEFAULT_EVERY,
        start: str | float | None = None,
        end: str | float | None = None,
        *,
        dashes: str = "",
    ) -> Sampling:
        """From options such as ``1s``, ``500ms``, ``10`` (frames); ``90``, ``1:30`` or ``0:01:30.5``.

        Parameters
        ----------
        every, start, end : str or number
            What the user gave: a number counts frames, or is a time in seconds. ``start`` and ``end`` may be None.
        dashes : str
            What stands before the names of the three in messages: ``--`` on the command line.

        Raises
        ------
        InputError
            Anything else.
        """
        period = str(every).strip()
        match = _DURATION.fullmatch(period)
        seconds = None if match is None else float(match[1]) * _UNITS[match[2]]
        frames = int(period) if _COUNT.fullmatch(period) else None
        if not frames and not (seconds and seconds >= _SHORTEST_PERIOD_S):
            raise InputError(
                f"{dashes}every {every}: must be a time such as 1s or 500ms, or a number of frames such as 25"
            )
        start_s = 0.0 if start is None else _clock(start, f"{dashes}start")
        end_s = None if end is None else _clock(end, f"{dashes}end")
        if end_s is not None and end_s <= start_s:
            raise InputError(f"{dashes}end {end}: is not after {dashes}start {start or 0}")
        return cls(seconds, frames, start_s, end_s)


def _clock(time: str | float, option: str) -> float:
    text = f"{time:.9f}" if isinstance(time, (int, float, np.number)) else str(time)
    match = _CLOCK.fullmatch(text.strip().removesuffix("s"))
    if match is None:
        raise InputError(f"{option} {time}: must be seconds, MM:SS or HH:MM:SS, such as 12:03.5")
    hours, minutes, seconds = match.groups(default="0")
    if (match[2] is not None and float(seconds) >= 60.0) or (match[1] is not None and int(minutes) >= 60):
        raise InputError(f"{option} {text}: has 60 or more minutes or seconds behind a colon; write them as such")
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds)


def frame_id(name: str, time_s: float) -> str:
    """Name of the frame at a time, such as ``match_00-12-03.480``: in order of time where sorted as text."""
    whole = round(time_s * 1000.0)
    seconds, milliseconds = divmod(whole, 1000)
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{name}_{hours:02d}-{minutes:02d}-{seconds:02d}.{milliseconds:03d}"


def clip_of(identifier: str) -> str:
    """Name of the clip of a frame of a video, from the frame's own; see :func:`frame_id`."""
    return identifier.rpartition("_")[0]


def frame_time(identifier: str) -> float:
    """Time in seconds of a frame by its name, to a millisecond; see :func:`frame_id`.

    Raises
    ------
    ValueError
        It is no name of a frame of a video.
    """
    match = _FRAME_TIME.search(identifier)
    if match is None:
        raise ValueError(f"{identifier} names no time")
    hours, minutes, seconds = match.groups()
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds)


@dataclass(frozen=True, slots=True)
class Video:
    """A video file with what its header says.

    Attributes
    ----------
    path, name : Path, str
        The file, and the first part of its frames' ids.
    width, height : int
        Size of the stored frames.
    rate : float
        Frames per second; 25 where the header has no sensible value.
    duration_s : float
        From the first frame that is shown to the end that the header tells, which may be wrong; 0 where it tells none.
    aspect : float or None
        Width of a pixel over its height, where the file says that it is not 1.
    bytes : int or None
        Size of the file when it was opened, by which a later start knows another one of its name.
    """

    path: Path
    name: str
    width: int
    height: int
    rate: float
    duration_s: float
    aspect: float | None
    bytes: int | None = None

    @classmethod
    def open(cls, path: Path, name: str, limits: LimitsConfig) -> Video:
        """Read the header and the first frame.

        Raises
        ------
        InputError
            Missing, no video, or one whose frames cannot be decoded or are larger than the limits allow.
        """
        size_bytes = file_size(path)
        with _Decoder(path) as decoder:
            width, height = decoder.size
            size = f"has frames of {width} x {height} pixels"
            if min(width, height) < MIN_SIDE:
                raise InputError(f"{path}: {size}; at least {MIN_SIDE} on each side are needed")
            if width * height > limits.max_pixels:
                limit = f"more than {limits.max_pixels / 1e6:g} million"
                raise InputError(f"{path}: {size}, {limit}; {suggest_limit('max_pixels', width * height)}")
            return cls(path, name, width, height, decoder.rate, decoder.duration_s, decoder.aspect, size_bytes)

    def estimate_count(self, sampling: Sampling) -> int:
        """About how many frames :meth:`frames` will find."""
        end = self.duration_s if sampling.end_s is None else min(sampling.end_s, self.duration_s)
        length = max(0.0, end - sampling.start_s)
        step = sampling.seconds if sampling.seconds is not None else (sampling.frames or 1) / self.rate
        return max(1, math.ceil(length / max(step, 1.0 / self.rate) - _TOLERANCE_S))

    def frames(self, sampling: Sampling, on_missing: Callable[[str], None] = _log.warning) -> Iterator[PictureFile]:
        """The wanted frames in order of time, decoded as they are asked for; never more than one is held.

        Parameters
        ----------
        sampling : Sampling
            Which frames; the first one at or after each time that is asked for.
        on_missing : callable
            Called once, at the end, with one line that says what of the video could not be read.
        """
        end = math.inf if sampling.end_s is None else sampling.end_s
        with _Decoder(self.path) as decoder:
            time = decoder.go_to(sampling.start_s)
            while time is not None and time < end - _TOLERANCE_S:
                identifier = frame_id(self.name, time)
                picture, time_s = decoder.picture(), round(time, 6)
                yield PictureFile(identifier, self.path, identifier, time_s, picture, self.aspect, bytes=self.bytes)
                if sampling.seconds is not None:
                    count = math.floor((time - sampling.start_s + _TOLERANCE_S) / sampling.seconds) + 1
                    target = sampling.start_s + count * sampling.seconds
                    if target >= end - _TOLERANCE_S:
                        break
                    time = decoder.go_to(target)
                else:
                    time = decoder.skip(sampling.frames or 1)
            missing = decoder.missing(end if time is None else 0.0)
        if missing:
            on_missing(f"{self.path}: {missing}; all else was read")

    def list_times(self, end_s: float = math.inf) -> tuple[float, ...]:
        """Times of the frames, seconds, in order, as the packets of the file tell them: nothing is decoded but the
        first frame, but the file is read.

        Parameters
        ----------
        end_s : float
            Frames from here on may be left out.

        Returns
        -------
        tuple of float
            Empty where the packets tell no times.

        Raises
        ------
        InputError
            Missing, or no video.
        """
        with _Decoder(self.path) as decoder:
            return tuple(decoder.list_times(end_s))


def pictures_at(path: Path, times_s: Iterable[float], *, exact: bool = True) -> Iterator[NDArray[np.uint8] | None]:
    """Pictures (H, W, 3) of frames whose times :meth:`Video.frames` told, in any order (fastest where they grow); None
    for one that is not there. Without ``exact`` any times, of which each means the first frame that is not before it.

    Raises
    ------
    InputError
        Missing, or no video.
    """
    with _Decoder(path) as decoder:
        for time_s in times_s:
            found = decoder.go_to(time_s)
            there = found is not None and (not exact or found - time_s <= 0.5 / decoder.rate)
            yield decoder.picture() if there else None


def _open_container(path: Path) -> InputContainer:
    """A video file, whatever encoding its titles have: PyAV before 19 must be told to replace what is no UTF-8, and
    later releases take no such option.
    """
    import av

    options: dict[str, Any] = {"metadata_errors": "replace"} if int(av.__version__.partition(".")[0]) < 19 else {}
    container: InputContainer = av.open(str(path), "r", **options)
    return container


class _Decoder:
    """Goes through a video; stands at a frame, the first one to begin with, and knows its time."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._first_s: float | None = None
        self._can_seek = True
        self._damaged = 0
        self._open()
        if self.grab() is None:
            self._container.close()
            raise InputError(f"{path}: holds no frame that can be decoded; copy or convert it again")
        stream, frame = self._stream, self._frame
        base = stream.time_base or Fraction(1)
        start_s = float((stream.start_time or 0) * base)
        # Matroska tells no length of its streams, but when the whole ends
        length_s = (self._container.duration or 0) / 1e6 - start_s
        if stream.duration is not None:
            length_s = float(stream.duration * base)
        if _EDITED not in self._container.format.name:
            # FFmpeg tells less of an AVI file that is cut short than its header does
            length_s = max(length_s, stream.frames / self.rate)
        self._late_s = (self._first_s or 0.0) - start_s
        self.duration_s = max(0.0, length_s - self._late_s)
        self._stored_size = frame.width, frame.height
        self._quarter_turns = round(frame.rotation / 90.0) % 4
        aspect = stream.sample_aspect_ratio or Fraction(1)
        self.aspect = None if aspect == 1 else float(1 / aspect if self._quarter_turns % 2 else aspect)

    def _open(self) -> None:
        import av
        from av.stream import Disposition
        from av.video.reformatter import VideoReformatter

        self._failures = (av.FFmpegError, OSError, ValueError)
        require_regular(self._path)
        try:
            self._container = _open_container(self._path)
        except self._failures as error:
            raise InputError(
                f"{self._path}: is no video that can be read, or is damaged; copy or convert it again"
            ) from error
        streams = [s for s in self._container.streams.video if not s.disposition & Disposition.attached_pic]
        if not streams or streams[0].codec_context is None:
            self._container.close()
            raise InputError(f"{self._path}: holds no video that can be decoded; convert it")
        self._stream = streams[0]
        self._stream.thread_type = "AUTO"
        rate = float(self._stream.average_rate or self._stream.guessed_rate or 0.0)
        self.rate = rate if 0.1 <= rate <= _MAX_RATE else _FALLBACK_RATE
        self._reformatter = VideoReformatter()
        self._frames = self._decode()
        self.time = -1.0 / self.rate

    def __enter__(self) -> _Decoder:
        return self

    def __exit__(self, *details: object) -> None:
        self._container.close()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures, pixels."""
        width, height = self._stored_size
        return (height, width) if self._quarter_turns % 2 else (width, height)

    def _decode(self) -> Iterator[av.VideoFrame]:
        try:
            for packet in self._container.demux(self._stream):
                try:
                    yield from packet.decode()
                except self._failures:
                    self._damaged += 1
        except self._failures:  # nothing behind this place of the file can be read
            self._damaged += 1

    def grab(self) -> float | None:
        """Go to the next frame; its time in seconds, None at the end."""
        frame = next(self._frames, None)
        if frame is None:
            return None
        self._frame = frame
        if self._first_s is None:
            self._first_s = frame.time or 0.0
        following = self.time + max(_SHORTEST_PERIOD_S, 1.0 / self.rate)
        time = following if frame.time is None else frame.time - self._first_s
        self.time = time if time >= self.time + _SHORTEST_PERIOD_S else following  # times that go back are wrong
        return self.time

    def picture(self) -> NDArray[np.uint8] | None:
        """The frame (H, W, 3), BGR, turned as it is shown; None where it cannot be converted."""
        width, height = self._stored_size
        try:
            picture = self._reformatter.reformat(self._frame, width, height, "bgr24").to_ndarray()
        except self._failures:
            self._damaged += 1
            return None
        return np.ascontiguousarray(np.rot90(picture, self._quarter_turns), dtype=np.uint8)

    def skip(self, count: int) -> float | None:
        """Time of the frame that many after this one."""
        found = None
        for _ in range(count):
            found = self.grab()
            if found is None:
                return None
        return found

    def go_to(self, time_s: float) -> float | None:
        """Time of the first frame at or after a time; None where there is none."""
        is_far = self._can_seek and self.time + _SEEK_GAP_S < time_s < self.duration_s
        if is_far or time_s < self.time - _TOLERANCE_S:
            self._seek(time_s)
        while self.time < time_s - _TOLERANCE_S:
            if self.grab() is None:
                return None
        return self.time

    def _seek(self, time_s: float) -> None:
        """Go to a frame before a time; where the file leads elsewhere, to the first one, and seek no more."""
        for margin in _SEEK_MARGINS_S if self._can_seek else ():
            if time_s <= margin:
                break
            target = time_s - margin + (self._first_s or 0.0)
            try:
                self._container.seek(round(target / (self._stream.time_base or 1)), stream=self._stream)
            except self._failures:
                continue
            self._frames = self._decode()
            self.time = -math.inf
            if self.grab() is not None and -math.inf < self.time <= time_s:
                return
        else:
            self._can_seek = False
        self._container.close()
        self._open()
        self.grab()

    def list_times(self, end_s: float) -> list[float]:
        """Times of the frames in order, seconds, without decoding: those of packets that are shown, from the first
        frame on. Nothing can be decoded any more after this.
        """
        self._container.close()
        self._open()
        base, first_s, found = float(self._stream.time_base or 1), self._first_s or 0.0, []
        with contextlib.suppress(*self._failures):
            for packet in self._container.demux(self._stream):
                ticks = packet.dts if packet.pts is None else packet.pts
                if ticks is None or packet.is_discard or packet.size == 0:
                    continue
                found.append(ticks * base - first_s)
                if packet.dts is not None and packet.dts * base - first_s > end_s + _REORDER_S:
                    break
        return sorted(time_s for time_s in found if time_s > -_TOLERANCE_S)

    def missing(self, until_s: float) -> str:
        """What could not be read of a video that should go on until a time, in words; empty for nothing."""
        found = []
        if self._late_s > _MISSING_S:
            found.append(f"its first {self._late_s:.1f} s lack the key frame that they build upon")
        if self.time < min(until_s, (1.0 - _MISSING_SHARE) * self.duration_s - _MISSING_S):
            stated, reached = (frame_id("", time)[1:].replace("-", ":") for time in (self.duration_s, self.time))
            found.append(f"ends at {reached}, not at {stated} as its header says")
        if self._damaged:
            found.append(f"{self._damaged} of its packets cannot be decoded")
        return ", and ".join(found)
