"""A tripod from frames whose markings were measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.camera.options import usual_k1_by_focal, usual_kappa
from circlecal.config import load_config
from circlecal.geometry.camera_parameters import KAPPA_1
from circlecal.geometry.surface import Surface
from circlecal.rig.tripod import PLACE, TripodEstimate
from circlecal.tracking.frame_paint import PART_M, HeadedFrame
from circlecal.tracking.markings import template_curves
from circlecal.tracking.tripod_fit import (
    _tell_covariance,
    common_priors,
    count_alike,
    fit_tripod,
    free_parameters,
    start_tripod,
)
from circlecal.tracking.tripod_problem import TripodProblem
from tests.tracking.scenes import (
    HEAD,
    SIZE,
    measure_ideal,
    template,
    tripod,
    views_of_a_pitch,
    views_of_badly_painted_markings,
)


def test_what_frames_repeat_does_not_average_out() -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    sd[PLACE["width"]] = 0.0
    frames, drawn = views_of_badly_painted_markings(1, 1.4), template_curves(template())
    fit = fit_tripod(frames, tripod(), mean, sd, drawn)
    assert count_alike(fit) == len(frames)
    alike = fit_tripod(frames, tripod(), mean, sd, drawn, alike=count_alike(fit))
    assert alike.estimate.sigma("length") > 1.5 * fit.estimate.sigma("length")
    assert count_alike(fit_tripod(views_of_a_pitch(105.0, 68.0), tripod(), mean, sd, drawn)) == 1.0


def test_only_what_frames_repeat_does_not_average_out_where_little_is_left() -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    sd[PLACE["width"]] = 0.0
    heads = [np.array([np.log(2600.0), pan, 1.38]) for pan in (0.0, -0.42)]

    def sigma_m(is_repeated: bool) -> float:
        rng = np.random.default_rng(7)
        frames = [measure_ideal(head, np.zeros(2), 0.1, rng) for head in heads for _ in range(8)]
        frames = [frames[k // 8 * 8] if is_repeated else frame for k, frame in enumerate(frames)]
        headed = [HeadedFrame(str(k), heads[k // 8], frame) for k, frame in enumerate(frames)]
        return fit_tripod(headed, tripod(), mean, sd, template_curves(template())).estimate.sigma("length")

    assert sigma_m(True) > 1.5 * sigma_m(False)


def test_the_last_fit_tells_what_models_leave_of_whole_markings() -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    sd[PLACE["width"]] = 0.0
    drawn = template_curves(template())
    for seed in (1, 3, 4):
        frames = views_of_badly_painted_markings(seed, 1.4)
        start = fit_tripod(frames, tripod(), mean, sd, drawn)
        alike = count_alike(start)
        before = fit_tripod(frames, start.estimate, mean, sd, drawn, alike=alike).estimate
        last = fit_tripod(frames, start.estimate, mean, sd, drawn, alike=alike, parts_m=PART_M).estimate
        np.testing.assert_array_equal(last.mean, before.mean)
        off = abs(last.mean[PLACE["length"]])
        assert off > 3.0 * before.sigma("length")
        assert off / last.sigma("length") < 0.8 * off / before.sigma("length")


def test_along_the_valley_of_a_camera_that_stands_still_any_start_leads_to_one_optimum() -> None:
    """Zoom, distance and width of the pitch make up for each other where circle and far touchline are seen alone."""
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    mean[[PLACE["kappa_1_by_zoom"], PLACE["kappa_1_by_focal"]]] = (
        0.0  # the lens of these views does not follow the zoom
    )
    sd[PLACE["width"]] = 0.0
    drawn, head, rng = template_curves(template()), np.array([np.log(2600.0), 0.02, 1.38]), np.random.default_rng(3)
    seen = measure_ideal(head, np.array([0.0, -5.0]), 0.0, rng).leave_out(drawn.names.index("side_line_bottom"))
    frames = [HeadedFrame(str(k), head, seen) for k in range(12)]
    there, aside = tripod().mean.copy(), tripod().mean.copy()
    there[PLACE["breadth"]] = -5.0
    aside[[PLACE["axis_y"], PLACE["axis_z"]]] += (8.0, -1.5)
    found, other = (fit_tripod(frames, replace(tripod(), mean=start), mean, sd, drawn) for start in (there, aside))
    assert abs(found.estimate.growth_m[1] + 5.0) < 0.2
    assert found.estimate.sigma("breadth") > 1.0
    np.testing.assert_allclose(other.estimate.growth_m, found.estimate.growth_m, atol=0.01)


def test_a_lever_arm_points_ahead() -> None:
    rng = np.random.default_rng(3)
    heads = [np.array([np.log(2600.0), pan, 1.38]) for pan in (0.1, 0.0, -0.2, -0.4)]
    frames = [HeadedFrame(str(head[1]), head, measure_ideal(head, np.zeros(2), 0.1, rng, -1.0)) for head in heads]
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    sd[[PLACE["length"], PLACE["breadth"]]] = mean[[PLACE["length"], PLACE["breadth"]]] = 0.0
    fit = fit_tripod(frames, tripod(), mean, sd, template_curves(template()))
    assert fit.estimate.mean[PLACE["lever"]] == 0.0
    # where somebody has measured it, it is taken as it is
    mean[PLACE["lever"]] = -1.0
    fit = fit_tripod(frames, tripod(), mean, sd, template_curves(template()))
    assert fit.estimate.mean[PLACE["lever"]] < -0.5


def test_a_frame_that_shows_nothing_but_a_line_that_is_left_out_takes_nothing_from_the_others() -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    frames, drawn = views_of_a_pitch(105.0, 68.0), template_curves(template())
    bare = frames[0].measured
    for line in np.unique(bare.marking).tolist():
        bare = bare.leave_out(line)
    alone = fit_tripod(frames[1:], tripod(), mean, sd, drawn)
    fit = fit_tripod([replace(frames[0], measured=bare), *frames[1:]], tripod(), mean, sd, drawn)
    assert len(bare.marking) == 0 and fit.rms_px[0] == 0.0
    np.testing.assert_allclose(fit.estimate.mean, alone.estimate.mean, atol=1e-3)
    assert np.isfinite(count_alike(fit))


def test_where_the_camera_is_known_to_stand_its_tripod_stands() -> None:
    frames, drawn = views_of_a_pitch(105.0, 68.0)[:1], template_curves(template())
    start = tripod()
    true = start.mean[:3]

    def fit(*options: str) -> TripodEstimate:
        config = load_config(None, options)
        mean, sd = common_priors(config.camera, config.rig, template(), SIZE)
        return fit_tripod(frames, start, mean, sd, drawn).estimate

    told = fit(f"camera.position_m={true.tolist()}", "camera.position_sd_m=[0.02, 0.02, 0.02]")
    assert (told.sigma("axis_y"), np.abs(told.mean[:3] - true).max()) < (0.02, 0.02)
    assert told.sigma("axis_y") < 0.2 * fit().sigma("axis_y")
    exact = fit(f"camera.position_m={true.tolist()}", "camera.position_sd_m=[0, 0, 0]")
    np.testing.assert_allclose(exact.mean[:3], true, rtol=0, atol=1e-12)


def test_the_lens_of_a_tripod_is_expected_as_that_of_a_frame_with_its_focal_length() -> None:
    camera, kappa, slope = load_config().camera, PLACE["kappa_1"], PLACE["kappa_1_by_zoom"]
    wide, long = (common_priors(camera, load_config().rig, template(), SIZE, widths)[0] for widths in (1.0, 4.0))
    assert wide[kappa] == pytest.approx(0.035 - 0.04)
    assert (wide[slope], long[slope]) == (pytest.approx(0.08), pytest.approx(0.005))
    assert long[kappa] == pytest.approx(0.035 - 0.04 / 16.0)
    told = camera.model_copy(update={"k1_mean": 0.03})
    mean, _ = common_priors(told, load_config().rig, template(), SIZE, 1.0)
    assert (mean[kappa], mean[slope]) == (0.03, 0.0)
    assert usual_k1_by_focal(told) == 0.0 == usual_k1_by_focal(camera.model_copy(update={"distortion": "none"}))


def test_the_lens_of_a_tripod_bends_with_the_zoom_as_that_of_a_frame() -> None:
    config = load_config()
    theta = tripod().model.thetas(np.array([HEAD]), tripod().mean)
    widths = float(np.exp(theta[0, 0])) / SIZE[0]
    mean, sd = common_priors(config.camera, config.rig, template(), SIZE, widths)
    start = start_tripod("camera-1", theta, SIZE, Surface(), mean, sd)
    common = start.mean.copy()
    common[PLACE["kappa_1"]] = usual_kappa(config.camera, widths)
    others = np.array([0.8, 1.0, 2.0, 4.0])
    heads = np.column_stack([np.log(others * SIZE[0]), np.tile(HEAD[1:], (4, 1))])
    usual = [usual_kappa(config.camera, focal) for focal in others]
    np.testing.assert_allclose(start.model.thetas(heads, common)[:, KAPPA_1], usual, atol=1e-12)


def test_what_a_tripod_says_grows_less_certain_with_what_it_leaves_of_the_paint() -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    frames, drawn = views_of_a_pitch(105.0, 68.0), template_curves(template())
    problem, heads, common = TripodProblem.of(
        frames,
        tripod(),
        drawn,
        mean,
        np.diag(np.where(sd > 0.0, sd, np.inf) ** -2.0),
        free_parameters(sd, is_width_free=True),
        1.0,
    )
    at = problem.evaluate(heads, common, 2.0)
    places = sum(len(frame.measured.marking) for frame in frames) - 3 * len(frames)

    def tell(cost: float) -> NDArray[np.float64]:
        return _tell_covariance(problem, replace(at, normal=replace(at.normal, cost=cost)), 1.0, sd, True)

    usual = tell(float(places))
    np.testing.assert_array_equal(tell(0.1 * places), usual)
    np.testing.assert_allclose(tell(4.0 * places), 4.0 * usual)


def test_a_tripod_follows_the_width_of_the_paint_as_its_covariance_says() -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    frames, drawn, width = views_of_a_pitch(105.0, 68.0), template_curves(template()), PLACE["width"]
    usual = fit_tripod(frames, tripod(), mean, sd, drawn).estimate
    broader = mean.copy()
    broader[width] = 0.01
    moved = fit_tripod(frames, tripod(), broader, sd, drawn).estimate.mean - usual.mean
    told = usual.covariance[width] / usual.covariance[width, width] * 0.01
    for name in ("axis_y", "axis_z", "length"):
        assert moved[PLACE[name]] == pytest.approx(told[PLACE[name]], rel=0.2), name
