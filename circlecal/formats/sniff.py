"""Which format a file has, by its content."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from circlecal.errors import InputError
from circlecal.formats.checked import parsed_json

Kind = Literal["annotation", "camera", "result"]
ANNOTATION_FORMATS = ("soccernet", "extremities", "pnlcalib", "coco", "cvat", "labelstudio", "labelme", "gamestate")
READ_ONLY = ("extremities", "gamestate")
"""Annotations that no calibration is written in."""
CAMERA_FORMATS = ("soccernet", "broadtrack", "tvcalib", "worldcup")
RESULT_FORMAT = "circlecal"
_EXTREMITIES_PREFIX = "extremities_"
_CAMERA_KEYS = {"pan_degrees", "x_focal_length"}


def recognise(path: Path, content: bytes) -> tuple[str, Kind]:
    """Name and kind of a file's format.

    Raises
    ------
    InputError
        None of the known ones; the line says what was found.
    """
    head = content.lstrip(b"\xef\xbb\xbf \t\r\n")[:1]
    if head == b"<":
        return "cvat", "annotation"
    if head in (b"{", b"["):
        return _recognise_json(path, content)
    if len(content) < 4096 and len(content.split()) == 9:
        return "worldcup", "camera"
    raise _unknown(path, "it is neither JSON, nor XML, nor nine numbers")


def kind_of(path: Path, content: bytes, name: str) -> Kind:
    """Kind of a file whose format the user names: SoccerNet has annotations and cameras."""
    if name == RESULT_FORMAT:
        return "result"
    if name == "soccernet":
        value = parsed_json(path, content)
        return "camera" if isinstance(value, dict) and value.keys() >= _CAMERA_KEYS else "annotation"
    return "camera" if name in CAMERA_FORMATS else "annotation"


def _recognise_json(path: Path, content: bytes) -> tuple[str, Kind]:
    first = content.partition(b"\n")[0]
    if b'"image_ids"' in first and _is_object(first):
        return "tvcalib", "camera"
    value = parsed_json(path, content)
    if isinstance(value, list):
        if all(isinstance(task, dict) and ("annotations" in task or "data" in task) for task in value):
            return "labelstudio", "annotation"
        raise _unknown(path, "it is a list, but not of Label Studio's tasks")
    return _recognise_mapping(path, value)


def _is_object(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def _recognise_mapping(path: Path, value: dict[str, Any]) -> tuple[str, Kind]:
    keys = value.keys()
    known: tuple[tuple[bool, tuple[str, Kind]], ...] = (
        (keys >= {"schema_version", "status", "image"}, (RESULT_FORMAT, "result")),
        ("image_ids" in keys, ("tvcalib", "camera")),
        (keys >= _CAMERA_KEYS, ("soccernet", "camera")),
        (_is_gamestate(value), ("gamestate", "annotation")),
        (keys >= {"images", "annotations"}, ("coco", "annotation")),
        ("shapes" in keys, ("labelme", "annotation")),
        (isinstance(value.get("kp"), dict), ("pnlcalib", "annotation")),
        (bool(value) and all(isinstance(v, dict) and "cp" in v for v in value.values()), ("broadtrack", "camera")),
    )
    found = next((answer for fits, answer in known if fits), None)
    if found is not None:
        return found
    if all(isinstance(points, list) for points in value.values()):
        lines = path.name.startswith(_EXTREMITIES_PREFIX)
        return ("extremities" if lines else "soccernet"), "annotation"
    raise _unknown(path, f"its keys are {', '.join(map(repr, list(keys)[:5]))}")


def _is_gamestate(value: dict[str, Any]) -> bool:
    """Lines of a pitch among the annotations, or, where no frame has any, images known by ``image_id``."""
    images, annotations = value.get("images"), value.get("annotations")
    if not isinstance(images, list) or not isinstance(annotations, list):
        return False
    pitches = any(isinstance(a, dict) and a.get("supercategory") == "pitch" for a in annotations)
    return pitches or any(isinstance(image, dict) and "image_id" in image and "id" not in image for image in images)


def _unknown(path: Path, found: str) -> InputError:
    formats = ", ".join(dict.fromkeys((*ANNOTATION_FORMATS, *CAMERA_FORMATS)))
    return InputError(f"{path}: is of no known format: {found}; known: {formats} (see --from)")
