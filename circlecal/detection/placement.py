"""Which circle of the field a circle in the picture is, and how the field lies about it, told by everything else that
is painted.

A circle that is seen and a focal length leave two planes (the circular sections of the cone over its image), and on
each the field may be turned about the circle. So every circle in the picture is taken for every circle and arc of the
field, with many focal lengths and turns; under each such camera the template is laid over the ridges of the picture,
and the one whose markings lie on ridges of their direction wins. Neither a halfway line nor a centre circle is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.options import DetectorConfig
from circlecal.detection.picture import Scaling, reduce_picture
from circlecal.detection.ridges import RidgePoints, find_ridges
from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, lens_factor, pan_tilt_roll
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array, Mask, lift
from circlecal.results import MarkingMask

DIRECTIONS = 8
"""Maps of ridges by direction; a ridge is in the map of its own and of both neighbouring ones."""
FOCAL_WIDTHS, FOCALS = (0.6, 8.0), 16
"""Range of the focal length, picture widths, and how many between, at equal ratios."""
TURN_DEG = 2.5
"""Between two turns of the field about a circle."""
LARGEST_ROLL_DEG, ROLL_SD_DEG = 8.0, 2.0
"""Of the cameras that are tried, and of a broadcast's camera."""
HEIGHT_M = (0.3, 80.0)
"""Of the cameras that are tried above the ground."""
COARSE_SHARE, MIDDLE_SHARE, FINE_SHARE = 0.03, 0.012, 0.006
"""Distance from a ridge at which a marking is not explained by it any more, picture widths: of the first cameras, whose
turn is off by half a step, after their first fit, and after the last."""
COLOURS = ("any", "blue", "other than blue")
"""Of ridges that are told apart. Pictures hold colours at half their resolution, so thin red paint looks gray (in three
rinks blue stood out by 24 to 48 levels on wide blue lines, red by 1 to 11 on circles of 2 in).
"""
WIDE_M = 0.2
"""Least width of paint whose colour is told."""
BESIDE_PX, LEAST_COLOUR, COLOUR_SHARE = 10.0, 10.0, 0.2
"""Distance from a ridge at which the surface is looked at, pixels of the searched picture; grey levels, and share of
what the paint changes most, by which blue must stand out from the mean of green and red.
"""
SEARCH_WIDTH_PX = 960
"""Width of the searched picture (does not scale), where the detector's own is not smaller. At 720 far lines of 2 in are
lost: four of ten frames with them.
"""
STRUCTURE_PX = 2.5
"""From a circle or a line within which a ridge belongs to it, pixels of the searched picture."""
BREAK_EVEN = 0.4
"""Share of a marking in view that must lie on ridges for it to speak for a camera: players, boards and logos hide the
rest."""
FOLLOWED, FIRST_KEPT, KEPT = 4000, 400, 40
"""Best cameras, of which so many different ones are fitted to what is surely painted, and so many of these to all."""
ALIKE_WIDTHS = 0.04
"""Two cameras that put the field's nearest markings within this share of the picture's width are one."""
FIRST_ROUNDS, ROUNDS = 5, 10
"""Of the first and the last fit, in which the reach shrinks from one of these distances to the next."""
OWN_PX, RIDGE_PX = 1.0, 1.5
"""Standard deviations of the circle and of ridges under the fit, pixels of the searched picture."""
LARGEST_LENS, FURTHEST_LENS = 0.15, 4.0
"""Largest distortion of the lens, and the squared distance from the middle, half widths, up to which it grows."""
LENS, LENS_SD = 0.025, 0.03
"""Radial distortion with which cameras start, in half widths of the picture, and its standard deviation about 0 in the
fit: 18 reference cameras of other sports have -0.02 to 0.09, which moves far lines by up to 30 px of the searched
picture.
"""
STEP = 1e-5
"""Of the numerical derivatives: radians, logarithm of the focal length, shares of the distance."""
COARSE_NODES = 4
"""Every so many nodes of an outline are looked at for the first cameras."""
MOST_CIRCLES, SAME_CIRCLE = 5, 0.06
"""Seen circles from which cameras start; share of the great half axis by which centre and axes of one may differ."""


