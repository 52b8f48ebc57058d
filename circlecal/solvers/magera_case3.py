"""Case 3 of Magera et al. 2025 (section 3.3): the imaged centre from both edges of the marking, then case 1 or 2.

The centre is an eigenvector of ``E_outer^-1 E_inner`` (Huang et al. 2015), and of its inverse alike.
"""

from __future__ import annotations

import numpy as np

from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.concentric import imaged_center
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.magera_case1 import homography_from_correspondences
from circlecal.solvers.primitives import SAME_CENTER_M, central_line, concentric_edges
from circlecal.stages.correspondences import correspondences_from_line, correspondences_from_point, known_points


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Eigenvector centre, then the construction from the line, or from a point where no line was seen."""
    outer, inner = concentric_edges(observations, template, circle, rng)
    found = imaged_center(outer.conic, inner.conic)
    if found is None:
        raise failure("no_real_center", "no real eigenvector lies inside the inner ellipse")
    try:
        line = central_line(observations, template, circle)
    except EstimationError:
        point = next(
            (
                p
                for p in known_points(observations, template)
                if np.linalg.norm(p.field_m - circle.center) > SAME_CENTER_M
            ),
            None,
        )
        if point is None:
            raise
        derived = correspondences_from_point(
            outer.conic, found.center, point.image_px, point.field_m, outer.center_m, outer.radius_m
        )
    else:
        derived = correspondences_from_line(
            outer.conic, found.center, line.image_line, outer.center_m, outer.radius_m, line.direction
        )
    return homography_from_correspondences(derived)
