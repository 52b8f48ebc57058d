"""A calibrated frame as the outside formats need it: camera, homography of the flat field, derived points, tangents.

Other programs' fields are flat and their pictures often free of distortion, ours need not be: what they cannot say is
put into what they can, so that the field in view projects to where it is seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from circlecal.camera.flat import flat_camera
from circlecal.camera.parameters import ProjectionModel
from circlecal.field import Circle, FieldTemplate
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.camera import Camera, camera_from_homography
from circlecal.geometry.homography import compass_label, dlt, scale_homography
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.records.record import StoredResult
from circlecal.results import Calibration

_GRID_M = 2.0
_TANGENT_SAMPLES = 9
_MIN_GRID = 8
CENTRE = "centre"
TANGENT = "tangent"


@dataclass(frozen=True)
class CalibratedFrame:
    """One accepted frame.

    Attributes
    ----------
    id, width, height : str, int, int
        The frame.
    H_image_field : (3, 3) array
        Field to undistorted pixels.
    camera : Camera or None
        With the lens; None where only a homography was estimated.
    crown_m, crown_shape, crown_radius_m : float, str, float
        How the surface falls; 0 for a flat field.
    template : FieldTemplate
        The field, in the convention in which the frame was calibrated.
    circle : Circle
        The circle that was seen.
    image : str or None
        Name of the picture.
    """

    id: str
    width: int
    height: int
    H_image_field: Array
    camera: Camera | None
    crown_m: float
    crown_shape: SurfaceShape
    crown_radius_m: float
    template: FieldTemplate
    circle: Circle
    image: str | None = None

    def project(self, points_m: ArrayLike) -> Array:
        """Pixels (N, 2) of the stored frame for points (N, 2) on the field's surface; nan behind the camera."""
        field = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
        if self.camera is None:
            lifted = np.column_stack([field, np.ones(len(field))]) @ self.H_image_field.T
            lifted = lifted * np.sign(np.linalg.det(self.H_image_field))
            pixels = lifted[:, :2] / np.where(lifted[:, 2:] > 0, lifted[:, 2:], np.nan)
            return np.asarray(pixels)
        model = ProjectionModel(self.width, self.height, Surface(self.crown_shape, self.crown_radius_m))
        depth = self.crown_m * model.surface.drop(field[:, 1])
        return self.camera.project(np.column_stack([field, depth]))

    def shows(self, pixel: Array) -> bool:
        """Whether a pixel (2,) lies in the picture."""
        return bool(np.isfinite(pixel).all() and (pixel >= -0.5).all()) and bool(
            pixel[0] <= self.width - 0.5 and pixel[1] <= self.height - 0.5
        )

    @cached_property
    def visible_field(self) -> tuple[Array, Array]:
        """Points (N, 2) on a grid over the field that are in the picture, and their pixels (N, 2)."""
        half = np.array([self.template.length_m, self.template.width_m]) / 2
        axes = [np.linspace(-h, h, max(3, int(np.ceil(2 * h / _GRID_M)) + 1)) for h in half]
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        rim = self.template.polylines(1.0)[self.circle.name]
        points = np.concatenate([grid, rim])
        pixels = self.project(points)
        seen = np.isfinite(pixels).all(axis=1) & (np.nan_to_num(pixels, nan=-1.0) >= 0).all(axis=1)
        seen &= (np.nan_to_num(pixels[:, 0], nan=np.inf) <= self.width - 1) & (
            np.nan_to_num(pixels[:, 1], nan=np.inf) <= self.height - 1
        )
        return points[seen], pixels[seen]

    @cached_property
    def flat(self) -> Camera | None:
        """The camera over a flat field, for formats that know no crown; None where no camera fits the homography."""
        if self.camera is None:
            return camera_from_homography(self.H_image_field, self.width, self.height)
        if self.crown_m == 0 or self.crown_shape == "flat":
            return self.camera
        return flat_camera(self.camera, *self.visible_field)

    @cached_property
    def centred(self) -> Camera | None:
        """The same with square pixels, the principal point at the image centre and one coefficient of distortion."""
        camera = self.flat
        return None if camera is None else centred_camera(camera, self.template)

    @cached_property
    def picture_homography(self) -> Array:
        """Field to pixels of the frame as stored (3, 3), nearest to lens and crown over the field in view."""
        points, pixels = self.visible_field
        exact = self.camera is None or (not np.any(self.camera.kappa) and self.crown_m == 0)
        found = None if exact or len(points) < _MIN_GRID else dlt(points, pixels)
        return scale_homography(self.H_image_field if found is None else found.H)

    def annotated(self) -> AnnotatedFrame:
        """Derived points and tangents of the circle as shapes: the centre, eight points, eight tangents.

        All on the centreline of the paint. Points outside the picture are left out, tangents end at its border.
        """
        name = self.circle.name
        center, radius = np.asarray(self.circle.center), self.template.radius(self.circle, "center")
        shapes = [Shape(f"{name} {CENTRE}", "points", self.project(center[None]))]
        for angle in np.radians(np.arange(0.0, 360.0, 45.0)):
            outward = np.array([np.cos(angle), np.sin(angle)])
            label = compass_label(outward)
            touch = center + radius * outward
            along = np.linspace(-1.0, 1.0, _TANGENT_SAMPLES)[:, None] * np.array([-outward[1], outward[0]])
            tangent = self.project(touch + 0.5 * radius * along)
            shapes.append(Shape(f"{name} {label}", "points", self.project(touch[None])))
            shapes.append(Shape(f"{name} {TANGENT} {label}", "line", tangent))
        kept = []
        for shape in shapes:
            inside = np.array([self.shows(pixel) for pixel in shape.points_px])
            if inside.sum() >= (2 if shape.kind == "line" else 1):
                kept.append(replace(shape, points_px=shape.points_px[inside]))
        ordered = sorted(kept, key=lambda shape: shape.kind, reverse=True)
        return AnnotatedFrame(self.id, self.width, self.height, tuple(ordered), self.image)


def calibrated_frame(
    result: Calibration | StoredResult, template: FieldTemplate, circle: Circle, image: str | None = None
) -> CalibratedFrame | None:
    """A frame's calibration for the outside formats; None where it was refused."""
    H_image_field = result.H_image_field
    if result.status != "calibrated" or H_image_field is None:
        return None
    if isinstance(result, StoredResult):
        camera, crown = result.camera, (result.crown_m, result.crown_shape, result.crown_radius_m)
    elif result.camera is None:
        camera, crown = None, (0.0, "flat", circle.radius_m)
    else:
        fit = result.camera
        camera, crown = fit.camera, (fit.crown_m, fit.crown_shape, circle.radius_m)
    return CalibratedFrame(
        result.id, result.width, result.height, H_image_field, camera, *crown, template, circle, image
    )


def centred_camera(camera: Camera, template: FieldTemplate) -> Camera:
    """The nearest camera with square pixels, principal point at the image centre and one coefficient of distortion."""
    half = np.array([camera.width, camera.height]) / 2.0
    at_center = np.allclose(camera.principal_point_px, half, atol=0.51)
    if at_center and camera.focal_px[0] == camera.focal_px[1] and camera.kappa[1] == 0:
        return camera
    model = CalibratedFrame(
        "", camera.width, camera.height, camera.homography, camera, 0.0, "flat", 1.0, template, template.circles[0]
    )
    points, pixels = model.visible_field
    return flat_camera(camera, points, pixels, centred=True)
