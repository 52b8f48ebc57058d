"""Where on the field a picture shows a place, and whether it is surely within the border."""

from __future__ import annotations

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, Mask

__all__ = ["half_field", "is_surely_inside", "lie_inside", "to_ground"]

INSIDE_M, INSIDE_SIGMAS = 1.0, 2.0
"""So far within the field's outline a place lies surely on the field: metres, and standard deviations."""


def to_ground(view: FieldView, places: Array) -> tuple[Array, Array]:
    """Field points (N, 2) of pixels, not finite above the horizon, and their standard deviations (N,), metres."""
    seen = view.to_field(places, sigma=True)
    sigma = np.zeros(len(places)) if seen.sigma is None else np.nan_to_num(seen.sigma, nan=np.inf)
    return seen.points, sigma


def lie_inside(view: FieldView, places: Array, template: FieldTemplate) -> Mask:
    """Which pixels (N, 2) show a place that lies surely within the field's outline."""
    return is_surely_inside(*to_ground(view, places), half_field(view, template))


def half_field(view: FieldView, template: FieldTemplate) -> Array:
    """Half the length and breadth (2,) of the field, metres."""
    return np.asarray(0.5 * (np.array([template.length_m, template.width_m]) + view.growth_m))


def is_surely_inside(points: Array, sigma: Array, half: Array) -> Mask:
    """Which field points (N, 2) with standard deviations (N,) lie surely within the outline."""
    margin = INSIDE_M + INSIDE_SIGMAS * sigma
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(points) + margin[:, None] < half).all(axis=1), np.bool_)
