"""Straight markings in another colour than the circle's: lines of another sport, streaks of light and halos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, line_distance
from circlecal.paint.colour import (
    colours_at,
    colours_beside,
    match_paint,
    measure_added_colour,
    measure_added_colours,
)
from circlecal.paint.lines import LEAST_UNIT
from circlecal.results import Cues, EllipseFits, LineCue, Segment

__all__ = ["are_painted_otherwise", "leave_out_other_paints", "leave_out_yellow_lines"]

SAME_LINE_PX = 6.0
"""So near to a measured line lie both ends of the rough one that it was measured along, pixels at 1920 px width."""
GREEN = 1
"""Of blue, green and red."""
LESS_BLUE, MORE_RED, LEAST_YELLOW = 0.2, 0.1, 16.0
"""What a yellow line adds less of blue and more of red than white paint of equal strength, shares of it, and the grey
levels that it must add to be told. Eleven yellow lines of another sport on rendered pitches, 1.4 to 2.1 px wide, have
0.23 to 0.27 and 0.11 to 0.15; of 565 lines of real and rendered fields, but for fainter ones, none exceeds both.
"""
MOST_BLUE = 0.76
"""Blue over red that a yellow line adds at most; it adds more red than green, too. Of 235 lines on rendered pitches
that the shares above tell from the circle's paint, yellow ones have 0.25 to 0.70 of blue and 1.05 of red over green or
more. Six white ones are told apart by this alone, since their circle was measured to be bluish: five have 0.82 to 1.2
of blue, the sixth is faint and has 0.93 of red over green.
"""
ONE_GROUND = 0.5
"""How far apart the colours of the ground on either side of a yellow line may be, as a share of what the line adds: on
rendered pitches ten yellow lines have up to 0.12; the far edge of the grass before a dark strip, yellowish as it is,
has 1.7.
"""
OWN_PX, HALO_PX, BESIDE_PX, HALO_SHARE = 1.5, 6.0, 12.0, 1.0 / 3.0
"""A sharpened picture has a dark halo beside a light line: the line itself reaches so far to both sides of its middle,
within the second distance lies paint of the opposite sign, and the halo has at most this share of its contrast. Up to
the third the surface lies bare; pixels at 1920 px width, looked at in steps of the first. In a rendered hall the halo
of a white line has 0.10 of it; a black line and a white one side by side have about 0.9.
"""


def leave_out_other_paints(image: NDArray[np.uint8], cues: Cues, ellipses: EllipseFits, band_px: float | None) -> Cues:
    """The cues without further lines of another colour than the circle's paint: those of another sport on the same
    floor, streaks of light beside them, and their halos. Lines too faint to tell are kept.

    The detector has compared the colours along rough segments, which miss paint of a pixel or two; the measured points
    do not.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    cues : Cues
        What was measured.
    ellipses : EllipseFits
        With the middle of the circle's paint, without which nothing is compared.
    band_px : float or None
        Width of the circle's paint where it is widest, pixels.
    """
    colour = _measure_circle(image, ellipses, band_px) if cues.lines else None
    if colour is None:
        return cues
    added = _measure_lines(image, cues.lines)
    is_other = [
        not match_paint(own, colour) or _is_yellow_on_grass(image, line, own, colour) or _is_halo(image, line, colour)
        for line, own in zip(cues.lines, added, strict=True)
    ]
    return _set_apart(cues, is_other)


def leave_out_yellow_lines(image: NDArray[np.uint8], cues: Cues, ellipses: EllipseFits, band_px: float | None) -> Cues:
    """The cues without further lines that are yellow on grass beside a circle in white; the parameters are those of
    :func:`leave_out_other_paints`, which compares all colours. Mown stripes and haze change what white paint adds to
    grass, but do not make it yellow.
    """
    colour = _measure_circle(image, ellipses, band_px) if cues.lines else None
    if colour is None:
        return cues
    told = zip(cues.lines, _measure_lines(image, cues.lines), strict=True)
    return _set_apart(cues, [_is_yellow_on_grass(image, line, own, colour) for line, own in told])


def _set_apart(cues: Cues, is_other: Sequence[bool]) -> Cues:
    """The cues with these of the further lines (S,) among those in another paint."""
    told = tuple(zip(cues.lines, is_other, strict=True))
    lines, others = (tuple(line for line, other in told if other is kind) for kind in (False, True))
    return replace(cues, lines=lines, others=(*cues.others, *others))


def _measure_circle(image: NDArray[np.uint8], ellipses: EllipseFits, band_px: float | None) -> Array | None:
    """Blue, green and red (3,) that the circle's paint adds to the ground; None where its middle was not measured."""
    fit = ellipses.center
    if fit is None:
        return None
    points = fit.points_px[fit.inliers]
    normals = fit.ellipse.normals(fit.ellipse.parameter(points))
    return measure_added_colour(image, points, normals, band_px or 0.0)


