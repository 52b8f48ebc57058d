"""A tripod that one still view leaves uncertain: the head that was found in a picture follows it."""

import numpy as np
import pytest

from circlecal.tracking.head_fit import follow_common


def test_what_the_head_makes_up_for_is_no_spread():
    rng = np.random.default_rng(1)
    by_own = rng.normal(size=(40, 3))
    made_up = rng.normal(size=(3, 2))
    own = rng.normal(size=(40, 1))
    by_common = np.column_stack([by_own @ made_up, own])
    left = by_common + by_own @ follow_common(by_own, by_common)
    assert left[:, :2] == pytest.approx(0.0, abs=1e-12)
    assert by_own.T @ left[:, 2] == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(left[:, 2]) > 0.5 * np.linalg.norm(own)


def test_fewer_places_than_unknowns_say_nothing():
    assert not follow_common(np.ones((2, 3)), np.ones((2, 4))).any()


def test_a_known_head_goes_on_following_what_it_followed():
    rng = np.random.default_rng(2)
    by_own, by_common, prior = rng.normal(size=(40, 3)), rng.normal(size=(40, 4)), 1e4 * np.eye(3)
    free = follow_common(by_own, by_common)
    # what the paint says again changes nothing, and a head that is known better than the paint tells it goes its way
    assert follow_common(by_own, by_common, prior, free) == pytest.approx(free, abs=1e-9)
    other = rng.normal(size=(3, 4))
    assert follow_common(by_own, by_common, prior, other) == pytest.approx(other, abs=0.1)
    assert np.abs(follow_common(by_own, by_common, prior)).max() < 0.1
