"""The centre mark: a painted disc on the halfway line, seen as the circle itself is seen, only smaller.

The picture is resampled along the halfway line and along the field's other axis, whose image at any point of a
diameter runs towards the diameter's pole. There the disc is symmetric about the line however the line runs in the
picture, and the circle gives its size, so it is found by a matched filter of known shape on both sides of the line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from circlecal.geometry.projective import Array, Mask
from circlecal.paint.profiles import GrayPicture
from circlecal.paint.rectified_line import (
    AROUND_PX,
    STEP_PX,
    RectifiedLine,
    disc_coverage,
    measure_contrast,
    rectify_line,
)

__all__ = ["LEAST_LINE", "SeenMark", "find_centre_mark"]

# Tuned on 330 circles of 40 real and 290 rendered frames, a quarter of these with a player over the mark or no mark:
# 185 marks are found, all within 4 px at 1920 px width of their place (median 0.12). Right and wrong below are marks
# found besides, or no more, when the constant alone is changed; one without such figures changes none by +-20 %.
_FAINTEST = 0.02
"""Of the line's contrast: scatter is never less. At 0.05 9 right fewer, at 0.005 one more."""
LEAST_LINE = 6.0
"""Brightness of the line over the ground, grey levels: where it shows less it is worn off, and nothing tells a disc
from the ground's unevenness, since its scatter is measured by that alone. Of 138 marks of rendered worn lines and of
real frames the faintest right ones lie on lines of 16 and 24 levels; a wrong one, which left the camera 53 px off, lay
on a line of 1.5.
"""
_HIDDEN = 0.25
"""Of the line's contrast: what is darker than the ground by this hides the line; worn paint does not. Without it 2
wrong more, a player over the mark and worn paint; at 0.1 one right fewer.
"""
_FADED = 0.5
"""Of its own brightness: what is left of a disc just beyond its edge. At 1.0 2 wrong more, at 0.25 5 right fewer."""
_BRIGHTEST = 1.0
"""Of the brightness of the line's paint where the disc lies on it, which is the disc's own: its rim shows no more, and
less where blur mixes it with the ground. Of 614 right marks of rendered frames it shows 0.1 to 0.59, of real ones up
to 0.84; of a piece of bare ground beside a line that is worn off, taken for a mark 8 px off, more than there is.
"""
_BALL, _BALL_QUANTILE = 1.25, 0.95
"""Times the brightness of the line's own paint, which is this quantile of it along the line: where the line shows more
beside a disc whose other half something still brighter hides, that is a ball on the line, and the disc its rim. Marks
that a player touches or hides a half of have 0.99 to 1.19, a ball on a real robots' field 1.5, which left a camera 173
px off.
"""
_ROUND_HALVES, _ROUNDED = (0.65, 0.9), 1.5
"""Radii of a ball, in half axes of the disc across the line: those of a child's and of a usual ball beside a pitch's
mark; and times the disc's half axis along the line that they must be for the shapes to differ.
"""
_BALL_MISFIT = 0.6
"""Share of the brightness beside the line that the shape of a ball leaves unexplained at most, where it explains more
than the mark's: 0.11 to 0.41 of ten balls that lie on the mark at a kick-off, of which the mark's shape leaves 0.14 to
0.54, while of 31 clean marks a ball's leaves more than the mark's in all but one, whose place nothing explains well.
Of 30 other rendered kick-offs 21 cameras were within 5 px and one 24 px off with balls taken for marks; without them 23
are, and none is more than 6 px off.
"""
_ASIDE_RADII = 2.0
"""Beside the disc, out to so many of its half axes, the surface is bare; players may stand beyond. At 3.0 one wrong
more.
"""
_INNERMOST = 0.75
"""Of the disc's half axis: beyond it, at least, the disc is looked for. At 1.0 3 right fewer, at 0.6 one wrong more."""
_LARGE_SHARE = 0.1
"""Of the searched stretch: by the templates' sizes a robot's disc covers 0.15 of it, a pitch's 0.06."""
_SIGMA_FLOOR_PX = 0.3
"""Pixels; painted marks are no exact discs."""
_ON_BOTH_SIDES = 0.65
"""Of the least signal to noise ratio, where the disc is seen on both sides: of 85 rendered frames whose mark is hidden
or out of view none shows one above it, of 52 whose mark was missed eight do.
"""


