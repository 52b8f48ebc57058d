"""Motion of the head from points that move as a turned camera moves them."""

from __future__ import annotations

import numpy as np

from circlecal.tracking.motion import Flow, estimate_motion
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


def test_no_motion_is_told_where_corners_disagree() -> None:
    rng = np.random.default_rng(6)
    model = tripod()
    before = rng.uniform([0.0, 0.0], [1280.0, 720.0], (150, 2))
    wild = Flow(before, before + rng.normal(0.0, 40.0, (150, 2)))
    assert estimate_motion(wild, HEAD, model.model, model.mean, rng, 2.0) is None
