"""Results read back: one file, or the log of a run, frame by frame as they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, overload

from circlecal.api.calibration import Calibration
from circlecal.errors import InputError
from circlecal.field import FieldTemplate, load_field
from circlecal.records.log import RESULTS_NAME, read_records
from circlecal.records.parquet import table_row
from circlecal.records.record import GIVE_A_RESULT, ResultRecord, ResultRow, parse_record, read_result


class Run(Sequence[Calibration]):
    """The results of a run, in the order in which they were finished; each is read when it is asked for.

    Attributes
    ----------
    path : path
        The ``results.jsonl``.
    """

    def __init__(self, path: Path, template: FieldTemplate | None = None) -> None:
        self.path = path
        self._template = template

    @cached_property
    def _lines(self) -> list[tuple[int, int]]:
        """First byte and length of every whole line."""
        lines, start = [], 0
        try:
            with self.path.open("rb") as file:
                for line in file:
                    if line.endswith(b"\n"):
                        lines.append((start, len(line)))
                    start += len(line)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from error
        return lines

    @cached_property
    def _number_by_id(self) -> dict[str, int]:
        return {row.id: number for number, row in enumerate(read_records(self.path, ResultRow))}

    def __len__(self) -> int:
        return len(self._lines)

    def __iter__(self) -> Iterator[Calibration]:
        return (Calibration(record, self._template) for record in read_records(self.path))

    @overload
    def __getitem__(self, index: int | str) -> Calibration: ...

    @overload
    def __getitem__(self, index: slice) -> list[Calibration]: ...

    def __getitem__(self, index: int | str | slice) -> Calibration | list[Calibration]:
        """The result at a place in the log, of a frame's id, or those of a slice."""
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        number = self._number_by_id[index] if isinstance(index, str) else index
        start, length = self._lines[number]
        with self.path.open("rb") as file:
            file.seek(start)
            content = file.read(length)
        return Calibration(parse_record(content, ResultRecord, str(self.path), GIVE_A_RESULT), self._template)

    def __contains__(self, frame: object) -> bool:
        """Whether there is a result of a frame's id, or a calibration."""
        return frame in self._number_by_id if isinstance(frame, str) else super().__contains__(frame)

    def table(self) -> list[dict[str, Any]]:
        """One flat row per frame, for ``pandas.DataFrame``; the columns are those of ``results.parquet``."""
        return [table_row(record) for record in read_records(self.path)]

    def __repr__(self) -> str:
        return f"Run({str(self.path)!r}, {len(self)} frames)"


def load(path: str | Path, field: str | Path | None = None) -> Calibration | Any:
    """Read a result file, or open the results of a run.

    Parameters
    ----------
    path : path
        ``<id>.json`` as ``circlecal calibrate`` or :meth:`Calibration.save` write it, or a run's ``results.jsonl``, or
        the folder of a run.
    field : path, optional
        Field template, where it is one of the user's own: results keep its name and sizes only.

    Returns
    -------
    Calibration or Run
        A run is a sequence of calibrations that reads each when it is asked for.

    Raises
    ------
    InputError
        Missing, no result of circlecal, of a newer version, or damaged.
    ConfigError
        The field template is unusable.
    """
    file = Path(path)
    template = None if field is None else load_field(field)
    if file.is_dir():
        file = file / RESULTS_NAME
    if file.suffix == ".jsonl":
        if not file.is_file():
            raise InputError(f"{file}: no such file; give a result file, a results.jsonl, or the folder of a run")
        return Run(file, template)
    return Calibration(read_result(file), template)
