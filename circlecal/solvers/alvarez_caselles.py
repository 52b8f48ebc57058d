"""Closed form from the circle, the halfway line and up to three points of it (Alvarez and Caselles 2014).

Circle and line alone leave one degree of freedom: with the line's coordinate s = t / r (so the circle meets it at
+-1, on the field and in the picture) every projectivity that keeps both points is
``tau = (s + m) / (1 + m s)``, and m, where the centre appears, is the unknown. A point of the line with known s and
seen tau gives ``m (1 - s tau) = tau - s``; several give it by least squares. With m the imaged centre is known, and
the rest is the closed form of a circle with its centre.
"""

from __future__ import annotations

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.homography import camera_side_of, homography_from_circle, turn_homography
from circlecal.geometry.projective import Array, lift
from circlecal.observations import Observations
from circlecal.solvers.great_axis import DOWN, toward_camera
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import (
    SAME_CENTER_M,
    SeenLine,
    central_line,
    crossing_points,
    find_circle,
    find_lines,
    line_meets,
)
from circlecal.stages.correspondences import known_points


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Find the imaged centre on the line, then the homography in closed form."""
    seen = find_circle(observations, template, circle.name, rng)
    line = central_line(observations, template, circle)
    crossings = crossing_points(seen.conic, line.image_line, DOWN)
    if crossings is None:
        raise failure("line_misses_circle", "the halfway line misses the ellipse")
    along = toward_camera(line.direction)
    field, image = points_on_line(observations, template, line)
    s = (field - seen.center_m) @ along / seen.radius_m
    middle, half = crossings.mean(axis=0), (crossings[0] - crossings[1]) / 2
    tau = (image - middle) @ half / (half @ half)
    m = imaged_middle(s, tau)
    H = homography_from_circle(
        seen.conic, lift(middle + m * half), line.image_line, seen.center_m, seen.radius_m, line.direction
    )
    if H is None:
        raise failure("center_outside", "the imaged centre lies outside the ellipse")
    return turn_homography(H, seen.center_m) if camera_side_of(H, "main", seen.center_m) < 0 else H


def imaged_middle(s: Array, tau: Array) -> float:
    """The m of the module's projectivity from points (N,) at s on the field and tau in the picture.

    Each equation is divided by how much m moves tau, so that the residuals are those of tau to first order.
    """
    slope = 1.0 - s * tau
    if len(s) == 0 or np.all(np.abs(slope) < 1e-9):
        raise failure("no_point_on_line", "no point of the halfway line beside those of the circle was seen")
    m = float(slope @ (tau - s) / (slope @ slope))
    for _ in range(3):
        weight = 1.0 / (1.0 + m * s) ** 2
        m = float((weight * slope) @ (tau - s) / ((weight * slope) @ slope))
    if abs(m) >= 1.0:
        raise failure("center_outside", "the points of the line put the centre outside the ellipse")
    return m


def points_on_line(observations: Observations, template: FieldTemplate, line: SeenLine) -> tuple[Array, Array]:
    """Field and image points (N, 2) on the line: marks, keypoints and its meets with other seen markings."""
    pairs = [
        (p.field_m, p.image_px)
        for p in known_points(observations, template)
        if abs(line.field_line @ np.r_[p.field_m, 1.0]) < SAME_CENTER_M
    ]
    others = [seen for seen in find_lines(observations, template) if seen.marking.name != line.marking.name]
    for other in others:
        pairs += line_meets([line, other])
    field = np.array([p[0] for p in pairs]).reshape(-1, 2)
    return field, np.array([p[1] for p in pairs]).reshape(-1, 2)
