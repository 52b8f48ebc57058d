"""SoccerNet game state (``Labels-GameState.json``): one file with all frames of a clip, in only.

``images`` (``image_id``, ``file_name``, ``width``, ``height``) and ``annotations``; those with the supercategory
``pitch`` have ``lines``, points by class as in SoccerNet's line annotation and with its mapping of pixels. Players and
cameras are left alone. Classes are spelled without blanks at their ends, and may have a single point.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Annotated

from pydantic import Field

from circlecal.errors import InputError
from circlecal.formats.cameras import Size
from circlecal.formats.format import (
    MAX_POINTS,
    AnnotationFormat,
    Content,
    FileModel,
    Side,
    ids_of_pictures,
    parse_content,
    require_distinct,
    require_size,
)
from circlecal.formats.shapes import AnnotatedFrame
from circlecal.formats.soccernet import ClassPoint, shapes_of_classes

SUPERCATEGORY = "pitch"
FrameKey = int | str


class GameStateImage(FileModel):
    """A frame of the clip."""

    image_id: FrameKey
    file_name: str
    width: Side | None = None
    height: Side | None = None


class _Annotation(FileModel):
    image_id: FrameKey
    supercategory: str = ""
    lines: dict[str, Annotated[list[ClassPoint], Field(max_length=MAX_POINTS)]] = Field({})


class _Labels(FileModel):
    images: list[GameStateImage]
    annotations: list[_Annotation]


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frames of a file, those without lines too.

    Raises
    ------
    InputError
        No such file, one that contradicts itself, or the size of the pictures is not known.
    """
    labels = parse_content(_Labels, path, content)
    require_distinct(path, "images.{}.image_id", [image.image_id for image in labels.images])
    lines: dict[FrameKey, list[dict[str, list[ClassPoint]]]] = defaultdict(list)
    known = {image.image_id for image in labels.images}
    for number, annotation in enumerate(labels.annotations):
        if annotation.supercategory != SUPERCATEGORY:
            continue
        if annotation.image_id not in known:
            raise InputError(f"{path}: annotations.{number}.image_id: {annotation.image_id} is not in the file")
        lines[annotation.image_id].append(annotation.lines)
    names = ids_of_pictures(image.file_name for image in labels.images)
    frames = []
    for name, image in zip(names, labels.images, strict=True):
        width, height = require_size(path, (image.width, image.height), size)
        shapes = (s for classes in lines[image.image_id] for s in shapes_of_classes(classes, (width - 1, height - 1)))
        frames.append(AnnotatedFrame(name, width, height, tuple(shapes), image.file_name))
    return frames


def _recognise(content: Content) -> bool:
    """Lines of a pitch among the annotations, or, where no frame has any, images known by ``image_id``."""
    images, annotations = content.mapping.get("images"), content.mapping.get("annotations")
    if not isinstance(images, list) or not isinstance(annotations, list):
        return False
    pitches = any(isinstance(a, dict) and a.get("supercategory") == SUPERCATEGORY for a in annotations)
    return pitches or any(isinstance(image, dict) and "image_id" in image and "id" not in image for image in images)


FORMAT = AnnotationFormat(
    name="gamestate", recognises=_recognise, read=read, file_name="Labels-GameState.json", marks_line_ends=True
)
