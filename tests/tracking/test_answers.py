"""Which frames of a shot are answered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.rig.tripod import COMMON, PLACE
from circlecal.tracking.answers import SigmaLimits, answer_shot
from circlecal.tracking.entry import Entry
from circlecal.tracking.looking import LookedAt, Place
from circlecal.tracking.motion import HeadMotion
from tests.tracking.scenes import HEAD, SIZE, draw, template, tripod

LIMITS = SigmaLimits.of(load_config().verdict)


def _entries(missing: list[int]) -> list[Entry]:
    """Frames of a still camera that see the penalty area well, but for markings that should be there."""
    place, still = Place.of(tripod(), template()), HeadMotion(np.zeros(3), np.eye(3) * 1e-8, 1.0, 100)
    return [
        Entry(k, k / 25.0, SIZE, 0, place, HEAD, np.eye(3) * 1e8, np.zeros(3), np.zeros((3, 20)), still if k else None,
              is_confirmed=not count, missing=count, expected=200, painted=180)
        for k, count in enumerate(missing)
    ]  # fmt: skip


def test_a_broad_marking_that_is_not_there_refuses_its_frame() -> None:
    answered = list(answer_shot(_entries([0, 0, 0]), 3, LIMITS))
    assert [frame.status for frame in answered] == ["calibrated"] * 3
    answered = list(answer_shot(_entries([0, 1, 0]), 3, LIMITS))
    assert [(frame.status, frame.code) for frame in answered] == [
        ("calibrated", None), ("refused", "paint_missing"), ("calibrated", None),
    ]  # fmt: skip


def test_a_frame_without_paint_follows_the_tripod_as_its_neighbours_do() -> None:
    place = Place.of(tripod(), template())
    shown = place.look(
        LookedAt.of(draw(HEAD, np.random.default_rng(1)), load_config().mask),
        HEAD,
        np.diag(np.square([0.005, 0.002, 0.002])),
    )
    entries = _entries([0, 0, 0])
    for k, entry in enumerate(entries):
        entry.information, entry.pull = (np.zeros((3, 3)), None) if k == 1 else (shown.fit.information, shown.fit.pull)
    before, between, after = (frame.sigma_px for frame in answer_shot(entries, 3, LIMITS))
    assert before is not None and between is not None and after is not None
    assert between < 1.2 * max(before, after)


def test_the_length_of_a_pitch_of_which_one_end_is_seen_refuses_no_frame() -> None:
    def codes(axis_by_length: float) -> list[str | None]:
        entries = _entries([0, 0, 0])
        by_length = np.zeros(len(COMMON))
        by_length[[PLACE["length"], PLACE["axis_x"]]] = 3.0, 3.0 * axis_by_length
        camera = replace(tripod(), covariance=tripod().covariance + np.outer(by_length, by_length))
        for entry in entries:
            entry.place, entry.head = Place.of(camera, template()), HEAD - np.array([0.0, 0.2, 0.0])
        return [frame.code for frame in answer_shot(entries, 3, LIMITS)]

    # the camera stands where it stands before the left end, and where it stands before the right one
    assert codes(-0.5) == [None] * 3
    assert codes(0.5) == ["too_uncertain"] * 3


@pytest.mark.parametrize("in_place", [True, False])
def test_a_frame_after_the_last_confirmed_one_is_answered_where_its_paint_is_in_place(in_place: bool) -> None:
    entries = _entries([0] * 4)
    for entry in entries[1:]:
        entry.is_confirmed = False
    for entry in entries[2:]:
        entry.is_in_place = in_place
    codes = [frame.code for frame in answer_shot(entries, 4, LIMITS)]
    assert codes == ([None] * 4 if in_place else [None] + ["paint_missing"] * 3)


def test_a_frame_between_others_whose_paint_is_in_place_is_refused_where_none_is_confirmed() -> None:
    entries = _entries([0] * 3)
    for entry in entries:
        entry.is_confirmed, entry.is_in_place = False, True
    assert [frame.code for frame in answer_shot(entries, 3, LIMITS)] == ["paint_missing"] * 3


def test_the_limits_follow_those_of_the_configuration() -> None:
    def limits(largest_px: float, mean_px: float) -> tuple[float, float]:
        options = {"verdict.max_sigma_px": largest_px, "verdict.max_mean_sigma_px": mean_px}
        found = SigmaLimits.of(load_config(None, options).verdict)
        return found.largest_px, found.mean_px

    assert (LIMITS.largest_px, LIMITS.mean_px) == (64.0, 8.0)
    assert limits(20.0, 5.0) == (20.0, 5.0)
    assert limits(100.0, 30.0) == (100.0, 10.0)

    entries = _entries([0] * 3)
    sigma_px = list(answer_shot(entries, 3, LIMITS))[1].sigma_px
    assert sigma_px is not None

    def codes(largest_px: float) -> set[str | None]:
        return {frame.code for frame in answer_shot(entries, 3, replace(LIMITS, largest_px=largest_px))}

    unit = SIZE[0] / 1920.0
    assert codes(1.1 * sigma_px / unit) == {None}
    assert codes(0.9 * sigma_px / unit) == {"too_uncertain"}
