"""The truth of rendered clips, as ``circlecal synth --video`` writes it beside them."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from circlecal.errors import InputError, reading_failure
from circlecal.geometry.camera import Camera, camera_from_soccernet
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.records.parts import CameraRow
from circlecal.synthetic.video import ShotKind

__all__ = ["ClipTruth", "parse_clip_truth", "read_clip_truth"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class _Pitch(_Part):
    length_m: float
    width_m: float
    crown_m: float
    crown_shape: SurfaceShape
    crown_reference_m: float


class _FrameTruth(_Part):
    time_s: float
    shot: ShotKind
    camera: CameraRow | None = None


class ClipTruth(_Part):
    """What :func:`circlecal.synthetic.clip_files.write_clip` writes beside a clip, as far as it is compared."""

    id: str
    kind: str
    width: int
    height: int
    rate: float
    field: str = "soccer"
    pitch: _Pitch
    frames: list[_FrameTruth]

    @property
    def surface(self) -> Surface:
        """The crowned pitch."""
        return Surface(self.pitch.crown_shape, self.pitch.crown_reference_m, self.pitch.crown_m)

    def camera(self, index: int) -> Camera | None:
        """True camera of a frame; None in a cut."""
        keys = self.frames[index].camera
        return None if keys is None else camera_from_soccernet(keys.model_dump(), self.width, self.height)

    def turn_field(self) -> ClipTruth:
        """The truth of the field turned by 180 degrees, which looks as it is."""
        cameras = [self.camera(index) for index in range(len(self.frames))]
        rows = [
            None if camera is None else CameraRow.model_validate(camera.turn_field().soccernet(), strict=False)
            for camera in cameras
        ]
        turned = [frame.model_copy(update={"camera": row}) for frame, row in zip(self.frames, rows, strict=True)]
        return self.model_copy(update={"frames": turned})


def read_clip_truth(path: Path) -> ClipTruth:
    """The truth of one clip.

    Raises
    ------
    InputError
        The file cannot be read, or is damaged.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reading_failure(error)}; render the clip again") from error
    return parse_clip_truth(path, content)


def parse_clip_truth(path: Path, content: bytes) -> ClipTruth:
    """The truth of one clip, from the content of its file.

    Raises
    ------
    InputError
        It is damaged.
    """
    try:
        return ClipTruth.model_validate_json(content)
    except ValidationError as error:
        where = ".".join(str(part) for part in error.errors()[0]["loc"])
        raise InputError(f"{path}: {where}: {error.errors()[0]['msg']}; render the clip again") from error
