"""``cameras.csv``: the camera of every frame of a clip as one row, for spreadsheets and other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from circlecal.names import as_cell
from circlecal.records.csv_rows import write_rows
from circlecal.records.parts import HeadRecord, TrackRecord
from circlecal.records.record import ResultRecord

CAMERAS_NAME = "cameras.csv"
_DIGITS = 9
"""Significant digits: a metre to a nanometre at the size of a stadium."""

_Read = Callable[[ResultRecord], Any]


def _entry(row: int, column: int) -> _Read:
    return lambda record: None if record.H_image_field is None else record.H_image_field[row][column]


def _camera(name: str, place: int | None = None) -> _Read:
    def read(record: ResultRecord) -> Any:
        value = None if record.camera is None else getattr(record.camera, name)
        return value if value is None or place is None else value[place]

    return read


def _size(name: str) -> _Read:
    def read(record: ResultRecord) -> Any:
        size = None if record.camera is None else record.camera.field_size
        return None if size is None else getattr(size, name)

    return read


def _angle_sigma(name: str) -> _Read:
    def read(record: ResultRecord) -> Any:
        told = None if record.camera is None else record.camera.covariance
        return None if told is None or name not in told.parameters else float(np.degrees(told.sigma(name)))

    return read


def _track(name: str) -> _Read:
    return lambda record: None if record.track is None else getattr(record.track, name)


def _head(name: str) -> _Read:
    def read(record: ResultRecord) -> Any:
        head: HeadRecord | None = None if record.track is None else record.track.head
        return None if head is None else getattr(head, name)

    return read


def _carriers(record: ResultRecord) -> str | None:
    track: TrackRecord | None = record.track
    return None if track is None else "+".join(track.carried_by)


COLUMNS: dict[str, _Read] = {
    "id": lambda record: record.id,
    "video": lambda record: record.path,
    "time_s": lambda record: None if record.source is None else record.source.time_s,
    "frame": _track("frame"),
    "status": lambda record: record.status,
    "code": lambda record: record.code,
    "shot": _track("shot"),
    "tripod": lambda record: None if record.rig is None else record.rig.camera,
    "carried_by": _carriers,
    "width_px": lambda record: record.width,
    "height_px": lambda record: record.height,
    "pan_deg": _camera("pan_degrees"),
    "tilt_deg": _camera("tilt_degrees"),
    "roll_deg": _camera("roll_degrees"),
    "pan_sigma_deg": _angle_sigma("pan"),
    "tilt_sigma_deg": _angle_sigma("tilt"),
    "roll_sigma_deg": _angle_sigma("roll"),
    "focal_x_px": _camera("x_focal_length"),
    "focal_y_px": _camera("y_focal_length"),
    "x_m": _camera("position_meters", 0),
    "y_m": _camera("position_meters", 1),
    "z_m": _camera("position_meters", 2),
    "principal_x_px": _camera("principal_point", 0),
    "principal_y_px": _camera("principal_point", 1),
    "radial_k1": _camera("radial_distortion", 0),
    "radial_k2": _camera("radial_distortion", 1),
    "crown_m": _camera("crown_m"),
    "crown_shape": _camera("crown_shape"),
    "crown_radius_m": _camera("crown_radius_m"),
    "length_m": lambda record: record.field_size_m[0],
    "width_m": lambda record: record.field_size_m[1],
    "length_sd_m": _size("length_sd_m"),
    "width_sd_m": _size("width_sd_m"),
    **{f"h{row + 1}{column + 1}": _entry(row, column) for row in range(3) for column in range(3)},
    "head_pan_deg": _head("pan_degrees"),
    "head_tilt_deg": _head("tilt_degrees"),
    "head_pan_sigma_deg": _head("pan_sigma_degrees"),
    "head_tilt_sigma_deg": _head("tilt_sigma_degrees"),
    "log_focal_sigma": _head("log_focal_sigma"),
    "x_sigma_m": _camera("position_sigma_m", 0),
    "y_sigma_m": _camera("position_sigma_m", 1),
    "z_sigma_m": _camera("position_sigma_m", 2),
    "sigma_px": _camera("max_sigma_px"),
    "sigma_m": _camera("max_sigma_m"),
}
"""Name of each column and where its value stands in a record; what a frame does not have is left empty."""


def write_cameras(path: Path, records: Iterable[ResultRecord]) -> None:
    """Write one row for each record as they come, the file whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_rows(path, COLUMNS, ([_cell(read(record)) for read in COLUMNS.values()] for record in records))


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return as_cell(value)
    return f"{value:.{_DIGITS}g}" if isinstance(value, float) else value
