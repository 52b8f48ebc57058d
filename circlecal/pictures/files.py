"""Pictures: which files are frames, reading them as 8-bit BGR, writing pictures.

A file is judged by its first bytes, not by its name, and its size is read from its header before anything is decoded.
"""

from __future__ import annotations

import os
import re
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.files import is_folder, list_folder, read_file, real_path, require_input, size_in_words, write_atomic
from circlecal.names import as_stem
from circlecal.pictures.headers import MIN_SIDE, read_header
from circlecal.pictures.limits import DEFAULT_LIMITS, LimitsConfig, suggest_limit

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
MASK_SUFFIX = ".mask.png"
MASK_FOLDER = "masks"
OVERLAY_SUFFIX, RADAR_SUFFIX, DEBUG_SUFFIX = ".overlay.jpg", ".radar.jpg", ".debug"
REPORT_FOLDER = "circlecal-report"
_DIGITS = re.compile(r"([0-9]+)")
OWN_FOLDERS = (
    "circlecal-out",
    "circlecal-run",
    "circlecal-debug",
    "circlecal-track",
    "circlecal-rig",
    "circlecal-simulate",
    REPORT_FOLDER,
)
STAGE_SHEET = "contact-sheet"
LAST_STAGE = "09-verdict"
"""The two pictures that every folder of stages has, whatever its name is."""


@dataclass(frozen=True, slots=True)
class PictureFile:
    """One picture to calibrate: its id, unique in a run, and its file.

    Attributes
    ----------
    id, path : str, Path
        The name in the results, and the file.
    mask_stem : str
        Path without suffix relative to the folder that was given, where a mask folder has its mask; of a frame of a
        video the id.
    time_s : float or None
        Time in the video that the frame is from.
    picture : (H, W, 3) uint8 or None
        The decoded frame of a video; None where the file is to be read.
    aspect : float or None
        Width of a pixel over its height, where the file says that it is not 1.
    url : str or None
        Where the picture is fetched from, instead of from ``path``.
    bytes : int or None
        Size of the video's file when it was opened; None of a picture.
    """

    id: str
    path: Path
    mask_stem: str
    time_s: float | None = None
    picture: NDArray[np.uint8] | None = field(default=None, compare=False, repr=False)
    aspect: float | None = None
    url: str | None = None
    bytes: int | None = None

    @property
    def stem(self) -> str:
        """Name that a mask or a file of keypoints of this frame has."""
        return self.path.stem if self.time_s is None and self.url is None else self.id

    @property
    def source(self) -> str:
        """File or URL, as the result names it."""
        return self.url or str(self.path)

    @property
    def label(self) -> str:
        """What messages call it."""
        return self.path.name if self.time_s is None and self.url is None else self.id


class NoFramesError(InputError):
    """Inputs that hold nothing to calibrate."""


def find_frames(inputs: Sequence[str | Path], exclude: Sequence[Path] = ()) -> list[PictureFile]:
    """Frames among files and folders, each once, in a fixed order.

    Folders are searched to any depth. Masks (``x.mask.png`` and what lies in a folder ``masks`` beside pictures),
    hidden files and circlecal's own pictures are not frames. An id is the path relative to the folder that was given,
    without suffix, with ``__`` for separators; where two would be equal, both carry their suffix, then the name of
    their folder.

    Parameters
    ----------
    inputs : sequence of path
        Pictures and folders.
    exclude : sequence of path
        Files and folders that hold no frames, such as the output folder and the masks.

    Raises
    ------
    InputError
        Missing input or unreadable folder.
    NoFramesError
        Nothing to calibrate.
    """
    excluded = {real_path(path) for path in exclude}
    found: dict[Path, tuple[Path, Path]] = {}
    masks = 0
    for given in map(Path, inputs):
        for path, relative in _pictures_of(given):
            resolved = real_path(path)
            if excluded and not excluded.isdisjoint((resolved, *resolved.parents)):
                continue
            if _is_mask(path, given):
                masks += 1
                continue
            found.setdefault(resolved, (path, relative))
    if not found:
        named = ", ".join(str(given) for given in inputs)
        what = "only masks" if masks else f"no pictures ({', '.join(PICTURE_SUFFIXES)})"
        raise NoFramesError(f"{named}: {what} found; give pictures or a folder of pictures")
    return _assign_ids(list(found.values()))


def _pictures_of(given: Path) -> Iterator[tuple[Path, Path]]:
    """Files of one input with their paths relative to the folder given."""
    require_input(given)
    if not is_folder(given):
        yield given, Path(given.name)
        return
    for path in walk(given):
        relative = path.relative_to(given)
        own = path.name.endswith((OVERLAY_SUFFIX, RADAR_SUFFIX))
        if path.suffix.lower() in PICTURE_SUFFIXES and not own and MASK_FOLDER not in relative.parts[:-1]:
            yield path, relative


