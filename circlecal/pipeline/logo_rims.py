"""Circles that a logo fills up to their line, by their outer rims, where a view puts them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Mask
from circlecal.line_naming.marking_places import lie_on_surface
from circlecal.observations import CirclePoints
from circlecal.paint.along_curve import RaysConfig, sample_curve, select_steady
from circlecal.paint.outer_edges import measure_outer_edges
from circlecal.pipeline.template_markings import CIRCLE_SHARE, FEWEST_ON_CIRCLE

INSIDE_PAINTS = 2.0
"""How far inside its outer edge a logo may end, widths of the line: with a gap as wide as that between both."""
WIDEST_LINE = 0.03
"""Width of such a line in the picture, picture widths, beyond which the ground inside it is not looked at."""
STEADY_RIM_PX, RIM_SIGMA_PX = 1.5, 0.3
"""Largest distance of steady points of a rim from the running median along it, and what an edge is measured to, pixels
at 1920 px width."""


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
        As for :func:`circlecal.pipeline.template_markings.measure_template`.
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
    inside, outside = sample_curve(view, circle, template, config)[2]
    paint = outside - inside
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
