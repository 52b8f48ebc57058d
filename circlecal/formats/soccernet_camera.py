"""SoccerNet's camera: one JSON file ``camera_<id>.json`` per frame, in and out.

The file has no size. The principal point is taken as the image centre, ``W / 2`` or ``(W - 1) / 2``, whichever makes
the size even; what circlecal writes has ``image_width`` and ``image_height`` beside its keys, for its principal points
need not be at the centre. Between two sizes pixels go as those of SoccerNet's annotation do, by
``(W' - 1) / (W - 1)``; coefficients of distortion belong to the focal plane and stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from circlecal.errors import InputError
from circlecal.formats.cameras import CameraFrame, Size
from circlecal.formats.format import (
    Bounded,
    CameraFormat,
    FileModel,
    Focal,
    Side,
    json_bytes,
    parse_content,
    require_size,
)
from circlecal.geometry.camera import Camera, camera_from_soccernet

PREFIX = "camera_"


class CameraKeys(FileModel):
    """SoccerNet's camera; all keys of distortion are mandatory in its reader, and written always."""

    pan_degrees: Bounded
    tilt_degrees: Bounded
    roll_degrees: Bounded
    position_meters: Annotated[list[Bounded], Field(min_length=3, max_length=3)]
    x_focal_length: Focal
    y_focal_length: Focal
    principal_point: Annotated[list[Bounded], Field(min_length=2, max_length=2)]
    radial_distortion: Annotated[list[Bounded], Field(max_length=6)] = [0.0] * 6
    tangential_distortion: Annotated[list[Bounded], Field(max_length=2)] = [0.0] * 2
    thin_prism_distortion: Annotated[list[Bounded], Field(max_length=4)] = [0.0] * 4
    image_width: Side | None = None
    image_height: Side | None = None

    def camera(self, path: Path, size: Size | None) -> Camera:
        """The camera at its own size: the file's, else the given one, else what the principal point tells.

        Raises
        ------
        InputError
            No size is known, or a distortion that circlecal's cameras do not have.
        """
        further = (*self.radial_distortion[2:], *self.tangential_distortion, *self.thin_prism_distortion)
        if any(further):
            raise InputError(f"{path}: only the first two of radial_distortion can be read; the others must be 0")
        width, height = require_size(path, (self.image_width, self.image_height), size, self._guess_size())
        radial = (*self.radial_distortion, 0.0, 0.0)[:2]
        return camera_from_soccernet({**self.model_dump(), "radial_distortion": radial}, width, height)

    def _guess_size(self) -> Size | None:
        """Twice the principal point or one more, whichever is even."""
        sides = []
        for center in self.principal_point:
            side = next((s for s in (2.0 * center, 2.0 * center + 1.0) if s % 2 == 0), None)
            if side is None or not 2 <= side <= 65535:
                return None
            sides.append(int(side))
        return sides[0], sides[1]


def read(path: Path, content: bytes, size: Size | None) -> list[CameraFrame]:
    """The camera of a file.

    Raises
    ------
    InputError
        No camera, or its size is not known.
    """
    camera = parse_content(CameraKeys, path, content).camera(path, size)
    return [CameraFrame(path.stem.removeprefix(PREFIX), camera.width, camera.height, camera)]


def write(frames: Sequence[CameraFrame]) -> bytes:
    """Content of a file.

    Raises
    ------
    InputError
        No camera fits a homography.
    """
    (frame,) = frames
    return json_bytes(camera_keys(frame.require_camera()))


def camera_keys(camera: Camera) -> dict[str, Any]:
    """Content of a file, at the camera's own size."""
    return {**camera.soccernet(), "image_width": camera.width, "image_height": camera.height}


FORMAT = CameraFormat(
    name="soccernet",
    recognises=lambda content: content.mapping.keys() >= {"pan_degrees", "x_focal_length"},
    read=read,
    write=write,
    file_name=f"{PREFIX}{{id}}.json",
)
