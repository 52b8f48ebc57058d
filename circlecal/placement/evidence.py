"""How far the paint of a picture and the markings that a view shows go together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.picture import Scaling
from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, Mask
from circlecal.placement.camera_batch import Pixels
from circlecal.placement.paint_maps import COLOURS, DIRECTIONS, RidgeMaps, SeenPaint

FINE_SHARE = 0.006
"""Distance from a ridge at which a marking is not explained by it any more, picture widths."""
BREAK_EVEN = 0.4
"""Share of a marking in view that must lie on ridges for it to speak for a camera: players, boards and logos hide the
rest."""
WIDE_M = 0.2
"""Least width of paint whose blue is told."""
LONGEST_STEP = 0.1
"""Between two nodes of an outline, picture widths: more of it counts no more, since what lies between is not known."""
BARE_SHARE = 0.25
"""Share of a marking in view on ridges below which it is not painted there: in right cameras of ten rendered rinks
every straight line has 0.6 or more, in those that took one end of the rink for the other the goal line 0 to 0.08.
"""
RIM_POINTS = 48
"""Of a circle or an arc, all round."""


@dataclass(frozen=True, slots=True)
class Outlines:
    """What a template paints.

    Attributes
    ----------
    nodes : (K, N, 2) array
        Points along each marking, metres.
    colours : (K,) array
        Index of each among :data:`circlecal.placement.paint_maps.COLOURS`.
    is_optional : (K,) array of bool
        Whether it may be the rim of a logo or of a disc, and show no line.
    rims : (C, M, 2) array
        Points all round each circle and arc, metres.
    """

    nodes: Array
    colours: NDArray[np.intp]
    is_optional: Mask
    rims: Array

    @classmethod
    def of(cls, template: FieldTemplate) -> Outlines:
        """Those of a template."""
        round_ones = template.round_ones
        elements = (*round_ones, *template.lines)
        angle = np.linspace(0, 2 * np.pi, RIM_POINTS, endpoint=False)
        return cls(
            nodes=template.outlines[1],
            colours=np.array([COLOURS.index(_colour_of(e.color, template.paint_width(e))) for e in elements]),
            is_optional=np.array([c.fill != "none" for c in round_ones] + [False] * len(template.lines), np.bool_),
            rims=np.array([template.curve_points(c, "center", angle) for c in round_ones]),
        )

    @property
    def has_colours(self) -> bool:
        """Whether the colour of any of them is told apart."""
        return bool(self.colours.any())

    def suit(self, maps: RidgeMaps) -> Outlines:
        """Those whose colours are told where the maps tell colours; any colour else."""
        return self if len(maps.steps) > 1 else replace(self, colours=np.zeros_like(self.colours))

    def thin(self, step: int) -> Outlines:
        """Every so many nodes of each marking."""
        return replace(self, nodes=self.nodes[:, ::step])


def _colour_of(color: str, width_m: float) -> str:
    """How paint of the template's colour looks: narrow blue paint may look like any."""
    if color == "blue" and width_m > WIDE_M:
        return "blue"
    return "other than blue" if color == "red" else "any"


@dataclass(frozen=True, slots=True)
class OutlineSamples:
    """Places along K markings, N on each, as B views show them in a reduced picture.

    Attributes
    ----------
    cell : (B, K, N) array
        Index of colour, direction, row and column in the flat maps of ridges.
    length : (B, K, N) float32
        Length of marking that each stands for, pixels; 0 where the playing surface does not show it.
    tangents : (2, B, K, N) float32
        From place to place along the marking, pixels.
    """

    cell: NDArray[np.intp]
    length: Pixels
    tangents: Pixels

    @property
    def normals(self) -> Pixels:
        """Unit vectors across the marking (2, B, K, N)."""
        along_x, along_y = self.tangents
        scale = np.maximum(np.sqrt(along_x * along_x + along_y * along_y), np.float32(1e-9))
        return np.stack([-along_y, along_x]) / scale


