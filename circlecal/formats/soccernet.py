"""SoccerNet: line annotations and extremities (in and out), and camera files (in and out).

Line annotation
    ``{"Circle central": [{"x": 0.677, "y": 0.613}, ...], ...}``, normalised. Pixel = ``x (W - 1)``, ``y (H - 1)``: the
    official evaluation's mapping, in which 0 and 1 are the centres of the outermost pixels. Points a little outside
    [0, 1] occur and are taken as they are. Extremities have the same form, but are read off a picture of class ids, so
    pixel = ``x W``, ``y H``.
Camera
    ``camera_<id>.json`` has no size. The principal point is taken as the image centre, ``W / 2`` or ``(W - 1) / 2``,
    whichever makes the size even; what circlecal writes has ``image_width`` and ``image_height`` beside its keys,
    for its principal points need not be at the centre. Between two sizes pixels go as the annotation's do, by
    ``(W' - 1) / (W - 1)``; coefficients of distortion belong to the focal plane and stay.

The class list of the public baseline spells ``"Goal left post left "`` with a trailing blank, later ones without:
both are read, and a writer is told which to use.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, RootModel

from circlecal.errors import InputError
from circlecal.formats.checked import MAX_POINTS, Bounded, Checked, Focal, Side, Size, checked, require_size
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.camera import Camera, camera_from_soccernet
from circlecal.geometry.projective import Array

CIRCLE_CLASSES = ("Circle central", "Circle left", "Circle right")
SEGMENTATION_CLASSES = (
    "Big rect. left bottom",
    "Big rect. left main",
    "Big rect. left top",
    "Big rect. right bottom",
    "Big rect. right main",
    "Big rect. right top",
    "Circle central",
    "Circle left",
    "Circle right",
    "Goal left crossbar",
    "Goal left post left ",
    "Goal left post right",
    "Goal right crossbar",
    "Goal right post left",
    "Goal right post right",
    "Goal unknown",
    "Line unknown",
    "Middle line",
    "Side line bottom",
    "Side line left",
    "Side line right",
    "Side line top",
    "Small rect. left bottom",
    "Small rect. left main",
    "Small rect. left top",
    "Small rect. right bottom",
    "Small rect. right main",
    "Small rect. right top",
)
"""The classes of segmentation masks in the order of their ids, from 1; the name of one ends in a blank."""
LINE_CLASSES = tuple(
    name.strip() for name in SEGMENTATION_CLASSES if not name.startswith("Circle") and not name.endswith("unknown")
)
"""Straight classes in SoccerNet's order, without blanks at the end; six of them are goals and stand above the field."""
GOAL_CLASSES = tuple(name for name in LINE_CLASSES if name.startswith("Goal"))
UNKNOWN_CLASSES = ("Goal unknown", "Line unknown")
BLANK_CLASS = "Goal left post left"
FLAT_PITCH = (105.0, 68.0)


class _Point(Checked):
    x: Bounded
    y: Bounded


class _Annotation(RootModel[dict[str, Annotated[list[_Point], Field(max_length=MAX_POINTS)]]]):
    pass


def read_annotation(path: Path, content: bytes, size: Size | None, *, extremities: bool = False) -> AnnotatedFrame:
    """The frame of a line annotation or of an extremities file; empty classes are left out.

    Raises
    ------
    InputError
        No such file of SoccerNet, or the size of the picture is not known.
    """
    classes = checked(_Annotation, path, content).root
    width, height = require_size(path, size)
    scale = _annotation_scale(width, height, extremities)
    shapes = []
    for name, points in classes.items():
        if points:
            pixels = np.array([(point.x, point.y) for point in points], dtype=np.float64) * scale
            shapes.append(Shape(name.strip(), "line", pixels))
    identifier = path.stem.removeprefix("extremities_") if extremities else path.stem
    return AnnotatedFrame(identifier, width, height, tuple(shapes))


