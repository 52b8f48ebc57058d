"""The markings that a predicted camera puts into view, and where the picture shows their paint.

Places are spread evenly over all that the picture may show of the template. Each is projected with its derivatives, and
the paint is looked for across the marking there. What is kept of a frame is small: places on the field, pixels, normals
and standard deviations, from which the frame can be fitted again when its tripod is known better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from circlecal.camera.residuals import SIZES
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import Projection, ProjectionModel, project
from circlecal.geometry.projective import Array, Indices, Mask
from circlecal.paint.bands import MeasuredCurve, measure_curve
from circlecal.paint.profiles import GrayPicture
from circlecal.tracking.faint_paint import PaintStrength, measure_faint
from circlecal.tracking.one_line import JUMP_PX, keep_one_line
from circlecal.tracking.thin_paint import measure_thin

SPACING_PX = 9.0
"""Distance of neighbouring places along a marking, pixels at 1920 px width: a third of what players and their shadows
cover, so that what lies between them still has the neighbours that paint is known by.
"""
MOST_PLACES = 420
"""More are not measured: a penalty area at 1920 px width shows about 4,000 px of markings."""
MARGIN_PX = 3.0
"""Places nearer to the picture's border are not measured, pixels."""
ACROSS_PX = 5.0
"""Least reach of a profile to both sides beyond the paint, pixels at 1920 px width."""
FARTHEST_SIGMA_PX = 12.0
"""A marking whose place is less certain than this, pixels at 1920 px width, is another one as likely."""
NARROWEST_PX, FAINTEST_PX = 0.35, 0.1
"""Paint that is narrower in the picture than the first, in pixels, need not be seen, so that its absence says nothing;
narrower than the second it is not looked for. The far touchline of a rendered pitch 88 m broad, 0.26 px at 1280 px
width, shows at 52 of 52 places, and nothing else tells how broad that pitch is.
"""
GOAL_REACH_M, BORDER_M = 5.0, 0.3
"""How far to both sides of its middle a goal line is not measured, metres, and how near to the end of the field a place
or a line counts as lying on its border. Beside posts and net the paint of rendered frames is off by 0.13 px, elsewhere
by 0.01.
"""
USUAL_BLUR, BIAS_BY_BLUR = 0.3, 0.3
"""Quantile of the blurs along a picture's markings that is the picture's own, and by how much the middle of a marking
may be off per pixel of further blur. A far touchline before a strip of another colour looks broad on one side: over
three rendered clips its middles are off by 0.06 px where the blur is the usual one, by 0.3 with one pixel more, by
0.8 with two and a half.
"""
FAINT_BIAS_PX = 4.0
"""By how much the middle of such paint may be off, pixels at 1920 px width: before boards it is off by 0.3 to 1 in all
frames of three rendered clips, to one side, and a number of frames does not lower that.
"""
PIECE_BIAS_PX = 8.0
"""By how much paint that only whole pieces of a line show may be off, pixels at 1920 px width: all their places, three
times as many as repeat an error elsewhere, are one measurement.
"""
LEAST_SHARE = 0.35
"""Share of the places of a marking with paint below which what was found is not the marking: of a halfway line that a
pan of 44 px smears, 12 of 60 places showed a false ridge, and 3 such frames of 58 made a pitch 0.6 m too short.
Markings that are seen have 0.6 to 1, between players and in worn paint 0.45.
"""
BROAD_PX, MISSED_PLACES, MISSED_SHARE = 2.0, 24, 0.35
"""A marking whose paint is broader than so many pixels at so many places, and shows in less than this share of all, is
not where the camera puts it: in real clips the halfway line, 12 px beside its place and 7 px broad, while circle and
touchline agreed; it showed at 0 to 0.3 of its places where it crossed its own, right ones show at 0.38 and more.
"""
CLEAR_PX_M = 10.0
"""Scale across a marking, pixels at 1920 px width per metre, from which on what lies beside the paint is not taken for
it: a circle and the penalty areas have 12 to 60, far touchlines 3 to 9.
"""
OPTICAL_BLUR_PX = 2.2
"""Width that optics and encoding add to paint, pixels at 1920 px width."""
SMEARED = 2.5
"""Paint that moved across by so many of its own widths in the picture, blurred, while the shutter was open, is too pale
to be expected.
"""
PALE = 1.0
"""Paint that moved across by so many of its own widths is too pale for its absence to say anything: by half. Of a
halfway line that a rendered pan of 7 to 11 px smears no place is found, where all else shows its paint.
"""
PIECE = 24
"""Places in a row within which paint has one usual contrast."""
FAR_APART = 6.0
"""Times the distance of neighbours, beyond which two places are not the neighbours of one between them."""