def sample_outlines(pixels: Pixels, ahead: Mask, colours: NDArray[np.intp], region: Mask) -> OutlineSamples:
    """Where markings lie on the maps.

    Parameters
    ----------
    pixels : (2, B, K, N) array
        Places along them, pixels of the reduced picture.
    ahead : (B, K, N) array of bool
        Which lie before the camera.
    colours : (K,) array
        Of the markings.
    region : (h, w) array of bool
        The playing surface.
    """
    along_x, along_y = tangents = np.gradient(pixels, axis=3)
    length = np.minimum(np.sqrt(along_x * along_x + along_y * along_y), np.float32(LONGEST_STEP * region.shape[1]))
    rows, columns = region.shape
    across, down = pixels
    inside = ahead & (across >= 0) & (across <= columns - 1) & (down >= 0) & (down <= rows - 1)
    x, y = (np.rint(np.where(inside, at, np.float32(0.0))).astype(np.int32) for at in (across, down))
    place = (y * columns + x).astype(np.intp)
    length *= inside & region.ravel().take(place)
    turn = np.arctan2(along_x, -along_y) * np.float32(DIRECTIONS / np.pi)  # of the normal
    direction = np.floor(turn).astype(np.int32) & (DIRECTIONS - 1)  # a power of two, far quicker than a remainder
    return OutlineSamples((colours[:, None] * DIRECTIONS + direction) * region.size + place, length, tangents)


def weigh_samples(samples: OutlineSamples, maps: RidgeMaps, is_optional: Mask, reach: float) -> tuple[Array, Array]:
    """Length of markings on ridges beyond break-even (B,), pixels, and share (B,) of what is in view on ridges.

    Parameters
    ----------
    samples : OutlineSamples
        Places along the markings.
    maps : RidgeMaps
        Ridges of the searched picture.
    is_optional : (K,) array of bool
        Which markings count only where they show as a line.
    reach : float
        Distance at which a ridge does not explain a marking any more, pixels.
    """
    return _weigh_lengths(*_measure_markings(samples, maps, is_optional, reach))


def _weigh_lengths(in_view: Array, on_ridges: Array) -> tuple[Array, Array]:
    """What :func:`weigh_samples` tells, from the length of each marking (B, K) in view and on ridges."""
    total, found = in_view.sum(axis=1), on_ridges.sum(axis=1)
    return found - BREAK_EVEN * total, found / np.maximum(total, 1e-9)


def _measure_markings(samples: OutlineSamples, maps: RidgeMaps, is_optional: Mask, reach: float) -> tuple[Array, Array]:
    """Length of each marking in view (B, K), pixels, and that of what lies on ridges; none of those that may show no
    line, and do not.
    """
    explained = maps.distance(samples.cell)
    explained *= np.float32(-1.0 / reach)
    explained += 1.0
    np.maximum(explained, 0.0, out=explained)
    total = np.einsum("bkn->bk", samples.length, dtype=np.float64)
    found = np.einsum("bkn,bkn->bk", samples.length, explained)
    is_left_out = is_optional & (found < BREAK_EVEN * total)
    return np.where(is_left_out, 0.0, total), np.where(is_left_out, 0.0, found)


@dataclass(frozen=True, slots=True)
class ViewEvidence:
    """How far paint and markings of a field that a camera shows go together.

    Attributes
    ----------
    evidence : float
        Length of markings that lie on ridges beyond break-even, picture widths.
    found_share : float
        Share of the markings in view that lie on ridges.
    explained_share : float
        Share of the ridges on circles and lines that were found which lie on markings; 1 where there are none.
    surface_share : float
        Share of the markings in the picture that lie on the playing surface; 1 where there are none.
    bare_widths : float
        Length in view of the longest marking that is not painted there, picture widths; 0 where all are.
    found_widths : float
        Length of the markings in view that lie on ridges, picture widths.
    """

    evidence: float
    found_share: float
    explained_share: float
    surface_share: float = 1.0
    bare_widths: float = 0.0
    found_widths: float = 0.0


