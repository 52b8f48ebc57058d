"""Observations of a frame as the optimiser's residuals: thinned, with realistic standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.camera.residuals import NOT_MOVED, CurvePoints, FixedPoints, circle_curve, line_curve, stack_curves
from circlecal.field import FieldTemplate
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Indices, extent, fit_line
from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkingKey, MarkPoint, Observations

LEAST_SIGMA_PX = 0.02
"""No point of a picture is measured better, pixels."""
ELLIPSE_POINTS = 240
FEWEST_OF_ELLIPSE = 20
"""Of so many points about is the ellipse along which neighbours are averaged."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """How far points along a marking can be trusted.

    Attributes
    ----------
    maximum_points : int
        Per marking; more are averaged along it.
    model_sigma_px : float
        What lens, crown and paint leave of an ideal marking.
    correlation_px : float
        Over which length neighbours repeat each other's error.
    """

    maximum_points: int
    model_sigma_px: float
    correlation_px: float


def curves_from_observations(observations: Observations, template: FieldTemplate, noise: NoiseModel) -> CurvePoints:
    """Circles and named lines of the template that were seen, thinned, with the model's own sigma added."""
    relative: dict[str, float] = {"outer": 0.5, "center": 0.0, "inner": -0.5}
    bloom: dict[str, float] = {"outer": 1.0, "center": 0.0, "inner": -1.0}
    parts = []
    for seen in observations.circles:
        known = template.circle_by_name.get(seen.circle)
        if known is None or len(seen.points_px) == 0:
            continue
        points, sigma = _thin_arc(seen.points_px, seen.sigma_px, noise.maximum_points)
        sigma = _add_model_noise(points, sigma, 2.0 * extent(points), noise)
        radius = template.radius(known, seen.edge)
        by_width = relative[seen.edge] - relative[known.edge]
        center = np.asarray(known.center)
        shift = template.place_shift(known.center)
        parts.append(circle_curve(seen.key, points, sigma, center, radius, by_width, bloom[seen.edge], shift))
    for line in observations.lines:
        drawn = None if line.line is None else template.line_by_name.get(line.line)
        if drawn is None or len(line.points_px) == 0:
            continue
        points, sigma = thin_line(line, noise)
        parts.append(line_curve(drawn.name, points, sigma, template.line_ends(drawn), template.line_shift(drawn)))
    return stack_curves(parts)