@dataclass(frozen=True, slots=True)
class RidgeMaps:
    """Where the nearest ridge of each direction is, in a reduced picture of (h, w) pixels.

    Attributes
    ----------
    distance : (C, D, h, w) float32
        Distance in pixels, for each of :data:`COLOURS`.
    label : (C, D, h, w) int32
        Index of the ridge's pixel among ``places``.
    places : (M, 2) array
        Pixels of ridges.
    region : (h, w) bool
        The playing surface.
    scaling : Scaling
        Way back to the full picture.
    """

    distance: NDArray[np.float32]
    label: NDArray[np.int32]
    places: Array
    region: Mask
    scaling: Scaling

    @property
    def width(self) -> int:
        """Pixels of the reduced picture."""
        return int(self.distance.shape[3])


@dataclass(frozen=True, slots=True)
class PlacedField:
    """A field before a camera that a seen circle led to.

    Attributes
    ----------
    circle : Circle
        What the seen circle is taken for.
    conic : (3, 3) array
        The seen circle, pixels of the full picture.
    view : FieldView
        Where the full picture shows the field.
    evidence : float
        Length of markings that lie on ridges beyond break-even, picture widths.
    found_share : float
        Share of the markings in view that lie on ridges.
    """

    circle: Circle
    conic: Array
    view: FieldView
    evidence: float
    found_share: float


@dataclass(frozen=True, slots=True)
class _Cameras:
    """B cameras: rotations (B, 3, 3) and shifts (B, 3) from the field to the camera, logarithms of focal lengths (B,)
    and lenses (B,), which circle of the template (B,) and of the picture (B,) each came from.
    """

    rotation: Array
    shift: Array
    log_focal: Array
    lens: Array
    own: NDArray[np.intp]
    seen: NDArray[np.intp]

    def take(self, index: NDArray[np.intp]) -> _Cameras:
        return _Cameras(*(getattr(self, name)[index] for name in _Cameras.__slots__))

    def homographies(self, center: Array) -> Array:
        """Field to pixels (B, 3, 3), positive depth before the camera."""
        columns = np.stack([self.rotation[:, :, 0], self.rotation[:, :, 1], self.shift], axis=-1)
        focal = np.exp(self.log_focal)[:, None]
        x = focal * columns[:, 0] + center[0] * columns[:, 2]
        y = focal * columns[:, 1] + center[1] * columns[:, 2]
        return np.stack([x, y, columns[:, 2]], axis=1)

    def project(self, points: Array, middle: Array) -> tuple[Array, Mask]:
        """Pixels (B, N, 2) of field points (N, 2) in a picture about its middle, and which lie before the camera."""
        pixels, ahead = _project(self.homographies(middle), points)
        return self.bend(pixels, middle), ahead

    def bend(self, pixels: Array, middle: Array) -> Array:
        """Pixels (B, N, 2) as the lenses show them."""
        offset = pixels - middle
        r2 = np.sum(offset * offset, axis=-1) / (middle[0] + 0.5) ** 2
        factor, _ = lens_factor(np.minimum(r2, FURTHEST_LENS), self.lens[:, None], 0.0)
        return np.asarray(offset * factor[..., None] + middle)

    def view(self, index: int, size: tuple[int, int], scaling: Scaling) -> FieldView:
        """What one of them shows in the full picture of ``size`` (width, height)."""
        camera = Camera(
            *size,
            focal_px=np.exp(self.log_focal[index]) * scaling.factor,
            principal_point_px=(np.array(size) - 1) / 2,
            angles_rad=np.array(pan_tilt_roll(self.rotation[index])),
            position_m=-self.rotation[index].T @ self.shift[index],
            kappa=np.array([self.lens[index], 0.0]),
        )
        return FieldView(camera)


def find_paint(
    gray: NDArray[np.uint8], hull: NDArray[np.uint8], signs: Sequence[float], config: DetectorConfig
) -> tuple[RidgePoints, Mask, Scaling]:
    """Ridges of a reduced picture on the playing surface, the surface there, and the way back to the full picture.

    Parameters
    ----------
    gray : (H, W) uint8
        Brightness.
    hull : (h, w) uint8
        The playing surface, 255, at any size.
    signs : sequence of float
        +1 for markings lighter than the surface, -1 for darker ones, or both.
    config : DetectorConfig
    """
    width = min(SEARCH_WIDTH_PX, config.detection_width_px)
    reduced, scaling = reduce_picture(gray, width, width)
    rows, columns = reduced.shape
    region = np.asarray(cv2.resize(hull, (columns, rows), interpolation=cv2.INTER_NEAREST), np.uint8)
    found = [find_ridges(reduced, region, sign, config.ridges) for sign in signs]
    ridges = RidgePoints(*(np.concatenate([getattr(r, n) for r in found]) for n in RidgePoints.__slots__))
    return ridges, region > 0, scaling


