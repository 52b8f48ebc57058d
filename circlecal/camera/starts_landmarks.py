"""Starts of the optimiser that need no circle: from points and straight markings of known field position.

Four of them determine a homography; samples of four, scored by all, also find it where some are wrong. Fewer leave it
open, and cameras of a usual place are pointed and zoomed at what was seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np

from circlecal.camera.multistart import Starts
from circlecal.camera.problem import Problem
from circlecal.camera.residuals import FixedPoints
from circlecal.field import FieldTemplate
from circlecal.geometry.camera import Camera, camera_from_homography
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.homography import SIDES, correspondence_rows
from circlecal.geometry.projective import Array, Indices, fit_line, lift, transform_lines
from circlecal.observations import Observations

MINIMAL = 4
"""Points and lines that determine a homography."""
MAXIMUM_LANDMARKS = 24
"""Of the points, evenly spread: they have 10,626 samples of four."""
MAXIMUM_SAMPLES = 600
"""Of four landmarks: one of them holds no wrong one with 99.9 % where two thirds of the landmarks are wrong."""
FOLLOWED, CONVERTED = 6, 40
"""How many cameras are starts, and how many of the best homographies are tried, to find that many."""
CAP_WIDTHS = 0.03
"""Distance in picture widths beyond which a point or line counts as wrong, however wrong."""
FIELD_UNIT_M = 10.0
"""Scale of field coordinates in the linear systems, metres: about that of a circle."""
REACH_WIDTHS = 1.5
"""Two lines that meet further from the picture's centre than this are no point to aim at."""
DISTANCES_M, ELEVATIONS_DEG, AZIMUTHS = (35.0, 65.0, 100.0), (7.0, 14.0, 25.0), 24
"""Of the usual positions about what is seen: those of small grounds, main cameras and large stadiums, all around."""


@dataclass(frozen=True, slots=True)
class Landmarks:
    """What was seen of known field position, in undistorted pixels.

    Attributes
    ----------
    points_m, points_px : (M, 2) arrays
        Marks and keypoints.
    lines_m, lines_px : (L, 3) arrays
        Straight markings as normalised lines.
    middles_m : (L, 2) array
        Middle of each marking on the field.
    ends_px : (L, 2, 2) array
        The outermost pixels of each.
    """

    points_m: Array
    points_px: Array
    lines_m: Array
    lines_px: Array
    middles_m: Array
    ends_px: Array

    def __len__(self) -> int:
        return len(self.points_m) + len(self.lines_m)

    def crossings(self, model: ProjectionModel) -> tuple[Array, Array]:
        """Where two of the markings meet, on the field (K, 2) and in the picture (K, 2)."""
        first, second = np.triu_indices(len(self.lines_m), 1)
        field = np.cross(self.lines_m[first], self.lines_m[second])
        seen = np.cross(self.lines_px[first], self.lines_px[second])
        with np.errstate(divide="ignore", invalid="ignore"):
            field, seen = field[:, :2] / field[:, 2:], seen[:, :2] / seen[:, 2:]
            near = np.linalg.norm(seen - model.center, axis=1) < REACH_WIDTHS * model.width
            near &= (np.abs(field) < 200.0).all(axis=1)
        return field[near], seen[near]

    def middle_m(self, model: ProjectionModel) -> Array:
        """About where on the field (2,) the picture looks."""
        field, seen = self.crossings(model)
        inside = (np.abs(seen - model.center) < np.array([model.width, model.height]) / 2).all(axis=1)
        shown = np.concatenate([self.points_m, field[inside]])
        if len(shown) == 0:
            shown = field if len(field) else self.middles_m
        return np.asarray(shown.mean(axis=0)) if len(shown) else np.zeros(2)


