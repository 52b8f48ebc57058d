"""Whether the picture confirms a camera: whether the markings that it puts into view are there (those of a wrong
circle's camera are not), and whether its circle is painted nearly everywhere, however faintly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, project
from circlecal.geometry.projective import Array
from circlecal.line_naming.predicted_markings import PredictedMarkings, predict_markings
from circlecal.paint.bands import measure_curve
from circlecal.paint.matched_filter import CLEAR, EVEN_ANGLES, LEAST_WIDTH_PX, measure_sectors
from circlecal.results import Agreement, CameraFit

__all__ = ["is_circle_painted", "look_for_markings", "measure_circle_sectors"]

SPACING_PX = 4.0
"""Distance of the profiles along a marking, pixels at 1920 px width."""
WELL_KNOWN_PX, LARGEST_SIGMA_PX = 4.0, 10.0
"""Standard deviations, pixels at 1920 px width: where a marking's place is less certain, it is looked for only where
little else is to be expected, or not at all.
"""
ENOUGH_WIDTHS = 0.12
"""So much of well known markings, picture widths, is enough to judge by."""
UNCERTAIN_SHIFTS = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""Standard deviations by which a piece of a marking may be shifted where its place is not well known."""
SHORTEST_WIDTHS = 0.03
"""Shorter parts of a marking, picture widths, are not judged."""
PIECE = 25
"""Places in a row between which contrast and shift of a marking may differ."""
ACROSS_PX, SIGMAS, SIGMAS_BETWEEN = 4.0, 2.0, 0.6
"""Reach of a profile to both sides: pixels at 1920 px width, and standard deviations of the marking's place, fewer
where it is shifted.
"""
THINNEST = 0.2, 0.6
"""Paint must be as wide in the picture as this share of the quantile of the circle's own, which was seen."""
LEAST_SHARE, LEAST_SECTORS = 0.75, 18
"""A circle is painted with this share of its sectors, if the picture shows three quarters of them (no arc of another
marking is as long, and ellipses stitched from other lines and streaks have half of them at most).
"""

_SIZES = ("width", "length", "breadth")


def look_for_markings(
    picture: NDArray[np.uint8],
    fit: CameraFit,
    template: FieldTemplate,
    circle: Circle,
    known: frozenset[str],
    region: NDArray[np.bool_] | None,
    carriers: frozenset[str] | None = None,
) -> Agreement:
    """Look for every marking of the template where the camera puts it, but for those that the camera was fitted to.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    fit : CameraFit
        The camera, with the covariance that says how well each marking's place is known.
    template : FieldTemplate
        The field.
    circle : Circle
        The circle that the camera was fitted to.
    known : frozenset of str
        Markings that it was fitted to beside the circle.
    region : (h, w) bool or None
        The playing surface in a reduced picture.
    carriers : frozenset of str, optional
        Markings whose paint was seen, with which the width of the others' is compared; the circle when None.

    Returns
    -------
    Agreement
    """
    model = fit.model
    unit = model.width / 1920.0
    names, nodes, shifts = template.outlines
    outline = np.array([template.length_m, template.width_m]) / 2 - template.marking_width_m
    on_outline = np.asarray((np.abs(nodes) >= outline).all(axis=1), np.bool_)
    inner = ~np.asarray(on_outline.any(axis=-1), np.bool_)
    own = [k for k, name in enumerate(names) if name in (carriers or {circle.name})]
    wanted = [*own, *(k for k, name in enumerate(names) if inner[k] and name not in known and k not in own)]
    names, nodes, shifts = tuple(names[k] for k in wanted), nodes[wanted], shifts[wanted]
    sizes = fit.theta[[INDEX[name] for name in _SIZES]]
    drawn = predict_markings(fit.theta, nodes + np.einsum("s,ksi->ki", sizes, shifts)[:, None], model)
    element, base, normal, spread, across = _sample_markings(
        drawn, _predict_sigmas(fit, drawn, shifts), SPACING_PX * unit
    )
    visible = np.asarray(((base > 0) & (base < (model.width - 1, model.height - 1))).all(axis=1), np.bool_)
    mine = element < len(own)
    if not (visible & mine).any():
        return Agreement((), np.zeros(0), np.zeros(0))
    visible &= ~mine & np.asarray(across >= THINNEST[1] * np.quantile(across[visible & mine], THINNEST[0]))
    if region is not None:
        rows, columns = region.shape
        at = np.clip((base * (columns / model.width, rows / model.height)).astype(int), 0, (columns - 1, rows - 1))
        visible &= np.asarray(region[at[:, 1], at[:, 0]])
    near = visible & (spread < WELL_KNOWN_PX * unit)
    certain = bool(np.count_nonzero(near) * SPACING_PX >= ENOUGH_WIDTHS * 1920.0)
    visible = near if certain else visible & (spread < LARGEST_SIGMA_PX * unit)
    shifts_sd = (0.0,) if certain else UNCERTAIN_SHIFTS
    count = np.bincount(element[visible], minlength=len(names))
    visible &= count[element] * SPACING_PX >= SHORTEST_WIDTHS * 1920.0
    kept, element = np.unique(element[visible], return_inverse=True)
    if len(kept) == 0:
        return Agreement((), np.zeros(0), np.zeros(0))
    places = _Places(base[visible], normal[visible], spread[visible], template.marking_width_m * across[visible])
    count = np.bincount(element)
    share = _count_painted(picture, places, element, shifts_sd, unit) / count
    length = count.astype(np.float64) * (SPACING_PX * unit)
    return Agreement(tuple(names[k] for k in kept), length, share, certain)


