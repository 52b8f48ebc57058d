"""Where points lie in files whose format has no place to say it: told by a list beside them.

:data:`LIST_NAME` names the files of its folder, one a line, whose points lie on the middle of the paint; lines that
begin with ``#`` are for people.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Collection, Iterable
from pathlib import Path

from circlecal.errors import InputError
from circlecal.files import is_file, read_file

LIST_NAME = "circlecal-paint.txt"
MOST_BYTES = 16 << 20
"""Of a list: names of 100,000 files have a quarter of it."""
_HEAD = (
    "# Points of the files below lie on the middle of the paint, not at the sizes of the rules: their format has no\n"
    "# place to say so, and circlecal reads it here. Keep this file beside them.\n"
)


def list_bytes(names: Iterable[str]) -> bytes:
    """Content of a list with the names of files."""
    return (_HEAD + "".join(f"{name}\n" for name in sorted(set(names)))).encode("utf-8", "surrogateescape")


def change_list(folder: Path, written: Collection[Path], on_paint: Collection[Path]) -> dict[Path, bytes]:
    """The list of a folder after files were written into it, by its path; nothing where none is or was in it.

    Parameters
    ----------
    folder : path
        Of the files.
    written, on_paint : collection of path
        All that are written, and those of them whose points lie on the middle of the paint.

    Raises
    ------
    InputError
        The folder's list cannot be read.
    """
    path = folder / LIST_NAME
    before = _read_list(path) if is_file(path) else frozenset()
    names = (before - {file.name for file in written}) | {file.name for file in on_paint}
    return {} if names == before else {path: list_bytes(names)}


def is_listed(path: Path) -> bool:
    """Whether a list beside a file names it.

    Raises
    ------
    InputError
        The list cannot be read.
    """
    beside = path.parent / LIST_NAME
    return is_file(beside) and path.name in _read_list(beside)


def _read_list(path: Path) -> frozenset[str]:
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    return _names_in(os.fspath(path), changed)


@functools.lru_cache(maxsize=8)
def _names_in(path: str, changed: int) -> frozenset[str]:
    """Names in a list; ``changed`` is when it was written, so that a folder of many files is read once."""
    text = read_file(Path(path), MOST_BYTES, "write it anew").decode("utf-8", "surrogateescape")
    return frozenset(line for line in text.splitlines() if line and not line.startswith("#"))
