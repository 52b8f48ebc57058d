"""The picture around the halfway line inside the circle, resampled along the line and along the field's other axis.

There a disc on the line is symmetric about it however it runs in the picture, and the circle gives the disc's size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.conics import line_conic_meet, pole
from circlecal.geometry.projective import Array, Mask, dehomogenise, line_distance, normalise_line
from circlecal.paint.profiles import GrayPicture, sample_profiles

Rows = NDArray[np.floating[Any]]

__all__ = [
    "AROUND_PX",
    "LINE_PX",
    "STEP_PX",
    "RectifiedLine",
    "across_directions",
    "disc_coverage",
    "half_chords",
    "measure_contrast",
    "rectify_line",
]

# Tuned as the constants of :mod:`circlecal.paint.centre_mark` are.
STEP_PX = 0.5
"""Pixels between two places that are compared: peaks are a disc wide, and refined between the places. At 1.0 half of
the marks of real frames are lost, since circles of 60 px leave too few places.
"""
_MARGIN = 0.2
"""Half chords searched beyond the allowed range, to know the usual scatter. At 0.12 a half chord of less than 37 px
leaves too few places for that: 5 right fewer, 2 wrong more. From 0.15 to 0.5 one more or fewer.
"""
LINE_PX = 1.5
"""Pixels to both sides of the line's middle over which its paint is looked at: it is wider, or blur makes it so."""
AROUND_PX = 2.5
"""How far around the disc the line and the surface must be bare, pixels. At 1.0 and at 5.0 2 right fewer, and 2 and 3
wrong more.
"""
_UNWORN, _MOSTLY_WORN = 0.75, 0.5
"""Quantile of the line's brightness along it that its paint has where half of it or more is worn off, and share of that
contrast: a line that usually shows less is worn.
"""
_BEND_POINTS = 15
"""Measured points of the line over which its bend is averaged. At 45 one wrong more; with no bend 16 right fewer, 3
wrong more, and a median error of 0.6 px.
"""


@dataclass(frozen=True, slots=True)
class RectifiedLine:
    """The picture around a stretch of the halfway line: rows along the line, columns along the field's other axis.

    ``values`` (T, S) are brightnesses over what is ``usual`` (S,) in their column; ``in_view`` (2, T) says on which
    sides of the line, left and right, the picture shows all that a disc there would cover or lie beside.
    ``position`` (T,) along the line and ``across`` (S,) in px; ``base`` (T, 2) the places on the line, ``length`` its
    half chord in px; ``half_px`` the disc's half axes along and across in the middle of the allowed range,
    ``halves_px`` (T, 2) at each place; ``cosine`` is that of the angle between the two axes in the picture.
    """

    values: Array
    usual: Array
    in_view: Mask
    position: Array
    across: Array
    base: Array
    length: float
    half_px: tuple[float, float]
    halves_px: Array
    cosine: float = 0.0

    def distance_px(self, along_px: Array, across_px: Array) -> Array:
        """How far from each other two places are in the picture that differ by so much along the axes."""
        square = along_px**2 + across_px**2 + 2.0 * self.cosine * along_px * across_px
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def rectify_line(
    picture: GrayPicture,
    line: Array,
    line_points_px: Array,
    conic: Array,
    radius_radii: float,
    blur_px: float,
    offset: tuple[float, float],
) -> RectifiedLine | None:
    """The picture around the places of a disc on the line; None where it shows too few of them.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
    line : (3,) array
        The line, px.
    line_points_px : (N, 2) array
        Measured middle of its paint.
    conic : (3, 3) array
        Image of the circle.
    radius_radii : float
        Radius of the disc, in radii of the circle.
    blur_px : float
        Standard deviation of the picture's blur.
    offset : (float, float)
        Where the disc may lie, half chords beyond the chord's middle, towards the far side.
    """
    line = normalise_line(line)
    meets = line_conic_meet(conic, line)
    if meets is None:
        return None
    chord = dehomogenise(meets)
    far, near = chord[np.argsort(chord[:, 1])]
    middle, along = 0.5 * (far + near), 0.5 * (far - near)
    length = float(np.hypot(*along))
    low, high = max(-0.95, offset[0] - _MARGIN) * length, min(0.95, offset[1] + _MARGIN) * length
    position = np.arange(low, high, STEP_PX)
    if len(position) < 24:
        return None
    base = middle + position[:, None] / length * along
    base += _bend(line, line_points_px, (line_points_px - middle) @ along / length, position)[:, None] * line[:2]
    direction = across_directions(conic, line, base)
    radius = half_chords(conic, base, direction)
    if not np.isfinite(radius).all():
        return None
    # along a chord whose ends stay the field's scale at the disc is 1 - place^2
    halves = radius_radii * np.stack([(1.0 - (position / length) ** 2) * length, radius], axis=-1)
    offsets = 0.5 * (offset[0] + offset[1])
    half = (radius_radii * (1.0 - offsets**2) * length, radius_radii * float(np.median(radius)))
    reach = max(3.0 * half[1], half[1] + 8.0)
    across = np.arange(-reach, reach + STEP_PX / 2, STEP_PX)
    values = np.asarray(sample_profiles(picture, base, direction, across), np.float64)
    # further out the picture may end
    needed = half[1] + 1.5 * blur_px + 2.0 + AROUND_PX
    is_seen = np.isfinite(values)
    sides = [(side * across >= -LINE_PX) & (side * across <= needed) for side in (-1.0, 1.0)]
    in_view = np.stack([is_seen[:, columns].all(axis=1) for columns in sides])
    whole = in_view.any(axis=0)
    if np.count_nonzero(whole) < 24:
        return None
    values = values[whole]
    known = np.isfinite(values).any(axis=0)
    values, across = values[:, known], across[known]
    usual = (np.nanmedian if np.isnan(values).any() else np.median)(values, axis=0)
    cosine = float(np.median(direction @ along)) / length
    places = position[whole], across, base[whole], length, half, halves[whole], cosine
    return RectifiedLine(values - usual, usual, in_view[:, whole], *places)


