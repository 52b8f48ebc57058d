"""What a rig tells of its tripod, whatever of it is fixed and on whichever side it stands."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.geometry.camera_parameters import ANGLES, INDEX, KAPPA_1, PARAMETERS, POSITION
from circlecal.rig.estimation import _stand_together, config_with_prior, estimate_rigs
from circlecal.rig.information import estimate_common
from circlecal.rig.run import RigReport
from circlecal.rig.tripod import PLACE
from circlecal.rig.tripod_of_rig import tripod_of_rig
from circlecal.synthetic.cameras import aim_camera

from .scenes import CIRCLE, TEMPLATE, calibrated

PLACE_M = np.array([3.0, 62.0, -15.0])
SETTINGS = ("camera.starts=2", "camera.iterations=30", "camera.crown_shape=flat", "camera.maximum_points=60")
AT_PLACE = f"camera.position_m={PLACE_M.tolist()}"


def frames_from(place_m):
    rng = np.random.default_rng(2)
    views = [aim_camera(place_m, np.array([x, 1.0, 0.0]), 3000.0, 0.0, 1920, 1080, 0.03) for x in (-5.0, -2, 1, 4)]
    return [calibrated(f"f{k}", view, rng) for k, view in enumerate(views)]


@pytest.fixture(scope="module")
def frames():
    return frames_from(PLACE_M)


@pytest.mark.parametrize(
    "fixed",
    [
        ("rig.lever_sd_m=0",),
        ("rig.lean_sd_deg=0",),
        ("rig.lever_sd_m=0", "rig.lever_m=0", "rig.lean_sd_deg=0"),
        ("camera.roll_sd_deg=0",),
        (AT_PLACE, "camera.position_sd_m=[0, 0, 0]"),
        (AT_PLACE, "camera.position_sd_m=[0, 0.5, 0]"),
    ],
)
def test_a_rig_of_which_something_is_fixed_tells_its_tripod(frames, fixed):
    config = load_config(None, [*SETTINGS, *fixed])
    (rig,) = estimate_rigs(frames, TEMPLATE, CIRCLE, config)
    tripod = tripod_of_rig(rig)
    heads = tripod.model.own_of(rig.state.theta, tripod.mean)
    cameras = tripod.model.thetas(heads, tripod.mean)
    np.testing.assert_allclose(cameras[:, POSITION], rig.state.theta[:, POSITION], atol=0.1)
    np.testing.assert_allclose(cameras[:, ANGLES], rig.state.theta[:, ANGLES], atol=2e-3)
    free = rig.problem.priors.sd[POSITION] > 0
    told = config_with_prior(config, rig.prior(), 1920).camera
    np.testing.assert_array_equal(np.array(told.position_sd_m) > 0, free)
    np.testing.assert_allclose(told.position_m, PLACE_M, atol=1.5)
    (summary,) = RigReport([rig]).summary()["cameras"]
    assert [summary[name] is not None for name in "xyz"] == free.tolist()
    assert _stand_together(rig, rig)


@pytest.mark.parametrize("x_m", [0.02, -0.02])
@pytest.mark.parametrize("turns", ["on a tripod", "about one point"])
def test_the_head_of_a_camera_beyond_the_far_touchline_moves_as_little_as_that_of_one_before_the_near_one(x_m, turns):
    fixed = () if turns == "on a tripod" else ("rig.lever_sd_m=0", "rig.lever_m=0", "rig.lean_sd_deg=0")
    config = load_config(None, [*SETTINGS, *fixed])
    (rig,) = estimate_rigs(frames_from(np.array([x_m, -62.0, -15.0])), TEMPLATE, CIRCLE, config)
    assert np.ptp(rig.state.theta[:, INDEX["pan"]] % (2 * np.pi)) < 0.2
    tripod = tripod_of_rig(rig)
    assert tripod.head_high[1] - tripod.head_low[1] < 0.2
    assert tripod.head_low[1] < np.pi < tripod.head_high[1]


def test_what_single_frames_may_deviate_makes_a_tripod_less_certain(frames):
    deviating = ("rig.position_deviation_m=0.3", "rig.roll_deviation_deg=0.2")
    (rig,) = estimate_rigs(frames, TEMPLATE, CIRCLE, load_config(None, [*SETTINGS, *deviating]))
    _, spread = estimate_common(rig.state)
    told, shared = tripod_of_rig(rig).covariance, [PARAMETERS[k] for k in rig.problem.shared]
    for name, place, sd in (("y", "axis_y", 0.3), ("roll", "head_roll", np.radians(0.2)), ("crown", "crown", 0.0)):
        own = spread[shared.index(name), shared.index(name)] if name in shared else 0.0
        assert told[PLACE[place], PLACE[place]] == pytest.approx(own + sd**2, rel=1e-9)
    off_diagonal = spread[shared.index("x"), shared.index("y")]
    assert told[PLACE["axis_x"], PLACE["axis_y"]] == pytest.approx(off_diagonal, rel=1e-9)


@pytest.mark.parametrize(
    ("told", "by_focal"), [((), 0.04), (("camera.k1_mean=0.03",), 0.0), (("rig.k1_by_zoom=0",), 0.0)]
)
def test_the_tripod_has_the_lens_of_its_rig_at_any_zoom(frames, told, by_focal):
    (rig,) = estimate_rigs(frames, TEMPLATE, CIRCLE, load_config(None, [*SETTINGS, *told]))
    tripod, prior, away = tripod_of_rig(rig), rig.prior(), rig.problem.log_focal + np.array([-0.5, 0.0, 0.8])
    assert tripod.mean[PLACE["kappa_1_by_focal"]] == by_focal
    assert (tripod.sigma("kappa_1_by_focal") > 0.0) == (by_focal > 0.0)
    heads = np.column_stack([away, np.tile(tripod.head_low[1:], (3, 1))])
    lens = tripod.model.thetas(heads, tripod.mean)[:, KAPPA_1]
    np.testing.assert_allclose(lens, prior.at(away)[0][:, prior.parameters.index("kappa_1")], atol=1e-12)
