"""A field that lies partly in deep shade: what is seen in the sun and what is seen in the shade, taken together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array, extent, join, lift, line_distance
from circlecal.paint.colour import surface_colour
from circlecal.results import MarkingMask, Segment

SHADE_TURN_DEG, LEAST_CHROMA = 10.0, 8.0
"""By how much shade turns the hue of the field in CIE Lab, and levels of a and b from grey below which a surface has no
hue. On a rendered pitch the deep shade of a stand turns it by 3 degrees.
"""
SAME_LINE_PX = 4.0
"""Pixels at 1920 px width within which both ends of a segment lie on the line of another one that is seen on the other
part of the field, too."""


def join_lights(mask: MarkingMask, image: NDArray[np.uint8]) -> MarkingMask | None:
    """The markings of all surfaces of a picture (H, W, 3) that have the hue of the field, which shade leaves it; None
    where other surfaces add no straight marking.
    """
    own = mask.field_region
    if own is None or mask.polarity is None or len(mask.sightings) < 2:
        return None
    near_px = SAME_LINE_PX * image.shape[1] / 1920.0
    hue, lines, region, parts = _hue(image, own), mask.lines, own, [mask]
    for seen in mask.sightings:
        if seen.polarity != mask.polarity or seen.field_region is None or not seen.lines:
            continue
        joined = _join_lines(lines, seen.lines, near_px)
        adds_lines = any(all(line is not other for other in lines) for line in joined)
        if adds_lines and _are_alike(hue, _hue(image, seen.field_region)):
            lines, region, parts = joined, region | seen.field_region, [*parts, seen]
    if len(parts) == 1:
        return None
    return replace(mask, drawn=partial(_draw, parts), lines=lines, field_region=region)


def _draw(parts: Sequence[MarkingMask]) -> NDArray[np.uint8]:
    """Classes (H, W) of the markings of all parts, those of the first ones over the others."""
    classes = parts[0].classes
    for part in parts[1:]:
        classes = np.where(classes > 0, classes, part.classes)
    return classes


def _join_lines(first: tuple[Segment, ...], second: tuple[Segment, ...], near_px: float) -> tuple[Segment, ...]:
    """The lines of two parts of the field, of one that both show the longer piece."""
    kept = [
        a for a in first if not any(_lies_on(a, b, near_px) and extent(_ends(a)) < extent(_ends(b)) for b in second)
    ]
    return (*kept, *(b for b in second if not any(_lies_on(b, a, near_px) for a in kept)))


def _hue(image: NDArray[np.uint8], region: NDArray[np.bool_]) -> float | None:
    """Median hue of a surface in CIE Lab, radians; None where it has none, or there is no surface."""
    colour = surface_colour(image, region)
    if colour is None or np.hypot(colour[1], colour[2]) < LEAST_CHROMA:
        return None
    return float(np.arctan2(colour[2], colour[1]))


def _are_alike(one: float | None, other: float | None) -> bool:
    """Whether two hues, radians, are alike; what has none is like nothing."""
    if one is None or other is None:
        return False
    turn = np.remainder(one - other + np.pi, 2.0 * np.pi) - np.pi
    return bool(np.abs(turn) < np.radians(SHADE_TURN_DEG))


def _ends(segment: Segment) -> Array:
    """Both ends (2, 2), pixels."""
    return np.stack([segment.start, segment.end])


def _lies_on(segment: Segment, other: Segment, near_px: float) -> bool:
    """Whether a segment lies on another's line and beside a part of it."""
    along = other.end - other.start
    off_px = line_distance(join(lift(other.start), lift(other.end)), _ends(segment))
    share = np.sort((_ends(segment) - other.start) @ along / max(float(along @ along), 1e-9))
    return bool((np.abs(off_px) < near_px).all() and share[0] < 1.0 and share[1] > 0.0)
