"""Shape and size of the pitch before a tripod."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.camera.world import Size
from circlecal.config import load_config
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.rig.tripod import PLACE, TripodEstimate
from circlecal.tracking import closer_look, pitch
from circlecal.tracking.frame_paint import PART_M, HeadedFrame
from circlecal.tracking.looking import LookedAt, Place
from circlecal.tracking.markings import template_curves
from circlecal.tracking.survey import WORST_RMS_PX
from circlecal.tracking.tripod_fit import TripodFit, common_priors, fit_tripod
from tests.tracking.scenes import (
    HEAD,
    SIZE,
    draw,
    measure_ideal,
    template,
    tripod,
    views_of_a_pitch,
    views_of_a_surface,
    views_of_badly_painted_markings,
)

LIMIT_PX = WORST_RMS_PX * SIZE[0] / 1920.0


@pytest.mark.parametrize("size_m", [(117.0, 48.0), (94.8, 70.7), (105.0, 68.0), (106.5, 68.0)])
def test_a_pitch_may_have_any_size(size_m: tuple[float, float]) -> None:
    frames = views_of_a_pitch(*size_m)
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    start = replace(tripod(), mean=tripod().mean + np.where(np.arange(len(mean)) < 3, 0.2, 0.0))
    fit = pitch.choose_pitch(frames, start, mean, sd, template_curves(template()), LIMIT_PX)
    found = np.array([template().length_m, template().width_m]) + fit.estimate.growth_m
    off = np.abs(found - size_m)
    sigmas = np.array([fit.estimate.sigma("length"), fit.estimate.sigma("breadth")])
    assert (off < 3.0 * sigmas + 0.01).all()
    assert off.max() < 0.3
    assert abs(fit.estimate.mean[PLACE["lever"]] - tripod().mean[PLACE["lever"]]) < 0.3


@pytest.mark.parametrize("shape", ["roof", "parabola", "hip"])
def test_the_shape_of_the_surface_is_told_where_penalty_areas_are_seen_beside_the_circle(shape: SurfaceShape) -> None:
    """Taken for a roof, a hipped pitch makes the tripod lean and its principal point lie elsewhere."""
    crown_m = 0.02 if shape == "parabola" else 0.08
    frames = views_of_a_surface(Surface(shape, 9.15, crown_m))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    drawn = template_curves(template())
    found = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX).estimate
    assert pitch.may_be_hip(frames, found, mean, sd, drawn) is (shape == "hip")
    if shape == "hip":
        assert found.surface.shape != shape
        found = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX, is_hipped=True).estimate
    assert found.surface.shape == shape
    assert abs(found.surface.crown_m - crown_m) < 0.006
    lean = [PLACE["lean_x"], PLACE["lean_y"]]
    np.testing.assert_allclose(found.mean[lean], tripod().mean[lean], atol=0.002)


@pytest.mark.parametrize("seed", [1, 2])
def test_what_painters_leave_is_not_taken_for_the_size_of_the_pitch(seed: int) -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    frames = views_of_badly_painted_markings(seed, 1.4)
    fit = pitch.choose_pitch(frames, tripod(), mean, sd, template_curves(template()), LIMIT_PX)
    np.testing.assert_array_equal(fit.estimate.growth_m, 0.0)


def test_a_width_is_not_held_at_the_usual_one_beside_another_length_that_takes_over_what_it_leaves() -> None:
    growth_m, drawn = np.array([2.0, -1.2]), template_curves(template())
    frames = views_of_badly_painted_markings(4, 1.0, (2.0, -1.2))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    found = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX).estimate
    assert abs(found.growth_m - growth_m).max() < 0.7
    assert abs(found.growth_m[1] - growth_m[1]) < 0.2


def test_a_usual_size_is_told_as_uncertain_as_its_own_paint_contradicts_it() -> None:
    frames, drawn = views_of_badly_painted_markings(4, 1.0, (1.5, 0.0)), template_curves(template())
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    held = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX).estimate
    assert held.growth_m[0] == held.sigma("length") == 0.0
    told = closer_look._fit_closely(held, frames, [], load_config(), template(), drawn, parts_m=PART_M).estimate
    assert told.growth_m[0] == 0.0
    assert abs(told.growth_m[0] - 1.5) < 2.5 * told.sigma("length")


def test_a_length_that_the_markings_tell_beyond_all_that_painters_leave_is_not_held() -> None:
    growth_m, drawn = -3.0, template_curves(template())
    frames = views_of_badly_painted_markings(5, 1.4, (growth_m, 0.0))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    # so much that no single frame contradicts the usual length
    found = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, 2.0 * LIMIT_PX).estimate
    assert abs(found.growth_m[0] - growth_m) < 1.0
    told = closer_look._fit_closely(found, frames, [], load_config(), template(), drawn, parts_m=PART_M).estimate
    assert abs(told.growth_m[0] - growth_m) < min(2.5 * told.sigma("length"), 0.6)
    assert told.sigma("length") > 0.05


def test_pictures_of_the_middle_and_an_end_that_leave_a_length_open_do_not_tell_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames, drawn = views_of_badly_painted_markings(5, 1.4, (-3.0, 0.0)), template_curves(template())
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    found = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX).estimate

    def tell() -> float:
        told = closer_look._fit_closely(found, frames, [], load_config(), template(), drawn, parts_m=PART_M).estimate
        return float(told.growth_m[0])

    by_pictures = tell()
    monkeypatch.setattr(closer_look, "TOLD_SD_M", 0.01)
    by_all = tell()
    assert abs(by_all - by_pictures) > 0.05
    monkeypatch.setattr(closer_look, "joint_frames", lambda frames, drawn: [])
    assert by_all == pytest.approx(tell())


def test_a_usual_size_is_told_as_uncertain_as_its_own_paint_leaves_it() -> None:
    frames, drawn = views_of_a_pitch(105.0, 68.0), template_curves(template())
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    held = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX).estimate
    assert held.sigma("length") == held.sigma("breadth") == 0.0

    def tell(seen: list[HeadedFrame]) -> TripodEstimate:
        return closer_look._fit_closely(held, seen, [], load_config(), template(), drawn, parts_m=PART_M).estimate

    told = tell(frames)
    np.testing.assert_array_equal(told.growth_m, 0.0)
    assert 0.0 < told.sigma("length") < 0.3
    assert 0.0 < told.sigma("breadth") < 0.3
    # without touchlines nothing is seen of the width
    without = frames
    for name in ("side_line_top", "side_line_bottom"):
        line = drawn.names.index(name)
        without = [replace(frame, measured=frame.measured.leave_out(line)) for frame in without]
    told = tell(without)
    assert told.growth_m[1] == 0.0
    assert told.sigma("breadth") == pytest.approx(pitch.USUAL_SD_M, rel=0.05)
    assert told.sigma("length") < 0.5 * told.sigma("breadth")


USUAL_SHARES: dict[Size, float] = {"usual": 0.9, "other_length": 0.06, "any": 0.04}


def _told_tripod(length_sd_m: float, breadth_sd_m: float) -> TripodEstimate:
    covariance = np.zeros((len(PLACE), len(PLACE)))
    covariance[pitch.SIZE, pitch.SIZE] = np.square([length_sd_m, breadth_sd_m])
    return replace(tripod(), covariance=covariance)


@pytest.mark.parametrize(
    ("size_sd_m", "breadth_m", "kinds"),
    [
        ((2.0, 2.0), None, {(1.0, 1.0): 0.9, (8.7, 1.0): 0.06, (8.7, 13.0): 0.04}),
        # frames tell a length that is not the usual one, and leave the width open
        ((0.2, 2.0), None, {(8.7, 1.0): 0.06, (8.7, 13.0): 0.04}),
        # they tell the width, which is the usual one or is not, and leave the length open
        ((2.0, 0.0), 0.0, {(1.0, 0.0): 0.9, (8.7, 0.0): 0.1}),
        ((2.0, 0.0), -1.5, {(8.7, 0.0): 0.04}),
        ((2.0, 0.2), None, {(8.7, 13.0): 0.04}),
    ],
)
def test_a_size_that_frames_leave_open_may_be_the_usual_one_or_any(size_sd_m, breadth_m, kinds) -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    if breadth_m is not None:
        mean[PLACE["breadth"]], sd[PLACE["breadth"]] = breadth_m, 0.0
    priors = pitch.priors_of_sizes(_told_tripod(*size_sd_m), mean, sd, USUAL_SHARES)
    found = {tuple(own_sd[pitch.SIZE].round(1).tolist()): share for _, own_sd, share in priors}
    assert found == pytest.approx(kinds)
    for own_mean, own_sd, _ in priors:
        is_near = own_sd[pitch.SIZE] == pitch.USUAL_SD_M
        np.testing.assert_array_equal(own_mean[pitch.SIZE], np.where(is_near, 0.0, mean[pitch.SIZE]))


def _fit_of_size(breadth_m: float, sd_m: float, cost: float) -> TripodFit:
    mean, covariance = tripod().mean.copy(), np.zeros((len(PLACE), len(PLACE)))
    mean[PLACE["breadth"]], covariance[PLACE["breadth"], PLACE["breadth"]] = breadth_m, sd_m**2
    estimate = replace(tripod(), mean=mean, covariance=covariance)
    return TripodFit(estimate, np.zeros((1, 3)), np.zeros(1), np.zeros(1), cost, 0.0, spread=0.5)


@pytest.mark.parametrize("more_cost", [2.0, 4.0, 6.0, 20.0])
def test_the_likelier_size_is_told_with_what_the_other_adds_to_its_variance(more_cost) -> None:
    """With the paint's own variance, half of what it is taken to be, a cost counts twice."""
    sd = np.zeros(len(PLACE))
    priors = []
    for sd_m, share in ((1.0, 0.96), (13.0, 0.04)):
        sd[PLACE["breadth"]] = sd_m
        priors.append((np.zeros(len(PLACE)), sd.copy(), share))
    best, told = pitch.mix_sizes([_fit_of_size(-1.0, 0.8, 50.0 + more_cost), _fit_of_size(-4.5, 1.1, 50.0)], priors)
    usual = 0.96 * 0.8 * np.exp(-more_cost)
    other = 0.04 * 1.1 / 13.0
    share = usual / (usual + other)
    assert best == (0 if share > 0.5 else 1)
    assert told.growth_m[1] == (-1.0, -4.5)[best]
    away = (share if best else 1.0 - share) * 3.5**2
    variance = share * 0.8**2 + (1.0 - share) * 1.1**2 + away
    assert told.sigma("breadth") ** 2 == pytest.approx(variance if 0.01 < share < 0.99 else (0.8, 1.1)[best] ** 2)