def collect_landmarks(
    observations: Observations, template: FieldTemplate, points: FixedPoints, lens: Camera
) -> Landmarks:
    """Landmarks among the observations; lines without a name or without length are none.

    Parameters
    ----------
    observations, template : Observations, FieldTemplate
        What was seen, and the field.
    points : FixedPoints
        Its marks and keypoints.
    lens : Camera
        Whose distortion is taken out of the pixels.
    """
    lines_m, lines_px, middles, ends = [], [], [], []
    for seen in observations.lines:
        drawn = None if seen.line is None else template.line_by_name.get(seen.line)
        if drawn is None or len(seen.points_px) < 2 or np.ptp(seen.points_px, axis=0).max() == 0:
            continue
        pixels = lens.undistort(seen.points_px)
        line = fit_line(pixels, 1.0 / seen.sigma_px**2)
        along = pixels @ np.array([line[1], -line[0]])
        lines_m.append(template.line_coordinates(drawn))
        lines_px.append(line)
        middles.append(template.line_ends(drawn).mean(axis=0))
        ends.append(pixels[[int(along.argmin()), int(along.argmax())]])
    kept = _evenly(len(points.points_px), MAXIMUM_LANDMARKS)
    return Landmarks(
        points.field_m[kept],
        lens.undistort(points.points_px[kept]) if len(kept) else np.zeros((0, 2)),
        np.array(lines_m).reshape(-1, 3),
        np.array(lines_px).reshape(-1, 3),
        np.array(middles).reshape(-1, 2),
        np.array(ends).reshape(-1, 2, 2),
    )


def landmark_starts(problem: Problem, landmarks: Landmarks, arcs: Array, side: str) -> Starts:
    """Starts where the circle shows no ellipse: from points and lines, and from grids (B, P) about other arcs.

    Parameters
    ----------
    problem : Problem
        Its priors may know where the camera stands.
    landmarks, arcs : Landmarks, (B, P) array
        What was seen of known field position.
    side : str
        Side of the field on which the camera stands.
    """
    middle = problem.priors.center_m
    positions = usual_positions(middle, side)
    if problem.priors.mean[INDEX["z"]] < 0:  # its priors know where the camera stands
        positions = np.concatenate([problem.priors.mean[None, 4:7], positions])
    grid = np.concatenate([arcs, aim_cameras(landmarks, positions, problem.model)])
    return Starts(homography_starts(landmarks, middle, problem.model), grid)


