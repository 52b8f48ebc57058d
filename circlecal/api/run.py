"""Results read back: one file, or those of a run, frame by frame as they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, overload

from circlecal.api.calibration import Calibration
from circlecal.errors import InputError
from circlecal.field import FieldTemplate, load_field
from circlecal.files import exists, is_folder
from circlecal.records.json_text import GIVE_A_RESULT, parse_record, read_result
from circlecal.records.log import RESULTS_NAME, Place, find_results, is_log, read_records, scan_records
from circlecal.records.parquet import table_row
from circlecal.records.record import ResultRecord, ResultRow


class Run(Sequence[Calibration]):
    """The results of a run, in the order in which they were finished; each is read when it is asked for.

    Parameters
    ----------
    path : path
        A ``results.jsonl``, or a folder that holds one, or result files.
    field : path, optional
        Field template, where it is none of those that come with circlecal.

    Attributes
    ----------
    path : Path
        What was opened.
    """

    def __init__(self, path: Path, field: str | Path | None = None) -> None:
        self.path = path
        self._field = field

    @cached_property
    def _places(self) -> dict[str, Place]:
        """Where each frame's result stands; the last one of a frame that was calibrated again."""
        return {row.id: place for place, row in scan_records(self.path, ResultRow)}

    @property
    def ids(self) -> list[str]:
        """Names of the frames."""
        return list(self._places)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._places)

    def __iter__(self) -> Iterator[Calibration]:
        """Every result in order, each read when its turn comes."""
        return (self._read(place) for place in self._places.values())

    @overload
    def __getitem__(self, index: int | str) -> Calibration: ...

    @overload
    def __getitem__(self, index: slice) -> list[Calibration]: ...

    def __getitem__(self, index: int | str | slice) -> Calibration | list[Calibration]:
        """The result at a place in the run, or that of a frame's id, or those of a slice.

        Raises
        ------
        IndexError
            The run has fewer frames.
        KeyError
            The run has no frame of this id.
        InputError
            The results changed or are damaged.
        """
        if isinstance(index, str):
            return self._read(self._places[index])
        places = list(self._places.values())
        return [self._read(place) for place in places[index]] if isinstance(index, slice) else self._read(places[index])

    def _read(self, place: Place) -> Calibration:
        record = parse_record(place.read(), ResultRecord, str(place), GIVE_A_RESULT)
        return Calibration(record, _load_own_field(self._field, record))

    def __contains__(self, frame: object) -> bool:
        """Whether there is a result of a frame's id, or an equal calibration."""
        return frame in self._places if isinstance(frame, str) else super().__contains__(frame)

    def table(self) -> list[dict[str, Any]]:
        """One flat row per frame, for ``pandas.DataFrame``; the columns are those of ``results.parquet``, all explained
        in ``circlecal/formats``.
        """
        return [table_row(record) for record in read_records(self.path)]

    def __repr__(self) -> str:
        return f"Run({str(self.path)!r}, {len(self)} frames)"


def load(path: str | Path, field: str | Path | None = None) -> Calibration | Run:
    """Read a result file, or open the results of a run.

    Parameters
    ----------
    path : path
        ``<id>.json`` as ``circlecal calibrate`` or :meth:`Calibration.save` write it; or a run: its ``results.jsonl``,
        the folder that holds it, or a folder of result files.
    field : path, optional
        Field template, where it is one of the user's own: results keep its name and sizes only, which count for it.

    Returns
    -------
    Calibration or Run
        A run is a sequence of calibrations that reads each when it is asked for. Which of the two it is only the file
        tells; ``isinstance`` tells type checkers.

    Raises
    ------
    InputError
        Missing, no result of circlecal, of a newer version, or damaged.
    ConfigError
        The field template is unusable.
    """
    file = Path(path)
    if field is not None:
        load_field(field)
    if not exists(file):
        raise InputError(f"{file}: no such file or folder; {GIVE_A_RESULT}, or the folder of a run")
    if is_folder(file):
        is_run = find_results(file)[0].name == RESULTS_NAME
        if not is_run and next(scan_records(file, ResultRow), None) is None:
            raise InputError(
                f"{file}: holds no results; give the folder that circlecal batch, track or calibrate wrote"
            )
        return Run(file, field)
    if is_log(file):
        return Run(file, field)
    record = read_result(file)
    return Calibration(record, _load_own_field(field, record))


def _load_own_field(field: str | Path | None, record: ResultRecord) -> FieldTemplate | None:
    """A field of the user's own with the sizes that a result has of it; None where none was given."""
    if field is None:
        return None
    told = {} if record.field is None else record.field.sizes or {}
    known = load_field(field).sizes
    return load_field(field, {name: size for name, size in told.items() if name in known})
