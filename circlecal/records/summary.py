"""``summary.csv``: one short row per frame, for spreadsheets and for the table on the terminal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from circlecal.names import as_cell, as_text
from circlecal.records.csv_rows import write_rows
from circlecal.records.parts import CameraRow
from circlecal.records.record import ResultRow
from circlecal.results import Status


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """One row; numbers are None where there is none.

    ``rms_px`` is that of the fitted ellipse's inliers, ``sigma_px`` the largest predicted standard deviation near the
    circle, both in pixels of the picture, which is ``width_px`` wide; ``sigma_1920_px`` is sigma at 1920 px width,
    which alone compares pictures of several sizes; ``time_s`` is the time in the video; position and focal length are
    the camera's, metres and pixels; ``annotation`` is the digest of the annotation that was used, ``mask`` the mask
    beside the picture and its size.
    """

    id: str
    status: Status
    code: str | None
    case: int | None
    rms_px: float | None
    sigma_px: float | None
    time_ms: float | None
    reason: str | None
    time_s: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    height_m: float | None = None
    pan_deg: float | None = None
    tilt_deg: float | None = None
    roll_deg: float | None = None
    focal_px: float | None = None
    annotation: str | None = None
    mask: str | None = None
    width_px: int | None = None
    sigma_1920_px: float | None = None

    @property
    def rms_1920_px(self) -> float | None:
        """``rms_px`` at 1920 px width."""
        return at_usual_width(self.rms_px, self.width_px)


def at_usual_width(length_px: float | None, width_px: int | None) -> float | None:
    """A length in a picture so wide, at 1920 px width; None where one of them is not known."""
    return None if length_px is None or not width_px else length_px * 1920.0 / width_px


def summarise(record: ResultRow) -> FrameSummary:
    """The row of a record."""
    camera, ellipses, timings = record.estimated_camera, record.ellipses, record.timings_ms
    reason, width_px = record.reason, record.picture_width
    sigma_px = None if camera is None else camera.max_sigma_px
    return FrameSummary(
        id=record.id,
        status=record.status,
        code=record.code,
        case=record.case,
        rms_px=None if ellipses is None or ellipses.found is None else ellipses.found.rms_px,
        sigma_px=sigma_px,
        time_ms=timings.get("total", sum(time or 0.0 for time in timings.values())) if timings else None,
        reason=reason and as_text(reason),
        time_s=None if record.source is None else record.source.time_s,
        annotation=record.annotation,
        mask=None if record.source is None else record.source.mask_label,
        width_px=width_px,
        sigma_1920_px=at_usual_width(sigma_px, width_px),
        **_camera_columns(record.camera),
    )


def _camera_columns(camera: CameraRow | None) -> dict[str, float | None]:
    """Of an accepted camera, what its columns hold."""
    if camera is None:
        return {}
    x, y, z = camera.position_meters
    return {
        "x_m": x,
        "y_m": y,
        "height_m": None if z is None else -z,
        "pan_deg": camera.pan_degrees,
        "tilt_deg": camera.tilt_degrees,
        "roll_deg": camera.roll_degrees,
        "focal_px": camera.x_focal_length,
    }


def write_summary(path: Path, rows: Iterable[FrameSummary]) -> None:
    """Write the rows as they come, the file whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    names = [column.name for column in fields(FrameSummary)]
    write_rows(path, names, ([_cell(getattr(row, name)) for name in names] for row in rows))


def _cell(value: Any) -> Any:
    return round(value, 3) if isinstance(value, float) else as_cell(value) if isinstance(value, str) else value
