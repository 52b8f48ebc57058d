"""What stands out from a playing surface as paint does, as maps of the nearest ridge of each direction and colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.options import DetectorConfig
from circlecal.detection.picture import Scaling, reduce_picture
from circlecal.detection.ridges import RidgePoints, find_ridges
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, Mask
from circlecal.results import MarkingMask

DIRECTIONS = 8
"""Maps of ridges by direction, a power of two; a ridge is in the map of its own and of both neighbouring ones."""
COLOURS = ("any", "blue", "other than blue")
"""Of ridges that are told apart. Pictures hold colours at half their resolution, so thin red paint looks gray (in three
rinks blue stood out by 24 to 48 levels on wide blue lines, red by 1 to 11 on circles of 2 in).
"""
BESIDE_PX, LEAST_COLOUR, COLOUR_SHARE = 10.0, 10.0, 0.2
"""Distance from a ridge at which the surface is looked at, pixels of the searched picture; grey levels, and share of
what the paint changes most, by which blue must stand out from the mean of green and red.
"""
SEARCH_WIDTH_PX = 960
"""Width of the searched picture (does not scale), where the detector's own is not smaller. At 720 far lines of 2 in are
lost: four of ten frames with them.
"""
ICE_THRESHOLD = 2.0
"""Ridge threshold on ice, in medians of the response: thin lines of the far half count. Of six rendered rinks that were
refused at 4 the true camera has 0.3 to 0.6 picture widths more evidence; on floors the grain of the wood then
outweighs the lines.
"""
STEPS_PER_PX = 2048
FARTHEST_PX = (2**16 - 1) / STEPS_PER_PX
"""Steps in which a map holds distances, and the largest distance, 32 pixels of the searched picture: beyond 0.03 of its
width of at most 960 no ridge counts. Half the memory, whose pages cost more than the distances: of a rink 0.2 s of
0.32.
"""
STRUCTURE_PX = 2.5
"""From a circle or a line within which a ridge belongs to it, pixels of the searched picture."""
SAME_CIRCLE = 0.06
"""Share of the great half axis by which centre and axes of one seen circle may differ."""


@dataclass(frozen=True, slots=True)
class RidgeMaps:
    """Where the nearest ridge of each direction is, in a reduced picture of (h, w) pixels.

    Attributes
    ----------
    steps : (C, D, h, w) uint16
        Its distance for each of :data:`COLOURS`, in :data:`STEPS_PER_PX`; without meaning in rows that hold neither
        surface nor ridges.
    label : (C, D, h, w) array of int
        Its index among ``places``.
    places : (N, 2) float32
        Pixels of ridges.
    region : (h, w) bool
        The playing surface.
    scaling : Scaling
        Way back to the full picture.
    """

    steps: NDArray[np.uint16]
    label: NDArray[np.unsignedinteger]
    places: NDArray[np.float32]
    region: Mask
    scaling: Scaling

    @property
    def width(self) -> int:
        """Pixels of the reduced picture."""
        return int(self.region.shape[1])

    def distance(self, cell: NDArray[np.intp]) -> NDArray[np.float32]:
        """Pixels to the nearest ridge at indices in the flat maps; those beyond :data:`FARTHEST_PX` are this."""
        return np.multiply(self.steps.ravel().take(cell), np.float32(1.0 / STEPS_PER_PX), dtype=np.float32)

    def nearest(self, cell: NDArray[np.intp]) -> NDArray[np.float32]:
        """Pixel (..., 2) of the nearest ridge at indices in the flat maps."""
        return self.places.take(self.label.ravel().take(cell), axis=0)


@dataclass(frozen=True, slots=True)
class SurfaceRidges:
    """All that stands out from a playing surface as paint of one polarity does, in a reduced picture.

    Attributes
    ----------
    ridges : RidgePoints
        Pixels of the reduced picture.
    colours : (C, N) array of bool
        Which ridges may be each of :data:`COLOURS`.
    maps : RidgeMaps
        Of all ridges.
    """

    ridges: RidgePoints
    colours: Mask
    maps: RidgeMaps


@dataclass(frozen=True, slots=True)
class SeenPaint:
    """What stands out from a playing surface as paint does, and what of it is painted most surely.

    Attributes
    ----------
    surface : SurfaceRidges
        All that stands out.
    conics : tuple of (3, 3) arrays
        Circles that were found, each once, pixels of the full picture.
    is_structure : (N,) array of bool
        Which ridges lie on circles and straight lines that were found.
    are_rims : bool
        Whether those circles are rims of logos, which no other circle of the field can be.
    """

    surface: SurfaceRidges
    conics: tuple[Array, ...]
    is_structure: Mask
    are_rims: bool = False

    @property
    def key(self) -> tuple[object, ...]:
        """What tells it from other paint of the same picture."""
        circles = tuple(conic.tobytes() for conic in self.conics)
        return id(self.surface), circles, np.packbits(self.is_structure).tobytes(), self.are_rims

    @property
    def maps(self) -> RidgeMaps:
        """Of all ridges."""
        return self.surface.maps

    @property
    def structures(self) -> RidgePoints:
        """Ridges on circles and straight lines that were found."""
        return self.surface.ridges.take(self.is_structure)

    def map_structures(self) -> RidgeMaps:
        """Maps of the ridges on circles and straight lines that were found."""
        maps = self.surface.maps
        return _map_ridges(self.structures, maps.region, maps.scaling, self.surface.colours[:, self.is_structure])


def see_surface(
    image: NDArray[np.uint8],
    gray: NDArray[np.uint8],
    mask: MarkingMask,
    config: DetectorConfig,
    has_colours: bool = True,
) -> SurfaceRidges | None:
    """The ridges of the playing surface of a mask; None where it has no surface, or nothing stands out from it.

    Parameters
    ----------
    image, gray : (H, W, 3), (H, W) uint8
        The picture and its brightness.
    mask : MarkingMask
        What the detector found, of which surface and polarity are used.
    config : DetectorConfig
        Options of the detector.
    has_colours : bool
        Whether colours of paint are told apart; else there is the first of :data:`COLOURS` alone.
    """
    if mask.field_region is None:
        return None
    sign = 1.0 if mask.polarity is None else mask.polarity
    hull = mask.field_region.astype(np.uint8) * 255
    ridges, region, scaling = _find_paint(gray, hull, sign, config)
    if len(ridges) == 0:
        return None
    colours = _tell_colours(image, ridges, scaling) if has_colours else np.ones((1, len(ridges)), np.bool_)
    return SurfaceRidges(ridges, colours, _map_ridges(ridges, region, scaling, colours))


def see_paint(surface: SurfaceRidges, mask: MarkingMask) -> SeenPaint:
    """The paint on a playing surface, of which what lies on the circles and lines of a mask is painted most surely."""
    scaling = surface.maps.scaling
    halfway = () if mask.halfway is None else (mask.halfway,)
    segments = np.array([(s.start, s.end) for s in (*mask.lines, *halfway)]).reshape(-1, 2, 2)
    conics = tuple(distinct_circles(mask))
    reduced = [scaling.reduce_conic(conic) for conic in conics]
    return SeenPaint(surface, conics, _lie_on_structures(surface.ridges, reduced, scaling.reduce(segments)))


def add_rims(
    paint: SeenPaint, relief: NDArray[np.uint8], mask: MarkingMask, rims: Sequence[Array], config: DetectorConfig
) -> SeenPaint:
    """The paint with what lies on rims of logos in the place of its circles, as painted as a line.

    Parameters
    ----------
    paint : SeenPaint
        What stands out from the surface of a mask.
    relief : (H, W) uint8
        The picture with lines and edges as light bands.
    mask : MarkingMask
        What the detector found, of which the surface is used.
    rims : sequence of (3, 3) arrays
        Rims of logos, pixels of the full picture.
    config : DetectorConfig
        Options of the detector.
    """
    if mask.field_region is None:
        return paint
    ridges, region, scaling = _find_paint(relief, mask.field_region.astype(np.uint8) * 255, 1.0, config)
    on = _lie_on_structures(ridges, [scaling.reduce_conic(conic) for conic in rims], np.zeros((0, 2, 2)))
    old, new = paint.surface, ridges.take(on)
    both = old.ridges.join(new)
    colours = np.concatenate([old.colours, np.ones((len(old.colours), len(new)), np.bool_)], axis=1)
    surface = SurfaceRidges(both, colours, _map_ridges(both, region, scaling, colours))
    is_structure = np.concatenate([paint.is_structure, np.ones(len(new), np.bool_)])
    return SeenPaint(surface, tuple(rims), is_structure, are_rims=True)


def distinct_circles(mask: MarkingMask) -> list[Array]:
    """The circles, arcs and candidates (3, 3) of a mask, each once, in pixels of the full picture."""
    seen = (
        *(() if mask.conic is None else (mask.conic,)),
        *(a.conic for a in mask.arcs),
        *(c.conic for c in mask.candidates),
    )
    kept: list[Array] = []
    shapes: list[Array] = []
    for conic in seen:
        ellipse = ellipse_from_conic(conic)
        if ellipse is None:
            continue
        shape = np.r_[ellipse.center, ellipse.semi_axes]
        if all(np.abs(shape - other).max() > SAME_CIRCLE * shape[2] for other in shapes):
            shapes.append(shape)
            kept.append(conic)
    return kept


def _find_paint(
    gray: NDArray[np.uint8], hull: NDArray[np.uint8], sign: float, config: DetectorConfig
) -> tuple[RidgePoints, Mask, Scaling]:
    """Ridges of a reduced picture (H, W) on the playing surface (h, w), 255, at any size; the surface there, and the
    way back to the full picture. Markings are lighter than the surface, +1, or darker, -1.
    """
    width = min(SEARCH_WIDTH_PX, config.detection_width_px)
    reduced, scaling = reduce_picture(gray, width, width)
    rows, columns = reduced.shape
    region = np.asarray(cv2.resize(hull, (columns, rows), interpolation=cv2.INTER_NEAREST), np.uint8)
    options = config.ridges
    if config.field_region.light:
        options = options.model_copy(update={"threshold": min(options.threshold, ICE_THRESHOLD)})
    return find_ridges(reduced, region, sign, options), region > 0, scaling


def _lie_on_structures(ridges: RidgePoints, conics: Sequence[Array], segments: Array) -> Mask:
    """Which ridges (N,) lie on circles or straight lines that were found, (3, 3) and (K, 2, 2) in the same picture:
    what is painted, mostly, without legs and letters.
    """
    on = np.zeros(len(ridges), np.bool_)
    for conic in conics:
        on |= np.abs(sampson_distance(conic, ridges.points)) < STRUCTURE_PX
    for start, end in segments:
        span = end - start
        length = np.linalg.norm(span)
        offset = ridges.points - start
        along = offset @ span / length
        beside = np.abs(offset @ np.array([-span[1], span[0]])) / length
        on |= (beside < STRUCTURE_PX) & (along > -STRUCTURE_PX) & (along < length + STRUCTURE_PX)
    return on


def _tell_colours(image: NDArray[np.uint8], ridges: RidgePoints, scaling: Scaling) -> Mask:
    """Which ridges (N,) may be each of :data:`COLOURS` (C, N), by what they add to the colours beside them."""
    places = scaling.full(ridges.points)
    beside = BESIDE_PX * float(scaling.factor.mean())
    height, width = image.shape[:2]

    def at(points: Array) -> Array:
        x, y = np.clip(np.rint(points), 0, (width - 1, height - 1)).astype(np.intp).T
        return image[y, x].astype(np.float64)

    added = at(places) - 0.5 * (at(places + beside * ridges.normals) + at(places - beside * ridges.normals))
    blue, green, red = added.T
    least = np.maximum(LEAST_COLOUR, COLOUR_SHARE * np.abs(added).max(axis=1))
    bluish = blue - 0.5 * (green + red) > least
    return np.array([np.ones(len(ridges), np.bool_), bluish, ~bluish])


def _map_ridges(ridges: RidgePoints, region: Mask, scaling: Scaling, colours: Mask) -> RidgeMaps:
    """Maps of ridges on a playing surface (h, w), for each colour that they may have (C, N)."""
    rows, columns = region.shape
    x, y = np.clip(np.rint(ridges.points), 0, (columns - 1, rows - 1)).astype(int).T
    direction = np.floor(np.arctan2(*ridges.normals.T[::-1]) % np.pi * (DIRECTIONS / np.pi)).astype(int)
    # nothing is looked up in rows without surface and ridges
    used = np.asarray(region.any(axis=1), np.bool_)
    used[y] = True
    filled = np.flatnonzero(used)
    band = slice(int(filled[0]), int(filled[-1]) + 1) if len(filled) else slice(0, 0)
    steps = np.zeros((len(colours), DIRECTIONS, rows, columns), np.uint16)
    label = np.zeros(steps.shape, np.min_scalar_type(len(ridges)))
    told = range(1, len(colours)) if len(colours) > 1 else range(1)
    for k in range(DIRECTIONS):
        around = (direction - k + 1) % DIRECTIONS < 3
        for c in told:
            near = np.flatnonzero(colours[c] & around)
            _map_nearest(x[near], y[near] - band.start, near, steps[c, k, band], label[c, k, band])
        if len(told) > 1:
            # the nearest of any colour is the nearer one of those that are told apart
            steps[0, k, band], label[0, k, band] = steps[told[0], k, band], label[told[0], k, band]
            for c in told[1:]:
                is_nearer = steps[c, k, band] < steps[0, k, band]
                np.copyto(steps[0, k, band], steps[c, k, band], where=is_nearer)
                np.copyto(label[0, k, band], label[c, k, band], where=is_nearer)
    return RidgeMaps(steps, label, np.stack([x, y], axis=-1).astype(np.float32), region, scaling)


def _map_nearest(
    x: NDArray[np.intp],
    y: NDArray[np.intp],
    names: NDArray[np.intp],
    steps: NDArray[np.uint16],
    label: NDArray[np.unsignedinteger],
) -> None:
    """Fill maps (h, w) of the distance of the nearest of some pixels (N,), and of its name."""
    if len(names) == 0:
        steps[:] = np.iinfo(np.uint16).max
        return
    free = np.ones(steps.shape, np.uint8)
    free[y, x] = 0
    distance, numbered = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    np.minimum(distance, FARTHEST_PX, out=distance)
    np.multiply(distance, STEPS_PER_PX, out=steps, casting="unsafe")
    number = numbered[y, x]
    name_of = np.zeros(int(number.max()) + 1, label.dtype)
    name_of[number] = names
    label[:] = name_of.take(np.asarray(numbered, np.int32))