def _evenly(count: int, most: int) -> Indices:
    """All of so many, or evenly some of them."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(int)


def homography_starts(landmarks: Landmarks, around_m: Array, model: ProjectionModel) -> Array:
    """Upright cameras (B, P) from homographies of four landmarks each, the best by all of them first.

    Parameters
    ----------
    landmarks : Landmarks
        What was seen.
    around_m : (2,) array
        A field point in front of the camera.
    model : ProjectionModel
        Picture size.
    """
    if len(landmarks) < MINIMAL:
        return np.zeros((0, len(PARAMETERS)))
    T_field = np.array([[1.0, 0.0, -around_m[0]], [0.0, 1.0, -around_m[1]], [0.0, 0.0, FIELD_UNIT_M]])
    half = model.width / 2.0
    T_image = np.array([[1.0, 0.0, -model.center[0]], [0.0, 1.0, -model.center[1]], [0.0, 0.0, half]])
    rows = correspondence_rows(
        landmarks.points_m, landmarks.points_px, landmarks.lines_m, landmarks.lines_px, T_field, T_image
    )
    sampled = rows[_samples(len(rows))]
    H = np.concatenate([_null_matrices(rows[None]), _null_matrices(sampled)])
    cost = _costs(H, landmarks, T_field, T_image)
    back, shift = np.linalg.inv(T_image), np.diag([1.0, 1.0, FIELD_UNIT_M])
    found: list[Array] = []
    order = np.argsort(cost, kind="stable")[:CONVERTED]
    for k in order[np.isfinite(cost[order])]:
        camera = camera_from_homography(back @ H[k] @ shift, model.width, model.height)
        if camera is not None and camera.angles_rad[1] > 0 and camera.depth(np.zeros(2)) > 0:
            theta = theta_of(camera, model)
            theta[4:6] += around_m
            found.append(theta)
        if len(found) == FOLLOWED:
            break
    return np.array(found).reshape(-1, len(PARAMETERS))


def _samples(count: int) -> Indices:
    """Index sets (B, 4) of landmarks: all of them where they are few, evenly spread ones otherwise."""
    total = np.array(list(islice(combinations(range(count), MINIMAL), 200_000)), dtype=np.int64)
    return total[_evenly(len(total), MAXIMUM_SAMPLES)]


def _null_matrices(rows: Array) -> Array:
    """Least squares solutions (B, 3, 3) of homogeneous systems (B, K, 3, 9)."""
    system = rows.reshape(len(rows), -1, 9)
    return np.asarray(np.linalg.eigh(np.swapaxes(system, 1, 2) @ system)[1][..., 0].reshape(-1, 3, 3))


def _costs(H: Array, landmarks: Landmarks, T_field: Array, T_image: Array) -> Array:
    """Capped distances (B,) of the landmarks from where homographies (B, 3, 3) put them; inf for mirrored views."""
    points_m, points_px = lift(landmarks.points_m) @ T_field.T, lift(landmarks.points_px) @ T_image.T
    ends_px = lift(landmarks.ends_px) @ T_image.T
    # the cofactors map lines as the inverse transpose does, and have the sign of an unmirrored view from above
    cofactors = np.stack([np.cross(H[..., (k + 1) % 3], H[..., (k + 2) % 3]) for k in range(3)], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mapped = np.einsum("bij,nj->bni", H, points_m)
        off = np.linalg.norm(mapped[..., :2] / mapped[..., 2:] - points_px[:, :2] / points_px[:, 2:], axis=-1)
        lines = np.einsum("bij,lj->bli", cofactors, transform_lines(T_field, landmarks.lines_m))
        lines = lines / np.hypot(lines[..., 0], lines[..., 1])[..., None]
        beside = np.abs(np.einsum("bli,lei->ble", lines, ends_px / ends_px[..., 2:])).max(axis=-1)
        distance = np.concatenate([off, beside], axis=1)
    seen = np.concatenate([points_px, ends_px.reshape(-1, 3)]).mean(axis=0)
    cap = 2.0 * CAP_WIDTHS
    cost = np.minimum(np.where(np.isfinite(distance), distance, cap), cap).sum(axis=1)
    return np.where(np.einsum("bi,i->b", cofactors[..., 2], seen) > 0, cost, np.inf)


def usual_positions(around_m: Array, side: str) -> Array:
    """Positions (B, 3) all around a field point, on the named side of it."""
    distance, elevation, azimuth = (
        g.ravel()
        for g in np.meshgrid(
            DISTANCES_M, np.radians(ELEVATIONS_DEG), np.linspace(-np.pi, np.pi, AZIMUTHS, endpoint=False), indexing="ij"
        )
    )
    level = distance * np.cos(elevation)
    offset = np.stack([np.sin(azimuth) * level, np.cos(azimuth) * level, -distance * np.sin(elevation)], axis=-1)
    return np.asarray(offset[offset[:, :2] @ np.array(SIDES[side]) >= -1e-9] + np.r_[around_m, 0.0])


def aim_cameras(landmarks: Landmarks, positions_m: Array, model: ProjectionModel) -> Array:
    """Level cameras (B, P) at given positions (B, 3), pointed and zoomed at the landmarks.

    Seen on the plane across the viewing direction, the landmarks must appear as in the picture up to scale and shift;
    the scale is the focal length. Empty where no two points, nor lines that meet, are seen.
    """
    field, pixels = (
        np.concatenate(pair)
        for pair in zip((landmarks.points_m, landmarks.points_px), landmarks.crossings(model), strict=True)
    )
    if len(field) < 2:
        return np.zeros((0, len(PARAMETERS)))
    offset = np.concatenate([field, np.zeros((len(field), 1))], axis=1) - positions_m[:, None]
    ahead = (offset / np.linalg.norm(offset, axis=-1, keepdims=True)).mean(axis=1)
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    right = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))], axis=-1)
    right /= np.maximum(np.linalg.norm(right, axis=-1, keepdims=True), 1e-9)
    axes = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    seen = offset @ np.swapaxes(axes, 1, 2)
    plane = seen[..., :2] / np.maximum(seen[..., 2:], 1e-3)
    spread = plane - plane.mean(axis=1, keepdims=True)
    focal = np.sum(spread * (pixels - pixels.mean(axis=0)), axis=(1, 2)) / np.maximum(
        np.sum(spread**2, axis=(1, 2)), 1e-12
    )
    usable = (focal > 0.2 * model.width) & (seen[..., 2] > 0).all(axis=1)
    focal, ahead, positions = focal[usable], ahead[usable], positions_m[usable]
    shift = (pixels.mean(axis=0) - model.center) / focal[:, None] - plane[usable].mean(axis=1)
    theta = np.zeros((len(focal), len(PARAMETERS)))
    tilt = np.arccos(np.clip(ahead[:, 2], -1.0, 1.0))
    theta[:, 0] = np.log(focal)
    theta[:, 1] = np.arctan2(ahead[:, 0], -ahead[:, 1]) - np.arctan(shift[:, 0]) / np.maximum(np.sin(tilt), 0.1)
    theta[:, 2] = tilt + np.arctan(shift[:, 1])
    theta[:, 4:7] = positions
    return theta
