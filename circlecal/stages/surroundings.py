"""Whether the ground that a picture shows can be that of a camera: field where it must be, none above the horizon or
far beyond the border, and one picture, not several put together.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.marking_places import lie_on_surface
from circlecal.line_naming.on_field import INSIDE_SIGMAS, half_field, is_surely_inside, to_ground
from circlecal.paint.roughness import measure_roughness
from circlecal.results import CameraFit, MarkingMask, Surroundings

__all__ = ["measure_surroundings"]

RUN_OFF_M = 10.0
"""Playing surface reaches no further beyond the border than this, metres, unless there is another field beside it."""
IN_FRONT_M = 3.0
"""Ground that lies so far off the field on the camera's side is none of it, metres."""
COLUMNS, FIELD_EVERY = 48, 4
"""Of the grid of places at which the surface is looked at; every so many of those that show it tell how rough it is."""
LEAST_OFF_SURFACE = 0.04
"""Share of the picture off the surface below which nothing is asked: players and captions."""
FEWEST_COLOURS, COLOUR_PERCENTILES, COLOUR_LEVELS = 40, (2.0, 98.0), 3.0
"""Places of the field from which on its colours are known, percentiles between which these are, and levels of a and b
(8 bits, CIE Lab) by which other grass may differ: the sky over a dark rendered field does by 11, seats by 8 to 15.
"""
ROUGH_TIMES, ROUGH_LEVELS = 4.0, 3.0
"""What is so many times rougher than the field, and so many gray levels, is no bare field: crowd, boards, letters."""
SEAT_TIMES, SEAT_LEVELS, FEWEST_SEATS = 3.0, 1.0, 0.05
"""What has the field's colour where no field can be, in more than the third as a share of the picture, and is so many
times rougher than most of the field, and so many gray levels, is green seats: those of a rendered frame are 4 to 27
times as rough, playing surface in the wrong place of six pictures that were put together 0.7 to 2.5 times.
"""
PARAPET_SHARE = 0.2
"""Share of what is seen before the field that is rough, below which it is a parapet or a roof under the camera: of a
right answer behind a parapet 0.03, of pictures whose halves were exchanged, with crowds there, 0.36 and 0.8.
"""
STEP_TIMES, STEP_LEVELS = 2, 2
"""A step from one row to the next stands out when it is so many times as high as those beside it, and so many gray
levels more: lenses and scaling spread what a camera sees over several pixels.
"""
STEP_SAMPLES, STEP_BLOCKS, STEP_SHARE = 256, 32, 0.3
"""Places along a row at which steps are looked at, blocks of them, and share of a block that steps where a seam is: in
smooth places nothing stands out on either side of it.
"""
MARGIN = 0.2
"""Nearer to the picture's border than this share of its size, a step is that of a caption's bar."""
PLAIN_LEVELS, PLAIN_ROWS = 1.5, 4
"""Standard deviation of a block of a row, gray levels, mean of so many rows on one side of the step, that is that of a
caption, a bar or a railing: cameras see rougher things. Single rows of a plain railing have 1.3 to 2.5 by the noise
alone.
"""
GOES_ON, LEAST_ALIKE = 0.5, 0.3
"""Correlation of the detail in both rows that meet in a step, over that of the rows beside them, and by itself, from
which on what is seen goes on behind the step, as the ground does behind a shadow's edge: there it has 0.7 and 1.1 of
it, 0.4 and 0.9 by itself; where quarters of pictures were exchanged at most 0.25 of it (12 rendered frames).
"""
WHOLE_SHARE = 0.9
"""Share of a row's blocks that step, from which on it is a seam however plain one side is: the roof of a stand is as
plain as a caption, but beside the half of a picture it has one edge only.
"""
ALONE_SHARE, CAPTION_SHARE = 0.5, 0.3
"""A seam stands out so much that no other row has more than this share of its steps: a caption has two edges, and
interlaced or scaled pictures step in many rows. Steps near the picture's border count, too, where a caption may begin
that is so high, or wide, as a share of the picture.
"""


