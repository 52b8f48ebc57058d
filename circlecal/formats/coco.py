"""COCO keypoints: one file with all frames, in and out.

``images`` (``file_name``, ``width``, ``height``), ``categories`` (``keypoints``: names) and ``annotations``
(``keypoints``: x, y, visibility of each; ``segmentation``: polygons). Keypoints are indices of pixels, so they are
ours; polygons and boxes run from 0 to the width, from the corner of the picture: pixel = theirs - 0.5. A keypoint with
visibility 0 is not there, one that is hidden (1) counts. COCO knows neither lines nor arcs: a polygon is read as points
on the marking that its category names, and lines are written so (a line of two points as a polygon with its end
doubled). A box alone is left out. A refused frame has what was measured in it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from circlecal.errors import InputError
from circlecal.formats.cameras import Size, derive_shapes
from circlecal.formats.format import (
    MAX_POINTS,
    AnnotationFormat,
    Bounded,
    FileModel,
    Side,
    ids_of_pictures,
    json_bytes,
    parse_content,
    require_distinct,
    require_size,
    says_paint,
    tell_convention,
)
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.projective import Array

POINTS_CATEGORY = "field"
_CORNER = 0.5


class _Category(FileModel):
    id: int
    name: str
    keypoints: list[str] = Field([])


class _Image(FileModel):
    id: int
    file_name: str
    width: Side | None = None
    height: Side | None = None
    circlecal: Any = None


_Numbers = Annotated[list[Bounded], Field(max_length=3 * MAX_POINTS)]


class _Annotation(FileModel):
    image_id: int
    category_id: int
    keypoints: _Numbers = Field([])
    segmentation: list[_Numbers] | dict[str, Any] = Field([])
    bbox: Any = None

    @property
    def is_box(self) -> bool:
        """Whether it says no more than where something is."""
        return bool(self.bbox) and not self.keypoints and not self.segmentation


class _Dataset(FileModel):
    images: list[_Image]
    categories: list[_Category]
    annotations: list[_Annotation]


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frames of a file, those without annotations too.

    Raises
    ------
    InputError
        No COCO file, or one that contradicts itself.
    """
    dataset = parse_content(_Dataset, path, content)
    require_distinct(path, "categories.{}.id", [category.id for category in dataset.categories])
    require_distinct(path, "images.{}.id", [image.id for image in dataset.images])
    categories = {category.id: category for category in dataset.categories}
    images = {image.id: image for image in dataset.images}
    shapes: dict[int, list[Shape]] = defaultdict(list)
    warnings: dict[int, list[str]] = defaultdict(list)
    for number, annotation in enumerate(dataset.annotations):
        where = f"{path}: annotations.{number}"
        category = categories.get(annotation.category_id)
        if category is None or annotation.image_id not in images:
            missing = "category_id" if category is None else "image_id"
            raise InputError(f"{where}.{missing}: {getattr(annotation, missing)} is not in the file")
        if annotation.is_box:
            told = f"{category.name!r} is a box, neither keypoints nor a polygon; left out"
            warnings[annotation.image_id].append(f"{where}.bbox: {told}")
        shapes[annotation.image_id] += _keypoints(annotation, category, where)
        if isinstance(annotation.segmentation, dict):
            warnings[annotation.image_id].append(f"{where}.segmentation: is a mask, not a polygon; left out")
        else:
            shapes[annotation.image_id] += _polygons(annotation.segmentation, category.name, where)
    names = ids_of_pictures(image.file_name for image in dataset.images)
    frames = []
    for name, image in zip(names, dataset.images, strict=True):
        chosen = require_size(path, (image.width, image.height), size)
        found = tuple(shapes[image.id])
        on_paint = says_paint(image.circlecal)
        warned = tuple(warnings[image.id])
        frames.append(AnnotatedFrame(name, *chosen, found, image.file_name, warned, on_paint=on_paint))
    return frames


def _keypoints(annotation: _Annotation, category: _Category, where: str) -> list[Shape]:
    if len(annotation.keypoints) % 3 or len(annotation.keypoints) // 3 > len(category.keypoints):
        raise InputError(
            f"{where}.keypoints: has {len(annotation.keypoints)} numbers; "
            f"three for each of the {len(category.keypoints)} keypoints of {category.name!r} are wanted"
        )
    triples = np.array(annotation.keypoints, dtype=np.float64).reshape(-1, 3)
    return [
        Shape(label.strip(), "points", triple[None, :2])
        for label, triple in zip(category.keypoints, triples, strict=False)
        if triple[2] > 0
    ]


