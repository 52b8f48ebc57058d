"""From the optimum to what is reported: the camera, its covariance, and everything derived from both."""

from __future__ import annotations

from functools import partial

import numpy as np

from circlecal.camera_fit.model import INDEX, PARAMETERS, Frame, camera_of
from circlecal.camera_fit.optimise import Problem, State
from circlecal.camera_fit.uncertainty import (
    correlation_factor,
    data_share,
    field_sigma,
    homography_vector,
    imaged_point,
    posterior_covariance,
    push_forward,
    spread_cameras,
)
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.homogeneous import Array
from circlecal.geometry.homography import compass_label, scale_homography
from circlecal.results import CameraFit, DerivedPoint

REACH_RADII = 2.5
"""How far from the circle's centre the field counts for the largest predicted error."""


def camera_fit(
    problem: Problem,
    state: State,
    scale: float,
    rejected: tuple[str, ...],
    named: tuple[str, ...],
    circle: Circle,
    template: FieldTemplate,
    stated_sigma_px: dict[str, float],
) -> CameraFit:
    """Everything that is reported of the best start of ``state``."""
    frame, theta = problem.frame, state.theta[0]
    covariance = posterior_covariance(state.normal[0], problem.priors.sd)
    prior = problem.priors.residuals(theta[None])[1][0]
    center = np.asarray(circle.center)
    spread = spread_cameras(theta, covariance, center)
    camera = camera_of(theta, frame)
    H = camera.homography
    grid = visible_field(theta, frame, template, center, REACH_RADII * circle.radius_m)
    sigma_px, sigma_m = field_sigma(theta, covariance, grid, frame)
    share = data_share(theta, covariance, prior.T @ prior, grid, frame)
    return CameraFit(
        camera=camera,
        crown_m=float(theta[INDEX["crown"]]),
        crown_shape=frame.crown_shape,
        parameters=PARAMETERS,
        covariance=covariance,
        H_image_field=H,
        H_field_image=scale_homography(np.linalg.inv(H)),
        H_covariance=push_forward(lambda t: homography_vector(t, frame), theta, spread),
        imaged_center_px=imaged_point(theta, frame, center),
        imaged_center_covariance=push_forward(lambda t: imaged_point(t, frame, center), theta, spread),
        noise_scale=scale,
        data_share=share,
        residual_correlation=_correlation(problem, state, circle),
        max_sigma_px=float(sigma_px.max()) if len(grid) else float("inf"),
        max_sigma_m=float(sigma_m.max()) if len(grid) else float("inf"),
        residuals_px=residuals_px(problem, state),
        theta=theta,
        stated_sigma_px=stated_sigma_px,
        derived_points=_derived_points(theta, spread, circle, frame),
        rejected=rejected,
        named_lines=named,
        alternatives=((camera.turned(), 0.0),),
    )


def _correlation(problem: Problem, state: State, circle: Circle) -> float:
    """How many neighbouring residuals along the circle repeat each other: 1 where they are white."""
    circles = [k for k, name in enumerate(problem.curves.names) if name.startswith(circle.name + " ")]
    factors = [1.0]
    for group in circles:
        index = np.flatnonzero(problem.curves.group == group)
        factors.append(correlation_factor(state.residuals[0, index[np.argsort(state.hidden[0, index])]]))
    return max(factors)


def _derived_points(theta: Array, cameras: Array, circle: Circle, frame: Frame) -> tuple[DerivedPoint, ...]:
    """The circle's eight points with the covariance that the camera's implies."""
    found = []
    for angle in np.radians(np.arange(0.0, 360.0, 45.0)):
        outward = np.array([np.cos(angle), np.sin(angle)])
        point = np.asarray(circle.center) + circle.radius_m * outward
        spread = push_forward(partial(imaged_point, frame=frame, point_m=point), theta, cameras)
        found.append(DerivedPoint(compass_label(outward), point, imaged_point(theta, frame, point), spread))
    return tuple(found)


def visible_field(
    theta: Array, frame: Frame, template: FieldTemplate, center: Array, reach_m: float, step_m: float = 1.0
) -> Array:
    """Field points (N, 2) on a grid that the camera shows, within ``reach_m`` of the circle's centre."""
    half = np.array([template.length_m, template.width_m]) / 2
    x, y = (
        np.arange(max(-h, c - reach_m), min(h, c + reach_m) + 1e-9, step_m) for h, c in zip(half, center, strict=True)
    )
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixels = camera_of(theta, frame).project(grid)
    inside = np.isfinite(pixels).all(axis=1) & (pixels >= 0).all(axis=1)
    return grid[inside & (pixels[:, 0] <= frame.width - 1) & (pixels[:, 1] <= frame.height - 1)]


def residuals_px(problem: Problem, state: State) -> dict[str, float]:
    """Root mean square residual of each observed marking, pixels; nothing is left out."""
    curves, values = problem.curves, state.residuals[0] * problem.curves.sigma_px
    found = {
        name: float(np.sqrt(np.mean(values[curves.group == group] ** 2))) for group, name in enumerate(curves.names)
    }
    for k, name in enumerate(problem.points.names):
        found[name] = float(np.linalg.norm(state.point_values[0, 2 * k : 2 * k + 2]) * problem.points.sigma_px[k])
    return found
