"""Ways to lay a field over a picture: all cameras first, of which the likeliest are fitted to all that is painted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array
from circlecal.placement.camera_batch import CameraBatch, cameras_before_circles, join_cameras
from circlecal.placement.evidence import (
    FINE_SHARE,
    Outlines,
    ViewEvidence,
    sample_outlines,
    weigh_samples,
    weigh_view,
)
from circlecal.placement.fit import fit_cameras
from circlecal.placement.paint_maps import RidgeMaps, SeenPaint

COARSE_SHARE, MIDDLE_SHARE = 0.03, 0.012
"""Distance from a ridge at which a marking is not explained by it any more, picture widths: of the first cameras, whose
turn is off by half a step, and after their first fit."""
FOLLOWED, FIRST_KEPT, KEPT = 4000, 250, 40
"""Best cameras by what is surely painted, and by all that may be (an arc of which too little is seen is among neither
circles nor lines); of either so many different ones are fitted to it, and so many of these to all.
"""
ALIKE_WIDTHS = 0.04
"""Two cameras that put the field's nearest markings within this share of the picture's width are one."""
FIRST_ROUNDS, ROUNDS = 5, 10
"""Of the first and the last fit, in which the reach shrinks from one of these distances to the next."""
COARSE_NODES = 4
"""Every so many nodes of an outline are looked at for the first cameras."""
MOST_CIRCLES = 5
"""Seen circles from which cameras start."""
AT_ONCE = 250
"""Cameras that are weighed at once, which bounds the memory."""


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
class RoughPlacements:
    """Ways to lay a field over a picture after a search among all cameras, before the last fit.

    Attributes
    ----------
    template : FieldTemplate
        The field that was laid.
    conics : tuple of (3, 3) arrays
        Circles that were seen, pixels of the full picture.
    cameras : CameraBatch
        The likeliest of clearly different ones.
    """

    template: FieldTemplate
    conics: tuple[Array, ...]
    cameras: CameraBatch


@dataclass(frozen=True, slots=True)
class LaidField:
    """A field that was laid where another one was seen, and moved onto the paint.

    Attributes
    ----------
    circle : Circle
        Its circle or arc that is taken for the seen one.
    view : FieldView
        Where the full picture shows the field.
    seen : ViewEvidence
        What speaks for it.
    """

    circle: Circle
    view: FieldView
    seen: ViewEvidence


def search_placements(
    paint: SeenPaint, size: tuple[int, int], template: FieldTemplate, side: str
) -> RoughPlacements | None:
    """The likeliest ways to lay a field over a picture among all that its circles allow; None where there is none.

    Parameters
    ----------
    paint : SeenPaint
        What stands out from the playing surface, and the circles there; cameras are chosen by what is surely painted,
        and by all of it.
    size : (int, int)
        Width and height of the picture.
    template : FieldTemplate
        The field.
    side : str
        Side of the field from which the camera looks.
    """
    conics, maps = paint.conics[:MOST_CIRCLES], paint.maps
    small = [maps.scaling.reduce_conic(conic) for conic in conics]
    middle = maps.scaling.reduce((np.array(size) - 1) / 2)
    cameras = cameras_before_circles(small, template, maps.width, middle, side, paint.are_rims)
    if cameras is None:
        return None
    outlines = Outlines.of(template)
    few, nodes = outlines.thin(COARSE_NODES), outlines.nodes
    reaches = COARSE_SHARE * maps.width * np.geomspace(1.0, MIDDLE_SHARE / COARSE_SHARE, FIRST_ROUNDS)
    parts = []
    all_paint = (paint.map_structures(), maps)
    for seen, (score, _) in zip(all_paint, _weigh_cameras(cameras, few, all_paint, reaches[0]), strict=True):
        first = cameras.take(_distinct(cameras, score, nodes, maps, FOLLOWED, FIRST_KEPT))
        parts.append(fit_cameras(first, small, few, seen, reaches))
    best = join_cameras(parts)
    ((score, _),) = _weigh_cameras(best, few, (maps,), reaches[-1])
    return RoughPlacements(template, conics, best.take(_distinct(best, score, nodes, maps, len(score))))


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
    maps, outlines = paint.maps, Outlines.of(template)
    small = [maps.scaling.reduce_conic(conic) for conic in rough.conics]
    cameras = rough.cameras if template is rough.template else rough.cameras.suit(rough.template, template)
    reaches = maps.width * np.geomspace(MIDDLE_SHARE, FINE_SHARE, ROUNDS)
    fitted = fit_cameras(cameras, small, outlines, maps, reaches)
    ((score, share),) = _weigh_cameras(fitted, outlines, (maps,), FINE_SHARE * maps.width)
    circles = template.round_ones
    return [
        PlacedField(
            circles[fitted.own[k]],
            rough.conics[fitted.seen[k]],
            fitted.view(k, size, maps.scaling.factor),
            float(score[k]) / maps.width,
            float(share[k]),
        )
        for k in _distinct(fitted, score, outlines.nodes, maps, KEPT).tolist()
    ]


def lay_over_view(
    view: FieldView, circle: Circle, conic: Array, template: FieldTemplate, other: FieldTemplate, paint: SeenPaint
) -> LaidField | None:
    """A field that is laid where a view has another one, and moved onto the paint.

    Parameters
    ----------
    view : FieldView
        Where ``template`` is seen.
    circle, conic : Circle, (3, 3) array
        A circle or an arc of it, about which the field is laid, and where it was seen, pixels of the full picture.
    template, other : FieldTemplate
        The field of the view, and the one that is laid, which may be this one.
    paint : SeenPaint
        What stands out from the playing surface.

    Returns
    -------
    LaidField or None
        None where the view has no camera.
    """
    maps, outlines = paint.maps, Outlines.of(other).suit(paint.maps)
    camera = CameraBatch.of_view(view, template.round_ones.index(circle), maps.scaling)
    if camera is None:
        return None
    camera = camera if other is template else camera.suit(template, other)
    reaches = maps.width * np.geomspace(MIDDLE_SHARE, FINE_SHARE, ROUNDS)
    laid = fit_cameras(camera, [maps.scaling.reduce_conic(conic)], outlines, maps, reaches)
    there = laid.view(0, (view.camera.width, view.camera.height), maps.scaling.factor)
    return LaidField(other.round_ones[laid.own[0]], there, weigh_view(there, other, paint))


def _weigh_cameras(
    cameras: CameraBatch, outlines: Outlines, seen: Sequence[RidgeMaps], reach: float
) -> list[tuple[Array, Array]]:
    """For each of several maps of one surface, length of markings on ridges beyond break-even (B,), pixels, and share
    (B,) of what is in view on ridges.
    """
    weights = []
    for begin in range(0, len(cameras), AT_ONCE):
        part = cameras.take(slice(begin, begin + AT_ONCE))
        shape = len(part), *outlines.nodes.shape[:2]
        shown = part.project(outlines.nodes.reshape(-1, 2))
        pixels, ahead = shown.pixels.reshape(2, *shape), shown.ahead.reshape(shape)
        samples = sample_outlines(pixels, ahead, outlines.colours, seen[0].region)
        weights.append([weigh_samples(samples, maps, outlines.is_optional, reach) for maps in seen])
    of_maps = [zip(*of_one, strict=True) for of_one in zip(*weights, strict=True)]
    return [(np.concatenate(scores), np.concatenate(shares)) for scores, shares in of_maps]


def _distinct(
    cameras: CameraBatch, score: Array, nodes: Array, maps: RidgeMaps, most: int, wanted: int = KEPT
) -> NDArray[np.intp]:
    """The best cameras, best first, each of those that show the field alike once; at most so many as are wanted."""
    order = np.argsort(-score)[:most]
    marked = cameras.take(order).project(nodes.reshape(-1, 2)[:: COARSE_NODES**2])
    rows, columns = maps.region.shape
    (x, y), size = marked.pixels, np.array([[[columns]], [[rows]]])
    shown = marked.ahead & (marked.pixels > 0).all(axis=0) & (marked.pixels < size).all(axis=0)
    x, y = np.where(shown, x, 0.0), np.where(shown, y, 0.0)
    weight, limit = shown.astype(np.float32), ALIKE_WIDTHS * columns * np.maximum(shown.sum(axis=1), 1)
    kept = np.zeros(wanted, np.intp)
    kept_x, kept_y = np.zeros((2, wanted, x.shape[1]), np.float32)
    count = 0
    for k in range(len(order)):
        across, down = kept_x[:count] - x[k], kept_y[:count] - y[k]
        off = np.sqrt(across * across + down * down)
        if (np.minimum(off, columns, out=off) @ weight[k] <= limit[k]).any():
            continue
        kept[count], kept_x[count], kept_y[count] = k, x[k], y[k]
        count += 1
        if count == wanted:
            break
    return order[kept[:count]]
