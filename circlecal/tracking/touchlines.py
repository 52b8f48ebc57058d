"""How broad the pitch is, by touchlines so thin in the picture that no single place shows their paint.

A line of which a pixel holds a tenth still lightens all of its hundreds of pixels by a tenth of the paint's contrast.
Under a camera whose place is known, the ground beyond a pitch of each width is looked at along whole lines, in all
frames together: where the touchline is, a narrow ridge of about the strength stands that paint of its width has there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import project
from circlecal.geometry.projective import Array
from circlecal.paint.profiles import interpolate
from circlecal.rig.tripod import PLACE, TripodEstimate
from circlecal.tracking.faint_paint import NEXT_SHARE, STRENGTHS, TAP_PX, PaintStrength, rise_of
from circlecal.tracking.frame_paint import HeadedFrame
from circlecal.tracking.looking import LookedAt
from circlecal.tracking.markings import CLEAR_PX_M, MARGIN_PX

COLUMN_M, ROW_M = 0.5, 0.5
"""Steps along a touchline and across it on the ground, metres."""
LEAST_COLUMNS, LEAST_FRAMES = 24, 3
"""Places along a line, on grass, whose median tells its brightness, and frames that must see it."""
LEVEL_PX = 1.0
"""By how much a frame's camera may have a line beside its place, pixels at 1920 px width."""
WIDTH_STEP_M = 0.1
"""Of the widths that are tried, metres."""
BROADEST_M = 5.0
"""Widths, metres, over which a touchline may have more than half of its greatest strength: two pixels are so many at a
far touchline that shows two pixels per metre.
"""
SHOWN, LEAST_SHOWN = 0.3, 0.6
"""Of a frame that shows the line, the least strength; and the share of such frames."""


@dataclass(frozen=True, slots=True)
class _Ridges:
    """How much ridges (W,) along touchlines of a pitch of each width rise above the ground beside them in one frame,
    and how much paint would, gray levels; nan where the frame does not show them.
    """

    rise: Array
    paint: Array


def find_width(
    tripod: TripodEstimate, members: Sequence[HeadedFrame], pictures: Mapping[str, LookedAt], template: FieldTemplate
) -> float | None:
    """Width of the pitch at which its touchlines show, metres; None where no width does, or more than one.

    Parameters
    ----------
    tripod : TripodEstimate
        Before a pitch of any width.
    members : sequence of HeadedFrame
        Its frames.
    pictures : mapping
        Their pictures by name.
    template : FieldTemplate
        With the widths that the rules allow.
    """
    seen = [frame for frame in members if frame.name in pictures]
    if template.width_range_m is None or len(seen) < LEAST_FRAMES:
        return None
    widths = np.arange(template.width_range_m[0], template.width_range_m[1] + WIDTH_STEP_M / 2.0, WIDTH_STEP_M)
    paint = _paint_of(seen, pictures)
    if paint is None:
        return None
    ridges = [
        ridge
        for frame in seen
        for side in (-1.0, 1.0)
        if (ridge := _ridges_of(frame, pictures[frame.name], tripod, template, side, widths, paint))
    ]
    if len(ridges) < LEAST_FRAMES:
        return None
    return _choose_width(widths, np.array([r.rise for r in ridges]), np.array([r.paint for r in ridges]))


def _choose_width(widths: Array, rise: Array, paint: Array) -> float | None:
    """The one width (of W) at which ridges (F, W) have the strength of paint (F, W)."""
    known = np.isfinite(rise)
    count = known.sum(axis=0)
    rise, paint = np.where(known, rise, 0.0), np.where(known, paint, 0.0)
    strength = (rise * paint).sum(axis=0) / np.maximum((paint**2).sum(axis=0), 1e-9)
    strength[count < LEAST_FRAMES] = 0.0
    best = int(np.argmax(strength))
    shown = np.count_nonzero(known[:, best] & (rise[:, best] > SHOWN * paint[:, best])) / max(count[best], 1)
    strong = strength > NEXT_SHARE * strength[best]
    # what else is as strong is another line, or one broad strip
    run = np.flatnonzero(np.diff(strong, prepend=False, append=False))
    is_one = len(run) == 2 and widths[run[1] - 1] - widths[run[0]] < BROADEST_M
    if not is_one or not STRENGTHS[0] < strength[best] < STRENGTHS[1] or shown < LEAST_SHOWN:
        return None
    above = np.where(strong, strength - NEXT_SHARE * strength[best], 0.0)
    return float((above * widths).sum() / above.sum())


