"""The smoother against the dense solution of the same least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.tracking.smoother import (
    JERK,
    LEAST_JERK_SHARE,
    Chain,
    Smoothed,
    Solution,
    _estimate_steadiness,
    smooth_robustly,
)

NO_INERTIA = np.zeros((0, 3))


def positive(rng: np.random.Generator, count: int) -> np.ndarray:
    root = rng.normal(size=(count, 3, 3))
    return root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(3)


def test_heads_and_covariances_are_those_of_the_dense_system() -> None:
    rng = np.random.default_rng(4)
    count = 7
    heads, seen = rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    information, precision = positive(rng, count), positive(rng, count - 1)
    information[3] = 0.0
    changes = rng.normal(size=(count - 1, 3))
    toward = np.einsum("nij,nj->ni", information, seen - heads)
    steadiness = rng.uniform(0.1, 2.0, (count - 3, 3))
    found = Chain(heads, information, toward, changes, precision).solve(steadiness)
    matrix, right = np.zeros((3 * count, 3 * count)), np.zeros(3 * count)
    for k in range(count):
        own = slice(3 * k, 3 * k + 3)
        matrix[own, own] += information[k]
        right[own] += information[k] @ seen[k]
    for k in range(count - 1):
        rows = np.zeros((3, 3 * count))
        rows[:, 3 * k : 3 * k + 3], rows[:, 3 * k + 3 : 3 * k + 6] = -np.eye(3), np.eye(3)
        matrix += rows.T @ precision[k] @ rows
        right += rows.T @ precision[k] @ changes[k]
    for k in range(count - 3):
        rows = np.zeros((3, 3 * count))
        rows[:, 3 * k : 3 * k + 12] = np.kron(JERK, np.eye(3))
        matrix += rows.T @ np.diag(steadiness[k]) @ rows
    np.testing.assert_allclose(found.heads.ravel(), np.linalg.solve(matrix, right), atol=1e-7)
    covariance = np.linalg.inv(matrix)
    for k in range(count):
        own = slice(3 * k, 3 * k + 3)
        np.testing.assert_allclose(found.covariances[k], covariance[own, own], atol=1e-7)


def test_a_motion_of_players_does_not_shake_the_camera() -> None:
    rng = np.random.default_rng(2)
    count, step, noise = 40, np.array([0.0, 0.002, 0.0]), 2e-4
    true = np.arange(count)[:, None] * step
    heads = true + rng.normal(0.0, noise, true.shape)
    information = np.tile(np.eye(3) / noise**2, (count, 1, 1))
    precision = np.tile(np.eye(3) / (0.5 * noise) ** 2, (count - 1, 1, 1))
    changes = np.diff(true, axis=0) + rng.normal(0.0, 0.5 * noise, (count - 1, 3))
    changes[20, 1] += 20.0 * noise
    chain = Chain(heads, information, np.zeros((count, 3)), changes, precision)
    plain, found = chain.solve(NO_INERTIA), smooth_robustly(chain, np.zeros((count, 3, 0)))
    near = slice(19, 23)
    assert np.abs(plain.heads - true)[near, 1].max() > 4.0 * noise
    assert np.abs(found.heads - true)[near, 1].max() < 2.0 * noise
    # where all motions agree with the paint nothing is lost
    changes[20, 1] -= 20.0 * noise
    plain, found = chain.solve(NO_INERTIA), smooth_robustly(chain, np.zeros((count, 3, 0)))
    assert np.abs(found.heads - true).max() < np.abs(plain.heads - true).max()


def test_a_head_has_inertia() -> None:
    rng = np.random.default_rng(5)
    count, noise = 120, 1e-5
    # stands, and from the middle on pans as an operator does
    at = np.maximum(np.arange(count) - 60.0, 0.0)
    true = np.stack([np.zeros(count), 0.01 * (1.0 - np.cos(at / 25.0)), 0.001 * np.sin(at / 20.0)], axis=1)
    heads = true + rng.normal(0.0, 10.0 * noise, true.shape)
    information = np.tile(np.eye(3) / (10.0 * noise) ** 2, (count, 1, 1))
    precision = np.tile(np.eye(3) / noise**2, (count - 1, 1, 1))
    changes = np.diff(true, axis=0) + rng.normal(0.0, noise, (count - 1, 3))
    chain = Chain(heads, information, np.zeros((count, 3)), changes, precision)

    def shake(found: Smoothed | Solution) -> float:
        return float(np.sqrt(np.mean(np.diff(found.heads - true, 2, axis=0) ** 2)))

    plain, found = chain.solve(NO_INERTIA), smooth_robustly(chain, np.zeros((count, 3, 0)))
    assert shake(found) < 0.5 * shake(plain)
    assert np.abs(found.heads - true).max() < 1.2 * np.abs(plain.heads - true).max()


def test_heads_follow_what_all_frames_share_as_their_paint_pulls_them() -> None:
    rng = np.random.default_rng(5)
    # of so few frames nothing is known of the inertia, whose weight would follow too
    count, noise, step = len(JERK) - 1, 2e-4, 1e-9
    heads = np.cumsum(rng.normal(0.0, 1e-3, (count, 3)), axis=0)
    information = positive(rng, count) / noise**2
    information[1] = 0.0
    pull = np.einsum("nij,njk->nik", information, rng.normal(size=(count, 3, 2)))
    changes, precision = np.diff(heads, axis=0), positive(rng, count - 1) / noise**2
    chain = Chain(heads, information, np.zeros((count, 3)), changes, precision)
    still = smooth_robustly(chain, pull)
    for k in range(2):
        moved = smooth_robustly(replace(chain, toward=step * pull[..., k]), pull)
        np.testing.assert_allclose((moved.heads - still.heads) / step, still.by_common[..., k], rtol=1e-3, atol=1e-3)
    # what is not seen goes with its neighbours
    assert np.abs(still.by_common[1]).max() > 0.1


def _spread_of_draws(alike: bool) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations that a chain tells, and those of its heads over many draws of paint that is four times as
    good as it says; either off alike in all frames, or in each by its own.
    """
    rng = np.random.default_rng(8)
    count, noise, share, draws = 60, 1e-4, 0.25, 400
    information = np.tile(np.eye(3) / noise**2, (count, 1, 1))
    information[20:26] = 0.0
    precision = np.tile(np.eye(3) / (0.3 * noise) ** 2, (count - 1, 1, 1))
    away, told = [], np.zeros(0)
    for _ in range(draws):
        off = np.sqrt(share) * noise * np.broadcast_to(rng.normal(size=(1 if alike else count, 3)), (count, 3))
        changes = rng.normal(0.0, 0.3 * noise, (count - 1, 3))
        toward = np.einsum("nij,nj->ni", information, off)
        chain = Chain(np.zeros((count, 3)), information, toward, changes, precision)
        found = smooth_robustly(chain, np.zeros((count, 3, 0)), share)
        away.append(found.heads)
        told = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    return told, np.sqrt(np.mean(np.square(away), axis=0))


