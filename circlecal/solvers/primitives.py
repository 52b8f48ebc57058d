"""What the solvers read from the observations: conics, the line through the circle's centre, known points.

The solvers know no lens: pixels are taken as undistorted. Ellipses are Fitzgibbon's, as in the paper's experiments;
where their residuals show outliers they come from RANSAC, as in the paper's work on real pictures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.field import Circle, FieldTemplate, Line
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.conics import line_conic_meet, sampson_distance
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, lift, meet
from circlecal.geometry.ransac import ransac_conic
from circlecal.observations import CircleEdge, CirclePoints, Observations
from circlecal.solvers.interface import failure
from circlecal.stages.correspondences import known_lines, known_points

OUTLIER_FACTOR = 3.0
"""A fit whose residuals are this many times their sigma (root mean square) has met outliers."""
RANSAC_SIGMAS = 4.0
RANSAC_HYPOTHESES = 300
RANSAC_MINIMUM_POINTS = 12
"""Distance of inliers in standard deviations, samples, and the fewest points among which outliers are looked for."""
SAME_CENTER_M = 1e-6
"""Places of a template nearer than this are one; its numbers are exact."""


@dataclass(frozen=True, slots=True)
class SeenCircle:
    """One edge of one circle of the template: its place on the field, its points and the ellipse through them."""

    name: str
    edge: CircleEdge
    center_m: Array
    radius_m: float
    conic: Array
    points_px: Array
    sigma_px: Array


@dataclass(frozen=True, slots=True)
class SeenLine:
    """A straight marking as homogeneous lines (3,) of the image and of the field."""

    marking: Line
    image_line: Array
    field_line: Array
    direction: Array


def fit_normalised_conic(points_px: Array, sigma_px: Array, rng: np.random.Generator) -> Array | None:
    """Normalised ellipse (3, 3) of points (N, 2), or None."""
    conic = fit_conic(points_px, "direct")
    if conic is None or len(points_px) < RANSAC_MINIMUM_POINTS:
        return conic
    scaled = sampson_distance(conic, points_px) / sigma_px
    if np.sqrt(np.mean(scaled**2)) < OUTLIER_FACTOR:
        return conic
    robust = ransac_conic(points_px, RANSAC_SIGMAS * sigma_px, rng, hypotheses=RANSAC_HYPOTHESES)
    return conic if robust is None else robust.conic


def _fit_edge(seen: CirclePoints, template: FieldTemplate, rng: np.random.Generator) -> SeenCircle | None:
    known = template.circle_by_name.get(seen.circle)
    conic = fit_normalised_conic(seen.points_px, seen.sigma_px, rng) if known is not None else None
    if known is None or conic is None or ellipse_from_conic(conic) is None:
        return None
    return SeenCircle(
        name=seen.circle,
        edge=seen.edge,
        center_m=np.asarray(known.center, dtype=np.float64),
        radius_m=template.radius(known, seen.edge),
        conic=conic,
        points_px=seen.points_px,
        sigma_px=seen.sigma_px,
    )


def find_edge(
    observations: Observations, template: FieldTemplate, name: str, edge: CircleEdge, rng: np.random.Generator
) -> SeenCircle:
    """One edge of a circle; gives up with ``no_circle`` where it was not seen or fits no ellipse."""
    points = observations.circle(name, edge)
    found = None if points is None else _fit_edge(points, template, rng)
    if found is None:
        raise failure("no_circle", f"the {edge} edge of {name!r} was not seen, or its points fit no ellipse")
    return found


def find_circle(observations: Observations, template: FieldTemplate, name: str, rng: np.random.Generator) -> SeenCircle:
    """The circle by its outer edge, else by its centreline, else by its inner edge."""
    edges: tuple[CircleEdge, ...] = ("outer", "center", "inner")
    edge: CircleEdge = next((e for e in edges if observations.circle(name, e) is not None), edges[0])
    return find_edge(observations, template, name, edge, rng)


def separate_circles(observations: Observations, template: FieldTemplate, rng: np.random.Generator) -> list[SeenCircle]:
    """All seen circles and arcs with different centres, one edge each, in the order of the observations.

    Gives up with ``needs_two_circles`` where there are fewer than two.
    """
    found: list[SeenCircle] = []
    for name in dict.fromkeys(c.circle for c in observations.circles if c.circle in template.circle_by_name):
        center = np.asarray(template.circle_by_name[name].center)
        if all(np.linalg.norm(center - other.center_m) > SAME_CENTER_M for other in found):
            found.append(find_circle(observations, template, name, rng))
    if len(found) < 2:
        raise failure("needs_two_circles", "two circles with different centres are needed")
    return found


def concentric_edges(
    observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator
) -> tuple[SeenCircle, SeenCircle]:
    """Outer and inner edge of one circle; gives up with ``needs_two_edges``."""
    if observations.circle(circle.name, "outer") is None or observations.circle(circle.name, "inner") is None:
        raise failure("needs_two_edges", "both edges of the marking are needed")
    outer = find_edge(observations, template, circle.name, "outer", rng)
    return outer, find_edge(observations, template, circle.name, "inner", rng)


def find_lines(observations: Observations, template: FieldTemplate) -> list[SeenLine]:
    """All named straight markings with at least two points."""
    found = []
    for seen in known_lines(observations, template):
        drawn = template.line_by_name[seen.label]
        ends = template.line_ends(drawn)
        direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        found.append(SeenLine(drawn, seen.image_line, seen.field_line, direction))
    return found


def central_line(observations: Observations, template: FieldTemplate, circle: Circle) -> SeenLine:
    """A seen line through the circle's centre; gives up with ``no_line``."""
    center = np.r_[circle.center, 1.0]
    for line in find_lines(observations, template):
        if abs(line.field_line @ center) < SAME_CENTER_M:
            return line
    raise failure("no_line", "no line through the circle's centre was seen")


def central_point(observations: Observations, template: FieldTemplate, circle: Circle) -> Array:
    """Imaged centre (3,) of the circle as a mark or keypoint shows it; gives up with ``no_center``."""
    for point in known_points(observations, template):
        if np.linalg.norm(point.field_m - circle.center) < SAME_CENTER_M:
            return lift(point.image_px)
    raise failure("no_center", "the circle's centre was not seen")


def line_meets(lines: list[SeenLine]) -> list[tuple[Array, Array]]:
    """Field (2,) and image (2,) points in which seen lines of different direction meet."""
    found = []
    for k, first in enumerate(lines):
        for second in lines[k + 1 :]:
            field, image = meet(first.field_line, second.field_line), meet(first.image_line, second.image_line)
            if abs(field[2]) > 1e-9 and abs(image[2]) > 1e-12:
                found.append((field[:2] / field[2], image[:2] / image[2]))
    return found


def crossing_points(conic: Array, line: Array, toward_px: Array) -> Array | None:
    """Points (2, 2) of a line on an ellipse: first the one in the direction ``toward_px`` (2,) of the picture."""
    both = line_conic_meet(conic, line)
    if both is None:
        return None
    points = both[:, :2]
    return points if (points[0] - points[1]) @ toward_px > 0 else points[::-1]
