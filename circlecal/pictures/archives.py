"""ZIP archives of pictures and annotations, unpacked with nothing outside their folder and nothing beyond a limit."""

from __future__ import annotations

import lzma
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from circlecal.errors import InputError
from circlecal.files import size_in_words, write_atomic

SUFFIX = ".zip"
MAGIC = b"PK"
MOST_FILES = 100_000
MOST_BYTES = 8 << 30
"""Of everything that is unpacked: 10,000 pictures of 1080p have some 5 GB."""
_NOT_FRAMES = "__MACOSX"
"""Folder of the companions that a Mac adds to every file."""
_BLOCK_BYTES = 1 << 20
_LEADS_OUT = re.compile(r"^[/\\]|^[A-Za-z]:|(^|[/\\])\.\.([/\\]|$)")
_BROKEN = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, lzma.LZMAError),
    *(NotImplementedError, EOFError, OSError, ValueError),
)


@dataclass(frozen=True, slots=True)
class Unpacked:
    """What was taken of an archive.

    Attributes
    ----------
    files : list of Path
        As they were written.
    others : list of PurePosixPath
        Paths in the archive of what was not wanted.
    led_out : list of str
        Names of wanted files that would have led out of the folder; they lie in it without that part of their names.
    """

    files: list[Path]
    others: list[PurePosixPath]
    led_out: list[str]

    def warnings(self, name: str) -> list[str]:
        """What a person should know of the archive of this name, a line each."""
        if not self.led_out:
            return []
        more = f" and {len(self.led_out) - 1} more" if len(self.led_out) > 1 else ""
        return [f"{name}: the path {self.led_out[0]}{more} leads out of the archive; its file is kept inside"]


def unpack(source: Path | IO[bytes], name: str, folder_of: Callable[[PurePosixPath], Path | None]) -> Unpacked:
    """Files of an archive that are wanted, written into folders.

    A file that is there already, with its size and checksum, is not written again.

    Parameters
    ----------
    source : path or binary stream
        The archive.
    name : str
        Of the archive, for errors.
    folder_of : callable
        Where a file goes, by its path in the archive, whose own folders are kept below it; None where it is not wanted.

    Raises
    ------
    InputError
        No archive, damaged, encrypted, or too large.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            members = [info for info in archive.infolist() if not info.is_dir() and _NOT_FRAMES not in info.filename]
            placed = [(info, path := _path_of(info), folder_of(path)) for info in members]
            wanted = [info for info, _, folder in placed if folder is not None]
            total = sum(info.file_size for info in wanted)
            if len(wanted) > MOST_FILES or total > MOST_BYTES:
                most = f"more than the {MOST_FILES} files or {size_in_words(MOST_BYTES)} that are unpacked"
                told = f"holds {len(wanted)} files of {size_in_words(total)}, {most}"
                raise InputError(f"{name}: {told}; unpack it yourself, and give its folder")
            if any(info.flag_bits & 1 for info in wanted):
                raise InputError(f"{name}: is encrypted; unpack it yourself, and give its folder")
            files = [_write(archive, info, folder / path) for info, path, folder in placed if folder is not None]
    except _BROKEN as error:
        raise InputError(f"{name}: is no ZIP archive that can be read: {error}; make it again") from error
    others = [path for _, path, folder in placed if folder is None]
    return Unpacked(files, others, [info.filename for info in wanted if _LEADS_OUT.search(info.filename)])


def _path_of(info: zipfile.ZipInfo) -> PurePosixPath:
    """Path of a file in its archive without what leads out of it."""
    parts = info.filename.replace("\\", "/").split("/")
    safe = [part.replace(":", "_") for part in parts if part not in ("", ".", "..")]
    return PurePosixPath(*safe)


def _write(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> Path:
    if not _is_there(path, info):
        with archive.open(info) as file:
            write_atomic(path, file.read(info.file_size + 1)[: info.file_size])
    return path


def _is_there(path: Path, info: zipfile.ZipInfo) -> bool:
    """Whether a file was unpacked before; an annotation that was changed may have as many bytes as before."""
    if not (path.is_file() and path.stat().st_size == info.file_size):
        return False
    checksum = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            checksum = zlib.crc32(block, checksum)
    return checksum == info.CRC