def test_whole_covariances_are_those_of_paint_that_is_better_than_it_says() -> None:
    told, drawn = _spread_of_draws(alike=True)
    # what frames repeat is most of it, and their own noise is counted beside it
    assert np.all(told > 0.9 * drawn) and np.all(told < 1.5 * drawn)
    told_of_noise, drawn_of_noise = _spread_of_draws(alike=False)
    np.testing.assert_allclose(told_of_noise, told, rtol=0.1)
    assert np.all(drawn_of_noise < told_of_noise)
    # frames without paint are told by their neighbours
    assert told[20:26].max() < 1.5 * told[10:15].max()


def test_covariances_of_paint_that_is_better_than_it_says_are_those_of_the_dense_system() -> None:
    rng = np.random.default_rng(4)
    # of so few frames nothing is known of the inertia, and all motions agree with the paint
    count, share = len(JERK) - 1, 0.2
    heads, information, precision = rng.normal(size=(count, 3)), positive(rng, count), positive(rng, count - 1)
    chain = Chain(heads, information, np.zeros((count, 3)), np.diff(heads, axis=0), precision)
    found = smooth_robustly(chain, np.zeros((count, 3, 0)), share)
    paint, root = np.zeros((3 * count, 3 * count)), np.zeros((3 * count, 3))
    for k in range(count):
        own = slice(3 * k, 3 * k + 3)
        paint[own, own] = information[k]
        root[own] = np.linalg.cholesky(information[k])
    matrix = paint.copy()
    for k in range(count - 1):
        rows = np.zeros((3, 3 * count))
        rows[:, 3 * k : 3 * k + 3], rows[:, 3 * k + 3 : 3 * k + 6] = -np.eye(3), np.eye(3)
        matrix += rows.T @ precision[k] @ rows
    inverse = np.linalg.inv(matrix)
    by_paint = inverse @ paint
    noise = by_paint @ np.linalg.inv(paint) @ by_paint.T
    # what the motions bring, the noise of the paint, and what it repeats in all frames
    whole = inverse - noise + share * noise + share * inverse @ root @ root.T @ inverse
    for k in range(count):
        own = slice(3 * k, 3 * k + 3)
        np.testing.assert_allclose(found.covariances[k], whole[own, own], rtol=0.02, atol=1e-4)


def test_the_noise_of_a_third_difference_is_that_of_three_motions() -> None:
    variance = np.array([1.0, 3.0, 7.0])
    precision = np.eye(3) / variance[:, None, None]
    # of a head that stands still a thousandth of what the motions say is taken for their noise
    (told,) = _estimate_steadiness(np.zeros((len(JERK), 3)), precision)
    least = LEAST_JERK_SHARE * 1e-3 * (variance[0] + 4.0 * variance[1] + variance[2])
    np.testing.assert_allclose(1.0 / told, least)
