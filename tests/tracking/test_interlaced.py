"""Clips whose frames hold two fields of different moments."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import load_config
from circlecal.pictures.interlacing import join_fields
from circlecal.rig.tripod import Venue
from circlecal.tracking import survey
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame
from tests.tracking.scenes import HEAD, draw, tripod

TURN = np.array([0.0, 0.012, 0.0])
"""How far the head turns from one frame to the next, 18 px."""


@pytest.fixture(scope="module")
def woven() -> list[NDArray[np.uint8]]:
    """Three frames of a pan; the odd rows are half a frame younger than the even ones."""
    rng = np.random.default_rng(1)
    frames = [draw(HEAD + TURN * (k - 0.25), rng) for k in range(3)]
    for k, frame in enumerate(frames):
        frame[1::2] = draw(HEAD + TURN * (k + 0.25), rng)[1::2]
    return frames


def test_both_fields_count_for_the_moment_between_them(woven: list[NDArray[np.uint8]]) -> None:
    venue = Venue("soccer", (tripod(),))
    found = list(track_frames((ClipFrame(k, k / 25.0, f) for k, f in enumerate(woven)), venue, load_config()))
    assert [frame.status for frame in found] == ["calibrated"] * 3
    for k, frame in enumerate(found):
        assert frame.head is not None
        assert (frame.head.pan_rad, frame.head.tilt_rad) == pytest.approx(tuple(HEAD[1:] + TURN[1:] * k), abs=2.5e-4)


@pytest.mark.parametrize("is_joined", [True, False])
def test_a_survey_sees_pictures_of_one_moment(
    woven: list[NDArray[np.uint8]], is_joined: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[NDArray[np.uint8]] = []

    def keep(picture: NDArray[np.uint8], *_: object) -> None:
        seen.append(picture)
        raise StopIteration

    def pictures_at(_: object) -> Iterator[NDArray[np.uint8]]:
        return iter(woven)

    monkeypatch.setattr(survey.LookedAt, "of", keep)
    given = load_config()
    config = given.model_copy(update={"mask": given.mask.model_copy(update={"deinterlace": is_joined})})
    with pytest.raises(StopIteration):
        survey.survey_clip(pictures_at, 1.0, config)
    np.testing.assert_array_equal(seen[0], join_fields(woven[0]) if is_joined else woven[0])
    assert (seen[0] is woven[0]) != is_joined