def select_structures(ridges: RidgePoints, conics: Sequence[Array], segments: Array) -> RidgePoints:
    """The ridges that lie on circles or straight lines that were found, (3, 3) and (K, 2, 2) in the same picture: what
    is painted, mostly, without legs and letters.
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
    return RidgePoints(ridges.points[on], ridges.normals[on], ridges.chain[on])


def tell_colours(image: NDArray[np.uint8], ridges: RidgePoints, scaling: Scaling) -> Mask:
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


def map_ridges(ridges: RidgePoints, region: Mask, scaling: Scaling, colours: Mask) -> RidgeMaps:
    """Maps of ridges on a playing surface (h, w), for each colour that they may have (C, N)."""
    rows, columns = region.shape
    direction = np.floor(np.arctan2(*ridges.normals.T[::-1]) % np.pi * (DIRECTIONS / np.pi)).astype(int)
    distance = np.full((len(colours), DIRECTIONS, rows, columns), columns, np.float32)
    label = np.zeros(distance.shape, np.int32)
    places = [np.zeros((1, 2))]
    x, y = np.clip(np.rint(ridges.points), 0, (columns - 1, rows - 1)).astype(int).T
    for c, k in np.ndindex(len(colours), DIRECTIONS):
        near = colours[c] & np.isin((direction - k + 1) % DIRECTIONS, (0, 1, 2))
        if not near.any():
            continue
        free = np.ones((rows, columns), np.uint8)
        free[y[near], x[near]] = 0
        away, nearest = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
        at = np.argwhere(free == 0)
        place = np.zeros((len(at) + 1, 2))
        place[nearest[at[:, 0], at[:, 1]]] = at[:, ::-1]
        distance[c, k] = away
        np.add(nearest, sum(len(part) for part in places), out=label[c, k])
        places.append(place)
    return RidgeMaps(distance, label, np.concatenate(places), region, scaling)


@dataclass(frozen=True, slots=True)
class SeenPaint:
    """What stands out from a playing surface as paint does, in a reduced picture.

    Attributes
    ----------
    structures : RidgePoints
        Ridges on circles and straight lines that were found.
    drawn, maps : RidgeMaps
        Of these, and of all ridges.
    """

    structures: RidgePoints
    drawn: RidgeMaps
    maps: RidgeMaps


def see_paint(
    image: NDArray[np.uint8], gray: NDArray[np.uint8], mask: MarkingMask, config: DetectorConfig
) -> SeenPaint | None:
    """The paint on the playing surface; None where there is neither.

    Parameters
    ----------
    image, gray : (H, W, 3), (H, W) uint8
        The picture and its brightness.
    mask : MarkingMask
        What the detector found.
    config : DetectorConfig
        Options of the detector.
    """
    if mask.field_region is None:
        return None
    sign = 1.0 if mask.polarity is None else mask.polarity
    hull = mask.field_region.astype(np.uint8) * 255
    ridges, region, scaling = find_paint(gray, hull, (sign,), config)
    if len(ridges) == 0:
        return None
    into = _into_full(scaling)
    halfway = () if mask.halfway is None else (mask.halfway,)
    segments = np.array([(s.start, s.end) for s in (*mask.lines, *halfway)]).reshape(-1, 2, 2)
    segments = (segments + 0.5) / scaling.factor - 0.5
    structures = select_structures(ridges, [into.T @ conic @ into for conic in _distinct_circles(mask)], segments)
    drawn, maps = (
        map_ridges(found, region, scaling, tell_colours(image, found, scaling)) for found in (structures, ridges)
    )
    return SeenPaint(structures, drawn, maps)


@dataclass(frozen=True, slots=True)
class RoughPlacements:
    """Ways to lay a field over a picture after a search among all cameras, before the last fit.

    Attributes
    ----------
    template : FieldTemplate
        The field that was laid.
    conics : tuple of (3, 3) arrays
        Circles that were seen, pixels of the full picture.
    cameras : _Cameras
        The likeliest of clearly different ones.
    """

    template: FieldTemplate
    conics: tuple[Array, ...]
    cameras: _Cameras

    def suit(self, template: FieldTemplate) -> _Cameras:
        """The cameras before a field of other sizes: each sees the circle that lies nearest to its own one there."""
        if template is self.template:
            return self.cameras
        here, there = ((*field.circles, *field.arcs) for field in (self.template, template))
        old, new = (np.array([circle.center for circle in circles], np.float64) for circles in (here, there))
        match = np.linalg.norm(old[:, None] - new, axis=-1).argmin(axis=1)
        radii = [
            template.radius(there[k], "center") / self.template.radius(circle, "center")
            for circle, k in zip(here, match.tolist(), strict=True)
        ]
        cameras = self.cameras
        own = match[cameras.own]
        axes = cameras.rotation[:, :, :2]
        center = cameras.shift + np.einsum("bij,bj->bi", axes, old[cameras.own])
        scale = np.array(radii)[cameras.own, None]
        return replace(cameras, shift=scale * center - np.einsum("bij,bj->bi", axes, new[own]), own=own)


def search_placements(
    mask: MarkingMask, paint: SeenPaint, size: tuple[int, int], template: FieldTemplate, side: str
) -> RoughPlacements | None:
    """The likeliest ways to lay a field over a picture among all that its circles allow; None where there is none.

    Parameters
    ----------
    mask : MarkingMask
        What the detector found.
    paint : SeenPaint
        What stands out from the playing surface; cameras are chosen by what is surely painted first.
    size : (int, int)
        Width and height of the picture.
    template : FieldTemplate
        The field.
    side : str
        Side of the field from which the camera looks.
    """
    conics, maps = tuple(_distinct_circles(mask)[:MOST_CIRCLES]), paint.maps
    if not conics:
        return None
    small, middle, circles = (
        _move_conics(conics, maps.scaling),
        _middle_of(size, maps.scaling),
        _round_ones(template),
    )
    cameras = _cameras_before_circles(small, circles, template, maps.width, middle, side)
    if cameras is None:
        return None
    _, nodes, _ = template.outlines
    few, colours = nodes[:, ::COARSE_NODES], _colours_of(template)
    rough = COARSE_SHARE * maps.width * np.geomspace(1.0, MIDDLE_SHARE / COARSE_SHARE, FIRST_ROUNDS)
    optional = _need_no_line(template)
    score = _score(cameras, few, colours, optional, paint.drawn, middle, rough[0])[0]
    best = cameras.take(_distinct(cameras, score, middle, nodes, maps, FOLLOWED, FIRST_KEPT))
    best = _fit(best, small, circles, template, few, colours, paint.drawn, middle, rough)
    score = _score(best, few, colours, optional, maps, middle, rough[-1])[0]
    return RoughPlacements(template, conics, best.take(_distinct(best, score, middle, nodes, maps, FIRST_KEPT)))


def refine_placements(
    rough: RoughPlacements, paint: SeenPaint, size: tuple[int, int], template: FieldTemplate
) -> list[PlacedField]:
    """Ways to lay a field over a picture, in clearly different places, the one with most evidence first.

    Parameters
    ----------
    rough : RoughPlacements
        Of this field, or of another one of the same sport, whose markings lie alike.
    paint : SeenPaint
        What stands out from the playing surface.
    size : (int, int)
        Width and height of the picture.
    template : FieldTemplate
        The field.
    """
    maps = paint.maps
    small, middle, circles = (
        _move_conics(rough.conics, maps.scaling),
        _middle_of(size, maps.scaling),
        _round_ones(template),
    )
    _, nodes, _ = template.outlines
    colours, optional = _colours_of(template), _need_no_line(template)
    finer = maps.width * np.geomspace(MIDDLE_SHARE, FINE_SHARE, ROUNDS)
    fitted = _fit(rough.suit(template), small, circles, template, nodes, colours, maps, middle, finer)
    score, share = _score(fitted, nodes, colours, optional, maps, middle, FINE_SHARE * maps.width)
    order = _distinct(fitted, score, middle, nodes, maps, KEPT)
    return [
        PlacedField(
            circles[fitted.own[k]],
            rough.conics[fitted.seen[k]],
            fitted.view(k, size, maps.scaling),
            float(score[k]) / maps.width,
            float(share[k]),
        )
        for k in order.tolist()
    ]


def _round_ones(template: FieldTemplate) -> tuple[Circle, ...]:
    return (*template.circles, *template.arcs)


def _move_conics(conics: Sequence[Array], scaling: Scaling) -> list[Array]:
    """Conics (3, 3) in pixels of the searched picture."""
    into = _into_full(scaling)
    return [into.T @ conic @ into for conic in conics]


def _middle_of(size: tuple[int, int], scaling: Scaling) -> Array:
    """Middle of a full picture of this width and height, pixels of the searched one."""
    return np.asarray(((np.array(size) - 1) / 2 + 0.5) / scaling.factor - 0.5)


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
    """

    evidence: float
    found_share: float
    explained_share: float
    surface_share: float = 1.0


