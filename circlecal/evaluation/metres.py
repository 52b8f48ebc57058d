"""Errors in metres on the ground near the centre circle: what a user of positions gets.

The published metrics count pixels or overlapping areas; none says how far a player near the circle is misplaced.
"""

from __future__ import annotations

import numpy as np

from circlecal.evaluation.reading import CENTRAL_CLASS, HALFWAY_CLASS, Annotated
from circlecal.evaluation.soccernet_metric import Projector, field_polylines
from circlecal.geometry.projective import Array

REACH_M = 18.3
"""Twice the radius of the circle."""
_RADIUS_M = 9.15
_STEP_M = 1.0
"""Between the grid's points."""
_ITERATIONS, _LONGEST_STEP_M, _DERIVATIVE_STEP_M = 12, 20.0, 1e-2
"""Newton steps at most, how long one may be, and the step of their difference quotients."""
_SETTLED_PX, _FOUND_PX = 1e-6, 0.05
"""Error at which the steps end, and below which what they reach is an answer: a good camera errs by far more."""


def field_positions(camera: Projector, pixels: Array, starts_m: Array) -> Array:
    """Field points (N, 2) that a camera shows at pixels (N, 2), by Newton's iteration; nan where it does not settle."""
    position = np.array(starts_m, dtype=np.float64)
    error = np.full(len(position), np.inf)
    for _ in range(_ITERATIONS):
        seen = _project(camera, position)
        offset = pixels - seen
        error = np.linalg.norm(offset, axis=1)
        if (error < _SETTLED_PX).all():
            break
        columns = [_project(camera, position + _DERIVATIVE_STEP_M * axis) - seen for axis in np.eye(2)]
        jacobian = np.stack(columns, axis=-1) / _DERIVATIVE_STEP_M
        regular = np.isfinite(jacobian).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 1e-9)
        step = np.zeros_like(position)
        step[regular] = np.linalg.solve(jacobian[regular], offset[regular][..., None])[..., 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        position = position + step * np.minimum(1.0, _LONGEST_STEP_M / np.maximum(length, 1e-12))
    return np.where((error < _FOUND_PX)[:, None], position, np.nan)


def _project(camera: Projector, positions: Array) -> Array:
    pixels, front = camera.project(np.column_stack([positions, np.zeros(len(positions))]))
    return np.where(front[:, None], pixels, np.nan)


def ground_errors(truth: Projector, predicted: Projector, width: int, height: int) -> Array:
    """Misplacement (N,) in metres of the visible field near the circle; infinite where the prediction has no answer.

    Every grid point is seen at a pixel by the true camera and put back on the ground by the predicted one; the better
    of the field and the field turned by 180 degrees counts.
    """
    axis = np.arange(-REACH_M, REACH_M + _STEP_M / 2, _STEP_M)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) <= REACH_M]
    pixels = _project(truth, grid)
    inside = np.isfinite(pixels).all(axis=1) & (np.nan_to_num(pixels, nan=-1.0) >= 0).all(axis=1)
    inside &= (np.nan_to_num(pixels, nan=np.inf) < (width, height)).all(axis=1)
    grid, pixels = grid[inside], pixels[inside]
    errors = [
        np.nan_to_num(np.linalg.norm(field_positions(predicted, pixels, sign * grid) - sign * grid, axis=1), nan=np.inf)
        for sign in (1.0, -1.0)
    ]
    return min(errors, key=lambda e: float(np.median(e)) if len(e) else np.inf)


def errors_of_annotated_points(annotated: Annotated, camera: Projector) -> Array:
    """Distances (N,) in metres on the ground of the annotated points of circle and halfway line from their element.

    Points that the camera does not put on the ground are infinitely far.
    """
    found = [np.zeros(0)]
    for name in (CENTRAL_CLASS, HALFWAY_CLASS):
        if name not in annotated or len(annotated[name]) == 0:
            continue
        element = field_polylines()[name][:, :2]
        shown = np.nan_to_num(_project(camera, element), nan=np.inf)
        nearest = np.linalg.norm(shown - annotated[name][:, None], axis=2).argmin(axis=1)
        position = field_positions(camera, annotated[name], element[nearest])
        distance = np.abs(np.hypot(*position.T) - _RADIUS_M) if name == CENTRAL_CLASS else np.abs(position[:, 0])
        found.append(np.nan_to_num(distance, nan=np.inf))
    return np.concatenate(found)
