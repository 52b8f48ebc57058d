"""The results of a run as the report reads them: one short row per frame in memory, the records left on the disk."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from circlecal.errors import InputError
from circlecal.files import is_file, is_folder
from circlecal.pictures.files import natural_order
from circlecal.records.json_text import parse_sound_parts
from circlecal.records.log import Place, find_results, scan_records
from circlecal.records.record import ResultRecord, ResultRow
from circlecal.records.summary import summarise
from circlecal.results import Status


@dataclass(frozen=True, slots=True)
class FrameRow:
    """What the summary and the list of frames need of one record.

    ``sigma_px`` and ``sigma_m`` are the largest predicted standard deviations near the circle, ``rms_px`` that of the
    fitted ellipse's inliers, both at 1920 px width, since pictures of a run may differ in size; None where there is
    none. ``camera`` and ``alone`` (the verdict before) are those of
    ``circlecal rig``. ``pan_deg`` and ``focal_px`` are the camera's, None for a refused frame, ``shot`` counts the
    shots of a clip that was tracked, ``position_m`` is where its camera stands: x, y and height, and ``bytes`` was the
    size of the picture's or video's file.
    """

    id: str
    status: Status
    code: str | None
    stage: str | None
    reason: str | None
    case: int | None
    sigma_px: float | None
    sigma_m: float | None
    rms_px: float | None
    time_ms: float | None
    path: str | None
    time_s: float | None
    camera: str | None = None
    alone: Status | None = None
    pan_deg: float | None = None
    focal_px: float | None = None
    shot: int | None = None
    position_m: tuple[float, float, float] | None = None
    bytes: int | None = None

    @property
    def gained(self) -> bool:
        """Whether the frame was refused alone, and accepted with what other frames of its camera know."""
        return self.calibrated and self.alone == "refused"

    @property
    def calibrated(self) -> bool:
        """Whether the frame was accepted."""
        return self.status == "calibrated"

    @property
    def refusal_code(self) -> str | None:
        """Code of the reason for which the frame was refused, ``unknown`` where the record names none; None of an
        accepted frame.
        """
        return None if self.calibrated else self.code or "unknown"


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
    _places: dict[str, Place] = field(repr=False)
    _by_id: dict[str, FrameRow] = field(default_factory=dict, repr=False)

    def row(self, name: str) -> FrameRow | None:
        """The row of a frame, by its id; None where the run does not have it."""
        return self._by_id.get(name)

    def record(self, row: FrameRow) -> ResultRecord:
        """The record of a frame, read from the disk; what is damaged in it is left out.

        Raises
        ------
        InputError
            The file changed since it was first read.
        """
        place = self._places[row.id]
        try:
            record = parse_sound_parts(place.read())
        except (OSError, ValueError) as error:
            raise InputError(f"{place}: changed while the report was written; run it again") from error
        if record.id != row.id:
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
    folder = results.parent if is_file(results) else results
    if not is_folder(folder):
        raise InputError(f"{results}: no such folder; give the folder that circlecal batch, track or calibrate wrote")
    run = StoredRun(folder, [], datetime.now().astimezone(), Counter(), Counter(), Counter(), Counter(), {})
    for place, record in scan_records(results, ResultRow):
        row = _row(record)
        run.rows.append(row)
        run._places[row.id] = place
        for counter, value in (
            (run.versions, record.version),
            (run.digests, record.config_digest),
            (run.seeds, record.seed),
            (run.fields, record.field and record.field.template),
        ):
            counter["unknown" if value is None else str(value)] += 1
    if not run.rows:
        raise InputError(f"{results}: holds no results; give the folder that circlecal batch, track or calibrate wrote")
    newest = max(file.stat().st_mtime for file in find_results(results))
    run.written = datetime.fromtimestamp(newest).astimezone()
    run._by_id.update((row.id, row) for row in run.rows)
    run.rows = sorted(run._by_id.values(), key=_order)
    return run


def _row(record: ResultRow) -> FrameRow:
    summary, camera, source, rig = summarise(record), record.estimated_camera, record.source, record.rig
    accepted, track = record.camera, record.track
    return FrameRow(
        id=summary.id,
        status=summary.status,
        code=summary.code,
        stage=record.stage,
        reason=summary.reason,
        case=summary.case,
        sigma_px=summary.sigma_1920_px,
        sigma_m=None if camera is None else camera.max_sigma_m,
        rms_px=summary.rms_1920_px,
        time_ms=summary.time_ms,
        path=record.path,
        time_s=None if source is None else source.time_s,
        bytes=None if source is None else source.bytes,
        camera=None if rig is None else rig.camera,
        alone=None if rig is None or rig.alone is None else rig.alone.status,
        pan_deg=None if accepted is None else accepted.pan_degrees,
        focal_px=None if accepted is None else accepted.x_focal_length,
        shot=None if track is None else track.shot,
        position_m=None
        if summary.x_m is None or summary.y_m is None or summary.height_m is None
        else (summary.x_m, summary.y_m, summary.height_m),
    )


def _order(row: FrameRow) -> tuple[str, float, list[tuple[int, str]]]:
    if row.time_s is None:
        return "", 0.0, natural_order(row.id)
    return row.path or "", row.time_s, natural_order(row.id)
