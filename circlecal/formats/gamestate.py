"""SoccerNet game state (``Labels-GameState.json``): one file with all frames of a clip, in only.

``images`` (``image_id``, ``file_name``, ``width``, ``height``) and ``annotations``; those with the supercategory
``pitch`` have ``lines``, points by class as in SoccerNet's line annotation and with its mapping of pixels. Players and
cameras are left alone. Classes are spelled without blanks at their ends, and may have a single point.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
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


def name_images(path: Path, images: Sequence[GameStateImage]) -> dict[FrameKey, tuple[str, GameStateImage]]:
    """Images of a file with the ids of their frames, by their key.

    Raises
    ------
    InputError
        Two have one key.
    """
    require_distinct(path, "images.{}.image_id", [image.image_id for image in images])
    names = ids_of_pictures(image.file_name for image in images)
    return {image.image_id: (name, image) for name, image in zip(names, images, strict=True)}


def require_image(path: Path, number: int, key: FrameKey, images: Collection[FrameKey]) -> None:
    """See that an annotation, told by its place in the file, is of an image of it.

    Raises
    ------
    InputError
        It is not.
    """
    if key not in images:
        raise InputError(f"{path}: annotations.{number}.image_id: {key} is not in the file")


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frames of a file, those without lines too.

    Raises
    ------
    InputError
        No such file, one that contradicts itself, or the size of the pictures is not known.
    """
    labels = parse_content(_Labels, path, content)
    images = name_images(path, labels.images)
    lines: dict[FrameKey, list[dict[str, list[ClassPoint]]]] = defaultdict(list)
    for number, annotation in enumerate(labels.annotations):
        if annotation.supercategory == SUPERCATEGORY:
            require_image(path, number, annotation.image_id, images)
            lines[annotation.image_id].append(annotation.lines)
    frames = []
    for name, image in images.values():
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
