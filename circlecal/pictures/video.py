"""Videos: which of their frames are wanted, and decoding just these, one after the other.

A frame is known by its time in the video, as the container tells it, never by the number that a decoder claims after
seeking: that is wrong in streams with reordered frames, a variable rate, or a late start. Decoding goes forward; a seek
only skips a long stretch and counts only if it lands before the time that is wanted.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.pictures.files import MAX_PIXELS, PictureFile, as_bgr
from circlecal.pictures.headers import MIN_SIDE

DEFAULT_EVERY = "1s"
_TOLERANCE_S = 0.001
"""Containers round times to milliseconds."""
_SEEK_GAP_S = 8.0
_SEEK_MARGIN_S = 3.0
"""A seek aims this much earlier, so that the decoder has met a whole picture before the one that is wanted."""
_SHORTEST_PERIOD_S = 0.001
_FALLBACK_RATE = 25.0
_MAX_RATE = 1000.0
_TRUNCATED_SHARE = 0.98
_CLOCK = re.compile(r"(?:(?:(\d+):)?([0-5]?\d):)?(\d+(?:\.\d+)?)")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*(ms|s|min|m|h)")
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
    def parse(cls, every: str = DEFAULT_EVERY, start: str | None = None, end: str | None = None) -> Sampling:
        """From options such as ``1s``, ``500ms``, ``10`` (frames); ``90``, ``1:30`` or ``0:01:30.5``.

        Raises
        ------
        InputError
            Anything else.
        """
        match = _DURATION.fullmatch(every.strip())
        seconds = None if match is None else float(match[1]) * _UNITS[match[2]]
        frames = int(every) if every.isascii() and every.isdigit() else None
        if not frames and not (seconds and seconds >= _SHORTEST_PERIOD_S):
            raise InputError(f"--every {every}: must be a time such as 1s or 500ms, or a number of frames such as 25")
        start_s = 0.0 if start is None else _clock(start, "--start")
        end_s = None if end is None else _clock(end, "--end")
        if end_s is not None and end_s <= start_s:
            raise InputError(f"--end {end}: is not after --start {start or 0}")
        return cls(seconds, frames, start_s, end_s)


def _clock(text: str, option: str) -> float:
    match = _CLOCK.fullmatch(text.strip().removesuffix("s"))
    if match is None:
        raise InputError(f"{option} {text}: must be seconds, MM:SS or HH:MM:SS, such as 12:03.5")
    hours, minutes, seconds = match.groups(default="0")
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds)


def frame_id(name: str, time_s: float) -> str:
    """Name of the frame at a time, such as ``match_00-12-03.480``: in order of time where sorted as text."""
    whole = round(time_s * 1000.0)
    seconds, milliseconds = divmod(whole, 1000)
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{name}_{hours:02d}-{minutes:02d}-{seconds:02d}.{milliseconds:03d}"


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
        As stated, which may be wrong; 0 where nothing is stated.
    aspect : float or None
        Width of a pixel over its height, where the file says that it is not 1.
    """

    path: Path
    name: str
    width: int
    height: int
    rate: float
    duration_s: float
    aspect: float | None

    @classmethod
    def open(cls, path: Path, name: str) -> Video:
        """Read the header and the first frame.

        Raises
        ------
        InputError
            Missing, no video, or one whose frames cannot be decoded.
        """
        with _Decoder(path) as decoder:
            if decoder.grab() is None:
                raise InputError(f"{path}: holds no frame that can be decoded; copy or convert it again")
            width, height = int(decoder.value(cv2.CAP_PROP_FRAME_WIDTH)), int(decoder.value(cv2.CAP_PROP_FRAME_HEIGHT))
            if min(width, height) < MIN_SIDE or width * height > MAX_PIXELS:
                raise InputError(f"{path}: has frames of {width} x {height} pixels, which is too small or too large")
            pixel = decoder.value(cv2.CAP_PROP_SAR_NUM), decoder.value(cv2.CAP_PROP_SAR_DEN)
            aspect = pixel[0] / pixel[1] if min(pixel) > 0 and pixel[0] != pixel[1] else None
            return cls(path, name, width, height, decoder.rate, decoder.duration_s, aspect)

    def estimate_count(self, sampling: Sampling) -> int:
        """About how many frames :meth:`frames` will find."""
        end = self.duration_s if sampling.end_s is None else min(sampling.end_s, self.duration_s)
        length = max(0.0, end - sampling.start_s)
        step = sampling.seconds if sampling.seconds is not None else (sampling.frames or 1) / self.rate
        return max(1, math.ceil(length / max(step, 1.0 / self.rate) - _TOLERANCE_S))

    def frames(self, sampling: Sampling, on_error: Callable[[InputError], None]) -> Iterator[PictureFile]:
        """The wanted frames in order of time, decoded as they are asked for; never more than one is held.

        Parameters
        ----------
        sampling : Sampling
            Which frames; the first one at or after each time that is asked for.
        on_error : callable
            Called where the video ends long before its header says.
        """
        end = math.inf if sampling.end_s is None else sampling.end_s
        with _Decoder(self.path) as decoder:
            time = decoder.forward_to(sampling.start_s)
            count = 0
            while time is not None and time < end - _TOLERANCE_S:
                identifier = frame_id(self.name, time)
                yield PictureFile(identifier, self.path, identifier, round(time, 6), decoder.picture(), self.aspect)
                if sampling.seconds is not None:
                    count = math.floor((time - sampling.start_s + _TOLERANCE_S) / sampling.seconds) + 1
                    target = sampling.start_s + count * sampling.seconds
                    if target >= end - _TOLERANCE_S:
                        return
                    time = decoder.forward_to(target)
                else:
                    time = decoder.skip(sampling.frames or 1)
            last = decoder.time
        if time is None and last < min(end, _TRUNCATED_SHARE * self.duration_s - 1.0):
            stated = frame_id("", self.duration_s)[1:].replace("-", ":")
            reached = frame_id("", max(last, 0.0))[1:].replace("-", ":")
            on_error(InputError(f"{self.path}: ends at {reached}, not at {stated} as it says; copy it again"))