def weigh_view(view: FieldView, template: FieldTemplate, paint: SeenPaint) -> ViewEvidence:
    """What speaks for a camera: that what it predicts is painted, and what is painted is predicted."""
    maps = paint.maps
    reach = FINE_SHARE * maps.width
    _, nodes, _ = template.outlines
    grown = np.array([view.grow(outline, template) for outline in nodes])
    pixels = view.project(grown)
    ahead = np.array(np.isfinite(pixels).all(axis=-1))[None]
    pixels = (np.nan_to_num(pixels, nan=-1e6)[None] + 0.5) / maps.scaling.factor - 0.5
    direction, y, x, length, _ = _look_up(pixels, ahead, maps)
    explained = np.maximum(0.0, 1.0 - maps.distance[_colours_of(template)[:, None], direction, y, x] / reach)
    in_picture = _look_up(pixels, ahead, replace(maps, region=np.ones_like(maps.region)))[3]
    score, share = _sum_up(length, length * explained, _need_no_line(template))
    return ViewEvidence(
        float(score[0]) / maps.width,
        float(share[0]),
        _share_on_markings(pixels[0], ahead[0], paint.structures.points, maps.region.shape, reach),
        float(length.sum() / in_picture.sum()) if in_picture.any() else 1.0,
    )


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


