"""Case 1 of Magera et al. 2025 (section 3.1): circle, its imaged centre and a line of known direction."""

from __future__ import annotations

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.homography import dlt
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.results import Correspondences
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import central_line, central_point, find_circle
from circlecal.stages.correspondences import correspondences_from_line

PAPER_POINTS = 4
"""The paper derives a, b, d and e; the further four of the stage follow from them."""


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Derive a, b, d, e and their tangents (``v = l1 x E c``, ``l2 = v x c``, ``l3 = E v``), then the DLT."""
    seen = find_circle(observations, template, circle.name, rng)
    line = central_line(observations, template, circle)
    center = central_point(observations, template, circle)
    derived = correspondences_from_line(
        seen.conic, center, line.image_line, seen.center_m, seen.radius_m, line.direction
    )
    return homography_from_correspondences(derived)


def homography_from_correspondences(derived: Correspondences) -> Array:
    """DLT (3, 3) on the paper's four points and their tangents."""
    points, tangents = derived.points[:PAPER_POINTS], derived.tangents[:PAPER_POINTS]
    solution = dlt(
        [p.field_m for p in points],
        [p.image_px for p in points],
        [t.field_line for t in tangents],
        [t.image_line for t in tangents],
    )
    if solution is None:
        raise failure("degenerate", "the derived points and tangents leave the homography undetermined")
    return solution.H
