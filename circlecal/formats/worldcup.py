"""WorldCup 2014 ``*.homographyMatrix``: nine numbers of text, picture (1280x720) to template in yards, in and out.

The template's origin is the top left corner of the field, x along the length, y down towards the camera. It is 115 x 74
yards, as TVCalib has it: metres about the centre mark = 0.9144 (yards - (57.5, 37)). PnLCalib takes a pitch of 105 x
68 m, yards = 1.09361 (metres + (52.5, 34)), and the two do not agree by up to 17 cm.

Pixels are taken as ours at 1280x720; pictures of other sizes are stretched to it corner to corner, and back where their
size is given. There is no room for a lens: what is written is the homography nearest to lens and surface over the field
in view, and by how much it leaves the picture is told. A refused frame has no file, and fields that are no soccer pitch
have none.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.formats.cameras import CameraFrame, Size
from circlecal.formats.format import CameraFormat, Content
from circlecal.geometry.homography import is_invertible, scale_homography
from circlecal.geometry.projective import Array

PICTURE: Size = (1280, 720)
SUFFIX = ".homographyMatrix"
_LARGEST = 1e9
_SOCCER_LINES = ("side_line_right", "big_rect_right_main", "small_rect_right_main")
"""Which fields of all sports only soccer pitches have together."""
_LONGEST_FILE = 4096
_METRES_PER_YARD, _CORNER_YARDS = 0.9144, (57.5, 37.0)


def yards_from_metres() -> Array:
    """Field (metres about the centre mark) to template (yards from the corner), (3, 3)."""
    scale, (x, y) = 1.0 / _METRES_PER_YARD, _CORNER_YARDS
    return np.array([[scale, 0.0, x], [0.0, scale, y], [0.0, 0.0, 1.0]])


def read_matrix(path: Path, content: bytes) -> CameraFrame:
    """The homography of a file, as one from field to picture at 1280x720.

    Raises
    ------
    InputError
        Not nine finite numbers, or a matrix that cannot be inverted.
    """
    matrix = parse_matrix(path, content)
    if np.abs(matrix).max() > _LARGEST or not is_invertible(matrix):
        raise InputError(f"{path}: the matrix cannot be inverted")
    template_to_image = np.linalg.inv(matrix)
    H = scale_homography(template_to_image @ yards_from_metres())
    return CameraFrame(path.name.removesuffix(path.suffix), *PICTURE, H_image_field=H)


def parse_matrix(path: Path, content: bytes) -> Array:
    """Nine numbers (3, 3) of whitespace separated text.

    Raises
    ------
    InputError
        Anything else.
    """
    words = content.split()
    try:
        values = [float(word) for word in words[:10]]
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if len(words) != 9 or not np.isfinite(values).all():
        raise InputError(f"{path}: a homography has nine finite numbers, this file {len(words)} words")
    return np.array(values).reshape(3, 3)


def matrix_bytes(H_image_field: Array, size: Size) -> bytes:
    """Content of a file for a homography from field (metres) to pictures of ``size``; numbers keep all their digits."""
    field_to_template = yards_from_metres()
    matrix = scale_homography(field_to_template @ np.linalg.inv(_stretch_to_picture(size) @ H_image_field))
    return "".join(" ".join(repr(float(v)) for v in row) + "\n" for row in matrix).encode()


def _stretch_to_picture(size: Size) -> Array:
    """Pixels of pictures of a size to those of the format's (3, 3), corner to corner."""
    factor = np.array(PICTURE) / np.array(size)
    shift = 0.5 * factor - 0.5
    return np.array([[factor[0], 0.0, shift[0]], [0.0, factor[1], shift[1]], [0.0, 0.0, 1.0]])


def _read(path: Path, content: bytes, size: Size | None) -> list[CameraFrame]:
    frame = read_matrix(path, content)
    if size is None or frame.H_image_field is None:
        return [frame]
    H = scale_homography(np.linalg.inv(_stretch_to_picture(size)) @ frame.H_image_field)
    return [CameraFrame(frame.id, *size, H_image_field=H)]


def _write(frames: Sequence[CameraFrame]) -> bytes:
    (frame,) = frames
    H = frame.H_image_field if frame.H_image_field is not None else frame.require_camera().homography
    return matrix_bytes(H, (frame.width, frame.height))


def _require_soccer(template: FieldTemplate) -> None:
    """See that the template in yards is one of this field.

    Raises
    ------
    InputError
        It is no soccer pitch.
    """
    missing = next((name for name in _SOCCER_LINES if name not in template.line_by_name), None)
    if missing is not None:
        raise InputError(f"the template of WorldCup is a soccer pitch; the field {template.name!r} has no {missing}")


def _recognise(content: Content) -> bool:
    short = len(content.raw) < _LONGEST_FILE and content.head not in (b"{", b"[", b"<")
    return short and len(content.raw.split()) == 9


FORMAT = CameraFormat(
    name="worldcup",
    recognises=_recognise,
    read=_read,
    write=_write,
    file_name=f"{{id}}{SUFFIX}",
    holds="homography",
    requires=_require_soccer,
)
