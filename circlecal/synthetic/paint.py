"""Exact anti-aliased paint: how much of every pixel each marking covers.

Where paint may be, pixels are carried back to the field through lens and surface; there the signed distance to each
edge of the paint is known in closed form. Divided by its gradient in the picture it is the distance in pixels to an
edge that is straight within a pixel, whose blurred profile is a normal distribution function. Lens and pixel together
are a Gaussian of ``PSF_SIGMA_PX``, applied before sampling: box-filtered pixels would move thin lines by up to 0.1 px.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from circlecal.field import Arc, Circle, FieldTemplate, Line, Mark, unit_circle
from circlecal.formats.soccernet import SEGMENTATION_CLASSES
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface

CLASS_NAMES = ("Background", *SEGMENTATION_CLASSES)
"""SoccerNet class names by id."""
CIRCLE_CLASS, UNKNOWN_LINE_CLASS, HALFWAY_CLASS = 7, 17, 18

PSF_SIGMA_PX = 0.5

_STEP_M, _STEP_RADII = 0.25, 0.04
"""Between two corners of an outline, metres, and radii of a curve: chords of so many leave the rim by 0.0002 radii. Of
the centre circle of a robots' field chords of 0.25 m cut up to 9 mm off paint that is 50 mm wide.
"""
_MARGIN_PX = 120.0
_JACOBIAN_STEP_M = 1e-3
_MARK_SUBPIXELS = 3
_SPARE_PX = 3


@dataclass(frozen=True, slots=True)
class PaintLayer:
    """One marking in the picture.

    Attributes
    ----------
    name, color : str
        Of the template's element.
    class_id : int
        SoccerNet class, 0 for spots.
    rows, columns : (N,) int arrays
        Pixels that it may touch.
    coverage : (N,) array
        Share of each pixel under its paint, 0..1.
    center_distance_px : (N,) array
        Distance of each pixel from the centreline (from the rim, for spots).
    """

    name: str
    color: str
    class_id: int
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    coverage: Array
    center_distance_px: Array


def paint_layers(
    camera: Camera,
    template: FieldTemplate,
    surface: Surface,
    marking_width_m: float,
    skipped: frozenset[str] = frozenset(),
    *,
    widths_m: Mapping[str, float] | None = None,
    elements: Iterable[Circle | Line | Mark] | None = None,
) -> list[PaintLayer]:
    """Layers of every element of the template that the frame shows, but the skipped ones.

    ``widths_m`` names elements that are painted wider or narrower than the others; ``elements`` stand in for those of
    the template.
    """
    layers = []
    for element in _elements(template) if elements is None else elements:
        if element.name in skipped:
            continue
        width_m = (widths_m or {}).get(element.name, template.paint_width(element, marking_width_m))
        rows, columns = _pixels_near(camera, surface, *_outline(template, element, width_m))
        if len(rows) == 0:
            continue
        pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
        subpixels = _MARK_SUBPIXELS if isinstance(element, Mark) else 1
        coverage, distance = _measure_coverage(camera, template, element, surface, width_m, pixels, subpixels)
        layers.append(
            PaintLayer(element.name, element.color, class_id(template, element), rows, columns, coverage, distance)
        )
    return layers


def class_id(template: FieldTemplate, element: Circle | Line | Mark) -> int:
    """SoccerNet class id of an element; elements that SoccerNet does not know get the nearest meaning."""
    if element.class_name in CLASS_NAMES:
        return CLASS_NAMES.index(element.class_name)
    if element.name == template.default_circle:
        return CIRCLE_CLASS
    if element.name == template.halfway_line:
        return HALFWAY_CLASS
    return UNKNOWN_LINE_CLASS if isinstance(element, Line) else 0


def class_mask(layers: list[PaintLayer], width: int, height: int) -> NDArray[np.uint8]:
    """Class ids (H, W) of pixels half covered or on the centreline; the circle over the halfway line over the rest."""
    mask = np.zeros((height, width), dtype=np.uint8)
    rank = {CIRCLE_CLASS: 2, HALFWAY_CLASS: 1}
    for layer in sorted(layers, key=lambda item: rank.get(item.class_id, 0)):
        if layer.class_id:
            marked = (layer.coverage >= 0.5) | ((np.abs(layer.center_distance_px) <= 0.5) & (layer.coverage > 0.05))
            mask[layer.rows[marked], layer.columns[marked]] = layer.class_id
    return mask


def _elements(template: FieldTemplate) -> Iterator[Circle | Line | Mark]:
    """From the bottom to the top: lines are painted on discs."""
    discs = [circle for circle in template.circles if circle.fill == "disc"]
    yield from sorted(discs, key=lambda circle: -circle.radius_m)
    yield from template.lines
    yield from template.arcs
    yield from (circle for circle in template.circles if circle.fill != "disc")
    yield from template.marks


def _outline(template: FieldTemplate, element: Circle | Line | Mark, width_m: float) -> tuple[Array, Array]:
    """Both edges (N, 2) of an element's paint as polylines with the same parameters."""
    if isinstance(element, Line):
        ends = template.line_ends(element, width_m)
        along = ends[1] - ends[0]
        length = float(np.linalg.norm(along))
        center = np.linspace(ends[0], ends[1], max(2, int(np.ceil(length / _STEP_M)) + 1))
        aside = np.array([-along[1], along[0]]) / length * width_m / 2
        return center + aside, center - aside
    if isinstance(element, Mark):
        inner, outer, middle, span = 0.0, element.diameter_m / 2, element.position, (0.0, 360.0)
    else:
        inner, outer = template.radius(element, "inner", width_m), template.radius(element, "outer", width_m)
        inner, middle, span = 0.0 if element.fill == "disc" else inner, element.center, element.span_deg
    first, last = np.radians(span)
    step_rad = min(_STEP_M / outer, _STEP_RADII)
    ring = unit_circle(np.linspace(first, last, int(np.ceil((last - first) / step_rad)) + 1))
    return np.asarray(middle) + outer * ring, np.asarray(middle) + inner * ring


