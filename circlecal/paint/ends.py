"""Where the paint of a straight marking ends in the picture.

A line that runs into another one ends sharply: its contrast falls from a level that it kept for a while to nothing
within its own width, and does not come back. Where it is merely covered it comes back; where it is cut by the border of
the picture nothing follows.
"""

from __future__ import annotations

import numpy as np

from circlecal.geometry.projective import Array, fit_line
from circlecal.observations import LineEnd
from circlecal.paint.profiles import GrayPicture, sample_profiles

PAINT_PX, BESIDE_PX = (-1.0, 0.0, 1.0), (5.0, 7.0, 9.0)
"""Offsets across the marking, pixels at 1920 px width, of its paint and of its surroundings."""
LEVEL, BEFORE, FALL, BEHIND = 80, 16, 3, 9
"""Pixels at 1920 px width: over which the level is taken, that still keep it just before the fall, that the fall takes,
and behind it, where nothing may be left.
"""
SEARCHED, FOUND_AGAIN = 120, 18
"""Pixels at 1920 px width behind the fall in which the marking is looked for, and of a piece of it that counts."""
LOST, LOST_SHARE = 100, 0.3
"""Pixels at 1920 px width over which the marking must keep this share of its level to be followed further."""
LEAST_LEVEL, LEAST_CROSSING = 8.0, 1.5
"""Grey levels by which a marking must stand out, and one that crosses it at its end."""
ASIDE_WIDTHS, LEAST_ASIDE_PX = (3.0, 4.0, 5.0, 6.0, 7.0, 8.0), 1.7
"""How far beside an end a crossing marking must go on, in widths of the paint (at least so wide, pixels at 1920 px
width): from 0.36 to 0.96 m, where a player who stands on the end does not reach.
"""
MOST_SLANT, SLANTS, PASSING_PX, SEEN_ASIDE = 0.35, 29, 6.0, 4
"""Largest slope of it against the normal of the line that ends, how many slopes are tried, how far it may pass by the
end (pixels at 1920 px width), and how many of these places must show it on each side.
"""
UNEVEN = 3.0
"""Times the usual contrast of what crosses an end that a place of it may show at most, and one such part of it at
least: letters on a board are far less even than paint. Of 150 rendered ends on touchlines 146 are as even, of ten
places 7 to 300 px away, where a player's body before a board or a banner ended the paint, four.
"""
BEND_SCALE_PX = 1.5
"""Pixels at 1920 px width from the bend of the marking at which a place counts a quarter for that bend."""
COARSELY = 32
"""Steps at once towards the border of the picture."""
PIECE_SHARE = 0.2
"""Share of a line's length to both sides of a place by which its course there is judged, since the lens bends a long
line: by its own ends a touchline that runs through the whole picture lay 2.3 px beside the end of the halfway line on
it.
"""


def piece_beside(points_px: Array, place_px: Array, along: Array, fewest: int) -> Array:
    """The points (M, 2) of a straight marking (N, 2), which runs along a direction (2,), beside a place (2,); all of
    them where fewer than ``fewest`` lie there.
    """
    way = (points_px - place_px) @ along
    beside = np.abs(way) < PIECE_SHARE * np.ptp(way)
    return points_px[beside] if np.count_nonzero(beside) >= fewest else points_px


