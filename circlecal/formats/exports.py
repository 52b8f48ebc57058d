"""Outside formats of a whole run: those with a file per frame are written at once, those with one of all at the end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from circlecal.errors import InputError
from circlecal.field import Circle, FieldTemplate
from circlecal.formats.calibrated import CalibratedFrame, calibrated_frame
from circlecal.formats.checked import Size
from circlecal.formats.exchange import TARGETS, write_calibrations
from circlecal.formats.inputs import FrameOfFile
from circlecal.formats.shapes import AnnotatedFrame, ObservedFrame
from circlecal.records.record import StoredResult, stored_result
from circlecal.results import Calibration

COLLECTIVE = ("broadtrack", "tvcalib", "coco", "cvat", "labelstudio")


class Exports:
    """What a run writes beside its result files.

    Parameters
    ----------
    targets : sequence of str
        Names of formats.
    folder : path
        Where.
    size : (int, int), optional
        Size of the pictures in which the written cameras count; each frame's own when None.

    Raises
    ------
    InputError
        An unknown format.
    """

    def __init__(self, targets: Sequence[str], folder: Path, size: Size | None = None) -> None:
        unknown = [name for name in targets if name not in TARGETS]
        if unknown:
            raise InputError(f"--to {unknown[0]}: is no format that can be written; known: {', '.join(TARGETS)}")
        self._targets = tuple(dict.fromkeys(targets))
        self._folder = folder
        self._size = size
        self._accepted: list[CalibratedFrame] = []
        self._refused: list[AnnotatedFrame] = []

    def add(
        self,
        calibration: Calibration | StoredResult,
        template: FieldTemplate,
        circle: Circle,
        image: str | None = None,
        observed: ObservedFrame | None = None,
    ) -> list[Path]:
        """Take a frame; return the files that were written for it alone.

        Parameters
        ----------
        calibration : Calibration or StoredResult
            Accepted or refused.
        template, circle : FieldTemplate, Circle
            The field in the convention in which the frame was calibrated, and its circle.
        image : str, optional
            Name of the picture.
        observed : ObservedFrame, optional
            What was read of it, where it came from a file.

        Raises
        ------
        InputError
            A file cannot be written.
        """
        if not self._targets:
            return []
        frame = calibrated_frame(calibration, template, circle, image)
        if frame is None:
            self._refused.append(AnnotatedFrame(calibration.id, calibration.width, calibration.height, (), image))
            return []
        self._accepted.append(frame)
        originals = {} if observed is None else {frame.id: observed}
        written: list[Path] = []
        for name in self._targets:
            if name not in COLLECTIVE:
                written += write_calibrations([frame], name, self._folder, self._size, originals=originals)
        return written

    def finish(self) -> list[Path]:
        """Write the files that hold all frames.

        Raises
        ------
        InputError
            A file cannot be written.
        """
        written: list[Path] = []
        for name in self._targets:
            if name in COLLECTIVE and (self._accepted or self._refused):
                written += write_calibrations(self._accepted, name, self._folder, self._size, self._refused)
        return written


def export_records(
    records: Iterable[Mapping[str, Any]],
    exports: Exports,
    template: FieldTemplate,
    circle: Circle,
    annotated: Mapping[str, FrameOfFile],
    annotated_template: FieldTemplate,
) -> list[Path]:
    """Write the frames of a finished batch in outside formats.

    Parameters
    ----------
    records : iterable of mapping
        Lines of ``results.jsonl``.
    exports : Exports
        What to write; finished here.
    template, circle : FieldTemplate, Circle
        As for :meth:`Exports.add`.
    annotated : mapping
        By frame id, where frames came from annotation files.
    annotated_template : FieldTemplate
        The field in the convention of these.

    Raises
    ------
    InputError
        A record is damaged, or a file cannot be written.
    """
    written: list[Path] = []
    for record in records:
        if record.get("image") is None:  # never read
            continue
        result = stored_result(record, str(record["id"]))
        frame = annotated.get(result.id)
        if frame is not None:
            written += exports.add(result, annotated_template, circle, frame.image, frame.observed)
        else:
            written += exports.add(result, template, circle, _picture_name(record))
    return written + exports.finish()


def _picture_name(record: Mapping[str, Any]) -> str | None:
    """Name of a frame's picture; one of a video is named by its id."""
    source = record.get("source") or {}
    if source.get("time_s") is not None:
        return f"{record['id']}.jpg"
    return str(source["path"]).replace("\\", "/").rpartition("/")[2] if source.get("path") else None
