"""Common self-polar triangle of separate circles (Huang, Zhang and Cheung 2016).

The eigenvectors of ``E2^-1 E1`` are the vertices of the triangle that is self-polar for both ellipses. For two circles
one vertex is the vanishing point across the line of centres, the other two lie on the line of centres; the degenerate
conics ``E1 - lambda E2`` are pairs of common chords, one of them vanishing line and radical axis. The vanishing line
gives both imaged centres, the line of centres its direction, and the rest is case 1 for each circle.
"""

from __future__ import annotations

import numpy as np

from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.conics import normalise_conic, pole
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.homography import dlt
from circlecal.geometry.projective import Array, join, similarity_normalisation
from circlecal.observations import Observations
from circlecal.results import Correspondences
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import SeenCircle, separate_circles
from circlecal.stages.correspondences import correspondences_from_line

REAL_TOLERANCE = 1e-6
"""Largest imaginary part of a root that counts as real, in shares of the root: what rounding leaves."""


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Vanishing line from the pencil of the two ellipses with most points, then the derived points of both circles."""
    found = sorted(separate_circles(observations, template, rng), key=lambda c: -len(c.points_px))
    first, second = found[:2]
    line = vanishing_line(first.conic, second.conic)
    centers = [pole(c.conic, line) for c in (first, second)]
    if any(abs(c[2]) < 1e-12 * np.linalg.norm(c) for c in centers):
        raise failure("degenerate", "an imaged centre lies at infinity")
    derived = [
        _derive_correspondences(seen, center, other_seen, other)
        for seen, center, other_seen, other in (
            (first, centers[0], second, centers[1]),
            (second, centers[1], first, centers[0]),
        )
    ]
    points = [p for d in derived for p in d.points]
    tangents = [t for d in derived for t in d.tangents]
    solution = dlt(
        [p.field_m for p in points],
        [p.image_px for p in points],
        [t.field_line for t in tangents],
        [t.image_line for t in tangents],
    )
    if solution is None:
        raise failure("degenerate", "the derived points leave the homography undetermined")
    return solution.H


def _derive_correspondences(seen: SeenCircle, center: Array, other: SeenCircle, other_center: Array) -> Correspondences:
    """Points and tangents of one circle; the other's centre says which way along the line of centres is which."""
    try:
        return correspondences_from_line(
            seen.conic,
            center / center[2],
            join(center, other_center),
            seen.center_m,
            seen.radius_m,
            other.center_m - seen.center_m,
            toward=other_center[:2] / other_center[2],
        )
    except EstimationError as error:
        raise failure(error.code, error.reason) from error


def vanishing_line(first: Array, second: Array) -> Array:
    """The vanishing line (3,) of the plane of two separate circles from their images.

    Of the real lines in the degenerate members of the pencil it is the one whose poles lie inside both ellipses and
    that has both on the same side; the radical axis of separate circles runs between them.
    """
    ellipse_a, ellipse_b = ellipse_from_conic(first), ellipse_from_conic(second)
    if ellipse_a is None or ellipse_b is None:
        raise failure("no_circle", "an ellipse is degenerate")
    T = np.linalg.inv(
        similarity_normalisation(np.concatenate([e.points(np.arange(4) * np.pi / 2) for e in (ellipse_a, ellipse_b)]))
    )
    a, b = normalise_conic(T.T @ first @ T), normalise_conic(T.T @ second @ T)
    best: tuple[float, Array] | None = None
    for value in np.linalg.eigvals(np.linalg.solve(b, a)):
        if abs(value.imag) > REAL_TOLERANCE * abs(value):
            continue
        for candidate in degenerate_lines(a - value.real * b):
            margin = _common_side(a, b, candidate)
            if margin is not None and (best is None or margin > best[0]):
                best = margin, candidate
    if best is None:
        raise failure("no_vanishing_line", "no common chord of the ellipses can be the vanishing line")
    return np.asarray(np.linalg.inv(T).T @ best[1])


def degenerate_lines(conic: Array) -> list[Array]:
    """Both real lines (3,) of a degenerate conic ``l m^T + m l^T``, or none where they are complex."""
    values, vectors = np.linalg.eigh(conic)
    order = np.argsort(np.abs(values))
    low, high = (order[1], order[2]) if values[order[1]] <= values[order[2]] else (order[2], order[1])
    if not values[low] < 0 < values[high]:
        return []
    minus, plus = np.sqrt(-values[low]) * vectors[:, low], np.sqrt(values[high]) * vectors[:, high]
    return [plus + minus, plus - minus]


def _common_side(a: Array, b: Array, line: Array) -> float | None:
    """How deep inside both ellipses the poles of a line lie (0 to 1), or None where it cannot be the vanishing line."""
    depths, sides = [], []
    for conic in (a, b):
        point = pole(conic, line)
        ellipse = ellipse_from_conic(conic)
        if ellipse is None or point @ conic @ point >= 0 or abs(point[2]) < 1e-12 * np.linalg.norm(point):
            return None
        local = np.linalg.solve(ellipse.frame(), point / point[2])
        depths.append(1.0 - float(np.hypot(*local[:2])))
        sides.append(np.sign(line @ np.r_[ellipse.center, 1.0]))
    return min(depths) if sides[0] == sides[1] != 0 else None
