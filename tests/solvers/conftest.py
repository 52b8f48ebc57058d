from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from circlecal.evaluation.bench.reprojection import grid_in_view, mean_reprojection_error
from circlecal.evaluation.bench.scenarios import faceoff_camera, hockey, soccer
from circlecal.evaluation.bench.solver_scenarios import solver_scenarios
from circlecal.geometry.projective import apply_homography, lift
from circlecal.observations import CirclePoints, LinePoints, MarkPoint, Observations
from circlecal.synthetic.cameras import sample_camera

SIGMA = 1e-4
ORIGIN = np.zeros(2)


@pytest.fixture(scope="session")
def main_cameras():
    return [sample_camera("main", np.random.default_rng([7, index])) for index in range(5)]


@pytest.fixture(scope="session")
def faceoff_cameras():
    return [faceoff_camera(np.random.default_rng([7, index])) for index in range(5)]


def scenario_view(name, camera, noise_px=0.0, seed=0):
    """What a scenario's camera sees, with sigmas that say how exact it is."""
    seen = solver_scenarios()[name].observe(camera, noise_px, np.random.default_rng([3, seed])).observations
    return seen if noise_px else stated(seen, SIGMA)


def stated(seen, sigma):
    return replace(
        seen,
        circles=tuple(replace(c, sigma_px=np.full(len(c.points_px), sigma)) for c in seen.circles),
        lines=tuple(replace(line, sigma_px=np.full(len(line.points_px), sigma)) for line in seen.lines),
        marks=tuple(replace(mark, sigma_px=sigma) for mark in seen.marks),
        keypoints=tuple(replace(point, sigma_px=sigma) for point in seen.keypoints),
    )


def error_px(result, camera, template):
    assert result.H_image_field is not None, result
    return mean_reprojection_error(camera.homography, result.H_image_field, grid_in_view(camera, template))


def circle_under(H, name, template, *, edge="outer", count=24, noise_px=0.0, rng=None, scale=1.0):
    """Points of a circle, ``scale`` times as large as the template's, under any homography."""
    circle = template.circle_by_name[name]
    angles = np.arange(count) * 2 * np.pi / count + 0.1
    radius = scale * template.radius(circle, edge)
    points = apply_homography(
        H, np.asarray(circle.center) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    )
    if noise_px:
        points = points + noise_px * rng.standard_normal(points.shape)
    return CirclePoints(name, edge, points, np.full(count, noise_px or SIGMA))


def halfway_under(H, template, ends_m=(-8.0, 8.0)):
    points = apply_homography(H, np.array([[0.0, end] for end in ends_m]))
    return LinePoints("halfway_line", points, np.full(len(points), SIGMA))


def central_view(H, template, *, mark=True, edges=("outer", "inner")):
    circles = tuple(circle_under(H, "centre_circle", template, edge=edge) for edge in edges)
    marks = (MarkPoint("centre_mark", apply_homography(H, ORIGIN), SIGMA),) if mark else ()
    return Observations(1920, 1080, circles, (halfway_under(H, template),), marks)


def proportional(a, b):
    """Largest entry of the cross product of two homogeneous vectors of unit length."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return float(np.abs(np.cross(a, b)).max())


__all__ = [
    "ORIGIN",
    "SIGMA",
    "central_view",
    "circle_under",
    "error_px",
    "halfway_under",
    "hockey",
    "lift",
    "proportional",
    "scenario_view",
    "soccer",
    "stated",
]