def weigh_view(view: FieldView, template: FieldTemplate, paint: SeenPaint) -> ViewEvidence:
    """What speaks for a camera: that what it predicts is painted, and what is painted is predicted."""
    maps = paint.maps
    reach = FINE_SHARE * maps.width
    outlines = Outlines.of(template).suit(maps)
    pixels, ahead = _show_outlines(view, template, outlines, maps.scaling)
    samples, surface_share = _sample_on_surface(pixels, ahead, outlines, maps.region)
    lengths = _measure_markings(samples, maps, outlines.is_optional, reach)
    score, share = _weigh_lengths(*lengths)
    total, found = (part[0] for part in lengths)
    return ViewEvidence(
        float(score[0]) / maps.width,
        float(share[0]),
        _share_on_markings(pixels, ahead, paint.structures.points, maps.region.shape, reach),
        surface_share,
        float(np.where(found < BARE_SHARE * total, total, 0.0).max(initial=0.0)) / maps.width,
        float(found.sum()) / maps.width,
    )


def share_on_surface(view: FieldView, template: FieldTemplate, region: Mask) -> float:
    """Share of the markings in the picture that lie on the playing surface (h, w), at any size; 1 where there are
    none.
    """
    outlines = Outlines.of(template)
    scaling = Scaling(np.array([view.camera.width, view.camera.height]) / region.shape[::-1])
    return _sample_on_surface(*_show_outlines(view, template, outlines, scaling), outlines, region)[1]


def _show_outlines(
    view: FieldView, template: FieldTemplate, outlines: Outlines, scaling: Scaling
) -> tuple[Array, Mask]:
    """Places (K, N, 2) along K markings in a reduced picture, and which of them lie before the camera (K, N)."""
    pixels = view.project(view.grow(outlines.nodes, template))
    ahead = np.array(np.isfinite(pixels).all(axis=-1), np.bool_)
    return scaling.reduce(np.nan_to_num(pixels, nan=-1e6)), ahead


def _sample_on_surface(pixels: Array, ahead: Mask, outlines: Outlines, region: Mask) -> tuple[OutlineSamples, float]:
    """Where the markings of one view lie on the playing surface (h, w), and the share of those in the picture that do;
    1 where there are none.
    """
    planes = np.moveaxis(pixels[None], -1, 0).astype(np.float32)
    samples = sample_outlines(planes, ahead[None], outlines.colours, region)
    in_picture = sample_outlines(planes, ahead[None], outlines.colours, np.ones_like(region)).length
    return samples, float(samples.length.sum() / in_picture.sum()) if in_picture.any() else 1.0


def mean_distance_px(view: FieldView, other: FieldView, template: FieldTemplate) -> float:
    """Mean distance in pixels between the markings that one view shows and where another one shows them."""
    nodes = template.outlines[1].reshape(-1, 2)
    here, there = view.project(nodes), other.project(nodes)
    shown = view.shows(here)
    off = np.linalg.norm(np.nan_to_num(there, nan=1e6) - here, axis=1)
    return float(off[shown].mean()) if shown.any() else np.inf


def _share_on_markings(pixels: Array, ahead: Mask, points: Array, shape: tuple[int, ...], reach: float) -> float:
    """Share of points (N, 2) that lie within reach, pixels, of outlines (K, M, 2)."""
    if len(points) == 0:
        return 1.0
    strip = np.zeros(shape, np.uint8)
    limit = 8 * max(shape)
    for outline, shown in zip(pixels, ahead & (np.abs(pixels) < limit).all(axis=-1), strict=True):
        drawn = np.rint(np.where(shown[:, None], outline, 0.0)).astype(np.int32)
        runs = np.split(drawn, np.flatnonzero(np.diff(shown)) + 1)[1 - int(shown[:1].sum()) :: 2]
        cv2.polylines(strip, [run.reshape(-1, 1, 2) for run in runs], False, 1, thickness=max(1, round(2 * reach)))
    x, y = np.clip(np.rint(points), 0, (shape[1] - 1, shape[0] - 1)).astype(int).T
    return float(strip[y, x].mean())