def _paint_of(frames: Sequence[HeadedFrame], pictures: Mapping[str, LookedAt]) -> PaintStrength | None:
    """What the paint of the frames' clear markings adds to the ground; None where too little is seen."""
    found = []
    for frame in frames:
        measured, gray = frame.measured, pictures[frame.name].gray
        unit = gray.shape[1] / 1920.0
        reach = (measured.width_px + 2.0 * unit)[:, None] * measured.normals
        around = (measured.points_px + reach * np.array([-1.0, 0.0, 1.0])[:, None, None]).astype(np.float32)
        before, here, after = interpolate(gray, around[..., 0], around[..., 1]).astype(np.float64)
        is_clear = measured.scale_px_m > CLEAR_PX_M * unit
        found.append((here - np.maximum(before, after), measured.width_px, measured.scale_px_m, is_clear))
    contrast, width, scale, is_clear = map(np.concatenate, zip(*found, strict=True))
    return PaintStrength.of(contrast, width, scale, is_clear)


def _ridges_of(
    frame: HeadedFrame,
    picture: LookedAt,
    tripod: TripodEstimate,
    template: FieldTemplate,
    side: float,
    widths: Array,
    paint: PaintStrength,
) -> _Ridges | None:
    """The ridges of one frame along touchlines on one side of the pitch; None where it shows none."""
    unit = tripod.size[0] / 1920.0
    theta = tripod.model.thetas(frame.head[None], tripod.mean)[0]
    half = (template.length_m + float(tripod.mean[PLACE["length"]])) / 2.0 - 1.0
    along = np.arange(-half, half, COLUMN_M)

    def look(y: Array) -> tuple[Array, Array]:
        """Pixels (R, C, 2) of the ground, nan outside the picture."""
        field_m = np.stack(np.meshgrid(along, y), axis=-1)
        seen = project(theta[None], field_m.reshape(1, -1, 2), tripod.model.projection)
        inside = seen.visible[0] & (seen.pixels[0] > MARGIN_PX).all(axis=1)
        inside &= (seen.pixels[0] < np.array(tripod.size) - 1 - MARGIN_PX).all(axis=1)
        pixels = np.where(inside[:, None], seen.pixels[0], np.nan).reshape(*field_m.shape)
        return pixels, np.isfinite(pixels[..., 0])

    y = side * np.arange(widths[0] / 2.0 - 1.0, widths[-1] / 2.0 + 1.0, ROW_M)
    pixels, inside = look(y)
    column = int(np.argmax(inside.sum(axis=0)))
    rows = np.flatnonzero(inside[:, column])
    along = along[inside.any(axis=0)]
    if len(rows) < 4 or len(along) < LEAST_COLUMNS:
        return None
    beside = column + 1 if column + 1 < pixels.shape[1] and inside[rows, column + 1].all() else column - 1
    line = pixels[rows, beside] - pixels[rows, column]
    step = np.diff(pixels[rows, column], axis=0)
    across = np.abs(step[:, 0] * line[1:, 1] - step[:, 1] * line[1:, 0]) / np.maximum(np.hypot(*line[1:].T), 1e-9)
    way = np.concatenate([[0.0], np.cumsum(across)])
    if not np.isfinite(way[-1]):
        return None
    offsets = np.arange(0.0, way[-1], TAP_PX)
    y = np.interp(offsets, way, y[rows])
    profile = _brightness(picture, *look(y))
    rise = np.where(np.isfinite(profile), rise_of(profile[None].astype(np.float32), offsets, unit)[0], np.nan)
    level = int(np.ceil(LEVEL_PX * unit / TAP_PX))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(rise, level, constant_values=np.nan), 2 * level + 1)
    rise = np.where(np.isfinite(rise), np.fmax.reduce(around, axis=1), np.nan)
    scale = TAP_PX / np.maximum(np.abs(np.gradient(y)), 1e-6)
    expected, _ = paint.ridges(scale, (template.marking_width_m + float(tripod.mean[PLACE["width"]])) * scale)
    order = np.argsort(np.abs(y))
    of_widths = 2.0 * np.abs(y)[order]
    return _Ridges(*(np.interp(widths, of_widths, v[order], np.nan, np.nan) for v in (rise, expected)))


def _brightness(picture: LookedAt, pixels: Array, inside: Array) -> Array:
    """Median gray levels (R,) along lines of pixels (R, C, 2) on the grass; nan where too few are."""
    width, height = picture.size
    rows, columns = picture.grass.shape
    x, y = (np.where(inside, pixels[..., k], 0.0) for k in (0, 1))
    at = (y * rows / height).astype(int), (x * columns / width).astype(int)
    on_grass = inside & (picture.grass[at] > 0)
    values = interpolate(picture.gray, x.astype(np.float32), y.astype(np.float32)).astype(np.float64)
    told = on_grass.sum(axis=1) >= LEAST_COLUMNS
    profile = np.full(len(values), np.nan)
    profile[told] = np.nanmedian(np.where(on_grass[told], values[told], np.nan), axis=1)
    return profile