def _distinct_circles(mask: MarkingMask) -> list[Array]:
    """The circles, arcs and candidates of a mask, each once."""
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


def _into_full(scaling: Scaling) -> Array:
    """Pixels of the searched picture to those of the full one (3, 3)."""
    x, y = scaling.factor
    return np.array([[x, 0.0, 0.5 * x - 0.5], [0.0, y, 0.5 * y - 0.5], [0.0, 0.0, 1.0]])


def _colours_of(template: FieldTemplate) -> NDArray[np.intp]:
    """Index (K,) among :data:`COLOURS` of each outline of the template."""
    elements = (*template.circles, *template.arcs, *template.lines)
    is_wide = [template.paint_width(element) > WIDE_M for element in elements]
    told = [
        "blue" if e.color == "blue" and wide else "other than blue" if e.color == "red" else "any"
        for e, wide in zip(elements, is_wide, strict=True)
    ]
    return np.array([COLOURS.index(color) for color in told])


def _need_no_line(template: FieldTemplate) -> Mask:
    """Which outlines (K,) of the template may be the rim of a logo or of a disc, and show no line."""
    round_ones = (*template.circles, *template.arcs)
    return np.array([circle.fill != "none" for circle in round_ones] + [False] * len(template.lines), np.bool_)


def _cameras_before_circles(
    conics: Sequence[Array],
    circles: Sequence[Circle],
    template: FieldTemplate,
    width: int,
    middle: Array,
    side: str,
) -> _Cameras | None:
    """Every seen circle as every circle of the field, for all focal lengths and turns of upright cameras."""
    focal = width * np.geomspace(*FOCAL_WIDTHS, FOCALS)
    turns = np.radians(np.arange(0.0, 360.0, TURN_DEG))
    parts = []
    for seen, conic in enumerate(conics):
        normal, unit_center, log_focal = _circular_sections(conic, focal, middle)
        right = np.array([1.0, 0.0, 0.0]) - normal * normal[:, :1]
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        near = np.cross(normal, right)
        for own, circle in enumerate(circles):
            center_m = np.asarray(circle.center)
            place = unit_center * template.radius(circle, "center")
            x = np.cos(turns)[:, None, None] * right + np.sin(turns)[:, None, None] * near
            y = -np.sin(turns)[:, None, None] * right + np.cos(turns)[:, None, None] * near
            rotation = np.stack([x, y, np.broadcast_to(normal, x.shape)], axis=-1).reshape(-1, 3, 3)
            shift = (place - center_m[0] * x - center_m[1] * y).reshape(-1, 3)
            stands = -np.einsum("bij,bi->bj", rotation, shift)
            kept = (stands[:, :2] @ np.array(SIDES[side]) >= 0) & (-stands[:, 2] > HEIGHT_M[0])
            kept &= -stands[:, 2] < HEIGHT_M[1]
            kept = np.flatnonzero(kept)
            index = np.full(len(kept), own), np.full(len(kept), seen)
            lens = np.full(len(kept), LENS)
            parts.append(_Cameras(rotation[kept], shift[kept], np.tile(log_focal, len(turns))[kept], lens, *index))
    if not parts or not sum(len(part.own) for part in parts):
        return None
    joined = (np.concatenate([getattr(part, name) for part in parts]) for name in _Cameras.__slots__)
    return _Cameras(*joined)


