"""How wide the paint of a circle is in the picture, where a camera shows it."""

from __future__ import annotations

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array

__all__ = ["RESIDUAL_WIDTHS", "WIDE_PX", "mean_paint_width", "predict_paint_widths"]

WIDE_PX = 16.0
"""Paint of more than so many pixels at 1920 px width is wide. Rendered robots' fields have 33 to 80 px where they are
nearest."""
RESIDUAL_WIDTHS = 0.05
"""Residual of a circle in widths of its paint, up to which it may be the paint's own: the middle of worn paint wanders
by a share of its width, 0.03 along the true circles of 40 rendered robots' fields, whose paint is up to 80 px wide at
1920 px width.
"""
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


def mean_paint_width(view: FieldView, circle: Circle, template: FieldTemplate) -> float:
    """Mean of these widths, pixels; 0 where the picture shows none of the paint."""
    widths = predict_paint_widths(view, circle, template)
    return float(widths.mean()) if len(widths) else 0.0
