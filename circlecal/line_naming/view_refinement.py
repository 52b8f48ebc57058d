"""Cameras from a few named lines, moved onto all lines and curves that have a name under them.

A camera from three or four lines is as uncertain as their directions: the markings between them lie where these put
them, those beside them tens of pixels off. Distances of the seen lines' ends from the straight markings that they are,
and of the seen curves' points from the circles that they lie on, move it there: Gauss-Newton for all cameras at once,
without a lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import LOG_FOCAL, PAN, POSITION, ROLL, TILT, ProjectionModel, homographies
from circlecal.geometry.conics import circle_conic
from circlecal.geometry.projective import Array, Indices, lift

__all__ = ["SeenMarkings", "circle_conics", "distances_from_circles", "refine_views"]

MOVED = [LOG_FOCAL, PAN, TILT, ROLL, *range(POSITION.start, POSITION.stop)]
"""Parameters of a camera without lens."""
LOOSENESS = np.array([0.2, 0.1, 0.1, 0.03, 6.0, 6.0, 4.0])
"""By how much these may move, one standard deviation: logarithm of the focal length, radians, metres. Chosen wider than
cameras from three or four lines are off, without a measurement of its own.
"""
STEP = 1e-4
"""Of each parameter for its derivative, as a share of its looseness."""
SIGMA_PX = 4.0
"""How far lens and crown leave lines and curves from where a camera without them puts these, px at 1920 px width."""
LARGEST_PX = 40.0
"""Largest distance that counts, pixels at 1920 px width: a wrong name must not pull a camera away."""
INDEPENDENT_POINTS = 4.0
"""As many points of a seen curve count, however many it has: lens and crown move neighbours alike."""
ROUNDS = 3
"""Of Gauss and Newton. Chosen without a measurement of its own."""


@dataclass(frozen=True, slots=True)
class SeenMarkings:
    """What was seen, and what it is under each of B cameras.

    Attributes
    ----------
    segments : (S, 2, 2) array
        Ends of seen lines, pixels.
    markings : (B, S) array of int
        Which straight marking of the template each line is, -1 for none.
    points : (C, N, 2) array
        Points of seen curves, pixels.
    rings : (B, C) array of int
        On which circle or arc of the template each seen curve lies, -1 for none.
    """

    segments: Array
    markings: Indices
    points: Array
    rings: Indices


def refine_views(
    theta: Array, seen: SeenMarkings, template: FieldTemplate, curves: tuple[Circle, ...], model: ProjectionModel
) -> Array:
    """The cameras (B, P), moved onto what has a name under them.

    Parameters
    ----------
    theta : (B, P) array
        Cameras without lens or crown.
    seen : SeenMarkings
        Lines and curves with their names.
    template, curves, model : FieldTemplate, tuple of Circle, ProjectionModel
        The field, the circles and arcs that the names of curves count, and the size of the picture.
    """
    unit = model.width / 1920.0
    moved = theta.copy()
    for _ in range(ROUNDS):
        tried = np.repeat(moved[None], 1 + len(MOVED), axis=0)
        tried[1:, :, MOVED] += np.diag(STEP * LOOSENESS)[:, None]
        batch = tried.reshape(-1, tried.shape[-1])
        back = np.asarray(np.linalg.inv(homographies(batch, model)), np.float64).reshape(*tried.shape[:2], 3, 3)
        off_px = np.concatenate(
            [_distances_of_lines(back, seen, template), _distances_of_curves(back, seen, template, curves)], axis=-1
        )
        values = np.minimum(np.maximum(off_px, -LARGEST_PX * unit), LARGEST_PX * unit) / (SIGMA_PX * unit)
        slopes = np.swapaxes((values[1:] - values[0]) / STEP, 0, 1).copy()
        normal = slopes @ np.swapaxes(slopes, 1, 2) + np.eye(len(MOVED))
        gradient = (slopes @ values[0][..., None])[..., 0] + (moved - theta)[:, MOVED] / LOOSENESS
        moved[:, MOVED] -= LOOSENESS * np.linalg.solve(normal, gradient[..., None])[..., 0]
    return moved


def _distances_of_lines(back: Array, seen: SeenMarkings, template: FieldTemplate) -> Array:
    """How far the ends of seen lines lie from their markings (K, B, 2 S), pixels, under cameras by their inverse
    homographies (K, B, 3, 3); 0 without a name.
    """
    lines = template.line_rows[seen.markings] @ back  # lines go by the inverse transpose
    a, b, c = (lines[..., k] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.where(seen.markings >= 0, 1.0 / np.sqrt(a * a + b * b), 0.0)
        off = [(a * x + b * y + c) * unit for x, y in (seen.segments[:, 0].T, seen.segments[:, 1].T)]
    return np.nan_to_num(np.concatenate(off, axis=-1))


def _distances_of_curves(back: Array, seen: SeenMarkings, template: FieldTemplate, curves: tuple[Circle, ...]) -> Array:
    """How far points of seen curves lie from their circles (K, B, C N), pixels, to first order (Sampson's distance) and
    so that all points of one curve count as :data:`INDEPENDENT_POINTS`; 0 without a name.
    """
    if not (curves and seen.points.size):
        return np.zeros((*back.shape[:2], 0))
    circles = circle_conics(curves, template)[seen.rings]
    off = distances_from_circles(back[:, :, None], circles, seen.points)
    off = np.where(seen.rings[..., None] >= 0, off, 0.0)
    return np.asarray(off.reshape(*back.shape[:2], -1) * np.sqrt(INDEPENDENT_POINTS / seen.points.shape[1]))


def circle_conics(curves: tuple[Circle, ...], template: FieldTemplate) -> Array:
    """Conics (C, 3, 3) of the middle of the paint of circles and arcs on the field."""
    return np.array([circle_conic(c.center, template.radius(c, "center")) for c in curves]).reshape(-1, 3, 3)


def distances_from_circles(back: Array, circles: Array, points_px: Array) -> Array:
    """Signed distances (..., N) of pixels (..., N, 2) from circles of the field (..., 3, 3), to first order (Sampson's
    distance), under cameras by their inverse homographies (..., 3, 3); 0 where none is defined.
    """
    images = np.swapaxes(back, -1, -2) @ circles @ back
    points = np.swapaxes(lift(points_px), -1, -2)
    polars = images @ points
    a, b, c = (polars[..., k, :] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        off = (a * points[..., 0, :] + b * points[..., 1, :] + c) / (2.0 * np.sqrt(a * a + b * b))
    return np.asarray(np.nan_to_num(off))