@dataclass(frozen=True, slots=True)
class SeenMark:
    """Position (2,) on the halfway line, its standard deviation in px, and its signal to noise ratio."""

    point_px: Array
    sigma_px: float
    snr: float


def find_centre_mark(
    picture: GrayPicture,
    line: Array,
    line_points_px: Array,
    conic: Array,
    diameter_radii: float,
    width_radii: float,
    blur_px: float,
    offset: tuple[float, float],
    minimum_snr: float,
) -> SeenMark | None:
    """Find the disc on the halfway line inside the circle.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        GrayPicture; the marking is lighter than the surface.
    line : (3,) array
        Halfway line, px.
    line_points_px : (N, 2) array
        Measured middle of its paint, which lens and crown bend away from the straight line.
    conic : (3, 3) array
        Image of the circle.
    diameter_radii, width_radii : float
        Diameter of the disc and width of the halfway line, in radii of the circle.
    blur_px : float
        Standard deviation of the picture's blur.
    offset : (float, float)
        Where the disc may lie: half chords beyond the chord's middle, towards the far side.
    minimum_snr : float

    Returns
    -------
    SeenMark or None
        None where no such disc is seen.
    """
    seen = rectify_line(picture, line, line_points_px, conic, diameter_radii / 2, blur_px, offset)
    if seen is None:
        return None
    paint = 0.5 * width_radii / (diameter_radii / 2) * seen.half_px[1]
    inner = min(paint + blur_px, _INNERMOST * seen.half_px[1])
    contrast = measure_contrast(seen)
    left, right = (_response(seen, blur_px, inner, side) for side in (-1.0, 1.0))
    if contrast < LEAST_LINE:
        return None
    response = _join_sides(left, right)
    allowed = (seen.position >= offset[0] * seen.length) & (seen.position <= offset[1] * seen.length)
    peak = int(np.argmax(np.where(allowed, response, -np.inf)))
    if not 1 <= peak < len(response) - 1 or not allowed[peak - 1 : peak + 2].all():
        return None
    reach = 2.0 * (seen.half_px[0] + blur_px) + 1.0
    elsewhere = np.abs(seen.position - seen.position[peak]) > reach
    if np.count_nonzero(elsewhere) < 16:
        return None
    # what lies on one side only is negative here, so the usual scatter is read off the positive end, below what the
    # players on the line add to it
    scatter = max(float(np.quantile(response[elsewhere], 0.84)), 0.0) / 0.994 + _FAINTEST * contrast
    snr = float(response[peak]) / scatter
    if snr < _ON_BOTH_SIDES * minimum_snr:
        return None
    sides = _bare_sides(seen, peak, blur_px, inner, contrast)
    if not (all(sides) if snr < minimum_snr else any(sides)):
        return None
    if _looks_like_ball(seen, peak, blur_px, inner, sides):
        return None
    shown = sum(side.contrast for side, bare in zip((left, right), sides, strict=True) if bare)
    place = _peak_position(seen.position, np.asarray(shown), peak)
    sigma = float(np.hypot(_SIGMA_FLOOR_PX, (seen.half_px[0] + blur_px) / snr))
    point = np.array([np.interp(place, seen.position, seen.base[:, axis]) for axis in range(2)])
    return SeenMark(point, sigma, snr)


@dataclass(frozen=True, slots=True)
class _Response:
    """Contrast (T,) of a disc centred at each row on one side of the line, and for which rows (T,) the picture shows
    all that this compares.
    """

    contrast: Array
    is_whole: Mask


