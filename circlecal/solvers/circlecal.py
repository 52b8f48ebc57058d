"""circlecal's own way: the maximum a posteriori pinhole camera of everything that was seen (stage ``camera``)."""

from __future__ import annotations

import numpy as np

from circlecal.camera.options import CameraConfig
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.solvers.interface import solver
from circlecal.stages.camera import estimate_camera

KNOWN_OPTICS = CameraConfig(
    principal_point_sd_px=0.0,
    distortion="none",
    crown_shape="flat",
    width_sd_m=0.0,
    bloom_sd_px=0.0,
    model_sigma_px=0.0,
    noise_from_residuals=False,
    name_lines=False,
)
"""Principal point at the image centre, no lens, flat ground: what the other solvers assume too."""
DEFAULTS = CameraConfig()


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """With principal point, lens and surface taken as known."""
    return estimate_camera(observations, template, circle, KNOWN_OPTICS).H_image_field


@solver
def solve_with_defaults(
    observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator
) -> Array:
    """With the default configuration: lens, principal point, crown and marking width estimated under their priors."""
    return estimate_camera(observations, template, circle, DEFAULTS).H_image_field