@dataclass(frozen=True, slots=True)
class DrawnTemplate:
    """Markings of a template as curves with a parameter.

    Attributes
    ----------
    names : tuple of str
        Circles and arcs, then lines (K).
    nodes : (K, N, 2) array
        Points along each, metres.
    shifts : (K, 3, 2) array
        How each moves with the sizes of the field.
    center, radius, first, last : (K, 2), (K,), (K,), (K,) arrays
        Circles: centre, radius of the centreline, first and last angle. Lines have a radius of 0.
    by_width : (K,) array
        How much the radius of a centreline grows per metre of marking width.
    """

    names: tuple[str, ...]
    nodes: Array
    shifts: Array
    center: Array
    radius: Array
    first: Array
    last: Array
    by_width: Array

    def places(self, marking: Indices, share: Array) -> Array:
        """Points (M, 2) at a share (M,) of the way along markings (M,), metres."""
        angle = self.first[marking] + share * (self.last[marking] - self.first[marking])
        on_circle = self.center[marking] + self.radius[marking, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        start, end = self.nodes[marking, 0], self.nodes[marking, -1]
        return np.where(self.radius[marking, None] > 0, on_circle, start + share[:, None] * (end - start))

    @property
    def is_circle(self) -> Mask:
        """Which of them (K,) go all the way round."""
        return np.asarray((self.radius > 0) & (self.last - self.first > 2.0 * np.pi - 1e-6), np.bool_)

    @property
    def border(self) -> Indices:
        """Numbers of the lines round the field, beside which boards and strips of another colour lie."""
        extent = np.abs(self.nodes).max(axis=(0, 1))
        on_border = (np.abs(self.nodes) > extent - BORDER_M).all(axis=1).any(axis=1)
        return np.flatnonzero(on_border & (self.radius == 0))


@lru_cache(maxsize=8)
def _read_curves(template_json: str) -> DrawnTemplate:
    template = FieldTemplate.model_validate_json(template_json)
    names, nodes, shifts = template.outlines
    round_ones = (*template.circles, *template.arcs)
    ends = [(0.0, 360.0)] * len(template.circles) + [(arc.start_deg, arc.end_deg) for arc in template.arcs]
    K, C = len(names), len(round_ones)
    center, radius, first, last, by_width = np.zeros((K, 2)), *np.zeros((4, K))
    for k, (circle, (start, end)) in enumerate(zip(round_ones, ends, strict=True)):
        center[k], radius[k] = circle.center, template.radius(circle, "center")
        first[k], last[k] = np.radians(start), np.radians(end)
        by_width[k] = template.radius(circle, "center", 1.0) - template.radius(circle, "center", 0.0)
    shifts = shifts.copy()
    # the arcs of the penalty areas move with the goal lines
    shifts[:C, 1, 0] = np.where(np.abs(center[:C, 0]) > 1.0, np.sign(center[:C, 0]) / 2.0, 0.0)
    return DrawnTemplate(names, nodes, shifts, center, radius, first, last, by_width)


def template_curves(template: FieldTemplate) -> DrawnTemplate:
    """The markings of a template as curves."""
    return _read_curves(template.model_dump_json())


@dataclass(frozen=True, slots=True)
class Places:
    """M places on the markings before a camera.

    Attributes
    ----------
    marking : (M,) int array
        Number of the marking.
    field_m : (M, 2) array
        Place on a field of the template's size.
    pixels, normals : (M, 2) arrays
        Where it is seen, and the unit vector across the marking.
    width_px, scale_px_m : (M,) arrays
        Width of the paint there, and pixels per metre across the marking.
    curvature : (M,) array
        Of the marking in the picture, per pixel: positive where it bends towards the normal.
    by_theta : (M, P) array
        Derivative of the place along the normal by the camera's parameters, sizes of the field among them.
    """

    marking: Indices
    field_m: Array
    pixels: Array
    normals: Array
    width_px: Array
    scale_px_m: Array
    curvature: Array
    by_theta: Array

    def shift_by_motion(self, moved_px: Array) -> Array:
        """How far the middle of smeared paint lies from the marking (M,), along the normals, pixels.

        While the picture moves by m (2,), a curve that bends by k leaves paint at ``k (t m . T)^2 / 2`` beside its
        tangent T, for t from -1/2 to 1/2: on average at ``k (m . T)^2 / 24``, on the inner side.
        """
        along = self.normals[:, 0] * moved_px[1] - self.normals[:, 1] * moved_px[0]
        return np.asarray(self.curvature * along**2 / 24.0)


def grow_places(drawn: DrawnTemplate, marking: Indices, field_m: Array, theta: Array) -> Array:
    """Places (M, 2) of the template on a field with the sizes of ``theta`` (P,)."""
    moved = field_m + np.einsum("s,msi->mi", theta[SIZES], drawn.shifts[marking])
    swollen = theta[SIZES[0]] * drawn.by_width[marking]
    round_ones = np.flatnonzero((drawn.radius[marking] > 0) & (swollen != 0))
    if len(round_ones):
        outward = field_m[round_ones] - drawn.center[marking[round_ones]]
        moved[round_ones] += outward * (swollen[round_ones] / drawn.radius[marking[round_ones]])[:, None]
    return np.asarray(moved)


def rows_of(drawn: DrawnTemplate, marking: Indices, field_m: Array, seen: Projection, normals: Array) -> Array:
    """Derivatives (M, P) along normals (M, 2) by all parameters of the first camera, sizes of the field among them."""
    rows, by_field = (values[0] for values in seen.gradient(normals.T[None]))
    rows[SIZES] = np.einsum("msi,im->sm", drawn.shifts[marking], by_field)
    outward = np.where(
        drawn.radius[marking, None] > 0,
        (field_m - drawn.center[marking]) / np.maximum(drawn.radius[marking, None], 1e-9),
        0.0,
    )
    rows[SIZES[0]] += drawn.by_width[marking] * (outward.T * by_field).sum(axis=0)
    return np.asarray(rows.T)


def place_markings(
    drawn: DrawnTemplate, theta: Array, model: ProjectionModel, width_m: float, spacing_px: float = SPACING_PX
) -> Places:
    """Spread places evenly over what the picture may show of the markings.

    Parameters
    ----------
    drawn : DrawnTemplate
        The field.
    theta : (P,) array
        The camera.
    model : ProjectionModel
        Picture and surface.
    width_m : float
        Width of the paint, metres.
    spacing_px : float
        Distance of neighbours, pixels at 1920 px width.
    """
    K, N = drawn.nodes.shape[:2]
    unit = model.width / 1920.0
    flat = drawn.nodes.reshape(-1, 2)
    marking_of = np.repeat(np.arange(K), N)
    coarse = project(theta[None], grow_places(drawn, marking_of, flat, theta)[None], model)
    pixels = np.where(coarse.visible[0, :, None], coarse.pixels[0], np.nan).reshape(K, N, 2)
    first, last = pixels[:, :-1], pixels[:, 1:]
    step = last - first
    with np.errstate(invalid="ignore"):
        met = (np.maximum(first, last) > 0) & (np.minimum(first, last) < (model.width, model.height))
        near = np.abs(step).max(axis=-1) < 2.0 * model.width
    length = np.where(met.all(axis=-1) & near, np.hypot(step[..., 0], step[..., 1]), 0.0).ravel()
    end = np.cumsum(length)
    spacing = max(spacing_px * unit, end[-1] / MOST_PLACES)
    along = np.arange(0.5 * spacing, end[-1], spacing)
    span = np.minimum(np.searchsorted(end, along, side="right"), len(length) - 1)
    within = (along - (end[span] - length[span])) / np.maximum(length[span], 1e-9)
    marking = span // (N - 1)
    share = (span % (N - 1) + within) / (N - 1)
    field_m = drawn.places(marking, share)
    seen = project(theta[None], grow_places(drawn, marking, field_m, theta)[None], model)
    # along the marking on the ground, and from there in the picture
    direction = drawn.nodes[marking, -1] - drawn.nodes[marking, 0]
    beside = field_m - drawn.center[marking]
    tangent = np.where(drawn.radius[marking, None] > 0, np.stack([-beside[:, 1], beside[:, 0]], -1), direction)
    tangent /= np.maximum(np.hypot(tangent[:, :1], tangent[:, 1:]), 1e-9)
    image = seen.along(tangent[None, :, 0], tangent[None, :, 1])[0].T
    normals = np.stack([-image[:, 1], image[:, 0]], axis=-1) / np.maximum(np.hypot(*image.T), 1e-9)[:, None]
    across = seen.along(-tangent[None, :, 1], tangent[None, :, 0])[0].T
    scale = np.abs((across * normals).sum(axis=1))
    width_px = width_m * scale
    found = seen.pixels[0]
    inside = (found > MARGIN_PX).all(axis=1) & (
        found < (model.width - 1 - MARGIN_PX, model.height - 1 - MARGIN_PX)
    ).all(1)
    inside &= seen.visible[0] & (width_px > FAINTEST_PX) & ~_lie_in_goals(field_m, drawn)
    rows = rows_of(drawn, marking, field_m, seen, normals)
    bend = _curvatures(marking, drawn.radius[marking] > 0, found, normals, spacing)
    found_places = marking, field_m, found, normals, width_px, scale, bend, rows
    return Places(*(values[inside] for values in found_places))


def _curvatures(marking: Indices, is_round: Mask, pixels: Array, normals: Array, spacing_px: float) -> Array:
    """Curvature (M,) of markings at places in the picture, per pixel, positive towards the normals; 0 of lines, and
    where a marking is seen in parts.

    Between places on either side of one, the normal turns by the curvature times the way.
    """
    before, after = (np.clip(np.arange(len(marking)) + k, 0, len(marking) - 1) for k in (-1, 1))
    along, turned = pixels[after] - pixels[before], normals[after] - normals[before]
    way = (along * along).sum(axis=1)
    is_one = is_round & (marking[before] == marking[after]) & (way < (FAR_APART * spacing_px) ** 2)
    return np.where(is_one, -(turned * along).sum(axis=1) / np.maximum(way, 1e-9), 0.0)


def _lie_in_goals(field_m: Array, drawn: DrawnTemplate) -> Mask:
    """Which places (M, 2) lie between and beside the posts of a goal, whose net and shadow hide the line."""
    end = drawn.nodes[..., 0].max() - BORDER_M
    return np.asarray((np.abs(field_m[:, 0]) > end) & (np.abs(field_m[:, 1]) < GOAL_REACH_M), np.bool_)


@dataclass(frozen=True, slots=True)
class MeasuredFrame:
    """Paint that a picture shows of the markings.

    Attributes
    ----------
    marking, field_m : (M,), (M, 2) arrays
        Which marking, and where on it, on a field of the template's size.
    points_px, normals : (M, 2) arrays
        Middle of the paint, and the direction across it in which it was measured.
    width_px, scale_px_m : (M,) arrays
        Full width at half the peak, and pixels per metre across the marking.
    bias_px : (M,) array
        By how much the middle may be off along the normal, a standard deviation, because of what lies beside the paint.
    expected, painted : (K,) int arrays
        Of each marking the number of places that the camera puts before grass and that are broad enough to be expected
        to show paint, and of those that do.
    missing : int
        Number of markings that should be seen broadly and are not seen at all.
    """

    marking: Indices
    field_m: Array
    points_px: Array
    normals: Array
    width_px: Array
    scale_px_m: Array
    bias_px: Array
    expected: Indices
    painted: Indices
    missing: int = 0

    @property
    def painted_share(self) -> float:
        """Share of the expected places that show paint, 0 where none is expected."""
        return float(self.painted.sum() / max(self.expected.sum(), 1))

    def leave_out(self, marking: int) -> MeasuredFrame:
        """The frame without the paint of one marking."""
        kept = self.marking != marking
        per_place = ("marking", "field_m", "points_px", "normals", "width_px", "scale_px_m", "bias_px")
        return replace(self, **{name: getattr(self, name)[kept] for name in per_place})


def measure_markings(
    picture: GrayPicture,
    places: Places,
    spread_px: Array,
    unit: float,
    count: int,
    blur_px: Array | None = None,
    grass: NDArray[np.uint8] | None = None,
) -> tuple[MeasuredFrame, Indices]:
    """Look for paint at places.

    Parameters
    ----------
    picture : (H, W) uint8
        Gray levels.
    places : Places
        Where the camera puts the markings.
    spread_px : (M,) array
        Standard deviation of the places along their normals.
    unit : float
        Width of the picture over 1920.
    count : int
        Number K of markings.
    blur_px : (2,) array, optional
        Way of the picture while the shutter was open.
    grass : (h, w) uint8, optional
        Playing surface in a reduced picture: what is seen elsewhere is not the marking.

    Returns
    -------
    MeasuredFrame, (P,) int array
        The paint, and the numbers of the places that show it.
    """
    keep = spread_px < FARTHEST_SIGMA_PX * unit
    if grass is not None:
        height, width = picture.shape
        rows, columns = grass.shape
        at = (places.pixels * (columns / width, rows / height)).astype(int)
        keep &= grass[np.clip(at[:, 1], 0, rows - 1), np.clip(at[:, 0], 0, columns - 1)] > 0
    smear = np.zeros(len(keep))
    if blur_px is not None:
        smear = np.abs(places.normals @ blur_px) / (places.width_px + OPTICAL_BLUR_PX * unit)
        keep &= smear < SMEARED
    index = np.flatnonzero(keep)
    marking, base, normals = places.marking[index], places.pixels[index], places.normals[index]
    is_expected = places.width_px[index] > NARROWEST_PX
    looked_for = np.bincount(marking, minlength=count)
    expected = np.bincount(marking[is_expected], minlength=count)
    if len(index) < 8:
        empty = np.zeros((0, 2))
        none = np.zeros(0)
        unseen = MeasuredFrame(
            marking[:0], empty, empty, empty, none, none, none, expected, np.zeros(count, dtype=np.int_)
        )
        return unseen, index[:0]
    reach = max(ACROSS_PX * unit, 3.5) + 2.0 * spread_px[index] + places.width_px[index]
    if blur_px is not None:
        reach = reach + 0.5 * np.abs(normals @ blur_px)
    start = np.searchsorted(marking, np.arange(count))
    position = np.arange(len(index)) - start[marking]
    pieces_of = np.where(looked_for > 0, (looked_for - 1) // PIECE + 1, 0)
    pieces = position // PIECE + (np.cumsum(pieces_of) - pieces_of)[marking]
    found = measure_curve(picture, base, normals, reach, pieces.astype(np.int64))
    is_thin = (places.scale_px_m[index] < CLEAR_PX_M * unit) & (smear[index] < PALE)
    found = measure_thin(picture, found, is_thin, pieces.astype(np.int64), unit)
    is_alone = found.supported
    found = _measure_faint(picture, found, is_thin & ~is_expected, pieces, places, index, reach, blur_px)
    on: Mask = found.supported
    # paint as wide as this camera shows it, blurred
    blurred = OPTICAL_BLUR_PX * unit + 1.0 + (np.abs(normals @ blur_px) if blur_px is not None else 0.0)
    on = np.asarray(on & (found.width < 1.6 * places.width_px[index] + 2.0 * blurred), np.bool_)
    share = np.bincount(marking[on], minlength=count) / np.maximum(looked_for, 1)
    is_broad = (places.width_px[index] > BROAD_PX) & (smear[index] < PALE)
    broad = np.bincount(marking[is_broad], minlength=count)
    missing = int(np.count_nonzero((broad >= MISSED_PLACES) & (share < MISSED_SHARE)))
    on &= share[marking] >= LEAST_SHARE
    is_far = on & (places.scale_px_m[index] < CLEAR_PX_M * unit)
    kept, is_double = keep_one_line(is_far, found.offset, marking, JUMP_PX * unit, count)
    on &= kept | ~is_far
    expected = np.where(is_double, 0, expected)
    painted = np.bincount(marking[on & is_expected], minlength=count)
    shift, moved = np.zeros((2, np.count_nonzero(on)))
    if blur_px is not None:
        shift, moved = places.shift_by_motion(blur_px)[index][on], np.abs(normals[on] @ blur_px)
    bias = np.hypot(_bias_sigmas(found.width[on], places.width_px[index][on], moved), shift)
    at = index[on]
    measured = MeasuredFrame(
        marking[on],
        places.field_m[at],
        base[on] + (found.offset[on] - shift)[:, None] * normals[on],
        normals[on],
        found.width[on],
        places.scale_px_m[at],
        np.where(is_expected[on], bias, np.where(is_alone[on], FAINT_BIAS_PX, PIECE_BIAS_PX) * unit),
        expected,
        painted,
        missing,
    )
    return measured, at


def _measure_faint(
    picture: GrayPicture,
    found: MeasuredCurve,
    faint: Mask,
    pieces: Indices,
    places: Places,
    index: Indices,
    reach: Array,
    blur_px: Array | None,
) -> MeasuredCurve:
    """The paint (N,) at some places, with that of lines too thin for single places along their pieces."""
    unit = picture.shape[1] / 1920.0
    faint = np.asarray(faint & ~found.supported, np.bool_)
    if not faint.any():
        return found
    on, scale, paint_px = found.supported, places.scale_px_m[index], places.width_px[index]
    paint = PaintStrength.of(found.contrast[on], found.width[on], scale[on], scale[on] > CLEAR_PX_M * unit)
    if paint is None:
        return found
    moved = 0.0 if blur_px is None else found.normals @ blur_px
    height, width = paint.ridges(scale, paint_px, moved)
    return measure_faint(picture, found, faint, pieces.astype(np.int64), height, width, reach, unit)


def _bias_sigmas(width_px: Array, paint_px: Array, moved_px: Array) -> Array:
    """By how much a middle may be off (M,) where the paint looks broader than paint does in this picture, pixels.

    A full width w at half the peak, of paint of width p that moved by m, comes of a blur ``b^2 = w^2 - p^2 - m^2``.
    """
    if len(width_px) == 0:
        return np.zeros(0)
    blur = np.sqrt(np.maximum(width_px**2 - paint_px**2 - moved_px**2, 0.0))
    at = int(USUAL_BLUR * (len(blur) - 1))
    usual = float(np.partition(blur, at)[at])
    return np.asarray(BIAS_BY_BLUR * np.maximum(blur - usual, 0.0))
