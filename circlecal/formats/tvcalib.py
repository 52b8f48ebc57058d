"""TVCalib ``per_sample_output.json``: JSON lines, one frame each, in and out.

``image_ids`` (the picture's name), SoccerNet's camera keys at ``image_width`` x ``image_height``, ``aov_radian``
(horizontal field of view) and ``homography`` (picture to field in metres). Where a file gives no size it is read off
the principal point, as for SoccerNet. Values may be numbers or lists of one. ``loss_ndc_total`` and ``time_s`` are not
known here and not written. A refused frame has no line.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from circlecal.errors import InputError
from circlecal.formats.cameras import CameraFrame
from circlecal.formats.checked import Bounded, Focal, Side, Size, checked, stem_of
from circlecal.formats.soccernet import CameraKeys, camera_record
from circlecal.geometry.homography import scale_homography
from circlecal.pictures.files import distinct_names

_WORST_CONDITION = 1e14


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


def read_samples(path: Path, content: bytes, size: Size | None) -> list[CameraFrame]:
    """Cameras of a file.

    Raises
    ------
    InputError
        A line is no camera, or its size is not known.
    """
    try:
        lines = content.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text") from error
    samples = [(number, checked(_Sample, path, text, number)) for number, text in enumerate(lines, 1) if text.strip()]
    names = distinct_names([stem_of(sample.image_ids) for _, sample in samples])
    frames = []
    for name, (number, sample) in zip(names, samples, strict=True):
        found = (sample.image_width, sample.image_height) if sample.image_width and sample.image_height else None
        camera = sample.camera(path, found or size)
        H = _field_to_image(path, number, sample)
        frames.append(CameraFrame(name, camera.width, camera.height, camera, H, sample.image_ids))
    return frames


def _field_to_image(path: Path, number: int, sample: _Sample) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    if sample.homography is None:
        return None
    matrix = np.array(sample.homography)
    if not np.linalg.cond(matrix) < _WORST_CONDITION:
        raise InputError(f"{path}, line {number}: homography: cannot be inverted")
    return scale_homography(np.linalg.inv(matrix))


def sample_line(frame: CameraFrame) -> str:
    """One line of a file for a frame with a camera."""
    camera = frame.camera
    if camera is None:
        raise ValueError("TVCalib's lines hold cameras")
    H = camera.homography if frame.H_image_field is None else frame.H_image_field
    record = {
        "image_ids": frame.image or f"{frame.id}.jpg",
        **camera_record(camera),
        "aov_radian": 2.0 * math.atan(camera.width / 2.0 / float(camera.focal_px[0])),
        "homography": scale_homography(np.linalg.inv(H)).tolist(),
    }
    return json.dumps(record, allow_nan=False, ensure_ascii=False)


def samples_bytes(frames: Sequence[CameraFrame]) -> bytes:
    """Content of a file."""
    return "".join(sample_line(frame) + "\n" for frame in frames if frame.camera is not None).encode()
