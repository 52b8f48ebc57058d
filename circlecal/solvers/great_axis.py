"""Great axis of the ellipse taken for a diameter of the circle (Cuevas et al. 2020; Roboflow's tutorial, 2024).

An approximation: the ends of the great axis are not the circle's points across the halfway line.
"""

from __future__ import annotations

import numpy as np

from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.homography import dlt
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import SeenCircle, SeenLine, central_line, crossing_points, find_circle

RIGHT, DOWN = np.array([1.0, 0.0]), np.array([0.0, 1.0])


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Four points: both ends of the great axis, and the halfway line's points on the ellipse (or the small axis')."""
    seen = find_circle(observations, template, circle.name, rng)
    try:
        line: SeenLine | None = central_line(observations, template, circle)
    except EstimationError:
        line = None
    along = toward_camera(DOWN if line is None else line.direction)
    across = np.array([along[1], -along[0]])
    ends = axis_ends(seen)
    crossings = None if line is None else crossing_points(seen.conic, line.image_line, DOWN)
    if crossings is None:
        crossings = axis_ends(seen, longer=False)
    field = seen.center_m + seen.radius_m * np.stack([across, -across, along, -along])
    solution = dlt(field, np.concatenate([ends, crossings]))
    if solution is None:
        raise failure("degenerate", "the four points leave the homography undetermined")
    return solution.H


def toward_camera(direction: Array) -> Array:
    """A direction (2,) of the field or its opposite, whichever points to the main camera's side."""
    return direction if (direction[1], direction[0]) > (0.0, 0.0) else -direction


def axis_ends(seen: SeenCircle, longer: bool = True) -> Array:
    """Ends (2, 2) of an axis of the ellipse: the right one first of the longer, the lower one first of the shorter."""
    ellipse = ellipse_from_conic(seen.conic)
    if ellipse is None:
        raise failure("no_circle", "the circle's points fit no ellipse")
    turn = 0.0 if longer else np.pi / 2
    ends = ellipse.points(np.array([turn, turn + np.pi]))
    ahead = (ends[0] - ends[1]) @ (RIGHT if longer else DOWN)
    return ends if ahead > 0 else ends[::-1]
