"""All starts of one frame: from the circle where it is seen, from points, lines and other arcs where they are."""

from __future__ import annotations

import numpy as np

from circlecal.camera_fit.curves import first_hidden, point_residuals
from circlecal.camera_fit.model import INDEX, PARAMETERS, camera_of
from circlecal.camera_fit.optimise import Problem
from circlecal.camera_fit.point_starts import Landmarks, aimed_starts, homography_starts, usual_positions
from circlecal.camera_fit.starts import closed_form_starts, grid_starts, standing_start
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.conics import Ellipse, ellipse_from_conic, fit_conic, refine_conic
from circlecal.geometry.homogeneous import Array, fit_line, lift
from circlecal.geometry.pinhole import Camera
from circlecal.observations import CircleEdge, CirclePoints, Observations

MINIMUM_CIRCLE_POINTS = 6
"""With fewer the circle is no ellipse that a start could come from."""

REFINEMENTS, ELLIPSE_POINTS = 2, 120
"""Steps of an ellipse from which only starts are taken, and of how many points of it about."""

SeenEllipse = tuple[Array, Ellipse, CircleEdge]
"""Conic (3, 3) and ellipse in undistorted pixels, and which edge of the paint it is."""


def starts_of(
    problem: Problem,
    observations: Observations,
    template: FieldTemplate,
    circle: Circle | None,
    landmarks: Landmarks,
    side: str,
    loss_scale: float,
) -> tuple[Array, Array]:
    """Starts from the closed forms (K, P), and a whole grid (L, P) for when the closed forms are few or weak.

    Parameters
    ----------
    problem : Problem
        Its priors may know where the camera stands.
    observations, template : Observations, FieldTemplate
        What was seen, and the field.
    circle : Circle or None
        The circle that shows an ellipse; without one the starts come from other points and lines, and other arcs.
    landmarks : Landmarks
        Those points and lines.
    side : str
        Side of the field from which the grids look.
    loss_scale : float
        Scale of the robust loss of the ellipse, standard deviations.
    """
    frame, middle = problem.frame, problem.priors.center_m
    closed = [homography_starts(landmarks, middle, frame)]
    grids = []
    ellipse = None if circle is None else seen_ellipse(observations, circle, problem, loss_scale)
    if circle is not None and ellipse is not None:
        from_circle, around = _circle_starts(problem, observations, template, circle, ellipse, side)
        closed, grids = [from_circle, *closed], [around]
    else:
        arcs = (template.circle_by_name[c.circle] for c in observations.circles if c.circle in template.circle_by_name)
        fitted = [(arc, seen_ellipse(observations, arc, problem, loss_scale)) for arc in dict.fromkeys(arcs)]
        grids = [
            grid_starts(found[1], np.asarray(arc.center), arc.radius_m, frame, side) for arc, found in fitted if found
        ]
        positions = usual_positions(middle, side)
        if problem.priors.mean[INDEX["z"]] < 0:  # its priors know where the camera stands
            positions = np.concatenate([problem.priors.mean[None, 4:7], positions])
        grids.append(aimed_starts(landmarks, positions, frame))
    return np.concatenate(closed), np.concatenate(grids)


def _circle_starts(
    problem: Problem,
    observations: Observations,
    template: FieldTemplate,
    circle: Circle,
    found: SeenEllipse,
    side: str,
) -> tuple[Array, Array]:
    """Starts from the imaged circle: closed forms (K, P), and the whole grid (L, P)."""
    conic, ellipse, edge = found
    usual, center = usual_lens(problem), np.asarray(circle.center)
    mark = next(
        (m for m in observations.marks if np.linalg.norm(_mark_position(template, m.mark) - center) < 1e-6), None
    )
    line, direction = _central_line(observations, template, circle, usual)
    closed = closed_form_starts(
        conic, None if mark is None else lift(usual.undistort(mark.point_px)), line, direction, center,
        template.radius(circle, edge), problem.frame, side,
    )  # fmt: skip
    return (
        np.concatenate([_standing(problem, observations, circle), closed]),
        grid_starts(ellipse, center, circle.radius_m, problem.frame, side),
    )


def _standing(problem: Problem, observations: Observations, circle: Circle) -> Array:
    """The start (0 or 1, P) of a camera whose place is known."""
    priors, seen = problem.priors, _longest_edge(observations, circle)
    if priors.standing_m is None or seen is None:
        return np.zeros((0, len(PARAMETERS)))
    points = usual_lens(problem).undistort(seen.points_px)
    position, roll = priors.standing_m, float(priors.mean[INDEX["roll"]])
    theta = standing_start(points, np.asarray(circle.center), circle.radius_m, position, roll, problem.frame)
    if priors.shared is not None:
        theta[:, priors.shared.indices] = priors.shared.at(theta[:, 0])[0]
    return theta


