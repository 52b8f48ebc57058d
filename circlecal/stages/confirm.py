"""Whether the picture confirms a camera: whether the markings that it puts into view are there (those of a wrong
circle's camera are not), and whether its circle is painted nearly everywhere, however faintly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import project
from circlecal.geometry.projective import Array
from circlecal.line_naming.marking_places import SPACING_PX, MarkingPlaces, lie_on_surface, place_markings
from circlecal.paint.bands import measure_curve
from circlecal.paint.edge_pairs import measure_edge_pairs
from circlecal.paint.matched_filter import CLEAR, EVEN_ANGLES, LEAST_WIDTH_PX, SECTORS, measure_sectors
from circlecal.paint.predicted_width import WIDE_PX
from circlecal.results import Agreement, CameraFit

__all__ = ["are_others_painted", "is_circle_painted", "look_for_markings", "measure_circle_sectors"]

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
THINNEST_SEEN, CONFIRMING_SHARE = 0.2, 0.35
"""Where nothing is held against a camera that is not found, paint of a third of that width is looked for too; and the
share of such markings that confirms a circle. Of eight right cameras to rendered robots' fields that nothing else
confirmed three have 0.40 to 0.70, while a penalty arc that was taken for the circle, and pictures put together from
others, have 0.05 to 0.13 of markings as wide as the circle's.
"""
LEAST_SHARE, LEAST_SECTORS = 0.75, 18
"""A circle is painted with this share of its sectors, if the picture shows three quarters of them (no arc of another
marking is as long, and ellipses stitched from other lines and streaks have half of them at most).
"""
LEAST_EDGED, EDGED_SHARE, EDGED_WIDTHS = 8, 0.5, 0.1
"""Sectors of a circle of wide paint in which both edges show, more than a penalty arc has; at which share of a sector's
places; and how far from theirs they may lie, widths of the paint. Right cameras of 14 rendered robots' fields have 3 to
19 (one in three less than 8), in their pictures turned over or moved by 12 to 60 px 4 at most.
"""


def look_for_markings(
    picture: NDArray[np.uint8],
    fit: CameraFit,
    template: FieldTemplate,
    circle: Circle,
    known: frozenset[str],
    region: NDArray[np.bool_] | None,
    carriers: frozenset[str] | None = None,
    thinnest: float = THINNEST[1],
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
    thinnest : float
        Paint that is narrower in the picture, in quantiles of that width, is not looked for.

    Returns
    -------
    Agreement
    """
    model = fit.model
    unit = model.width / 1920.0
    names, _, _ = template.outlines
    own = [k for k, name in enumerate(names) if name in (carriers or {circle.name})]
    elsewhere = known | template.border
    wanted = [*own, *(k for k, name in enumerate(names) if name not in elsewhere and k not in own)]
    places = place_markings(fit, template, wanted)
    visible = lie_on_surface(places.base, None, model.width, model.height)
    mine = places.element < len(own)
    if not (visible & mine).any():
        return Agreement((), np.zeros(0), np.zeros(0))
    least_across = thinnest * np.quantile(places.across[visible & mine], THINNEST[0])
    visible = lie_on_surface(places.base, region, model.width, model.height) & ~mine & (places.across >= least_across)
    visible &= places.is_sure
    near = visible & (places.spread < WELL_KNOWN_PX * unit)
    certain = bool(np.count_nonzero(near) * SPACING_PX >= ENOUGH_WIDTHS * 1920.0)
    visible = near if certain else visible & (places.spread < LARGEST_SIGMA_PX * unit)
    shifts_sd = (0.0,) if certain else UNCERTAIN_SHIFTS
    count = np.bincount(places.element[visible], minlength=len(places.names))
    visible &= count[places.element] * SPACING_PX >= SHORTEST_WIDTHS * 1920.0
    kept, element = np.unique(places.element[visible], return_inverse=True)
    if len(kept) == 0:
        return Agreement((), np.zeros(0), np.zeros(0))
    count = np.bincount(element)
    share = _count_painted(picture, places.take(visible), element, template.marking_width_m, shifts_sd, unit) / count
    length = count.astype(np.float64) * (SPACING_PX * unit)
    return Agreement(tuple(places.names[k] for k in kept), length, share, certain)