def measure_surroundings(
    picture: NDArray[np.uint8],
    mask: MarkingMask,
    fit: CameraFit,
    template: FieldTemplate,
    covered: Mask | None = None,
    image_bgr: NDArray[np.uint8] | None = None,
) -> Surroundings:
    """Compare the ground in a picture with what a camera says of it.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness.
    mask : MarkingMask
        With the playing surface; without it only seams are looked for.
    fit : CameraFit
        The camera with its covariance.
    template : FieldTemplate
        The field.
    covered : (H, W) bool, optional
        What graphics cover, along which other pictures may meet.
    image_bgr : (H, W, 3) uint8, optional
        The picture in colour: what is coloured otherwise than the field is none of it, such as seats and the sky over a
        picture so dark that all of it was taken for one surface.
    """
    seam = _seam_share(picture, covered)
    if mask.field_region is None:
        return Surroundings(0.0, 0.0, 0.0, 0.0, seam)
    height, width = picture.shape
    step = width / COLUMNS
    x, y = (np.arange(0.5 * step, size, step) for size in (width, height))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    surface = lie_on_surface(places, mask.field_region, width, height)
    ground, sigma = to_ground(fit.view, places)
    half = half_field(fit.view, template)
    inside = is_surely_inside(ground, sigma, half)
    is_ground = np.asarray(np.isfinite(ground).all(axis=1))
    ground, sigma = np.where(is_ground[:, None], ground, 0.0), np.where(is_ground, sigma, 0.0)
    off = ground - np.clip(ground, -half, half)
    beyond = is_ground & (np.abs(off).max(axis=1) - INSIDE_SIGMAS * sigma > RUN_OFF_M)
    towards = (off * (fit.camera.position_m[:2] - (ground - off))).sum(axis=1)
    in_front = is_ground & (towards > 0.0) & (np.hypot(off[:, 0], off[:, 1]) > IN_FRONT_M)
    elsewhere = surface & (beyond | ~is_ground)
    if image_bgr is not None and elsewhere.any():
        elsewhere &= _are_coloured_alike(image_bgr, inside & surface, (len(x), len(y)))
    if np.mean(elsewhere) > FEWEST_SEATS:
        elsewhere &= ~_are_rough(picture, places, inside & surface, elsewhere, SEAT_TIMES, SEAT_LEVELS)
    above = elsewhere & ~is_ground
    if template.ground != "grass":
        above &= _joins(inside, surface.reshape(len(y), len(x)))
    is_rough = _find_rough(picture, places, surface, inside, inside | in_front)
    return Surroundings(
        rough_share=float(np.count_nonzero(inside & is_rough) / max(int(np.count_nonzero(inside)), 1)),
        above_share=float(np.mean(above)),
        beyond_share=float(np.mean(elsewhere & beyond)),
        near_share=_near_share(in_front & ~surface, is_rough),
        seam_share=seam,
    )