@dataclass(frozen=True, slots=True)
class _Places:
    """Where markings are expected: pixels, normals (M, 2), standard deviation there and width of the paint (M,)."""

    base: Array
    normal: Array
    spread: Array
    width: Array


def _count_painted(
    picture: NDArray[np.uint8], places: _Places, element: NDArray[np.intp], shifts_sd: Sequence[float], unit: float
) -> Array:
    """At how many places of each marking there is paint: piece by piece at the best of the shifts, which are given in
    standard deviations.
    """
    count = np.bincount(element)
    position = np.arange(len(element)) - np.repeat(np.cumsum(count) - count, count)
    pieces = position // PIECE + np.concatenate([[0], np.cumsum((count[:-1] - 1) // PIECE + 1)])[element]
    owner = element[np.searchsorted(pieces, np.arange(pieces[-1] + 1))]
    sigmas = SIGMAS if len(shifts_sd) == 1 else SIGMAS_BETWEEN
    reach = max(ACROSS_PX * unit, 3.0) + sigmas * places.spread + places.width
    best = np.zeros(len(owner))
    for shift in shifts_sd:
        moved = places.base + shift * places.spread[:, None] * places.normal
        found = measure_curve(picture, moved, places.normal, reach, pieces).supported
        best = np.maximum(best, np.bincount(pieces, found.astype(np.float64)))
    return np.asarray(np.bincount(owner, best), np.float64)


def _predict_sigmas(fit: CameraFit, drawn: PredictedMarkings, shifts: Array) -> Array:
    """Standard deviation (K, N) of the places along their normals, pixels."""
    by_theta = drawn.by_theta.copy()
    by_theta[[INDEX[name] for name in _SIZES]] += np.einsum("ksi,ikn->skn", shifts, drawn.by_field)
    rows = by_theta.reshape(len(by_theta), -1)
    variance = (rows * (fit.covariance @ rows)).sum(axis=0)
    return np.sqrt(np.maximum(variance, 0.0)).reshape(by_theta.shape[1:])


def _sample_markings(
    drawn: PredictedMarkings, sigma: Array, spacing_px: float
) -> tuple[NDArray[np.int_], Array, Array, Array, Array]:
    """Places at equal steps along what the picture may show of the markings: which marking (M,), pixels, normals
    (M, 2), sigma and pixels across per metre (M,).
    """
    markings, nodes = sigma.shape
    length = drawn.length_px.ravel()
    end = np.cumsum(length)
    along = np.arange(0.5 * spacing_px, end[-1], spacing_px)
    span = np.minimum(np.searchsorted(end, along, side="right"), len(length) - 1)
    share = ((along - (end[span] - length[span])) / np.maximum(length[span], 1e-9))[:, None]
    element = span // (nodes - 1)
    node = element * nodes + span % (nodes - 1)

    def between(values: Array) -> Array:
        flat = values.reshape(markings * nodes, -1)
        return np.asarray(flat[node] + share * (flat[node + 1] - flat[node]))

    across = between(drawn.across)[:, 0]
    return element, between(drawn.pixels), between(drawn.normals), between(sigma)[:, 0], across


def is_circle_painted(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> bool:
    """Whether paint shows nearly everywhere along the predicted circle; the parameters are those of
    :func:`measure_circle_sectors`.
    """
    sectors = measure_circle_sectors(picture, fit, template, circle)
    return len(sectors) >= LEAST_SECTORS and float(np.mean(sectors > CLEAR)) >= LEAST_SHARE


def measure_circle_sectors(
    picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle
) -> Array:
    """By how many standard deviations the paint stands out in each sector of the circle that the picture shows.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    fit : CameraFit
        Says where the circle is.
    template, circle : FieldTemplate, Circle
        The field and the circle.

    Returns
    -------
    (K,) array
        At most 24 of them, in order.
    """
    model = fit.model
    outward = np.stack([np.cos(EVEN_ANGLES), np.sin(EVEN_ANGLES)])
    ring = np.asarray(circle.center) + template.radius(circle, "center") * outward.T
    seen = project(fit.theta[None], ring[None], model)
    along = seen.along(-outward[None, 1], outward[None, 0])[0].T
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    across = np.abs((seen.along(outward[None, 0], outward[None, 1])[0].T * normals).sum(axis=-1))
    width = np.maximum(template.marking_width_m * across, LEAST_WIDTH_PX * model.width / 1920.0)
    places = np.where(seen.visible[0, :, None], seen.pixels[0], -1.0)
    return measure_sectors(picture, places, width[:, None] * normals)
