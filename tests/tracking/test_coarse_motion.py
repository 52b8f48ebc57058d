"""Motion of pictures that a fast pan smears until hardly a corner is left."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.rig.tripod import Venue
from circlecal.tracking import follower
from circlecal.tracking.clip import track_frames
from circlecal.tracking.coarse_motion import coarsen, estimate_coarsely, find_shift
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.motion import HeadMotion, SmallPicture, estimate_motion, find_corners, follow_corners
from circlecal.tracking.results import TrackedFrame
from tests.tracking.scenes import HEAD, SIZE, draw, tripod

PAN = np.array([0.004, 0.12, 0.006])
"""A turn by 180 px of 1280."""
SHUTTER, MOMENTS = 0.5, 12


def surroundings() -> NDArray[np.float64]:
    """Levels, without the mean, of what a camera turns over, twice as wide as a picture in both directions."""
    rng = np.random.default_rng(3)
    rows, columns = 2 * SIZE[1], 2 * SIZE[0]
    rough = cv2.GaussianBlur(rng.normal(0.0, 1.0, (rows, columns)), (0, 0), 3.0)
    return np.asarray(rough / rough.std())


def see(levels: NDArray[np.float64], head: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a picture shows of the surroundings, in whose middle :data:`HEAD` looks."""
    straight, turned = (tripod().view(h, np.zeros((3, 3))).camera for h in (HEAD, head))
    wider = np.array([[1.0, 0.0, SIZE[0] / 2.0], [0.0, 1.0, SIZE[1] / 2.0], [0.0, 0.0, 1.0]])
    way = turned.K @ turned.R @ straight.R.T @ np.linalg.inv(wider @ straight.K)
    return np.asarray(cv2.warpPerspective(levels, way, SIZE, flags=cv2.INTER_LINEAR))


def smear(levels: NDArray[np.float64], head: NDArray[np.float64], change: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A gray picture of noise and surroundings, taken while the head changed."""
    moments = SHUTTER * (np.arange(MOMENTS) / (MOMENTS - 1) - 0.5)
    seen = np.mean([see(levels, head + t * change) for t in moments], axis=0)
    noise = np.random.default_rng(4).normal(0.0, 2.0, seen.shape)
    return np.asarray(np.clip(100.0 + 30.0 * seen + noise, 0, 255), np.uint8)


def test_windows_tell_a_pan_of_which_corners_tell_nothing() -> None:
    levels, model = surroundings(), tripod()
    pictures = [SmallPicture.of(smear(levels, HEAD + k * PAN, PAN)) for k in (0, 1)]
    rng = np.random.default_rng(5)
    corners = follow_corners(*pictures, find_corners(pictures[0]))
    by_corners = estimate_motion(corners, HEAD, model.model, model.mean, rng, pictures[0].factor)
    assert by_corners is None or by_corners.inliers < follower.MANY_CORNERS
    first, second = (coarsen(picture) for picture in pictures)
    expected = PAN * (0.0, 0.7, 0.0)
    found = estimate_coarsely(first, second, expected, HEAD, model.model, model.mean, rng)
    assert found is not None
    # the drawn pictures lack what lens and lever make of such a turn, 2 % of it
    assert np.abs((found.change - PAN) * (640.0, 1500.0, 1500.0)).max() < 6.0


def test_most_windows_may_move_otherwise() -> None:
    levels, model = surroundings(), tripod()
    still, turned = (smear(levels, HEAD + k * PAN, PAN) for k in (0, 1))
    # strips below the upper part move by 12 px less and by 12 px more
    for first_row, off in ((0.44, 12.0), (0.72, -24.0)):
        rows = slice(round(first_row * SIZE[1]), None)
        turned[rows] = cv2.warpAffine(turned, np.array([[1.0, 0.0, off], [0.0, 1.0, 0.0]]), SIZE)[rows]
    first, second = (coarsen(SmallPicture.of(picture)) for picture in (still, turned))
    found = estimate_coarsely(first, second, PAN, HEAD, model.model, model.mean, np.random.default_rng(5))
    assert found is not None
    assert found.share < 0.5
    assert np.abs((found.change - PAN) * (640.0, 1500.0, 1500.0)).max() < 6.0


def test_pictures_of_other_things_tell_no_motion() -> None:
    levels, model = surroundings(), tripod()
    rng = np.random.default_rng(5)
    first, second = (coarsen(SmallPicture.of(smear(part, HEAD, PAN))) for part in (levels, levels[::-1, ::-1].copy()))
    assert estimate_coarsely(first, second, np.zeros(3), HEAD, model.model, model.mean, rng) is None


def test_a_strip_that_stands_still_is_no_shift_of_a_fast_pan() -> None:
    rng = np.random.default_rng(6)
    wide = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (180, 400)), (0, 0), 2.0)
    strip = 200.0 * rng.integers(0, 2, (60, 320))
    seen = []
    for first in (0, 40):
        picture = 100.0 + 2.0 * (wide[:, first : first + 320] - wide.mean())
        picture[120:] = strip
        seen.append(coarsen(SmallPicture.of(np.clip(picture, 0, 255).astype(np.uint8))))
    assert find_shift(*seen, np.array([-33.0, 2.0])) == pytest.approx([-40.0, 0.0])


def test_what_is_flat_below_something_rich_has_the_middle_level() -> None:
    rng = np.random.default_rng(8)
    levels = np.full((360, 640), 128, np.uint8)
    levels[:200] = rng.integers(0, 256, (200, 640))
    with np.errstate(all="raise"):
        picture = coarsen(SmallPicture.of(levels))
    assert (np.abs(picture.gray[140:].astype(int) - 128) <= 1).all()


def test_pictures_that_hardly_overlap_are_not_compared() -> None:
    picture = SmallPicture(np.zeros((180, 320), np.uint8), 4.0)
    assert find_shift(picture, picture, np.array([-230.0, 0.0])) is None


def track_smeared(
    monkeypatch: pytest.MonkeyPatch, heads: list[NDArray[np.float64]], searched: int
) -> list[TrackedFrame]:
    """Tracked frames of a pitch before rough surroundings, without a corner, where one frame is searched."""
    levels = surroundings()
    pictures = []
    for head in heads:
        seen = draw(head, np.random.default_rng(1)).astype(np.float64) + 6.0 * see(levels, head)[..., None]
        pictures.append(np.asarray(np.clip(seen, 0, 255), np.uint8))

    def tell_nothing(*_: object) -> HeadMotion | None:
        return None

    monkeypatch.setattr(follower, "estimate_motion", tell_nothing)
    monkeypatch.setattr(follower, "SEARCHES", (searched,))
    monkeypatch.setattr(follower, "SEARCH_EVERY", 1000)
    monkeypatch.setattr(follower, "SHUTTER", 0.0)
    frames = [ClipFrame(k, k / 25.0, picture) for k, picture in enumerate(pictures)]
    return list(track_frames(frames, Venue("soccer", (tripod(),)), Config()))


@pytest.mark.parametrize("searched", [0, 3])
def test_a_camera_that_turns_at_once_is_followed_without_a_corner(
    searched: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # it hardly turns at first: two pictures that are alike would be one
    heads = [HEAD + turn * np.array([0.0, 0.05, 0.0]) for turn in (0.0, 0.02, 1.0, 2.0)]
    found = track_smeared(monkeypatch, heads, searched)
    assert [frame.status for frame in found] == ["calibrated"] * len(heads)
    for frame, head in zip(found, heads, strict=True):
        assert frame.head is not None
        assert np.abs(frame.head.values - head).max() < 1e-3
