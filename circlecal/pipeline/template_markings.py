"""Every marking of a field, measured where a view puts it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from circlecal.field import FieldTemplate, Line
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.marking_places import lie_on_surface
from circlecal.observations import CirclePoints, LinePoints
from circlecal.paint.along_curve import RaysConfig, measure_along_curve, measure_along_model
from circlecal.paint.lines import ONE_ROUND, measure_lines
from circlecal.paint.local_energy import widest_band_px
from circlecal.paint.predicted_width import WIDE_PX
from circlecal.paint.profiles import GrayPicture
from circlecal.results import Segment

__all__ = ["measure_straight_markings", "measure_template"]

SHORTEST_LINE, LINE_SEARCH_PX, LINE_RMS_PX, LINE_SHARE = 0.06, 9.0, 2.5, 0.35
"""A straight marking is measured where a placed field shows so much of it, picture widths; how far to both sides, and
with what scatter, pixels at 1920 px width; and the share of it that must be seen.
"""
LINE_SPACING_PX, DENSE_SHARE = 2.0, 0.25
"""Between two profiles across a line, pixels, and least share of a line's places at which paint is measured: 17 streaks
of the ice in 0.11 of a rendered rink's length were taken for the goal line, which exchanged its ends.
"""
FEWEST_ON_CIRCLE, CIRCLE_SHARE = 16, 0.25
"""Points of a circle or an arc, fewer of which, or of a smaller share of what is in view of it, lie on something else:
those on a logo within a centre circle were 0.05 of it.
"""
STRAIGHT_PX = 1.5
"""Largest distance of a line from the straight one between its ends, pixels at 1920 px width: half of what a robust
line keeps of its points.
"""
FEWEST_ON_LINE = 6
"""Points on a straight marking, fewer of which tell no curve."""
LINE_NODES = 65
"""Along a straight marking, which tell what of it the picture shows."""


def measure_template(
    picture: GrayPicture,
    view: FieldView,
    template: FieldTemplate,
    region: Mask | None,
    noise: float,
    config: RaysConfig,
    *,
    follows_curves: bool = True,
    plain: GrayPicture | None = None,
) -> tuple[tuple[CirclePoints, ...], tuple[LinePoints, ...]]:
    """Points on the circles, arcs and straight markings of a field where a view puts them.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    view : FieldView
        Where the field is seen.
    template : FieldTemplate
        The field.
    region : (h, w) bool or None
        The playing surface in a reduced picture.
    noise : float
        Grey-level noise of the picture.
    config : RaysConfig
        How the middle of paint is measured.
    follows_curves : bool
        Whether bent and wide lines are measured along their curves; among many players and boards a robust line loses
        fewer of them (one of nine rendered courts had no answer).
    plain : (H, W) uint8 or float32, optional
        Brightness again where ``picture`` shows edges as bands, which broad lines have two of: they are measured here.
    """
    height, width = picture.shape
    circles, curves = [], template.polylines()
    for circle in template.round_ones:
        points, sigma = measure_along_model(picture, view, circle, template, noise, config)
        on = lie_on_surface(points, region, width, height)
        shown = view.project(curves[circle.name])
        visible = np.asarray(np.isfinite(shown).all(axis=1), np.bool_)
        visible[visible] = lie_on_surface(shown[visible], region, width, height)
        steps = np.linalg.norm(np.diff(shown, axis=0), axis=1)[visible[1:] & visible[:-1]]
        if on.sum() >= max(FEWEST_ON_CIRCLE, CIRCLE_SHARE * steps.sum() / config.spacing_px):
            circles.append(CirclePoints(circle.name, "center", points[on], sigma[on]))
    return tuple(circles), measure_straight_markings(
        picture, view, template, template.lines, region, noise, config, follows_curves=follows_curves, plain=plain
    )


def measure_straight_markings(
    picture: GrayPicture,
    view: FieldView,
    template: FieldTemplate,
    lines: Iterable[Line],
    region: Mask | None,
    noise: float,
    config: RaysConfig,
    *,
    follows_curves: bool = True,
    plain: GrayPicture | None = None,
) -> tuple[LinePoints, ...]:
    """Points on those of the straight markings of which enough is seen; the parameters are those of
    :func:`measure_template`.

    What is straight and thin in the picture is measured by a line that players cannot draw aside, the rest along the
    curve as which lens and surface show it.
    """
    height, width = picture.shape
    unit = width / 1920.0
    placed = [(line, *_place_line(view, template, line, region, (height, width))) for line in lines]
    placed = [(line, places, sides) for line, places, sides in placed if _length(places) >= SHORTEST_LINE * width]
    courses = [(places, sides) for _, places, sides in placed]
    broad = [plain is not None and _is_broad(sides, widest_band_px(width)) for _, sides in courses]
    straight = [
        not is_broad and (not follows_curves or _is_plain(places, sides, unit))
        for (places, sides), is_broad in zip(courses, broad, strict=True)
    ]
    measured = iter(_measure_plain(picture, [c for c, is_one in zip(courses, straight, strict=True) if is_one], noise))
    found = []
    for (line, places, sides), is_straight, is_broad in zip(placed, straight, broad, strict=True):
        shown = plain if is_broad and plain is not None else picture
        points, sigma = (
            next(measured)
            if is_straight
            else measure_along_curve(shown, places, sides, LINE_SEARCH_PX * unit, noise, config)
        )
        if _is_seen(points, places, unit):
            found.append(LinePoints(line.name, points, sigma))
    return tuple(found)


def _is_plain(places: Array, sides: Array, unit: float) -> bool:
    """Whether a line with places (N, 2) and edges (2, N, 2) is straight and thin in the picture."""
    span = places[-1] - places[0]
    off = np.abs((places - places[0]) @ np.array([-span[1], span[0]])) / np.linalg.norm(span)
    return bool(off.max() <= STRAIGHT_PX * unit and np.linalg.norm(sides[1] - sides[0], axis=1).max() <= WIDE_PX * unit)


def _is_broad(sides: Array, widest_px: float) -> bool:
    """Whether a line with edges (2, N, 2) is mostly wider than that in the picture."""
    width = np.linalg.norm(sides[1] - sides[0], axis=1)
    return len(width) > 0 and float(np.median(width)) > widest_px


def _measure_plain(
    picture: GrayPicture, courses: Sequence[tuple[Array, Array]], noise: float
) -> list[tuple[Array, Array]]:
    """Points (K, 2) on straight, thin lines with places (N, 2) and edges (2, N, 2), and their sigmas (K,)."""
    segments = [Segment(places[0], places[-1]) for places, _ in courses]
    widths = np.zeros((len(courses), 2))
    for width, (places, sides) in zip(widths, courses, strict=True):
        span = places[-1] - places[0]
        normal = np.array([-span[1], span[0]]) / np.linalg.norm(span)
        width[:] = np.abs((sides[0] - sides[1])[[0, -1]] @ normal)
    found = measure_lines(picture, segments, noise, LINE_SEARCH_PX, LINE_SPACING_PX, ONE_ROUND, widths)
    nothing = np.zeros((0, 2)), np.zeros(0)
    return [nothing if cue is None else (cue.points_px, cue.sigma_px) for cue in found]


def _place_line(
    view: FieldView, template: FieldTemplate, line: Line, region: Mask | None, shape: tuple[int, int]
) -> tuple[Array, Array]:
    """Places (N, 2) along the part of a line that the picture shows on the playing surface, at even distances, and both
    edges (2, N, 2) of its paint there, pixels.
    """
    first, last = template.line_ends(line)
    nodes = first + np.linspace(0.0, 1.0, LINE_NODES)[:, None] * (last - first)
    shown = view.project(nodes)
    ahead = np.flatnonzero(np.isfinite(shown).all(axis=1))
    visible = ahead[lie_on_surface(shown[ahead], region, shape[1], shape[0])]
    if len(visible) < 2:
        return np.zeros((0, 2)), np.zeros((2, 0, 2))
    # a lens may fold what lies between two places that are seen
    run = ahead[(ahead >= visible[0]) & (ahead <= visible[-1])]
    across = np.array([first[1] - last[1], last[0] - first[0]]) / np.linalg.norm(last - first)
    paint = 0.5 * template.paint_width(line) * across
    curves = np.stack([shown[run], view.project(nodes[run] + paint), view.project(nodes[run] - paint)])
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curves[0], axis=0), axis=1))])
    at = np.linspace(0.0, travelled[-1], max(2, int(travelled[-1] / LINE_SPACING_PX) + 1))
    place = np.array([[np.interp(at, travelled, values) for values in curve.T] for curve in curves])
    return place[0].T, place[1:].transpose(0, 2, 1)


def _length(places: Array) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _is_seen(points: Array, places: Array, unit: float) -> bool:
    """Whether enough of a line was measured: between its ends, and place by place; and on one smooth curve."""
    length_px = _length(places)
    if LINE_SPACING_PX * len(points) <= DENSE_SHARE * length_px or len(points) < FEWEST_ON_LINE:
        return False
    direction = (places[-1] - places[0]) / np.linalg.norm(places[-1] - places[0])
    along, off = points @ direction, points @ np.array([-direction[1], direction[0]])
    if np.ptp(along) <= LINE_SHARE * length_px:
        return False
    along = (along - along.mean()) / np.ptp(along)
    rest = off - np.polyval(np.polyfit(along, off, 2), along)
    return float(np.sqrt(np.mean(rest**2))) < LINE_RMS_PX * unit
