"""One answer to where a point of the field is seen, how surely, and what part of the field a pixel shows.

With a camera the lens and the crown of the surface are in the answer; with a homography alone the picture is taken as
free of distortion and the field as flat.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike

from circlecal.field import Circle, FieldTemplate, unit_circle
from circlecal.field.template import Edge
from circlecal.geometry.camera import Camera, PlaneCamera
from circlecal.geometry.camera_parameters import Projection, ProjectionModel, project, theta_of
from circlecal.geometry.projective import Array, Mask
from circlecal.geometry.short_repr import ShortRepr
from circlecal.geometry.surface import FLAT, Surface

_CURVE_STEPS = 420.0
"""Pieces into which a marking as long as the field is divided to be drawn."""


class Projected(NamedTuple):
    """Points (..., 2) in the other frame, and the standard deviation (...,) of the length of their error.

    Both are nan where there is no answer; ``sigma`` is None where the covariance of the camera is not known.
    """

    points: Array
    sigma: Array | None


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class FieldView(ShortRepr):
    """A field before a camera.

    Attributes
    ----------
    camera : Camera or PlaneCamera
        The camera, or a homography where no camera is known.
    surface : Surface
        With its crown.
    growth_m : (2,) array
        By how much this field is longer and broader than its template.
    covariance : (P, P) array or None
        Of the camera's parameters, in the order of :data:`circlecal.geometry.camera_parameters.PARAMETERS`.
    """

    camera: Camera | PlaneCamera
    surface: Surface = FLAT
    growth_m: Array = field(default_factory=lambda: np.zeros(2))
    covariance: Array | None = None

    @overload
    def project(self, points_m: ArrayLike, sigma: Literal[False] = False) -> Array: ...

    @overload
    def project(self, points_m: ArrayLike, sigma: Literal[True]) -> Projected: ...

    def project(self, points_m: ArrayLike, sigma: bool = False) -> Array | Projected:
        """Where points of the field are seen.

        Parameters
        ----------
        points_m : (..., 2) or (..., 3) array
            Points on the field, or points in space, metres; z points down from the level of the centre mark.
        sigma : bool
            Whether their standard deviations are returned too.

        Returns
        -------
        (..., 2) array or Projected
            Pixels of the stored picture, also outside its borders; nan behind the camera, where the lens model folds
            back, and of points in space where only a homography is known. The standard deviations are in pixels; nan
            for points in space.
        """
        points = np.asarray(points_m, dtype=np.float64)
        if points.shape[-1] == 3:
            pixels = self._project_space(points)
            return Projected(pixels, np.full(pixels.shape[:-1], np.nan)) if sigma else pixels
        pixels = self.camera.project(self.surface.lift(points))
        return Projected(pixels, self._sigma(points, pixels, 0)) if sigma else pixels

    @overload
    def to_field(self, points_px: ArrayLike, sigma: Literal[False] = False) -> Array: ...

    @overload
    def to_field(self, points_px: ArrayLike, sigma: Literal[True], point_sigma_px: ArrayLike = 0.0) -> Projected: ...

    def to_field(self, points_px: ArrayLike, sigma: bool = False, point_sigma_px: ArrayLike = 0.0) -> Array | Projected:
        """What points of the field are seen at pixels.

        Parameters
        ----------
        points_px : (..., 2) array
            Pixels of the stored picture.
        sigma : bool
            Whether their standard deviations are returned too.
        point_sigma_px : float or (...,) array
            How well the pixels themselves are known, one standard deviation along x and along y, which enters these.

        Returns
        -------
        (..., 2) array or Projected
            Field points, metres; nan on and above the horizon, where the ray passes over the surface, and further out
            than the lens model puts any point. The standard deviations are in metres on the ground.
        """
        pixels = np.asarray(points_px, dtype=np.float64)
        points = self.camera.back_project(pixels, self.surface)
        return Projected(points, self._sigma(points, pixels, 1, point_sigma_px)) if sigma else points

    def image_covariance(self, points_m: ArrayLike) -> Array:
        """Covariances (..., 2, 2), pixels squared, of where field points (..., 2) are seen; nan where not known."""
        points = np.asarray(points_m, dtype=np.float64)
        return self._covariance(points, self.project(points), 0)

    def field_covariance(self, points_px: ArrayLike, point_sigma_px: ArrayLike = 0.0) -> Array:
        """Covariances (..., 2, 2), square metres, of the field points seen at pixels (..., 2), which are known to a
        standard deviation of their own, as for :meth:`to_field`; nan where not known.
        """
        pixels = np.asarray(points_px, dtype=np.float64)
        return self._covariance(self.to_field(pixels), pixels, 1, point_sigma_px)

    def shows(self, points_px: ArrayLike, margin_px: float = 0.0) -> Mask:
        """Whether pixels (..., 2) lie in the picture, or at most so far outside the centres of its outermost pixels."""
        pixels = np.asarray(points_px, dtype=np.float64)
        last = np.array([self.camera.width, self.camera.height]) - 1.0
        return np.asarray(((pixels >= -margin_px) & (pixels <= last + margin_px)).all(axis=-1), np.bool_)

    def visible_field(
        self, template: FieldTemplate, center_m: ArrayLike = (0.0, 0.0), reach_m: float = np.inf, step_m: float = 1.0
    ) -> Array:
        """Points (N, 2) of the template's field, on a grid, that the picture shows.

        Parameters
        ----------
        template : FieldTemplate
            The field.
        center_m, reach_m : (2,) array, float
            No point is further from this one along x or y.
        step_m : float
            Spacing of the grid.
        """
        half, center = np.array([template.length_m, template.width_m]) / 2.0, np.asarray(center_m, dtype=np.float64)
        least, most = np.maximum(-half, center - reach_m), np.minimum(half, center + reach_m)
        x, y = (_spread_evenly(low, high, step_m) for low, high in zip(least, most, strict=True))
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return np.asarray(grid[self.shows(self.project(grid))])

    def markings(self, template: FieldTemplate) -> dict[str, Array]:
        """Centrelines of all markings and rims of all marks as polylines (N, 2) in metres, at this field's own size."""
        drawn = template.polylines(template.length_m / _CURVE_STEPS)
        rim = 0.5 * unit_circle(np.linspace(0.0, 2 * np.pi, 25))
        drawn.update({mark.name: np.asarray(mark.position) + mark.diameter_m * rim for mark in template.marks})
        return {name: self.grow(polyline, template) for name, polyline in drawn.items()}

    def grow(self, marking_m: Array, template: FieldTemplate) -> Array:
        """Markings (..., N, 2) of the template where this longer and broader field has them.

        See :meth:`circlecal.field.template.FieldTemplate.growth_of`.
        """
        moves, stretches = template.growth_of(marking_m)
        return np.asarray(marking_m + self.growth_m * (moves[..., None, :] + stretches[..., None, :] * marking_m))

    def center_of(self, circle: Circle, template: FieldTemplate) -> Array:
        """Centre (2,) of a circle or an arc of the template on this longer and broader field, metres."""
        return template.center_after_growth(circle, self.growth_m)

    def circle_points(self, circle: Circle, edge: Edge, angle_rad: Array, template: FieldTemplate) -> Array:
        """Points (..., 2) on this field, metres, as :meth:`circlecal.field.template.FieldTemplate.curve_points` gives
        them on the template's.
        """
        moved = self.center_of(circle, template) - circle.center
        return np.asarray(template.curve_points(circle, edge, angle_rad) + moved)

    def _project_space(self, points_m: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in space."""
        if isinstance(self.camera, Camera):
            return self.camera.project(points_m)
        return np.where(points_m[..., 2:] == 0.0, self.camera.project(points_m), np.nan)

    def _sigma(
        self, points_m: Array, points_px: Array, frame: Literal[0, 1], point_sigma_px: ArrayLike = 0.0
    ) -> Array | None:
        """Standard deviations (...,) in the picture (0) or on the ground (1); nan where either point is."""
        if self.covariance is None or not isinstance(self.camera, Camera):
            return None
        seen = np.isfinite(points_m).all(axis=-1) & np.isfinite(points_px).all(axis=-1)
        sigma = np.full(seen.shape, np.nan)
        if seen.any():
            own = np.broadcast_to(point_sigma_px, seen.shape)[seen]
            sigma[seen] = self._projection(self.camera, points_m[seen]).sigma(self.covariance, own)[frame]
        return sigma

    def _covariance(
        self, points_m: Array, points_px: Array, frame: Literal[0, 1], point_sigma_px: ArrayLike = 0.0
    ) -> Array:
        """Covariances (..., 2, 2) in the picture (0) or on the ground (1); nan where either point is, or unknown."""
        seen = np.isfinite(points_m).all(axis=-1) & np.isfinite(points_px).all(axis=-1)
        found = np.full((*seen.shape, 2, 2), np.nan)
        if seen.any() and self.covariance is not None and isinstance(self.camera, Camera):
            own = np.broadcast_to(point_sigma_px, seen.shape)[seen]
            found[seen] = self._projection(self.camera, points_m[seen]).covariances(self.covariance, own)[frame]
        return found

    def _projection(self, camera: Camera, points_m: Array) -> Projection:
        model = ProjectionModel.of(camera, self.surface)
        return project(theta_of(camera, model, self.surface.crown_m)[None], points_m[None], model)


def _spread_evenly(low: float, high: float, step: float) -> Array:
    """Numbers (N,) between two others, a step apart from each other, as far from the one end as from the other."""
    steps = int(np.floor((high - low) / step + 1e-9))
    return np.asarray((low + high) / 2.0 + step * (np.arange(steps + 1) - steps / 2.0), np.float64)
