"""Tables as CSV, written row by row."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from circlecal.files import write_atomic_parts

_BLOCK = 1 << 16
"""Characters that are written at once."""


def write_rows(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write rows as they come below their header, the file whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_atomic_parts(path, _lines(header, rows))


def _lines(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> Iterator[bytes]:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow(row)
        if text.tell() > _BLOCK:
            yield text.getvalue().encode("utf-8", "backslashreplace")
            text.seek(0)
            text.truncate()
    yield text.getvalue().encode("utf-8", "backslashreplace")
