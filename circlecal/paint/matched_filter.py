"""How much of a curve is painted, from many weak samples: faint and worn paint shows in their sum, not in each.

A matched filter (the paint's width against both sides) is averaged over each sector of the curve; where the curve is
painted the average stands out from those of the same curve moved inwards and outwards, which show the surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.medians import median_of_rows, upper_median
from circlecal.geometry.projective import Array
from circlecal.paint.profiles import sample_profiles

SECTORS, SAMPLES = 24, 30
"""Of the whole curve, and places in each."""
EVEN_ANGLES: Array = (np.arange(SECTORS * SAMPLES, dtype=np.float64) + 0.5) * (2 * np.pi / (SECTORS * SAMPLES))
"""Angles, rad, of the places about the centre of a circle."""
CLEAR = 3.0
"""A sector is painted from so many standard deviations on."""
LEAST_WIDTH_PX = 2.0
"""Blur makes narrower paint this wide, pixels at 1920 px width."""
TAPS, REACH = 4, 12.0
"""Samples across per width of the paint, and how far the curve is moved, in those widths."""
AT_CURVE, OFF_CURVE = 1.0, 3.0
"""Widths from the curve within which the paint lies, and from which on there is only the surface."""
FLOOR = 0.3
"""Least scatter of an average, grey levels."""
CLIPPED = 4.0
"""Single responses count up to so many times the usual one: players and captions are outliers."""
WIDTH_RADII = 0.013
"""Usual width of the paint in radii of its circle."""


def measure_sectors(picture: NDArray[np.uint8], places: Array, widths: Array) -> Array:
    """By how many standard deviations paint stands out in each sector of a curve that the picture shows.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    places : (SECTORS * SAMPLES, 2) array
        Along the curve, in order, px.
    widths : (SECTORS * SAMPLES, 2) array
        Normals there, as long as the paint is wide.

    Returns
    -------
    (K,) array
        At most :data:`SECTORS` of them, in order: those of which the picture shows half.
    """
    offsets = np.arange(-REACH, REACH + 0.5 / TAPS, 1.0 / TAPS)
    # whole rows of places, one for each shift across the curve
    response = _ridge_response(sample_profiles(picture, places, widths, offsets).T)
    shift = offsets[2 * TAPS : -2 * TAPS]
    inside = np.asarray(np.isfinite(response).all(axis=0), np.bool_)
    # shifts by a share of the paint's width say the same
    usual = CLIPPED * upper_median(np.abs(response[::TAPS, inside]).ravel()) if inside.any() else CLIPPED
    response = np.minimum(np.maximum(response if inside.all() else np.where(inside, response, 0.0), -usual), usual)
    count = inside.reshape(SECTORS, SAMPLES).sum(axis=1)
    shown = 2 * count >= SAMPLES
    mean = response.reshape(-1, SECTORS, SAMPLES).sum(axis=2)[:, shown] / count[shown]
    surface = mean[np.abs(shift) >= OFF_CURVE]
    level = median_of_rows(surface)
    scatter = 1.4826 * median_of_rows(np.abs(surface - level)) + FLOOR
    return np.asarray((mean[np.abs(shift) <= AT_CURVE].max(axis=0) - level) / scatter)


def measure_painted_share(picture: NDArray[np.uint8], ellipse: Ellipse | None, sign: float) -> tuple[float, int]:
    """Share of the sectors of an ellipse that are painted, and how many the picture shows.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness.
    ellipse : Ellipse or None
        Middle of the paint; None has no sectors.
    sign : float
        +1 for light paint, -1 for dark paint.
    """
    if ellipse is None:
        return 0.0, 0
    places, normals = ellipse.points_and_normals(EVEN_ANGLES)
    reach = np.abs(((places - ellipse.center) * normals).sum(axis=-1))
    width = np.maximum(WIDTH_RADII * reach, LEAST_WIDTH_PX * picture.shape[1] / 1920.0)
    sectors = measure_sectors(picture if sign > 0 else ~picture, places, width[:, None] * normals)
    return (float(np.mean(sectors > CLEAR)) if len(sectors) else 0.0), len(sectors)


def paint_and_sides(profiles: NDArray[np.floating[Any]]) -> tuple[Array, Array, Array]:
    """Means over the paint's width left of a place, on it and right of it, (..., S - 4 TAPS) each.

    Parameters
    ----------
    profiles : (..., S) array
        Across the paint, :data:`TAPS` samples per width of it; the places are the samples but the first and last
        2 TAPS.
    """
    rows = np.moveaxis(profiles.astype(np.float64), -1, 0)
    left, middle, right = (np.moveaxis(part, 0, -1) for part in _paint_and_sides_of_rows(rows))
    return left, middle, right


def _paint_and_sides_of_rows(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Means of TAPS rows (S, ...) left of a place, on it and right of it, (S - 4 TAPS, ...) each."""
    last = len(rows) - TAPS + 1
    means = rows[:last] / TAPS
    for k in range(1, TAPS):
        means += rows[k : last + k] / TAPS
    size = len(rows) - 4 * TAPS
    # half a width of blur lies between the paint and the surface that it is compared with
    left, middle, right = (means[start : start + size] for start in (0, 3 * TAPS // 2, 3 * TAPS))
    return left, middle, right


def _ridge_response(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean over the paint's width less the lighter one of both sides (S - 4 TAPS, N), from rows (S, N) of samples."""
    left, middle, right = _paint_and_sides_of_rows(rows)
    return np.asarray(middle - np.maximum(left, right))
