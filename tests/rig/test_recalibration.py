"""One frame again: which camera took it, and when that is not certain."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.geometry.camera_parameters import INDEX
from circlecal.observations import Observations
from circlecal.pipeline import run_observations
from circlecal.records.writing import result_record
from circlecal.rig.estimation import estimate_rigs
from circlecal.rig.frames import RigFrame
from circlecal.rig.recalibration import _try_rig, find_refusal, recalibrate
from circlecal.rig.run import RecordedFrame, RigTask, accept_short_arcs
from circlecal.synthetic.markings import line_points

from .scenes import CIRCLE, CONFIG, TEMPLATE, calibrated, displaced, goal_views, main_views, seen_by


@pytest.fixture(scope="module")
def cameras():
    """A main camera and one behind the goal, each from three frames, and a further view of each."""
    rng = np.random.default_rng(8)
    main, goal = main_views(4, rng), goal_views(4, rng)
    frames = [calibrated(f"m{k}", c, rng) for k, c in enumerate(main[:3])]
    frames += [calibrated(f"g{k}", c, rng) for k, c in enumerate(goal[:3])]
    rigs = estimate_rigs(frames, TEMPLATE, CIRCLE, CONFIG)
    return sorted(rigs, key=lambda rig: rig.members, reverse=True), frames, main[3], goal[3]


def again(frame, rigs):
    def calibrate(config):
        return run_observations(frame.observations, config, frame_id=frame.id, convention="paint")

    return recalibrate(frame, rigs, calibrate, TEMPLATE, CIRCLE, CONFIG)


def test_a_frame_without_halfway_line_goes_to_the_camera_that_took_it(cameras):
    rigs, _, *views = cameras
    rng = np.random.default_rng(1)
    for rig, view in zip(rigs, views, strict=True):
        found = again(RigFrame("x", seen_by(view, rng, line=False), None, None), rigs)
        assert found.rig is rig, found.reason
        assert found.calibration.attempt.camera.camera.position_m == pytest.approx(view.position_m, abs=2.0)


def test_two_cameras_at_one_place_are_not_decided(cameras):
    rigs, _, view, _ = cameras
    twins = [rigs[0], replace(rigs[0], name="twin", members=(), used=())]
    found = again(RigFrame("x", seen_by(view, np.random.default_rng(1), line=False), None, None), twins)
    assert found.rig is None
    assert "equally well" in found.reason


def test_a_wrong_camera_is_mended(cameras):
    rigs, frames, *_ = cameras
    wrong = displaced(replace(frames[0], id="w"), (1.0, 8.0, -2.0), 0.05)
    wrong = replace(wrong, observations=frames[0].observations)
    found = again(wrong, rigs)
    assert found.rig is rigs[0]
    assert found.calibration.attempt.camera.camera.position_m == pytest.approx(frames[0].theta[4:7], abs=2.5)


def test_a_camera_of_its_own_keeps_its_frame(cameras):
    rigs, *_ = cameras
    rng = np.random.default_rng(3)
    other = calibrated("o", main_views(1, np.random.default_rng(77))[0], rng, sigma=0.1)
    assert np.linalg.norm(other.theta[4:7] - rigs[0].state.theta[0, 4:7]) > 5.0
    found = again(other, rigs)
    assert found.calibration is None
    assert found.reason


def test_a_refused_frame_of_another_camera_is_not_taken(cameras):
    """A camera of the run nearly fits an arc and a touchline of one that stands lower, which alone leave zoom and
    distance open.
    """
    rigs, _, view, _ = cameras
    rng = np.random.default_rng(1)
    main = rigs[0]
    for height, is_taken in ((1.0, True), (0.85, False)):
        other = replace(view, position_m=view.position_m * (1.0, 1.0, height))
        far = line_points(other, TEMPLATE, "side_line_top", 60, 0.3, rng)
        seen = seen_by(other, rng, line=False, share=0.5)
        found = again(RigFrame("x", replace(seen, lines=(far,)), None, None), [main])
        assert (found.rig is main) is is_taken, (height, found.reason)
        assert is_taken or "worse than a camera of its own" in found.reason


def test_no_camera_no_change(cameras):
    frame = cameras[1][0]
    assert again(frame, []).reason == "no camera is known for it"


def test_detector_of_a_known_camera_asks_for_less():
    relaxed, usual = accept_short_arcs(CONFIG).mask.detector.acceptance, CONFIG.mask.detector.acceptance
    assert relaxed.whole_share == CONFIG.rig.whole_share < usual.whole_share
    assert relaxed.share_of_lone_arc < usual.share_of_lone_arc
    strict = CONFIG.model_copy(update={"rig": CONFIG.rig.model_copy(update={"whole_share": 0.9})})
    assert accept_short_arcs(strict).mask.detector.acceptance.whole_share == usual.whole_share


@pytest.mark.parametrize("shows_markings", [True, False])
def test_a_refused_frame_is_looked_at_with_the_camera_that_its_points_fit(
    cameras, monkeypatch, tmp_path, shows_markings
):
    rigs, _, view, _ = cameras
    picture = tmp_path / "x.png"
    picture.write_bytes(b"a picture")
    seen = seen_by(view, np.random.default_rng(1), line=False)
    looks = []

    def look(file, config, mask):
        looks.append(config)
        shown = seen if len(looks) == 1 or shows_markings else Observations(1920, 1080)
        return file, run_observations(shown, config, frame_id="x", source=str(picture), convention="paint")

    monkeypatch.setattr("circlecal.rig.run.calibrate_frame", look)
    alone = run_observations(seen, CONFIG, frame_id="x", source=str(picture), convention="paint")
    task = RigTask(CONFIG, (rigs[1], rigs[0]), None, None, "official", False)  # the camera that took it comes second
    found = task.record(RecordedFrame("x", result_record(alone, TEMPLATE)))
    assert len(looks) == 2
    assert found.status == ("calibrated" if shows_markings else "refused")
    assert found.rig.camera == (rigs[0].name if shows_markings else None)


def test_a_frame_that_founded_a_camera_keeps_it_however_much_worse_it_fits_than_alone(cameras):
    rigs, frames, *_ = cameras
    rig, frame = rigs[0], frames[0]

    def calibrate(config):
        return run_observations(frame.observations, config, frame_id=frame.id, convention="paint")

    def fit(name, excess):
        return _try_rig(replace(frame, id=name), rig, calibrate, lambda *_: 1.0, lambda *_: excess, CONFIG)

    limit = CONFIG.rig.maximum_chi_square_increase
    assert frame.id in rig.used and fit(frame.id, 1e9).calibration is not None
    assert fit("another", 0.9 * limit).calibration is not None
    refused = fit("another", 1.1 * limit)
    assert refused.calibration is None and "worse than a camera of its own" in refused.reason


@pytest.mark.parametrize("sigmas", [0.0, 20.0])
def test_a_calibration_that_stands_elsewhere_is_of_another_camera(cameras, sigmas):
    rigs, frames, *_ = cameras
    rig, frame = rigs[0], frames[0]
    found = run_observations(frame.observations, CONFIG, frame_id=frame.id, convention="paint")
    prior = rig.prior(frame.id, rig.state.theta[0])
    theta = rig.state.theta[0].copy()
    at = prior.parameters.index("y")
    theta[INDEX["y"]] = prior.mean[at] + sigmas * prior.frame_sd[at]
    moved = replace(found.attempt.camera, theta=theta)
    found = replace(found, attempt=replace(found.attempt, camera=moved))
    reason = find_refusal(found, frame, rig)
    assert reason is None if sigmas == 0.0 else f"another one than {rig.name}" in reason
