"""The picture's brightness along the colour of a paint: where paint is about as light as the surface, gray levels hide
what colour shows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.paint.colour import measure_added_colours
from circlecal.paint.profiles import to_gray

__all__ = ["brightness_of_paint", "measure_paint"]

SUPPRESSION = 30.0
"""By how much the square of another paint's contrast counts over that of noise, which is alike in all three channels:
with 30 what is left of another paint whose colour is 60 degrees away is 5 % of its strength.
"""
PLACES, FEWEST_PLACES = 256, 32
"""Along a circle where its paint is looked at, and least of them in the picture."""


def brightness_of_paint(
    image: NDArray[np.uint8], colour: Sequence[float] | None, others: Sequence[Sequence[float]] = ()
) -> NDArray[np.uint8]:
    """Gray levels in which a paint is lighter than its surface, whatever its colour.

    The weights ``w`` of the three channels let through what the paint adds, ``c``, and least of noise and of other
    paints ``o_k`` (Fisher's linear discriminant, *The use of multiple measurements in taxonomic problems*, 1936):
    ``w = (I + s sum_k o_k o_k' / |o_k|^2)^-1 c``. They are scaled so that no picture leaves the range of 8 bits.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    colour : (3,) sequence or None
        What the paint adds to blue, green and red of its surface, in any strength; None for the usual gray levels.
    others : sequence of (3,)
        What other paints on the same surface add, which shall not show.
    """
    if colour is None:
        return to_gray(image)
    wanted = np.asarray(colour, np.float64)
    spread = np.eye(3)
    for other in others:
        direction = np.asarray(other, np.float64) / max(float(np.linalg.norm(other)), 1e-9)
        spread += SUPPRESSION * np.outer(direction, direction)
    weights = np.linalg.solve(spread, wanted)
    weights /= max(float(np.abs(weights).sum()), 1e-9)
    table = np.arange(256)[:, None] * weights - 255.0 * np.minimum(weights, 0.0)
    blue, green, red = (table[:, channel].astype(np.float32)[image[..., channel]] for channel in range(3))
    return np.rint(blue + green + red).clip(0.0, 255.0).astype(np.uint8)


def measure_paint(
    image: NDArray[np.uint8], view: FieldView, circle: Circle, template: FieldTemplate
) -> tuple[float, float, float] | None:
    """What the paint of a circle adds to blue, green and red of its surface: medians over the places where a camera
    shows it; None where the picture shows too little of it.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    view : FieldView
        Where the field is seen.
    circle, template : Circle, FieldTemplate
        Whose paint is looked at.
    """
    height, width = image.shape[:2]
    angle = np.linspace(0.0, 2 * np.pi, PLACES, endpoint=False)
    middle, outer, inner = (
        view.project(template.curve_points(circle, edge, angle)) for edge in ("center", "outer", "inner")
    )
    across = outer - inner
    along = np.gradient(middle, axis=0)
    normals = np.stack([along[:, 1], -along[:, 0]], axis=-1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    widths = np.abs(np.sum(across * normals, axis=1))
    shown = np.isfinite(middle).all(axis=1) & np.isfinite(widths) & np.isfinite(normals).all(axis=1)
    shown &= ((middle >= 0) & (middle <= (width - 1, height - 1))).all(axis=1)
    if np.count_nonzero(shown) < FEWEST_PLACES:
        return None
    added = np.median(measure_added_colours(image, middle[shown], normals[shown], widths[shown]), axis=0)
    blue, green, red = np.round(added, 1).tolist()
    return blue, green, red