def walk(folder: Path, above: Collection[Path] = ()) -> Iterator[Path]:
    """Files of a folder at any depth, in the order of their names, but hidden ones and what circlecal writes.

    Links to folders are followed, but not to one of the folders ``above`` that they lie in.

    Raises
    ------
    InputError
        A folder cannot be read.
    """
    inside = (*above, real_path(folder))
    if inside[-1] in above:
        return
    entries = list_folder(folder)
    names = {entry.stem for entry in entries}
    if {STAGE_SHEET, LAST_STAGE} <= names:
        return
    for entry in entries:
        if entry.name.startswith("."):
            continue
        if not is_folder(entry):
            yield entry
        elif entry.name not in OWN_FOLDERS and entry.suffix != DEBUG_SUFFIX:
            yield from walk(entry, inside)


def _is_mask(path: Path, given: Path) -> bool:
    """Whether a picture is a mask by name or place; a folder ``masks`` that lies beside no pictures holds frames."""
    if path.name.lower().endswith(MASK_SUFFIX):
        return True
    folder = path.parent.absolute()
    if folder.name != MASK_FOLDER or (is_folder(given) and folder != given.absolute()):
        return False
    return any(entry.suffix.lower() in PICTURE_SUFFIXES for entry in folder.parent.iterdir() if entry.is_file())


def _assign_ids(found: Sequence[tuple[Path, Path]]) -> list[PictureFile]:
    ids = [as_stem(_short_id(relative)) for _, relative in found]
    longer: dict[int, list[str]] = {}  # of frames whose short id another one has
    level = [0] * len(found)
    while True:
        counts = Counter(name.casefold() for name in ids)
        doubled = [index for index, name in enumerate(ids) if counts[name.casefold()] > 1]
        longer |= {index: _longer_ids(*found[index]) for index in doubled if index not in longer}
        if not doubled or all(level[index] > len(longer[index]) for index in doubled):
            break
        for index in doubled:
            level[index] += 1
            ids[index] = longer[index][min(level[index], len(longer[index])) - 1]
    return [
        PictureFile(name, path, relative.with_suffix("").as_posix())
        for name, (path, relative) in zip(ids, found, strict=True)
    ]


def _short_id(relative: Path) -> str:
    return "__".join(relative.with_suffix("").parts)


def path_in_folder(frame_id: str, path: Path) -> str:
    """Path without suffix of a picture relative to the folder in which it was found, from its id; its stem where the
    id, which others shared, does not tell.
    """
    whole = path.absolute().with_suffix("")
    of_depth = (Path(*whole.parts[-depth:]) for depth in range(1, len(whole.parts)))
    return next((p.as_posix() for p in of_depth if as_stem("__".join(p.parts)) == frame_id), whole.name)


def _longer_ids(path: Path, relative: Path) -> list[str]:
    """Ids from the shortest but one to one that no other file has."""
    stem = _short_id(relative)
    suffixed = f"{stem}-{path.suffix[1:].lower()}" if path.suffix else stem
    parents = path.absolute().parts[1 : -len(relative.parts)]
    longer = ["__".join((*parents[-count:], suffixed)) for count in range(1, len(parents) + 1)]
    exact = f"{suffixed}-{zlib.crc32(os.fsencode(real_path(path))):08x}"
    return [as_stem(name) for name in (suffixed, *longer, exact)]


def read_image(path: str | Path, limits: LimitsConfig = DEFAULT_LIMITS) -> NDArray[np.uint8]:
    """Picture (H, W, 3), BGR, 8 bit, turned as its EXIF orientation says.

    Grey pictures are repeated to three channels, transparency is dropped, 10 to 16 bits are scaled to 8.

    Raises
    ------
    InputError
        Missing, a folder, empty, truncated, no picture, too small or too large; one line with the mend.
    """
    return decode_picture(path, read_picture_bytes(path, limits=limits))


