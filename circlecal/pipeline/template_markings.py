"""Every marking of a field measured where a view puts it: circles, arcs, straight lines, and the rims of logos."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.marking_places import lie_on_surface
from circlecal.observations import CirclePoints, LinePoints
from circlecal.paint.lines import ONE_ROUND, measure_lines
from circlecal.paint.outer_edges import measure_outer_edges
from circlecal.paint.profiles import GrayPicture
from circlecal.results import LineCue, Segment
from circlecal.stages.rays import RaysConfig, measure_along_model, sample_curve, select_steady

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
LINE_NODES = 65
"""Along a straight marking, which tell what of it the picture shows."""
INSIDE_PAINTS = 2.0
"""How far inside its outer edge a logo may end, widths of the line: with a gap as wide as that between both."""
WIDEST_LINE = 0.03
"""Width of such a line in the picture, picture widths, beyond which the ground inside it is not looked at."""
STEADY_RIM_PX, RIM_SIGMA_PX = 1.5, 0.3
"""Largest distance of steady points of a rim from the running median along it, and what an edge is measured to, pixels
at 1920 px width."""


def measure_template(
    picture: GrayPicture,
    view: FieldView,
    template: FieldTemplate,
    region: Mask | None,
    noise: float,
    config: RaysConfig,
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
        How circles are measured.
    """
    seen = (
        _observe_circle(picture, view, circle, template, region, noise, config)
        for circle in (*template.circles, *template.arcs)
    )
    circles = tuple(CirclePoints(circle, "center", points, sigma) for circle, points, sigma in filter(None, seen))
    return circles, _measure_lines_of(picture, view, template, region, noise)


def measure_logo_rims(
    image: NDArray[np.uint8],
    view: FieldView,
    template: FieldTemplate,
    circles: Sequence[Circle],
    region: Mask | None,
    config: RaysConfig,
) -> tuple[CirclePoints, ...]:
    """Points on the outer edges of circles that a logo may fill up to their line, which then is no band.

    Whether the logo ends at either edge of the line or beyond it the picture does not tell, so that no point is surer
    than half the paint's width.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    view, template, region, config
        As for :func:`measure_template`.
    circles : sequence of Circle
        Those of the template that are looked for.
    """
    seen = (_measure_rim(image, view, circle, template, region, config) for circle in circles)
    return tuple(circle for circle in seen if circle is not None)


def _measure_rim(
    image: NDArray[np.uint8],
    view: FieldView,
    circle: Circle,
    template: FieldTemplate,
    region: Mask | None,
    config: RaysConfig,
) -> CirclePoints | None:
    """Points on the outer edge of a circle on the playing surface; None where too little of it is seen."""
    height, width = image.shape[:2]
    search = 2 * config.refine_px * width / 1920.0
    rim = circle.model_copy(update={"fill": "disc", "radius_m": template.radius(circle, "outer")})
    points, outward, _, _ = sample_curve(view, rim, template, config)
    paint = sample_curve(view, circle, template, config)[2]
    if np.nanmedian(paint) < 0.0:  # a view turns all of a circle alike
        outward, paint = -outward, -paint
    shown = np.asarray(np.isfinite(points).all(axis=1), np.bool_)
    shown[shown] = lie_on_surface(points[shown], region, width, height)
    if shown.sum() < FEWEST_ON_CIRCLE:
        return None
    points, outward = points[shown], outward[shown]
    paint_px = min(float(np.nanmax(paint)), WIDEST_LINE * width)
    inner = np.full(len(points), search + INSIDE_PAINTS * paint_px)
    places, found = measure_outer_edges(image, points, outward, inner, search)
    beside = np.sum((places - points) * outward, axis=1)[found]
    limit = np.full(len(beside), STEADY_RIM_PX * width / 1920.0)
    on = places[found][select_steady(beside, limit)]
    if len(on) < max(FEWEST_ON_CIRCLE, CIRCLE_SHARE * len(points)):
        return None
    scale = float(np.ptp(on, axis=0).max()) / (2 * rim.radius_m)  # pixels per metre at least
    sigma = np.hypot(RIM_SIGMA_PX * width / 1920.0, 0.5 * template.paint_width(circle) * scale)
    return CirclePoints(circle.name, "outer", on, np.full(len(on), sigma))


def _observe_circle(
    picture: GrayPicture,
    view: FieldView,
    circle: Circle,
    template: FieldTemplate,
    region: Mask | None,
    noise: float,
    config: RaysConfig,
) -> tuple[str, Array, Array] | None:
    """Name, points and sigmas of a circle or an arc on the playing surface; None where too little of it is seen."""
    height, width = picture.shape
    points, sigma = measure_along_model(picture, view, circle, template, noise, config)
    on = lie_on_surface(points, region, width, height)
    shown = view.project(template.polylines()[circle.name])
    visible = np.asarray(np.isfinite(shown).all(axis=1), np.bool_)
    visible[visible] = lie_on_surface(shown[visible], region, width, height)
    steps = np.linalg.norm(np.diff(shown, axis=0), axis=1)[visible[1:] & visible[:-1]]
    if on.sum() < max(FEWEST_ON_CIRCLE, CIRCLE_SHARE * steps.sum() / config.spacing_px):
        return None
    return circle.name, points[on], sigma[on]


def _measure_lines_of(
    picture: GrayPicture, view: FieldView, template: FieldTemplate, region: Mask | None, noise: float
) -> tuple[LinePoints, ...]:
    height, width = picture.shape
    unit = width / 1920.0
    share = np.linspace(0.0, 1.0, LINE_NODES)[:, None]
    names, segments, widths = [], [], []
    for line in template.lines:
        first, last = template.line_ends(line)
        shown = view.project(first + share * (last - first))
        ahead = np.flatnonzero(np.isfinite(shown).all(axis=1))
        visible = ahead[lie_on_surface(shown[ahead], region, width, height)]
        if len(visible) < 2:
            continue
        start, end = shown[visible[0]], shown[visible[-1]]
        if np.linalg.norm(end - start) < SHORTEST_LINE * width:
            continue
        across = np.array([first[1] - last[1], last[0] - first[0]]) / np.linalg.norm(last - first)
        paint = 0.5 * template.paint_width(line) * across
        ends = (first + share[visible[[0, -1]]] * (last - first))[:, None] + np.array([paint, -paint])
        normal = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
        names.append(line.name)
        segments.append(Segment(start, end))
        widths.append(np.abs((view.project(ends[:, 0]) - view.project(ends[:, 1])) @ normal))
    found = measure_lines(
        picture, segments, noise, LINE_SEARCH_PX, LINE_SPACING_PX, ONE_ROUND, np.array(widths).reshape(-1, 2)
    )
    return tuple(
        LinePoints(name, cue.points_px, cue.sigma_px)
        for name, segment, cue in zip(names, segments, found, strict=True)
        if cue is not None and cue.rms_px < LINE_RMS_PX * unit and _is_seen(cue, segment)
    )


def _is_seen(cue: LineCue, segment: Segment) -> bool:
    """Whether enough of a line was measured: between its ends, and place by place."""
    length = float(np.linalg.norm(segment.end - segment.start))
    between = float(np.linalg.norm(cue.segment.end - cue.segment.start))
    return between > LINE_SHARE * length and LINE_SPACING_PX * len(cue.points_px) > DENSE_SHARE * length
