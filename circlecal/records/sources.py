"""Whether the file from which a record was made is still the one of its name."""

from __future__ import annotations

from pathlib import Path

from circlecal.files import are_different, file_size, real_path
from circlecal.records.log import START_OVER, OtherRunError
from circlecal.records.parts import SourceRecord


def is_another(before: SourceRecord, path: str | Path) -> bool:
    """Whether a file is not the one of a record.

    Its size tells, or where the record has none, whether the file that the record names is still there and is another
    one. A missing file is not another one.
    """
    now = None if before.bytes is None else file_size(path)
    if now is not None:
        return now != before.bytes
    return before.path is not None and are_different(before.path, path)


def require_own(before: SourceRecord, path: str | Path, folder: Path, held: str) -> None:
    """See that a run goes on with the file from which it holds something, such as frames.

    Raises
    ------
    OtherRunError
        The file was replaced or went on growing, or another one of its name is given.
    """
    if before.path is None or not is_another(before, path):
        return
    is_in_place = real_path(Path(before.path)) == real_path(Path(path))
    told = "which has changed since" if is_in_place else f"which has the name of {path}"
    raise OtherRunError(f"{folder}: holds {held} of {before.path}, {told}; {START_OVER}")