def decode_picture(path: str | Path, content: bytes) -> NDArray[np.uint8]:
    """The picture of :func:`read_image` from the content of its file; ``path`` is for messages.

    Raises
    ------
    InputError
        As :func:`read_image`.
    """
    decoded = decode(path, content, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    return as_bgr(decoded, str(path))


def read_picture_bytes(path: str | Path, min_side: int = MIN_SIDE, limits: LimitsConfig = DEFAULT_LIMITS) -> bytes:
    """Content of a picture file whose header was found sound.

    Raises
    ------
    InputError
        As :func:`read_image`.
    """
    content = read_file(path, limits.max_bytes, suggest_limit("max_bytes"))
    require_picture(path, content, min_side, limits)
    return content


def require_picture(
    path: str | Path, content: bytes, min_side: int = MIN_SIDE, limits: LimitsConfig = DEFAULT_LIMITS
) -> None:
    """See by its header that the content of a file is a sound picture; ``path`` is for messages.

    Raises
    ------
    InputError
        As :func:`read_image`.
    """
    if not content:
        raise InputError(f"{path}: is empty (0 bytes); copy or export it again")
    header = read_header(content)
    if header is None:
        raise InputError(f"{path}: is no JPEG, PNG, BMP, TIFF or WebP picture; convert it to one of them")
    size = f"{header.width} x {header.height}"
    if header.decoded_bytes > limits.max_decoded_bytes:
        decoded = f"{size} pixels of {header.bits} bit, {size_in_words(header.decoded_bytes)} once decoded"
        limit = f"more than {limits.max_pixels / 1e6:g} million of 8 bit"
        mend = suggest_limit("max_pixels", limits.pixels_of(header.decoded_bytes))
        raise InputError(f"{path}: has {decoded}, {limit}; {mend}")
    if min(header.width, header.height) < min_side:
        raise InputError(f"{path}: has only {size} pixels; at least {min_side} on each side are needed")
    if header.truncated:
        raise InputError(f"{path}: is truncated: the {header.format} file ends early; copy or export it again")


def decode(path: str | Path, content: bytes, flags: int) -> NDArray[Any]:
    """Decoded picture of whatever depth and channels the flags leave.

    Raises
    ------
    InputError
        The file is damaged.
    """
    try:
        decoded = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), flags)
    except cv2.error as error:
        raise InputError(f"{path}: is damaged: {' '.join(str(error.err).split())}; copy or export it again") from error
    if decoded is None:
        raise InputError(f"{path}: is damaged or of an unknown variant; copy or export it again")
    return np.asarray(decoded)


def as_bgr(image: NDArray[Any], name: str) -> NDArray[np.uint8]:
    """Array (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) of 8 or 16 bit as BGR (H, W, 3) of 8 bit.

    Raises
    ------
    InputError
        Another shape or type, or smaller than :data:`MIN_SIDE`.
    """
    if image.ndim == 2:
        image = image[:, :, None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4):
        raise InputError(f"{name}: has shape {image.shape}; wanted (H, W), (H, W, 3) or (H, W, 4)")
    if min(image.shape[:2]) < MIN_SIDE:
        raise InputError(
            f"{name}: has only {image.shape[1]} x {image.shape[0]} pixels; at least {MIN_SIDE} on each side are needed"
        )
    if image.dtype.kind == "u" and image.dtype.itemsize == 2:
        image = _scale_to_8_bit(image.astype(np.uint16, copy=False))
    if image.dtype != np.uint8:
        raise InputError(f"{name}: has {image.dtype} values; convert it to 8 or 16 bit")
    channels = image[:, :, :3] if image.shape[2] >= 3 else np.repeat(image, 3, axis=2)
    return np.ascontiguousarray(channels, dtype=np.uint8)


def _scale_to_8_bit(image: NDArray[np.uint16]) -> NDArray[np.uint8]:
    # cameras store 10, 12 or 14 bits in files of 16
    top = int(image.max(initial=0))
    full = next(limit for limit in (255, 1023, 4095, 16383, 65535) if top <= limit)
    return np.asarray(cv2.convertScaleAbs(image, alpha=255.0 / full), np.uint8).reshape(image.shape)


def write_image(path: Path, image: NDArray[np.uint8], jpeg_quality: int = 90) -> None:
    """Write a BGR picture in the format of its suffix, whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if path.suffix.lower() in (".jpg", ".jpeg") else []
    encoded, content = cv2.imencode(path.suffix, image, options)
    if not encoded:
        raise InputError(f"{path}: cannot be written as {path.suffix}")
    write_atomic(path, content.tobytes())


def distinct_names(names: Sequence[str]) -> list[str]:
    """The names, fit to be those of files, and those that are not the first of their kind (or empty) numbered."""
    taken: set[str] = set()
    last: dict[str, int] = {}
    found = []
    for name in map(as_stem, names):
        candidate, number = name, last.get(name, 1)
        while candidate.casefold() in taken:
            number += 1
            candidate = f"{name}-{number}"
        last[name] = number
        taken.add(candidate.casefold())
        found.append(candidate)
    return found


def natural_order(text: str) -> list[tuple[int, str]]:
    """Key that puts ``f2`` before ``f10``."""
    return [(int(part), "") if part.isdigit() and part.isascii() else (-1, part) for part in _DIGITS.split(text)]
