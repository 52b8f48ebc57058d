"""Case 2 of Magera et al. 2025 (section 3.2): circle, its imaged centre and a point of known field position.

The paper prints the vanishing point of the tangents as ``v = E l1``; a point is the pole of a line through the
inverse, ``v = E^-1 l1``, and so it is computed here.
"""

from __future__ import annotations

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.magera_case1 import homography_from_correspondences
from circlecal.solvers.primitives import SAME_CENTER_M, central_point, find_circle
from circlecal.stages.correspondences import correspondences_from_point, known_points


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Take the known point that lies farthest from the centre in the picture: its direction is the best known."""
    seen = find_circle(observations, template, circle.name, rng)
    center = central_point(observations, template, circle)
    others = [
        p for p in known_points(observations, template) if np.linalg.norm(p.field_m - circle.center) > SAME_CENTER_M
    ]
    if not others:
        raise failure("no_point", "no point of known field position beside the centre was seen")
    point = max(others, key=lambda p: np.linalg.norm(p.image_px - center[:2] / center[2]) / p.sigma_px)
    derived = correspondences_from_point(
        seen.conic, center, point.image_px, point.field_m, seen.center_m, seen.radius_m
    )
    return homography_from_correspondences(derived)