def _measure_lines(image: NDArray[np.uint8], lines: Sequence[LineCue]) -> list[Array]:
    """Blue, green and red (3,) that the paint of each line adds to the ground."""
    counts = [len(line.points_px) for line in lines]
    points = np.concatenate([line.points_px for line in lines])
    normals = np.repeat([_normal_of(line) for line in lines], counts, axis=0)
    widths = np.repeat([line.width_px for line in lines], counts)
    added = measure_added_colours(image, points, normals, widths)
    return [median_of_rows(own) for own in np.split(added, np.cumsum(counts)[:-1])]


def are_painted_otherwise(
    image: NDArray[np.uint8], segments: Sequence[Segment], cues: Cues, ellipses: EllipseFits, band_px: float | None
) -> NDArray[np.bool_]:
    """Which straight lines (S,) were measured to be in another colour than the circle's paint, as
    :func:`leave_out_other_paints` takes them; that looks at those alone that run along one of the segments.
    """
    near_px = SAME_LINE_PX * image.shape[1] / 1920.0
    ends = np.array([(segment.start, segment.end) for segment in segments]).reshape(-1, 2, 2)
    measured = (*cues.lines, *cues.others)
    off = [np.abs(line_distance(line.line, ends)).max(axis=1) < near_px for line in measured]
    asked = [(line, along) for line, along in zip(measured, off, strict=True) if along.any()]
    lines = tuple(line for line, _ in asked)
    kept = leave_out_other_paints(image, replace(cues, lines=lines), ellipses, band_px).lines
    found = np.zeros(len(segments), np.bool_)
    for line, along in asked:
        if all(line is not other for other in kept):
            found |= along
    return found


def _is_yellow_on_grass(image: NDArray[np.uint8], line: LineCue, added: Array, colour: Array) -> bool:
    """Whether a line with the same green ground on both sides adds less blue and more red than paint of a colour (3,)
    does: compression smears the colours of narrow lines so far that yellow looks nearly white. On wood it makes white
    lines yellow.
    """
    strength = float(np.linalg.norm(added))
    if strength < LEAST_YELLOW:
        return False
    blue, _, red = added / strength - colour / max(float(np.linalg.norm(colour)), 1e-9)
    if blue >= -LESS_BLUE or red <= MORE_RED or added[0] >= MOST_BLUE * added[2] or added[1] >= added[2]:
        return False
    across = np.broadcast_to(_normal_of(line), line.points_px.shape)
    sides = np.median(colours_beside(image, line.points_px, across, np.full(1, line.width_px)), axis=(0, 2))
    is_one_ground = float(np.linalg.norm(sides[0] - sides[1])) < ONE_GROUND * strength
    return is_one_ground and int(sides.mean(axis=0).argmax()) == GREEN


def _is_halo(image: NDArray[np.uint8], line: LineCue, colour: Array) -> bool:
    """Whether a line that looks like paint of a colour (3,) is what sharpening left beside paint of the opposite sign:
    by the picture across the line, the median over its points, along that colour.
    """
    unit = max(LEAST_UNIT, image.shape[1] / 1920.0)
    away_px = np.arange(-BESIDE_PX, BESIDE_PX + 0.5 * OWN_PX, OWN_PX)
    places = line.points_px[:, None] + unit * away_px[:, None] * _normal_of(line)
    profile = np.median(colours_at(image, places) @ (colour / max(float(np.linalg.norm(colour)), 1e-9)), axis=0)
    profile -= np.median(profile)
    own, opposite = (
        float(values[np.abs(away_px) <= reach].max()) for values, reach in ((profile, OWN_PX), (-profile, HALO_PX))
    )
    return own < HALO_SHARE * opposite


def _normal_of(line: LineCue) -> Array:
    """Unit vector (2,) across a line."""
    return np.asarray(line.line[:2] / np.hypot(*line.line[:2]))
