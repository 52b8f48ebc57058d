"""Circles and arcs measured where a camera puts them, and how far apart two cameras put the markings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from circlecal.field import Arc, Circle, FieldTemplate
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.marking_places import place_markings
from circlecal.observations import CirclePoints, Observations
from circlecal.paint.along_curve import measure_along_model
from circlecal.paint.profiles import GrayPicture
from circlecal.pictures.graphics import lie_clear
from circlecal.pipeline.setting import Setting
from circlecal.placement import mean_distance_px
from circlecal.results import CameraFit

__all__ = ["SETTLED_PX", "distance_widths", "measure_curves", "measure_distances", "replace_curves"]

SETTLED_PX = 0.5
"""Mean distance, pixels at 1920 px width, by which a camera that is found again moves the markings where it stays."""
CLEAR_OF_LINES_PX = 6.0
"""Points of an arc so near to where a straight marking runs, pixels at 1920 px width, are left out: at a slant the line
on which the arc ends is as near as the arc, and nine of 39 points lay on it in a rendered frame, up to 6 px beside
the arc.
"""


def measure_curves(
    setting: Setting,
    picture: GrayPicture,
    camera: CameraFit,
    curves: Iterable[Circle],
    noise: float,
    covered: Mask | None = None,
) -> dict[str, CirclePoints]:
    """Circles and arcs, by name, measured where a camera puts them and graphics (H, W) cover nothing; without those of
    which too little is seen.
    """
    config = setting.config
    found = {}
    with setting.clock("rays"):
        for curve in curves:
            points, sigma = measure_along_model(picture, camera.view, curve, setting.template, noise, config.rays)
            is_clear = lie_clear(points, covered)
            points, sigma = points[is_clear], sigma[is_clear]
            if isinstance(curve, Arc) and len(points):
                kept = _lie_clear_of_lines(points, camera, setting.template)
                points, sigma = points[kept], sigma[kept]
            if len(points) >= config.ellipse.minimum_points:
                found[curve.name] = CirclePoints(curve.name, "center", points, sigma)
    return found


def _lie_clear_of_lines(points_px: Array, camera: CameraFit, template: FieldTemplate) -> Mask:
    """Which points (N, 2) of the picture lie beside all straight markings, as a camera shows these."""
    names, _, _ = template.outlines
    lines = place_markings(camera, template, [k for k, name in enumerate(names) if name in template.line_by_name])
    return np.asarray(
        measure_distances(points_px, lines.base) > CLEAR_OF_LINES_PX * camera.model.width / 1920.0, np.bool_
    )


def replace_curves(observations: Observations, curves: Mapping[str, CirclePoints]) -> Observations:
    """The observations with these circles and arcs in the place of those of their names."""
    others = tuple(circle for circle in observations.circles if circle.circle not in curves)
    return replace(observations, circles=(*curves.values(), *others))


def measure_distances(points_px: Array, others_px: Array) -> Array:
    """From points (N, 2) to the nearest of others (M, 2) each, (N,)."""
    aside, above = (points_px[:, k, None] - others_px[:, k] for k in range(2))
    return np.sqrt((aside * aside + above * above).min(axis=1, initial=np.inf))


def distance_widths(setting: Setting, one: CameraFit, other: CameraFit) -> float:
    """Mean distance between the markings as two cameras show them, picture widths."""
    return mean_distance_px(one.view, other.view, setting.template) / setting.width