def _join_sides(left: _Response, right: _Response) -> Array:
    """Contrast (T,) of a disc that is seen on both sides of the line, or on one at the picture's border; none where
    the border cuts both.
    """
    sides = (np.where(side.is_whole, side.contrast, np.inf) for side in (left, right))
    response = np.minimum(*sides)
    return np.where(np.isinf(response), 0.0, response)


def _response(seen: RectifiedLine, blur_px: float, inner_px: float, side: float) -> _Response:
    """Contrast of a disc centred at each row, measured on one side of the line beyond its paint."""
    b, a = seen.half_px
    shown = seen.in_view[0 if side < 0 else 1]
    distance = side * seen.across
    used = (distance > min(inner_px, a)) & (distance <= a + 1.5 * blur_px)
    beyond = (distance > a + 1.5 * blur_px + 1.0) & (distance <= 3.0 * a + 8.0)
    if not (shown.any() and used.any() and beyond.any()):
        return _Response(np.zeros(len(shown)), np.zeros(len(shown), np.bool_))
    surface = seen.values[shown][:, beyond]
    surface = (np.nanmean if np.isnan(surface).any() else np.mean)(surface, axis=1, keepdims=True)
    values = np.zeros((len(shown), np.count_nonzero(used)), np.float32)
    values[shown] = seen.values[shown][:, used] - surface
    half = int(np.ceil((2.0 * b + 2.0 * blur_px + 2.0) / STEP_PX))
    t = np.arange(half + 1)[:, None] * STEP_PX
    disc = disc_coverage(t, distance[used][None], b, a, blur_px)
    disc = np.concatenate([disc[:0:-1], disc])
    kernel = disc - disc.mean(axis=0)  # a change of the surface along the line has no response
    covered = float(np.maximum(kernel, 0.0).sum())
    if covered == 0.0:  # the disc reaches none of what is measured
        return _Response(np.zeros(len(shown)), np.zeros(len(shown), np.bool_))
    kernel /= covered  # the response is a mean brightness: never more than the paint's
    mirrored = np.arange(-half, len(values) + half) % (2 * len(values))
    padded = values[np.minimum(mirrored, 2 * len(values) - 1 - mirrored)]
    response = cv2.matchTemplate(padded, kernel.astype(np.float32), cv2.TM_CCORR)[:, 0]
    is_cut = cv2.dilate((~shown[:, None]).astype(np.uint8), np.ones((2 * half + 1, 1), np.uint8))[:, 0] > 0
    return _Response(np.asarray(response, np.float64), ~is_cut)


