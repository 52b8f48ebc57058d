"""Which outside formats there are, and reading any of them by its name or by what a file looks like."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2

from circlecal.errors import InputError
from circlecal.files import is_file, read_file
from circlecal.formats.cameras import Size
from circlecal.formats.format import MAX_SHAPES, AnnotationFormat, CameraFormat, Content, Format, OutsideFormat
from circlecal.formats.paint_list import is_listed
from circlecal.formats.picture_paths import path_endings, picture_path
from circlecal.formats.shapes import AnnotatedFrame
from circlecal.pictures.files import PICTURE_SUFFIXES, decode
from circlecal.pictures.headers import read_header
from circlecal.pictures.limits import DEFAULT_LIMITS

MODULES = (
    *("annotation", "tvcalib", "soccernet_camera", "gamestate_camera", "gamestate", "coco", "labelme", "pnlcalib"),
    "broadtrack",
    *("labelstudio", "cvat", "worldcup", "extremities", "soccernet"),
)
"""The files of this folder that end with ``FORMAT``, in the order in which they are asked whether a file is theirs:
any object of lists may be SoccerNet's, so its line annotation is the last."""
RESULT = Format(name="circlecal", recognises=lambda c: c.mapping.keys() >= {"schema_version", "status", "image"})
"""A result file of circlecal itself, which becomes cameras."""


@cache
def formats() -> tuple[Format, ...]:
    """All formats; some names are those of an annotation and of a camera."""
    return (RESULT, *(import_module(f"circlecal.formats.{name}").FORMAT for name in MODULES))


def annotation_formats() -> dict[str, AnnotationFormat]:
    """Formats of annotations by name."""
    return {f.name: f for f in formats() if isinstance(f, AnnotationFormat)}


def camera_formats() -> dict[str, CameraFormat]:
    """Formats of cameras by name."""
    return {f.name: f for f in formats() if isinstance(f, CameraFormat)}


def calibration_formats() -> dict[str, AnnotationFormat | CameraFormat]:
    """Formats that a calibration can be written in, by name."""
    derived = {name: f for name, f in annotation_formats().items() if f.derive is not None}
    return {**camera_formats(), **derived}


@cache
def annotation_suffixes() -> frozenset[str]:
    """Suffixes of files that hold annotations, cameras or results, in small letters."""
    return frozenset({".jsonl", *(Path(f.file_name).suffix.lower() for f in formats() if isinstance(f, OutsideFormat))})


def require_format(name: str, known: dict[str, Any], option: str, what: str) -> None:
    """See that the user names one of the formats that ``known`` has.

    Raises
    ------
    InputError
        It does not.
    """
    if name not in known:
        raise InputError(f"{option} {name}: is no {what}; known: {', '.join(sorted(known))}")


def open_file(path: Path, name: str | None = None) -> tuple[Format, Content]:
    """Format and content of a file; ``name`` overrides what the content looks like.

    Raises
    ------
    InputError
        Unreadable, or of no known format.
    """
    content = Content.of(path)
    possible = [f for f in formats() if name in (None, f.name)]
    found = next((f for f in possible if f.recognises(content)), None)
    if found is None and (name is None or (len(possible) > 1 and isinstance(content.json, InputError))):
        raise _unknown(content)
    return found or possible[-1], content


def _unknown(content: Content) -> InputError:
    value = content.json
    if isinstance(value, InputError):
        return value
    if content.mapping:
        found = f"its keys are {', '.join(map(repr, list(content.mapping)[:5]))}"
    else:
        found = "it is neither JSON, nor XML, nor nine numbers" if value is None else "it is a list of something else"
    known = ", ".join(sorted({f.name for f in formats() if f is not RESULT}))
    return InputError(f"{content.path}: is of no known format: {found}; known: {known} (see --from)")


