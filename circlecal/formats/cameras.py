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

from circlecal.camera.flat import flat_camera
from circlecal.errors import InputError
from circlecal.field import COMPASS, Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.camera import Camera, camera_from_homography, camera_from_soccernet, image_center
from circlecal.geometry.homography import dlt, is_invertible, scale_homography
from circlecal.geometry.projective import Array, apply_homography
from circlecal.records.record import ResultRecord
from circlecal.results import FrameCalibration

_GRID_M = 2.0
CENTRED_PX = 0.01
"""How far a principal point that counts as the centre of the picture may lie from it, pixels."""
SQUARE = 0.01
"""Share by which pixels may be broader than high and still count as square: estimated ones are that to some
thousandths, the narrowest of video (704 x 576 shown at 4:3) are 9 % off.
"""
THINNEST_PAINT_M = 1e-6
"""Markings that are thinner have no paint, metres: both of their edges lie at the sizes of the rules."""
_TANGENT_SAMPLES = 9
_MIN_GRID = 8
CENTRE = "centre"
TANGENT = "tangent"
Size = tuple[int, int]
CameraModel = Literal["camera", "centred camera", "homography"]
"""What a format can say: any camera; one with square pixels, the principal point at the image centre and one
coefficient of distortion; or only where the flat field is seen."""


def as_size(given: Any) -> Size:
    """Width and height of pictures as a caller gave them.

    Raises
    ------
    InputError
        They are no two whole numbers above 0.
    """
    try:
        width, height = (int(side) for side in given)
        is_whole = (width, height) == tuple(given) and min(width, height) >= 1
    except (TypeError, ValueError, OverflowError):
        is_whole = False
    if not is_whole:
        raise InputError(f"size must be the width and height of the picture in pixels, not {given!r}")
    return width, height


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
    is_stretched : bool
        Whether the pixels of the pictures are not square, and those of the format are: the camera is another one.
    loss_px : float
        By how much the field in view lies beside where the picture shows it, at most, where a homography stands for a
        camera with a lens; pixels.
    """

    id: str
    width: int
    height: int
    camera: Camera | None = None
    H_image_field: Array | None = None
    image: str | None = None
    is_stretched: bool = False
    loss_px: float = 0.0

    @property
    def is_accepted(self) -> bool:
        """Whether there is a camera, or a homography; there is none of a refused frame."""
        return self.camera is not None or self.H_image_field is not None

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
            No camera fits the homography, or the camera lies in the plane of the field.
        """
        H, seen = self.H_image_field, None
        if self.camera is not None and (H is None or holds == "homography"):
            view = FieldView(self.camera)
            seen = _visible_field(view, template)
            H = nearest_homography(view, *seen) if H is None else H
        if H is not None and not is_invertible(H):
            raise InputError(
                "its camera lies in the plane of the field, or beyond all bounds, and its homography cannot be "
                "inverted; correct its position (position_meters, z below 0) or leave the file out"
            )
        if holds == "homography":
            loss_px = 0.0 if H is None or seen is None else _largest_loss(H, *seen)
            return replace(self, H_image_field=H, loss_px=loss_px)
        camera = self.require_camera()
        if holds == "camera":
            return replace(self, camera=camera, H_image_field=H)
        is_stretched = abs(camera.focal_px[0] / camera.focal_px[1] - 1.0) > SQUARE
        return replace(self, camera=center_camera(camera, template), H_image_field=H, is_stretched=bool(is_stretched))

    def with_square_pixels(self) -> CameraFrame:
        """The frame for the picture as it is shown, where its pixels are broader or narrower than high; as it is where
        they are square, or where no camera tells.
        """
        if self.camera is None:
            return self
        focal_x, focal_y = self.camera.focal_px.tolist()
        if abs(focal_y / focal_x - 1.0) < SQUARE:
            return self
        return self.resize((max(2, round(self.width * focal_y / focal_x)), self.height))

    def resize(self, size: Size | None) -> CameraFrame:
        """The frame for pictures of another size; as it is where that is None.

        Raises
        ------
        InputError
            No camera fits the homography.
        """
        if size is None or size == (self.width, self.height):
            return self
        camera, H = self.require_camera(), self.H_image_field
        if H is not None:
            H = scale_homography(np.diag([*_factors((self.width, self.height), size), 1.0]) @ H)
        return CameraFrame(self.id, *size, resize_camera(camera, size), H, self.image)


def _factors(before: Size, after: Size) -> tuple[float, float]:
    """By what columns and rows of pictures of one size are multiplied in those of another."""
    return (after[0] - 1) / (before[0] - 1), (after[1] - 1) / (before[1] - 1)


