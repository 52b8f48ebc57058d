"""How long the field is, from the circle in its middle: where lines at one end tell the camera, the circle is painted
half a field from them, and its paint says where that is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, camera_of, project
from circlecal.geometry.projective import Array, Indices
from circlecal.paint.matched_filter import CLEAR, EVEN_ANGLES, SAMPLES
from circlecal.results import CameraFit
from circlecal.stages.confirm import measure_circle_sectors

__all__ = ["HALF_CIRCLE", "find_size_by_circle", "misses_circle"]

STEP_WIDTHS = 1.0
"""By how many widths of its paint the circle moves from one tried length to the next: the filter sees paint within one
width to both sides.
"""
FEWEST_SECTORS, PAINTED_SHARE = 4, 0.75
"""Sectors of 24 that the picture must show of the circle, and the share of them that must be painted: a straight line
or the edge of a shadow touches a circle in two.
"""
HALF_CIRCLE = 12
"""Sectors in view of a circle that is painted at no length of the field, from which on the camera is not believed: of
99 answers without the circle to real clips one has 6 in view, the others none; a rendered frame that shows the whole
circle, 150 px from where such a camera puts it, has 24.
"""


def find_size_by_circle(
    picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle
) -> CameraFit | None:
    """The camera on a field of that length with which the circle lies on paint, seen from where it saw its lines.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    fit : CameraFit
        A camera from markings at one end of the field.
    template, circle : FieldTemplate, Circle
        The field, and the circle in its middle.

    Returns
    -------
    CameraFit or None
        With other parameters, camera and view, all else unchanged; None where the length is known, moves nothing that
        was seen, or no length lays enough of the circle on paint.
    """
    extent = template.length_range_m
    if extent is None or not _is_length_open(fit):
        return None
    step_m = STEP_WIDTHS * template.paint_width(circle) / abs(float(fit.reference_by_growth[0]))
    growths = np.arange(extent[0], extent[1] + step_m / 2, step_m) - template.length_m
    tried = [_stretch(fit, growth) for growth in growths.tolist()]
    in_view = _count_in_view(tried, template, circle) >= FEWEST_SECTORS
    tried = [stretched for stretched, is_seen in zip(tried, in_view.tolist(), strict=True) if is_seen]
    paint = np.array([_measure_paint(picture, stretched, template, circle) for stretched in tried])
    return tried[int(paint.argmax())] if paint.any() else None


def misses_circle(fit: CameraFit, template: FieldTemplate, circle: Circle, sectors: int = FEWEST_SECTORS) -> bool:
    """Whether a camera from markings at one end of the field was fitted without the circle, of which it has so many
    sectors of 24 in its picture: only the circle tells how long the field is.
    """
    is_open = template.length_range_m is not None and _is_length_open(fit)
    return is_open and bool(_count_in_view([fit], template, circle)[0] >= sectors)


def _is_length_open(fit: CameraFit) -> bool:
    """Whether a length of the field was looked for, and what was seen lies elsewhere on a longer one."""
    return fit.field_size is not None and bool(fit.reference_by_growth[0])


def _count_in_view(fits: list[CameraFit], template: FieldTemplate, circle: Circle) -> Indices:
    """How many of the middles of 24 sectors of the circle each camera (G,) has in its picture."""
    model, angles = fits[0].model, EVEN_ANGLES[SAMPLES // 2 :: SAMPLES]
    seen = project(np.array([fit.theta for fit in fits]), template.curve_points(circle, "center", angles)[None], model)
    inside = ((seen.pixels >= 0) & (seen.pixels <= (model.width - 1, model.height - 1))).all(axis=-1)
    return np.asarray((inside & seen.visible).sum(axis=1))


def _measure_paint(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> float:
    """By how many standard deviations the paint of the circle stands out, mean of its sectors; 0 where too few are in
    view, or too many of these are bare.
    """
    sectors: Array = measure_circle_sectors(picture, fit, template, circle)
    if len(sectors) < FEWEST_SECTORS or np.mean(sectors > CLEAR) < PAINTED_SHARE:
        return 0.0
    return float(sectors.mean())


def _stretch(fit: CameraFit, growth_m: float) -> CameraFit:
    """The camera before a field that is longer by so many metres, where what was seen looks as before."""
    theta = fit.theta.copy()
    more_m = growth_m - float(theta[INDEX["length"]])
    theta[INDEX["length"]] = growth_m
    theta[INDEX["x"]] += float(fit.reference_by_growth[0]) * more_m
    return replace(fit, theta=theta, camera=camera_of(theta, fit.model))
