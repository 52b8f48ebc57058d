"""Row 10 of ``circlecal bench accuracy``: frames of one camera calibrated together, beside the joint Cramer-Rao bound.

Each draw is one camera that stands still with several zooms and aims. Every frame is calibrated alone, the camera is
estimated from all of them, and every frame is calibrated again under what the others say, as ``circlecal rig`` does.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.options import CameraConfig, priors_of, usual_kappa
from circlecal.camera.problem import Problem
from circlecal.camera.rig_options import RigConfig
from circlecal.config import Config
from circlecal.errors import EstimationError
from circlecal.evaluation.bench.bounds import bound_errors
from circlecal.evaluation.bench.reprojection import grid_in_view, mean_reprojection_error
from circlecal.evaluation.bench.scenarios import KNOWN, PRIORS, Draw, soccer
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import INDEX, POSITION, ProjectionModel, camera_of, theta_of
from circlecal.geometry.least_squares import invert_normal
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import FLAT, Surface
from circlecal.observations import CirclePoints, Observations
from circlecal.results import CameraFit
from circlecal.rig.estimation import config_with_prior, estimate_rigs, turning_of
from circlecal.rig.frames import RigFrame
from circlecal.rig.information import frame_information
from circlecal.rig.joint import TURNING, JointState, Turning, joint_problem, start_state
from circlecal.rig.tripod import COMMON, PLACE, TripodModel
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.markings import circle_points, line_points
from circlecal.synthetic.views import CameraProfile

STANDING = RigConfig(
    least_frames=1,
    position_deviation_m=0.0,
    roll_deviation_deg=0.0,
    principal_point_deviation_px=0.0,
    k1_deviation=0.0,
    principal_point_by_zoom_px=0.0,
    k1_by_zoom=0.0,
    lever_m=0.0,
    lever_sd_m=0.0,
    lean_sd_deg=0.0,
)
"""A camera that turns about exactly one point with one lens."""
ON_TRIPOD = STANDING.model_copy(
    update={name: RigConfig.model_fields[name].default for name in ("lever_m", "lever_sd_m", "lean_sd_deg")}
)
"""A camera with one lens on a tripod whose lean and lever arm are known as well as any."""


@dataclass(frozen=True, slots=True)
class RigScenario:
    """One row: number, title, number of frames, profile of the cameras, what is known of them and of how they turn, and
    the figures to reach.
    """

    row: str
    title: str
    frames: int
    profile: CameraProfile
    config: CameraConfig
    from_priors: bool
    reach_px: tuple[float, float | None]
    rig: RigConfig = STANDING


def rig_scenarios() -> list[RigScenario]:
    """The rows of many frames."""
    title = "5 frames of one camera together, sigma 0.5"
    return [
        RigScenario("10", title, 5, "main", KNOWN, False, (0.15, 0.4)),
        RigScenario("10w", f"{title}, within 25 m of the halfway line", 5, "wide", KNOWN, False, (np.inf, None)),
        RigScenario("10t", f"{title}, on a tripod", 5, "main", KNOWN, False, (np.inf, None), ON_TRIPOD),
        RigScenario("10d", f"{title}, lens, crown from their priors", 5, "main", PRIORS, True, (np.inf, None)),
    ]


def select_rigs(names: Sequence[str]) -> list[RigScenario]:
    """The rows that are named (``10`` stands for all of them); all where none is."""
    return [s for s in rig_scenarios() if not names or s.row in names or "10" in names]


@dataclass(frozen=True, slots=True)
class RigDraw:
    """Frames of one camera: of each the truth and its observations, the error (px; inf for none), what the bound lets
    expect (K draws, px) and the calibration; and the time of one frame in seconds.
    """

    draws: list[Draw]
    errors: list[float]
    bounds: list[Array]
    fits: list[CameraFit | None]
    seconds: float


def run_draw(scenario: RigScenario, rng: np.random.Generator, bound_draws: int) -> RigDraw:
    """One camera of a scenario: truth, estimates and bound."""
    template, _ = soccer()
    draws, turning = _draws(scenario, rng)
    covariances = _bound_covariances(draws, turning_of(scenario.rig), turning)
    grids = [grid_in_view(draw.camera, template) for draw in draws]
    bounds = [
        bound_errors(draw.camera, covariance, grid, bound_draws, rng)
        for draw, covariance, grid in zip(draws, covariances, grids, strict=True)
    ]
    start = time.perf_counter()
    fits = calibrate_together([draw.observations for draw in draws], scenario.config, scenario.rig)
    seconds = (time.perf_counter() - start) / len(draws)
    errors = [
        np.inf if fit is None else mean_reprojection_error(draw.camera.homography, fit.H_image_field, grid)
        for draw, fit, grid in zip(draws, fits, grids, strict=True)
    ]
    return RigDraw(draws, errors, bounds, fits, seconds)


def calibrate_together(seen: Sequence[Observations], camera: CameraConfig, rig: RigConfig) -> list[CameraFit | None]:
    """Cameras of frames of one camera, estimated together; None where there is none."""
    template, circle = soccer()
    config = Config(camera=camera, rig=rig)
    frames = []
    for k, observations in enumerate(seen):
        fit = _fit(observations, camera)
        theta, covariance = (None, None) if fit is None else (fit.theta, fit.covariance)
        frames.append(RigFrame(str(k), observations, theta, covariance))
    rigs = estimate_rigs(frames, template, circle, config, {frame.id: "camera" for frame in frames})
    if not rigs:
        return [None] * len(frames)
    return [
        _fit(observations, config_with_prior(config, rigs[0].prior(frame.id, frame.theta), observations.width).camera)
        for frame, observations in zip(frames, seen, strict=True)
    ]


def _fit(observations: Observations, camera: CameraConfig) -> CameraFit | None:
    template, circle = soccer()
    try:
        return estimate_camera(observations, template, circle, camera)
    except EstimationError:
        return None


def _draws(scenario: RigScenario, rng: np.random.Generator) -> tuple[list[Draw], Array]:
    """Frames of one camera, and how it turns (3,)."""
    template, _ = soccer()
    config, surface, kappa_off, shift = scenario.config, FLAT, 0.0, np.zeros(2)
    if scenario.from_priors:
        kappa_off = float(rng.normal(0.0, config.k1_sd))
        surface = Surface("roof", crown_m=float(rng.normal(config.crown_m, config.crown_sd_m)))
        shift = rng.normal(0.0, config.principal_point_sd(1920, 1080))
    first = sample_camera(scenario.profile, rng)
    views = [first]
    while len(views) < scenario.frames:
        views.append(sample_camera(scenario.profile, rng, like=first))
    if scenario.from_priors:
        focal_widths = float(np.exp(np.median([np.log(view.focal_px[0] / view.width) for view in views])))
        kappa = np.array([usual_kappa(config, focal_widths) + kappa_off, 0.0])
        views = [replace(view, kappa=kappa) for view in views]
    prior = turning_of(scenario.rig)
    turning = prior.mean + prior.sd * rng.normal(size=3)
    found = []
    for view in _turn(views, turning) if turning.any() else views:
        camera = replace(view, principal_point_px=view.principal_point_px + shift)
        circles: tuple[CirclePoints, ...] = tuple(
            circle_points(camera, template, edge, 200, 0.5, rng, surface=surface) for edge in ("outer", "inner")
        )
        lines = (line_points(camera, template, "halfway_line", 200, 0.5, rng, surface=surface),)
        seen = Observations(camera.width, camera.height, circles, lines)
        found.append(Draw(camera, seen, config, surface.crown_m))
    return found, turning


def _turn(views: Sequence[Camera], turning: Array) -> list[Camera]:
    """Cameras that point as the views do, on a tripod that stands where they do and turns as told (3,)."""
    model = ProjectionModel(views[0].width, views[0].height, FLAT)
    theta = np.array([theta_of(view, model) for view in views])
    tripod = TripodModel(model, float(np.median(theta[:, 0])))
    common = np.zeros(len(COMMON))
    common[:3], common[PLACE["head_roll"]] = theta[0, POSITION], theta[0, INDEX["roll"]]
    common[[PLACE[name] for name in TURNING]] = turning
    common[[PLACE["kappa_1"], PLACE["kappa_2"]]] = theta[0, [INDEX["kappa_1"], INDEX["kappa_2"]]]
    return [camera_of(turned, model) for turned in tripod.thetas(tripod.own_of(theta, common), common)]


def _bound_covariances(draws: Sequence[Draw], prior: Turning, turning: Array) -> Array:
    """Covariances (F, P, P) of the frames' parameters at the truth: the inverse of the joint Fisher information, for a
    camera that turns as told (3,).
    """
    template, circle = soccer()
    problems, thetas = [], []
    for draw in draws:
        model = ProjectionModel(
            draw.camera.width, draw.camera.height, Surface(draw.config.usual_crown, circle.radius_m)
        )
        theta = theta_of(draw.camera, model, draw.crown_m)
        thetas.append(theta)
        curves = curves_from_observations(draw.observations, template, NoiseModel(10**6, 0.0, 0.0))
        points = points_from_observations(draw.observations, template)
        problems.append(Problem(curves, points, priors_of(draw.config, template, circle, model), model))
    theta = np.array(thetas)
    problem = joint_problem(problems, {}, {}, float(np.median(theta[:, 0])), prior)
    return joint_covariances(start_state(problem, theta, turning))


def joint_covariances(state: JointState) -> Array:
    """Covariances (F, P, P) of the frames' parameter vectors, with what all the others bring."""
    precision, _ = frame_information(state)
    common = invert_normal(state.H_common + precision.sum(axis=0))
    inverse = invert_normal(state.H_oo)
    gain = inverse @ state.H_oc
    by_common = state.by_common - state.by_own @ gain
    return np.asarray(
        state.by_own @ inverse @ np.swapaxes(state.by_own, 1, 2) + by_common @ common @ np.swapaxes(by_common, 1, 2)
    )
