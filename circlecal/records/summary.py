"""``summary.csv``: one short row per frame, for spreadsheets and for the table on the terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from circlecal.files import write_atomic_parts
from circlecal.results import Status

_BLOCK = 1 << 16


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """One row; numbers are None where there is none.

    ``rms_px`` is that of the fitted ellipse's inliers, ``sigma_px`` the largest predicted standard deviation near the
    circle.
    """

    id: str
    status: Status
    code: str | None
    case: int | None
    rms_px: float | None
    sigma_px: float | None
    time_ms: float | None
    reason: str | None


def summarise(record: Mapping[str, Any]) -> FrameSummary:
    """The row of a result file's content."""
    rejected = record.get("rejected_estimate") or {}
    camera = record.get("camera") or rejected.get("camera") or {}
    ellipses = record.get("ellipses") or {}
    primary = ellipses.get(ellipses.get("primary")) or {}
    timings = record.get("timings_ms") or {}
    reason = record.get("reason")
    return FrameSummary(
        id=record["id"],
        status=record["status"],
        code=record.get("code"),
        case=record.get("case"),
        rms_px=primary.get("rms_px"),
        sigma_px=camera.get("max_sigma_px"),
        time_ms=timings.get("total", sum(timings.values())) if timings else None,
        reason=None
        if reason is None
        else reason.encode("utf-8", "backslashreplace").decode(),  # names need not be text
    )


def write_summary(path: Path, rows: Iterable[FrameSummary]) -> None:
    """Write the rows as they come, the file whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_atomic_parts(path, _lines(rows))


def _lines(rows: Iterable[FrameSummary]) -> Iterator[bytes]:
    names = [column.name for column in fields(FrameSummary)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        values = (getattr(row, name) for name in names)
        writer.writerow([round(value, 3) if isinstance(value, float) else value for value in values])
        if text.tell() > _BLOCK:
            yield text.getvalue().encode()
            text.seek(0)
            text.truncate()
    yield text.getvalue().encode()
