"""Frames of one camera by where their cameras stand."""

import numpy as np
import pytest

from circlecal.rig.positions import _find_largest_group, group_positions

MAIN, GOAL = np.array([3.0, 62.0, -15.0]), np.array([-75.0, 1.0, -12.0])


def drawn(center, sds, rng, count):
    toward = center / np.linalg.norm(center)
    root = np.linalg.qr(np.column_stack([toward, np.eye(3)[:, :2]]))[0]
    positions, covariances = [], []
    for _ in range(count):
        covariance = root @ np.diag(np.square(sds)) @ root.T
        positions.append(rng.multivariate_normal(center, covariance))
        covariances.append(covariance)
    return positions, covariances


def test_two_cameras_and_one_that_is_wrong():
    rng = np.random.default_rng(0)
    main, goal = drawn(MAIN, (2.0, 0.2, 0.2), rng, 12), drawn(GOAL, (3.0, 0.3, 0.3), rng, 5)
    wrong = [np.array([10.0, 90.0, -22.0])], [0.01 * np.eye(3)]
    groups, turned = group_positions(np.array(main[0] + goal[0] + wrong[0]), np.array(main[1] + goal[1] + wrong[1]), 2)
    assert (groups[:12] == 0).all()
    assert (groups[12:17] == 1).all()
    assert groups[17] == -1
    assert not turned.any()


def test_turned_positions_agree():
    rng = np.random.default_rng(1)
    positions, covariances = drawn(GOAL, (1.0, 0.3, 0.3), rng, 6)
    positions = [p * np.array([-1, -1, 1]) if k % 2 else p for k, p in enumerate(positions)]
    groups, turned = group_positions(np.array(positions), np.array(covariances), 2)
    assert (groups == 0).all()
    assert len(set(turned[::2])) == len(set(turned[1::2])) == 1
    assert turned[0] != turned[1]


def test_a_vague_position_goes_where_it_is_likely_and_founds_nothing():
    rng = np.random.default_rng(2)
    main = drawn(MAIN, (0.3, 0.2, 0.2), rng, 4)
    vague = [MAIN + np.array([8.0, 10.0, -3.0])], [np.diag([100.0, 150.0, 20.0])]
    groups, _ = group_positions(np.array(main[0] + vague[0]), np.array(main[1] + vague[1]), 2)
    assert (groups == 0).all()
    many_vague = np.tile(vague[1][0], (2, 1, 1))
    assert set(group_positions(np.array([MAIN, -3 * GOAL]), many_vague * 0.01, 2)[0]) == {-1}


def test_nothing_to_group():
    assert group_positions(np.zeros((0, 3)), np.zeros((0, 3, 3)))[0].shape == (0,)
    assert group_positions(MAIN[None], np.eye(3)[None])[0].tolist() == [-1]
    assert group_positions(MAIN[None], np.eye(3)[None], 1)[0].tolist() == [0]


def test_what_a_turned_position_says_is_turned_with_it():
    """Two frames of a camera that leave open how far it stands along one way are as vague along that together."""
    _, (covariance,) = drawn(np.array([-40.0, 45.0, -12.0]), (3.0, 0.3, 0.3), np.random.default_rng(4), 1)
    place, turn = np.array([-40.0, 45.0, -12.0]), np.array([-1.0, -1.0, 1.0])
    _, fused, agree = _find_largest_group(
        np.array([place, turn * place]), np.array([covariance, covariance * np.outer(turn, turn)])
    )
    assert agree.all()
    np.testing.assert_allclose(fused, covariance / 2.0, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("surest", [0, 3])
def test_most_of_a_group_are_not_turned(surest):
    """Also where the surest of them sees the field turned: it founds the group, and a tripod has the others' frames."""
    positions = np.array([[-117.3, 1.1, -38.8], [-117.2, 1.2, -39.0], [-117.4, 1.1, -39.0], [117.3, -1.2, -39.0]])
    covariances = np.array([(0.5 if k == surest else 1.0) * np.eye(3) for k in range(4)])
    groups, turned = group_positions(positions, covariances, 2)
    assert (groups == 0).all()
    assert turned.tolist() == [False, False, False, True]
