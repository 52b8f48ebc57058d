"""A field template as a picture: every marking as broad and in the colour that it is painted in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.files import write_atomic
from circlecal.geometry.projective import Array
from circlecal.overlay.canvas import Picture
from circlecal.pictures.files import distinct_names

LONGEST_PX, LARGEST_PX_PER_M = 1400.0, 80.0
"""Length of the longer side, pixels, and the largest scale, pixels per metre, of a short field."""
BORDER_SHARE = 0.04
"""Of the field's length, on every side."""
LEAST_WIDTH_PX = 2.0
"""Of a line, pixels, so that thin paint on a long field is seen."""
_SHIFT = 4
_GRASS, _FLOOR, _ICE = (74, 122, 64), (150, 190, 220), (245, 243, 238)
SURFACE_BGR = {"light": _GRASS, "any": _FLOOR, "dark": _ICE}
"""Surface by the polarity of the markings on it."""
PAINT_BGR = {
    "light": (250, 250, 250),
    "dark": (50, 50, 50),
    "red": (45, 40, 200),
    "blue": (190, 90, 30),
    "yellow": (40, 210, 240),
}
"""Paint by the template's name of its colour."""


def draw_template(template: FieldTemplate) -> Picture:
    """A field from straight above, x to the right and y downwards, as uint8 BGR.

    Discs are filled, lines have their own width; on a floor whose lines may have any colour they are drawn dark.
    """
    border = BORDER_SHARE * template.length_m
    scale = min(LONGEST_PX / (template.length_m + 2 * border), LARGEST_PX_PER_M)
    half = np.array([template.length_m, template.width_m]) / 2 + border
    columns, rows = (round(2 * side * scale) for side in half)
    picture = np.full((rows, columns, 3), SURFACE_BGR[template.polarity], dtype=np.uint8)

    def fixed(points: Array) -> Array:
        return np.rint(((points + half) * scale - 0.5) * (1 << _SHIFT)).astype(np.int32)

    def paint(name: str) -> tuple[int, int, int]:
        return PAINT_BGR["dark" if template.polarity == "any" and name == "light" else name]

    drawn = template.polylines(step_m=1.0 / scale)
    for circle in sorted(template.round_ones, key=lambda c: -c.radius_m):
        if circle.fill == "disc":
            cv2.fillPoly(picture, [fixed(drawn[circle.name])], paint(circle.color), cv2.LINE_AA, _SHIFT)
            cv2.polylines(picture, [fixed(drawn[circle.name])], False, PAINT_BGR["light"], 1, cv2.LINE_AA, _SHIFT)
    for element in (*template.lines, *template.round_ones):
        if not (isinstance(element, Circle) and element.fill == "disc"):
            width = template.paint_width(element) * scale
            thickness = max(round(LEAST_WIDTH_PX), round(width))
            line = fixed(drawn[element.name])
            cv2.polylines(picture, [line], False, paint(element.color), thickness, cv2.LINE_AA, _SHIFT)
    for mark in template.marks:
        radius = max(LEAST_WIDTH_PX, mark.diameter_m / 2 * scale)
        x, y = fixed(np.array(mark.position)).tolist()
        cv2.circle(picture, (x, y), round(radius * (1 << _SHIFT)), paint(mark.color), cv2.FILLED, cv2.LINE_AA, _SHIFT)
    return picture


def write_template_pictures(templates: Sequence[FieldTemplate], folder: Path) -> list[Path]:
    """Draw templates into a folder, which is made where it is missing.

    Returns
    -------
    list of Path
        ``<name>.png`` of each; further ones of the same name are numbered.

    Raises
    ------
    InputError
        Where the folder cannot be written to.
    """
    written = []
    for name, template in zip(distinct_names([t.name for t in templates]), templates, strict=True):
        path = folder / f"{name}.png"
        write_atomic(path, cv2.imencode(".png", draw_template(template))[1].tobytes())
        written.append(path)
    return written
