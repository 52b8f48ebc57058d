"""Cameras whose exact or noisy observations the tests of the stage `camera` are made of."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.errors import EstimationError
from circlecal.evaluation.bench.scenarios import KNOWN
from circlecal.field import load_field
from circlecal.geometry.homography import transfer_errors
from circlecal.observations import Observations
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points, mark_point

SOCCER = load_field("soccer")
CIRCLE = SOCCER.circle_by_name["centre_circle"]
HOCKEY = load_field("ice-hockey")
EXACT = KNOWN.model_copy(
    update={"distance_log_sd": None, "elevation_sd_deg": None, "roll_sd_deg": 1e6, "usual_size_share": 1.0}
)
"""Lens, principal point, surface and size of the field known, and no opinion on the camera's place."""
MAIN = aim_camera(np.array([5.0, 60.0, -16.0]), np.array([0.8, 0.5, 0.0]), 3600.0, 0.01, 1920, 1080)
WIDE = aim_camera(np.array([-4.0, 62.0, -17.0]), np.array([-14.0, -8.0, 0.0]), 1700.0, 0.01, 1920, 1080)


def seen(camera, *, edges=("outer",), line="halfway_line", lines=(), mark=False, sigma=0.0, seed=0, count=200,
         circles=("centre_circle",), template=SOCCER, surface=None):  # fmt: skip
    """Observations of a camera; ``line=None`` for the circle alone. Without noise 0.3 px are stated."""
    rng = np.random.default_rng(seed)
    kind = {} if surface is None else {"surface": surface}

    def stated(points):
        return points if sigma else replace(points, sigma_px=np.full(len(points.points_px), 0.3))

    rims = [circle_points(camera, template, e, count, sigma, rng, circle=c, **kind) for c in circles for e in edges]
    names = (*(() if line is None else (line,)), *lines)
    straight = [line_points(camera, template, name, 60, sigma, rng, **kind) for name in names]
    spot = mark_point(camera, template, "centre_mark", sigma, rng, **kind) if mark else None
    return Observations(
        camera.width,
        camera.height,
        tuple(map(stated, rims)),
        tuple(map(stated, straight)),
        () if spot is None else (replace(spot, sigma_px=max(sigma, 0.3)),),
    )


def departure(fit, camera, reach_m=12.0, center=(0.0, 0.0)):
    """Largest error (px) of the homography about the circle."""
    field = np.random.default_rng(0).uniform(-reach_m, reach_m, (80, 2)) + center
    return float(transfer_errors(fit.H_image_field, field, camera.project(field, distort=False)).max())


def refusal(observations, config=KNOWN, circle=CIRCLE, template=SOCCER):
    with pytest.raises(EstimationError) as refused:
        estimate_camera(observations, template, circle, config)
    assert refused.value.stage == "camera"
    return refused.value
