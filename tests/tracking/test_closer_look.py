"""The last look of a survey: how near to its marking the paint is measured, beside other ground and while it moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import load_config
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import PLACE, TripodEstimate
from circlecal.synthetic.optics import motion_kernel
from circlecal.tracking import closer_look, head_path, pitch
from circlecal.tracking.closer_look import learn_closely, measure_closely
from circlecal.tracking.frame_paint import HeadedFrame, residuals_of
from circlecal.tracking.head_fit import HeadFit
from circlecal.tracking.head_path import HeadPath
from circlecal.tracking.looking import Look, LookedAt, Place
from circlecal.tracking.markings import place_markings, template_curves
from circlecal.tracking.seen_paint import BESIDE_BIAS_PX, BIAS_BY_SMEAR, MeasuredFrame
from circlecal.tracking.tripod_fit import common_priors, fit_tripod
from tests.tracking.scenes import HEAD, SIZE, draw, measure_ideal, template, tripod, views_of_a_pitch

CIRCLE_HEAD = np.array([np.log(2200.0), -0.01, 1.38])
"""Sees the circle from the tripod of the scenes."""
MASK = load_config().mask


def _far_side_off_px(measured: MeasuredFrame, head: np.ndarray, name: str) -> float:
    """How far the middle of a marking's paint beyond the long axis lies above its true place, pixels."""
    drawn, true = template_curves(template()), tripod()
    theta = true.model.thetas(head[None], true.mean)[0]
    away, _ = residuals_of(measured, drawn, theta, true.model.projection)
    own = (measured.marking == drawn.names.index(name)) & (measured.field_m[:, 1] < -6.0)
    assert np.count_nonzero(own) > 15
    return float(np.median((away * -np.sign(measured.normals[:, 1]))[own]))


def _darken_beyond_far_line(picture: NDArray[np.uint8], head: np.ndarray) -> NDArray[np.uint8]:
    """The picture with paler paint, and with darker ground from some way beyond the far touchline on."""
    grass = np.array([60.0, 120.0, 60.0])
    picture = np.asarray(grass + 0.2 * (picture - grass), np.float64)
    beyond = np.array([[x, -template().width_m / 2 - 4.0] for x in np.linspace(-80.0, 80.0, 161)])
    edge = tripod().view(head, np.zeros((3, 3))).project(beyond)
    edge = edge[np.isfinite(edge).all(axis=1)]
    mask = np.zeros(picture.shape[:2], np.float32)
    above = np.vstack([edge, [[edge[-1, 0], -9.0], [edge[0, 0], -9.0]]])
    cv2.fillPoly(mask, [np.clip(above, -(2**14), 2**14).round().astype(np.int32)], 1.0)
    mask = cv2.GaussianBlur(mask, (0, 0), 0.8)
    return np.asarray(picture * (1.0 - 0.3 * mask[..., None]), np.uint8)


def test_other_ground_beyond_a_line_does_not_draw_its_middle() -> None:
    picture = _darken_beyond_far_line(draw(HEAD, np.random.default_rng(3)), HEAD)
    seen = LookedAt.of(picture, MASK)
    place = Place.of(tripod(), template())
    far = place.look(seen, HEAD, place.proposal_covariance(HEAD)).measured
    frame = HeadedFrame("0.000", HEAD, far)
    (near,) = measure_closely(tripod(), [frame], {"0.000": seen}, template(), 0.04, HeadPath.of([frame]))
    assert abs(_far_side_off_px(far, HEAD, "side_line_top")) < 0.1
    assert abs(_far_side_off_px(near.measured, HEAD, "side_line_top")) < 0.07


def _leave_nothing(frame: HeadedFrame) -> HeadedFrame:
    """The frame as if no paint had been measured in it."""
    return replace(frame, measured=MeasuredFrame.unseen(frame.measured.expected))


def _learn(
    members: list[HeadedFrame], looks: Sequence[list[HeadedFrame]], monkeypatch: pytest.MonkeyPatch
) -> TripodEstimate:
    """What is learnt closely from frames of a tripod, which one look after the other measures so."""
    left = iter(looks)
    monkeypatch.setattr(closer_look, "measure_closely", lambda *_: next(left, []))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    start = fit_tripod(members, tripod(), mean, sd, template_curves(template())).estimate
    return learn_closely(start, members, {}, lambda times: iter(()), load_config(), template_curves(template()))


