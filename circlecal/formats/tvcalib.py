"""TVCalib ``per_sample_output.json``: JSON lines, one frame each, in and out.

``image_ids`` (the picture's name), SoccerNet's camera keys at ``image_width`` x ``image_height``, ``aov_radian``
(horizontal field of view) and ``homography`` (picture to field in metres). Where a file gives no size it is read off
the principal point, as for SoccerNet. Values may be numbers or lists of one. ``loss_ndc_total`` and ``time_s`` are not
known here and not written. A refused frame has no line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from circlecal.errors import InputError
from circlecal.formats.cameras import CameraFrame, Size
from circlecal.formats.format import (
    Bounded,
    CameraFormat,
    Content,
    Focal,
    Side,
    ids_of_pictures,
    json_bytes,
    parse_content,
)
from circlecal.formats.soccernet_camera import CameraKeys, camera_keys
from circlecal.geometry.homography import is_invertible, scale_homography


def _single(value: Any) -> Any:
    return value[0] if isinstance(value, list) and len(value) == 1 else value


_Row = Annotated[list[Bounded], Field(min_length=3, max_length=3)]


class _Sample(CameraKeys):
    image_ids: Annotated[str, BeforeValidator(_single)]
    pan_degrees: Annotated[Bounded, BeforeValidator(_single)]
    tilt_degrees: Annotated[Bounded, BeforeValidator(_single)]
    roll_degrees: Annotated[Bounded, BeforeValidator(_single)]
    x_focal_length: Annotated[Focal, BeforeValidator(_single)]
    y_focal_length: Annotated[Focal, BeforeValidator(_single)]
    homography: Annotated[list[_Row], Field(min_length=3, max_length=3)] | None = None
    image_width: Annotated[Side | None, BeforeValidator(_single)] = None
    image_height: Annotated[Side | None, BeforeValidator(_single)] = None


def read(path: Path, content: bytes, size: Size | None) -> list[CameraFrame]:
    """Cameras of a file.

    Raises
    ------
    InputError
        A line is no camera, or its size is not known.
    """
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text") from error
    samples = [
        (number, parse_content(_Sample, path, text, number)) for number, text in enumerate(lines, 1) if text.strip()
    ]
    names = ids_of_pictures(sample.image_ids for _, sample in samples)
    frames = []
    for name, (number, sample) in zip(names, samples, strict=True):
        camera = sample.camera(path, size)
        H = _field_to_image(path, number, sample)
        frames.append(CameraFrame(name, camera.width, camera.height, camera, H, sample.image_ids))
    return frames


def _field_to_image(path: Path, number: int, sample: _Sample) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    if sample.homography is None:
        return None
    matrix = np.array(sample.homography)
    if not is_invertible(matrix):
        raise InputError(f"{path}, line {number}: homography: cannot be inverted")
    return scale_homography(np.linalg.inv(matrix))


def write(frames: Sequence[CameraFrame]) -> bytes:
    """Content of a file, one line per frame.

    Raises
    ------
    InputError
        No camera fits a homography.
    """
    return b"".join(map(_line, frames))


def _line(frame: CameraFrame) -> bytes:
    camera = frame.require_camera()
    H = camera.homography if frame.H_image_field is None else frame.H_image_field
    return json_bytes(
        {
            "image_ids": frame.image or f"{frame.id}.jpg",
            **camera_keys(camera),
            "aov_radian": 2.0 * math.atan(camera.width / 2.0 / float(camera.focal_px[0])),
            "homography": scale_homography(np.linalg.inv(H)).tolist(),
        }
    )


def _recognise(content: Content) -> bool:
    """An object with ``image_ids``, or several on a line each."""
    if "image_ids" in content.mapping:
        return True
    first = Content(content.path, content.raw.partition(b"\n")[0])
    return b'"image_ids"' in first.raw and isinstance(first.json, dict)


FORMAT = CameraFormat(name="tvcalib", recognises=_recognise, read=read, write=write, file_name="per_sample_output.json")
