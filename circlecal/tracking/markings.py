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
    stretches : (K, 2) array
        By how much each metre of its coordinates stretches per metre of length and of width of the field.
    center, radius, first, last : (K, 2), (K,), (K,), (K,) arrays
        Circles: centre, radius of the centreline, first and last angle. Lines have a radius of 0.
    by_width : (K,) array
        How much the radius of a centreline grows per metre of marking width.
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
    stretches = np.array([template.growth_of(marking)[1] for marking in nodes])
    return DrawnTemplate(names, nodes, shifts, stretches, center, radius, first, last, by_width)


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

    def take(self, index: Indices) -> Places:
        """Some of the places, by their numbers (N,)."""
        return Places(*(getattr(self, field.name)[index] for field in fields(self)))

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
