"""Painters' errors: where the markings of one field lie that are not exactly where the sizes put them."""

from __future__ import annotations

import numpy as np

from circlecal.field import FieldTemplate

__all__ = ["displace_markings"]


def displace_markings(template: FieldTemplate, rng: np.random.Generator) -> FieldTemplate:
    """A field with each marking moved along x and along y by normal errors, as large as its template says.

    Parameters
    ----------
    template : FieldTemplate
        The field as it should be.
    rng : Generator
        Randomness; nothing is drawn where the template knows no such errors.
    """
    if template.placement_sd_m == 0.0:
        return template

    def draw_shift(_: str) -> tuple[float, float]:
        dx, dy = rng.normal(0.0, template.placement_sd_m, 2).tolist()
        return dx, dy

    return template.move_markings(draw_shift)