def _are_coloured_alike(image_bgr: NDArray[np.uint8], field: Mask, size: tuple[int, int]) -> Mask:
    """Which places (N,) of a grid of this size (columns, rows) have a colour that places (N,) of the field have; all
    of them where the field shows too few. In a picture without colours they are compared by their brightness: 41 of 44
    real frames that are calibrated in colour are so in gray, 36 where all of a gray picture counts as one surface.
    """
    if np.count_nonzero(field) < FEWEST_COLOURS:
        return np.ones(len(field), np.bool_)
    # area averaging is several times as fast by two as by what is no whole number
    half = cv2.resize(image_bgr, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    cells = cv2.resize(half, size, interpolation=cv2.INTER_AREA)
    lightness, colour = np.split(cv2.cvtColor(cells, cv2.COLOR_BGR2LAB).reshape(-1, 3).astype(np.float64), [1], axis=1)
    if np.ptp(np.percentile(colour, COLOUR_PERCENTILES, axis=0), axis=0).max() <= COLOUR_LEVELS:
        colour = lightness
    low, high = np.percentile(colour[field], COLOUR_PERCENTILES, axis=0)
    return np.asarray(((colour >= low - COLOUR_LEVELS) & (colour <= high + COLOUR_LEVELS)).all(axis=1), np.bool_)


def _near_share(before: Mask, is_rough: Mask) -> float:
    """Share of places (N,) before the field that are none; none of them where nearly all are plain."""
    share = float(np.mean(before))
    return share if float(np.mean(before & is_rough)) > PARAPET_SHARE * share else 0.0


def _joins(inside: Mask, surface: Mask) -> Mask:
    """Which places (N,) belong to a piece of the surface (H, W) that reaches where the field surely is (N,).

    Ceilings have a floor's colour, not grass's, and walls between them and the floor.
    """
    pieces = cv2.connectedComponents(surface.astype(np.uint8))[1].ravel()
    return np.asarray((pieces > 0) & np.isin(pieces, pieces[inside]), np.bool_)


def _find_rough(picture: NDArray[np.uint8], places: Array, surface: Mask, inside: Mask, asked: Mask) -> Mask:
    """Which of the places (N, 2) that are asked for (N,) are no playing surface but as rough as a crowd."""
    if np.count_nonzero(~surface) < LEAST_OFF_SURFACE * len(places):
        return np.zeros(len(places), np.bool_)
    return _are_rough(picture, places, inside & surface, asked & ~surface, ROUGH_TIMES, ROUGH_LEVELS)


def _are_rough(
    picture: NDArray[np.uint8], places: Array, field: Mask, asked: Mask, times: float, levels: float
) -> Mask:
    """Which of the places (N, 2) that are asked for (N,) are so many times rougher than most of those of the field
    (N,), and so many gray levels; none where no field shows.
    """
    rough = np.zeros(len(places), np.bool_)
    if field.any():
        usual = float(np.median(measure_roughness(picture, places[field][::FIELD_EVERY])))
        rough[asked] = measure_roughness(picture, places[asked]) > times * usual + levels
    return rough


def _seam_share(picture: NDArray[np.uint8], covered: Mask | None) -> float:
    """Share of the picture's width or height over which two rows or columns meet as no lens would let them."""
    height, width = picture.shape
    every_column, every_row = np.s_[:, :: max(width // STEP_SAMPLES, 1)], np.s_[:: max(height // STEP_SAMPLES, 1)]
    rows, columns = picture[every_column], np.asarray(cv2.transpose(picture[every_row]), np.uint8)
    if covered is None:
        return max(_worst_seam(rows, None), _worst_seam(columns, None))
    return max(_worst_seam(rows, covered[every_column]), _worst_seam(columns, covered[every_row].T))


def _worst_seam(rows: NDArray[np.uint8], covered: Mask | None) -> float:
    """Largest share of blocks of samples (N, K) that step from one row to the next, away from the border and from what
    graphics cover (N, K), where what is seen does not go on.
    """
    first = int(MARGIN * len(rows))
    if len(rows) - 2 * first < 4 or rows.shape[1] < STEP_BLOCKS:
        return 0.0
    rows = np.ascontiguousarray(rows)
    rise = np.asarray(cv2.absdiff(rows[1:], rows[:-1]), np.uint8)
    # bytes that are full are full on either side: no rise stands out above the highest level
    usual = cv2.convertScaleAbs(np.maximum(rise[:-2], rise[2:]), alpha=STEP_TIMES, beta=STEP_LEVELS)
    stands_out = rise[1:-1] > usual
    if covered is not None:
        stands_out &= ~(covered[1:-2] | covered[2:-1])
    starts = np.arange(STEP_BLOCKS) * rows.shape[1] // STEP_BLOCKS
    size = np.diff(np.append(starts, rows.shape[1]))
    before = np.asarray(cv2.integral(stands_out.view(np.uint8)), np.int32)[:, np.append(starts, rows.shape[1])]
    steps = np.diff(np.diff(before, axis=1), axis=0) > STEP_SHARE * size
    share = steps.mean(axis=1)
    inner = np.zeros(len(share), np.bool_)
    inner[first : len(rows) - first - 3] = True
    worst = int(np.argmax(np.where(inner, share, -1.0)))
    off = np.abs(np.arange(len(share)) - worst)
    others = share[(off > 1) & (inner | (off < CAPTION_SHARE * len(rows)))]
    if others.max(initial=0.0) > ALONE_SHARE * share[worst]:
        return 0.0
    meeting = worst + 2
    sides = np.stack([rows[r : r + PLAIN_ROWS].mean(axis=0) for r in (meeting - PLAIN_ROWS, meeting)])
    power = np.add.reduceat(_take_detail(sides, starts) ** 2, starts, axis=1) / size
    counted = steps[worst] & ((power > PLAIN_LEVELS**2).all(axis=0) | (share[worst] >= WHOLE_SHARE))
    detail = _take_detail(rows[meeting - 2 : meeting + 2].astype(np.float64), starts)
    return 0.0 if _goes_on(detail, starts, counted) else float(np.mean(counted))


def _take_detail(rows: Array, starts: NDArray[np.int_]) -> Array:
    """What rows (M, K) have beside the mean of each of their blocks, which begin at columns (N,)."""
    size = np.diff(np.append(starts, rows.shape[1]))
    return np.asarray(rows - np.repeat(np.add.reduceat(rows, starts, axis=1) / size, size, axis=1))


def _goes_on(detail: Array, starts: NDArray[np.int_], counted: Mask) -> bool:
    """Whether the detail (4, K) of four rows, in counted blocks (N,) that begin at columns (N,), is as alike on both
    sides of the step in their middle as above and below it.
    """
    if not counted.any():
        return False
    scale = np.sqrt(np.add.reduceat(detail**2, starts, axis=1))
    alike = np.add.reduceat(detail[1:] * detail[:-1], starts, axis=1) / np.maximum(scale[1:] * scale[:-1], 1e-9)
    above, across, below = np.median(alike[:, counted], axis=1)
    return bool(across > max(GOES_ON * 0.5 * (above + below), LEAST_ALIKE))
