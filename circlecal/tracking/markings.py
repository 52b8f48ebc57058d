"""The markings that a predicted camera puts into view.

Places are spread evenly over all that the picture may show of the template, and each is projected with its derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from circlecal.camera.residuals import SIZES
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import Projection, ProjectionModel, project
from circlecal.geometry.projective import Array, Indices, Mask

SPACING_PX = 9.0
"""Distance of neighbouring places along a marking, pixels at 1920 px width: a third of what players and their shadows
cover, so that what lies between them still has the neighbours that paint is known by.
"""
MOST_PLACES = 420
"""More are not measured: a penalty area at 1920 px width shows about 4,000 px of markings."""
MARGIN_PX = 3.0
"""Places nearer to the picture's border are not measured, pixels."""
NARROWEST_PX, FAINTEST_PX = 0.35, 0.1
"""Paint that is narrower in the picture than the first, in pixels, need not be seen, so that its absence says nothing;
narrower than the second it is not looked for. The far touchline of a rendered pitch 88 m broad, 0.26 px at 1280 px
width, shows at 52 of 52 places, and nothing else tells how broad that pitch is.
"""
CLEAR_PX_M = 10.0
"""Scale across a marking, pixels at 1920 px width per metre, from which on what lies beside the paint is not taken for
it: a circle and the penalty areas have 12 to 60, far touchlines 3 to 9.
"""
GOAL_REACH_M, BORDER_M = 5.0, 0.3
"""How far to both sides of its middle a goal line is not measured, metres, and how near to the end of the field a place
or a line counts as lying on its border. Beside posts and net the paint of rendered frames is off by 0.13 px, elsewhere
by 0.01.
"""


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
    stretches : (K, 2) array
        By how much each metre of its coordinates stretches per metre of length and of width of the field.
    center, radius, first, last : (K, 2), (K,), (K,), (K,) arrays
        Circles: centre, radius of the centreline, first and last angle. Lines have a radius of 0.
    by_width : (K,) array
        How much the radius of a centreline grows per metre of marking width.
    own_width_m : (K,) array
        Width of the paint of markings that have one of their own, such as the lines of a rink; 0 of all others.
    placement_sd_m, radius_sd_m : float
        How far painters may put each marking beside its place, along x and along y, and by how much they may draw all
        circles and arcs of one size too large, metres.
    """

    names: tuple[str, ...]
    nodes: Array
    shifts: Array
    stretches: Array
    center: Array
    radius: Array
    first: Array
    last: Array
    by_width: Array
    own_width_m: Array
    placement_sd_m: float = 0.0
    radius_sd_m: float = 0.0

    def places(self, marking: Indices, share: Array, theta: Array) -> Array:
        """Points (M, 2) at a share (M,) of the way along markings (M,), metres, before they move with the field.

        A line that ends at both sides of the field is as long as that has it with the sizes of ``theta`` (P,). A place
        on it is told in metres, not as a share: paint that was measured stays where it is when the field grows. As a
        share it would slide along the line, and where lens or surface bend that, frames of a circle and a halfway line
        told a pitch 68 m wide to be 42.1 +- 6.3 m.
        """
        angle = self.first[marking] + share * (self.last[marking] - self.first[marking])
        on_circle = self.center[marking] + self.radius[marking, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        start, end = self.nodes[marking, 0], self.nodes[marking, -1]
        on_line = (start + share[:, None] * (end - start)) * (1.0 + theta[SIZES[1:]] * self.stretches[marking])
        return np.where(self.radius[marking, None] > 0, on_circle, on_line)

    def widths_m(self, marking: Indices, usual_m: float) -> Array:
        """Width of the paint of markings (M,), metres: the usual one but for those that have one of their own."""
        own = self.own_width_m[marking]
        return np.where(own > 0.0, own, usual_m)

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
    K = len(names)
    center, radius, first, last, by_width = np.zeros((K, 2)), *np.zeros((4, K))
    for k, (circle, (start, end)) in enumerate(zip(round_ones, ends, strict=True)):
        center[k], radius[k] = circle.center, template.radius(circle, "center")
        first[k], last[k] = np.radians(start), np.radians(end)
        by_width[k] = template.radius(circle, "center", 1.0) - template.radius(circle, "center", 0.0)
    stretches = np.array([template.growth_of(marking)[1] for marking in nodes])
    own_width_m = np.array([element.width_m or 0.0 for element in (*round_ones, *template.lines)])
    painters = template.placement_sd_m, template.radius_sd_m
    return DrawnTemplate(names, nodes, shifts, stretches, center, radius, first, last, by_width, own_width_m, *painters)


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
        Place before it moves with the sizes of the field: see :meth:`DrawnTemplate.places`.
    pixels, normals : (M, 2) arrays
        Where it is seen, and the unit vector across the marking.
    width_px, scale_px_m : (M,) arrays
        Width of the paint there, and pixels per metre across the marking.
    slant_px : (M,) array
        How far along the marking its two edges lie apart that face each other on the ground, pixels.
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
    slant_px: Array
    curvature: Array
    by_theta: Array

    def take(self, index: Indices) -> Places:
        """Some of the places, by their numbers (N,)."""
        return Places(*(getattr(self, field.name)[index] for field in fields(self)))

    def offset_middles(self, moved_px: Array) -> Array:
        """How far the middle of the paint, as it is seen across a marking, lies from the marking (M,), along the
        normals, pixels, where the picture moves by ``moved_px`` (2,) while the shutter is open.

        A curve that bends by k lies ``k t^2 / 2`` beside its tangent T, at a distance t along it, on the inner side.
        Edges that face each other on the ground are seen by q apart along the marking, each by ``t = q / 2`` beside the
        profile across it. An even motion by m has a mean t^2 of ``(m . T)^2 / 12``. So the middle lies at
        ``k (q^2 / 4 + (m . T)^2 / 12) / 2``.
        """
        along = self.normals[:, 0] * moved_px[1] - self.normals[:, 1] * moved_px[0]
        return np.asarray(self.curvature * (self.slant_px**2 / 4.0 + along**2 / 12.0) / 2.0)

    def shift_by_blur(self, variance: float) -> Array:
        """How far blur with a variance v, pixels squared, moves the middle of paint across a marking (M,), along the
        normals, pixels: a curve that bends by k lies on average at ``k v / 2`` beside its tangent.
        """
        return np.asarray(self.curvature * variance / 2.0)


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
        Width of the paint of markings that have none of their own, metres.
    spacing_px : float
        Distance of neighbours, pixels at 1920 px width.
    """
    K, N = drawn.nodes.shape[:2]
    unit = model.width / 1920.0
    marking_of = np.repeat(np.arange(K), N)
    flat = drawn.places(marking_of, np.tile(np.linspace(0.0, 1.0, N), K), theta)
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
    field_m = drawn.places(marking, share, theta)
    seen = project(theta[None], grow_places(drawn, marking, field_m, theta)[None], model)
    # along the marking on the ground, and from there in the picture
    direction = drawn.nodes[marking, -1] - drawn.nodes[marking, 0]
    beside = field_m - drawn.center[marking]
    tangent = np.where(drawn.radius[marking, None] > 0, np.stack([-beside[:, 1], beside[:, 0]], -1), direction)
    tangent /= np.maximum(np.hypot(tangent[:, :1], tangent[:, 1:]), 1e-9)
    image = seen.along(tangent[None, :, 0], tangent[None, :, 1])[0].T
    along_px_m = np.maximum(np.hypot(*image.T), 1e-9)
    image /= along_px_m[:, None]
    normals = np.stack([-image[:, 1], image[:, 0]], axis=-1)
    across = seen.along(-tangent[None, :, 1], tangent[None, :, 0])[0].T
    across_px_m = (across * normals).sum(axis=1)
    scale = np.abs(across_px_m)
    widths_m = drawn.widths_m(marking, width_m)
    width_px, slant_px = widths_m * scale, widths_m * np.abs((across * image).sum(axis=1))
    found = seen.pixels[0]
    inside = (found > MARGIN_PX).all(axis=1) & (
        found < (model.width - 1 - MARGIN_PX, model.height - 1 - MARGIN_PX)
    ).all(1)
    inside &= seen.visible[0] & (width_px > FAINTEST_PX) & ~_lie_in_goals(field_m, drawn)
    rows = rows_of(drawn, marking, field_m, seen, normals)
    bend = _curvatures(drawn.radius[marking], across_px_m, along_px_m)
    found_places = marking, field_m, found, normals, width_px, scale, slant_px, bend, rows
    return Places(*(values[inside] for values in found_places))


