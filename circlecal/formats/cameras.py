"""Cameras as outside formats have them, and calibrated frames as those need them.

Other programs' fields are flat and their pictures often free of distortion, ours need not be: what they cannot say is
put into what they can, so that the field in view projects to where it is seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from circlecal.camera.flat import flat_camera
from circlecal.errors import InputError
from circlecal.field import Circle, FieldTemplate
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.camera import Camera, camera_from_homography, camera_from_soccernet
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
Size = tuple[int, int]
CameraModel = Literal["camera", "centred camera", "homography"]
"""What a format can say: any camera; one with square pixels, the principal point at the image centre and one
coefficient of distortion; or only where the flat field is seen."""


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """A frame's camera in an outside file, or its homography alone.

    Attributes
    ----------
    id : str
        Name of the frame.
    width, height : int
        Size of the pictures in which pixels count.
    camera : Camera or None
        None where the file holds a homography only.
    H_image_field : (3, 3) array or None
        Field (metres) to pixels of the frame as stored, where the file holds one.
    image : str or None
        Name of the picture, where the file has one.
    """

    id: str
    width: int
    height: int
    camera: Camera | None = None
    H_image_field: Array | None = None
    image: str | None = None

    def require_camera(self) -> Camera:
        """The camera, if need be the one that fits the homography.

        Raises
        ------
        InputError
            No camera fits it.
        """
        camera = self.camera
        if camera is None and self.H_image_field is not None:
            camera = camera_from_homography(self.H_image_field, self.width, self.height)
        if camera is None:
            raise InputError(f"{self.id}: no camera with square pixels fits its homography")
        return camera

    def reduce(self, holds: CameraModel, template: FieldTemplate) -> CameraFrame:
        """The frame as a format that holds no more can say it.

        Raises
        ------
        InputError
            No camera fits the homography.
        """
        if holds == "homography":
            return self
        camera = self.require_camera()
        return replace(self, camera=center_camera(camera, template) if holds == "centred camera" else camera)

    def resize(self, size: Size | None) -> CameraFrame:
        """The frame with its camera for pictures of another size; as it is where that is None.

        Raises
        ------
        InputError
            No camera fits the homography.
        """
        if size is None:
            return replace(self, camera=self.require_camera())
        return CameraFrame(self.id, *size, resize_camera(self.require_camera(), size), None, self.image)


def resize_camera(camera: Camera, size: Size) -> Camera:
    """The camera for pictures of another size, between which pixels go by ``(W' - 1) / (W - 1)``."""
    if size == (camera.width, camera.height):
        return camera
    factor = (size[0] - 1) / (camera.width - 1), (size[1] - 1) / (camera.height - 1)
    keys = camera.soccernet()
    keys["x_focal_length"] *= factor[0]
    keys["y_focal_length"] *= factor[1]
    keys["principal_point"] = [p * f for p, f in zip(keys["principal_point"], factor, strict=True)]
    return camera_from_soccernet(keys, *size)


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

    @classmethod
    def of(
        cls, result: Calibration | StoredResult, template: FieldTemplate, circle: Circle, image: str | None = None
    ) -> CalibratedFrame | None:
        """A frame's calibration for the outside formats; None where it was refused."""
        H_image_field = result.H_image_field
        if result.status != "calibrated" or H_image_field is None:
            return None
        camera: Camera | None = None
        crown: tuple[float, SurfaceShape, float] = (0.0, "flat", circle.radius_m)
        if isinstance(result, StoredResult):
            camera, crown = result.camera, (result.crown_m, result.crown_shape, result.crown_radius_m)
        elif result.camera is not None:
            camera, crown = result.camera.camera, (result.camera.crown_m, result.camera.crown_shape, circle.radius_m)
        return cls(result.id, result.width, result.height, H_image_field, camera, *crown, template, circle, image)

    def project(self, points_m: ArrayLike) -> Array:
        """Pixels (N, 2) of the stored frame for points (N, 2) on the field's surface; nan behind the camera."""
        field = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
        if self.camera is None:
            lifted = np.column_stack([field, np.ones(len(field))]) @ self.H_image_field.T
            lifted = lifted * np.sign(np.linalg.det(self.H_image_field))
            pixels = lifted[:, :2] / np.where(lifted[:, 2:] > 0, lifted[:, 2:], np.nan)
            return np.asarray(pixels)
        depth = self.crown_m * Surface(self.crown_shape, self.crown_radius_m).drop(field[:, 1])
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
    def picture_homography(self) -> Array:
        """Field to pixels of the frame as stored (3, 3), nearest to lens and crown over the field in view."""
        points, pixels = self.visible_field
        exact = self.camera is None or (not np.any(self.camera.kappa) and self.crown_m == 0)
        found = None if exact or len(points) < _MIN_GRID else dlt(points, pixels)
        return scale_homography(self.H_image_field if found is None else found.H)

    def reduce(self, holds: CameraModel) -> CameraFrame:
        """The frame as a format can say it."""
        H = self.picture_homography
        camera = None if holds == "homography" else self.flat
        if camera is not None and holds == "centred camera":
            camera = center_camera(camera, self.template)
        return CameraFrame(self.id, self.width, self.height, camera, H, self.image)


def center_camera(camera: Camera, template: FieldTemplate) -> Camera:
    """The nearest camera with square pixels, principal point at the image centre and one coefficient of distortion."""
    half = np.array([camera.width, camera.height]) / 2.0
    at_center = np.allclose(camera.principal_point_px, half, atol=0.51)
    if at_center and camera.focal_px[0] == camera.focal_px[1] and camera.kappa[1] == 0:
        return camera
    frame = CalibratedFrame(
        "", camera.width, camera.height, camera.homography, camera, 0.0, "flat", 1.0, template, template.circles[0]
    )
    points, pixels = frame.visible_field
    return flat_camera(camera, points, pixels, centred=True)


def derive_shapes(frame: CalibratedFrame, original: Mapping[str, Any] | None = None) -> AnnotatedFrame:
    """Derived points and tangents of the circle as shapes: the centre, eight points, eight tangents.

    All on the centreline of the paint. Points outside the picture are left out, tangents end at its border.
    """
    name = frame.circle.name
    center, radius = np.asarray(frame.circle.center), frame.template.radius(frame.circle, "center")
    shapes = [Shape(f"{name} {CENTRE}", "points", frame.project(center[None]))]
    for angle in np.radians(np.arange(0.0, 360.0, 45.0)):
        outward = np.array([np.cos(angle), np.sin(angle)])
        label = compass_label(outward)
        touch = center + radius * outward
        along = np.linspace(-1.0, 1.0, _TANGENT_SAMPLES)[:, None] * np.array([-outward[1], outward[0]])
        tangent = frame.project(touch + 0.5 * radius * along)
        shapes.append(Shape(f"{name} {label}", "points", frame.project(touch[None])))
        shapes.append(Shape(f"{name} {TANGENT} {label}", "line", tangent))
    kept = []
    for shape in shapes:
        inside = np.array([frame.shows(pixel) for pixel in shape.points_px])
        if inside.sum() >= (2 if shape.kind == "line" else 1):
            kept.append(replace(shape, points_px=shape.points_px[inside]))
    ordered = sorted(kept, key=lambda shape: shape.kind, reverse=True)
    return AnnotatedFrame(frame.id, frame.width, frame.height, tuple(ordered), frame.image)
