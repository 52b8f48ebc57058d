"""Whether the paint of the whole picture agrees with a camera: paint where it must be, narrower with the distance, and
no other where bare field must be.

What else the picture shows is weighed against what the camera says of it, whatever the camera was fitted to. Of right
and wrong answers to rendered frames of all kinds and to real ones ``circlecal bench constants`` prints the values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.medians import quantile
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.marking_places import SPACING_PX, MarkingPlaces, lie_on_surface, place_markings
from circlecal.line_naming.on_field import lie_inside
from circlecal.paint.bands import MeasuredCurve, measure_curve
from circlecal.paint.roughness import measure_roughness
from circlecal.results import CameraFit, Evidence, MarkingMask, Segment

__all__ = ["bound_paint_width", "measure_evidence"]

FindOtherPaints = Callable[[Sequence[Segment]], Mask]
"""Which of some lines (S,) are in another paint than the circle's."""

PIECE = 25
"""Places in a row that are measured together."""
KNOWN_PX = 8.0
"""Paint is measured where the camera knows its place so well (standard deviation, pixels at 1920 px width)."""
REACH_PX, LEAST_REACH_PX = 4.0, 3.0
"""Reach of a profile beyond the paint and its uncertainty: pixels at 1920 px width, and pixels of the picture."""
FEWEST_IN_PIECE, FEWEST_PIECES, NARROWEST_PX = 6, 6, 1.0
"""Painted places of a piece whose width is told, pieces that tell how widths change, and predicted width of paint that
is not all blur, pixels at 1920 px width.
"""
SHARES_OF_WIDTH = tuple(share / 40 for share in range(4, 41))
"""Widths of paint that are tried for the greatest that it may have, shares of the template's."""
MOST_OFF_WIDTH = 3.0
"""By how much (half a chi-square) such a width may explain less than the best one."""
FEWEST_PLACES = 50
"""Places of the carriers of which a share is told."""
WIDTH_NOISE = 0.16
"""Relative standard deviation of a piece's squared width (8 % of the width, on rendered and real frames)."""
ROUNDS = 4
"""Of the robust fit of widths."""
LEAST_SEEN, SHARPEST = 0.5, 0.1
"""Errors are relative to at least so much of the squared width that the least blurred share of the pieces has: a fifth
of the width beside a player's leg outweighed 31 pieces of a right camera.
"""
EXPLAINED_PX, EXPLAINED_SIGMAS = 6.0, 3.0
"""Paint so near to a marking of the template that runs alike is that marking: pixels at 1920 px width and standard
deviations of the marking's place.
"""
ALIKE_SINE = 0.25
"""Sine of the largest angle between paint and a marking that may be the same."""
CONTRASTS = 0.5, 2.5
"""Of unexplained paint, over that of the carriers: what is fainter may be wear, mowing or shade, and what is
stronger a board, a net or a graphic.
"""
PAINT_WIDTHS = (0.5, 2.0)
"""Width of unexplained paint over that which a marking would have there; shade, boards and legs are wider."""
OLD_COAT_M = 0.6
"""Paint so near to a circle that runs along it is an old coat of it: grounds are painted anew some decimetres beside,
and 0.43 picture widths of old coats in a rendered frame refused a camera that is 1.3 px off.
"""
SHARP_PX = 2.0
"""Least width at which paint is seen, pixels at 1920 px width."""
THINNEST_SHARE = 0.1
"""Least width of paint, in widths at which paint is seen, of which the contrast without blur is told."""
OBLIQUE_DEG = 4.0
"""Angle to both axes of the field, degrees, from which on paint is no line of another sport: those run along the
field's own.
"""
SHORTEST_WIDTHS = 0.03
"""Shorter lines, picture widths, are not counted among those that run along the field's axes."""
ONE_LINE_M = 1.0
"""Segments along an axis of the field that lie so near to each other across it, metres, are pieces of one line: lines
of other sports are several metres apart. The near touchline of a rendered pitch 52 m broad was measured in two pieces,
counted as two lines of another sport, and was believed to be outside the picture by a camera that was 56 px off.
"""
BESIDE_PX, BARE_TIMES, BARE_LEVELS = 12.0, 2.0, 3.0
"""A place without paint is in full view where the ground so far off it to both sides (pixels at 1920 px width) is at
most so many times as rough as beside paint, and so many gray levels: else a player or a shadow's edge hides it.
"""
LARGEST_WORN = 0.25
"""Share of a circle that worn paint may leave bare in one stretch; where more is, another curve was taken for it."""
PATCH_PLACES, FEWEST_PATCHES = 3, 3
"""A halfway line whose paint comes back behind so many stretches of so many bare places is worn, and may be at its ends
too: in a right camera's frame of a worn rendered field it does behind five, and ends 0.24 picture widths early. The
lines of pictures whose quarters were exchanged are whole up to where they break off.
"""
PAN_PX = 24.0
"""Paint that a pan has blurred is looked for so far to both sides, pixels at 1920 px width, before it is missed."""
REVERSALS = (4, 8, 12, 16)
"""Powers of the depth by which squared widths are changed: the camera that is fitted to a picture turned upside down
sees less perspective than there is, since the circle tells it no other.
"""
TELLING_SHARE = 0.25
"""Of the misfit that a camera leaves, the least that exchanged near and far must explain: paint that neither explains
has an old coat beside it, which widens it here and not there. Of six pictures turned upside down or mirrored they
explain 0.35 to 0.86, of five right cameras of rendered fields with old coats 0.13 to 0.18.
"""


