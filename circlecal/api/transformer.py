"""The camera in the shape in which tracking code asks for it: an object with ``transform_points``."""

from __future__ import annotations

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, PointsLike


def as_points(given: PointsLike) -> Array:
    """Points as an array of numbers; nan where a masked array hides them."""
    if isinstance(given, np.ma.MaskedArray):
        return np.asarray(np.ma.filled(given.astype(np.float64), np.nan))
    return np.asarray(given, dtype=np.float64)


class ViewTransformer:
    """Pixels to places on a map of the field; stands in for a transformer made of four points and a homography.

    Unlike a homography it knows the lens and the surface.

    Parameters
    ----------
    view : FieldView or None
        The field before the camera; without one every answer is nan.
    template : FieldTemplate or None
        The field, of which a map with a size is one.
    size : (float, float), optional
        Length and width of the map, both positive, such as ``(12000, 7000)``; its origin is the corner of the field
        that the main camera sees top left, and the field, as long and broad as it was estimated, is stretched to it.
        Metres from the centre mark when None.

    Raises
    ------
    ValueError
        The map has no length or no width.
    """

    def __init__(
        self, view: FieldView | None, template: FieldTemplate | None, size: tuple[float, float] | None = None
    ) -> None:
        if size is not None and not _is_size(size):
            raise ValueError(f"size must be the length and width of a map, both positive, not {size}")
        self._view = view
        self._scale, self._origin_m = np.ones(2), np.zeros(2)
        if size is not None and template is not None:
            own = np.array([template.length_m, template.width_m]) + (0.0 if view is None else view.growth_m)
            self._scale, self._origin_m = np.asarray(size, dtype=np.float64) / own, -own / 2.0

    def transform_points(self, points: PointsLike) -> Array:
        """Places (N, 2) on the map of what is seen at pixels (N, 2); nan where that is no point of the field.

        Raises
        ------
        ValueError
            The last axis does not hold the column and the row of each pixel.
        """
        pixels = as_points(points)
        if pixels.size and pixels.shape[-1:] != (2,):
            raise ValueError(f"pixels must be (N, 2), not of shape {pixels.shape}")
        pixels = pixels.reshape(-1, 2)
        field = np.full(pixels.shape, np.nan) if self._view is None else self._view.to_field(pixels)
        return np.asarray((field - self._origin_m) * self._scale)


def _is_size(given: object) -> bool:
    """Whether a caller gave two finite numbers above 0."""
    try:
        sides = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return sides.shape == (2,) and bool((np.isfinite(sides) & (sides > 0.0)).all())
