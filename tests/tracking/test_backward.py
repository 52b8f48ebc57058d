"""Frames before the one in which the camera is found are followed backwards from it, up to the cut and no further."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.rig.tripod import Venue
from circlecal.synthetic.optics import motion_kernel
from circlecal.tracking import follower
from circlecal.tracking.clip import track_frames
from circlecal.tracking.clock import StageClock
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.first_look import suit_tracking
from circlecal.tracking.follower import Follower, KnownHead
from circlecal.tracking.frame_paint import HeadedFrame
from circlecal.tracking.head_fit import HeadFit
from circlecal.tracking.head_path import HeadPath
from circlecal.tracking.looking import LookedAt, Place
from circlecal.tracking.results import TrackedFrame
from circlecal.tracking.seen_paint import MeasuredFrame
from tests.tracking.scenes import HEAD, SIZE, draw, template, tripod

STEP = np.array([0.0, 0.002, 0.0])
FOREIGN, PITCH = 2, 4


@pytest.fixture(scope="module")
def pictures() -> list[NDArray[np.uint8]]:
    """A slow pan over a pitch."""
    return [draw(HEAD + k * STEP, np.random.default_rng(1)) for k in range(PITCH)]


def track(monkeypatch: pytest.MonkeyPatch, pictures: list[NDArray[np.uint8]], searched: int) -> list[TrackedFrame]:
    """Tracked frames, where the camera is searched for in one frame after a cut alone."""
    monkeypatch.setattr(follower, "SEARCHES", (searched,))
    monkeypatch.setattr(follower, "SEARCH_EVERY", 1000)
    frames = [ClipFrame(k, k / 25.0, picture) for k, picture in enumerate(pictures)]
    return list(track_frames(frames, Venue("soccer", (tripod(),)), Config()))


def test_frames_before_the_camera_is_found_are_answered(
    monkeypatch: pytest.MonkeyPatch, pictures: list[NDArray[np.uint8]]
) -> None:
    frames = track(monkeypatch, pictures, PITCH - 2)
    assert [frame.status for frame in frames] == ["calibrated"] * PITCH
    for k, frame in enumerate(frames):
        assert frame.head is not None
        assert np.abs(frame.head.values - HEAD - k * STEP).max() < 4e-4
    assert len({frame.shot for frame in frames}) == 1
    assert "motion" in frames[0].carriers
    assert "motion" not in frames[PITCH - 2].carriers


def test_the_way_back_ends_at_a_cut(monkeypatch: pytest.MonkeyPatch, pictures: list[NDArray[np.uint8]]) -> None:
    crowd = np.random.default_rng(2).integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
    frames = track(monkeypatch, [crowd] * FOREIGN + pictures, 2)
    assert [frame.status for frame in frames] == ["refused"] * FOREIGN + ["calibrated"] * PITCH
    assert {frame.code for frame in frames[:FOREIGN]} == {"lost"}
    assert frames[FOREIGN - 1].shot < frames[FOREIGN].shot


def test_frames_whose_paint_is_in_place_are_answered_before_a_cut_that_looks_alike(
    monkeypatch: pytest.MonkeyPatch, pictures: list[NDArray[np.uint8]]
) -> None:
    confirm = Place.is_confirmed

    def confirm_first(place: Place, measured: MeasuredFrame, fit: HeadFit) -> bool:
        return confirm(place, measured, fit) and abs(fit.head[1] - HEAD[1]) < 0.5 * STEP[1]

    monkeypatch.setattr(Place, "is_confirmed", confirm_first)
    monkeypatch.setattr(LookedAt, "differs_from", lambda *_: False)
    crowd = np.random.default_rng(2).integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
    frames = track(monkeypatch, [*pictures, crowd], 0)
    assert [frame.status for frame in frames] == ["calibrated"] * PITCH + ["refused"]
    assert [frame.shot for frame in frames] == [0] * PITCH + [1]


def test_few_pictures_are_kept_for_the_way_back(
    monkeypatch: pytest.MonkeyPatch, pictures: list[NDArray[np.uint8]]
) -> None:
    monkeypatch.setattr(follower, "BACKWARD_BYTES", 2 * SIZE[0] * SIZE[1])
    frames = track(monkeypatch, pictures, PITCH - 1)
    assert [frame.status for frame in frames] == ["refused"] * (PITCH - 3) + ["calibrated"] * 3


def test_known_heads_on_both_sides_of_a_cut_are_followed_without_a_search(
    monkeypatch: pytest.MonkeyPatch, pictures: list[NDArray[np.uint8]]
) -> None:
    def search(*_: object) -> None:
        raise AssertionError("searched for a camera that is known")

    monkeypatch.setattr(Place, "find", search)
    crowd = np.random.default_rng(2).integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
    clip = [*pictures[:2], crowd, *pictures[2:]]
    known = {0: KnownHead(HEAD), len(clip) - 1: KnownHead(HEAD + (PITCH - 1) * STEP)}
    config = suit_tracking(Config(), None)
    followed = Follower(Venue("soccer", (tripod(),)), config, template(), StageClock(), known)
    entries = [followed.follow(ClipFrame(k, k / 25.0, picture)) for k, picture in enumerate(clip)]
    assert [entry.is_confirmed for entry in entries] == [True, True, False, True, True]


def test_what_a_known_pan_smears_is_not_expected_where_a_known_head_is_looked_for(
    pictures: list[NDArray[np.uint8]],
) -> None:
    way = np.array([45.0, 0.0])
    smeared = np.asarray(cv2.filter2D(pictures[0], -1, motion_kernel(float(way[0]), 0.0)), np.uint8)
    config = suit_tracking(Config(), None)
    untold, told = (
        Follower(Venue("soccer", (tripod(),)), config, template(), StageClock(), {0: KnownHead(HEAD, blur)}).follow(
            ClipFrame(0, 0.0, smeared)
        )
        for blur in (None, way)
    )
    assert told.is_confirmed
    assert told.painted > 36
    assert told.expected < untold.expected - 10


def test_how_smeared_a_frame_beside_a_gap_is_its_neighbour_tells() -> None:
    turned = np.array([0.0, 0.01, 0.0])
    seen = MeasuredFrame.unseen(np.zeros(1, np.int_))
    times = (0.0, 0.1, 0.9, 2.0)
    path = HeadPath.of([HeadedFrame(f"{t:.3f}", HEAD + (t > 0.05) * turned, seen) for t in times])
    blur = path.blur_at_gap(0.1, tripod(), 0.04)
    assert blur is not None
    assert abs(blur[0]) == pytest.approx(0.5 * 0.04 / 0.1 * 0.01 * 1500.0, rel=0.1)
    assert path.blur_at_gap(0.9, tripod(), 0.04) is None