def read_annotations(
    path: Path, size: Size | None = None, name: str | None = None
) -> tuple[Format, list[AnnotatedFrame]]:
    """Format and frames of an annotation file.

    Parameters
    ----------
    path : path
        The file.
    size : (int, int), optional
        Width and height of its pictures where the file has none; else those of a picture of the same name beside it.
    name : str, optional
        Its format; recognised by content when None.

    Raises
    ------
    InputError
        One line with the file, the field and the mend.
    """
    found, content = open_file(path, name)
    return found, parse_annotations(found, content, size)


def parse_annotations(found: Format, content: Content, size: Size | None) -> list[AnnotatedFrame]:
    """Frames of an annotation file that is open already; parameters and errors as :func:`read_annotations`."""
    if not isinstance(found, AnnotationFormat):
        what = f"{found.name} {found.kind}"
        raise InputError(f"{content.path}: is a {what}, not an annotation; give its pictures instead")
    if size is None and found.per_frame:
        size = size_beside(content.path)
    frames = found.read(content.path, content.raw, size)
    if not found.holds_convention and is_listed(content.path):
        frames = [replace(frame, on_paint=True) for frame in frames]
    crowded = next((frame for frame in frames if len(frame.shapes) > MAX_SHAPES), None)
    if crowded is not None:
        limit = f"at most {MAX_SHAPES} are read of one frame"
        raise InputError(f"{content.path}: {crowded.id}: has {len(crowded.shapes)} shapes; {limit}")
    return frames


def picture_beside(path: Path, image: str | None = None, shared: Collection[str] = ()) -> Path | None:
    """The picture of an annotation file: the one that it names, in its folder or one below, or the one of its own name.

    Parameters
    ----------
    path : path
        The file.
    image : str, optional
        Path of the picture as the file names it; its first folders may be missing here.
    shared : collection of str
        Endings of such paths that several pictures of the file have, which are not looked for.
    """
    names = []
    for name in () if image is None else (picture_path(image), image):
        whole, *shorter = path_endings(name) or [""]
        names += [whole, *(ending for ending in shorter if ending not in shared)]
    names += [f"{name}{suffix}" for name in frame_names(path) for suffix in PICTURE_SUFFIXES]
    return next((path.parent / name for name in names if name and is_file(path.parent / name)), None)


def frame_names(path: Path) -> list[str]:
    """Names that the frame of a file may have: the file's own, and that without what formats put round it, as in
    ``x.soccernet.json`` and ``extremities_x.json``.
    """
    names = [path.stem]
    for name, found in annotation_formats().items():
        if found.per_frame:
            prefix = found.file_name.partition("{id}")[0]
            names.append(path.stem.removeprefix(prefix).removesuffix(f".{name}"))
    return list(dict.fromkeys(names))


def names_of_files(frame_name: str, format_name: str | None = None) -> list[str]:
    """Names that files of one frame have, of all formats of annotations or of one: those that programs give them, then
    those that circlecal does.
    """
    known = [f for f in annotation_formats().values() if f.per_frame and format_name in (None, f.name)]
    names = [f"{frame_name}{suffix}" for suffix in annotation_suffixes()]
    names += [f.file_name.format(id=f"{frame_name}{tag}") for f in known for tag in ("", f".{f.name}")]
    return list(dict.fromkeys(names))


def size_beside(path: Path) -> Size | None:
    """Size of the picture of the same name in the same folder as it is shown, turned as its EXIF orientation says; None
    where there is none that can be decoded.
    """
    picture = picture_beside(path)
    if picture is None:
        return None
    content = read_file(picture)
    header = read_header(content)
    if header is None:
        return None
    if header.format != "TIFF" and b"exif" not in content.lower():
        return header.width, header.height
    if header.decoded_bytes > DEFAULT_LIMITS.max_decoded_bytes:
        return None
    try:  # the header has the size before the turn, and the decoder alone knows whether it turns the picture
        height, width = decode(picture, content, cv2.IMREAD_GRAYSCALE).shape[:2]
    except InputError:
        return None
    return width, height