def _circular_sections(conic: Array, focal: Array, middle: Array) -> tuple[Array, Array, Array]:
    """Planes on which an ellipse is the image of a circle, for upright cameras above them.

    Chen, Q., Wu, H., Wada, T. (2004), *Camera calibration with two arbitrary coplanar circles*, section 2.

    Returns
    -------
    normal, center : (K, 3) arrays
        Unit normal away from the camera, and the centre of a circle of radius 1, in the camera's frame.
    log_focal : (K,) array
    """
    K = np.zeros((len(focal), 3, 3))
    K[:, 0, 0] = K[:, 1, 1] = focal
    K[:, :2, 2], K[:, 2, 2] = middle, 1.0
    cone = K.swapaxes(1, 2) @ conic @ K
    cone *= -np.sign(np.linalg.det(cone))[:, None, None]
    values, vectors = np.linalg.eigh(cone)
    low, middle_value, high = values.T
    g = np.sqrt(np.maximum(high - middle_value, 0.0) / (high - low))
    h = np.sqrt(np.maximum(middle_value - low, 0.0) / (high - low))
    along, across = vectors[:, :, 2] * g[:, None], vectors[:, :, 0] * h[:, None]
    normal = np.concatenate([along + across, along - across])
    cone, K, valid = np.tile(cone, (2, 1, 1)), np.tile(K, (2, 1, 1)), np.tile((low < 0) & (middle_value > 0), 2)
    center = np.linalg.solve(cone, normal[..., None])[..., 0]
    center *= np.where(center[:, 2:] < 0, -1.0, 1.0)
    facing = np.sum(normal * center, axis=1)
    normal *= np.where(facing < 0, -1.0, 1.0)[:, None]
    center /= np.maximum(np.abs(facing), 1e-12)[:, None]
    ellipse = ellipse_from_conic(conic)
    if ellipse is None:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    rim = np.linalg.solve(K, np.broadcast_to(lift(ellipse.points(np.zeros(1)))[0][:, None], (len(K), 3, 1)))[..., 0]
    rim /= np.sum(normal * rim, axis=1, keepdims=True)
    center /= np.maximum(np.linalg.norm(rim - center, axis=1, keepdims=True), 1e-12)
    roll = np.degrees(np.arctan2(normal[:, 0], normal[:, 1]))
    valid &= np.abs(roll) < LARGEST_ROLL_DEG
    return normal[valid], center[valid], np.tile(np.log(focal), 2)[valid]


def _project(H: Array, points: Array) -> tuple[Array, Mask]:
    """Pixels (B, N, 2) of field points (N, 2), and which lie before the camera."""
    homogeneous = lift(points) @ H.swapaxes(1, 2)
    depth = homogeneous[..., 2]
    ahead = depth > 1e-6
    return homogeneous[..., :2] / np.where(ahead, depth, 1.0)[..., None], ahead