def pictures_at(path: Path, times_s: Iterable[float]) -> Iterator[NDArray[np.uint8] | None]:
    """Pictures (H, W, 3) of frames whose times, in growing order, :meth:`Video.frames` told; None for one that is not
    there.

    Raises
    ------
    InputError
        Missing, or no video.
    """
    with _Decoder(path) as decoder:
        for time_s in times_s:
            found = decoder.forward_to(time_s)
            there = found is not None and found - time_s <= 0.5 / decoder.rate
            yield decoder.picture() if there else None


class _Decoder:
    """Goes through a video; knows the time of the frame that it is at."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._can_seek = True
        self._open()

    def _open(self) -> None:
        if not self._path.exists():
            raise InputError(f"{self._path}: no such file")
        with _silence():
            self._capture = cv2.VideoCapture(str(self._path))
        if not self._capture.isOpened():
            raise InputError(f"{self._path}: is no video that can be read, or is damaged; copy or convert it again")
        rate = self.value(cv2.CAP_PROP_FPS)
        self.rate = rate if 0.1 <= rate <= _MAX_RATE else _FALLBACK_RATE
        self.duration_s = max(0.0, self.value(cv2.CAP_PROP_FRAME_COUNT)) / self.rate
        self.time = -math.inf

    def __enter__(self) -> _Decoder:
        return self

    def __exit__(self, *details: object) -> None:
        self._capture.release()

    def value(self, key: int) -> float:
        """A property of the stream; 0 where it is unknown."""
        found = float(self._capture.get(key))
        return found if math.isfinite(found) else 0.0

    def grab(self) -> float | None:
        """Go to the next frame; its time in seconds, None at the end."""
        if not self._capture.grab():
            return None
        told = self.value(cv2.CAP_PROP_POS_MSEC) / 1000.0
        if told < self.time + _SHORTEST_PERIOD_S and math.isfinite(self.time):  # no time, or one that goes back
            told = self.time + max(_SHORTEST_PERIOD_S, 1.0 / self.rate)
        self.time = told
        return told

    def picture(self) -> NDArray[np.uint8] | None:
        """The frame (H, W, 3), BGR; None where it is damaged."""
        decoded, image = self._capture.retrieve()
        return as_bgr(np.asarray(image), str(self._path)) if decoded and image is not None else None

    def skip(self, count: int) -> float | None:
        """Time of the frame that many after this one."""
        found = None
        for _ in range(count):
            found = self.grab()
            if found is None:
                return None
        return found

    def forward_to(self, time_s: float) -> float | None:
        """Time of the first frame at or after a time; None where there is none."""
        if self._can_seek and time_s - max(self.time, 0.0) > _SEEK_GAP_S and time_s < self.duration_s:
            self._seek(time_s)
        while self.time < time_s - _TOLERANCE_S:
            if self.grab() is None:
                return None
        return self.time

    def _seek(self, time_s: float) -> None:
        """Skip ahead, but not past the time; where the file leads elsewhere, go back and decode all from there on."""
        before = self.time
        self.time = -math.inf
        self._capture.set(cv2.CAP_PROP_POS_MSEC, 1000.0 * (time_s - _SEEK_MARGIN_S))
        landed = self.grab()
        if landed is not None and before < landed < time_s - _TOLERANCE_S:
            return
        self._can_seek = False
        self._capture.release()
        self._open()
        while self.time < before and self.grab() is not None:
            pass


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """What is wrong with a file is told in one line by us, not by the decoder's own log."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)
