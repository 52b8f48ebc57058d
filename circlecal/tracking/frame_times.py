"""Numbers of the frames of a clip, counted as they are shown, however their rate varies."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from circlecal.errors import InputError
from circlecal.pictures.video import Video

_TOLERANCE_S = 0.0005
"""Half of the shortest time between two frames of a video, seconds: times in ids are rounded to milliseconds."""


@dataclass(frozen=True, slots=True)
class FrameTimes:
    """When the frames of a video, or of a part of it, are shown.

    Attributes
    ----------
    rate : float
        Frames per second, by which they are counted where the file tells no times.
    times_s : tuple of float
        Times of frames that follow each other, seconds; empty where the file tells none.
    first : int
        Number of the first of these in the video, from 0.
    """

    rate: float
    times_s: tuple[float, ...] = ()
    first: int = 0

    @classmethod
    def of_video(cls, video: Video, end_s: float = math.inf) -> FrameTimes:
        """The times of a video, as far as to a time, seconds; none of one that cannot be read any more."""
        try:
            return cls(video.rate, video.list_times(end_s))
        except InputError:  # told by whoever decodes it
            return cls(video.rate)

    def number_at(self, time_s: float) -> int:
        """Number of the frame that is shown at a time, seconds."""
        if not self.times_s:
            return max(0, round(time_s * self.rate))
        return self.first + max(0, bisect_right(self.times_s, time_s + _TOLERANCE_S) - 1)

    def number_from(self, time_s: float) -> int:
        """Number of the first frame that is not before a time, seconds."""
        if not self.times_s:
            return max(0, math.ceil((time_s - _TOLERANCE_S) * self.rate))
        return self.first + bisect_left(self.times_s, time_s - _TOLERANCE_S)

    def time_of(self, number: int) -> float:
        """Time of a frame, seconds; of one that is not among these that of the nearest."""
        if not self.times_s:
            return number / self.rate
        return self.times_s[min(max(number - self.first, 0), len(self.times_s) - 1)]

    def cut(self, low: int, high: int) -> FrameTimes:
        """Those of the frames from number ``low`` to ``high``."""
        if not self.times_s:
            return self
        start = min(max(low - self.first, 0), len(self.times_s) - 1)
        return FrameTimes(self.rate, self.times_s[start : high - self.first + 1], self.first + start)
