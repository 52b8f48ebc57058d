"""Pictures that a clip shows several times: material of 25 frames per second stored as 50, and frames that were sent
twice.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.first_look import PicturesAt
from circlecal.tracking.motion import SmallPicture
from circlecal.tracking.results import TrackedFrame

BLOCKS, BLOCK_LEVELS = (40, 22), 6.0
"""Blocks of a picture, and how far one may differ on average in a picture that is shown again, gray levels: of clips
that an encoder of strong compression stored twice up to 3.2, of neighbours that are not one picture, of real clips and
rendered ones, 12 and more, since somebody moves somewhere.
"""
MOVED_PX = 0.06
"""How far what is seen may move from a picture to itself, reduced pixels: of pictures stored twice with strong
compression 0.03, once 0.09, of neighbours in a slow zoom 0.15; a slow pan over an empty pitch changes no
block much.
"""
SAMPLE_STEP, SAMPLE_LEVELS = 16, 4.0
"""Every so many-th pixel is compared first, and how far these may differ on average, gray levels: of pictures stored
twice by up to 2.1, of those in a pan by 3 to 13.
"""
PROBES = 9
"""Neighbouring frames from the middle of a clip that tell how often it shows each of its pictures."""


@dataclass(frozen=True)
class _Seen:
    """A picture (H, W, 3) as it is compared."""

    picture: NDArray[np.uint8]

    @cached_property
    def gray(self) -> NDArray[np.uint8]:
        """Reduced (h, w)."""
        return SmallPicture.of(np.asarray(cv2.cvtColor(self.picture, cv2.COLOR_BGR2GRAY), np.uint8)).gray

    def is_again(self, later: _Seen) -> bool:
        """Whether a later picture is this one."""
        if self.picture.shape != later.picture.shape:
            return False
        first, second = (seen.picture[::SAMPLE_STEP, ::SAMPLE_STEP] for seen in (self, later))
        if float(np.mean(cv2.absdiff(first, second))) > SAMPLE_LEVELS:
            return False
        apart = np.asarray(cv2.absdiff(self.gray, later.gray), np.float32)
        if float(cv2.resize(apart, BLOCKS, interpolation=cv2.INTER_AREA).max()) > BLOCK_LEVELS:
            return False
        return _measure_way(self.gray, later.gray) < MOVED_PX


def _measure_way(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    """How far a picture moved or grew as a whole, pixels, in the first order: the largest way of a corner."""
    height, width = first.shape
    by_x, by_y = (cv2.Sobel(first, cv2.CV_32F, *order, ksize=3, scale=0.125).ravel() for order in ((1, 0), (0, 1)))
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height) * height / width)
    by_zoom = by_x * x.ravel() + by_y * y.ravel()
    rows = np.stack([by_x, by_y, by_zoom]).astype(np.float64)
    levels = second.ravel().astype(np.float64) - first.ravel()
    normal = rows @ rows.T + 1e-6 * np.eye(3)
    shift_x, shift_y, growth = np.abs(np.linalg.solve(normal, rows @ levels))
    return float(np.hypot(shift_x + growth, shift_y + growth))


@dataclass(slots=True)
class _Shown:
    """When one picture is shown, numbers and times, seconds, its answer, and whether another picture follows."""

    times: list[tuple[int, float]]
    answer: TrackedFrame | None = None
    is_over: bool = False

    def answers(self) -> Iterator[TrackedFrame]:
        """The answer of each frame."""
        if self.answer is not None:
            for index, time_s in self.times:
                yield replace(self.answer, index=index, time_s=time_s)


def answer_once(
    frames: Iterable[ClipFrame], track: Callable[[Iterator[ClipFrame]], Iterator[TrackedFrame]]
) -> Iterator[TrackedFrame]:
    """Answers of frames, of which those that show one picture have one answer.

    Parameters
    ----------
    frames : iterable of ClipFrame
        In order.
    track : callable
        Gives an answer for each frame that it is given, in order; it is given each picture once, and the numbers that
        the frames would have in a clip of these.
    """
    waiting: deque[_Shown] = deque()

    def single() -> Iterator[ClipFrame]:
        last: _Seen | None = None
        shown, again = _Shown([]), 0
        for frame in frames:
            seen = _Seen(frame.picture)
            if last is not None and last.is_again(seen):
                again += 1
                shown.times.append((frame.index, frame.time_s))
                continue
            shown.is_over = True
            last, shown = seen, _Shown([(frame.index, frame.time_s)])
            waiting.append(shown)
            yield replace(frame, index=frame.index - again)

    answered: deque[_Shown] = deque()
    for answer in track(single()):
        answered.append(waiting.popleft())
        answered[-1].answer = answer
        while answered and answered[0].is_over:
            yield from answered.popleft().answers()
    for shown in answered:
        yield from shown.answers()


def measure_period(pictures_at: PicturesAt, time_s: float, period_s: float) -> float:
    """Time between two pictures of a clip, seconds, whose frames are so far from each other, about a time: longer than
    between its frames where it shows each picture several times; as for frames where nothing moves.
    """
    times: Sequence[float] = [time_s + (k + 0.25) * period_s for k in range(PROBES)]
    probes = [_Seen(picture) for picture in pictures_at(times) if picture is not None]
    changes, last = 0, probes[0] if probes else None
    for seen in probes[1:]:
        if last is not None and not last.is_again(seen):
            changes, last = changes + 1, seen
    return period_s if changes < PROBES // 4 else period_s * (len(probes) - 1) / changes
