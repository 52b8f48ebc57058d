"""Label Studio: a JSON list of tasks, in and out.

``annotations[].result[]`` with ``value`` in per cent of ``original_width`` and ``original_height``, counted from the
corner of the picture: pixel = ``x / 100 W - 0.5``. Read are key points, polygons, vectors and ellipses (``x``, ``y`` is
the centre, turned by ``rotation`` degrees clockwise in the picture, not in per cent), labelled by their own tag or by
``<Labels>``; one with several labels lies on each of them, as a point where two lines meet. Of several annotations of a
task the first counts that was not cancelled and is not empty; predictions are not read. A refused frame has what was
measured in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, RootModel

from circlecal.formats.cameras import Size, derive_shapes
from circlecal.formats.format import (
    MAX_POINTS,
    OWN_KEY,
    AnnotationFormat,
    Bounded,
    Content,
    FileModel,
    Side,
    ids_of_pictures,
    json_bytes,
    parse_content,
    parse_value,
    require_size,
    says_paint,
    tell_convention,
)
from circlecal.formats.shapes import AnnotatedFrame, Shape, ShapeKind
from circlecal.geometry.projective import Array

_CORNER = 0.5
_LABELS = "labels"
_NO_REGIONS = ("choices", "taxonomy")
_KIND_BY_KEY = {"points": "polygon", "vertices": "vector", "radiusX": "ellipse"}
"""Which regions a value of ``<Labels>`` is of; a point has neither these nor a height."""
_Pair = Annotated[list[Bounded], Field(min_length=2, max_length=2)]


class _Result(FileModel):
    type: str = ""
    original_width: Side | None = None
    original_height: Side | None = None
    value: dict[str, Any] = Field({})


class _Annotation(FileModel):
    result: list[_Result]
    was_cancelled: bool = False


class _Task(FileModel):
    data: dict[str, Any] = Field({})
    meta: Any = None
    annotations: list[_Annotation] = Field([])


class _Tasks(RootModel[list[_Task]]):
    pass


class _Point(FileModel):
    x: Bounded
    y: Bounded


class _Ellipse(_Point):
    radiusX: Annotated[Bounded, Field(gt=0)]  # noqa: N815 - the file's own name
    radiusY: Annotated[Bounded, Field(gt=0)]  # noqa: N815
    rotation: float = 0.0


class _Polygon(FileModel):
    points: Annotated[list[_Pair], Field(min_length=1, max_length=MAX_POINTS)]


class _Vector(FileModel):
    vertices: Annotated[list[_Point], Field(min_length=1, max_length=MAX_POINTS)]


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frames of a file, those without annotations too where their size is given; else the first one warns of
    them.

    Raises
    ------
    InputError
        No export of Label Studio, or the size of a picture is not known.
    """
    tasks = parse_content(_Tasks, path, content).root
    names = ids_of_pictures(_image_name(task) or "" for task in tasks)
    frames: list[AnnotatedFrame] = []
    left_out = []
    for number, (task, name) in enumerate(zip(tasks, names, strict=True)):
        filled = [a.result for a in task.annotations if a.result and not a.was_cancelled]
        results = filled[0] if filled else []
        where = f"{number}.annotations.result"
        found = next(((r.original_width, r.original_height) for r in results if r.original_width), None)
        if found is None and size is None and not results:
            left_out.append(f"{path}: {number}: {_image_name(task) or 'the task'} has no annotation; left out")
            continue
        width, height = require_size(path, found, size)
        shapes, warnings = [], []
        for position, result in enumerate(results):
            labelled = _shapes(path, result, f"{where}.{position}", (width, height))
            if isinstance(labelled, str):
                warnings.append(labelled)
            else:
                shapes += labelled
        if len(filled) > 1:
            warnings.append(f"{path}: {number}.annotations: has several; only the first is read")
        on_paint = isinstance(task.meta, dict) and says_paint(task.meta.get(OWN_KEY))
        frames.append(
            AnnotatedFrame(name, width, height, tuple(shapes), _image_name(task), tuple(warnings), on_paint=on_paint)
        )
    if frames:
        frames[0] = replace(frames[0], warnings=(*frames[0].warnings, *left_out))
    return frames


def _image_name(task: _Task) -> str | None:
    values = [value for value in task.data.values() if isinstance(value, str)]
    return next((v for v in (task.data.get("image"), *values) if isinstance(v, str)), None)


