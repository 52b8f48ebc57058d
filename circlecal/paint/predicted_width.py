"""How wide the paint of a circle is in the picture, where a camera shows it."""

from __future__ import annotations

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array

__all__ = ["WIDE_PX", "predict_paint_widths"]

WIDE_PX = 16.0
"""Paint of more than so many pixels at 1920 px width is wide. Rendered robots' fields have 33 to 80 px where they are
nearest."""
ROUND = 72
"""Places round a circle at which the width of its paint is predicted."""


def predict_paint_widths(view: FieldView, circle: Circle, template: FieldTemplate) -> Array:
    """Width (N,) of a circle's paint in the picture, pixels, at places all round that the picture shows; empty of the
    rim of a disc, which has none.
    """
    if circle.fill == "disc":
        return np.zeros(0)
    angle = np.linspace(0.0, 2 * np.pi, ROUND, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    outer, inner = (
        view.project(np.asarray(circle.center) + template.radius(circle, edge) * ring) for edge in ("outer", "inner")
    )
    shown = view.shows(outer) & view.shows(inner)
    return np.asarray(np.linalg.norm(outer - inner, axis=1)[shown])
