"""BroadTrack: one JSON object with all frames of a sequence by the path of their picture, in and out.

``cp`` has the size of the picture, the horizontal field of view (``f = W / 2 / tan(fov / 2)``), SoccerNet's angles and
position, and up to three radial coefficients, each times ``(H / f)^(2 i)``. The principal point is the image centre and
pixels are square: other cameras are replaced by the nearest of that kind. ``score`` is the share of marking that is
met: not known here, written as 1 for an accepted frame. A refused frame is left out, as a lost one is there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, RootModel

from circlecal.errors import InputError
from circlecal.formats.cameras import CameraFrame, Size
from circlecal.formats.format import (
    Bounded,
    CameraFormat,
    Content,
    FileModel,
    Side,
    ids_of_pictures,
    json_bytes,
    parse_content,
)
from circlecal.geometry.camera import Camera, image_center


class _Camera(FileModel):
    sensorResolutionWidthPixels: Side  # noqa: N815 - the file's own names
    sensorResolutionHeightPixels: Side  # noqa: N815
    horizontalFieldOfViewDegrees: Annotated[float, Field(gt=0, lt=180)]  # noqa: N815
    panDegrees: Bounded  # noqa: N815
    tiltDegrees: Bounded  # noqa: N815
    rollDegrees: Bounded  # noqa: N815
    positionXMeters: Bounded  # noqa: N815
    positionYMeters: Bounded  # noqa: N815
    positionZMeters: Bounded  # noqa: N815
    normalizedRadialDistortionCoefficients: Annotated[list[Bounded], Field(max_length=3)] = Field([])  # noqa: N815


class _Entry(FileModel):
    cp: _Camera


class _Sequence(RootModel[dict[str, _Entry]]):
    pass


def read(path: Path, content: bytes, size: Size | None) -> list[CameraFrame]:
    """Cameras of a sequence, by the names of their pictures; every camera has its own size.

    Raises
    ------
    InputError
        No file of BroadTrack, or a third coefficient of distortion.
    """
    entries = parse_content(_Sequence, path, content).root
    names = ids_of_pictures(entries)
    return [_frame(path, key, name, entry.cp) for (key, entry), name in zip(entries.items(), names, strict=True)]


def _frame(path: Path, key: str, name: str, stored: _Camera) -> CameraFrame:
    width, height = stored.sensorResolutionWidthPixels, stored.sensorResolutionHeightPixels
    focal = width / 2.0 / math.tan(math.radians(stored.horizontalFieldOfViewDegrees) / 2.0)
    radial = (*stored.normalizedRadialDistortionCoefficients, 0.0, 0.0, 0.0)
    if radial[2]:
        raise InputError(f"{path}: {key}.cp.normalizedRadialDistortionCoefficients: the third must be 0 to be read")
    # theirs are in units of the height, ours of half the width, both on the picture
    per_height = np.array([(width / 2.0 / height) ** 2, (width / 2.0 / height) ** 4])
    camera = Camera(
        width=width,
        height=height,
        focal_px=np.array([focal, focal]),
        principal_point_px=image_center(width, height),
        angles_rad=np.radians([stored.panDegrees, stored.tiltDegrees, stored.rollDegrees]),
        position_m=np.array([stored.positionXMeters, stored.positionYMeters, stored.positionZMeters]),
        kappa=np.array(radial[:2]) * per_height,
    )
    return CameraFrame(name, width, height, camera, image=key)


def write(frames: Sequence[CameraFrame]) -> bytes:
    """Content of a file; every camera must be centred.

    Raises
    ------
    InputError
        No camera fits a homography.
    """
    return json_bytes({frame.image or f"/{frame.id}.jpg": _entry(frame.require_camera()) for frame in frames})


def _entry(camera: Camera) -> dict[str, Any]:
    per_half_width = camera.height / (camera.width / 2.0)
    pan, tilt, roll = np.degrees(camera.angles_rad).tolist()
    x, y, z = camera.position_m.tolist()
    stored = {
        "sensorResolutionWidthPixels": camera.width,
        "sensorResolutionHeightPixels": camera.height,
        "horizontalFieldOfViewDegrees": 2.0 * math.degrees(math.atan(camera.width / 2.0 / float(camera.focal_px[0]))),
        "panDegrees": pan,
        "tiltDegrees": tilt,
        "rollDegrees": roll,
        "positionXMeters": x,
        "positionYMeters": y,
        "positionZMeters": z,
        "normalizedRadialDistortionCoefficients": [
            float(camera.kappa[0] * per_half_width**2), float(camera.kappa[1] * per_half_width**4), 0.0
        ],
    }  # fmt: skip
    return {"cp": stored, "score": 1.0}


def _recognise(content: Content) -> bool:
    entries = content.mapping.values()
    return bool(entries) and all(isinstance(entry, dict) and "cp" in entry for entry in entries)


FORMAT = CameraFormat(
    name="broadtrack",
    recognises=_recognise,
    read=read,
    write=write,
    file_name="broadtrack.json",
    holds="centred camera",
)