def paint_ends(
    picture: GrayPicture, points_px: Array, middle_px: Array, clear_px: float, growth: Array | None = None
) -> tuple[LineEnd, ...]:
    """Ends, at most two, of a straight marking.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    points_px : (N, 2) array
        Points along its middle; they may run on over something else.
    middle_px : (2,) array
        A point on the marking from which its ends are looked for, both ways.
    clear_px : float
        How far from there the marking does not end.
    growth : (3,) array, optional
        Width of its paint: coefficients of x, y and 1, pixels. Without them it is as wide as it must be to be seen.

    Returns
    -------
    tuple of LineEnd
        Where the contrast has fallen to half; empty where the marking is seen to end nowhere in the picture.
    """
    height, width = picture.shape
    unit = max(width / 1920.0, 0.5)
    normal = fit_line(points_px)[:2]
    along = np.array([normal[1], -normal[0]])
    offset = points_px - middle_px
    bend = _bend_near_middle(offset @ along, offset @ normal, unit, clear_px)
    found: list[LineEnd] = []
    for side in (1.0, -1.0):
        t = side * np.arange(max(clear_px - LEVEL * unit, 0.0), float(width + height), unit)
        for step in (COARSELY, 1):  # most of the way lies outside the picture
            sparse = t[::step]
            path = middle_px + sparse[:, None] * along + np.polyval(bend, sparse)[:, None] * normal
            inside = ((path >= 0) & (path <= (width - 1, height - 1))).all(axis=1)
            t = t[: len(t) if inside.all() else int(np.argmin(inside)) * step]
        path = path[: len(t)]
        if len(path) < LEVEL:
            continue
        paint, beside = _brightness(picture, path, normal, unit)
        end = _end(paint - beside.mean(axis=0))
        if end is not None:
            low = int(end)
            point = path[low] + (end - low) * (path[low + 1] - path[low])
            paint_px = max(0.0 if growth is None else float(growth @ [*point, 1.0]), LEAST_ASIDE_PX * unit)
            crossed = _is_crossed(beside, low) and _goes_on_aside(picture, point, side * along, paint_px, unit)
            found.append(LineEnd(point, crossed))
    return tuple(found)


def _bend_near_middle(position: Array, offset: Array, unit: float, clear_px: float) -> Array:
    """Parabola (3,) through the points, as lens and crown bend a marking. The middle is surely painted, and what lies
    behind an end may be longer than the marking: the first fit trusts the middle alone, the others a fixed distance.
    """
    scale = max(float(np.abs(position).max()), 1.0)
    design = np.vander(position / scale, 3)
    weights: Array = 1.0 / (1.0 + (position / max(1.5 * clear_px, unit)) ** 2) ** 2
    coefficients: Array = np.zeros(3)
    for share in (3.0, 1.0, 1.0):
        weighted = design * weights[:, None]
        coefficients = np.asarray(
            np.linalg.lstsq(weighted.T @ design, weighted.T @ offset, rcond=None)[0], dtype=np.float64
        )
        weights = 1.0 / (1.0 + ((offset - design @ coefficients) / (share * BEND_SCALE_PX * unit)) ** 2) ** 2
    return np.asarray(coefficients / np.array([scale * scale, scale, 1.0]))


def _brightness(picture: GrayPicture, path: Array, normal: Array, unit: float) -> tuple[Array, Array]:
    """Of the paint (N,) and of both sides (2, N) along a path, smoothed over three pixels at 1920 px width."""
    offsets = unit * np.array([*(-d for d in BESIDE_PX), *BESIDE_PX, *PAINT_PX])
    profiles = sample_profiles(picture, path, np.broadcast_to(normal, path.shape), offsets)
    profiles[np.isnan(profiles)] = 0.0
    count = len(BESIDE_PX)
    rows = [profiles[:, k : k + count].mean(axis=1) for k in (0, count, 2 * count)]
    left, right, paint = (np.convolve(row, np.full(3, 1.0 / 3.0), mode="same") for row in rows)
    return paint, np.array([left, right])


def _is_crossed(beside: Array, end: int) -> bool:
    """Whether on both sides of the end something brighter lies across than before and behind it."""
    across = beside[:, end - 1 : end + 5].max(axis=1)
    before = np.median(beside[:, max(end - 30, 0) : end - 4], axis=1)
    behind = beside[:, end + 4 : end + 12].min(axis=1)
    return bool((across - np.maximum(before, behind) > LEAST_CROSSING).all())


