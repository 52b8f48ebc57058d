"""ZIP archives of pictures and annotations, unpacked with nothing outside their folder and nothing beyond a limit."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
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


def unpack(
    source: Path | IO[bytes], name: str, folder: Path, is_wanted: Callable[[PurePosixPath], bool]
) -> tuple[list[Path], int]:
    """Files of an archive that are wanted, written into a folder, and how many others there are.

    A file that is there already in its size is not written again.

    Parameters
    ----------
    source : path or binary stream
        The archive.
    name : str
        Of the archive, for errors.
    folder : path
        Where; the archive's own folders are kept below it.
    is_wanted : callable
        Whether a file is taken, by its path in the archive.

    Raises
    ------
    InputError
        No archive, damaged, encrypted, or too large.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            members = [info for info in archive.infolist() if not info.is_dir() and _NOT_FRAMES not in info.filename]
            wanted = [info for info in members if is_wanted(_path_of(info))]
            total = sum(info.file_size for info in wanted)
            if len(wanted) > MOST_FILES or total > MOST_BYTES:
                raise InputError(f"{name}: holds {len(wanted)} files of {size_in_words(total)}; unpack it yourself")
            if any(info.flag_bits & 1 for info in wanted):
                raise InputError(f"{name}: is encrypted; unpack it yourself")
            return [_write(archive, info, folder) for info in wanted], len(members) - len(wanted)
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, EOFError, OSError, ValueError) as error:
        raise InputError(f"{name}: is no ZIP archive that can be read: {error}") from error


def _path_of(info: zipfile.ZipInfo) -> PurePosixPath:
    """Path of a file in its archive without what leads out of it."""
    parts = info.filename.replace("\\", "/").split("/")
    safe = [part.replace(":", "_") for part in parts if part not in ("", ".", "..")]
    return PurePosixPath(*safe)


def _write(archive: zipfile.ZipFile, info: zipfile.ZipInfo, folder: Path) -> Path:
    path = folder.joinpath(*_path_of(info).parts)
    if not (path.is_file() and path.stat().st_size == info.file_size):
        path.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(info) as file:
            write_atomic(path, file.read(info.file_size + 1)[: info.file_size])
    return path
