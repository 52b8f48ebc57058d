"""Motion of the head from points that move as a turned camera moves them."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from circlecal.tracking import motion
from circlecal.tracking.motion import (
    CornerTrail,
    Flow,
    HeadMotion,
    SmallPicture,
    estimate_motion,
    find_corners,
    follow_corners,
)
from tests.tracking.scenes import HEAD, tripod


def flow_of(change: np.ndarray, rng: np.random.Generator, strange: int, still: int = 0) -> Flow:
    """Corners on the ground before and after a change of the head, some of which move otherwise, or not at all."""
    points = rng.uniform([-50.0, -30.0], [10.0, 30.0], (150, 2))
    before = tripod().view(HEAD, np.zeros((3, 3))).project(points)
    after = tripod().view(HEAD + change, np.zeros((3, 3))).project(points) + rng.normal(0.0, 0.1, (150, 2))
    after[:strange] += rng.normal(0.0, 12.0, (strange, 2))
    after[strange : strange + still] = before[strange : strange + still]
    return Flow(before, after)


def test_most_corners_tell_the_motion() -> None:
    rng = np.random.default_rng(5)
    change = np.array([0.004, 0.012, -0.003])
    model = tripod()
    found = estimate_motion(flow_of(change, rng, 50, 30), HEAD, model.model, model.mean, rng, 2.0)
    assert found is not None
    assert np.abs((found.change - change) * [640.0, 1500.0, 1500.0]).max() < 0.25
    away = found.change - change
    assert away @ np.linalg.solve(found.covariance, away) < 16.0


def test_how_sure_a_motion_is_hangs_on_no_resolution() -> None:
    """Corners that agree leave the floor alone, which is told in reduced pixels."""
    points, change = (
        np.random.default_rng(5).uniform([-50.0, -30.0], [10.0, 30.0], (150, 2)),
        np.array([0.0, 2e-3, 0.0]),
    )

    def sds(size: tuple[int, int]) -> np.ndarray:
        camera = tripod().resize(size)
        head = HEAD + np.array([np.log(size[0] / 1280.0), 0.0, 0.0])
        flow = Flow(*(camera.view(at, np.zeros((3, 3))).project(points) for at in (head, head + change)))
        found = estimate_motion(flow, head, camera.model, camera.mean, np.random.default_rng(1), size[0] / 640.0)
        assert found is not None
        return np.sqrt(np.diag(found.covariance))

    usual = sds((1920, 1080))
    # 0.01 reduced pixels, 0.03 whole ones, at 250 px from the middle, and at a focal length of 2250 px
    assert (usual > 0.9 * np.array([0.03 / 250.0, 0.03 / 2250.0, 0.03 / 2250.0])).all()
    np.testing.assert_allclose(sds((960, 540)), usual, rtol=1e-3)


@pytest.mark.parametrize("axis", range(3))
def test_a_motion_is_wrong_by_a_share_of_itself(axis: int) -> None:
    points = np.random.default_rng(5).uniform([-50.0, -30.0], [10.0, 30.0], (150, 2))

    def tell(size: float) -> HeadMotion:
        change = size * np.eye(3)[axis]
        before, after = (tripod().view(head, np.zeros((3, 3))).project(points) for head in (HEAD, HEAD + change))
        found = estimate_motion(Flow(before, after), HEAD, tripod().model, tripod().mean, np.random.default_rng(1), 2.0)
        assert found is not None
        return found

    still, moved = tell(0.0), tell(0.03)
    more = np.diag(moved.covariance - still.covariance)[axis]
    assert np.sqrt(more) == pytest.approx(motion.BIAS_SHARE * 0.03, rel=0.02)


def test_no_motion_is_told_where_corners_disagree() -> None:
    rng = np.random.default_rng(6)
    model = tripod()
    before = rng.uniform([0.0, 0.0], [1280.0, 720.0], (150, 2))
    wild = Flow(before, before + rng.normal(0.0, 40.0, (150, 2)))
    assert estimate_motion(wild, HEAD, model.model, model.mean, rng, 2.0) is None


def test_a_sharp_score_does_not_take_the_corners_of_a_smeared_picture() -> None:
    rng = np.random.default_rng(7)
    way, shutter = 30, np.full((1, 15), 1.0 / 15.0)
    stands = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (360, 640 + way)), (0, 0), 2.0)
    score = np.kron(rng.integers(0, 2, (4, 20)), np.full((6, 8), 255.0))
    seen = []
    for first in (0, way):
        smeared = cv2.filter2D(stands, -1, shutter)[:, first : first + 640]
        picture = 100.0 + 2.0 * (smeared - smeared.mean())
        picture[20:44, 40:200] = score
        seen.append(SmallPicture.of(np.clip(picture, 0, 255).astype(np.uint8)))
    flow = follow_corners(*seen, find_corners(seen[0]), expected=np.array([-way, 0.0]))
    moved = np.abs(flow.after - flow.before + (way, 0.0)).max(axis=1) < 1.0
    assert np.count_nonzero(moved) > 60


@pytest.mark.parametrize(("way", "searches"), [(3, 3), (30, 5)])
def test_corners_are_followed_for_some_frames_and_looked_for_again_where_the_picture_is_new(
    way: int, searches: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = 10
    stands = np.random.default_rng(8).uniform(0.0, 255.0, (360, 640 + frames * way))
    stands = np.clip(4.0 * (cv2.GaussianBlur(stands, (0, 0), 2.0) - 127.5) + 127.5, 0, 255).astype(np.uint8)
    seen = [SmallPicture.of(np.ascontiguousarray(stands[:, k * way : k * way + 640])) for k in range(frames)]
    looked_at: list[SmallPicture] = []

    def note(picture: SmallPicture) -> np.ndarray:
        looked_at.append(picture)
        return find_corners(picture)

    monkeypatch.setattr(motion, "find_corners", note)
    trail = CornerTrail()
    for first, second in itertools.pairwise(seen):
        flow = trail.follow(first, second, np.array([-float(way), 0.0]))
        assert len(flow.before) > 60
        assert np.abs(flow.after - flow.before + (way, 0.0)).max(axis=1).mean() < 0.1
        # corners that entered with the picture are among them
        assert flow.before[:, 0].max() > 640 - 2 * motion.LARGEST_WAY_PX
    assert len(looked_at) == searches
    trail.forget()
    trail.follow(seen[0], seen[1], np.zeros(2))
    assert looked_at[-1] is seen[0]
