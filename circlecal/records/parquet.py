"""``results.parquet``: one row per frame with the numbers of its result, for tables of many frames.

What a cell cannot hold, such as observations and covariances, stays in ``results.jsonl``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from circlecal.errors import MissingExtraError
from circlecal.files import replacement
from circlecal.names import as_text
from circlecal.records.parts import Number
from circlecal.records.record import ResultRecord
from circlecal.records.summary import at_usual_width, summarise

PARQUET_NAME = "results.parquet"
PARQUET_FORMAT = "parquet"
_ROWS_AT_ONCE = 5000

_Read = Callable[[ResultRecord], Any]


def _of(*names: str | int) -> _Read:
    """A value deep inside a record; None where something on the way is not there."""

    def read(record: ResultRecord) -> Any:
        value: Any = record
        for name in names:
            if value is None:
                return None
            value = value[name] if isinstance(name, int) else getattr(value, name)
        return value

    return read


def _matrix(record: ResultRecord) -> list[Number] | None:
    rows = record.H_image_field
    return None if rows is None else [value for row in rows for value in row]


def _sigma_at_usual_width(record: ResultRecord) -> Number:
    return None if record.camera is None else at_usual_width(record.camera.max_sigma_px, record.picture_width)


_COLUMNS: dict[str, tuple[str, _Read]] = {
    "id": ("string", _of("id")),
    "status": ("string", _of("status")),
    "code": ("string", _of("code")),
    "stage": ("string", _of("stage")),
    "reason": ("string", _of("reason")),
    "source": ("string", _of("source", "path")),
    "time_s": ("double", _of("source", "time_s")),
    "width": ("int32", _of("image", "width")),
    "height": ("int32", _of("image", "height")),
    "field": ("string", _of("field", "template")),
    "circle": ("string", _of("field", "circle")),
    "case": ("int8", _of("case")),
    "H_image_field": ("doubles", _matrix),
    "pan_degrees": ("double", _of("camera", "pan_degrees")),
    "tilt_degrees": ("double", _of("camera", "tilt_degrees")),
    "roll_degrees": ("double", _of("camera", "roll_degrees")),
    "position_x_m": ("double", _of("camera", "position_meters", 0)),
    "position_y_m": ("double", _of("camera", "position_meters", 1)),
    "position_z_m": ("double", _of("camera", "position_meters", 2)),
    "position_sigma_x_m": ("double", _of("camera", "position_sigma_m", 0)),
    "position_sigma_y_m": ("double", _of("camera", "position_sigma_m", 1)),
    "position_sigma_z_m": ("double", _of("camera", "position_sigma_m", 2)),
    "focal_x_px": ("double", _of("camera", "x_focal_length")),
    "focal_y_px": ("double", _of("camera", "y_focal_length")),
    "principal_x_px": ("double", _of("camera", "principal_point", 0)),
    "principal_y_px": ("double", _of("camera", "principal_point", 1)),
    "radial_k1": ("double", _of("camera", "radial_distortion", 0)),
    "radial_k2": ("double", _of("camera", "radial_distortion", 1)),
    "crown_m": ("double", _of("camera", "crown_m")),
    "crown_shape": ("string", _of("camera", "crown_shape")),
    "crown_radius_m": ("double", _of("camera", "crown_radius_m")),
    "length_m": ("double", lambda record: record.field_size_m[0]),
    "width_m": ("double", lambda record: record.field_size_m[1]),
    "imaged_center_x_px": ("double", _of("imaged_center", 0)),
    "imaged_center_y_px": ("double", _of("imaged_center", 1)),
    "max_sigma_px": ("double", _of("camera", "max_sigma_px")),
    "max_sigma_1920_px": ("double", _sigma_at_usual_width),
    "max_sigma_m": ("double", _of("camera", "max_sigma_m")),
    "rms_px": ("double", lambda record: summarise(record).rms_px),
    "time_ms": ("double", lambda record: summarise(record).time_ms),
    "seed": ("int64", _of("seed")),
    "version": ("string", _of("version")),
    "config_digest": ("string", _of("config_digest")),
}


def table_row(record: ResultRecord) -> dict[str, Any]:
    """The row of one result, by column."""
    return {name: _cell(read(record)) for name, (_, read) in _COLUMNS.items()}


def _cell(value: Any) -> Any:
    """What Parquet can hold: its texts are UTF-8, which names need not be."""
    return as_text(value) if isinstance(value, str) else value


def require_parquet() -> None:
    """See that the file can be written before a long run.

    Raises
    ------
    MissingExtraError
        No pyarrow.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("pyarrow", "parquet") from error


def write_parquet(records: Iterable[ResultRecord], path: Path) -> Path:
    """Write the records of a batch as a table, whole or not at all; return the file.

    Parameters
    ----------
    records : iterable of ResultRecord
        Of the run; a few thousand are held at a time.
    path : Path
        Where.

    Raises
    ------
    MissingExtraError
        No pyarrow.
    InputError
        The file cannot be written.
    """
    require_parquet()
    import pyarrow
    import pyarrow.parquet

    kinds = {"doubles": pyarrow.list_(pyarrow.float64(), 9)}
    fields = [
        (name, kinds[kind] if kind in kinds else pyarrow.type_for_alias(kind)) for name, (kind, _) in _COLUMNS.items()
    ]
    schema = pyarrow.schema(fields)
    with replacement(path) as temporary, pyarrow.parquet.ParquetWriter(temporary, schema, compression="zstd") as writer:
        for rows in _chunks(records):
            writer.write_table(pyarrow.Table.from_pydict(rows, schema))
    return path


def _chunks(records: Iterable[ResultRecord]) -> Iterator[dict[str, list[Any]]]:
    iterator = iter(records)
    while chunk := list(islice(iterator, _ROWS_AT_ONCE)):
        yield {name: [_cell(read(record)) for record in chunk] for name, (_, read) in _COLUMNS.items()}