def annotation_record(
    frame: AnnotatedFrame, *, extremities: bool = False, trailing_blank: bool = True
) -> dict[str, list[dict[str, float]]]:
    """Content of a line annotation; shapes that share a label are put together.

    Parameters
    ----------
    frame : AnnotatedFrame
        What is marked.
    extremities : bool
        With the mapping of extremities.
    trailing_blank : bool
        Spell ``"Goal left post left "`` as the public baseline does.
    """
    scale = _annotation_scale(frame.width, frame.height, extremities)
    record: dict[str, list[dict[str, float]]] = {}
    for shape in frame.shapes:
        label = f"{shape.label} " if trailing_blank and shape.label == BLANK_CLASS else shape.label
        points = (shape.sampled() / scale).tolist()
        record.setdefault(label, []).extend({"x": x, "y": y} for x, y in points)
    return record


def _annotation_scale(width: int, height: int, extremities: bool) -> Array:
    return np.array([width, height], dtype=np.float64) - (0.0 if extremities else 1.0)


class CameraKeys(Checked):
    """SoccerNet's camera; all keys of distortion are mandatory in its reader, and written always."""

    pan_degrees: Bounded
    tilt_degrees: Bounded
    roll_degrees: Bounded
    position_meters: Annotated[list[Bounded], Field(min_length=3, max_length=3)]
    x_focal_length: Focal
    y_focal_length: Focal
    principal_point: Annotated[list[Bounded], Field(min_length=2, max_length=2)]
    radial_distortion: Annotated[list[Bounded], Field(max_length=6)] = [0.0] * 6
    tangential_distortion: Annotated[list[Bounded], Field(max_length=2)] = [0.0] * 2
    thin_prism_distortion: Annotated[list[Bounded], Field(max_length=4)] = [0.0] * 4
    image_width: Side | None = None
    image_height: Side | None = None

    def camera(self, path: Path, size: Size | None) -> Camera:
        """The camera at its own size.

        Raises
        ------
        InputError
            No size is known, or a distortion that circlecal's cameras do not have.
        """
        further = (*self.radial_distortion[2:], *self.tangential_distortion, *self.thin_prism_distortion)
        if any(further):
            raise InputError(f"{path}: only the first two of radial_distortion can be read; the others must be 0")
        width, height = require_size(path, size, self._size())
        radial = (*self.radial_distortion, 0.0, 0.0)[:2]
        return camera_from_soccernet({**self.model_dump(), "radial_distortion": radial}, width, height)

    def _size(self) -> Size | None:
        """The size in the file, else twice the principal point or one more, whichever is even."""
        if self.image_width is not None and self.image_height is not None:
            return self.image_width, self.image_height
        sides = []
        for center in self.principal_point:
            side = next((s for s in (2.0 * center, 2.0 * center + 1.0) if s % 2 == 0), None)
            if side is None or not 2 <= side <= 65535:
                return None
            sides.append(int(side))
        return sides[0], sides[1]


def read_camera(path: Path, content: bytes, size: Size | None) -> tuple[str, Camera]:
    """Frame id and camera of a ``camera_<id>.json``.

    Raises
    ------
    InputError
        No camera, or its size is not known.
    """
    return path.stem.removeprefix("camera_"), checked(CameraKeys, path, content).camera(path, size)


def camera_record(camera: Camera, size: Size | None = None) -> dict[str, Any]:
    """Content of a camera file, at the camera's own size or at another."""
    width, height = size or (camera.width, camera.height)
    record = {**camera.soccernet(), "image_width": width, "image_height": height}
    if size is None or size == (camera.width, camera.height):
        return record
    factor = (size[0] - 1) / (camera.width - 1), (size[1] - 1) / (camera.height - 1)
    return {
        **record,
        "x_focal_length": record["x_focal_length"] * factor[0],
        "y_focal_length": record["y_focal_length"] * factor[1],
        "principal_point": [p * f for p, f in zip(record["principal_point"], factor, strict=True)],
    }


def camera_at_size(camera: Camera, size: Size | None) -> Camera:
    """The same camera for pictures of another size."""
    return camera if size is None else camera_from_soccernet(camera_record(camera, size), *size)


def json_bytes(record: Mapping[str, Any] | list[Any]) -> bytes:
    """JSON text of a file; numbers keep all their digits."""
    return (json.dumps(record, allow_nan=False, ensure_ascii=False) + "\n").encode()
