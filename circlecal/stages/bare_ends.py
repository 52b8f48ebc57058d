"""Whether the halfway line's paint ends on bare ground: a pitch's ends at the touchlines, a drawn one anywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, Mask
from circlecal.paint.bands import measure_curve
from circlecal.paint.roughness import measure_roughness

__all__ = ["count_bare_ends"]

SPACING_PX = 2.0
"""Distance of places along the line, pixels at 1920 px width."""
PIECE = 25
"""Places in a row that are measured together."""
REACH_PX, REACH_ACROSS_PX = 14.0, 22.0
"""Reach of a profile across the line, and across one that would cross it at its end, whose place is that of the paint's
end: pixels at 1920 px width.
"""
GROUND_PX = 6.0
"""The ground is looked at so far beyond the reach of a profile, pixels at 1920 px width."""
LONGEST_LINE = 2.0
"""The line is followed so far from its middle, in half lengths of the field's: a drawn one may run on."""
SEEN_AHEAD_PX = 20.0, 140.0
"""From where to where beyond the last paint the ground is looked at, pixels at 1920 px width."""
SEEN_BESIDE_M, PLACES_BESIDE = (1.0, 6.0), 60
"""From where to where to each side a line that crosses the end is looked for, metres, and at how many places: a player
hides less of it.
"""
RUN, PAINTED_OF_RUN = 9, 0.8
"""The line is painted where such a share of so many places in a row is: noise is not."""
FULL_VIEW, MOST_PAINTED = 0.9, 0.3
"""Share of the ground ahead and beside that must be in full view for an end to be bare, and the most of a crossing line
that may be painted there. Of 45 real frames none has two such ends, and one has one, which a pan has blurred; the line
of a picture that was drawn has two.
"""
ROUGH_TIMES, ROUGH_LEVELS = 2.0, 3.0
"""Ground in full view is at most so many times as rough as beside the line's paint, and so many gray levels more."""


def count_bare_ends(picture: NDArray[np.uint8], view: FieldView, template: FieldTemplate) -> int:
    """At how many ends of the halfway line's paint nothing but bare ground is in full view, ahead and to both sides.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    view : FieldView
        Says where the line runs.
    template : FieldTemplate
        A field whose halfway line ends at other lines.
    """
    height, width = picture.shape
    unit = width / 1920.0
    line, along_m = _place_line(view, template, (width, height))
    if len(line) < RUN:
        return 0
    pieces = np.arange(len(line)) // PIECE
    normals = _normals(line)
    painted = measure_curve(picture, line, normals, np.full(len(line), REACH_PX * unit), pieces).supported
    runs = np.flatnonzero(np.convolve(painted, np.ones(RUN), "same") >= PAINTED_OF_RUN * RUN)
    if len(runs) == 0:
        return 0
    rough = _measure_ground(picture, line, normals, REACH_PX * unit)
    limit = ROUGH_TIMES * float(np.median(rough[runs])) + ROUGH_LEVELS
    is_ground = ~painted & (rough < limit)
    return sum(
        _is_in_full_view(is_ground, last, step)
        and all(_is_bare_beside(picture, view, template, along_m[last], side, limit) for side in (-1.0, 1.0))
        for last, step in ((int(runs[0]), -1), (int(runs[-1]), 1))
    )


def _halfway_line(template: FieldTemplate) -> tuple[Array, Array]:
    """Middle (2,) of the halfway line and the way (2,) from there to its one end, metres."""
    ends = template.line_ends(template.line_by_name[template.halfway_line or ""])
    return ends.mean(axis=0), (ends[1] - ends[0]) / 2.0


def _place_line(view: FieldView, template: FieldTemplate, size: tuple[int, int]) -> tuple[Array, Array]:
    """Places (N, 2) of the halfway line and of what lies behind its ends, as far as the picture shows it, at even
    distances in pixels, and how far each is along the line (N,), metres from its middle.
    """
    middle, half = _halfway_line(template)
    share = np.linspace(-LONGEST_LINE, LONGEST_LINE, 1001)
    pixels = view.project(middle + share[:, None] * half)
    inside = (
        np.isfinite(pixels).all(axis=1) & (pixels >= 0.0).all(axis=1) & (pixels <= np.subtract(size, 1)).all(axis=1)
    )
    pixels, along_m = pixels[inside], share[inside] * float(np.linalg.norm(half))
    if len(pixels) < 2:
        return np.zeros((0, 2)), np.zeros(0)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))])
    even = np.arange(0.0, way[-1], SPACING_PX * size[0] / 1920.0)
    return np.stack([np.interp(even, way, pixels[:, k]) for k in (0, 1)], axis=-1), np.interp(even, way, along_m)


def _normals(places: Array) -> Array:
    """Unit normals (N, 2) of a curve through places (N, 2)."""
    along = np.gradient(places, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=-1)


def _measure_ground(picture: NDArray[np.uint8], places: Array, normals: Array, reach_px: float) -> Array:
    """How rough the ground (N,) is beside places, on the rougher of the two sides, gray levels."""
    beside = (reach_px + GROUND_PX * picture.shape[1] / 1920.0) * normals
    return np.maximum(*(measure_roughness(picture, places + side * beside) for side in (-1.0, 1.0)))


def _is_in_full_view(is_ground: Mask, last: int, step: int) -> bool:
    """Whether the ground ahead of the last paint is in full view; never where the picture ends before."""
    first, farthest = (round(distance / SPACING_PX) for distance in SEEN_AHEAD_PX)
    ahead = last + step * np.arange(first, farthest)
    inside = ahead.min() >= 0 and ahead.max() < len(is_ground)
    return bool(inside and is_ground[ahead].mean() >= FULL_VIEW)


def _is_bare_beside(
    picture: NDArray[np.uint8], view: FieldView, template: FieldTemplate, along_m: float, side: float, limit: float
) -> bool:
    """Whether ground in full view, and no line that crosses it there, lies on one side of a place along the halfway
    line; ``limit`` is how rough ground may be.
    """
    middle, half = _halfway_line(template)
    along = half / np.linalg.norm(half)
    across = side * np.array([-along[1], along[0]])
    places = view.project(middle + along_m * along + np.linspace(*SEEN_BESIDE_M, PLACES_BESIDE)[:, None] * across)
    inside = (places >= 0.0).all(axis=1) & (places <= np.subtract(picture.shape[::-1], 1)).all(axis=1)
    if not inside.all():
        return False
    normals, reach_px = _normals(places), REACH_ACROSS_PX * picture.shape[1] / 1920.0
    pieces = np.zeros(PLACES_BESIDE, np.int64)
    painted = measure_curve(picture, places, normals, np.full(PLACES_BESIDE, reach_px), pieces).supported
    is_ground = _measure_ground(picture, places, normals, reach_px) < limit
    return bool(painted.mean() <= MOST_PAINTED and is_ground.mean() >= FULL_VIEW)
