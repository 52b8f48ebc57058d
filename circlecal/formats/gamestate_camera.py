"""SoccerNet game state (``Labels-GameState.json``): one file with the cameras of all frames of a clip, in and out.

``images`` (``image_id``, ``file_name``, ``width``, ``height``) and ``annotations``; those of the supercategory
``camera`` (category 6) have ``parameters``, SoccerNet's camera at the size of the picture. The other annotations,
players and lines of the pitch, are left alone. A refused frame has its image and no camera: ids count all frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from circlecal.formats.cameras import CameraFrame, Size
from circlecal.formats.format import (
    CameraFormat,
    Content,
    FileModel,
    json_bytes,
    parse_content,
    parse_value,
    require_size,
)
from circlecal.formats.gamestate import SUPERCATEGORY as PITCH
from circlecal.formats.gamestate import FrameKey, GameStateImage, name_images, require_image
from circlecal.formats.soccernet_camera import CameraKeys

SUPERCATEGORY = "camera"
CATEGORY = 6


class _Annotation(FileModel):
    image_id: FrameKey
    supercategory: str = ""
    parameters: dict[str, Any] | None = None


class _Labels(FileModel):
    images: list[GameStateImage]
    annotations: list[_Annotation]


def read(path: Path, content: bytes, size: Size | None) -> list[CameraFrame]:
    """The cameras of a file, each at the size of its picture.

    Raises
    ------
    InputError
        No such file, one that contradicts itself, or the size of the pictures is not known.
    """
    labels = parse_content(_Labels, path, content)
    images = name_images(path, labels.images)
    frames = []
    for number, annotation in enumerate(labels.annotations):
        if annotation.supercategory != SUPERCATEGORY or annotation.parameters is None:
            continue
        require_image(path, number, annotation.image_id, images)
        name, image = images[annotation.image_id]
        keys = parse_value(CameraKeys, path, annotation.parameters, f"annotations.{number}.parameters")
        camera = keys.camera(path, require_size(path, (image.width, image.height), size))
        frames.append(CameraFrame(name, camera.width, camera.height, camera, image=image.file_name))
    return frames


def write(frames: Sequence[CameraFrame]) -> bytes:
    """Content of a file.

    Raises
    ------
    InputError
        No camera fits a homography.
    """
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for number, frame in enumerate(frames, start=1):
        key, has_camera = f"{number:010d}", frame.is_accepted
        images.append(
            {
                "is_labeled": has_camera,
                "image_id": key,
                "file_name": frame.image or f"{frame.id}.jpg",
                "height": frame.height,
                "width": frame.width,
                "has_labeled_person": False,
                "has_labeled_pitch": False,
                "has_labeled_camera": has_camera,
            }
        )
        if not has_camera:
            continue
        annotations.append(
            {
                "id": key,
                "image_id": key,
                "supercategory": SUPERCATEGORY,
                "category_id": CATEGORY,
                "parameters": frame.require_camera().soccernet(),
            }
        )
    categories = [{"supercategory": SUPERCATEGORY, "id": CATEGORY, "name": SUPERCATEGORY}]
    return json_bytes({"images": images, "annotations": annotations, "categories": categories})


def _recognise(content: Content) -> bool:
    """Cameras among the annotations, and no lines of a pitch, which would make it an annotation."""
    annotations = content.mapping.get("annotations")
    if not isinstance(annotations, list) or not isinstance(content.mapping.get("images"), list):
        return False
    kinds = [annotation.get("supercategory") for annotation in annotations if isinstance(annotation, dict)]
    return SUPERCATEGORY in kinds and PITCH not in kinds


FORMAT = CameraFormat(
    name="gamestate",
    recognises=_recognise,
    read=read,
    write=write,
    file_name="Labels-GameState.json",
    lists_refused=True,
)
