"""RANSAC over keypoint subsets, then joint refinement on points and lines, after Gutierrez-Perez and Agudo 2024
(PnLCalib).

Keypoints are the marks and keypoints of the observations and, as there, the meets of straight markings with each other
and with the circle. Subsets of four give homographies by the DLT; the one with most inliers becomes a pinhole camera,
which is refined on inlier keypoints and straight lines together. Circles enter through their keypoints only, so a
central view, whose keypoints all lie on the halfway line, has no answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from math import comb

import numpy as np

from circlecal.camera.observed import NoiseModel, curves_from_observations
from circlecal.camera.options import CameraConfig, priors_of
from circlecal.camera.problem import Problem, minimise
from circlecal.camera.residuals import FixedPoints
from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import camera_from_homography
from circlecal.geometry.camera_parameters import ProjectionModel, camera_of, theta_of
from circlecal.geometry.homography import dlt, projects_in_front, transfer_errors
from circlecal.geometry.projective import Array, Mask
from circlecal.geometry.surface import Surface
from circlecal.observations import MarkingKey, Observations
from circlecal.results import KnownPoint
from circlecal.solvers.great_axis import DOWN, toward_camera
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import (
    central_line,
    crossing_points,
    find_circle,
    find_lines,
    line_meets,
)
from circlecal.stages.correspondences import known_points

SUBSET = 4
SUBSETS = 120
THRESHOLD_SIGMAS = 3.0
LEAST_THRESHOLD_PX = 2.0
"""Points of a sample, samples that are drawn where there are more, and the distance in standard deviations of a point,
and in pixels at least, within which it agrees.
"""
COLLINEAR = 1e-3
"""Points whose spread across is below this share of their spread along count as collinear."""
WITHOUT_PRIORS = CameraConfig(
    principal_point_sd_px=0.0,
    distortion="none",
    crown_shape="flat",
    width_sd_m=0.0,
    bloom_sd_px=0.0,
    roll_sd_deg=1e3,
    distance_log_sd=None,
    elevation_sd_deg=None,
)


@dataclass(frozen=True, slots=True)
class Keypoints:
    """N points: ``field_m`` (N, 2), ``image_px`` (N, 2), ``sigma_px`` (N,)."""

    field_m: Array
    image_px: Array
    sigma_px: Array

    def select(self, chosen: Mask) -> Keypoints:
        """The chosen ones."""
        return Keypoints(self.field_m[chosen], self.image_px[chosen], self.sigma_px[chosen])


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """Best subset, camera, refinement."""
    points = keypoints(observations, template, circle, rng)
    if len(points.field_m) < SUBSET:
        raise failure("too_few_keypoints", f"four keypoints are needed, {len(points.field_m)} seen")
    if spread_across(points.field_m) < COLLINEAR:
        raise failure("collinear_keypoints", "all keypoints lie on one line")
    inliers = consensus(points, rng)
    kept = points.select(inliers)
    solution = dlt(kept.field_m, kept.image_px)
    if solution is None:
        raise failure("degenerate", "the keypoints leave the homography undetermined")
    camera = camera_from_homography(solution.H, observations.width, observations.height)
    if camera is None or (camera.depth(kept.field_m) <= 0).any():
        return solution.H
    return refine(kept, theta_of(camera, _model(observations, circle)), observations, template, circle)


def _model(observations: Observations, circle: Circle) -> ProjectionModel:
    return ProjectionModel(observations.width, observations.height, Surface("flat", circle.radius_m))


def keypoints(
    observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator
) -> Keypoints:
    """Marks, keypoints, meets of lines, and the halfway line's points on the circle."""
    found = known_points(observations, template)
    usual = float(np.median([p.sigma_px for p in found])) if found else 1.0
    lines = find_lines(observations, template)
    found += [KnownPoint(field, image, usual) for field, image in line_meets(lines)]
    try:
        seen, line = find_circle(observations, template, circle.name, rng), central_line(observations, template, circle)
    except EstimationError:
        crossings = None
    else:
        crossings = crossing_points(seen.conic, line.image_line, DOWN)
        along = toward_camera(line.direction)
    if crossings is not None:
        ends = (seen.center_m + seen.radius_m * along, seen.center_m - seen.radius_m * along)
        sigma = max(usual if found else 0.0, float(np.median(seen.sigma_px)))
        found += [KnownPoint(end, pixel, sigma) for end, pixel in zip(ends, crossings, strict=True)]
    return Keypoints(
        np.array([p.field_m for p in found]).reshape(-1, 2),
        np.array([p.image_px for p in found]).reshape(-1, 2),
        np.array([p.sigma_px for p in found]),
    )


def spread_across(points: Array) -> float:
    """Extent of points (N, 2) across their best line over that along it."""
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(singular[1] / max(singular[0], 1e-300))


def consensus(points: Keypoints, rng: np.random.Generator) -> Mask:
    """Inliers (N,) of the homography of four keypoints that most of the others agree with."""
    count = len(points.field_m)
    if comb(count, SUBSET) <= SUBSETS:
        subsets = list(combinations(range(count), SUBSET))
    else:
        subsets = [tuple(rng.choice(count, SUBSET, replace=False)) for _ in range(SUBSETS)]
    threshold = np.maximum(THRESHOLD_SIGMAS * points.sigma_px, LEAST_THRESHOLD_PX)
    best: tuple[int, float, Mask] | None = None
    for subset in subsets:
        chosen = list(subset)
        if any(spread_across(points.field_m[list(three)]) < COLLINEAR for three in combinations(chosen, 3)):
            continue
        solution = dlt(points.field_m[chosen], points.image_px[chosen])
        if solution is None or not projects_in_front(solution.H, points.field_m):
            continue
        scaled = transfer_errors(solution.H, points.field_m, points.image_px) / threshold
        inliers = scaled < 1.0
        cost = float(np.sum(np.minimum(scaled, 1.0) ** 2))
        if best is None or (int(inliers.sum()), -cost) > (best[0], -best[1]):
            best = int(inliers.sum()), cost, inliers
    if best is None or best[0] < SUBSET:
        raise failure("no_consensus", "no four keypoints, no three of them on a line, agree with a homography")
    if spread_across(points.field_m[best[2]]) < COLLINEAR:
        raise failure("collinear_keypoints", "the keypoints that agree lie on one line")
    return best[2]


def refine(
    points: Keypoints, theta: Array, observations: Observations, template: FieldTemplate, circle: Circle
) -> Array:
    """Homography of the camera that fits inlier keypoints and straight lines best."""
    model = _model(observations, circle)
    known = template.model_copy(update={"length_sd_m": 0.0, "width_sd_m": 0.0})
    curves = curves_from_observations(replace(observations, circles=()), template, NoiseModel(10**6, 0.0, 0.0))
    keys = tuple(MarkingKey(str(k)) for k in range(len(points.field_m)))
    fixed = FixedPoints(points.field_m, points.image_px, points.sigma_px, keys)
    problem = Problem(curves, fixed, priors_of(WITHOUT_PRIORS, known, circle, model), model)
    state = minimise(problem, theta[None])
    return camera_of(state.theta[0], model).homography
