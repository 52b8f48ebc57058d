"""Reading ``results.jsonl``, line by line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from circlecal.errors import InputError


def read_records(path: Path) -> Iterator[dict[str, Any]]:
    """Records of a batch in the order in which they were finished; a torn last line of a run that goes on is left out.

    Raises
    ------
    InputError
        The file cannot be read, or a line is no result.
    """
    try:
        with path.open("rb") as file:
            for number, line in enumerate(file, start=1):
                if not line.endswith(b"\n"):
                    return
                try:
                    record = json.loads(line)
                except ValueError as error:
                    raise InputError(f"{path}, line {number}: is no JSON; mend or remove that line") from error
                if not isinstance(record, dict) or not {"id", "status", "schema_version"} <= record.keys():
                    raise InputError(f"{path}, line {number}: is no result of circlecal batch")
                yield record
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror}; give the results.jsonl of circlecal batch"
        ) from error


def is_records(path: Path) -> bool:
    """Whether a file is the ``results.jsonl`` of a batch, by its first line."""
    if path.suffix != ".jsonl":
        return False
    try:
        with path.open("rb") as file:
            record = json.loads(file.readline())
    except (OSError, ValueError):
        return False
    return isinstance(record, dict) and record.keys() >= {"id", "status", "schema_version"}
