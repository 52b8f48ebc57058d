"""Great axis with the vanishing point of the halfway line (Andrews, Borch and Fjeld 2024, FootyVision).

The vanishing point of the halfway line and its parallels comes from another parallel marking where one is seen, else
from the centre mark: it is the mark's harmonic conjugate about the halfway line's points on the ellipse. Where neither
is seen the line's point on the great axis is taken for the centre, and the answer is that of ``great_axis``. The lines
from it through the ends of the great axis are taken for the tangents parallel to the halfway line. An approximation.
"""

from __future__ import annotations

import numpy as np

from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.conics import polar
from circlecal.geometry.homography import dlt
from circlecal.geometry.projective import Array, join, lift, meet
from circlecal.observations import Observations
from circlecal.solvers.great_axis import DOWN, axis_ends, toward_camera
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import (
    SeenCircle,
    SeenLine,
    central_line,
    central_point,
    crossing_points,
    find_circle,
    find_lines,
)

PARALLEL = 1e-9
"""Sine of the angle below which two lines of the field count as parallel; a template has them exactly so."""


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Four points, as in ``great_axis``, and three parallel lines through the vanishing point."""
    seen = find_circle(observations, template, circle.name, rng)
    line = central_line(observations, template, circle)
    crossings = crossing_points(seen.conic, line.image_line, DOWN)
    if crossings is None:
        raise failure("line_misses_circle", "the halfway line misses the ellipse")
    ends = lift(axis_ends(seen))
    try:
        center = central_point(observations, template, circle)
    except EstimationError:
        center = meet(line.image_line, join(ends[0], ends[1]))
    vanishing = vanishing_point(seen, line, find_lines(observations, template), center)
    along = toward_camera(line.direction)
    across = np.array([along[1], -along[0]])
    field = seen.center_m + seen.radius_m * np.stack([across, -across, along, -along])
    normals = np.stack([across, across, across])
    offsets = -(normals @ seen.center_m) - seen.radius_m * np.array([1.0, -1.0, 0.0])
    solution = dlt(
        field,
        np.concatenate([ends[:, :2], crossings]),
        np.column_stack([normals, offsets]),
        np.stack([join(vanishing, ends[0]), join(vanishing, ends[1]), line.image_line]),
    )
    if solution is None:
        raise failure("degenerate", "points and lines leave the homography undetermined")
    return solution.H


def vanishing_point(seen: SeenCircle, line: SeenLine, lines: list[SeenLine], center: Array) -> Array:
    """Vanishing point (3,) of the line: from a seen parallel, or on the polar of the centre (3,)."""
    for other in lines:
        parallel = abs(other.direction[0] * line.direction[1] - other.direction[1] * line.direction[0]) < PARALLEL
        if parallel and other.marking.name != line.marking.name:
            return meet(line.image_line, other.image_line)
    return meet(line.image_line, polar(seen.conic, center))