def across_directions(conic: Array, line: Array, places: Array) -> Array:
    """Directions (T, 2) of the field's other axis at places (T, 2) on a line through the circle's middle, to the right
    in the picture.
    """
    aim = pole(conic, line)
    direction = aim[:2] - aim[2] * places
    direction /= np.maximum(np.hypot(direction[:, :1], direction[:, 1:]), 1e-12)
    return np.asarray(direction * np.where(direction[:, :1] < 0, -1.0, 1.0))


def _bend(line: Array, points_px: Array, places: Array, wanted: Array) -> Array:
    """Distance (T,) of the paint from the straight line at wanted places along it: a running median, which goes on
    beyond the measured points as a parabola through them does.
    """
    size = min(_BEND_POINTS, len(places))
    if size < 3:
        return np.zeros(len(wanted))
    order = np.argsort(places)
    low, high = np.searchsorted(places, (wanted[0], wanted[-1]), sorter=order).tolist()
    order = order[max(0, low - 2 * size) : high + 2 * size]  # medians beyond bear on no wanted place
    ordered = np.stack([places[order], line_distance(line, points_px[order])])
    at, middle = np.lib.stride_tricks.sliding_window_view(ordered, size, axis=1)
    at, middle = at.mean(axis=-1), np.median(middle, axis=-1)
    course = np.polyfit(at, middle, min(2, len(at) - 1))
    beyond = np.polyval(course, wanted) - np.polyval(course, np.clip(wanted, at[0], at[-1]))
    return np.asarray(np.interp(wanted, at, middle) + beyond)


def half_chords(conic: Array, points: Array, directions: Array) -> Array:
    """Half lengths (N,) of the chords through points (N, 2) inside the conic along unit directions (N, 2)."""
    (u, v), (x, y) = directions.T, points.T
    (xx, xy, x1), (_, yy, y1), (_, _, one) = conic.tolist()
    gx, gy = xx * x + xy * y + x1, xy * x + yy * y + y1
    a, b = (xx * u + 2 * xy * v) * u + yy * v * v, u * gx + v * gy
    c = gx * x + gy * y + x1 * x + y1 * y + one
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(b * b - a * c) / np.abs(a))


def measure_contrast(seen: RectifiedLine) -> float:
    """Usual brightness of the halfway line over the surface beside it; where most of it is worn, that of the rest; 0
    where the picture shows no surface beside it.
    """
    outer, paint = np.abs(seen.across) > 2.0 * seen.half_px[1] + 2.0, np.abs(seen.across) <= LINE_PX
    if not outer.any():
        return 0.0
    ground = float(np.median(seen.usual[outer]))
    usual = float(seen.usual[paint].max()) - ground
    left = float(np.quantile(seen.values[:, paint] + seen.usual[paint], _UNWORN, axis=0).max()) - ground
    return usual if usual >= _MOSTLY_WORN * left else left


def disc_coverage(t: Rows, s: Rows, b: float, a: float, blur_px: float) -> Array:
    """Coverage of an ellipse with half axes ``b`` along t and ``a`` along s, its edge softened by the blur."""
    steps = np.linspace(-2.0, 2.0, 7)
    fine, weight = steps * blur_px, np.exp(-0.5 * steps**2)
    spread = (t[..., None, None] - fine[:, None]) / b, (s[..., None, None] - fine) / a
    inside = spread[0] ** 2 + spread[1] ** 2 <= 1.0
    return np.asarray((inside * (weight[:, None] * weight)).sum(axis=(-1, -2)) / weight.sum() ** 2)
