"""A simpler camera that shows a flat field where another camera, over a crowned field, was found to show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.priors import Priors
from circlecal.camera.problem import Problem, minimise
from circlecal.camera.residuals import FixedPoints, stack_curves
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, camera_of, theta_of
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import FLAT
from circlecal.observations import MarkingKey

ADJUSTED = ("log_focal", "pan", "tilt", "roll", "x", "y", "z", "kappa_1")
"""Parameters that are estimated."""
FEWEST_POINTS, ENOUGH_POINTS = 8, 400
"""Points without which the start stays, and of about so many that it is fitted to: two per unknown, and a hundred."""
RULE = StoppingRule(1e-12, unit=np.inf, last_step=True)
"""So far that the rounding of what is written to a file and read back does not show in what is fitted to it."""


def flat_camera(camera: Camera, points_m: Array, pixels: Array, *, centred: bool = False) -> Camera:
    """The pinhole camera over the plane z = 0 nearest to given pixels, in least squares.

    Focal length, angles, position and the first coefficient of distortion are adjusted; principal point, aspect and the
    second coefficient stay, or are those of the simplest model.

    Parameters
    ----------
    camera : Camera
        The start, and the size of the picture.
    points_m, pixels : (N, 2) arrays
        Points of the field and where they are seen (distorted).
    centred : bool
        Square pixels, the principal point at the image centre, no second coefficient.

    Returns
    -------
    Camera
        The start itself (with the simplest model's constants) where fewer than eight points are given.
    """
    if centred:
        camera = replace(
            camera,
            focal_px=np.full(2, camera.focal_px[0]),
            principal_point_px=image_center(camera.width, camera.height),
            kappa=np.array([camera.kappa[0], 0.0]),
        )
    stride = max(1, len(points_m) // ENOUGH_POINTS)
    field, seen = points_m[::stride], pixels[::stride]
    if len(field) < FEWEST_POINTS:
        return camera
    model = ProjectionModel(camera.width, camera.height, FLAT)
    start = theta_of(camera, model)
    sd = np.zeros(len(PARAMETERS))
    sd[[INDEX[name] for name in ADJUSTED]] = np.inf
    priors = Priors(start, sd, 1.0, np.inf, 0.0, np.inf, field.mean(axis=0))
    points = FixedPoints(field, seen, np.ones(len(field)), (MarkingKey(""),) * len(field))
    return camera_of(minimise(Problem(stack_curves([]), points, priors, model), start[None], RULE).theta[0], model)
