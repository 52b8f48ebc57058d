"""The results of a run as the report reads them: one short row per frame in memory, the records left on the disk."""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from circlecal.errors import InputError
from circlecal.pictures.files import natural_order
from circlecal.records.log import RESULTS_NAME
from circlecal.records.record import SCHEMA_VERSION
from circlecal.records.summary import summarise

_log = logging.getLogger(__name__)
_MEND = "mend or remove it, or run circlecal batch again"


class FrameRow(BaseModel):
    """What the summary and the list of frames need of one record.

    ``sigma_px`` and ``sigma_m`` are the largest predicted standard deviations near the circle, ``rms_px`` that of the
    fitted ellipse's inliers; None where there is none. ``camera`` and ``alone`` (the verdict before) are those of
    ``circlecal rig``.
    """

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    id: str
    status: Literal["calibrated", "refused"]
    code: str | None
    stage: str | None
    reason: str | None
    case: int | None
    sigma_px: Annotated[float, Field(ge=0)] | None
    sigma_m: Annotated[float, Field(ge=0)] | None
    rms_px: Annotated[float, Field(ge=0)] | None
    time_ms: Annotated[float, Field(ge=0)] | None
    path: str | None
    time_s: float | None
    camera: str | None = None
    alone: Literal["calibrated", "refused"] | None = None

    @property
    def gained(self) -> bool:
        """Whether the frame was refused alone, and accepted with what other frames of its camera know."""
        return self.calibrated and self.alone == "refused"

    @property
    def calibrated(self) -> bool:
        """Whether the frame was accepted."""
        return self.status == "calibrated"


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a record stands: a file, its line (0 for a whole file), and the bytes of it."""

    file: Path
    line: int
    start: int
    length: int

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}" if self.line else str(self.file)


@dataclass(slots=True)
class StoredRun:
    """The results of a folder, in the order of the match.

    Attributes
    ----------
    folder : path
        Where they lie.
    rows : list of FrameRow
        One per frame: pictures by name with numbers in their order, then each video by time.
    written : datetime
        When the newest of the files was written, local time.
    versions, digests, seeds, fields : Counter
        How many records carry each version of circlecal, configuration digest, seed and field template.
    """

    folder: Path
    rows: list[FrameRow]
    written: datetime
    versions: Counter[str]
    digests: Counter[str]
    seeds: Counter[str]
    fields: Counter[str]
    _places: dict[str, _Place] = field(repr=False)

    def record(self, row: FrameRow) -> dict[str, Any]:
        """The whole record of a frame, read from the disk.

        Raises
        ------
        InputError
            The file changed since it was first read.
        """
        place = self._places[row.id]
        try:
            with place.file.open("rb") as file:
                file.seek(place.start)
                record = json.loads(file.read(place.length))
        except (OSError, ValueError) as error:
            raise InputError(f"{place}: changed while the report was written; run it again") from error
        if not isinstance(record, dict) or record.get("id") != row.id:
            raise InputError(f"{place}: changed while the report was written; run it again")
        return record


def read_run(results: Path) -> StoredRun:
    """Rows of a folder written by ``circlecal batch`` or ``calibrate``, or of its ``results.jsonl``.

    Where there is a ``results.jsonl`` it is what counts, else the result files ``<id>.json``. A torn last line, as of a
    run that is still going on, is left out with a warning.

    Raises
    ------
    InputError
        No such folder, nothing in it, or a record that is none: in one line with the file, the line and the mend.
    """
    folder = results.parent if results.is_file() else results
    if not folder.is_dir():
        raise InputError(f"{results}: no such folder; give the --out folder of circlecal batch or calibrate")
    log = results if results.is_file() else folder / RESULTS_NAME
    run = StoredRun(folder, [], datetime.now().astimezone(), Counter(), Counter(), Counter(), Counter(), {})
    try:
        files = [log] if log.is_file() else sorted(folder.glob("*.json"))
        for place, record in _lines(log) if log.is_file() else _files(files):
            _add(run, place, record)
        if files:
            run.written = datetime.fromtimestamp(max(file.stat().st_mtime for file in files)).astimezone()
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}; check its permissions") from error
    if not run.rows:
        where = log if log.is_file() else folder
        raise InputError(f"{where}: holds no results; give the --out folder of circlecal batch or calibrate")
    by_id = {row.id: row for row in run.rows}
    run.rows = sorted(by_id.values(), key=_order)
    return run


def _lines(log: Path) -> Iterator[tuple[_Place, dict[str, Any]]]:
    start = 0
    with log.open("rb") as file:
        for number, line in enumerate(file, start=1):
            place = _Place(log, number, start, len(line))
            start += len(line)
            record = _parsed(line)
            if record is not None and line.endswith(b"\n"):
                yield place, record
            elif line.endswith(b"\n"):
                raise InputError(f"{place}: is no result; {_MEND}")
            else:
                _log.warning("%s: left out the torn last line", log)


def _files(files: Iterable[Path]) -> Iterator[tuple[_Place, dict[str, Any]]]:
    for file in files:
        content = file.read_bytes()
        record = _parsed(content)
        if record is None and content.lstrip().startswith(b"["):
            continue
        if record is None:
            raise InputError(f"{file}: is not JSON; {_MEND}")
        if "schema_version" in record and "status" in record:
            yield _Place(file, 0, 0, len(content)), record


def _parsed(text: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


def _add(run: StoredRun, place: _Place, record: dict[str, Any]) -> None:
    version = record.get("schema_version")
    if version != SCHEMA_VERSION:
        raise InputError(f"{place}: has schema_version {version!r}; this version reads {SCHEMA_VERSION}")
    try:
        row = _row(record)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{place}: is no result: {where}: {first['msg']}; {_MEND}") from error
    except (KeyError, TypeError, AttributeError) as error:
        missing = (
            f"{error.args[0]} is missing" if isinstance(error, KeyError) else f"a field is of the wrong kind ({error})"
        )
        raise InputError(f"{place}: is no result: {missing}; {_MEND}") from error
    run.rows.append(row)
    run._places[row.id] = place
    for counter, key in ((run.versions, "version"), (run.digests, "config_digest"), (run.seeds, "seed")):
        counter[str(record.get(key, "unknown"))] += 1
    run.fields[str((record.get("field") or {}).get("template", "unknown"))] += 1


def _row(record: dict[str, Any]) -> FrameRow:
    summary = summarise(record)
    rejected = record.get("rejected_estimate") or {}
    camera = record.get("camera") or rejected.get("camera") or {}
    source = record.get("source") or {}
    rig = record.get("rig") or {}
    return FrameRow(
        id=summary.id,
        status=summary.status,
        code=summary.code,
        stage=record.get("stage"),
        reason=summary.reason,
        case=summary.case,
        sigma_px=summary.sigma_px,
        sigma_m=camera.get("max_sigma_m"),
        rms_px=summary.rms_px,
        time_ms=summary.time_ms,
        path=source.get("path"),
        time_s=source.get("time_s"),
        camera=rig.get("camera"),
        alone=(rig.get("alone") or {}).get("status"),
    )


def _order(row: FrameRow) -> tuple[str, float, list[tuple[int, str]]]:
    if row.time_s is None:
        return "", 0.0, natural_order(row.id)
    return row.path or "", row.time_s, natural_order(row.id)