def _curvatures(radius_m: Array, across_px_m: Array, along_px_m: Array) -> Array:
    """Curvature (M,) of markings in the picture, per pixel, positive towards the normals; 0 of lines, without a radius.

    A map by a homography takes a circle of radius r, which bends by 1 / r, to a curve that bends by
    ``k = det J / (r |J t|^3)``, where J is its derivative and t the tangent: of a point ``(c + r u, 1)`` with
    homogeneous picture X the determinant of X and its first and second derivatives by the angle is ``det(H) r^2``. With
    N and T, the pixels per metre across the marking (M,), positive where the normal points to the centre, and along it
    (M,), ``det J = N T``, so that ``k = N / (r T^2)``.
    """
    is_round = radius_m > 0
    return np.where(is_round, across_px_m / np.maximum(np.where(is_round, radius_m, 1.0) * along_px_m**2, 1e-9), 0.0)


def _lie_in_goals(field_m: Array, drawn: DrawnTemplate) -> Mask:
    """Which places (M, 2) lie between and beside the posts of a goal, whose net and shadow hide the line."""
    end = drawn.nodes[..., 0].max() - BORDER_M
    return np.asarray((np.abs(field_m[:, 0]) > end) & (np.abs(field_m[:, 1]) < GOAL_REACH_M), np.bool_)