def test_a_width_that_frames_contradict_is_not_held_at_the_usual_one() -> None:
    """A camera that stands still shows circle and far touchline of a pitch 59 m wide, which tell that to 1.4 m."""
    drawn, head, rng = template_curves(template()), np.array([np.log(2600.0), 0.02, 1.38]), np.random.default_rng(3)
    near = drawn.names.index("side_line_bottom")
    frames = [
        HeadedFrame(str(k), head, measure_ideal(head, np.array([0.0, -9.0]), 0.1, rng).leave_out(near))
        for k in range(12)
    ]
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    held_mean, held_sd = mean.copy(), sd.copy()
    held_mean[pitch.SIZE], held_sd[pitch.SIZE] = 0.0, pitch.USUAL_SD_M
    held = fit_tripod(frames, tripod(), held_mean, held_sd, drawn).estimate
    assert held.growth_m[1] > -4.0
    told = closer_look._fit_closely(held, frames, [], load_config(), template(), drawn, parts_m=PART_M).estimate
    assert abs(told.growth_m[1] + 9.0) < 2.0 * told.sigma("breadth") < 5.0


def test_what_follows_a_size_is_uncertain_with_it() -> None:
    some, length, away = tripod(), PLACE["length"], PLACE["axis_x"]
    is_held = np.arange(len(some.mean)) == length
    held = replace(some, covariance=np.where(np.eye(len(is_held)) > 0.0, 0.01, 0.0) * ~is_held)
    loose = replace(held, mean=some.mean + 0.4 * is_held, covariance=held.covariance.copy())
    loose.covariance[length, length] = 0.3**2
    loose.covariance[away, length] = loose.covariance[length, away] = 0.045
    told = pitch.open_size(held, loose, is_held)
    np.testing.assert_array_equal(told.mean, held.mean)
    assert told.sigma("length") == pytest.approx(0.5)
    assert told.covariance[away, length] == pytest.approx(0.045)
    assert told.sigma("axis_x") ** 2 == pytest.approx(0.01 + 0.045**2 / 0.09)