def _bare_sides(
    seen: RectifiedLine, peak: int, blur_px: float, inner_px: float, line_contrast: float
) -> tuple[bool, bool]:
    """On which sides of the line the disc ends where it should, with the line and the bare surface around it.

    A player may stand beside the disc, or cover its one half, if the other half is beyond doubt; a ball on the line is
    brighter than its paint, and its rim may look like half a disc.
    """
    b, a = float(seen.halves_px[peak, 0]), seen.half_px[1]
    values = seen.values
    rise = seen.position - seen.position[peak]
    edge = b + 1.5 * blur_px
    on = np.abs(rise) <= max(b, STEP_PX)
    beyond = [(side * rise > edge) & (side * rise <= edge + AROUND_PX) for side in (-1.0, 1.0)]
    if not all(rows.any() for rows in beyond):
        return False, False
    is_large = np.count_nonzero(on) > _LARGE_SHARE * len(on)
    shown, lit, bare = np.zeros((2, 3)), np.zeros((2, 3)), []
    for place, side in enumerate((-1.0, 1.0)):
        beside = side * seen.across
        rim = a + 1.5 * blur_px + 1.0
        disc = (beside > inner_px) & (beside <= a + blur_px)
        aside = (beside > rim) & (beside <= max(_ASIDE_RADII * a, rim + 2.0 * AROUND_PX))
        lit[place] = [_median_level(values[rows][:, aside]) for rows in (on, *beyond)]
        is_shown = bool(seen.in_view[place, on | beyond[0] | beyond[1]].all())
        is_bare = is_shown and bool(abs(lit[place, 0]) <= _FADED * line_contrast)
        # what a large disc adds is added to the ground beside it, which is as uneven as worn paint is faint
        level = lit[place, 0] if is_bare and is_large else 0.0
        lit[place, 0] -= level
        shown[place] = [float(values[rows][:, disc].mean()) for rows in (on, *beyond)]
        shown[place, 0] -= level
        bare.append(is_bare)
    if not any(bare):
        return False, False
    paint = _measure_line(seen, (on, *beyond), bare, a + 1.5 * blur_px + 1.0)
    if paint.darkest < -_HIDDEN * line_contrast:
        return False, False
    covers = [not is_bare and beside[0] > paint.on_disc for is_bare, beside in zip(bare, lit, strict=True)]
    if any(covers) and paint.on_disc > _BALL * paint.elsewhere:
        return False, False
    sides, shown = _tell_sides(shown, lit, bare, _FADED * line_contrast)
    most = _BRIGHTEST * paint.on_disc
    return sides[0] and bool(shown[0, 0] <= most), sides[1] and bool(shown[1, 0] <= most)


def _tell_sides(shown: Array, lit: Array, bare: Sequence[bool], most: float) -> tuple[tuple[bool, bool], Array]:
    """On which sides of the line the disc ends, and by what is brighter (2, 3) on it, above and below it; ``lit``
    (2, 3) is how bright the ground beside these is, at most ``most`` where nothing stands on it.
    """
    sides = _ending_sides(shown, bare)
    if any(sides):
        return sides, shown
    if all(bare):
        # shade that crosses the line dims the ground beside the disc as it dims the disc
        both = _ending_sides(shown - lit, bare)
        if all(both):
            return both, shown - lit
    # somebody may stand above or below the disc's one half
    clear = [is_bare and bool(np.abs(around).max() <= most) for is_bare, around in zip(bare, lit, strict=True)]
    return _ending_sides(shown, clear), shown