def resize_camera(camera: Camera, size: Size) -> Camera:
    """The camera for pictures of another size, between which pixels go by ``(W' - 1) / (W - 1)``."""
    if size == (camera.width, camera.height):
        return camera
    factor = _factors((camera.width, camera.height), size)
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
    view : FieldView
        Where the field is seen.
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
    view: FieldView
    template: FieldTemplate
    circle: Circle
    image: str | None = None

    @classmethod
    def of(
        cls, result: FrameCalibration | ResultRecord, template: FieldTemplate, circle: Circle, image: str | None = None
    ) -> CalibratedFrame | None:
        """A frame's calibration for the outside formats; None where it was refused."""
        if result.status != "calibrated" or result.view is None:
            return None
        return cls(result.id, result.width, result.height, result.view, template, circle, image)

    @property
    def camera(self) -> Camera | None:
        """With the lens; None where only a homography was estimated."""
        return self.view.camera if isinstance(self.view.camera, Camera) else None

    @property
    def is_painted(self) -> bool:
        """Whether its markings have a width, so that what is projected lies on the middle of the paint."""
        return self.template.marking_width_m > THINNEST_PAINT_M

    @property
    def H_image_field(self) -> Array:
        """Field to undistorted pixels (3, 3)."""
        return self.view.camera.homography

    @cached_property
    def visible_field(self) -> tuple[Array, Array]:
        """Points (N, 2) on a grid over the field that are in the picture, and their pixels (N, 2)."""
        return _visible_field(self.view, self.template, self.circle)

    @cached_property
    def flat(self) -> Camera | None:
        """The camera over a flat field, for formats that know no crown; None where no camera fits the homography."""
        if self.camera is None:
            near = camera_from_homography(self.H_image_field, self.width, self.height)
            return None if near is None else flat_camera(near, *self.visible_field)
        if self.view.surface.is_flat:
            return self.camera
        return flat_camera(self.camera, *self.visible_field)

    @cached_property
    def picture_homography(self) -> Array:
        """Field to pixels of the frame as stored (3, 3), nearest to lens and crown over the field in view."""
        return nearest_homography(self.view, *self.visible_field)

    def reduce(self, holds: CameraModel, size: Size | None = None) -> CameraFrame:
        """The frame as a format can say it, for pictures of another size where one is given: homographies alone, whose
        formats have a size of their own, count in the frame's own, and cameras of square pixels in the picture as it
        is shown where no size is given.

        Raises
        ------
        InputError
            No camera fits the homography.
        """
        H = self.picture_homography
        if holds == "homography":
            loss_px = _largest_loss(H, *self.visible_field)
            return CameraFrame(self.id, self.width, self.height, None, H, self.image, loss_px=loss_px)
        whole = CameraFrame(self.id, self.width, self.height, self.flat, H, self.image).resize(size)
        whole = whole.with_square_pixels() if holds == "centred camera" and size is None else whole
        return whole if whole.camera is None else whole.reduce(holds, self.template)


def nearest_homography(view: FieldView, points_m: Array, points_px: Array) -> Array:
    """Homography (3, 3) from the field to pixels as stored that is nearest to lens and crown.

    Parameters
    ----------
    view : FieldView
        Of which the homography is exact where it has neither lens nor crown.
    points_m, points_px : (N, 2) arrays
        Field points in view, and where they are seen.
    """
    camera = view.camera
    exact = not isinstance(camera, Camera) or (not np.any(camera.kappa) and view.surface.is_flat)
    found = None if exact or len(points_m) < _MIN_GRID else dlt(points_m, points_px)
    return scale_homography(camera.homography if found is None else found.H)


def _largest_loss(H: Array, points_m: Array, points_px: Array) -> float:
    """How far a homography (3, 3) shows points (N, 2) of the field beside their pixels (N, 2), at most."""
    return float(np.linalg.norm(apply_homography(H, points_m) - points_px, axis=1).max(initial=0.0))


def center_camera(camera: Camera, template: FieldTemplate) -> Camera:
    """The nearest camera with square pixels, principal point at the image centre and one coefficient of distortion."""
    center = image_center(camera.width, camera.height)
    at_center = np.allclose(camera.principal_point_px, center, rtol=0.0, atol=CENTRED_PX)
    if at_center and camera.focal_px[0] == camera.focal_px[1] and camera.kappa[1] == 0:
        return camera
    points, pixels = _visible_field(FieldView(camera), template)
    return flat_camera(camera, points, pixels, centred=True)


def _visible_field(view: FieldView, template: FieldTemplate, circle: Circle | None = None) -> tuple[Array, Array]:
    """Points (N, 2) of the field and of a circle that are in the picture, and their pixels (N, 2); of the first circle
    or arc of the field where none is named.
    """
    curves = (circle,) if circle is not None else template.round_ones[:1]
    half = np.array([template.length_m, template.width_m]) / 2
    axes = [np.linspace(-h, h, max(3, int(np.ceil(2 * h / _GRID_M)) + 1)) for h in half]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    points = np.concatenate([grid, *(template.polylines(1.0)[curve.name] for curve in curves)])
    pixels = view.project(points)
    seen = view.shows(pixels)
    return points[seen], pixels[seen]


def derive_shapes(frame: CalibratedFrame, original: Mapping[str, Any] | None = None) -> AnnotatedFrame:
    """Derived points and tangents of the circle as shapes: the centre, eight points, eight tangents.

    All on the centreline of the paint. Points outside the picture are left out, tangents end at its border.
    """
    name = frame.circle.name
    center, radius = frame.view.center_of(frame.circle, frame.template), frame.template.radius(frame.circle, "center")
    shapes = [Shape(f"{name} {CENTRE}", "points", frame.view.project(center[None]))]
    for label, outward in COMPASS.items():
        touch = center + radius * outward
        along = np.linspace(-1.0, 1.0, _TANGENT_SAMPLES)[:, None] * np.array([-outward[1], outward[0]])
        tangent = frame.view.project(touch + 0.5 * radius * along)
        shapes.append(Shape(f"{name} {label}", "points", frame.view.project(touch[None])))
        shapes.append(Shape(f"{name} {TANGENT} {label}", "line", tangent))
    kept = []
    for shape in shapes:
        inside = frame.view.shows(shape.points_px, margin_px=0.5)
        if inside.sum() >= (2 if shape.kind == "line" else 1):
            kept.append(replace(shape, points_px=shape.points_px[inside]))
    ordered = sorted(kept, key=lambda shape: shape.kind, reverse=True)
    return AnnotatedFrame(frame.id, frame.width, frame.height, tuple(ordered), frame.image, on_paint=frame.is_painted)
