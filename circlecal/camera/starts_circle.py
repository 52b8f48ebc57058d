"""Starts of the optimiser from a circle: closed forms where they apply, and a grid over distance, height and side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.camera.multistart import Starts
from circlecal.camera.problem import Problem
from circlecal.camera.starts_landmarks import MINIMAL, collect_landmarks, homography_starts
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import Camera, camera_from_homography, image_center
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.circle_pose import pinhole_centers
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.ellipses import Ellipse, ellipse_from_conic
from circlecal.geometry.homography import SIDES, camera_side_of, homography_from_circle, turn_homography
from circlecal.geometry.projective import Array, fit_line, lift
from circlecal.observations import CircleEdge, CirclePoints, Observations

MINIMUM_CIRCLE_POINTS = 6
"""With fewer the circle is no ellipse that a start could come from: five determine a conic, one says how it fits."""
STARTING_POINTS = 120
"""Of so many points about are the ellipse and the line from which only starts are taken."""
SHORT_ARC_DEG = 200.0
"""Shorter arcs have local minima: the whole grid of starts is followed."""
GRID_DISTANCES = (4.0, 7.0, 11.0)
"""In radii of the circle: half, once and one and a half times the usual one of main cameras."""
GRID_TILT_FACTORS = (0.7, 1.0, 1.4)
"""By which the sine of the elevation differs from the ellipse's axis ratio, which is that of a camera far away."""
GRID_AZIMUTHS = 24
"""All around: 15 degrees apart."""


@dataclass(frozen=True, slots=True)
class SeenEllipse:
    """An imaged circle in undistorted pixels: its conic (3, 3) and ellipse, which edge of the paint it is, and how many
    degrees of it are seen.
    """

    conic: Array
    ellipse: Ellipse
    edge: CircleEdge
    arc_deg: float

    def follows_grid(self, problem: Problem) -> bool:
        """Whether so little of the circle is seen, by a camera somewhere, that the grid of starts is needed."""
        return self.arc_deg < SHORT_ARC_DEG and problem.priors.standing_m is None