def test_a_frame_that_contradicts_the_usual_size_is_no_false_calibration() -> None:
    frames, drawn = views_of_badly_painted_markings(4, 1.0, (1.5, 0.0)), template_curves(template())
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    free = fit_tripod(frames, tripod(), mean, sd, drawn, alike=float(len(frames)))
    usual_sd = sd.copy()
    usual_sd[[PLACE["length"], PLACE["breadth"]]] = 0.0
    fixed = fit_tripod(
        frames, tripod(), np.where(usual_sd == 0.0, 0.0, mean), usual_sd, drawn, alike=float(len(frames))
    )
    contradicted = float((fixed.clear_rms_px - free.clear_rms_px).argmax())
    between = float(np.mean([fit.clear_rms_px[int(contradicted)] for fit in (fixed, free)]))
    for limit_px, is_held in ((fixed.clear_rms_px.max() + 0.1, True), (between, False)):
        found = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, limit_px).estimate
        assert (found.growth_m[0] == 0.0) == is_held


@pytest.mark.parametrize("seed", [2, 3, 6])
def test_boards_behind_a_touchline_do_not_broaden_the_pitch(seed: int) -> None:
    frames, drawn, rng = [], template_curves(template()), np.random.default_rng(7)
    far = drawn.names.index("side_line_top")
    for k, frame in enumerate(views_of_badly_painted_markings(seed, 0.8)):
        seen = frame.measured
        on_it = np.flatnonzero(seen.marking == far)
        # here and there the foot of the boards is seen instead, 3 m behind the line
        hidden = on_it[rng.random(len(on_it)) > (0.8 if k in (2, 3, 4) else 0.0)]
        kept = np.setdiff1d(np.arange(len(seen.marking)), hidden)
        moved = seen.points_px - np.where(seen.marking == far, 8.0, 0.0)[:, None] * (0.0, 1.0)
        by_place = {"marking": seen.marking, "field_m": seen.field_m, "points_px": moved, "normals": seen.normals,
                    "width_px": seen.width_px, "scale_px_m": seen.scale_px_m, "bias_px": seen.bias_px}  # fmt: skip
        frames.append(replace(frame, measured=replace(seen, **{name: v[kept] for name, v in by_place.items()})))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    fit = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX)
    np.testing.assert_array_equal(fit.estimate.growth_m, 0.0)


