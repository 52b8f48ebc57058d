"""Clips that show every picture several times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.rig.tripod import Venue
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.twins import answer_once, measure_period
from tests.tracking.scenes import HEAD, draw, tripod

STEP = np.array([0.0, 0.03, 0.0])
"""A fast pan: 45 px a picture."""


def _encode_again(picture: NDArray[np.uint8], seed: int) -> NDArray[np.uint8]:
    """The picture as an encoder leaves it the second time: a level more or less here and there."""
    off = np.random.default_rng(seed).integers(-1, 2, picture.shape)
    return np.clip(picture.astype(np.int16) + off, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def pan() -> list[NDArray[np.uint8]]:
    """Pictures of a pan that speeds up."""
    return [draw(HEAD + k * k / 4.0 * STEP, np.random.default_rng(k)) for k in range(5)]


def _show_twice(pictures: Sequence[NDArray[np.uint8]]) -> list[ClipFrame]:
    twice = [shown for k, picture in enumerate(pictures) for shown in (picture, _encode_again(picture, k))]
    return [ClipFrame(k + 7, k / 50.0, picture) for k, picture in enumerate(twice)]


def test_equal_pictures_have_equal_answers(pan: list[NDArray[np.uint8]]) -> None:
    found = list(track_frames(_show_twice(pan), Venue("soccer", (tripod(),)), Config()))
    assert [(frame.index, round(50.0 * frame.time_s)) for frame in found] == [(k + 7, k) for k in range(10)]
    assert {frame.status for frame in found} == {"calibrated"} and len({frame.shot for frame in found}) == 1
    for k, (first, second) in enumerate(zip(found[::2], found[1::2], strict=True)):
        assert first.head is not None and second.head is not None
        assert (first.head.values == second.head.values).all()
        assert (first.head.covariance == second.head.covariance).all()
        assert np.abs(first.head.values - HEAD - k * k / 4.0 * STEP).max() < 1e-3


def test_pictures_are_numbered_as_if_each_were_shown_once(pan: list[NDArray[np.uint8]]) -> None:
    """By the numbers it is told how far a frame is smeared: its shutter is open for half of the time to the next."""
    numbers: list[int] = []
    frames = _show_twice(pan)
    told = list(answer_once(frames, lambda distinct: _count(distinct, numbers)))  # type: ignore[arg-type]
    assert numbers == [7, 8, 9, 10, 11]
    assert [frame.index for frame in told] == [frame.index for frame in frames]


def test_a_slow_pan_over_an_empty_pitch_shows_other_pictures() -> None:
    moved = [draw(HEAD + k * 0.4 / np.exp(HEAD[0]) * np.eye(3)[1], np.random.default_rng(k)) for k in range(3)]
    counted: list[int] = []
    list(answer_once([ClipFrame(k, k / 25.0, p) for k, p in enumerate(moved)], lambda f: _count(f, counted)))  # type: ignore[arg-type]
    assert counted == [0, 1, 2]


def _count(frames: Iterator[ClipFrame], counted: list[int]) -> Iterator[ClipFrame]:
    for frame in frames:
        counted.append(frame.index)
        yield frame


@pytest.mark.parametrize(("times", "expected_s"), [(1, 0.02), (2, 0.04)])
def test_the_time_between_pictures_is_told_by_those_that_differ(
    times: int, expected_s: float, pan: list[NDArray[np.uint8]]
) -> None:
    shown = [pan[(k // times) % len(pan)] for k in range(200)]

    def pictures_at(times_s: Sequence[float]) -> Iterator[NDArray[np.uint8]]:
        return (shown[int(np.ceil(time_s * 50.0))] for time_s in times_s)

    assert measure_period(pictures_at, 1.0, 0.02) == pytest.approx(expected_s)
    assert measure_period(lambda times_s: iter([pan[0]] * len(times_s)), 1.0, 0.02) == 0.02
    assert measure_period(lambda times_s: iter([None] * len(times_s)), 1.0, 0.02) == 0.02
