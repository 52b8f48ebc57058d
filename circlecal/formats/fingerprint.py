"""Whether a file or a folder that a run was given is still the same."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from circlecal.errors import InputError

_BLOCK = 1 << 20


def fingerprint(path: Path) -> str:
    """Digest of a file's content, or of the names and sizes of all files in a folder.

    Raises
    ------
    InputError
        It cannot be read.
    """
    digest = hashlib.sha256()
    try:
        if path.is_dir():
            for name, size in sorted(_sizes(path, "")):
                digest.update(f"{name}\0{size}\0".encode(errors="surrogateescape"))
        else:
            with path.open("rb") as file:
                while block := file.read(_BLOCK):
                    digest.update(block)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check its permissions") from error
    return digest.hexdigest()


def _sizes(folder: Path, prefix: str) -> Iterator[tuple[str, int]]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _sizes(Path(entry.path), f"{prefix}{entry.name}/")
            else:
                yield f"{prefix}{entry.name}", entry.stat().st_size