def circle_starts(
    problem: Problem, observations: Observations, template: FieldTemplate, circle: Circle, seen: SeenEllipse, side: str
) -> Starts:
    """Starts from the closed forms, and a whole grid for when these are few or weak.

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
    usual, center, model = problem.usual_lens, np.asarray(circle.center), problem.model
    mark = next(
        (m for m in observations.marks if np.linalg.norm(_mark_position(template, m.mark) - center) < 1e-6), None
    )
    line, direction = _central_line(observations, template, circle, usual)
    closed = closed_form_starts(
        seen.conic, None if mark is None else lift(usual.undistort(mark.point_px)), line, direction, center,
        template.radius(circle, seen.edge), model, side,
    )  # fmt: skip
    found = [_fixed_position_starts(problem, observations, circle), closed]
    if len(problem.points.keys) + sum(line.line is not None for line in observations.lines) >= MINIMAL:
        landmarks = collect_landmarks(observations, template, problem.points, usual)
        found.append(homography_starts(landmarks, problem.priors.center_m, model))
    grid = grid_starts(seen.ellipse, center, circle.radius_m, model, side)
    return Starts(np.concatenate(found), grid, seen.follows_grid(problem))


def arc_starts(problem: Problem, observations: Observations, template: FieldTemplate, side: str) -> Array:
    """Grids (B, P) about all circles and arcs that show an ellipse."""
    arcs = (template.circle_by_name[c.circle] for c in observations.circles if c.circle in template.circle_by_name)
    fitted = [(arc, select_ellipse(observations, arc, problem)) for arc in dict.fromkeys(arcs)]
    grids = [
        grid_starts(found.ellipse, np.asarray(arc.center), arc.radius_m, problem.model, side)
        for arc, found in fitted
        if found
    ]
    return np.concatenate([np.zeros((0, len(PARAMETERS))), *grids])


def _fixed_position_starts(problem: Problem, observations: Observations, circle: Circle) -> Array:
    """The start (0 or 1, P) of a camera whose place is known."""
    priors, seen = problem.priors, _longest_edge(observations, circle)
    if priors.standing_m is None or seen is None:
        return np.zeros((0, len(PARAMETERS)))
    points = problem.usual_lens.undistort(seen.points_px)
    position, roll = priors.standing_m, float(priors.mean[INDEX["roll"]])
    theta = fixed_position_start(points, np.asarray(circle.center), circle.radius_m, position, roll, problem.model)
    if priors.shared is not None:
        theta[:, priors.shared.indices] = priors.shared.at(theta[:, 0])[0]
    return theta


def select_ellipse(observations: Observations, circle: Circle, problem: Problem) -> SeenEllipse | None:
    """The edge of a circle with the most points, None where they make no ellipse."""
    seen = _longest_edge(observations, circle)
    if seen is None:
        return None
    points = problem.usual_lens.undistort(seen.points_px[:: max(1, len(seen.points_px) // STARTING_POINTS)])
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


def closed_form_starts(
    conic: Array,
    center: Array | None,
    line: Array | None,
    direction: Array,
    field_center: Array,
    radius: float,
    model: ProjectionModel,
    side: str,
) -> Array:
    """Upright cameras (B, P) from the circle, a line of known direction through its centre and, where seen, the
    imaged centre.

    Parameters
    ----------
    conic : (3, 3) array
        Image of the circle of ``radius``.
    center : (3,) array or None
        Imaged centre where a mark shows it; otherwise, or where it allows no camera, every centre that a pinhole
        camera allows is a start.
    line : (3,) array or None
        Image of the line; without one there is no closed form.
    direction : (2,) array
        Its direction on the field.
    field_center, radius : (2,) array, float
        The circle.
    model : ProjectionModel
        Picture size.
    side : str
        Prior on the camera's side.
    """
    if line is None:
        return np.zeros((0, len(PARAMETERS)))
    starts = _cameras([] if center is None else [center], conic, line, direction, field_center, radius, model, side)
    if not starts:
        centers = pinhole_centers(conic, line, image_center(model.width, model.height), model.width)
        starts = _cameras(list(centers), conic, line, direction, field_center, radius, model, side)
    return np.array(starts).reshape(-1, len(PARAMETERS))


def _cameras(
    centers: list[Array],
    conic: Array,
    line: Array,
    direction: Array,
    field_center: Array,
    radius: float,
    model: ProjectionModel,
    side: str,
) -> list[Array]:
    """The upright ones of the cameras with these imaged centres."""
    starts = []
    for candidate in centers:
        H = homography_from_circle(conic, candidate, line, field_center, radius, direction)
        if H is None:
            continue
        if camera_side_of(H, side, field_center) < 0:
            H = turn_homography(H, field_center)
        camera = camera_from_homography(H, model.width, model.height)
        if camera is not None and camera.angles_rad[1] > 0 and camera.depth(field_center) > 0:
            starts.append(theta_of(camera, model))
    return starts


def grid_starts(ellipse: Ellipse, field_center: Array, radius: float, model: ProjectionModel, side: str) -> Array:
    """Level cameras (B, P) all around the circle that see it about as large, as flat and in the same place as an
    ellipse.

    The distance is free without more knowledge, the height follows from the axis ratio, the focal length from the
    longer axis.
    """
    lower = np.clip(ellipse.axis_ratio, 0.03, 0.95)
    distance, factor, azimuth = (
        g.ravel()
        for g in np.meshgrid(
            np.array(GRID_DISTANCES) * radius,
            np.array(GRID_TILT_FACTORS),
            np.linspace(-np.pi, np.pi, GRID_AZIMUTHS, endpoint=False),
            indexing="ij",
        )
    )
    elevation = np.arcsin(np.clip(lower * factor, 0.03, 0.97))
    horizontal = distance * np.cos(elevation)
    # azimuth 0 is the main camera's side, +y
    position = np.stack(
        [np.sin(azimuth) * horizontal, np.cos(azimuth) * horizontal, -distance * np.sin(elevation)], axis=-1
    )
    theta = np.zeros((len(distance), len(PARAMETERS)))
    focal = ellipse.semi_axes[0] * distance / radius
    ahead = -position / distance[:, None]
    shift = (ellipse.center - model.center) / focal[:, None]
    tilt = np.arccos(ahead[:, 2])
    theta[:, 0] = np.log(focal)
    theta[:, 1] = np.arctan2(ahead[:, 0], -ahead[:, 1]) - np.arctan(shift[:, 0]) / np.sin(tilt)
    theta[:, 2] = tilt + np.arctan(shift[:, 1])
    theta[:, 4:7] = position + np.r_[field_center, 0.0]
    return theta[position[:, :2] @ np.array(SIDES[side]) >= -1e-9]


def fixed_position_start(
    points_px: Array, field_center: Array, radius: float, position_m: Array, roll_rad: float, model: ProjectionModel
) -> Array:
    """The camera (1, P) of a known position that sees points (N, 2) of a circle; none (0, P) where they are too few.

    Position and roll fix the direction of the imaged circle's axes and their ratio. Its middle and size are then linear
    in the points, so that a short arc gives them as well as a long one.
    """
    offset = position_m - np.r_[field_center, 0.0]
    distance = float(np.linalg.norm(offset))
    ratio = -offset[2] / max(distance, 1e-6)
    if len(points_px) < 3 or ratio <= 0:
        return np.zeros((0, len(PARAMETERS)))
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    upright = (points_px - model.center) @ np.array([[c, s], [-s, c]]) / np.array([1.0, ratio])
    scale = np.abs(upright).max() + 1e-9
    x, y = (upright / scale).T
    # x^2 + y^2 = 2 u x + 2 v y + w
    solved = np.linalg.lstsq(np.column_stack([2 * x, 2 * y, np.ones(len(x))]), x * x + y * y, rcond=None)[0]
    u, v = solved[:2]
    size = float(np.sqrt(max(solved[2] + u * u + v * v, 1e-12)) * scale)
    focal = size * distance / radius
    ahead = -offset / distance
    tilt = np.arccos(ahead[2])
    theta = np.zeros((1, len(PARAMETERS)))
    theta[0, 0] = np.log(focal)
    theta[0, 1] = np.arctan2(ahead[0], -ahead[1]) - np.arctan(u * scale / focal) / np.sin(tilt)
    theta[0, 2] = tilt + np.arctan(v * scale * ratio / focal)
    theta[0, 3] = roll_rad
    theta[0, 4:7] = position_m
    return theta


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