def _goes_on_aside(picture: GrayPicture, end_px: Array, outward: Array, paint_px: float, unit: float) -> bool:
    """Whether what crosses an end is one straight marking that runs on, on both sides, over more than a player."""
    normal = np.array([-outward[1], outward[0]])
    aside = np.array([*(-w for w in ASIDE_WIDTHS[::-1]), *ASIDE_WIDTHS]) * paint_px
    away = max(BESIDE_PX[1] * unit, paint_px)
    reach = MOST_SLANT * float(aside.max()) + PASSING_PX * unit + away
    along = np.arange(-reach, reach + unit, unit)
    path = end_px + along[:, None] * outward
    rows = sample_profiles(picture, path, np.broadcast_to(normal, path.shape), aside).T
    smooth = np.array([np.convolve(row, np.full(3, 1.0 / 3.0), mode="same") for row in np.nan_to_num(rows)])
    step = round(away / unit)
    # by how much each place is lighter than what lies before it and behind it
    rise = smooth[:, step:-step] - np.maximum(smooth[:, : -2 * step], smooth[:, 2 * step :])
    slopes = np.linspace(-MOST_SLANT, MOST_SLANT, SLANTS)[:, None, None]
    passing = np.arange(-PASSING_PX, PASSING_PX + 1.0)[:, None] * unit
    place = np.rint((slopes * aside + passing + reach - away) / unit).astype(int)
    contrast = rise[np.arange(len(aside)), np.clip(place, 0, rise.shape[1] - 1)]
    usual = np.maximum(np.median(contrast, axis=-1, keepdims=True), LEAST_CROSSING)
    is_seen = (contrast > np.maximum(LEAST_CROSSING, usual / UNEVEN)) & (contrast < UNEVEN * usual)
    half = len(ASIDE_WIDTHS)
    left, right = is_seen[..., :half].sum(axis=-1), is_seen[..., half:].sum(axis=-1)
    return bool(((left >= SEEN_ASIDE) & (right >= SEEN_ASIDE)).any())


def _end(contrast: Array) -> float | None:
    """Index, between samples, at which a contrast (one sample per pixel at 1920 px width) falls for good."""
    n = len(contrast)
    if n < LEVEL + FALL + BEHIND + 1:
        return None
    total = np.concatenate([[0.0], np.cumsum(contrast)])
    index = np.arange(LEVEL, n - FALL - BEHIND)
    usual = (total[index - FALL] - total[index - LEVEL]) / (LEVEL - FALL)
    before = (total[index - FALL] - total[index - BEFORE]) / (BEFORE - FALL)
    behind = (total[index + FALL + BEHIND] - total[index + FALL]) / BEHIND
    half = 0.5 * before
    crossing = (contrast[index - 1] >= half) & (contrast[index] < half)
    falls = crossing & (usual > LEAST_LEVEL) & (before > 0.6 * usual) & (behind < 0.25 * usual)
    ahead = np.minimum(index + LOST, n)
    light = np.concatenate([[0.0], np.cumsum(np.maximum(contrast, 0.0))])
    lost = (usual > LEAST_LEVEL) & (light[ahead] - light[index] < LOST_SHARE * usual * (ahead - index))
    # so much before the marking is gone its share ahead falls below
    last = index[np.argmax(lost)] + LOST_SHARE * LOST + 2 * FALL if lost.any() else n
    for k in np.flatnonzero(falls):
        at = int(index[k])
        if at > last:
            break
        if not _is_resumed(contrast[at + FALL : at + SEARCHED], float(half[k])):
            return at - 1 + float((contrast[at - 1] - half[k]) / max(contrast[at - 1] - contrast[at], 1e-9))
    return None


def _is_resumed(behind: Array, half: float) -> bool:
    """Whether a marking goes on behind a gap, with about its own contrast."""
    alike = (behind > 1.2 * half) & (behind < 3.0 * half)
    run = np.convolve(alike, np.ones(FOUND_AGAIN), mode="valid") if len(alike) >= FOUND_AGAIN else np.zeros(1)
    return bool((run > FOUND_AGAIN - 0.5).any())