def test_a_halfway_line_on_a_surface_of_another_shape_does_not_tell_how_broad_the_pitch_is() -> None:
    drawn, place = template_curves(template()), Place.of(tripod(), template())
    frames = []
    for k, pan in enumerate((-0.01, -0.1)):
        head = np.array([np.log(2200.0), pan, 1.38])
        picture = LookedAt.of(draw(head, np.random.default_rng(k)), load_config().mask)
        seen = place.look(picture, head, place.proposal_covariance(head)).measured
        for name in ("side_line_top", "side_line_bottom"):
            seen = seen.leave_out(drawn.names.index(name))
        frames.append(HeadedFrame(str(k), head, seen))
    assert all(frame.measured.painted[drawn.names.index("halfway_line")] > 20 for frame in frames)
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    start = replace(tripod(), surface=replace(tripod().surface, shape="parabola"))
    found = fit_tripod(frames, start, mean, sd, drawn).estimate
    assert found.growth_m[1] == pytest.approx(mean[PLACE["breadth"]], abs=0.1)
    assert found.sigma("breadth") == pytest.approx(sd[PLACE["breadth"]], rel=1e-3)


def test_boards_behind_a_goal_line_do_not_lengthen_the_pitch() -> None:
    growth, rng, drawn = np.array([7.0, -1.0]), np.random.default_rng(8), template_curves(template())
    heads = [np.array([np.log(2000.0 + 30.0 * k), pan, 1.38]) for k, pan in enumerate(np.linspace(0.1, -0.5, 8))]
    goal_line = drawn.names.index("side_line_left")
    frames = []
    for k, head in enumerate(heads):
        seen = measure_ideal(head, growth, 0.1, rng)
        away = np.where(seen.marking == goal_line, 5.0, 0.0)[:, None] * seen.normals
        frames.append(HeadedFrame(str(k), head, replace(seen, points_px=seen.points_px + away)))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    sd[PLACE["width"]] = 0.0
    fit = pitch.choose_pitch(frames, tripod(), mean, sd, drawn, LIMIT_PX)
    sigma = np.array([fit.estimate.sigma("length"), fit.estimate.sigma("breadth")])
    assert (np.abs(fit.estimate.growth_m - growth) < 3.0 * sigma + 0.02).all()
    assert sigma.max() < 0.2


