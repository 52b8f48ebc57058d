"""Straight markings that were measured where a view puts them, and are no paint of this field: streaks of light along a
floor, other sports' lines beside the field's own, and lines that the halfway line runs beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, fit_line
from circlecal.line_naming.line_ends import find_line_through, lies_short_of_end
from circlecal.observations import CirclePoints, LineEnd, LinePoints
from circlecal.paint.colour import match_paint, measure_added_colour
from circlecal.paint.predicted_width import blur_widths, mean_paint_width, predict_line_widths

__all__ = ["leave_out_short_borders", "leave_out_streaks"]

LEAST_STRENGTH = 0.2
"""Share of the contrast of the circle's or the halfway line's paint, at the width that the view predicts, that the
paint of another line has at least: of 416 lines of 160 rendered halls true ones have 0.25 at least, four of seven
false ones (streaks of light on the floor, 5 to 32 px off) 0.09 to 0.16.
"""
STEP = 0.01
"""Share of a circle's radius by which two places lie beside its curve, between which its normal runs."""


@dataclass(frozen=True, slots=True)
class _Paint:
    """What a marking adds to the blue, green and red of its surface (3,), and which share of its full contrast paint of
    its width keeps in the blurred picture.
    """

    colour: Array
    kept: float

    @property
    def strength(self) -> float:
        """Its full contrast, grey levels."""
        return float(np.linalg.norm(self.colour)) / max(self.kept, 1e-6)


def leave_out_streaks(
    image: NDArray[np.uint8],
    view: FieldView,
    template: FieldTemplate,
    circles: Sequence[CirclePoints],
    lines: Sequence[LinePoints],
    blur_px: float,
) -> tuple[LinePoints, ...]:
    """The lines that may have the paint of the circles and the halfway line, in colour and in strength; all of them
    where none of these is seen.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    view : FieldView
        Where the markings were measured.
    template : FieldTemplate
        A field with all markings in one paint.
    circles, lines : sequence of CirclePoints, LinePoints
        What was measured, with names.
    blur_px : float
        Standard deviation of the picture's blur, pixels.
    """
    if not lines:
        return ()
    places = np.array([line.points_px[len(line.points_px) // 2] for line in lines])
    widths = predict_line_widths(view.project, [line.line or "" for line in lines], places, template)
    paints = [
        _measure_paint(image, line.points_px, fit_line(line.points_px)[:2], w, blur_px)
        for line, w in zip(lines, widths.tolist(), strict=True)
    ]
    known = [paint for line, paint in zip(lines, paints, strict=True) if line.line == template.halfway_line]
    round_paints = [_measure_circle_paint(image, view, template, circle, blur_px) for circle in circles]
    known += [paint for paint in round_paints if paint is not None]
    if not known:
        return tuple(lines)
    least = LEAST_STRENGTH * max(paint.strength for paint in known)
    return tuple(
        line
        for line, paint in zip(lines, paints, strict=True)
        if line.line == template.halfway_line
        or (paint.strength >= least and any(match_paint(paint.colour, own.colour) for own in known))
    )


def _measure_circle_paint(
    image: NDArray[np.uint8], view: FieldView, template: FieldTemplate, seen: CirclePoints, blur_px: float
) -> _Paint | None:
    """The paint of a circle or an arc that was measured where a view puts it; None where the view shows none of it."""
    circle = next(c for c in template.round_ones if c.name == seen.circle)
    center_m = view.center_of(circle, template)
    outward_m = view.to_field(seen.points_px) - center_m
    across = view.project(center_m + (1.0 + STEP) * outward_m) - view.project(center_m + (1.0 - STEP) * outward_m)
    length = np.linalg.norm(across, axis=1)
    shown = length > 0.0
    if not shown.any():
        return None
    width_px = mean_paint_width(view, circle, template)
    return _measure_paint(image, seen.points_px[shown], across[shown] / length[shown, None], width_px, blur_px)


def _measure_paint(image: NDArray[np.uint8], points: Array, normals: Array, width_px: float, blur_px: float) -> _Paint:
    """The paint at places (N, 2) with normals (N, 2), or one (2,), of a marking of a predicted width, by medians."""
    kept = width_px / max(float(blur_widths(width_px, blur_px)), 1e-6)
    return _Paint(measure_added_colour(image, points, normals, width_px), kept)


def leave_out_short_borders(
    view: FieldView,
    template: FieldTemplate,
    center_m: Array,
    lines: Sequence[LinePoints],
    ends: Sequence[LineEnd],
) -> tuple[LinePoints, ...]:
    """The lines without those on which the halfway line should end, and beyond which its paint was seen to end.

    Parameters
    ----------
    view : FieldView
        Where the lines were measured.
    template : FieldTemplate
        The field.
    center_m : (2,) array
        A place on the halfway line between its ends, metres.
    lines : sequence of LinePoints
        What was measured, with names.
    ends : sequence of LineEnd
        Where the paint of the halfway line was seen to end.
    """
    halfway = template.line_by_name.get(template.halfway_line or "")
    if halfway is None or not ends:
        return tuple(lines)
    others = (find_line_through(corner, halfway, template) for corner in template.line_ends(halfway))
    borders = {other.name for other in others if other is not None}
    center_px, unit = view.project(center_m), view.camera.width / 1920.0
    return tuple(
        line
        for line in lines
        if line.line not in borders or not lies_short_of_end(line.points_px, ends, center_px, unit)
    )