def measure_evidence(
    picture: NDArray[np.uint8],
    mask: MarkingMask,
    fit: CameraFit,
    template: FieldTemplate,
    carriers: frozenset[str],
    find_other_paints: FindOtherPaints | None = None,
) -> Evidence:
    """Weigh the whole picture against a camera.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    mask : MarkingMask
        Straight markings that were seen, and the playing surface.
    fit : CameraFit
        The camera with its covariance.
    template : FieldTemplate
        The field.
    carriers : frozenset of str
        Markings whose paint was surely seen: the circle and the halfway line, or what carries a camera without them.
    find_other_paints : callable, optional
        Tells which of the mask's lines (S,) are in another colour than the circle's paint: those speak against no
        camera. It is only asked about lines that no marking explains.

    Returns
    -------
    Evidence
    """
    places = place_markings(fit, template, range(len(template.outlines[0])))
    own = _place_carriers(mask, fit, carriers, places)
    painted = _measure_paint(picture, own, fit, template)
    other = _measure_other_paint(picture, mask, fit, template, places, own, painted, find_other_paints)
    reversal = 0.0 if painted is None else _reversal(painted, own, fit, template)
    share = 1.0 if len(own.element) < FEWEST_PLACES else 0.0 if painted is None else float(painted.supported.mean())
    bare, worn = 0.0, 0.0
    if painted is not None:
        bare, worn = _measure_bare_ends(picture, painted, own, fit, template)
    return Evidence(
        oblique_widths=other.oblique,
        alone_widths=other.alone,
        painted_share=share,
        bare_widths=bare / fit.model.width,
        worn_widths=worn / fit.model.width,
        reversal=reversal,
        parallel_widths=other.parallel,
    )


def _place_carriers(
    mask: MarkingMask, fit: CameraFit, carriers: frozenset[str], places: MarkingPlaces
) -> MarkingPlaces:
    """Of the places of all markings those of the carriers that are known well, on the playing surface."""
    kept = [k for k, name in enumerate(places.names) if name in carriers]
    return places.take(
        np.isin(places.element, kept)
        & (places.spread < KNOWN_PX * fit.model.width / 1920.0)
        & lie_on_surface(places.base, mask.field_region, fit.model.width, fit.model.height)
    )


def _measure_paint(
    picture: NDArray[np.uint8], own: MarkingPlaces, fit: CameraFit, template: FieldTemplate
) -> MeasuredCurve | None:
    """The paint of the carriers where they are known well; None where they are seen nowhere."""
    if len(own.element) == 0:
        return None
    unit = fit.model.width / 1920.0
    reach = max(REACH_PX * unit, LEAST_REACH_PX) + 2.0 * own.spread + _paint_px(own, template)
    pieces = _number_pieces(own.element)
    painted = measure_curve(picture, own.base, own.normal, reach, pieces)
    return painted if painted.supported.any() else None


def _paint_px(own: MarkingPlaces, template: FieldTemplate) -> Array:
    """Width (M,) of the paint at places of markings, pixels."""
    elements = {element.name: element for element in (*template.circles, *template.arcs, *template.lines)}
    widths = np.array([template.paint_width(elements[name]) for name in own.names])
    return np.asarray(widths[own.element] * own.across)


