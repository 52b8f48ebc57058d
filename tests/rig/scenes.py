"""Frames of standing cameras as a run leaves them, straight from cameras, without pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.options import priors_of
from circlecal.camera.problem import Problem, minimise
from circlecal.camera.world import Size, World
from circlecal.config import Config, load_config
from circlecal.field import load_field
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.observations import Observations
from circlecal.pipeline import field_of
from circlecal.rig.frames import RigFrame
from circlecal.synthetic.cameras import aim_camera, sample_camera
from circlecal.synthetic.markings import circle_points, line_points

CONFIG: Config = load_config(
    None,
    ["camera.starts=2", "camera.iterations=30", "camera.crown_shape=flat", "camera.maximum_points=60",
     "camera.model_sigma_px=0", "camera.name_lines=false", "camera.principal_point_sd_px=5"],
)  # fmt: skip
TEMPLATE, CIRCLE = field_of(CONFIG)
KAPPA = 0.03


def main_views(count: int, rng: np.random.Generator, kappa: float = KAPPA) -> list[Camera]:
    """Views of one main camera."""
    first = sample_camera("main", rng, kappa=kappa)
    return [first] + [sample_camera("main", rng, like=first, kappa=kappa) for _ in range(count - 1)]


def goal_views(count: int, rng: np.random.Generator) -> list[Camera]:
    """Views of one camera behind the left goal."""
    position = np.array([-80.0, 4.0, -12.0])
    targets = rng.normal(0, 2, (count, 2))
    return [
        aim_camera(position, np.r_[target, 0.0], rng.uniform(3500, 6000), 0.01, 1920, 1080, 0.02) for target in targets
    ]


def seen_by(
    camera: Camera, rng: np.random.Generator, *, sigma: float = 0.3, line: bool = True, share: float = 1.0
) -> Observations:
    """Centreline of the circle (a contiguous share of it), and the halfway line."""
    circle = circle_points(camera, TEMPLATE, "center", 120, sigma, rng)
    kept = int(share * len(circle.points_px))
    circle = replace(circle, points_px=circle.points_px[:kept], sigma_px=circle.sigma_px[:kept])
    lines = (line_points(camera, TEMPLATE, "halfway_line", 60, sigma, rng),) if line else ()
    return Observations(camera.width, camera.height, (circle,), lines)


def calibrated(name: str, camera: Camera, rng: np.random.Generator, sigma: float = 0.3) -> RigFrame:
    """A frame calibrated alone, from the truth as start."""
    return calibrate_seen(name, camera, seen_by(camera, rng, sigma=sigma))


def calibrated_before_touchline(name: str, camera: Camera, rng: np.random.Generator, width_m: float) -> RigFrame:
    """A frame of a pitch of another width that shows its far touchline, calibrated alone before a pitch of any size."""
    pitch = load_field("soccer", {"width": width_m})
    touchline = line_points(camera, pitch, "side_line_top", 60, 0.3, rng)
    seen = seen_by(camera, rng)
    return calibrate_seen(name, camera, replace(seen, lines=(*seen.lines, touchline)), "any")


def calibrate_seen(name: str, camera: Camera, seen: Observations, size: Size = "usual") -> RigFrame:
    """A frame by what was seen, from the true camera as start."""
    model = ProjectionModel(camera.width, camera.height, Surface("flat"))
    usual = priors_of(CONFIG.camera, TEMPLATE, CIRCLE, model)
    priors = World(size, is_flat=False, share=1.0).priors(usual, usual, TEMPLATE)
    problem = Problem(
        curves_from_observations(seen, TEMPLATE, NoiseModel(60, 0, 60)), points_from_observations(seen, TEMPLATE),
        priors, model,
        CONFIG.camera.loss_scale,
    )  # fmt: skip
    state = minimise(problem, theta_of(camera, model)[None])
    return RigFrame(name, seen, state.theta[0], posterior_covariance(state.normal[0], priors.sd))


def displaced(frame: RigFrame, by_m: tuple[float, float, float], position_sd_m: float) -> RigFrame:
    """The same with a wrong camera that is sure of itself, or not."""
    assert frame.theta is not None
    theta = frame.theta.copy()
    theta[4:7] += by_m
    covariance = 1e-6 * np.eye(len(PARAMETERS))
    covariance[4:7, 4:7] = position_sd_m**2 * np.eye(3)
    return replace(frame, theta=theta, covariance=covariance)