def seen_ellipse(observations: Observations, circle: Circle, problem: Problem, loss_scale: float) -> SeenEllipse | None:
    """Conic and ellipse of the undistorted points of the edge with the most of them."""
    seen = _longest_edge(observations, circle)
    if seen is None:
        return None
    some = slice(None, None, max(1, len(seen.points_px) // ELLIPSE_POINTS))
    points = usual_lens(problem).undistort(seen.points_px[some])
    conic = fit_conic(points, "direct")
    refined = None
    if conic is not None:
        refined = refine_conic(points, conic, seen.sigma_px[some], loss_scale=loss_scale, iterations=REFINEMENTS)
    conic = conic if refined is None else refined[0]
    ellipse = None if conic is None else ellipse_from_conic(conic)
    return None if conic is None or ellipse is None else (conic, ellipse, seen.edge)


def _longest_edge(observations: Observations, circle: Circle) -> CirclePoints | None:
    """The edge of a circle with the most points, where they are enough for an ellipse."""
    edges = [c for c in observations.circles if c.circle == circle.name and len(c.points_px) >= MINIMUM_CIRCLE_POINTS]
    return max(edges, key=lambda c: len(c.points_px), default=None)


def usual_lens(problem: Problem) -> Camera:
    """A camera with the lens that the priors expect, to start from undistorted pixels."""
    theta = np.where(np.isfinite(problem.priors.mean), problem.priors.mean, 0.0).copy()
    theta[0] = np.log(problem.frame.width * 2.0)
    return camera_of(theta, problem.frame)


def _mark_position(template: FieldTemplate, name: str) -> Array:
    mark = template.mark_by_name.get(name)
    return np.full(2, np.inf) if mark is None else np.asarray(mark.position)


def arc_deg(observations: Observations, circle: Circle) -> float:
    """Degrees of the circle that are seen, by the ellipse of its points; 0 where they are none."""
    seen = _longest_edge(observations, circle)
    conic = None if seen is None else fit_conic(seen.points_px, "direct")
    ellipse = None if conic is None else ellipse_from_conic(conic)
    if seen is None or ellipse is None:
        return 0.0
    angles = np.sort(ellipse.parameter(seen.points_px))
    return 360.0 - float(np.degrees(np.max(np.diff(angles, append=angles[0] + 2 * np.pi))))


def _central_line(
    observations: Observations, template: FieldTemplate, circle: Circle, lens: Camera
) -> tuple[Array | None, Array]:
    """A seen line through the circle's centre in undistorted pixels, and its direction on the field."""
    for seen in observations.lines:
        drawn = None if seen.line is None else template.line_by_name.get(seen.line)
        if drawn is None or len(seen.points_px) < 2:
            continue
        if abs(template.line_coordinates(drawn) @ np.r_[circle.center, 1.0]) < 1e-6:
            ends = template.line_ends(drawn)
            return fit_line(lens.undistort(seen.points_px), 1.0 / seen.sigma_px**2), ends[1] - ends[0]
    return None, np.array([0.0, 1.0])


def screened(problem: Problem, grid: Array, count: int) -> Array:
    """The starts of a grid (L, P) that already lie nearest to what was seen, at most ``count``."""
    if len(grid) <= count:
        return grid
    stride = max(1, len(problem.curves.points_px) // 48)
    few = problem.curves.select(np.arange(0, len(problem.curves.points_px), stride))
    candidates = grid.copy()
    fixed = problem.priors.sd == 0
    candidates[:, fixed] = problem.priors.mean[fixed]
    _, on_curves = first_hidden(few, candidates, problem.frame, samples=48)
    values, _ = point_residuals(problem.points, candidates, problem.frame)
    offsets = values.reshape(len(candidates), -1, 2) * problem.points.sigma_px[:, None]
    distance = np.concatenate([on_curves, np.linalg.norm(offsets, axis=-1)], axis=1)
    penalty = np.sum(problem.priors.residuals(candidates)[0] ** 2, axis=1)
    score = np.mean(np.minimum(distance, 200.0), axis=1) + 2.0 * penalty
    return grid[np.argsort(score, kind="stable")[:count]]