def _shapes(path: Path, result: _Result, where: str, size: Size) -> list[Shape] | str:
    """The shape of a result under each of its labels, or a warning; nothing for what is no region (choices, ratings),
    and for a region whose labels are a result of their own.
    """
    value = result.value
    labels = value.get(result.type, value.get(_LABELS))
    if not isinstance(labels, list) or not labels or not all(isinstance(label, str) for label in labels):
        return f"{path}: {where}.value: has no label; left out" if result.type.endswith(_LABELS) else []
    if result.type in _NO_REGIONS:
        return []
    kind = _kind_of(value) if result.type == _LABELS else result.type.removesuffix(_LABELS)
    prefix = f"{where}.value"
    scale = np.array(size, dtype=np.float64) / 100.0
    shape_kind: ShapeKind = "line"
    if kind == "keypoint":
        point = parse_value(_Point, path, value, prefix)
        shape_kind, points = "points", np.array([[point.x, point.y]]) * scale
    elif kind == "ellipse":
        shape_kind, points = "ellipse", _ellipse(parse_value(_Ellipse, path, value, prefix), scale)
    elif kind == "polygon":
        points = np.array(parse_value(_Polygon, path, value, prefix).points) * scale
    elif kind == "vector":
        points = np.array([(v.x, v.y) for v in parse_value(_Vector, path, value, prefix).vertices]) * scale
    else:
        return f"{path}: {where}.type: {result.type!r} is no point, polygon, vector or ellipse; left out"
    return [Shape(label.strip(), shape_kind, points - _CORNER) for label in labels]


def _kind_of(value: dict[str, Any]) -> str:
    """Kind of a region by what its value has; empty for what is none that is read."""
    found = next((kind for key, kind in _KIND_BY_KEY.items() if key in value), "")
    return found or ("keypoint" if "x" in value and "height" not in value else "")


def _ellipse(value: _Ellipse, scale: Array) -> Array:
    center = np.array([value.x, value.y]) * scale
    turn = math.radians(value.rotation)
    first = value.radiusX * scale[0] * np.array([math.cos(turn), math.sin(turn)])
    second = value.radiusY * scale[1] * np.array([-math.sin(turn), math.cos(turn)])
    return np.stack([center, center + first, center + second])


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a file: points as key points, lines as polygons (the classic tags have no open line)."""
    tasks = []
    for number, frame in enumerate(frames, start=1):
        results = [result for shape in frame.shapes for result in _results(shape, frame)]
        annotations = [{"result": results}] if results else []
        data = {"image": frame.image or f"{frame.id}.jpg"}
        task = {"id": number, "data": data, "annotations": annotations}
        tasks.append(task | ({"meta": tell_convention(frame)} if frame.on_paint else {}))
    return json_bytes(tasks)


def _results(shape: Shape, frame: AnnotatedFrame) -> list[dict[str, Any]]:
    scale = np.array([frame.width, frame.height], dtype=np.float64) / 100.0
    percent = (shape.points_px + _CORNER) / scale
    values: list[tuple[str, dict[str, Any]]]
    if shape.kind == "points":
        values = [("keypointlabels", {"x": x, "y": y, "width": 0.4}) for x, y in percent.tolist()]
    elif shape.kind == "ellipse":
        first, second = shape.points_px[1:] - shape.points_px[0]
        center = percent[0].tolist()
        ellipse = {
            "x": center[0], "y": center[1],
            "radiusX": float(np.hypot(*first) / scale[0]), "radiusY": float(np.hypot(*second) / scale[1]),
            "rotation": math.degrees(math.atan2(first[1], first[0])) % 360.0,
        }  # fmt: skip
        values = [("ellipselabels", ellipse)]
    else:
        values = [("polygonlabels", {"points": percent.tolist(), "closed": False})]
    return [
        {
            "original_width": frame.width, "original_height": frame.height, "image_rotation": 0,
            "from_name": kind.removesuffix("labels"), "to_name": "image", "type": kind,
            "value": {**value, kind: [shape.label]},
        }
        for kind, value in values
    ]  # fmt: skip


def _recognise(content: Content) -> bool:
    tasks = content.json
    return isinstance(tasks, list) and all(isinstance(t, dict) and ("annotations" in t or "data" in t) for t in tasks)


FORMAT = AnnotationFormat(
    name="labelstudio",
    recognises=_recognise,
    read=read,
    write=write,
    derive=derive_shapes,
    draws_measured=True,
    file_name="labelstudio.json",
)
