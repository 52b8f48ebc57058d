"""Painters' errors of a clip: markings that lie beside the places where the template has them, in all frames alike.

A marking is painted once, so no number of frames lowers such an error, and a tripod and the heads of its frames follow
it together. They are fitted as if paint lay where the template has it; what that leaves open is told beside the noise.
Where errors e of one standard deviation each move the distances ``r`` of the paint by ``R e``, and J are the
derivatives of these by what is fitted, with weights w and a prior's information N, the fit moves by
``-(J^T w J + N)^-1 J^T w R e``, and its covariance grows by that times its transpose.
"""

from __future__ import annotations

import numpy as np

from circlecal.geometry.camera_parameters import ProjectionModel, project
from circlecal.geometry.projective import Array, Indices
from circlecal.rig.tripod import COMMON, TripodEstimate
from circlecal.tracking.markings import DrawnTemplate, grow_places
from circlecal.tracking.seen_paint import MeasuredFrame

RADIUS_DIGITS = 3
"""Circles whose radii agree to so many digits of a metre are drawn with one compass."""


def name_errors(drawn: DrawnTemplate) -> tuple[str, ...]:
    """Names of the E errors that painters may make: of each marking along x, of each along y, of each radius."""
    placed = [f"{name} {axis}" for axis in "xy" for name in drawn.names] if drawn.placement_sd_m > 0.0 else []
    radii = [f"radius {radius:.{RADIUS_DIGITS}f} m" for radius in _radii(drawn)] if drawn.radius_sd_m > 0.0 else []
    return (*placed, *radii)


def move_by_errors(measured: MeasuredFrame, drawn: DrawnTemplate, theta: Array, model: ProjectionModel) -> Array:
    """Derivatives (M, E) of the distances of a frame's paint from its markings by painters' errors, each in its
    standard deviations, before a camera (P,).
    """
    places = grow_places(drawn, measured.marking, measured.field_m, theta)
    by_place = project(theta[None], places[None], model).gradient(measured.normals.T[None])[1][0].T
    parts = []
    if drawn.placement_sd_m > 0.0:
        is_of = _members(measured.marking, len(drawn.names))
        parts += [drawn.placement_sd_m * is_of * by_place[:, axis, None] for axis in (0, 1)]
    if drawn.radius_sd_m > 0.0:
        radius = drawn.radius[measured.marking]
        outward = (measured.field_m - drawn.center[measured.marking]) / np.maximum(radius, 1e-9)[:, None]
        grown = np.where(radius > 0.0, (outward * by_place).sum(axis=1), 0.0)
        size = np.searchsorted(_radii(drawn), np.round(radius, RADIUS_DIGITS))
        parts.append(drawn.radius_sd_m * _members(size, len(_radii(drawn))) * grown[:, None])
    return np.concatenate(parts, axis=1) if parts else np.zeros((len(measured.marking), 0))


def align_errors(tripod: TripodEstimate | None, drawn: DrawnTemplate) -> Array:
    """How the common parameters of a tripod follow the errors of a field (K, E), as far as that is known of them by
    their names; not at all without a tripod.
    """
    by_errors = {} if tripod is None or tripod.painters is None else tripod.painters.by_errors
    nothing = np.zeros(len(COMMON))
    columns = [by_errors.get(name, nothing) for name in name_errors(drawn)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(COMMON), 0))


def list_errors(by_errors: Array, drawn: DrawnTemplate) -> dict[str, Array]:
    """How the common parameters (K, E) follow errors, by the names of those that they follow."""
    columns = zip(name_errors(drawn), by_errors.T, strict=True)
    return {name: np.array(column) for name, column in columns if column.any()}


def _radii(drawn: DrawnTemplate) -> Array:
    """The sizes of circles and arcs, from the smallest to the largest, metres."""
    return np.unique(np.round(drawn.radius[drawn.radius > 0.0], RADIUS_DIGITS))


def _members(number: Indices, count: int) -> Array:
    """Ones (M, count) where a place has a number."""
    return np.asarray(number[:, None] == np.arange(count), np.float64)
