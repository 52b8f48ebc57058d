"""Looking at a drawn pitch: from a head nearby, and from nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.tracking import search
from circlecal.tracking.looking import LookedAt, Place
from tests.tracking.scenes import HEAD, draw, template, tripod


@pytest.fixture(scope="module")
def picture() -> LookedAt:
    return LookedAt.of(draw(HEAD, np.random.default_rng(1)), load_config().mask.detector.field_region)


def pixels(head: np.ndarray) -> np.ndarray:
    """How far a head puts the picture from the true one, pixels: by zoom, pan and tilt."""
    return np.abs(head - HEAD) * np.array([640.0, 1500.0, 1500.0])


def test_a_head_nearby_is_led_to_the_paint(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    start = HEAD + np.array([0.002, 0.002, -0.0015])
    look = place.look(picture, start, np.diag(np.square([0.005, 0.002, 0.002])))
    assert look.is_confirmed
    assert pixels(look.fit.head).max() < 0.15
    assert look.measured.painted_share > 0.9


def test_a_wrong_head_is_not_confirmed(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    look = place.look(picture, HEAD + np.array([0.0, 0.05, 0.02]), np.diag(np.square([0.005, 0.002, 0.002])))
    assert not look.is_confirmed


def test_the_camera_is_found_from_nowhere(picture: LookedAt) -> None:
    look = Place.of(tripod(), template()).find(picture)
    assert look is not None
    assert pixels(look.fit.head).max() < 0.3


def test_a_picture_without_paint_is_not_found() -> None:
    noise = np.random.default_rng(2).normal(0.0, 4.0, (720, 1280, 3))
    bare = np.clip(np.array([60.0, 120.0, 60.0]) + noise, 0, 255).astype(np.uint8)
    looked = LookedAt.of(bare, load_config().mask.detector.field_region)
    assert Place.of(tripod(), template()).find(looked) is None


def test_heads_that_differ_in_zoom_alone_are_all_kept() -> None:
    heads = HEAD + np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.0], [0.06, 0.0, 0.0], [0.0, 0.02, 0.0]])
    np.testing.assert_array_equal(search._keep_apart(heads, 1280, 2.0), heads[[0, 2, 3]])


def test_where_the_head_was_seen_is_proposed(picture: LookedAt) -> None:
    known = tripod()
    assert Place.of(known, template()).propose(picture)[-1] == pytest.approx((known.head_low + known.head_high) / 2)