def _number_pieces(element: NDArray[np.int_]) -> NDArray[np.int64]:
    """Number (M,) of each place's piece: :data:`PIECE` of one marking in a row."""
    place = np.arange(len(element))
    first = np.concatenate([[True], element[1:] != element[:-1]])
    start = np.maximum.accumulate(np.where(first, place, 0))
    new = first | ((place - start) % PIECE == 0)
    return np.cumsum(new) - 1


def _measure_bare_ends(
    picture: NDArray[np.uint8],
    painted: MeasuredCurve,
    own: MarkingPlaces,
    fit: CameraFit,
    template: FieldTemplate,
) -> tuple[float, float]:
    """By how much the halfway line's paint ends too early, in full view, and the longest such stretch of a circle
    between its paint, pixels; what is hidden is skipped.
    """
    spacing_px = SPACING_PX * fit.model.width / 1920.0
    on_line = np.array([name == template.halfway_line for name in own.names])[own.element]
    parts = _bare_parts(picture, painted, own, np.flatnonzero(on_line), fit, template)
    ends = max(parts[0], parts[-1])
    if ends == 0 or np.count_nonzero(parts[1:-1] >= PATCH_PLACES) >= FEWEST_PATCHES:
        return 0.0, 0.0
    worn = 0
    circles = {circle.name for circle in template.circles}
    for k in (k for k, name in enumerate(own.names) if name in circles):
        index = np.flatnonzero(own.element == k)
        inner = _bare_parts(picture, painted, own, index, fit, template)[1:-1].max(initial=0)
        worn = max(worn, inner if inner < LARGEST_WORN * len(index) else 0)
    return float(ends) * spacing_px, float(worn) * spacing_px


def _bare_parts(
    picture: NDArray[np.uint8],
    painted: MeasuredCurve,
    own: MarkingPlaces,
    index: NDArray[np.intp],
    fit: CameraFit,
    template: FieldTemplate,
) -> NDArray[np.intp]:
    """How many of a marking's places are bare in full view before its first painted one, behind each, and at its end.

    Worn paint comes back, a line that is another one does not.
    """
    missed = index[~painted.supported[index]]
    if len(missed) in (0, len(index)):
        return np.zeros(2, np.intp)
    unit = fit.model.width / 1920.0
    pieces = _number_pieces(own.element[missed])
    blurred = measure_curve(picture, own.base[missed], own.normal[missed], np.full(len(missed), PAN_PX * unit), pieces)
    beside = own.normal[index] * (0.5 * _paint_px(own, template)[index] + BESIDE_PX * unit)[:, None]
    rough = np.maximum(*(measure_roughness(picture, own.base[index] + side * beside) for side in (-1.0, 1.0)))
    is_painted = painted.supported[index]
    is_bare = ~is_painted & (rough < BARE_TIMES * float(np.median(rough[is_painted])) + BARE_LEVELS)
    is_bare[~is_painted] &= ~blurred.supported
    return np.bincount(np.cumsum(is_painted), is_bare, minlength=2).astype(np.intp)


def _reversal(painted: MeasuredCurve, own: MarkingPlaces, fit: CameraFit, template: FieldTemplate) -> float:
    """How much better exchanged near and far explain the paint's widths; nothing where they explain little of what is
    unexplained.

    Scale falls with the depth ``z``; a picture that was turned upside down or mirrored has scales that fall with
    ``1 / z``, and its ``w^2`` are ``w^2 z^4`` of the camera that was fitted to it, or more (:data:`REVERSALS`).
    """
    widths = _measure_widths(painted, own, fit, template)
    if widths is None:
        return 0.0
    relative = widths.depth / np.exp(np.mean(np.log(widths.depth)))
    left = _misfit(widths.predicted, widths.blur, widths.measured)
    explained = left - min(_misfit(widths.predicted * relative**k, widths.blur, widths.measured) for k in REVERSALS)
    return explained if explained > TELLING_SHARE * left else min(explained, 0.0)