def _look_up(
    pixels: Array, ahead: Mask, maps: RidgeMaps
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], Array, Array]:
    """Direction, row and column of the maps at places (B, K, N, 2) along K markings, the length of marking that each
    stands for (0 where the playing surface does not show it), and the normals (B, K, N, 2).
    """
    tangent = np.gradient(pixels, axis=2)
    length = np.hypot(tangent[..., 0], tangent[..., 1])
    normals = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1) / np.maximum(length, 1e-9)[..., None]
    rows, columns = maps.region.shape
    inside = ahead & (pixels >= 0).all(axis=-1) & (pixels <= (columns - 1, rows - 1)).all(axis=-1)
    x, y = np.where(inside[..., None], np.rint(pixels), 0).astype(np.intp).transpose(3, 0, 1, 2)
    direction = np.floor(np.arctan2(normals[..., 1], normals[..., 0]) % np.pi * (DIRECTIONS / np.pi)).astype(np.intp)
    length = np.where(inside & maps.region[y, x], np.minimum(length, 0.1 * columns), 0.0)
    return np.minimum(direction, DIRECTIONS - 1), y, x, length, normals


def _score(
    cameras: _Cameras,
    nodes: Array,
    paint: NDArray[np.intp],
    optional: Mask,
    maps: RidgeMaps,
    middle: Array,
    reach: float,
    chunk: int = 4000,
) -> tuple[Array, Array]:
    """Length of markings on ridges beyond break-even (B,), pixels, and share of what is in view that lies on ridges."""
    scores, shares = [], []
    for begin in range(0, len(cameras.own), chunk):
        part = cameras.take(np.arange(begin, min(begin + chunk, len(cameras.own))))
        pixels, ahead = part.project(nodes.reshape(-1, 2), middle)
        shape = (len(pixels), *nodes.shape[:2])
        direction, y, x, length, _ = _look_up(pixels.reshape(*shape, 2), ahead.reshape(shape), maps)
        explained = np.maximum(0.0, 1.0 - maps.distance[paint[:, None], direction, y, x] / reach)
        score, share = _sum_up(length, length * explained, optional)
        scores.append(score)
        shares.append(share)
    return np.concatenate(scores), np.concatenate(shares)


def _sum_up(length: Array, found: Array, optional: Mask) -> tuple[Array, Array]:
    """Length of markings on ridges beyond break-even (B,), and share of what is in view that lies on ridges, from the
    lengths in view and on ridges (B, K, N) and which of the K markings need not show as a line.
    """
    total, found = length.sum(axis=2), found.sum(axis=2)
    is_left_out = optional & (found < BREAK_EVEN * total)
    total, found = (np.where(is_left_out, 0.0, part).sum(axis=1) for part in (total, found))
    return found - BREAK_EVEN * total, found / np.maximum(total, 1e-9)


def _distinct(
    cameras: _Cameras, score: Array, middle: Array, nodes: Array, maps: RidgeMaps, most: int, wanted: int = KEPT
) -> NDArray[np.intp]:
    """The best cameras, best first, each of those that show the field alike once; at most so many as are wanted."""
    order = np.argsort(-score)[:most]
    marked, ahead = cameras.take(order).project(nodes.reshape(-1, 2)[:: COARSE_NODES**2], middle)
    rows, columns = maps.region.shape
    shown = ahead & (marked > 0).all(axis=-1) & (marked < (columns, rows)).all(axis=-1)
    x, y = np.where(shown, marked.transpose(2, 0, 1), 0.0).astype(np.float32)
    weight, limit = shown.astype(np.float32), ALIKE_WIDTHS * columns * np.maximum(shown.sum(axis=1), 1)
    kept = np.zeros(wanted, np.intp)
    kept_x, kept_y = np.zeros((2, wanted, x.shape[1]), np.float32)
    count = 0
    for k in range(len(order)):
        off = np.hypot(kept_x[:count] - x[k], kept_y[:count] - y[k])
        if (np.minimum(off, columns, out=off) @ weight[k] <= limit[k]).any():
            continue
        kept[count], kept_x[count], kept_y[count] = k, x[k], y[k]
        count += 1
        if count == wanted:
            break
    return order[kept[:count]]


