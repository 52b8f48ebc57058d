"""All starts of one frame: from the circle where it is seen, from points, lines and other arcs where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.camera.optimise import Problem
from circlecal.camera.starts_circle import closed_form_starts, grid_starts, standing_start
from circlecal.camera.starts_landmarks import (
    MINIMAL,
    Landmarks,
    aimed_starts,
    homography_starts,
    seen_landmarks,
    usual_positions,
)
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, camera_of
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.ellipses import Ellipse, ellipse_from_conic
from circlecal.geometry.projective import Array, fit_line, lift
from circlecal.observations import CircleEdge, CirclePoints, Observations

MINIMUM_CIRCLE_POINTS = 6
"""With fewer the circle is no ellipse that a start could come from."""

STARTING_POINTS = 120
"""Of so many points about are the ellipse and the line from which only starts are taken."""


@dataclass(frozen=True, slots=True)
class SeenEllipse:
    """An imaged circle in undistorted pixels: its conic (3, 3) and ellipse, which edge of the paint it is, and how many
    degrees of it are seen.
    """

    conic: Array
    ellipse: Ellipse
    edge: CircleEdge
    arc_deg: float


def circle_starts(
    problem: Problem,
    observations: Observations,
    template: FieldTemplate,
    circle: Circle,
    seen: SeenEllipse,
    side: str,
) -> tuple[Array, Array]:
    """Starts from the closed forms (K, P), and a whole grid (L, P) for when the closed forms are few or weak.

    Parameters
    ----------
    problem : Problem
        Its priors may know where the camera stands.
    observations, template : Observations, FieldTemplate
        What was seen, and the field.
    circle, seen : Circle, SeenEllipse
        The circle on the field and in the picture.
    side : str
        Side of the field from which the grid looks.
    """
    usual, center, model = usual_lens(problem), np.asarray(circle.center), problem.model
    mark = next(
        (m for m in observations.marks if np.linalg.norm(_mark_position(template, m.mark) - center) < 1e-6), None
    )
    line, direction = _central_line(observations, template, circle, usual)
    closed = closed_form_starts(
        seen.conic, None if mark is None else lift(usual.undistort(mark.point_px)), line, direction, center,
        template.radius(circle, seen.edge), model, side,
    )  # fmt: skip
    found = [_standing(problem, observations, circle), closed]
    if len(problem.points.names) + sum(line.line is not None for line in observations.lines) >= MINIMAL:
        landmarks = seen_landmarks(observations, template, problem.points, usual)
        found.append(homography_starts(landmarks, problem.priors.center_m, model))
    return np.concatenate(found), grid_starts(seen.ellipse, center, circle.radius_m, model, side)


def landmark_starts(
    problem: Problem, observations: Observations, template: FieldTemplate, landmarks: Landmarks, side: str
) -> tuple[Array, Array]:
    """The same where the circle shows no ellipse: from points and lines, and from other arcs."""
    model, middle = problem.model, problem.priors.center_m
    arcs = (template.circle_by_name[c.circle] for c in observations.circles if c.circle in template.circle_by_name)
    fitted = [(arc, seen_ellipse(observations, arc, problem)) for arc in dict.fromkeys(arcs)]
    grids = [
        grid_starts(found.ellipse, np.asarray(arc.center), arc.radius_m, model, side) for arc, found in fitted if found
    ]
    positions = usual_positions(middle, side)
    if problem.priors.mean[INDEX["z"]] < 0:  # its priors know where the camera stands
        positions = np.concatenate([problem.priors.mean[None, 4:7], positions])
    grids.append(aimed_starts(landmarks, positions, model))
    return homography_starts(landmarks, middle, model), np.concatenate(grids)


def _standing(problem: Problem, observations: Observations, circle: Circle) -> Array:
    """The start (0 or 1, P) of a camera whose place is known."""
    priors, seen = problem.priors, _longest_edge(observations, circle)
    if priors.standing_m is None or seen is None:
        return np.zeros((0, len(PARAMETERS)))
    points = usual_lens(problem).undistort(seen.points_px)
    position, roll = priors.standing_m, float(priors.mean[INDEX["roll"]])
    theta = standing_start(points, np.asarray(circle.center), circle.radius_m, position, roll, problem.model)
    if priors.shared is not None:
        theta[:, priors.shared.indices] = priors.shared.at(theta[:, 0])[0]
    return theta


def seen_ellipse(observations: Observations, circle: Circle, problem: Problem) -> SeenEllipse | None:
    """The edge of a circle with the most points, None where they make no ellipse."""
    seen = _longest_edge(observations, circle)
    if seen is None:
        return None
    points = usual_lens(problem).undistort(seen.points_px[:: max(1, len(seen.points_px) // STARTING_POINTS)])
    conic = fit_conic(points, "direct")
    ellipse = None if conic is None else ellipse_from_conic(conic)
    if conic is None or ellipse is None:
        return None
    angles = np.sort(ellipse.parameter(points))
    gap = float(np.max(np.diff(angles, append=angles[0] + 2 * np.pi)))
    return SeenEllipse(conic, ellipse, seen.edge, 360.0 - float(np.degrees(gap)))


def _longest_edge(observations: Observations, circle: Circle) -> CirclePoints | None:
    """The edge of a circle with the most points, where they are enough for an ellipse."""
    edges = [c for c in observations.circles if c.circle == circle.name and len(c.points_px) >= MINIMUM_CIRCLE_POINTS]
    return max(edges, key=lambda c: len(c.points_px), default=None)


def usual_lens(problem: Problem) -> Camera:
    """A camera with the lens that the priors expect, to start from undistorted pixels."""
    theta = np.where(np.isfinite(problem.priors.mean), problem.priors.mean, 0.0).copy()
    theta[0] = np.log(problem.model.width * 2.0)
    return camera_of(theta, problem.model)


def _mark_position(template: FieldTemplate, name: str) -> Array:
    mark = template.mark_by_name.get(name)
    return np.full(2, np.inf) if mark is None else np.asarray(mark.position)


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
            some = slice(None, None, max(1, len(seen.points_px) // STARTING_POINTS))
            return fit_line(lens.undistort(seen.points_px[some]), 1.0 / seen.sigma_px[some] ** 2), ends[1] - ends[0]
    return None, np.array([0.0, 1.0])
