"""LabelMe: one JSON file per frame, in and out.

``shapes`` (``label``, ``shape_type``, ``points``), ``imageWidth``, ``imageHeight``, ``imagePath``. LabelMe counts from
the corner of the picture: pixel = theirs - 0.5. Points, lines, line strips and polygons are read; its circle is no
ellipse and, like rectangles and masks, left out. A refused frame has what was measured in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from circlecal.formats.cameras import Size, derive_shapes
from circlecal.formats.format import (
    MAX_POINTS,
    AnnotationFormat,
    Bounded,
    FileModel,
    Side,
    json_bytes,
    parse_content,
    require_size,
    says_paint,
    tell_convention,
)
from circlecal.formats.shapes import AnnotatedFrame, Shape, ShapeKind

_CORNER = 0.5
_VERSION = "5.5.0"
_KINDS: dict[str, ShapeKind] = {
    "point": "points",
    "points": "points",
    "line": "line",
    "linestrip": "line",
    "polygon": "line",
}


class _Shape(FileModel):
    label: str
    shape_type: str = "polygon"
    points: Annotated[list[Annotated[list[Bounded], Field(min_length=2, max_length=2)]], Field(max_length=MAX_POINTS)]


class _File(FileModel):
    shapes: list[_Shape]
    imagePath: str | None = None  # noqa: N815 - the file's own name
    imageWidth: Side | None = None  # noqa: N815
    imageHeight: Side | None = None  # noqa: N815
    circlecal: Any = None


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frame of a file.

    Raises
    ------
    InputError
        No file of LabelMe, or the size of the picture is not known.
    """
    found = parse_content(_File, path, content)
    width, height = require_size(path, (found.imageWidth, found.imageHeight), size)
    shapes, warnings = [], []
    for number, shape in enumerate(found.shapes):
        kind = _KINDS.get(shape.shape_type)
        if kind is None:
            warnings.append(f"{path}: shapes.{number}.shape_type: {shape.shape_type!r} is no point or line; left out")
        elif shape.points:
            shapes.append(Shape(shape.label.strip(), kind, np.array(shape.points, dtype=np.float64) - _CORNER))
    identifier = path.name.removesuffix(path.suffix).removesuffix(".labelme")
    on_paint = says_paint(found.circlecal)
    return [
        AnnotatedFrame(identifier, width, height, tuple(shapes), found.imagePath, tuple(warnings), on_paint=on_paint)
    ]


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a file; several points of one label are one shape each, an ellipse is a polygon."""
    (frame,) = frames
    shapes: list[dict[str, Any]] = []
    for shape in frame.shapes:
        points = (shape.sample() + _CORNER).tolist()
        if shape.kind == "points":
            shapes += [_record(shape.label, "point", [point]) for point in points]
        elif shape.kind == "ellipse":
            shapes.append(_record(shape.label, "polygon", points))
        else:
            shapes.append(_record(shape.label, "line" if len(points) == 2 else "linestrip", points))
    return json_bytes({
        "version": _VERSION, "flags": {}, "shapes": shapes, "imagePath": frame.image or f"{frame.id}.jpg",
        "imageData": None, "imageHeight": frame.height, "imageWidth": frame.width,
        **tell_convention(frame),
    })  # fmt: skip


def _record(label: str, kind: str, points: list[list[float]]) -> dict[str, Any]:
    return {"label": label, "points": points, "group_id": None, "shape_type": kind, "flags": {}}


FORMAT = AnnotationFormat(
    name="labelme",
    recognises=lambda content: "shapes" in content.mapping,
    read=read,
    write=write,
    derive=derive_shapes,
    draws_measured=True,
    file_name="{id}.json",
)