def _fit(
    cameras: _Cameras,
    conics: Sequence[Array],
    circles: Sequence[Circle],
    template: FieldTemplate,
    nodes: Array,
    paint: NDArray[np.intp],
    maps: RidgeMaps,
    middle: Array,
    reaches: Array,
) -> _Cameras:
    """Cameras moved so that their circle stays where it is seen and the other markings come to lie on ridges within
    reach, pixels, one round for each.
    """
    angle = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    own = np.array([np.asarray(c.center) + template.radius(c, "center") * ring for c in circles])[cameras.own]
    conic = np.array(conics)[cameras.seen]
    for reach in reaches.tolist():
        base = _residuals(cameras, own, conic, nodes, paint, maps, middle, reach, None)
        moved = [
            _residuals(_move(cameras, step), own, conic, nodes, paint, maps, middle, reach, base.targets)
            for step in np.eye(8) * STEP
        ]
        J = np.stack([(other.values - base.values) / STEP for other in moved], axis=-1)
        J = np.where(np.isfinite(J), J, 0.0)
        normal = J.swapaxes(1, 2) @ J
        normal += 1e-4 * np.eye(8) * np.trace(normal, axis1=1, axis2=2)[:, None, None] / 8 + 1e-9 * np.eye(8)
        step = -np.linalg.solve(normal, J.swapaxes(1, 2) @ base.values[..., None])[..., 0]
        cameras = _move(cameras, np.clip(step, -0.3, 0.3))
    return cameras


def _move(cameras: _Cameras, step: Array) -> _Cameras:
    """Cameras after a step (8,) or (B, 8): turn, shift as a share of the distance, log of the focal length, lens."""
    step = np.broadcast_to(step, (len(cameras.own), 8))
    size = np.linalg.norm(step[:, :3], axis=1)
    axis = step[:, :3] / np.maximum(size, 1e-15)[:, None]
    cross = np.zeros((len(step), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    cross -= cross.swapaxes(1, 2)
    turn = np.eye(3) + np.sin(size)[:, None, None] * cross + (1 - np.cos(size))[:, None, None] * (cross @ cross)
    distance = np.linalg.norm(cameras.shift, axis=1, keepdims=True)
    return _Cameras(
        turn @ cameras.rotation,
        (turn @ cameras.shift[..., None])[..., 0] + distance * step[:, 3:6],
        cameras.log_focal + step[:, 6],
        np.clip(cameras.lens + step[:, 7], -LARGEST_LENS, LARGEST_LENS),
        cameras.own,
        cameras.seen,
    )


@dataclass(frozen=True, slots=True)
class _Residuals:
    """Residuals (B, R), and the ridges with their weights that they refer to."""

    values: Array
    targets: tuple[Array, Array, Array]


def _residuals(
    cameras: _Cameras,
    own: Array,
    conic: Array,
    nodes: Array,
    paint: NDArray[np.intp],
    maps: RidgeMaps,
    middle: Array,
    reach: float,
    targets: tuple[Array, Array, Array] | None,
) -> _Residuals:
    H = cameras.homographies(middle)
    rim = lift(own) @ H.swapaxes(1, 2)
    rim /= np.where(np.abs(rim[..., 2:]) > 1e-9, rim[..., 2:], 1e-9)
    rim[..., :2] = cameras.bend(rim[..., :2], middle)
    polar = rim @ conic
    off = np.sum(rim * polar, axis=-1) / np.maximum(2 * np.hypot(polar[..., 0], polar[..., 1]), 1e-12)
    pixels, ahead = _project(H, nodes.reshape(-1, 2))
    pixels = cameras.bend(pixels, middle)
    shape = (len(H), *nodes.shape[:2])
    pixels = pixels.reshape(*shape, 2)
    if targets is None:
        direction, y, x, length, normals = _look_up(pixels, ahead.reshape(shape), maps)
        distance = maps.distance[paint[:, None], direction, y, x]
        trust = np.where(distance < reach, (1 - (distance / reach) ** 2), 0.0) * np.sqrt(length / 10.0)
        targets = (
            maps.places[maps.label[paint[:, None], direction, y, x]],
            normals,
            trust / (RIDGE_PX + 0.2 * reach),
        )
    nearest, normals, weight = targets
    beside = np.sum((nearest - pixels) * normals, axis=-1) * weight
    roll = np.degrees(np.arctan2(cameras.rotation[:, 0, 2], cameras.rotation[:, 1, 2])) / ROLL_SD_DEG
    prior = np.stack([roll, (cameras.lens - LENS) / LENS_SD], axis=-1)
    values = np.concatenate([off / OWN_PX, beside.reshape(len(H), -1), prior], axis=1)
    return _Residuals(np.nan_to_num(values), targets)