def _pixels_near(
    camera: Camera, surface: Surface, first_m: Array, second_m: Array
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns (N,) of the pixels within a few of the strip between two polylines (N, 2)."""
    first, second = (camera.project(surface.lift(edge)) for edge in (first_m, second_m))
    quads = np.stack([first[:-1], first[1:], second[1:], second[:-1]], axis=1)
    size = np.array([camera.width, camera.height])
    with np.errstate(invalid="ignore"):
        corners_close = np.all((quads > -_MARGIN_PX) & (quads < size + _MARGIN_PX), axis=2)
    chosen = quads[np.any(corners_close, axis=1) & np.isfinite(quads).all(axis=(1, 2))]
    if len(chosen) == 0:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    corners = np.round(np.clip(chosen, -20000, 20000)).astype(np.int32)
    low = np.clip(corners.min(axis=(0, 1)) - _SPARE_PX, 0, size)
    high = np.clip(corners.max(axis=(0, 1)) + _SPARE_PX + 1, low, size)
    near: NDArray[Any] = np.zeros((high - low)[::-1], dtype=np.uint8)
    if near.size:
        cv2.fillPoly(near, list(corners - low.astype(np.int32)), 1)
        near = cv2.dilate(near, np.ones((2 * _SPARE_PX + 1, 2 * _SPARE_PX + 1), dtype=np.uint8))
    rows, columns = np.nonzero(near)
    return rows + low[1], columns + low[0]


def _measure_coverage(
    camera: Camera,
    template: FieldTemplate,
    element: Circle | Line | Mark,
    surface: Surface,
    width_m: float,
    pixels: Array,
    subpixels: int,
) -> tuple[Array, Array]:
    """Coverage (N,) of pixels (N, 2), and their distance (N,) from the centreline in pixels."""
    shift = (np.arange(subpixels) + 0.5) / subpixels - 0.5
    offsets = np.stack(np.meshgrid(shift, shift), axis=-1).reshape(-1, 1, 2)
    spots = (pixels[None] + offsets).reshape(-1, 2)
    field = camera.back_project(spots, surface)
    ground = np.asarray(np.isfinite(field).all(axis=1))
    field = np.where(ground[:, None], field, 0.0)
    gradient = _Gradient(_inverse_jacobian(camera, surface, field))
    if isinstance(element, Line):
        share, center = _line_share(template.line_ends(element, width_m), width_m, field, gradient)
    elif isinstance(element, Mark):
        share, center = _disc_share(np.asarray(element.position), element.diameter_m / 2, field, gradient)
    else:
        share, center = _ring_share(template, element, width_m, field, gradient)
    share = np.where(ground & np.isfinite(share), share, 0.0).reshape(len(offsets), -1).mean(axis=0)
    return np.asarray(share), np.where(ground, center, np.inf).reshape(len(offsets), -1).mean(axis=0)


@dataclass(frozen=True, slots=True)
class _Gradient:
    """Turns signed distances on the field into shares of pixels; ``J_inverse`` (N, 2, 2) is d field / d pixel."""

    J_inverse: Array

    def distance_px(self, signed_m: Array, gradient_m: Array) -> Array:
        """Distance (N,) in pixels from a signed distance (N,) on the field with the gradient (N, 2) or (2,) there."""
        gradient = np.broadcast_to(gradient_m, (len(self.J_inverse), 2))
        slope = np.linalg.norm(np.einsum("nij,ni->nj", self.J_inverse, gradient), axis=1)
        return np.asarray(signed_m / np.maximum(slope, 1e-12))

    def share(self, inside_m: Array, gradient_m: Array) -> Array:
        """Share (N,) of each pixel where a signed distance (N,) with this gradient is positive."""
        return np.asarray(ndtr(self.distance_px(inside_m, gradient_m) / PSF_SIGMA_PX))


def _inverse_jacobian(camera: Camera, surface: Surface, field_m: Array) -> Array:
    """d field / d pixel (N, 2, 2) at field points (N, 2), by central differences of the projection."""
    step = np.eye(2) * _JACOBIAN_STEP_M
    columns = [
        (camera.project(surface.lift(field_m + s)) - camera.project(surface.lift(field_m - s))) / (2 * _JACOBIAN_STEP_M)
        for s in step
    ]
    (a, c), (b, d) = (column.T for column in columns)
    with np.errstate(divide="ignore", invalid="ignore"):
        adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], -2)
        return np.asarray(adjugate / (a * d - b * c)[:, None, None])


def _line_share(ends: Array, width_m: float, field: Array, gradient: _Gradient) -> tuple[Array, Array]:
    length = float(np.linalg.norm(ends[1] - ends[0]))
    along = (ends[1] - ends[0]) / length
    aside = np.array([-along[1], along[0]])
    t, across = (field - ends[0]) @ along, (field - ends[0]) @ aside
    band = gradient.share(across + width_m / 2, aside) - gradient.share(across - width_m / 2, aside)
    cap = gradient.share(t, along) - gradient.share(t - length, along)
    return band * cap, gradient.distance_px(across, aside)


def _disc_share(center: Array, radius: float, field: Array, gradient: _Gradient) -> tuple[Array, Array]:
    offset = field - center
    distance = np.linalg.norm(offset, axis=1)
    outward = np.where(distance[:, None] > 1e-9, offset / np.maximum(distance, 1e-9)[:, None], np.array([1.0, 0.0]))
    # the opposite rim matters for spots that are no wider than the blur
    share = gradient.share(radius - distance, outward) + gradient.share(radius + distance, outward) - 1.0
    return share, gradient.distance_px(distance - radius, outward)


def _ring_share(
    template: FieldTemplate, element: Circle, width_m: float, field: Array, gradient: _Gradient
) -> tuple[Array, Array]:
    center = np.asarray(element.center)
    outer, rim = _disc_share(center, template.radius(element, "outer", width_m), field, gradient)
    if element.fill == "disc":
        return outer, rim
    inner, _ = _disc_share(center, template.radius(element, "inner", width_m), field, gradient)
    band = outer - inner
    middle = _disc_share(center, template.radius(element, "center", width_m), field, gradient)[1]
    if not isinstance(element, Arc):
        return band, middle
    gates = []
    for angle, sign in ((np.radians(element.start_deg), 1.0), (np.radians(element.end_deg), -1.0)):
        normal = sign * np.array([-np.sin(angle), np.cos(angle)])
        gates.append(gradient.share((field - center) @ normal, normal))
    if element.end_deg - element.start_deg <= 180.0:
        return band * gates[0] * gates[1], middle
    return band * (1.0 - (1.0 - gates[0]) * (1.0 - gates[1])), middle