def _count_painted(
    picture: NDArray[np.uint8],
    places: MarkingPlaces,
    element: NDArray[np.intp],
    width_m: float,
    shifts_sd: Sequence[float],
    unit: float,
) -> Array:
    """At how many places of each marking there is paint: piece by piece at the best of the shifts, which are given in
    standard deviations.
    """
    count = np.bincount(element)
    position = np.arange(len(element)) - np.repeat(np.cumsum(count) - count, count)
    pieces = position // PIECE + np.concatenate([[0], np.cumsum((count[:-1] - 1) // PIECE + 1)])[element]
    owner = element[np.searchsorted(pieces, np.arange(pieces[-1] + 1))]
    sigmas = SIGMAS if len(shifts_sd) == 1 else SIGMAS_BETWEEN
    reach = max(ACROSS_PX * unit, 3.0) + sigmas * places.spread + width_m * places.across
    best = np.zeros(len(owner))
    for shift in shifts_sd:
        moved = places.base + shift * places.spread[:, None] * places.normal
        found = measure_curve(picture, moved, places.normal, reach, pieces).supported
        best = np.maximum(best, np.bincount(pieces, found.astype(np.float64)))
    return np.asarray(np.bincount(owner, best), np.float64)


def are_others_painted(
    picture: NDArray[np.uint8],
    fit: CameraFit,
    template: FieldTemplate,
    circle: Circle,
    known: frozenset[str],
    region: NDArray[np.bool_] | None,
) -> bool:
    """Whether other markings show where the camera puts them, however thin they are there; the parameters are those of
    :func:`look_for_markings`. A field with several circles is rather laid over the picture as a whole.
    """
    if len(template.circles) > 1:
        return False
    found = look_for_markings(picture, fit, template, circle, known, region, thinnest=THINNEST_SEEN)
    enough_px = ENOUGH_WIDTHS * fit.model.width
    return found.certain and found.expected_px >= enough_px and found.found_share >= CONFIRMING_SHARE


def is_circle_painted(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> bool:
    """Whether paint shows nearly everywhere along the predicted circle, or both edges of wide paint along a third of
    it; the parameters are those of :func:`measure_circle_sectors`.
    """
    sectors = measure_circle_sectors(picture, fit, template, circle)
    is_painted = len(sectors) >= LEAST_SECTORS and float(np.mean(sectors > CLEAR)) >= LEAST_SHARE
    return is_painted or count_edged_sectors(picture, fit, template, circle) >= LEAST_EDGED


def count_edged_sectors(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> int:
    """In how many of 24 sectors of the circle wide paint shows both edges at their places; the parameters are those of
    :func:`measure_circle_sectors`.
    """
    places, normals, width = _place_circle(fit, template, circle)
    wide = width > WIDE_PX * fit.model.width / 1920.0
    wide &= ((places >= 0) & (places <= (fit.model.width - 1, fit.model.height - 1))).all(axis=1)
    if not wide.any() or circle.fill == "disc":
        return 0
    offset, found = measure_edge_pairs(picture, places[wide], normals[wide], width[wide], 0.0)
    edged = np.zeros(len(places), np.bool_)
    edged[wide] = found & (np.abs(offset) <= EDGED_WIDTHS * width[wide])
    return int(np.count_nonzero(edged.reshape(SECTORS, -1).mean(axis=1) >= EDGED_SHARE))


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
    places, normals, width = _place_circle(fit, template, circle)
    return measure_sectors(picture, places, width[:, None] * normals)


def _place_circle(fit: CameraFit, template: FieldTemplate, circle: Circle) -> tuple[Array, Array, Array]:
    """Places (N, 2) in the picture at even angles of a circle, -1 where it is not seen, unit normals (N, 2), and the
    width (N,) of its paint there, pixels.
    """
    model = fit.model
    outward = np.stack([np.cos(EVEN_ANGLES), np.sin(EVEN_ANGLES)])
    ring = fit.view.center_of(circle, template) + template.radius(circle, "center") * outward.T
    seen = project(fit.theta[None], ring[None], model)
    along = seen.along(-outward[None, 1], outward[None, 0])[0].T
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    across = np.abs((seen.along(outward[None, 0], outward[None, 1])[0].T * normals).sum(axis=-1))
    width = np.maximum(template.marking_width_m * across, LEAST_WIDTH_PX * model.width / 1920.0)
    places = np.where(seen.visible[0, :, None], seen.pixels[0], -1.0)
    return places, normals, width