def test_paint_of_the_first_look_counts_where_the_second_measures_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    members = [replace(f, name=f"{0.6 * k:.3f}") for k, f in enumerate(views_of_a_pitch(105.0, 68.0))]
    bare = [_leave_nothing(frame) for frame in members]
    twice, once = (_learn(members, [members, look], monkeypatch) for look in (members, bare))
    assert once.used == twice.used == tuple(frame.name for frame in members)
    assert np.abs(once.mean - twice.mean)[:3].max() < 0.01
    assert once.covariance[:3, :3] == pytest.approx(twice.covariance[:3, :3], rel=0.02, abs=1e-6)


def test_a_tripod_stays_as_it_was_where_a_close_look_measures_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    members = [replace(f, name=f"{0.6 * k:.3f}") for k, f in enumerate(views_of_a_pitch(105.0, 68.0))]
    bare = [_leave_nothing(frame) for frame in members]
    left_out = _learn(members, [[members[0], bare[1], *members[2:]], members[:1] + members[2:]], monkeypatch)
    assert left_out.used == tuple(frame.name for frame in members[:1] + members[2:])
    assert _learn(members, [bare], monkeypatch).used == tuple(frame.name for frame in members)


def test_smeared_paint_of_a_circle_lies_inside_it() -> None:
    blur = np.array([60.0, 0.0])
    picture = cv2.filter2D(draw(CIRCLE_HEAD, np.random.default_rng(4)), -1, motion_kernel(float(blur[0]), 0.0))
    drawn, true = template_curves(template()), tripod()
    theta = true.model.thetas(CIRCLE_HEAD[None], true.mean)[0]
    places = place_markings(drawn, theta, true.model.projection, template().marking_width_m)
    own = (places.marking == drawn.names.index("centre_circle")) & (places.field_m[:, 1] < -6.0)
    inward = places.offset_middles(blur)[own] * np.sign(places.normals[own, 1])
    place = Place.of(true, template())
    seen = LookedAt.of(np.asarray(picture, np.uint8), MASK)
    measured = place.look(seen, CIRCLE_HEAD, np.eye(3) * 1e-9, None, blur).measured
    assert np.median(inward) > 0.1
    assert abs(_far_side_off_px(measured, CIRCLE_HEAD, "centre_circle")) < 0.4 * np.median(inward)


@pytest.mark.parametrize("way_px", [30.0, 60.0])
def test_ends_of_lines_are_doubtful_where_a_goal_line_is_smeared_over_them(way_px: float) -> None:
    picture = cv2.filter2D(draw(HEAD, np.random.default_rng(4)), -1, motion_kernel(way_px, 0.0))
    drawn, true = template_curves(template()), tripod()
    seen = LookedAt.of(np.asarray(picture, np.uint8), MASK)
    blur = np.array([way_px, 0.0])
    measured = Place.of(true, template()).look(seen, HEAD, np.eye(3) * 1e-9, None, blur).measured
    theta = true.model.thetas(HEAD[None], true.mean)[0]
    away, _ = residuals_of(measured, drawn, theta, true.model.projection)
    along = measured.marking == drawn.names.index("big_rect_left_bottom")
    doubtful = measured.bias_px >= BESIDE_BIAS_PX * SIZE[0] / 1920.0
    assert np.abs(away[along & doubtful]).max() > 0.3
    assert np.count_nonzero(along & ~doubtful) > 15
    assert np.abs(away[along & ~doubtful]).max() < 0.15


def test_a_head_is_followed_by_smeared_paint_and_a_tripod_doubts_it() -> None:
    """Where heads doubted it too, real clips lost right answers in their pans, and the length of their pitch."""
    picture = cv2.filter2D(draw(HEAD, np.random.default_rng(4)), -1, motion_kernel(30.0, 0.0))
    seen, blur = LookedAt.of(np.asarray(picture, np.uint8), MASK), np.array([30.0, 0.0])
    place = Place.of(tripod(), template())
    followed = place.look(seen, HEAD, place.proposal_covariance(HEAD), None, blur).measured
    closely = closer_look._look_closely(place, seen, HEAD, blur).measured
    across = [np.abs(measured.normals @ blur) for measured in (followed, closely)]
    assert np.median(followed.bias_px) < 0.5 * BIAS_BY_SMEAR * np.median(across[0])
    assert (closely.bias_px >= BIAS_BY_SMEAR * across[1]).all()


