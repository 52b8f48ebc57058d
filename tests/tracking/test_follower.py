"""What is kept of a frame that is followed, and how far from where it is expected its head is looked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from circlecal.config import Config
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import COMMON, Venue
from circlecal.tracking.clock import StageClock
from circlecal.tracking.entry import ClipFrame, Entry
from circlecal.tracking.first_look import suit_tracking
from circlecal.tracking.follower import HEAD_SD, Follower, KnownHead
from circlecal.tracking.head_fit import HeadFit
from circlecal.tracking.looking import Look, LookedAt, Place
from circlecal.tracking.motion import HeadMotion
from circlecal.tracking.seen_paint import MeasuredFrame
from tests.tracking.scenes import HEAD, SIZE, draw, measure_ideal, template, tripod

STEP = np.array([0.0, 0.002, 0.0])
PAN = 4


def follower_of(known: dict[int, KnownHead]) -> Follower:
    config = suit_tracking(Config(), None)
    return Follower(Venue("soccer", (tripod(),)), config, template(), StageClock(), known)


def test_motions_of_frames_that_are_followed_backwards_lead_from_each_to_the_next() -> None:
    follower = follower_of({PAN - 1: KnownHead(HEAD + (PAN - 1) * STEP)})
    pictures = [draw(HEAD + k * STEP, np.random.default_rng(1)) for k in range(PAN)]
    entries = [follower.follow(ClipFrame(k, k / 25.0, picture)) for k, picture in enumerate(pictures)]
    assert all(entry.place is not None for entry in entries)
    for entry in entries[1:]:
        assert entry.motion is not None
        assert np.abs(entry.motion.change - STEP)[1:].max() < 5e-4


def test_a_head_that_was_searched_for_is_told_by_its_paint_alone() -> None:
    """Nothing was expected of it; one that is followed is pulled from where its motion took it."""
    follower = follower_of({0: KnownHead(HEAD)})
    pictures = [draw(HEAD + k * STEP, np.random.default_rng(1)) for k in range(2)]
    found, followed = [follower.follow(ClipFrame(k, k / 25.0, picture)) for k, picture in enumerate(pictures)]
    assert found.information.any() and not found.toward.any() and "motion" not in found.carriers
    assert followed.information.any() and followed.toward.any() and followed.carriers[-1] == "motion"


def test_a_head_is_looked_for_the_further_the_more_frames_were_not_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_for: list[tuple[Array, Array]] = []

    def look(place: Place, picture: object, head: Array, covariance: Array, *_: Any) -> Look:
        looked_for.append((head, covariance))
        return look_of(4, head)

    monkeypatch.setattr(Place, "look", look)
    place, before, entry = Place.of(tripod(), template()), Entry(0, 0.0, SIZE, 0, head=HEAD), Entry(1, 0.04, SIZE, 0)
    picture = LookedAt.of(draw(HEAD, np.random.default_rng(1)), Config().mask)
    motion = HeadMotion(STEP, np.diag([1e-8, 2e-8, 3e-8]), 1.0, 100)
    follower = follower_of({})
    for unconfirmed in (0, 3):
        follower._unconfirmed = unconfirmed
        followed = follower._look_along(place, picture, before, entry, motion)
        head, covariance = looked_for.pop()
        np.testing.assert_array_equal(head, HEAD + STEP)
        np.testing.assert_allclose(covariance, motion.covariance + (1 + unconfirmed) * np.diag(np.square(HEAD_SD)))
        np.testing.assert_array_equal(followed.covariance, covariance)


def look_of(count: int, head: Array) -> Look:
    """What brings a number of places of paint whose fit has a head."""
    whole = measure_ideal(HEAD, np.zeros(2), 0.1, np.random.default_rng(1))
    places = ("marking", "field_m", "points_px", "normals", "width_px", "scale_px_m", "bias_px")
    measured = MeasuredFrame(*(getattr(whole, name)[:count] for name in places), np.full(3, count), np.full(3, count))
    nothing = np.zeros((3, len(COMMON)))
    fit = HeadFit(
        head, 1e6 * np.eye(3), nothing, nothing, 0.1, np.zeros((count, 3)), np.ones(count, np.bool_), np.zeros(2),
        np.ones(count),
    )  # fmt: skip
    return Look(measured, fit, False, np.zeros(2))


@pytest.mark.parametrize("count", [7, 8])
def test_a_frame_that_shows_too_little_stays_where_its_head_is_expected(count: int) -> None:
    entry, found = Entry(0, 0.0, SIZE, 0), HEAD + 3.0 * STEP
    entry.take(look_of(count, found), HEAD, 1e-4 * np.eye(3))
    is_enough = count == 8
    np.testing.assert_array_equal(entry.head, found if is_enough else HEAD)
    np.testing.assert_array_equal(entry.information, 1e6 * np.eye(3) * is_enough)
    np.testing.assert_allclose(entry.toward, 1e4 * (found - HEAD) * is_enough)
