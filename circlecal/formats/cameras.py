"""A camera as an outside file has it: of one frame, at the size of the pictures that it was made for."""

from __future__ import annotations

from dataclasses import dataclass

from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """A frame's camera, or its homography alone.

    Attributes
    ----------
    id : str
        Name of the frame.
    width, height : int
        Size of the pictures in which pixels count.
    camera : Camera or None
        None where the file holds a homography only.
    H_image_field : (3, 3) array or None
        Field (metres) to pixels of the frame as stored, where the file holds one.
    image : str or None
        Name of the picture, where the file has one.
    """

    id: str
    width: int
    height: int
    camera: Camera | None = None
    H_image_field: Array | None = None
    image: str | None = None
