"""Pole-polar constraints of ellipses beside point and line matches in one linear system (Gupta, Little, Woodham 2011).

A homography keeps pole and polar, so a matched point p brings a matched line ``C p ~ H^T (E H p)``, and a matched
line l a matched point ``H (C^-1 l) ~ E^-1 l'``. Without matches there is nothing to build on, and matches on one
axis of the circle (the halfway line and its points) leave the scale across that axis free.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.conics import circle_conic, polar, pole
from circlecal.geometry.projective import Array, lift, similarity_normalisation
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import SeenCircle, find_circle, find_lines
from circlecal.stages.correspondences import known_points

RANK_TOLERANCE = 1e-6
"""Smallest ratio of the eighth to the first singular value of a system that determines the homography."""


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Matches, and for each ellipse the polars of matched points and the poles of matched lines; then least squares."""
    names = dict.fromkeys(c.circle for c in observations.circles if c.circle in template.circle_by_name)
    if circle.name not in names:
        raise failure("no_circle", f"no points of the circle {circle.name!r} were seen")
    circles = [find_circle(observations, template, name, rng) for name in names]
    points, lines = known_points(observations, template), find_lines(observations, template)
    if not points and not lines:
        raise failure("no_matches", "poles and polars need matched points or lines")
    T_field, T_image = _normalisations(circles)
    field_points = [lift(p.field_m) for p in points]
    image_points = [lift(p.image_px) for p in points]
    field_lines = [line.field_line for line in lines]
    image_lines = [line.image_line for line in lines]
    polars_field, polars_image, poles_field, poles_image = [], [], [], []
    for seen, k in product(circles, range(len(points))):
        polars_field.append(polar(_field_coordinates(seen), field_points[k]))
        polars_image.append(polar(seen.conic, image_points[k]))
    for seen, k in product(circles, range(len(lines))):
        poles_field.append(pole(_field_coordinates(seen), field_lines[k]))
        poles_image.append(pole(seen.conic, image_lines[k]))
    x = np.array(field_points + poles_field).reshape(-1, 3) @ T_field.T
    y = np.array(image_points + poles_image).reshape(-1, 3) @ T_image.T
    a = np.array(field_lines + polars_field).reshape(-1, 3) @ np.linalg.inv(T_field)
    b = np.array(image_lines + polars_image).reshape(-1, 3) @ np.linalg.inv(T_image)
    # which matches determine a homography does not depend on the homography: the field against itself tells it free
    # of the noise that lends a lacking equation to the picture
    ideal = np.linalg.svd(np.concatenate([point_rows(x, x), line_rows(a, a)]), compute_uv=False)
    _, _, vectors = np.linalg.svd(np.concatenate([point_rows(x, y), line_rows(a, b)]))
    if len(ideal) < 8 or ideal[7] <= RANK_TOLERANCE * ideal[0]:
        raise failure("underdetermined", "the matches leave part of the homography free: one off the axis is needed")
    return np.asarray(np.linalg.inv(T_image) @ vectors[8].reshape(3, 3) @ T_field)


def _field_coordinates(seen: SeenCircle) -> Array:
    return circle_conic(seen.center_m, seen.radius_m)


def _normalisations(circles: list[SeenCircle]) -> tuple[Array, Array]:
    rim = [c.center_m + c.radius_m * np.array([[1, 0], [0, 1], [-1, 0], [0, -1.0]]) for c in circles]
    pixels = np.concatenate([c.points_px for c in circles])
    return similarity_normalisation(np.concatenate(rim)), similarity_normalisation(pixels)


def _cross(vectors: Array) -> Array:
    x, y, w = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -w, y, w, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def point_rows(field: Array, image: Array) -> Array:
    """Rows (3 N, 9) of ``[y]_x H x = 0`` for homogeneous points (N, 3), at infinity too; H row by row."""
    x, y = _unit(field), _cross(_unit(image))
    return np.einsum("nij,nk->nijk", y, x).reshape(-1, 9)


def line_rows(field: Array, image: Array) -> Array:
    """Rows (3 M, 9) of ``[l]_x H^T l' = 0`` for homogeneous lines (M, 3)."""
    a, b = _cross(_unit(field)), _unit(image)
    return np.einsum("nij,nk->nikj", a, b).reshape(-1, 9)
