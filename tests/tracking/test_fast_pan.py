"""A pan so fast that blur leaves no corners to follow, or only those of players and graphics: the paint goes on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.rig.tripod import Venue
from circlecal.tracking import follower, motion
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.looking import Look, LookedAt, Place
from circlecal.tracking.motion import HeadMotion, move_of_middle
from tests.tracking.scenes import HEAD, SIZE, draw, tripod

STEP = np.array([0.0, 0.005, 0.0])
FRAMES, STEADY = 5, 2


@pytest.fixture(scope="module")
def pictures() -> list[NDArray[np.uint8]]:
    """A pan over the penalty area by 7 px a frame."""
    return [draw(HEAD + k * STEP, np.random.default_rng(1)) for k in range(FRAMES)]


@pytest.mark.parametrize("motion", [None, np.zeros(3)])
def test_a_camera_goes_on_turning_where_no_motion_is_seen(
    motion: NDArray[np.float64] | None, pictures: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = iter(range(1, FRAMES))

    def estimate_motion(*_: object) -> HeadMotion | None:
        if next(seen) < STEADY:
            return HeadMotion(STEP, np.diag([1e-8, 1e-8, 1e-8]), 1.0, 100)
        return None if motion is None else HeadMotion(motion, np.diag([1e-8, 1e-8, 1e-8]), 0.4, 20)

    monkeypatch.setattr(follower, "estimate_motion", estimate_motion)
    monkeypatch.setattr(follower, "SEARCHES", (0,))
    frames = [ClipFrame(k, k / 25.0, picture) for k, picture in enumerate(pictures)]
    found = list(track_frames(frames, Venue("soccer", (tripod(),)), Config()))
    assert {frame.status for frame in found} == {"calibrated"}
    assert len({frame.shot for frame in found}) == 1
    for k, frame in enumerate(found):
        assert frame.head is not None
        assert np.abs(frame.head.values - HEAD - k * STEP).max() < 6e-4


def test_a_camera_goes_on_speeding_up_where_no_motion_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    # by 42 px more from frame to frame
    turned = [np.array([0.0, 0.014 * k * k, 0.0]) for k in range(FRAMES)]
    seen = iter(range(1, FRAMES))
    look = Place.look
    began: list[NDArray[np.float64]] = []
    seen_pictures: list[NDArray[np.uint8]] = []

    def estimate_motion(*_: object) -> HeadMotion | None:
        k = next(seen)
        return HeadMotion(turned[k] - turned[k - 1], np.diag([1e-8, 1e-8, 1e-8]), 1.0, 100) if k < 3 else None

    def note_start(place: Place, picture: LookedAt, head: NDArray[np.float64], *given: Any) -> Look:
        if not (seen_pictures and seen_pictures[-1] is picture.gray):
            seen_pictures.append(picture.gray)
            began.append(head)
        return look(place, picture, head, *given)

    monkeypatch.setattr(follower, "estimate_motion", estimate_motion)
    monkeypatch.setattr(follower, "SHUTTER", 0.0)
    monkeypatch.setattr(Place, "look", note_start)
    pictures = [draw(HEAD + turn, np.random.default_rng(1)) for turn in turned]
    frames = [ClipFrame(k, k / 25.0, picture) for k, picture in enumerate(pictures)]
    found = list(track_frames(frames, Venue("soccer", (tripod(),)), Config()))
    assert {frame.status for frame in found} == {"calibrated"}
    for turn, start in zip(turned[1:], began[1:], strict=True):
        assert np.abs(start - HEAD - turn).max() < 2e-3


@pytest.mark.parametrize("every", [1, 6])
def test_pictures_blur_by_the_way_between_neighbouring_frames_of_the_video(
    every: int, pictures: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch
) -> None:
    blurs: list[NDArray[np.float64]] = []
    look = Place.look

    def note_blur(place: Place, *given: Any) -> Look:
        if len(given) == 5:
            blurs.append(given[-1])
        return look(place, *given)

    monkeypatch.setattr(Place, "look", note_blur)
    frames = [ClipFrame(k * every, k / 25.0, picture) for k, picture in enumerate(pictures[:2])]
    list(track_frames(frames, Venue("soccer", (tripod(),)), Config()))
    assert blurs[-1][0] == pytest.approx(-motion.SHUTTER * 7.0 / every, abs=0.5 / every)


def test_the_middle_of_the_picture_moves_against_the_pan() -> None:
    model, common = tripod().model, tripod().mean
    moved = move_of_middle(np.array([0.0, 1e-3, 0.0]), HEAD, model, common)
    middle = np.array(SIZE) / 2.0 - 0.5
    view, turned = (tripod().view(HEAD + turn, np.zeros((3, 3))) for turn in (np.zeros(3), np.array([0.0, 1e-3, 0.0])))
    ground = view.camera.back_project(middle)[None, :2]
    assert moved == pytest.approx(turned.project(ground)[0] - view.project(ground)[0], abs=0.05)
    assert moved[0] < -1.0