def thin_curves(curves: CurvePoints, along: Array | Indices, maximum: int, least_sigma_px: float) -> CurvePoints:
    """At most so many points of each marking, evenly in the order of ``along`` (N,), which then count for the
    others too: with sigmas that are the smaller, down to the model's own.
    """
    count = np.bincount(curves.group, minlength=len(curves.keys))
    order = np.lexsort((along, curves.group))
    group = curves.group[order]
    place = np.arange(len(order)) - (np.cumsum(count) - count)[group]
    size = -(-count // maximum)[group]
    kept = order[place % size == size // 2]
    thinned = curves.select(kept)
    fewer = np.maximum(thinned.sigma_px / np.sqrt(-(-count // maximum)[thinned.group]), least_sigma_px)
    return thinned.with_sigma(np.minimum(thinned.sigma_px, fewer))


def thin_line(line: LinePoints, noise: NoiseModel) -> tuple[Array, Array]:
    """Points (N, 2) along a straight marking and their standard deviations (N,)."""
    points, sigma = _thin(line.points_px, line.sigma_px, noise.maximum_points)
    return points, _add_model_noise(points, sigma, extent(points), noise)


def with_model_noise(curves: CurvePoints, sigma_px: Array, noise: NoiseModel, model_sigma_px: float) -> Array:
    """Standard deviations (N,) with another error of the model than that of ``noise``, with which they are given."""
    variance = sigma_px**2
    for group in range(len(curves.keys)):
        own = np.flatnonzero(curves.group == group)
        if len(own) < 2:
            continue
        length_px = extent(curves.points_px[own]) * (1.0 if curves.straight[own[0]] else 2.0)
        change = model_sigma_px**2 - noise.model_sigma_px**2
        variance[own] += change * _repeats(len(own), length_px, noise)
    return np.sqrt(np.maximum(variance, LEAST_SIGMA_PX**2))


def points_from_observations(observations: Observations, template: FieldTemplate, relief_m: float = 0.0) -> FixedPoints:
    """Marks and keypoints that were seen; the ground at a mark is so much (metres, one standard deviation) higher or
    lower than its profile.
    """
    marks = [m for m in observations.marks if m.mark in template.mark_by_name]
    relief_px = relief_m * _pixels_per_height(observations, template) if marks and relief_m > 0.0 else 0.0
    places = [np.asarray(template.mark_by_name[m.mark].position) for m in marks]
    found = [(m.key, place, m.point_px, m.sigma_px, relief_px) for m, place in zip(marks, places, strict=True)]
    found += [(k.key, k.field_m, k.point_px, k.sigma_px, 0.0) for k in observations.keypoints]
    shifts = [template.place_shift((float(x), float(y))) for x, y in places]
    shifts += [NOT_MOVED if k.shift is None else k.shift for k in observations.keypoints]
    sigma_px = np.array([f[3] for f in found], dtype=np.float64)
    return FixedPoints(
        np.array([f[1] for f in found]).reshape(-1, 2),
        np.array([f[2] for f in found]).reshape(-1, 2),
        sigma_px,
        tuple(f[0] for f in found),
        np.hypot(sigma_px, [f[4] for f in found]) if relief_px > 0.0 else None,
        np.array(shifts).reshape(-1, 3, 2) if found else None,
    )


def _pixels_per_height(observations: Observations, template: FieldTemplate) -> float:
    """By how many pixels a point is seen higher that lies a metre higher, by the ellipse of the circle seen best.

    With semi-axes a > b of a circle's image and its radius R, a / R pixels show a metre across the view, and sin(e) =
    b / a the angle e under which the ground is seen, on which what stands upright is foreshortened by cos(e).
    """
    most = max(observations.circles, key=lambda circle: len(circle.points_px), default=None)
    known = None if most is None else template.circle_by_name.get(most.circle)
    if most is None or known is None or len(most.points_px) < FEWEST_OF_ELLIPSE:
        return 0.0
    conic = fit_conic(most.points_px[:: max(1, len(most.points_px) // ELLIPSE_POINTS)], "direct")
    ellipse = None if conic is None else ellipse_from_conic(conic)
    if ellipse is None:
        return 0.0
    longer, shorter = ellipse.semi_axes
    return float(np.sqrt(longer**2 - shorter**2)) / known.radius_m


def median_sigmas(observations: Observations) -> dict[MarkingKey, float]:
    """Median standard deviation in pixels that each observation itself states."""
    curves: tuple[CirclePoints | LinePoints, ...] = (*observations.circles, *observations.lines)
    points: tuple[MarkPoint | Keypoint, ...] = (*observations.marks, *observations.keypoints)
    stated = {c.key: float(median_of_rows(c.sigma_px)) for c in curves if c.key is not None and len(c.sigma_px)}
    return stated | {p.key: p.sigma_px for p in points}


def _add_model_noise(points: Array, sigma: Array, length_px: float, noise: NoiseModel) -> Array:
    """Sigmas (N,) with the model's own error, grown so that points within one correlation length count as one."""
    if len(points) < 2 or noise.model_sigma_px == 0:
        return sigma
    return np.hypot(sigma, noise.model_sigma_px * np.sqrt(_repeats(len(points), length_px, noise)))


def _repeats(count: int, length_px: float, noise: NoiseModel) -> float:
    """How many of so many points lie within one correlation length."""
    return max(1.0, noise.correlation_px * count / max(length_px, 1e-6))


def _thin(points: Array, sigma: Array, maximum: int) -> tuple[Array, Array]:
    """Means of neighbouring points of a straight marking, in which all count but the last ones that fill no group."""
    size = -(-len(points) // maximum)
    if size <= 1:
        return points, sigma
    normal = fit_line(points)[:2]
    order = np.argsort(points @ np.array([normal[1], -normal[0]]), kind="stable")
    usable = len(points) // size * size
    groups = order[:usable].reshape(-1, size)
    return points[groups].mean(axis=1), np.sqrt((sigma[groups] ** 2).mean(axis=1) / size)


def _thin_arc(points: Array, sigma: Array, maximum: int) -> tuple[Array, Array]:
    """Means of neighbouring points of an arc: the middle one of each group, moved by the group's mean deviation from an
    ellipse.
    """
    size = -(-len(points) // maximum)
    # the ellipse only orders and levels neighbours
    conic = fit_conic(points[:: max(1, len(points) // ELLIPSE_POINTS)], "direct") if size > 1 else None
    ellipse = None if conic is None else ellipse_from_conic(conic)
    if ellipse is None:
        return points, sigma
    angle = ellipse.parameter(points)
    order = np.argsort(angle, kind="stable")
    groups = order[: len(points) // size * size].reshape(-1, size)
    normals = ellipse.normals(angle)
    deviation = np.sum((points - ellipse.points(angle)) * normals, axis=-1)
    middle = groups[:, size // 2]
    # groups that span a gap of the arc keep only their middle point
    spread = np.linalg.norm(points[groups[:, -1]] - points[groups[:, 0]], axis=-1)
    whole = spread < 4 * np.median(spread) + 1e-9
    change = np.where(whole, deviation[groups].mean(axis=1) - deviation[middle], 0.0)
    averaged = np.sqrt((sigma[groups] ** 2).mean(axis=1) / np.where(whole, size, 1))
    return points[middle] + change[:, None] * normals[middle], averaged
