"""Many frames of one camera in one problem: derivatives, elimination, and what is said of a single frame."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.priors import Priors, ZoomLens
from circlecal.camera.problem import Problem, minimise
from circlecal.camera.residuals import sample_feet
from circlecal.evaluation.bench.many_frames import joint_covariances
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1, PARAMETERS, ProjectionModel, camera_of, theta_of
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations
from circlecal.rig.information import deletion_gains, frame_information, shared_prior
from circlecal.rig.joint import ABOUT_ONE_POINT, Turning, evaluate_joint, joint_problem, minimise_joint, start_state
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.markings import circle_points, line_points

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080, Surface("flat"))
ZOOM = {"pp_x": 10.0, "kappa_1": 0.01}
DEVIATION = {"x": 0.1, "roll": 0.001}
ON_TRIPOD = Turning(np.array([0.0, 0.0, 0.6]), np.array([0.01, 0.01, 0.4]))
KNOWN_TRIPOD = Turning(np.array([0.004, -0.006, 0.3]), np.zeros(3))


def priors():
    mean, sd = np.zeros(len(PARAMETERS)), np.zeros(len(PARAMETERS))
    sd[:7] = np.inf
    for name, value in {"roll": 0.05, "pp_x": 5.0, "pp_y": 5.0, "kappa_1": 0.015, "bloom": 0.3}.items():
        sd[INDEX[name]] = value
    mean[INDEX["kappa_1"]] = 0.03
    return Priors(mean, sd, 64.0, 0.6, np.radians(15), np.radians(10), np.zeros(2))


def views(count, rng, kappa=0.03):
    first = sample_camera("main", rng, kappa=kappa)
    return [first] + [sample_camera("main", rng, like=first, kappa=kappa) for _ in range(count - 1)]


def problem_of(camera, rng, sigma=0.5):
    seen = Observations(
        1920,
        1080,
        (circle_points(camera, SOCCER, "center", 80, sigma, rng),),
        (line_points(camera, SOCCER, "halfway_line", 40, sigma, rng),),
    )
    return Problem(
        curves_from_observations(seen, SOCCER, NoiseModel(500, 0.0, 0.0)),
        points_from_observations(seen, SOCCER),
        priors(),
        MODEL,
        6.0,
    )


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(3)
    cameras = views(4, rng)
    problems = [problem_of(camera, rng) for camera in cameras]
    truth = np.array([theta_of(camera, MODEL) for camera in cameras])
    return problems, truth


def joint(scene, zoom=ZOOM, deviation=DEVIATION):
    problems, truth = scene
    problem = joint_problem(problems, zoom, deviation, float(np.median(truth[:, 0])))
    return problem, minimise_joint(problem, start_state(problem, truth))


def flat(problem, state):
    return np.concatenate([state.own.ravel(), state.common])


def unflat(problem, state, values):
    return values[: state.own.size].reshape(state.own.shape), values[state.own.size :]


def dense_normal(state):
    """The whole Gauss-Newton matrix from its blocks."""
    frames, own, common = state.H_oc.shape
    total = np.zeros((frames * own + common,) * 2)
    for f in range(frames):
        block = slice(f * own, (f + 1) * own)
        total[block, block] = state.H_oo[f]
        total[block, frames * own :] = state.H_oc[f]
        total[frames * own :, block] = state.H_oc[f].T
    total[frames * own :, frames * own :] = state.H_common + state.H_cc.sum(axis=0)
    return total


def gradient_of(state):
    return np.concatenate([state.g_o.ravel(), state.g_common + state.g_c.sum(axis=0)])


def test_gradient_is_that_of_the_cost(scene):
    problem, state = joint(scene)
    rng = np.random.default_rng(0)
    own = state.own + rng.normal(0, 1e-4, state.own.shape)
    common = state.common + rng.normal(0, 1e-4, state.common.shape)
    # without a robust loss the gradient that is used is exactly half that of the cost
    problem = problem.with_loss(np.inf)
    here = evaluate_joint(problem, own, common, state.feet, updates=6)
    gradient, values = gradient_of(here), flat(problem, here)
    size = np.sqrt(np.diag(dense_normal(here)))
    least = 2e-3 * np.abs(gradient / size).max() * size
    for k in range(len(values)):
        step = np.zeros_like(values)
        step[k] = 1e-5 * max(1.0, abs(values[k]) * 1e-2)
        costs = [
            evaluate_joint(problem, *unflat(problem, here, values + s * step), here.feet, updates=6).cost[0]
            for s in (1, -1)
        ]
        measured = (costs[0] - costs[1]) / (4 * step[k])
        assert measured == pytest.approx(gradient[k], rel=2e-3, abs=least[k]), k


@pytest.mark.parametrize("turning", [ABOUT_ONE_POINT, ON_TRIPOD])
def test_gradient_of_the_priors_is_that_of_their_cost(scene, turning):
    """Told by how a problem differs from one without them: what was seen says a thousand times as much."""
    problems, truth = scene
    problem = joint_problem(problems, ZOOM, DEVIATION, float(np.median(truth[:, 0])), turning)
    endless = replace(turning, sd=np.where(turning.sd > 0, np.inf, 0.0))
    without = replace(
        problem, deviation_sd=np.inf * problem.deviation_sd, slope_sd=np.inf * problem.slope_sd, turning=endless
    )
    start = start_state(problem, truth)
    own, common = start.own.copy(), start.common.copy()
    # about a standard deviation beside what is expected
    own[:, len(problem.own) :] = np.array([[1.0], [-1.5], [0.7], [2.0]]) * problem.deviation_sd
    sd = np.concatenate([problem.slope_sd, turning.sd[turning.free]])
    common[len(problem.shared) :] += np.resize([1.0, -1.5, 0.7], len(sd)) * sd

    def told(values):
        given, bare = (evaluate_joint(p, *unflat(p, start, values), start.feet) for p in (problem, without))
        return given.cost[0] - bare.cost[0], gradient_of(given) - gradient_of(bare)

    values = np.concatenate([own.ravel(), common])
    _, gradient = told(values)
    assert np.count_nonzero(np.abs(gradient) > 0.05) == len(truth) * len(problem.deviating) + len(sd)
    for k in np.flatnonzero(gradient):
        step = 1e-4 * (np.arange(len(values)) == k)
        measured = (told(values + step)[0] - told(values - step)[0]) / 4e-4
        assert measured == pytest.approx(gradient[k], rel=1e-3, abs=1e-3), k


def test_optimum_has_no_gradient_and_no_worse_cost_than_the_truth(scene):
    problem, state = joint(scene)
    start = start_state(problem, scene[1])
    assert state.cost <= start.cost
    gradient = np.concatenate([state.g_o.ravel(), state.g_common + state.g_c.sum(axis=0)])
    size = np.sqrt(np.diag(dense_normal(state)))
    assert np.abs(gradient / size).max() < 1e-2


def test_eliminated_covariance_is_the_dense_one(scene):
    _, state = joint(scene)
    normal = dense_normal(state)
    size = np.sqrt(np.diag(normal))
    dense = np.linalg.inv(normal / np.outer(size, size)) / np.outer(size, size)
    found = joint_covariances(state)
    frames, own, _ = state.H_oc.shape
    for f in range(frames):
        mapping = np.zeros((len(PARAMETERS), len(dense)))
        mapping[:, f * own : (f + 1) * own] = state.by_own[f]
        mapping[:, frames * own :] = state.by_common[f]
        np.testing.assert_allclose(found[f], mapping @ dense @ mapping.T, rtol=1e-4, atol=1e-12)


def test_frames_add_up_to_what_is_shared(scene):
    problem, state = joint(scene)
    precision, _ = frame_information(state)
    whole = shared_prior(problem, state)
    np.testing.assert_allclose(
        np.linalg.inv(whole.covariance), state.H_common + precision.sum(axis=0), rtol=1e-4, atol=1e-3
    )
    without = shared_prior(problem, state, 0)
    assert (np.diag(without.covariance) >= np.diag(whole.covariance) * (1 - 1e-9)).all()


@pytest.mark.parametrize(("zoom", "deviation"), [({}, {}), (ZOOM, DEVIATION)])
def test_a_frame_under_what_the_others_say_is_the_joint_frame(scene, zoom, deviation):
    problem, state = joint(scene, zoom, deviation)
    told = shared_prior(problem, state, 1)
    own = priors()
    sd = own.sd.copy()
    sd[told.indices] = np.inf
    alone = replace(
        scene[0][1], priors=replace(own, sd=sd, distance_log_sd=np.inf, elevation_sd_rad=np.inf, shared=told)
    )
    fitted = minimise(alone, scene[1][1:2])
    difference = fitted.theta[0] - state.theta[1]
    spread = joint_covariances(state)[1]
    sigma = np.sqrt(np.diag(spread))
    moving = sigma > 0
    # the change with the zoom is taken at its mean in the single frame
    assert np.abs(difference[moving] / sigma[moving]).max() < (0.02 if not zoom else 0.2)
    np.testing.assert_allclose(
        np.sqrt(np.diag(posterior_covariance(fitted.normal[0], sd)))[moving], sigma[moving], rtol=0.1
    )


def test_five_frames_are_better_than_one():
    gains = []
    for seed in range(4):
        rng = np.random.default_rng([7, seed])
        cameras = views(5, rng)
        problems = [problem_of(camera, rng) for camera in cameras]
        truth = np.array([theta_of(camera, MODEL) for camera in cameras])
        alone = np.array([minimise(p, t[None]).theta[0] for p, t in zip(problems, truth, strict=True)])
        problem = joint_problem(problems, {}, {}, float(np.median(truth[:, 0])))
        state = minimise_joint(problem, start_state(problem, alone))
        errors = [np.linalg.norm(theta[:, 4:7] - truth[:, 4:7], axis=1).mean() for theta in (alone, state.theta)]
        gains.append(errors[1] / errors[0])
    assert np.median(gains) < 0.7


def test_covariance_holds_over_draws():
    inside, expected = [], []
    for seed in range(16):
        rng = np.random.default_rng([11, seed])
        cameras = views(3, rng, kappa=float(rng.normal(0.03, 0.015)))
        shift = rng.normal(0, 5.0, 2)
        cameras = [replace(c, principal_point_px=c.principal_point_px + shift) for c in cameras]
        problems = [problem_of(camera, rng) for camera in cameras]
        truth = np.array([theta_of(camera, MODEL) for camera in cameras])
        problem = joint_problem(problems, {}, {}, float(np.median(truth[:, 0])))
        state = minimise_joint(problem, start_state(problem, truth))
        told = shared_prior(problem, state)
        values, _ = told.residuals(truth[:1])
        inside.append(float(values[0] @ values[0]))
        expected.append(len(told.parameters))
    # mean of a chi-squared variable is its number of degrees of freedom
    assert np.mean(inside) == pytest.approx(np.mean(expected), rel=0.35)


def test_zoom_that_moves_the_principal_point_is_found():
    rng = np.random.default_rng(5)
    cameras = views(12, rng)
    mean = np.mean([np.log(c.focal_px[0]) for c in cameras])
    moved = [
        replace(c, principal_point_px=c.principal_point_px + np.array([30.0 * (np.log(c.focal_px[0]) - mean), 0.0]))
        for c in cameras
    ]
    problems = [problem_of(camera, rng, sigma=0.1) for camera in moved]
    truth = np.array([theta_of(camera, MODEL) for camera in moved])
    errors = {}
    for name, zoom in (("fixed", {}), ("by zoom", {"pp_x": 30.0})):
        problem = joint_problem(problems, zoom, {}, float(mean))
        state = minimise_joint(problem, start_state(problem, truth))
        grid = np.stack(np.meshgrid(np.linspace(-12, 12, 7), np.linspace(-12, 12, 7)), axis=-1).reshape(-1, 2)
        errors[name] = np.mean(
            [
                np.abs(camera_of(a, MODEL).project(grid) - camera_of(b, MODEL).project(grid)).mean()
                for a, b in zip(state.theta, truth, strict=True)
            ]
        )
    assert errors["by zoom"] < 0.5 * errors["fixed"]


def test_foot_parameters_start_on_their_markings(scene):
    problem, state = joint(scene)
    for frame, theta, feet in zip(problem.frames, state.theta, state.feet, strict=True):
        near = sample_feet(frame.curves, theta[None], frame.model, samples=720)
        circle = frame.curves.radius > 0
        apart = np.abs(np.angle(np.exp(1j * (near - feet)[0, circle])))
        assert apart.max() < 0.05


def test_derivatives_of_a_camera_that_turns_on_a_tripod(scene):
    problems, truth = scene
    problem = joint_problem(problems, ZOOM, DEVIATION, float(np.median(truth[:, 0])), turning=ON_TRIPOD)
    rng = np.random.default_rng(4)
    state = start_state(problem, truth)
    own = state.own + rng.normal(0, 1e-3, state.own.shape)
    common = state.common + np.r_[rng.normal(0, 1e-3, len(state.common) - 3), 0.004, -0.006, 0.3]
    by_own, by_common = problem.mappings(own, common)
    for k in range(own.shape[1]):
        step = 1e-6 * (np.arange(own.shape[1]) == k)
        difference = (problem.thetas(own + step, common) - problem.thetas(own - step, common)) / 2e-6
        np.testing.assert_allclose(by_own[..., k], difference, atol=1e-6)
    for k in range(len(common)):
        step = 1e-6 * (np.arange(len(common)) == k)
        difference = (problem.thetas(own, common + step) - problem.thetas(own, common - step)) / 2e-6
        np.testing.assert_allclose(by_common[..., k], difference, atol=1e-6)


def test_heads_of_cameras_on_a_tripod(scene):
    problems, truth = scene
    problem = joint_problem(problems, {}, {}, float(np.median(truth[:, 0])), turning=ON_TRIPOD)
    state = start_state(problem, truth)
    common = state.common + np.r_[np.zeros(len(state.common) - 3), 0.004, -0.006, 0.3]
    heads = problem.heads_of(problem.thetas(state.own, common), common)
    np.testing.assert_allclose(heads, problem.on_head(state.own, common), atol=1e-9)


def test_what_is_known_of_a_tripod_is_not_estimated(scene):
    problems, truth = scene
    log_focal = float(np.median(truth[:, 0]))
    known = joint_problem(problems, {}, {}, log_focal, turning=KNOWN_TRIPOD)
    free = joint_problem(problems, {}, {}, log_focal, turning=ON_TRIPOD)
    state = start_state(known, truth)
    assert len(state.common) == len(known.shared) == len(start_state(free, truth).common) - 3
    both = np.r_[state.common, KNOWN_TRIPOD.mean]
    np.testing.assert_allclose(known.thetas(state.own, state.common), free.thetas(state.own, both))
    by_own, by_common = known.mappings(state.own, state.common)
    of_free = free.mappings(state.own, both)
    np.testing.assert_allclose(by_own, of_free[0])
    np.testing.assert_allclose(by_common, of_free[1][..., :-3])


def test_what_frames_say_of_a_camera_hangs_on_where_it_points_not_on_where_it_was_thought_to_stand(scene):
    problems, truth = scene
    problem = joint_problem(problems, {}, {}, float(np.median(truth[:, 0])), turning=ON_TRIPOD)
    state = minimise_joint(problem, start_state(problem, truth))
    elsewhere = truth[1].copy()
    elsewhere[[INDEX["x"], INDEX["y"], INDEX["z"]]] += (4.0, -3.0, 2.0)
    near, far = (shared_prior(problem, state, 1, theta) for theta in (truth[1], elsewhere))
    np.testing.assert_allclose(far.mean, near.mean, atol=1e-9)
    np.testing.assert_allclose(far.covariance, near.covariance, rtol=1e-9, atol=1e-12)


def test_a_lens_is_expected_to_follow_the_zoom_as_that_of_one_frame_is():
    rng = np.random.default_rng(5)
    problem, lens = problem_of(views(1, rng)[0], rng), ZoomLens(0.035, 0.04, 1920)
    following = replace(problem, priors=replace(problem.priors, lens=lens))
    log_focal = float(np.log(3000.0))
    told, free = (joint_problem([one], ZOOM, DEVIATION, log_focal) for one in (problem, following))
    slopes = dict(zip(free.zoomed.tolist(), free.slope_mean.tolist(), strict=True))
    assert slopes == {INDEX["pp_x"]: 0.0, INDEX["kappa_1"]: pytest.approx(float(lens.slope(np.array(log_focal))))}
    assert not told.slope_mean.any()
    theta = theta_of(views(1, rng)[0], MODEL)[None]
    started = start_state(free, theta).common[len(free.shared) :]
    np.testing.assert_array_equal(started, free.slope_mean)


def test_lenses_bend_with_the_zoom_as_that_of_one_frame_does():
    """All frames of a camera lie on the law of single ones, beside offset and slope of their own; derivatives too."""
    rng, lens = np.random.default_rng(5), ZoomLens(0.035, 0.04, 1920)
    problems = [problem_of(camera, rng) for camera in views(3, rng)]
    problems = [replace(one, priors=replace(one.priors, lens=lens)) for one in problems]
    theta = np.array([theta_of(camera, MODEL) for camera in views(3, rng)])
    theta[:, 0] = np.log([1300.0, 2500.0, 7000.0])
    log_focal = float(theta[1, 0])
    problem = joint_problem(problems, ZOOM, {}, log_focal)
    state = start_state(problem, theta)
    common = state.common.copy()
    K = len(problem.shared)
    kappa, slope = list(problem.shared).index(KAPPA_1), K + list(problem.zoomed).index(KAPPA_1)
    common[kappa], common[slope] = lens.kappa(log_focal) + 0.004, lens.slope(log_focal) - 0.006
    found = problem.thetas(state.own, common)[:, KAPPA_1]
    np.testing.assert_allclose(found, lens.kappa(theta[:, 0]) + 0.004 - 0.006 * (theta[:, 0] - log_focal), atol=1e-12)
    step = np.zeros_like(state.own)
    zoom = list(problem.own).index(INDEX["log_focal"])
    step[:, zoom] = 1e-6
    ahead, back = (problem.thetas(state.own + sign * step, common)[:, KAPPA_1] for sign in (1, -1))
    by_zoom = problem.mappings(state.own, common)[0][:, KAPPA_1, zoom]
    np.testing.assert_allclose(by_zoom, (ahead - back) / 2e-6, atol=1e-8)
    told = shared_prior(problem, replace(state, common=common))
    np.testing.assert_allclose(
        told.at(theta[:, 0])[2][:, told.parameters.index("kappa_1")] - by_zoom, told.mean[-1] - common[slope]
    )
    # a lens that is told not to follow the zoom does not bend either
    still = joint_problem(problems, {}, {}, log_focal)
    assert np.ptp(still.thetas(state.own, common[:K])[:, KAPPA_1]) == 0.0


def test_what_the_others_gain_without_a_frame_is_what_they_gain_when_they_are_fitted_alone(scene):
    problems, _ = scene
    problem, state = joint(scene, {}, {})
    gains = deletion_gains(state)
    for k in range(len(problems)):
        others = [f for f in range(len(problems)) if f != k]
        left = joint_problem([problems[f] for f in others], {}, {}, problem.log_focal)
        alone = minimise_joint(left, start_state(left, state.theta[others]))
        gained = state.costs[others].sum() + state.common_cost - alone.cost[0]
        assert gains[k] == pytest.approx(gained, rel=0.15), k