def _median_level(values: Array) -> float:
    """Median of what is known of brightnesses; none where nothing is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _ending_sides(shown: Array, bare: Sequence[bool]) -> tuple[bool, bool]:
    """On which sides of the line the disc ends, by what is brighter (2, 3) on it, above and below it, where these are
    bare; none where a bare one shows something else.
    """
    halves = [_fades_beyond(half, _FADED) for half in shown]
    if all(bare) and _fades_beyond(shown.sum(axis=0), _FADED) and all(_fades_beyond(half, 1.0) for half in shown):
        # of worn paint no half may be clear of the ground's unevenness by itself
        halves = [True, True]
    if not any(half and clear for half, clear in zip(halves, bare, strict=True)):
        return False, False
    if not all(half or not clear for half, clear in zip(halves, bare, strict=True)):
        return False, False
    return halves[0], halves[1]


@dataclass(frozen=True, slots=True)
class _LinePaint:
    """How much brighter the line is than the bare ground beside it: where a disc lies on it, at its darkest place there
    and around it, and where its paint shows best farther away, grey levels.
    """

    on_disc: float
    darkest: float
    elsewhere: float


def _measure_line(seen: RectifiedLine, parts: Sequence[Mask], bare: Sequence[bool], rim_px: float) -> _LinePaint:
    """The line on parts (T,) of it, of which the disc covers the first. Where it is darker than the ground something
    stands there, while worn paint only leaves the ground.
    """
    values = seen.values + seen.usual
    sides = [side * seen.across > rim_px for side, is_bare in zip((-1.0, 1.0), bare, strict=True) if is_bare]
    ground, paint = np.logical_or.reduce(sides), np.abs(seen.across) <= 1.0
    levels = [float(np.nanmedian(values[rows][:, ground])) for rows in parts]
    darkest = [values[rows][:, paint].mean(axis=1).min() - level for rows, level in zip(parts, levels, strict=True)]
    away = ~np.logical_or.reduce(parts)
    shown = float(np.quantile(values[away][:, paint].mean(axis=1), _BALL_QUANTILE)) if away.any() else np.inf
    on_disc = float(np.median(values[parts[0]][:, paint])) - levels[0]
    return _LinePaint(on_disc, float(min(darkest)), shown - levels[0])


def _fades_beyond(shown: Array, faded: float) -> bool:
    """Whether what is brighter (3,) on a disc, above and below it, is no more than a share as bright beyond the disc.

    Brightness that goes on is a player; shade beside the disc dims it too, and may be as deep as it is bright.
    """
    here, *around = shown.tolist()
    return bool(max(around) <= faded * here and min(around) >= -here)


def _looks_like_ball(seen: RectifiedLine, peak: int, blur_px: float, inner_px: float, sides: tuple[bool, bool]) -> bool:
    """Whether what is seen beside the line, on the sides where the disc ends, is rather round than foreshortened as the
    field is: a ball at a kick-off hides the mark, and is seen above its place.
    """
    b, a = seen.halves_px[peak].tolist()
    radii = [share * a for share in _ROUND_HALVES if share * a >= _ROUNDED * b]
    if not radii:
        return False
    step = np.rint((seen.position - seen.position[peak]) / STEP_PX).astype(int)
    reach = round((2.0 * max(b, *radii) + 2.0 * blur_px + 3.0) / STEP_PX)
    beside = np.where(seen.across < 0, sides[0], sides[1]) & (np.abs(seen.across) > inner_px)
    columns = beside & (np.abs(seen.across) <= a + 1.5 * blur_px)
    values = seen.values[:, columns]
    rows = (np.abs(step) <= reach) & np.isfinite(values).all(axis=1)
    values, step = values[rows], step[rows]
    if not columns.any() or np.ptp(values) == 0.0:
        return False
    # rows farther away than any shift
    along, across = np.arange(-2 * reach, 2 * reach + 1)[:, None] * STEP_PX, seen.across[columns][None]
    mark = disc_coverage(along, across, b, a, blur_px)
    balls = [ndtr((radius - seen.distance_px(along, across)) / blur_px) for radius in radii]
    least, *rounder = (_least_misfit(values, step, shape) for shape in (mark, *balls))
    return min(rounder) < min(least, _BALL_MISFIT)


def _least_misfit(values: Array, step: NDArray[np.int_], shape: Array) -> float:
    """Share of the variance of brightnesses (T, S) that a light shape (4 K + 1, S) leaves where it fits best, at most K
    / 2 rows along the line away from its middle, from which ``step`` (T,) counts the rows.
    """
    middle = len(shape) // 2
    shifts = np.arange(-(middle // 4), middle // 4 + 1)
    moved = shape[middle + step - shifts[:, None]]
    moved = moved - moved.mean(axis=(1, 2), keepdims=True)
    about = values - values.mean()
    size = np.sqrt((moved**2).sum(axis=(1, 2)) * (about**2).sum())
    alike = (moved * about).sum(axis=(1, 2)) / np.maximum(size, 1e-12)
    return 1.0 - float(np.max(alike, initial=0.0)) ** 2


def _peak_position(position: Array, response: Array, peak: int) -> float:
    """Place of the maximum nearest to a row, between the rows by a parabola."""
    low = max(1, peak - 3)
    top = low + int(np.argmax(response[low : min(len(response) - 1, peak + 4)]))
    before, here, after = response[top - 1 : top + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(position[top] + np.clip(shift, -1.0, 1.0) * STEP_PX)
