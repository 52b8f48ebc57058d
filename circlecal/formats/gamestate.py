"""SoccerNet game state (``Labels-GameState.json``): one file with all frames of a clip, in only.

``images`` (``image_id``, ``file_name``, ``width``, ``height``) and ``annotations``; those with the supercategory
``pitch`` have ``lines``, points by class as in SoccerNet's line annotation and with its mapping of pixels. Players and
cameras are left alone. Classes are spelled without blanks at their ends, and may have a single point.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from circlecal.errors import InputError
from circlecal.formats.checked import MAX_POINTS, Bounded, Checked, Side, Size, checked, require_size, stem_of
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.pictures.files import distinct_names

SUPERCATEGORY = "pitch"
_Id = int | str


class _Point(Checked):
    x: Bounded
    y: Bounded


class _Image(Checked):
    image_id: _Id
    file_name: str
    width: Side | None = None
    height: Side | None = None


class _Annotation(Checked):
    image_id: _Id
    supercategory: str = ""
    lines: dict[str, Annotated[list[_Point], Field(max_length=MAX_POINTS)]] = Field({})


class _Labels(Checked):
    images: list[_Image]
    annotations: list[_Annotation]


def read_labels(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frames of a file, those without lines too.

    Raises
    ------
    InputError
        No such file, one that contradicts itself, or the size of the pictures is not known.
    """
    labels = checked(_Labels, path, content)
    lines: dict[_Id, list[tuple[str, list[_Point]]]] = defaultdict(list)
    known = {image.image_id for image in labels.images}
    for number, annotation in enumerate(labels.annotations):
        if annotation.supercategory != SUPERCATEGORY:
            continue
        if annotation.image_id not in known:
            raise InputError(f"{path}: annotations.{number}.image_id: {annotation.image_id} is not in the file")
        lines[annotation.image_id] += annotation.lines.items()
    names = distinct_names([stem_of(image.file_name) for image in labels.images])
    frames = []
    for name, image in zip(names, labels.images, strict=True):
        stored = (image.width, image.height) if image.width and image.height else None
        width, height = require_size(path, stored, size)
        scale = np.array([width, height], dtype=np.float64) - 1.0
        shapes = tuple(
            Shape(label.strip(), "line", np.array([(p.x, p.y) for p in points], dtype=np.float64) * scale)
            for label, points in lines[image.image_id]
            if points
        )
        frames.append(AnnotatedFrame(name, width, height, shapes, image.file_name))
    return frames