def _polygons(polygons: Sequence[Sequence[float]], label: str, where: str) -> list[Shape]:
    found = []
    for number, flat in enumerate(polygons):
        if len(flat) % 2 or not flat:
            raise InputError(f"{where}.segmentation.{number}: has {len(flat)} numbers; pairs are wanted")
        points = np.array(flat, dtype=np.float64).reshape(-1, 2) - _CORNER
        again = np.all(points[1:] == points[:-1], axis=1)
        found.append(Shape(label.strip(), "line", points[~np.concatenate([[False], again])]))
    return found


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a file: single points as keypoints of one category, everything else as polygons of one per label, in
    which several points of one label in a frame are one.
    """
    frames = [replace(frame, shapes=_join_points(frame.shapes)) for frame in frames]
    labels = sorted({shape.label for frame in frames for shape in frame.shapes if _is_single(shape)})
    curves = sorted({shape.label for frame in frames for shape in frame.shapes if not _is_single(shape)})
    categories: list[dict[str, Any]] = [{"id": 1, "name": POINTS_CATEGORY, "keypoints": labels, "skeleton": []}]
    categories += [{"id": number, "name": label} for number, label in enumerate(curves, start=2)]
    numbers = {label: number for number, label in enumerate(curves, start=2)}
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for image_id, frame in enumerate(frames, start=1):
        name = frame.image or f"{frame.id}.jpg"
        image = {"id": image_id, "file_name": name, "width": frame.width, "height": frame.height}
        images.append(image | tell_convention(frame))
        single = {shape.label: shape.points_px[0] for shape in frame.shapes if _is_single(shape)}
        if single:
            annotations.append(_annotation(len(annotations) + 1, image_id, 1, np.array(list(single.values())), {
                "keypoints": [v for label in labels for v in _triple(single.get(label))], "num_keypoints": len(single)
            }))  # fmt: skip
        for shape in frame.shapes:
            if not _is_single(shape):
                points = shape.sample()
                polygon = points if len(points) > 2 else points[np.minimum(np.arange(3), len(points) - 1)]
                annotations.append(_annotation(len(annotations) + 1, image_id, numbers[shape.label], points, {
                    "segmentation": [(polygon + _CORNER).ravel().tolist()]
                }))  # fmt: skip
    return json_bytes({"images": images, "categories": categories, "annotations": annotations})


def _join_points(shapes: Sequence[Shape]) -> tuple[Shape, ...]:
    """The shapes with several single points of one label as one shape, where the first of them stands."""
    points: dict[str, list[Array]] = defaultdict(list)
    for shape in shapes:
        if _is_single(shape):
            points[shape.label].append(shape.points_px)
    kept, joined = [], set[str]()
    for shape in shapes:
        if not _is_single(shape) or len(points[shape.label]) == 1:
            kept.append(shape)
        elif shape.label not in joined:
            kept.append(replace(shape, points_px=np.concatenate(points[shape.label])))
            joined.add(shape.label)
    return tuple(kept)


def _is_single(shape: Shape) -> bool:
    return shape.kind == "points" and len(shape.points_px) == 1


def _triple(point: Array | None) -> list[float]:
    return [0.0, 0.0, 0] if point is None else [float(point[0]), float(point[1]), 2]


def _annotation(number: int, image_id: int, category_id: int, points: Array, content: dict[str, Any]) -> dict[str, Any]:
    corner, extent = points.min(axis=0) + _CORNER, np.ptp(points, axis=0)
    box = [float(v) for v in (*corner, *extent)]
    return {
        "id": number, "image_id": image_id, "category_id": category_id, "bbox": box,
        "area": box[2] * box[3], "iscrowd": 0, **content,
    }  # fmt: skip


FORMAT = AnnotationFormat(
    name="coco",
    recognises=lambda content: content.mapping.keys() >= {"images", "annotations"},
    read=read,
    write=write,
    derive=derive_shapes,
    draws_measured=True,
    file_name="coco.json",
)
