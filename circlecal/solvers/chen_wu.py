"""Focal length and pose from two coplanar circles (Chen, Wu and Wada 2004).

For a focal length f each ellipse is the image of a circle on two planes
(:mod:`circlecal.geometry.circular_sections`). Both circles lie in one plane, so at the true f a normal of one is a
normal of the other, at the same distance, with the centres as far apart as the template says. The principal point is
taken at the image centre and pixels as square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import image_center
from circlecal.geometry.circular_sections import Sections, circular_sections
from circlecal.geometry.homography import camera_side_of, turn_homography
from circlecal.geometry.projective import Array, Indices, Mask
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, intrinsics_solver, solver
from circlecal.solvers.primitives import (
    SAME_CENTER_M,
    SeenCircle,
    central_line,
    concentric_edges,
    separate_circles,
)

FOCAL_WIDTHS = (0.3, 20.0)
"""Range of the search, in widths of the picture."""
GRID, REFINEMENTS = 96, 40
"""Focal lengths of the search, 4.5 % apart, and most steps from the best of them."""
DIFFERENCE, LARGEST_MOVE = 1e-5, 0.1
"""Of the logarithm of the focal length: between the misfits whose slope is taken, and in one step."""
LARGEST_MISFIT = 0.5
"""Length of the misfits (sines, logarithms of ratios) beyond which the circles lie in no common plane."""


@dataclass(frozen=True, slots=True)
class TwoCircles:
    """Focal length, the plane's normal (3,) and both circle centres (2, 3) in camera coordinates."""

    focal_px: float
    normal: Array
    centers: Array


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Two circles with different centres, or both edges of one circle with the halfway line."""
    pair, concentric = _pair(observations, template, circle, rng)
    found = focal_and_plane(pair, (observations.width, observations.height))
    x, y = image_center(observations.width, observations.height)
    K = np.array([[found.focal_px, 0.0, x], [0.0, found.focal_px, y], [0.0, 0.0, 1.0]])
    if not concentric:
        return _homography(K, found, pair, pair[1].center_m - pair[0].center_m, found.centers[1] - found.centers[0])
    line = central_line(observations, template, circle)
    H = _homography(K, found, pair, line.direction, np.cross(found.normal, K.T @ line.image_line))
    return turn_homography(H, pair[0].center_m) if camera_side_of(H, "main", pair[0].center_m) < 0 else H


@intrinsics_solver
def intrinsics(
    views: Sequence[Observations], template: FieldTemplate, circle: Circle, rng: np.random.Generator
) -> Array:
    """Focal length alone, the median over the views."""
    found = []
    for view in views:
        pair, _ = _pair(view, template, circle, rng)
        found.append(focal_and_plane(pair, (view.width, view.height)).focal_px)
    if not found:
        raise failure("needs_a_view", "at least one view is needed")
    x, y = image_center(views[0].width, views[0].height)
    focal = float(np.median(found))
    return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])


def _pair(
    observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator
) -> tuple[tuple[SeenCircle, SeenCircle], bool]:
    try:
        found = sorted(separate_circles(observations, template, rng), key=lambda c: -len(c.points_px))
        return (found[0], found[1]), False
    except EstimationError as error:
        if error.code != "needs_two_circles":
            raise
    return concentric_edges(observations, template, circle, rng), True


def _misfits(
    pair: tuple[SeenCircle, SeenCircle], focal_px: Array, center_px: Array, choices: Indices
) -> tuple[Array, Sections, Sections]:
    """How far the sections chosen (K, 2) of each cone disagree (K, 7): normals, distances, and the centres' distance.

    Infinite where a cone has no circular sections.
    """
    first, second = (circular_sections(c.conic, focal_px, center_px, c.radius_m) for c in pair)
    k, (i, j) = np.arange(len(focal_px)), choices.T
    turned = np.cross(first.normals[k, i], second.normals[k, j])
    ratio = np.log(first.distances[k, i] / second.distances[k, j])
    between = second.centers[k, j] - first.centers[k, i]
    apart = float(np.linalg.norm(pair[1].center_m - pair[0].center_m))
    if apart > SAME_CENTER_M:
        length = np.log(np.maximum(np.linalg.norm(between, axis=1), 1e-300) / apart)[:, None]
    else:
        length = between / first.distances[k, i, None]
    found = np.column_stack([turned, ratio, length])
    return np.where(np.isfinite(found).all(axis=1, keepdims=True), found, np.inf), first, second


def focal_and_plane(pair: tuple[SeenCircle, SeenCircle], size: tuple[int, int]) -> TwoCircles:
    """Focal length at which the circular sections of both cones agree best: a grid, then Gauss-Newton."""
    center = image_center(*size)
    low, high = (float(np.log(w * size[0])) for w in FOCAL_WIDTHS)
    grid = np.linspace(low, high, GRID)
    choices = np.array(list(product((0, 1), (0, 1))))
    misfits, *_ = _misfits(pair, np.tile(np.exp(grid), len(choices)), center, np.repeat(choices, GRID, axis=0))
    cost = np.sum(misfits**2, axis=1).reshape(len(choices), GRID)
    inner = (cost[:, 1:-1] <= cost[:, :-2]) & (cost[:, 1:-1] <= cost[:, 2:]) & np.isfinite(cost[:, 1:-1])
    chosen, place = np.nonzero(inner)
    log_focal, refined = _refine(pair, grid[place + 1], center, choices[chosen])
    refined[(log_focal <= low) | (log_focal >= high)] = np.inf
    if not refined.min(initial=np.inf) <= LARGEST_MISFIT**2:
        raise failure("no_common_plane", "no focal length gives both circles one plane")
    best = int(np.argmin(refined))
    focal, choice = float(np.exp(log_focal[best])), choices[chosen[best]]
    _, first, second = _misfits(pair, np.array([focal]), center, choice[None])
    i, j = choice
    normal = first.normals[0, i] + second.normals[0, j]
    normal = normal / np.linalg.norm(normal)
    return TwoCircles(focal, normal, np.stack([first.centers[0, i], second.centers[0, j]]))


def _refine(
    pair: tuple[SeenCircle, SeenCircle], log_focal: Array, center_px: Array, choices: Indices
) -> tuple[Array, Array]:
    """Logarithms of focal lengths (M,) after Gauss-Newton on the misfits of choices (M, 2), and their costs (M,)."""
    log_focal, moving = log_focal.copy(), np.ones(len(log_focal), dtype=np.bool_)
    cost = np.full(len(log_focal), np.inf)
    for _ in range(REFINEMENTS):
        around = log_focal[moving] + np.array([0.0, -DIFFERENCE, DIFFERENCE])[:, None]
        misfits, *_ = _misfits(pair, np.exp(around).ravel(), center_px, np.tile(choices[moving], (3, 1)))
        values, before, after = misfits.reshape(3, -1, misfits.shape[1])
        usable: Mask = np.asarray(np.isfinite(values + before + after).all(axis=1))
        values, before, after = (np.where(usable[:, None], v, 0.0) for v in (values, before, after))
        slope = (after - before) / (2 * DIFFERENCE)
        move = -(slope * values).sum(axis=1) / np.maximum((slope * slope).sum(axis=1), 1e-300)
        cost[moving] = np.where(usable, (values * values).sum(axis=1), np.inf)
        log_focal[moving] += np.clip(move, -LARGEST_MOVE, LARGEST_MOVE)
        moving[moving] = usable & (np.abs(move) >= 1e-15)
        if not moving.any():
            break
    return log_focal, cost


def _homography(
    K: Array, found: TwoCircles, pair: tuple[SeenCircle, SeenCircle], direction_m: Array, direction: Array
) -> Array:
    """Homography from the plane and one direction known on the field (2,) and in camera coordinates (3,)."""
    u = direction_m / np.linalg.norm(direction_m)
    along = direction - (direction @ found.normal) * found.normal
    along = along / np.linalg.norm(along)
    across = np.cross(found.normal, along)
    x_axis, y_axis = u[0] * along - u[1] * across, u[1] * along + u[0] * across
    origins = [c - s.center_m[0] * x_axis - s.center_m[1] * y_axis for c, s in zip(found.centers, pair, strict=True)]
    return K @ np.column_stack([x_axis, y_axis, np.mean(origins, axis=0)])
