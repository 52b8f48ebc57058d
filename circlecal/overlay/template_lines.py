"""The field template, drawn where a view sees it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from circlecal.camera.covariance import count_from_seen
from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array
from circlecal.overlay.canvas import Canvas
from circlecal.overlay.page_view import cell_centers
from circlecal.overlay.palette import CIRCLE, TEMPLATE, Color

_MARGIN = 0.6
"""How far beyond the picture a marking is drawn, in its size: pixel coordinates far outside say nothing to an eye and
overflow drawing programs.
"""
_SIGMA_STEPS = 210.0
"""Pieces of a marking as long as the field at whose ends its standard deviation is taken."""
COLUMNS = 96
"""Columns of the grid on which standard deviations are shown over a picture."""


def pixels_near_picture(view: FieldView, points_m: Array) -> Array:
    """Pixels (N, 2) of field points (N, 2), nan where they are not visible or far outside the picture."""
    pixels = view.project(points_m)
    size = np.array([view.camera.width, view.camera.height])
    near = (np.abs(pixels - (size - 1) / 2) <= (0.5 + _MARGIN) * size).all(axis=-1, keepdims=True)
    return np.asarray(np.where(near, pixels, np.nan))


def draw_template(
    canvas: Canvas,
    view: FieldView,
    template: FieldTemplate,
    circle: str,
    color: Color = TEMPLATE,
    dashed: bool = False,
    most_sigma_px: float = np.inf,
) -> None:
    """Draw every marking's centreline, the circle that carried the calibration in its own colour; dashed where asked
    for, and those whose standard deviation in the picture is more than ``most_sigma_px``.
    """
    sigmas = marking_sigmas(view, template) if np.isfinite(most_sigma_px) else {}
    for name, polyline in view.markings(template).items():
        own = CIRCLE if name == circle and color == TEMPLATE else color
        pixels = pixels_near_picture(view, polyline)
        is_dashed = (dashed and name not in template.mark_by_name) or sigmas.get(name, 0.0) > most_sigma_px
        canvas.polyline(pixels, own, 1.4, dashed=is_dashed)


def marking_sigmas(view: FieldView, template: FieldTemplate) -> dict[str, float]:
    """Largest standard deviation in the picture, pixels, of each marking that the picture shows, by its name: what is
    open of the size of the field is open of a marking as far as it moves with that. Nothing where the covariance of
    the camera is not known.
    """
    found = {}
    for name, polyline in template.polylines(template.length_m / _SIGMA_STEPS).items():
        moves, _ = template.growth_of(polyline)
        own = count_sigma_from_seen(view, moves)
        pixels, sigma = own.project(view.grow(polyline, template), sigma=True)
        shown = view.shows(pixels)
        if sigma is not None and shown.any():
            found[name] = float(np.nanmax(sigma[shown]))
    return found


def count_sigma_from_seen(view: FieldView, by_growth: ArrayLike) -> FieldView:
    """The view with standard deviations that count from what was seen instead of from the middle of the field, as the
    frame's own predicted errors do: a goal that is seen lies where it is seen, however long the field is.

    Parameters
    ----------
    view : FieldView
        The view.
    by_growth : (2,) array
        By how much what was seen moves along x per metre that the field is longer, and along y per metre that it is
        broader (:attr:`circlecal.results.CameraFit.reference_by_growth`).
    """
    if view.covariance is None:
        return view
    turn = count_from_seen(np.asarray(by_growth, dtype=np.float64))
    return replace(view, covariance=turn @ view.covariance @ turn.T)


def sigma_over_picture(view: FieldView, template: FieldTemplate) -> Array | None:
    """Standard deviation in pixels on a grid (R, COLUMNS) of the picture, nan off the field; None where the
    covariance of the camera is not known.
    """
    rows = max(2, round(COLUMNS * view.camera.height / view.camera.width))
    field = view.to_field(cell_centers(view, COLUMNS, rows))
    half = np.array([template.length_m, template.width_m]) / 2 + 1.0
    field[~(np.abs(field) <= half).all(axis=-1)] = np.nan
    return view.project(field, sigma=True).sigma