def bound_paint_width(
    picture: NDArray[np.uint8], mask: MarkingMask, fit: CameraFit, template: FieldTemplate, carriers: frozenset[str]
) -> float:
    """The greatest width that the paint of markings may have on the field of a camera, shares of the template's; 1
    where it may have that, or the picture does not tell. The parameters are those of :func:`measure_evidence`.
    """
    own = _place_carriers(mask, fit, carriers, place_markings(fit, template, range(len(template.outlines[0]))))
    painted = _measure_paint(picture, own, fit, template)
    widths = None if painted is None else _measure_widths(painted, own, fit, template)
    if widths is None:
        return 1.0
    scale = _scale_of_widths(widths.predicted, widths.measured)
    blur, shares = widths.blur / scale[:, None], np.array(SHARES_OF_WIDTH)
    left = np.array([_fit_widths(blur, (widths.measured - g * widths.predicted) / scale) for g in shares**2])
    return float(np.max(shares[left <= left.min() + MOST_OFF_WIDTH]))


@dataclass(frozen=True, slots=True)
class _PaintWidths:
    """Squared widths (K,) of pieces of paint, as predicted and as measured, pixels squared, the depth of each, and by
    how much blur across the picture and down it adds to each (K, 2).

    Blur adds to the width of paint in squares, ``m^2 = g w^2 + b_x n_x^2 + b_y n_y^2``, with the predicted width ``w``,
    the normal ``n`` and no negative coefficient: a pan blurs what it sweeps across, not what runs along with it.
    """

    predicted: Array
    measured: Array
    depth: Array
    blur: Array


def _measure_widths(
    painted: MeasuredCurve, own: MarkingPlaces, fit: CameraFit, template: FieldTemplate
) -> _PaintWidths | None:
    """Widths of the paint of carriers, piece by piece; None where too few pieces tell them."""
    unit = fit.model.width / 1920.0
    predicted = _paint_px(own, template)
    seen = painted.supported & (predicted > NARROWEST_PX * unit)
    pieces = _number_pieces(own.element)[seen]
    count = np.bincount(pieces, minlength=1)
    enough = count >= FEWEST_IN_PIECE
    if np.count_nonzero(enough) < FEWEST_PIECES:
        return None
    depth = fit.camera.depth(fit.view.to_field(own.base[seen]))
    each = (predicted[seen], painted.width[seen], depth, own.normal[seen, 0] ** 2)
    width, measured, depth, across = (_median_by_piece(values, pieces, count)[enough] for values in each)
    known = np.isfinite(depth) & (depth > 0) & (measured > 0)
    if np.count_nonzero(known) < FEWEST_PIECES:
        return None
    blur = np.stack([across, 1.0 - across], axis=-1)[known]
    return _PaintWidths(width[known] ** 2, measured[known] ** 2, depth[known], blur)


