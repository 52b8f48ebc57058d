"""Which frames of a shot are answered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import Config, load_config
from circlecal.overlay.template_lines import count_sigma_from_seen
from circlecal.pipeline import field_of
from circlecal.rig.tripod import COMMON, PLACE, Venue
from circlecal.tracking.answers import DRIFT_SD, SigmaLimits, _chain_of, answer_shot
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame, Entry
from circlecal.tracking.looking import LookedAt, Place
from circlecal.tracking.motion import HeadMotion
from circlecal.tracking.records import RecordForm, record_of_track
from circlecal.tracking.results import TrackedFrame
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


def test_frames_of_a_clip_without_any_camera_say_so() -> None:
    frame = ClipFrame(0, 0.0, np.full((120, 160, 3), 90, np.uint8))
    lost, unknown = (next(track_frames([frame], Venue("soccer", cameras), Config())) for cameras in ((tripod(),), ()))
    assert (lost.code, unknown.code) == ("lost", "no_tripod")
    assert unknown.reason == "no camera of the clip is known"


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


def test_sigmas_of_the_head_hold_what_the_tripod_leaves_open() -> None:
    """Paint told each frame's head within a thousandth, had the tripod been known; it leaves a hundredth open."""
    told, open_sd = 1e-3, 1e-2
    camera = tripod()
    spread = np.zeros((len(COMMON), len(COMMON)))
    spread[PLACE["axis_x"], PLACE["axis_x"]] = open_sd**2
    entries = _entries([0, 0, 0])
    for entry in entries:
        entry.place, entry.information = Place.of(replace(camera, covariance=spread), template()), np.eye(3) / told**2
        entry.pull = np.zeros((3, len(COMMON)))
        entry.pull[1, PLACE["axis_x"]] = 1.0 / told**2  # the pan follows the axis radian by metre
    middle = list(answer_shot(entries, 3, LIMITS))[1].head
    assert middle is not None
    sigmas = np.sqrt(np.diag(middle.covariance))
    assert sigmas[1] == pytest.approx(open_sd, rel=0.02)
    assert max(sigmas[0], sigmas[2]) < 2.0 * told


def _answer_before_an_end(axis_by_length: float) -> list[TrackedFrame]:
    """Answers to frames of the left end of a pitch whose length is open by three metres, which the place of the camera
    follows so far.
    """
    entries = _entries([0, 0, 0])
    by_length = np.zeros(len(COMMON))
    by_length[[PLACE["length"], PLACE["axis_x"]]] = 3.0, 3.0 * axis_by_length
    camera = replace(tripod(), covariance=tripod().covariance + np.outer(by_length, by_length))
    for entry in entries:
        entry.place, entry.head = Place.of(camera, template()), HEAD - np.array([0.0, 0.2, 0.0])
    return list(answer_shot(entries, 3, LIMITS))


def test_the_length_of_a_pitch_of_which_one_end_is_seen_refuses_no_frame() -> None:
    # the camera stands where it stands before the left end, and where it stands before the right one
    assert [frame.code for frame in _answer_before_an_end(-0.5)] == [None] * 3
    assert [frame.code for frame in _answer_before_an_end(0.5)] == ["too_uncertain"] * 3


def test_a_record_says_from_where_its_standard_deviations_are_counted() -> None:
    """Both in the picture and on the ground, as those of frames alone; whoever counts from the middle finds more."""
    frame, form = _answer_before_an_end(-0.5)[1], RecordForm(*field_of(load_config()), 0, "0" * 12)
    record = record_of_track(frame, "clip_1", "clip.mp4", 0, form)
    assert (record.camera.reference_m, record.camera.reference_by_growth) == ((-52.5, 0.0), (-0.5, 0.0))
    view = record.view
    points = view.visible_field(template(), step_m=2.5)
    from_end = count_sigma_from_seen(view, record.camera.reference_by_growth)
    pixels = view.project(points)
    for to, given, told in (
        ("project", points, record.camera.max_sigma_px), ("to_field", pixels, record.camera.max_sigma_m),
    ):  # fmt: skip
        counted, whole = (np.nanmax(getattr(v, to)(given, sigma=True).sigma) for v in (from_end, view))
        assert told <= 1.01 * counted and whole > 5.0 * told
    by_middle = list(answer_shot(_entries([0, 0, 0]), 3, LIMITS))[1]
    record = record_of_track(by_middle, "clip_1", "clip.mp4", 0, form)
    assert (record.camera.reference_m, record.camera.reference_by_growth) == ((0.0, 0.0), (0.0, 0.0))


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


def test_what_motions_leave_open_beside_their_own_noise_counts() -> None:
    entries = _entries([0, 0, 0])
    chain = _chain_of(entries)
    left = 1e-8 * np.eye(3) + np.diag(np.square(DRIFT_SD))
    np.testing.assert_allclose(np.linalg.inv(chain.precision), [left, left])


@pytest.mark.parametrize("confirmed", [(0, 1), (2, 3)])
def test_frames_confirmed_beyond_a_motion_that_is_not_known_say_nothing(confirmed: tuple[int, ...]) -> None:
    entries = _entries([0] * 4)
    for k, entry in enumerate(entries):
        entry.is_confirmed, entry.is_in_place = k in confirmed, True
    assert [frame.code for frame in answer_shot(entries, 4, LIMITS)] == [None] * 4
    entries[2].motion = None
    codes = [frame.code for frame in answer_shot(entries, 4, LIMITS)]
    assert codes == [None if k in confirmed else "paint_missing" for k in range(4)]
