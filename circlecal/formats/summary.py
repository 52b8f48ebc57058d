"""``summary.csv``: one short row per frame, for spreadsheets and for the table on the terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from circlecal.formats.atomic import write_atomic


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """One row; numbers are None where there is none.

    ``rms_px`` is that of the fitted ellipse's inliers, ``sigma_px`` the largest predicted standard deviation near the
    circle.
    """

    id: str
    status: str
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
    return FrameSummary(
        id=record["id"],
        status=record["status"],
        code=record.get("code"),
        case=record.get("case"),
        rms_px=primary.get("rms_px"),
        sigma_px=camera.get("max_sigma_px"),
        time_ms=timings.get("total", sum(timings.values())) if timings else None,
        reason=record.get("reason"),
    )


def write_summary(path: Path, rows: Mapping[str, FrameSummary]) -> None:
    """Write the rows in the order of their ids, whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    text = io.StringIO()
    names = [column.name for column in fields(FrameSummary)]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for identifier in sorted(rows):
        values = (getattr(rows[identifier], name) for name in names)
        writer.writerow([round(value, 3) if isinstance(value, float) else value for value in values])
    write_atomic(path, text.getvalue().encode())
