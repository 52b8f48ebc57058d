"""Painters' errors: where the markings of one field lie that are not exactly where the sizes put them."""

from __future__ import annotations

import numpy as np

from circlecal.field import FieldTemplate

__all__ = ["displace_markings"]


def displace_markings(template: FieldTemplate, rng: np.random.Generator) -> FieldTemplate:
    """A field with each marking moved along x and along y, and each size of circles drawn larger or smaller, by normal
    errors as large as its template says.

    Parameters
    ----------
    template : FieldTemplate
        The field as it should be.
    rng : Generator
        Randomness; nothing is drawn where the template knows no such errors.
    """
    if max(template.placement_sd_m, template.radius_sd_m) == 0.0:
        return template
    growths: dict[float, float] = {}

    def draw_shift(_: str) -> tuple[float, float]:
        dx, dy = rng.normal(0.0, template.placement_sd_m, 2).tolist()
        return dx, dy

    def draw_growth(radius_m: float) -> float:
        if template.radius_sd_m == 0.0:
            return 0.0
        # circles of one size are drawn with one compass
        size = round(radius_m, 3)
        if size not in growths:
            growths[size] = float(rng.normal(0.0, template.radius_sd_m))
        return growths[size]

    return template.move_markings(draw_shift, draw_growth)
