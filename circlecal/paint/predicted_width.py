"""How wide the paint of circles and lines is in the picture, where a camera shows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array

__all__ = [
    "RESIDUAL_WIDTHS",
    "WIDE_PX",
    "blur_widths",
    "mean_paint_width",
    "predict_line_widths",
    "predict_paint_widths",
]

WIDE_PX = 16.0
"""Paint of more than so many pixels at 1920 px width is wide. Rendered robots' fields have 33 to 80 px where they are
nearest."""
RESIDUAL_WIDTHS = 0.05
"""Residual of a circle in widths of its paint, up to which it may be the paint's own: the middle of worn paint wanders
by a share of its width, 0.03 along the true circles of 40 rendered robots' fields, whose paint is up to 80 px wide at
1920 px width.
"""
GAUSSIAN_FWHM = 2.355
"""Full width at half the peak of a Gaussian blur, in its standard deviations."""
ROUND = 72
"""Places round a circle at which the width of its paint is predicted."""
ALONG = 65
"""Places along a line at which the width of its paint is predicted."""


def predict_paint_widths(view: FieldView, circle: Circle, template: FieldTemplate) -> Array:
    """Width (N,) of a circle's paint in the picture, pixels, at places all round that the picture shows; empty of the
    rim of a disc, which has none.
    """
    if circle.fill == "disc":
        return np.zeros(0)
    angle = np.linspace(0.0, 2 * np.pi, ROUND, endpoint=False)
    outer, inner = (view.project(view.circle_points(circle, edge, angle, template)) for edge in ("outer", "inner"))
    shown = view.shows(outer) & view.shows(inner)
    return np.asarray(np.linalg.norm(outer - inner, axis=1)[shown])


def predict_line_widths(
    project: Callable[[Array], Array], names: Sequence[str], seen_px: Array, template: FieldTemplate
) -> Array:
    """Width (K,) of the paint of straight markings in the picture, pixels; zero of those that it does not show.

    Parameters
    ----------
    project : callable
        Pixels (N, 2) of places (N, 2) on the field, nan where they are not in view.
    names : sequence of str
        The markings.
    seen_px : (K, 2) array
        Where each is seen: the width is that of its nearest place.
    template : FieldTemplate
        The field.
    """
    ends = np.array([(template.line_by_name[name].start, template.line_by_name[name].end) for name in names])
    span = ends[:, 1] - ends[:, 0]
    normal = np.stack([-span[:, 1], span[:, 0]], axis=-1) / np.linalg.norm(span, axis=-1, keepdims=True)
    middle = ends[:, 0, None] + np.linspace(0.0, 1.0, ALONG)[:, None] * span[:, None]
    half = 0.5 * template.marking_width_m * normal[:, None]
    rims = np.stack([middle - half, middle + half])
    pixels = project(rims.reshape(-1, 2)).reshape(rims.shape)
    is_visible = np.asarray(np.isfinite(pixels).all(axis=(0, 3)), np.bool_)
    away = np.where(is_visible, np.linalg.norm(pixels.mean(axis=0) - seen_px[:, None], axis=-1), np.inf)
    nearest = np.arange(len(ends)), np.argmin(away, axis=1)
    widths = np.linalg.norm(pixels[0] - pixels[1], axis=-1)[nearest]
    return np.where(is_visible[nearest], widths, 0.0)


def mean_paint_width(view: FieldView, circle: Circle, template: FieldTemplate) -> float:
    """Mean of these widths, pixels; 0 where the picture shows none of the paint."""
    widths = predict_paint_widths(view, circle, template)
    return float(widths.mean()) if len(widths) else 0.0


def blur_widths(widths_px: ArrayLike, blur_px: float) -> Array:
    """Widths at half height (...,), pixels, of paint of such widths in a picture with a blur, a standard deviation."""
    return np.asarray(np.hypot(widths_px, GAUSSIAN_FWHM * blur_px))
