"""The field as the page draws it beside the picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from circlecal.field import FieldTemplate

KEYS = {
    "halfway_line": "h", "centre_circle": "c", "side_line_top": "t", "side_line_bottom": "b", "side_line_left": "l",
    "side_line_right": "r",
}  # fmt: skip
"""Keys of the markings that are named most."""
FURTHER_KEYS = "1234567890"
"""Keys of the other straight markings, in the template's order."""


def describe_field(template: FieldTemplate) -> dict[str, Any]:
    """Markings of a template with their polylines in metres, keys and SoccerNet classes, ready for JSON."""
    polylines = template.polylines(1.0)
    free = iter(key for key in FURTHER_KEYS)
    markings = []
    polylines |= {mark.name: np.array([mark.position]) for mark in template.marks}
    for kind, elements in (
        ("curve", (*template.circles, *template.arcs)),
        ("line", template.lines),
        ("point", template.marks),
    ):
        for element in elements:
            key = KEYS.get(element.name) or (next(free, None) if kind == "line" else None)
            markings.append(
                {
                    "name": element.name,
                    "label": element.name.replace("_", " "),
                    "class": element.class_name,
                    "kind": kind,
                    "key": key,
                    "points": np.round(polylines[element.name], 2).tolist(),
                }
            )
    return {
        "name": template.name,
        "length": template.length_m,
        "width": template.width_m,
        "circle": template.default_circle,
        "markings": markings,
    }