def _median_by_piece(values: Array, pieces: NDArray[np.int64], count: NDArray[np.int_]) -> Array:
    """Middle value of each piece (K,); of pieces without places any value."""
    order = np.lexsort((values, pieces))
    start = np.cumsum(count) - count
    return np.asarray(values[order][np.minimum(start + count // 2, len(values) - 1)])


def _misfit(predicted: Array, blur: Array, measured: Array) -> float:
    """Half the robust chi-square of ``measured = g predicted + blur b`` with no negative coefficient, in relative
    errors; ``blur`` is (N, 2).
    """
    scale = _scale_of_widths(predicted, measured)
    return _fit_widths(np.column_stack([predicted, blur]) / scale[:, None], measured / scale)


def _scale_of_widths(predicted: Array, measured: Array) -> Array:
    """What errors of squared widths (N,) are relative to: what hides paint leaves a small part of its width, of which
    the error would be many times as large.
    """
    return np.asarray(np.maximum(measured, LEAST_SEEN * quantile(measured / predicted, SHARPEST) * predicted))


def _fit_widths(rows: Array, target: Array) -> float:
    """Half the robust chi-square that no negative coefficients of rows (N, K) leave of a target (N,)."""
    # takes as long to import as all of circlecal; only a camera that was accepted asks for it
    from scipy.optimize import nnls

    weight = np.ones(len(rows))
    off = np.zeros(len(rows))
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        off = (rows @ nnls(rows * root[:, None], target * root)[0] - target) / WIDTH_NOISE
        weight = 1.0 / np.sqrt(1.0 + off**2)
    return float((np.sqrt(1.0 + off**2) - 1.0).sum())


@dataclass(frozen=True, slots=True)
class _OtherPaint:
    """Length of lines on the field that are none of its markings, picture widths: oblique to its axes, of one along an
    axis that is the only one, and of all along an axis whose paint is as light as the carriers' would be there.
    """

    oblique: float = 0.0
    alone: float = 0.0
    parallel: float = 0.0


def _measure_other_paint(
    picture: NDArray[np.uint8],
    mask: MarkingMask,
    fit: CameraFit,
    template: FieldTemplate,
    places: MarkingPlaces,
    own: MarkingPlaces,
    painted: MeasuredCurve | None,
    find_other_paints: FindOtherPaints | None,
) -> _OtherPaint:
    """What is painted on the field that is none of its markings, beside the carriers' paint at their own places."""
    segments = [segment for segment in (*mask.lines, mask.halfway) if segment is not None]
    if painted is None or not segments:
        return _OtherPaint()
    width, height = fit.model.width, fit.model.height
    unit = width / 1920.0
    ends = np.array([(segment.start, segment.end) for segment in segments])
    cells = _divide(ends, SPACING_PX * unit)
    bare = ~_are_explained(cells, places, unit) & lie_on_surface(cells.points, mask.field_region, width, height)
    bare[bare] = lie_inside(fit.view, cells.points[bare], template)
    if find_other_paints is not None:
        asked = np.unique(cells.which[bare])
        asked = asked[asked < len(mask.lines)]
        others = find_other_paints([mask.lines[k] for k in asked.tolist()])
        bare &= ~np.isin(cells.which, asked[others])
    if not bare.any():
        return _OtherPaint()
    points, along, which = cells.points[bare], cells.along[cells.which[bare]], cells.which[bare]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    field_m = fit.view.to_field(points)
    expected, angle = _paint_on_ground(fit.view, points, field_m, along, template.marking_width_m)
    reach = REACH_PX * unit + LEAST_REACH_PX + PAINT_WIDTHS[1] * expected
    seen = measure_curve(picture, points, normals, reach, _number_pieces(which))
    ratio = seen.width / np.hypot(expected, SHARP_PX * unit)
    like = seen.supported & (ratio > PAINT_WIDTHS[0]) & (ratio < PAINT_WIDTHS[1])
    like &= ~_are_old_coats(field_m, angle, template)
    is_oblique = np.abs(np.sin(2.0 * angle)) > np.sin(np.radians(2.0 * OBLIQUE_DEG))
    carried = painted.supported
    paint = like & _are_as_light(seen.contrast, painted.contrast[carried])
    sharp_px = SHARP_PX * unit
    light = _sharpen(seen.contrast, expected, sharp_px)
    carried_light = _sharpen(painted.contrast, _paint_px(own, template), sharp_px)[carried]
    thin = like & _are_as_light(light, carried_light)
    step = cells.step[which]

    def measure_lines(kept: Mask) -> Array:
        """Length of each line along an axis that is long enough, pixels."""
        lines = _number_lines(field_m[kept], angle[kept], which[kept])
        length = np.bincount(lines, step[kept], minlength=1)
        return np.asarray(length[length > SHORTEST_WIDTHS * width])

    alone, parallel = (measure_lines(kept & ~is_oblique) for kept in (paint, thin))
    return _OtherPaint(
        float(step[paint & is_oblique].sum()) / width,
        float(alone[0]) / width if len(alone) == 1 else 0.0,
        float(parallel.sum()) / width,
    )


def _are_as_light(contrast: Array, carried: Array) -> Mask:
    """Which of some paint (N,) is about as light as that of the carriers (M,), whose middle value counts."""
    share = contrast / np.median(carried)
    return np.asarray((share > CONTRASTS[0]) & (share < CONTRASTS[1]), np.bool_)


def _sharpen(contrast: Array, width_px: Array, blur_px: float) -> Array:
    """Contrast (N,) that paint of this width (N,), pixels, would have without the picture's blur: what is far away is
    thinner than that, and as much fainter.
    """
    thin = np.maximum(width_px, THINNEST_SHARE * blur_px)
    return np.asarray(contrast * np.hypot(thin, blur_px) / thin)


def _number_lines(field_m: Array, angle: Array, which: NDArray[np.int_]) -> NDArray[np.int_]:
    """Numbers of the lines along an axis of the field on which places (N, 2) lie, whose segments (N,) at these angles
    (N,), rad, may be pieces of one line.
    """
    runs_along_y = np.abs(np.sin(angle)) > np.abs(np.cos(angle))
    _, segment = np.unique(which, return_inverse=True)
    count = np.bincount(segment)
    is_along_y = np.bincount(segment, runs_along_y) > count / 2.0
    mean_m = np.stack([np.bincount(segment, field_m[:, axis]) / count for axis in (0, 1)])
    across_m = np.where(is_along_y, mean_m[0], mean_m[1])
    order = np.lexsort([across_m, is_along_y])
    begins = (np.diff(across_m[order]) > ONE_LINE_M) | (np.diff(is_along_y[order].astype(int)) != 0)
    line = np.zeros(len(order), np.int_)
    line[order[1:]] = np.cumsum(begins)
    return np.asarray(line[segment])


@dataclass(frozen=True, slots=True)
class _Cells:
    """S segments divided into M cells: start and direction (S, 2), length of a cell (S,) and their count (S,), and of
    each cell its segment (M,) and middle (M, 2), pixels.
    """

    start: Array
    along: Array
    step: Array
    count: NDArray[np.int_]
    which: NDArray[np.int_]
    points: Array


def _divide(ends: Array, spacing_px: float) -> _Cells:
    """Segments (S, 2, 2) in cells of about this length."""
    span = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.hypot(span[:, 0], span[:, 1]), 1e-9)
    count = np.maximum((length / spacing_px).astype(int), 1)
    which = np.repeat(np.arange(len(ends)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    along, step = span / length[:, None], length / count
    points = ends[which, 0] + ((number + 0.5) * step[which])[:, None] * along[which]
    return _Cells(ends[:, 0], along, step, count, which, points)


def _are_explained(cells: _Cells, places: MarkingPlaces, unit: float) -> Mask:
    """Which cells (M,) lie on a marking that runs like their segment.

    Each place of a marking that lies beside a segment covers an interval of it; how often a cell is covered is the sum
    of what begins before it less what ends there.
    """
    offset = places.base[None] - cells.start[:, None]
    normal = np.stack([-cells.along[:, 1], cells.along[:, 0]], axis=-1)
    alike = np.abs(cells.along @ places.normal.T) < ALIKE_SINE
    spread = EXPLAINED_SIGMAS * places.spread
    beside = np.abs((offset @ normal[:, :, None])[..., 0]) < EXPLAINED_PX * unit + spread
    segment, place = np.nonzero(alike & beside)
    position = (offset[segment, place] * cells.along[segment]).sum(axis=-1) / cells.step[segment]
    reach = (2.0 * SPACING_PX * unit + spread[place]) / cells.step[segment]
    low, high = (
        np.clip(edge, 0, cells.count[segment]).astype(int)
        for edge in (np.floor(position - reach), np.ceil(position + reach))
    )
    # one more slot behind each segment takes the ends of what reaches beyond it
    first = np.cumsum(cells.count + 1) - (cells.count + 1)
    size = int((cells.count + 1).sum())
    begun, ended = (np.bincount(first[segment] + edge, minlength=size) for edge in (low, high))
    covered = np.cumsum(begun - ended) > 0
    last = first + cells.count
    return np.asarray(np.delete(covered, last), np.bool_)


def _are_old_coats(field_m: Array, angle: Array, template: FieldTemplate) -> Mask:
    """Which places (N, 2) of the field, on lines at these angles (N,), rad, lie beside a circle and run along it."""
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    found = np.zeros(len(field_m), np.bool_)
    for circle in template.circles:
        outward = field_m - np.asarray(circle.center)
        distance = np.maximum(np.hypot(outward[:, 0], outward[:, 1]), 1e-9)
        runs_along = np.abs((along * outward).sum(axis=-1)) < ALIKE_SINE * distance
        found |= runs_along & (np.abs(distance - template.radius(circle, "center")) < OLD_COAT_M)
    return found


def _paint_on_ground(
    view: FieldView, points: Array, field_m: Array, along: Array, width_m: float
) -> tuple[Array, Array]:
    """Width (N,) in pixels that a marking along a line at pixels (N, 2), places (N, 2) of the field, would have, and
    the line's angle (N,) on the field, rad.
    """
    ahead = view.to_field(points + along) - field_m
    ahead /= np.maximum(np.hypot(ahead[:, :1], ahead[:, 1:]), 1e-12)
    beside = view.project(field_m + width_m * np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)) - points
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    return np.nan_to_num(np.abs((beside * normals).sum(axis=-1))), np.arctan2(ahead[:, 1], ahead[:, 0])
