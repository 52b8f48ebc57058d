"""SoccerNet's extremities: where a segmentation's classes end, one JSON file ``extremities_<id>.json`` per frame.

The form is that of the line annotation, but the points are read off a picture of class ids, so pixel = ``x W``,
``y H``. Only the name of the file tells the two apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from circlecal.formats.cameras import Size
from circlecal.formats.format import AnnotationFormat, require_size
from circlecal.formats.shapes import AnnotatedFrame
from circlecal.formats.soccernet import holds_classes, parse_classes, write_classes

PREFIX = "extremities_"


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frame of a file; empty classes are left out.

    Raises
    ------
    InputError
        No such file of SoccerNet, or the size of the picture is not known.
    """
    chosen = require_size(path, size)
    return [AnnotatedFrame(path.stem.removeprefix(PREFIX), *chosen, parse_classes(path, content, chosen))]


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a file."""
    (frame,) = frames
    return write_classes(frame, (frame.width, frame.height))


FORMAT = AnnotationFormat(
    name="extremities",
    recognises=lambda content: content.path.name.startswith(PREFIX) and holds_classes(content),
    read=read,
    write=write,
    file_name=f"{PREFIX}{{id}}.json",
    sigma_px=4.0,
    holds_convention=False,
)
