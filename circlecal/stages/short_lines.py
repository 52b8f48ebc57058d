"""Straight markings too short to be told from players' limbs, but for a camera that says how markings run there.

A corner of the penalty area at the border of the picture settles how long and how broad the field is, which a circle, a
halfway line and a touchline leave open.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, level_points, project
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.broad_lines import predict_widths_along
from circlecal.paint.colour import lie_on_one_surface
from circlecal.paint.lines import ONE_ROUND, measure_lines
from circlecal.paint.predicted_width import blur_widths
from circlecal.paint.strays import keep_on_course
from circlecal.results import CameraFit, LineCue, Segment

__all__ = ["measure_short_lines"]

LARGEST_TURN_DEG = 20.0
"""Degrees in the picture between a short marking and the way that the field's length or width runs there. The front of
the penalty area ran 4 to 12 degrees beside it on a rendered pitch 120 m long that was taken for one of 105 m, and 12 to
20 degrees on one 79 m wide that was taken for 68 m: with 12 degrees that camera stayed 22 px off, with 20 it is 0.4 px
off. Of 800 rendered frames 20 degrees mend this one, and worsen none.
"""
BEYOND_M = 5.0
"""Metres beyond the field, whose size may be off, up to which the middle of a short marking may lie: boards stand
further out.
"""
BROADEST, LEAST_SUPPORT = 1.4, 0.8
"""Times the width of blurred paint there up to which a short run may be a marking, and share of its profiles on which
it must be seen. Of 64 that got names in 45 real frames all have at most 1.23, and nine in ten at least 0.9; of 147
others half have more than 1.1, a quarter more than 2.1, and a quarter are seen on less than 0.77.
"""
_AXES = np.eye(2)


def measure_short_lines(
    image: NDArray[np.uint8],
    picture: NDArray[np.uint8],
    runs: Array,
    fit: CameraFit,
    template: FieldTemplate,
    noise: float,
    blur_px: float,
    sampling_px: tuple[float, float],
) -> tuple[LineCue, ...]:
    """Measure those of some short straight runs that lie on the field and run along its length or width.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    picture : (H, W) uint8
        Its brightness, with the markings lighter than the field.
    runs : (R, 2, 2) array
        Ends of the runs, pixels.
    fit : CameraFit
        A camera that is about right in how the field runs, if not in its sizes.
    template : FieldTemplate
        The field.
    noise : float
        Grey-level noise of the picture.
    blur_px : float
        Standard deviation of its blur.
    sampling_px : (float, float)
        How far to both sides a marking may lie, at 1920 px width, and how far apart its profiles are.

    Returns
    -------
    tuple of LineCue
        Without names.
    """
    ends = runs[_run_along_axes(runs, fit, template)]
    ends = ends[lie_on_one_surface(image, ends)]
    measured = measure_lines(picture, [Segment(*pair) for pair in ends], noise, *sampling_px, ONE_ROUND)
    lines = [line for line in measured if line is not None and line.segment.support >= LEAST_SUPPORT]
    return tuple(
        keep_on_course(line, fit.model.width / 1920.0) for line in _leave_out_broad(lines, fit, template, blur_px)
    )


def _leave_out_broad(lines: list[LineCue], fit: CameraFit, template: FieldTemplate, blur_px: float) -> list[LineCue]:
    """The lines that are about as narrow as blurred paint is there."""
    ends = np.array([(line.segment.start, line.segment.end) for line in lines]).reshape(-1, 2, 2)
    painted_px = predict_widths_along(fit.theta, ends, template.marking_width_m, fit.model)
    largest_px = BROADEST * blur_widths(painted_px, blur_px)
    return [line for line, largest in zip(lines, largest_px.tolist(), strict=True) if line.width_px <= largest]


def _run_along_axes(ends: Array, fit: CameraFit, template: FieldTemplate) -> Mask:
    """Which runs (R, 2, 2) lie on the field or right beside it, and run along its length or its width there."""
    if len(ends) == 0:
        return np.zeros(0, np.bool_)
    middle = level_points(fit.theta[None], ends.mean(axis=1), fit.model)[0]
    half = 0.5 * (np.array([template.length_m, template.width_m]) + fit.theta[[INDEX["length"], INDEX["breadth"]]])
    is_on_field = (np.abs(middle) <= half + BEYOND_M).all(axis=1)
    there = project(fit.theta[None], middle[None], fit.model)
    span = ends[:, 1] - ends[:, 0]
    span /= np.maximum(np.linalg.norm(span, axis=1, keepdims=True), 1e-9)
    axes = np.array([there.along(x, y)[0] for x, y in _AXES[:, :, None, None]])  # (which, x or y, R)
    axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-9)
    across = np.abs(axes[:, 0] * span[:, 1] - axes[:, 1] * span[:, 0]).min(axis=0)
    return np.asarray(is_on_field & (across <= np.sin(np.deg2rad(LARGEST_TURN_DEG))), np.bool_)