def test_penalty_areas_alone_do_not_tell_the_size_of_the_pitch() -> None:
    growth, rng = np.array([2.5, 19.9]), np.random.default_rng(4)
    heads = [np.array([8.0, -0.5 + 0.01 * k, 1.40]) for k in range(3)]
    seen = [measure_ideal(head, growth, 0.1, rng) for head in heads]
    frames = [HeadedFrame(str(k), head, m) for k, (head, m) in enumerate(zip(heads, seen, strict=True))]
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    moved = tripod().mean.copy()
    moved[:2] += np.array([growth[0] / 2.0, 0.0])
    fit = pitch.choose_pitch(frames, replace(tripod(), mean=moved), mean, sd, template_curves(template()), LIMIT_PX)
    sigma = np.array([fit.estimate.sigma("length"), fit.estimate.sigma("breadth")])
    assert (np.abs(fit.estimate.growth_m - growth)[:1] < 3.0 * sigma[:1]).all()
    assert sigma[0] > 0.3


def test_a_penalty_area_that_comes_into_view_tells_a_length_that_was_open() -> None:
    length, heads = PLACE["length"], [HEAD + np.array([0.0, 0.01 * k, 0.0]) for k in range(2)]
    pictures = [draw(head, np.random.default_rng(k)) for k, head in enumerate(heads)]
    looked_at = {str(k): LookedAt.of(p, load_config().mask) for k, p in enumerate(pictures)}
    members = [HeadedFrame(str(k), head, measure_ideal(head, np.zeros(2), 0.1, np.random.default_rng(k)))
               for k, head in enumerate(heads)]  # fmt: skip
    wrong = tripod()
    wrong.mean[length], wrong.covariance[length, length] = 6.0, 3.0**2
    found = pitch.search_length(wrong, members, looked_at, template())
    assert found is not None
    assert abs(found.mean[length]) <= pitch.LENGTH_STEP_M / 2.0
    wrong.covariance[length, length] = 0.1**2
    assert pitch.search_length(wrong, members, looked_at, template()) is None


@pytest.mark.parametrize(
    ("is_rough", "costs", "is_held"),
    [(False, 10.0, True), (False, 12.0, False), (True, 12.0, True), (True, 21.0, False)],
)
def test_a_size_is_held_where_another_one_explains_little_more_beside_what_the_models_leave(
    is_rough, costs, is_held, monkeypatch
):
    """From behind a goal 104.2 m cost 12 less than 105 m so counted, and the paint lay as well on either's markings."""
    spread = 8.0 if is_rough else 1.0

    def fit_of(cost):
        estimate = replace(tripod(), covariance=1e-4 * np.eye(len(PLACE)))
        return SimpleNamespace(estimate=estimate, cost=cost, spread=spread, clear_rms_px=np.zeros(2))

    free, fixed = fit_of(100.0), fit_of(100.0 + spread * costs)
    monkeypatch.setattr(pitch, "leave_out_false_line", lambda frames, *given: (frames, [free, free]))
    monkeypatch.setattr(pitch, "count_alike", lambda fit: 2.0 if is_rough else 1.0)
    monkeypatch.setattr(
        pitch, "fit_tripod", lambda frames, start, mean, sd, *given, **more: fixed if sd.min() == 0.0 else free
    )
    found = pitch.choose_pitch(
        [], tripod(), np.zeros(len(PLACE)), np.ones(len(PLACE)), template_curves(template()), LIMIT_PX
    )
    assert (found is fixed) is is_held