def test_smear_makes_the_paint_less_certain() -> None:
    measured = [measure_ideal(HEAD, np.zeros(2), 0.1, np.random.default_rng(k)) for k in range(3)]
    turned = np.array([0.0, 0.01, 0.0])
    members = [HeadedFrame(f"{0.1 * k:.3f}", HEAD + k * turned, seen) for k, seen in enumerate(measured)]
    path = HeadPath.of(members)
    blur = path.blur_px(0.1, tripod(), 0.04)
    assert blur is not None
    assert abs(blur[0]) == pytest.approx(0.5 * 0.04 / 0.1 * 0.01 * 1500.0, rel=0.1)
    assert path.blur_px(0.1, tripod(), 0.0) is None
    # how the head turns at the end of what is known is a guess
    assert path.blur_px(0.2, tripod(), 0.04) is None
    assert path.blur_px(0.15, tripod(), 0.04) is not None
    doubted = members[1].measured.doubt_smear(blur)
    across = np.abs(members[1].measured.normals @ blur)
    assert (doubted.bias_px >= BIAS_BY_SMEAR * across - 1e-9).all()


def test_pictures_between_tell_the_size_of_the_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    size_m, drawn, rng = (117.0, 48.0), template_curves(template()), np.random.default_rng(6)
    growth = np.array(size_m) - (template().length_m, template().width_m)
    members = [replace(f, name=f"{0.3 * k:.3f}") for k, f in enumerate(views_of_a_pitch(*size_m))]
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    start = pitch.choose_pitch(members, tripod(), mean, sd, drawn, pitch.WORST_RMS_PX).estimate
    nothing = np.zeros((3, 3))

    def look(place: object, picture: object, head: np.ndarray, blur_px: object) -> Look:
        return Look(
            measure_ideal(head, growth, 0.1, rng),
            HeadFit(head, nothing, nothing, nothing, 0.1, nothing, np.zeros(0, np.bool_), np.zeros(2), np.zeros(0)),
            True,
            np.zeros(2),
        )

    monkeypatch.setattr(closer_look, "_look_closely", look)
    monkeypatch.setattr(head_path, "MOST_MORE", 6)
    blank = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    asked: list[float] = []

    def pictures_at(times: Sequence[float]) -> Iterator[NDArray[np.uint8]]:
        asked.extend(times)
        return iter([blank] * len(times))

    found = learn_closely(start, members, {}, pictures_at, load_config(), drawn)
    assert asked == pytest.approx([0.1, 0.2, 0.4, 0.5, 0.7, 0.8])
    assert found.sigma("length") < 0.8 * start.sigma("length")
    assert abs(found.growth_m[0] - growth[0]) < 3.0 * found.sigma("length")
    asked.clear()
    known = replace(start, covariance=0.0 * start.covariance)
    learn_closely(known, members, {}, pictures_at, load_config(), drawn)
    assert not asked


def test_a_size_that_frames_left_open_stays_near_the_usual_one(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, rng, breadth = template_curves(template()), np.random.default_rng(6), PLACE["breadth"]
    members = [replace(f, name=f"{0.3 * k:.3f}") for k, f in enumerate(views_of_a_pitch(105.0, 68.6))]
    start = tripod()
    start.covariance[breadth, breadth] = pitch.USUAL_SD_M**2
    nothing = np.zeros((3, 3))

    def look(place: object, picture: object, head: np.ndarray, blur_px: object) -> Look:
        fit = HeadFit(head, nothing, nothing, nothing, 0.1, nothing, np.zeros(0, np.bool_), np.zeros(2), np.zeros(0))
        return Look(measure_ideal(head, np.array([0.0, 0.6]), 0.1, rng), fit, True, np.zeros(2))

    monkeypatch.setattr(closer_look, "_look_closely", look)
    monkeypatch.setattr(head_path, "MOST_MORE", 3)
    blank = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    found = learn_closely(start, members, {}, lambda t: iter([blank] * len(t)), load_config(), drawn)
    assert found.growth_m[1] == pytest.approx(0.6, abs=3.0 * found.sigma("breadth"))
    assert 0.0 < found.sigma("breadth") < pitch.USUAL_SD_M


def test_a_fast_pan_between_frames_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    way = HEAD + np.linspace(0.0, 1.0, 8)[:, None] * (0.0, 0.06, 0.0)
    pictures = [draw(head, np.random.default_rng(k)) for k, head in enumerate(way)]
    asked: list[float] = []

    def pictures_at(times: Sequence[float]) -> Iterator[NDArray[np.uint8]]:
        asked.extend(times)
        return (pictures[int(np.ceil(time_s / 0.1 - 1e-6))] for time_s in times)

    measured = [measure_ideal(head, np.zeros(2), 0.1, np.random.default_rng(1)) for head in (way[0], way[-1])]
    ends = [HeadedFrame("0.000", way[0], measured[0]), HeadedFrame("0.700", way[-1], measured[1])]
    path = HeadPath.of(ends)
    assert path.gaps() == [(0.0, 0.7)]
    place = Place.of(tripod(), template())
    found = closer_look._follow_gaps(place, path, pictures_at, load_config(), None, 0.1)
    assert [frame.name for frame in found] == ["0.100", "0.200", "0.300", "0.400", "0.500", "0.600"]
    for frame, true in zip(found, way[1:-1], strict=True):
        np.testing.assert_allclose(frame.head, true, atol=4e-4)
    monkeypatch.setattr(closer_look, "MOST_FOLLOWED", 5)
    asked.clear()
    assert not closer_look._follow_gaps(place, path, pictures_at, load_config(), None, 0.1)
    assert not asked


def test_a_frame_of_a_gap_that_cannot_be_decoded_shifts_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    step = np.array([0.0, 0.06 / 7, 0.0])
    way = [HEAD + k * step for k in range(8)]
    pictures = [draw(head, np.random.default_rng(k)) for k, head in enumerate(way)]
    blurs: list[Array] = []
    look_closely = closer_look._look_closely

    def look(place: Place, picture: LookedAt, head: Array, blur_px: Array) -> Look:
        blurs.append(blur_px)
        return look_closely(place, picture, head, blur_px)

    monkeypatch.setattr(closer_look, "_look_closely", look)
    measured = [measure_ideal(head, np.zeros(2), 0.1, np.random.default_rng(1)) for head in (way[0], way[-1])]
    ends = [HeadedFrame("0.000", way[0], measured[0]), HeadedFrame("0.700", way[-1], measured[1])]
    shown = [None if k == 3 else picture for k, picture in enumerate(pictures)]
    place = Place.of(tripod(), template())
    found = closer_look._follow_gaps(place, HeadPath.of(ends), lambda _: iter(shown), load_config(), None, 0.1)
    assert [frame.name for frame in found] == ["0.100", "0.200", "0.400", "0.500", "0.600"]
    for frame in found:
        np.testing.assert_allclose(frame.head, HEAD + 10.0 * float(frame.name) * step, atol=4e-4)
    # beside the missing one too the picture moves by as much a frame
    np.testing.assert_allclose([abs(blur[0]) for blur in blurs], 0.5 * step[1] * 1500.0, rtol=0.15)


def test_the_gap_with_the_largest_turn_is_followed_first() -> None:
    nothing = MeasuredFrame.unseen(np.zeros(1, np.int_))
    pans = {0.0: 0.0, 1.0: 0.1, 2.0: -0.2, 3.0: 0.0, 3.2: 0.0, 9.0: 0.9}
    members = [HeadedFrame(f"{time_s:.3f}", HEAD + np.array([0.0, pan, 0.0]), nothing) for time_s, pan in pans.items()]
    assert HeadPath.of(members).gaps() == [(1.0, 2.0), (2.0, 3.0), (0.0, 1.0)]


def test_a_followed_gap_tells_how_far_the_frames_beside_it_are_smeared(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, turn = np.random.default_rng(6), np.array([0.0, -0.1, 0.0])

    def at(time_s: float) -> HeadedFrame:
        head = CIRCLE_HEAD + time_s * turn
        return HeadedFrame(f"{time_s:.3f}", head, measure_ideal(head, np.zeros(2), 0.1, rng))

    members = [at(time_s) for time_s in (0.0, 0.3, 0.9, 1.2)]
    smeared = [at(time_s) for time_s in (0.5, 0.7)]
    pictures = dict.fromkeys((frame.name for frame in members), LookedAt.of(draw(CIRCLE_HEAD, rng), MASK))
    start = tripod()
    start.covariance[PLACE["length"], PLACE["length"]] = 1.0
    looks: list[tuple[float, bool]] = []
    nothing = np.zeros((3, 3))

    def look(place: object, picture: object, head: np.ndarray, blur_px: Array | None) -> Look:
        looks.append((round(float((head - CIRCLE_HEAD)[1] / turn[1]), 1), blur_px is not None))
        fit = HeadFit(head, nothing, nothing, nothing, 0.1, nothing, np.zeros(0, np.bool_), np.zeros(2), np.zeros(0))
        return Look(measure_ideal(head, np.zeros(2), 0.1, rng), fit, True, np.zeros(2))

    monkeypatch.setattr(closer_look, "_look_closely", look)
    monkeypatch.setattr(closer_look, "_follow_gaps", lambda *_: smeared)
    monkeypatch.setattr(closer_look, "_look_between", lambda *_: [])
    learn_closely(start, members, pictures, lambda _: iter(()), load_config(), template_curves(template()), None, 0.04)
    assert looks[4:8] == [(0.0, False), (0.3, False), (0.9, False), (1.2, False)]
    assert looks[8:] == [(0.0, False), (0.3, True), (0.9, True), (1.2, False)]
