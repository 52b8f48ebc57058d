"""Calibrations, annotations and cameras written in outside formats: of a whole run, and converted from files."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from circlecal.errors import ConfigError, InputError
from circlecal.field import Circle, FieldTemplate, load_field
from circlecal.files import real_path, remove_file, write_atomic
from circlecal.formats.annotation import draw_measured
from circlecal.formats.cameras import CalibratedFrame, CameraFrame, Size, as_size
from circlecal.formats.format import AnnotationFormat, CameraFormat
from circlecal.formats.inputs import FrameOfFile
from circlecal.formats.meaning import SourcesConfig, observe, sure_shapes, understand
from circlecal.formats.paint_list import change_list
from circlecal.formats.registry import (
    RESULT,
    annotation_formats,
    calibration_formats,
    camera_formats,
    open_file,
    parse_annotations,
    require_format,
)
from circlecal.formats.shapes import AnnotatedFrame, ObservedFrame
from circlecal.names import as_stem, picture_name
from circlecal.pictures.files import distinct_names
from circlecal.records.json_text import read_result
from circlecal.records.log import is_log, read_records
from circlecal.records.record import ResultRecord

TOLD_LOSS_PX = 0.5
"""By so many pixels a written homography must leave a lens to be told: less is what an estimated lens of a picture
without any costs (0.2 px), and cannot be seen.
"""
F = TypeVar("F", AnnotatedFrame, CameraFrame)
_log = logging.getLogger(__name__)


def require_field(targets: Sequence[str], template: FieldTemplate) -> None:
    """Tell before the first frame that a format has no names for a field.

    Raises
    ------
    InputError
        A format of ``targets`` takes no such field.
    """
    for name in targets:
        found = calibration_formats().get(name)
        if found is not None and found.requires is not None:
            found.requires(template)


class Exports:
    """What a run writes beside its result files: formats with a file per frame at once, the others at the end.

    Parameters
    ----------
    targets : sequence of str
        Names of formats.
    folder : path
        Where.
    size : (int, int), optional
        Size of the pictures in which the written cameras count; each frame's own when None.

    Attributes
    ----------
    written : list of Path
        All files so far.

    Raises
    ------
    InputError
        An unknown format, or a size that is none.
    """

    def __init__(self, targets: Sequence[str], folder: Path, size: Size | None = None) -> None:
        known = calibration_formats()
        for name in targets:
            require_format(name, known, "--to", "format that can be written")
        self._targets = tuple(known[name] for name in dict.fromkeys(targets))
        self._folder = folder
        self._size = None if size is None else as_size(size)
        self._cameras: dict[str, list[CameraFrame]] = defaultdict(list)
        self._shapes: dict[str, list[AnnotatedFrame]] = defaultdict(list)
        self._refused: list[AnnotatedFrame] = []
        self._losses: dict[str, list[tuple[float, str]]] = defaultdict(list)
        self.written: list[Path] = []

    def require_apart(self, ids: Iterable[str]) -> None:
        """See that no file of another program has the name of a frame's own result in the folder, ``<id>.json``.

        Raises
        ------
        InputError
            One has.
        """
        results = {f"{as_stem(frame_id)}.json".casefold(): frame_id for frame_id in ids}
        for frame_id in results.values():
            for form in self._targets:
                for path in _files_of(form, frame_id, self._folder):
                    if path.name.casefold() in results:
                        raise InputError(
                            f"{path}: would hold the result of {results[path.name.casefold()]}, and what --to "
                            f"{form.name} writes of {frame_id}; rename the picture, or use one --out for each"
                        )

    def add(
        self,
        record: ResultRecord,
        template: FieldTemplate,
        circle: Circle,
        image: str | None = None,
        observed: ObservedFrame | None = None,
    ) -> None:
        """Take a frame, and write its own files.

        Parameters
        ----------
        record : ResultRecord
            Of a frame that was accepted or refused.
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
            return
        frame = CalibratedFrame.of(record, template, circle, image)
        if frame is None:
            self._add_refusal(draw_measured(record, image))
            return
        for target in self._targets:
            if isinstance(target, CameraFormat):
                camera = frame.reduce(target.holds, self._size)
                self._cameras[target.name].append(camera)
                self._losses[target.name].append((camera.loss_px, camera.id))
            elif target.derive is not None:
                self._shapes[target.name].append(target.derive(frame, observed.original if observed else None))
            if target.per_frame:
                self._write(target)

    def _add_refusal(self, measured: AnnotatedFrame) -> None:
        """Take a refused frame with what was measured in it, for people to go on from; what an earlier run wrote of its
        calibration is gone.
        """
        self._refused.append(measured)
        for form in self._targets:
            if form.per_frame:
                remove_file(_files_of(form, measured.id, self._folder)[0])
        # a format of cameras has an annotation of the same name that goes with it, or none
        own = [annotation_formats().get(t.name) if isinstance(t, CameraFormat) else t for t in self._targets]
        for target in own if measured.shapes else ():
            if target is not None and target.per_frame and target.draws_measured:
                self._write_shapes([measured], target)

    def finish(self) -> None:
        """Write the files that hold all frames; those that list their pictures list the refused ones too.

        Raises
        ------
        InputError
            A file cannot be written.
        """
        any_frame = bool(self._cameras or self._shapes or self._refused)
        for target in self._targets:
            if any_frame and not target.per_frame:
                self._write(target)
        for name, losses in self._losses.items():
            _note_lost_lenses(losses, name)
        self._losses.clear()

    def _write(self, target: AnnotationFormat | CameraFormat) -> None:
        if isinstance(target, CameraFormat):
            frames = self._cameras.pop(target.name, []) + (self._without_camera() if target.lists_refused else [])
            ordered = frames if target.per_frame else sorted(frames, key=lambda frame: frame.id)
            self.written += _write(_camera_files(ordered, target, self._folder))
            return
        shapes = self._shapes.pop(target.name, []) + ([] if target.per_frame else self._refused)
        self._write_shapes(sorted(shapes, key=lambda frame: frame.id), target)

    def _without_camera(self) -> list[CameraFrame]:
        """The refused frames, at the size of the pictures in which cameras count."""
        return [
            CameraFrame(frame.id, *(self._size or (frame.width, frame.height)), image=frame.image)
            for frame in self._refused
        ]

    def _write_shapes(self, shapes: Sequence[AnnotatedFrame], target: AnnotationFormat) -> None:
        """Write annotations, in names that differ from those of the result files beside them, ``<id>.json``."""
        contents = _annotation_files(shapes, target, self._folder, _tag(target))
        self.written += _write(contents)
        _write(_list_on_paint(shapes, contents, target, self._folder))


def export_records(
    records: Iterable[ResultRecord],
    exports: Exports,
    template: FieldTemplate,
    annotated: Mapping[str, FrameOfFile],
    annotated_template: FieldTemplate,
    load_told: Callable[[str], FieldTemplate] = load_field,
) -> None:
    """Write the frames of a finished batch in outside formats.

    Parameters
    ----------
    records : iterable of ResultRecord
        Of the run.
    exports : Exports
        What to write; finished here.
    template : FieldTemplate
        As for :meth:`Exports.add`; of frames that told their field themselves it is that.
    annotated : mapping
        By frame id, where frames came from annotation files.
    annotated_template : FieldTemplate
        The field in the convention of those whose files do not tell it.
    load_told : callable
        The template of the name by which a frame told its field; one of the package where it is not given.

    Raises
    ------
    InputError
        A record is damaged, or a file cannot be written.
    """
    for record in records:
        if record.image is None:  # never read
            continue
        frame = annotated.get(record.id)
        is_official = frame is not None and not frame.observed.on_paint
        field = field_of_record(record, annotated_template if is_official else template, load_told)
        if frame is not None:
            exports.add(record, *field, frame.image, frame.observed)
        else:
            exports.add(record, *field, _picture_name(record))
    exports.finish()


def field_of_record(
    record: ResultRecord, usual: FieldTemplate, load: Callable[[str], FieldTemplate]
) -> tuple[FieldTemplate, Circle]:
    """The field of a record, and the circle of it that was seen; the usual field where the record names none."""
    own = record.field
    template = usual if own is None or own.template == usual.name else load(own.template)
    seen = None if own is None or own.circle is None else template.circle_by_name.get(own.circle)
    return template, seen or template.circle_by_name[template.default_circle]


def _picture_name(record: ResultRecord) -> str | None:
    return picture_name(record.id, record.path, None if record.source is None else record.source.time_s)


@dataclass(frozen=True, slots=True)
class _Goal:
    """What files are rewritten in.

    Attributes
    ----------
    name : str
        Of the format.
    annotations : AnnotationFormat or None
        Where annotations go; None where the format holds none.
    cameras : CameraFormat or None
        Where cameras go; None where the format holds none.
    template : FieldTemplate
        The field of the cameras.
    size : (int, int) or None
        Size of the pictures where a file has none.
    """

    name: str
    annotations: AnnotationFormat | None
    cameras: CameraFormat | None
    template: FieldTemplate
    size: Size | None


def convert(
    paths: Sequence[Path],
    source: str | None,
    target: str,
    folder: Path,
    template: FieldTemplate,
    size: Size | None = None,
    field: str = "soccer",
    failures: list[InputError] | None = None,
) -> list[Path]:
    """Rewrite files in another format of their kind, and results as cameras; formats of one file get all frames.

    What a format cannot say is left out with a warning. ``field`` names the template, or its file. Where there is a
    list for ``failures``, files that cannot be read are entered there, and the others go on.

    Raises
    ------
    InputError
        Unreadable, there is no way from the one format to the other, or a file would be written over its source.
    """
    goal = _Goal(target, _writable_annotations().get(target), camera_formats().get(target), template, size)
    frames: list[AnnotatedFrame | CameraFrame] = []
    for path in paths:
        try:
            held = _read_frames(path, source, goal)
        except InputError as error:
            if failures is None:
                raise
            failures.append(error)
            continue
        if not any(isinstance(frame, AnnotatedFrame) or frame.is_accepted for frame in held):
            _log.warning("%s: holds no accepted frame; left out", path)
            continue
        frames += held
    if failures and not frames:
        raise failures[0]
    annotations = [frame for frame in frames if isinstance(frame, AnnotatedFrame)]
    cameras = [frame for frame in frames if isinstance(frame, CameraFrame)]
    if annotations and cameras:
        raise InputError(f"{paths[0]}: annotations and cameras together; convert one kind at a time")
    for frame in annotations:
        for warning in frame.warnings:
            _log.warning("%s", warning)
    if goal.annotations and annotations:
        named = _number(annotations) if goal.annotations.holds_confidence else _drop_confidences(_number(annotations))
        told = [replace(frame, field=field) for frame in named]
        contents = _annotation_files(told, goal.annotations, folder)
        for loss in list_losses(told, contents, goal.annotations, template):
            _log.warning("%s", loss)
        contents |= _list_on_paint(told, contents, goal.annotations, folder)
    elif goal.cameras and cameras:
        contents = _camera_files(_number(cameras), goal.cameras, folder)
        _note_lost_lenses([(camera.loss_px, camera.id) for camera in cameras], goal.name)
    else:
        raise InputError(f"{paths[0]}: holds no accepted frame; nothing to convert")
    _require_apart(contents, paths)
    return _write(contents)


def _drop_confidences(frames: Sequence[AnnotatedFrame]) -> list[AnnotatedFrame]:
    """The frames for a format that knows no confidences: without detections that are too doubtful to be used, or that
    were computed from others.
    """
    kept, doubtful = [], 0
    for frame in frames:
        shapes = sure_shapes(frame, SourcesConfig())
        doubtful += len(frame.shapes) - len(shapes)
        kept.append(replace(frame, shapes=shapes))
    if any(shape.confidence is not None for frame in frames for shape in frame.shapes):
        _log.warning("confidences cannot be said; %d doubtful or computed detections are left out", doubtful)
    return kept


def list_losses(
    frames: Sequence[AnnotatedFrame], contents: Mapping[Path, bytes], target: AnnotationFormat, template: FieldTemplate
) -> list[str]:
    """Which markings, edges and points of the field are in frames, and not in the files that were made of them, one
    line each.
    """
    losses = []
    sizes = [(frame.width, frame.height) for frame in frames]
    files = zip(contents.items(), sizes, strict=False)
    again = [read for (path, content), size in files for read in target.read(path, content, size)]
    for frame, read in zip(frames, again, strict=False):
        said, kept = (_say_what(seen, template, target) for seen in (frame, read))
        lost = sorted(words for what, words in said.items() if what not in kept)
        if lost:
            losses.append(f"{frame.id}: {target.name} cannot say {', '.join(lost)}; left out")
        drawn = ", ".join(sorted(_say_edges(frame) - _say_edges(read)))
        if drawn:
            losses.append(f"{frame.id}: {target.name} cannot say {drawn}; drawn as the middle of the paint")
    return losses


def _say_edges(frame: AnnotatedFrame) -> set[str]:
    """The edges of circular markings on which points of a frame lie, in words."""
    circles = () if frame.observations is None else frame.observations.circles
    return {f"the {circle.edge} edge of {circle.circle}" for circle in circles if circle.edge != "center"}


def _say_what(frame: AnnotatedFrame, template: FieldTemplate, target: AnnotationFormat) -> dict[object, str]:
    """Names of the markings and points of the field that a frame shows, points by their place: formats name them
    differently.
    """
    seen = observe(frame, template, SourcesConfig(), target.name, frame.id).observations
    markings = {*(c.circle for c in seen.circles), *(m.mark for m in seen.marks)}
    markings |= {line.line for line in seen.lines if line.line is not None}
    told: dict[object, str] = {name: name for name in markings}
    return told | {tuple(np.round(point.field_m, 2).tolist()): point.name for point in seen.keypoints}


def _read_frames(path: Path, source: str | None, goal: _Goal) -> Sequence[AnnotatedFrame | CameraFrame]:
    """The frames of a file in the format ``source``, or what its content looks like: annotations or cameras."""
    if is_log(path):
        if goal.cameras is None:
            raise InputError(f"{path}: there is no way from a {RESULT.name} {RESULT.kind} to {goal.name}; {_pairs()}")
        records = read_records(path)
        held = [camera for record in records for camera in _cameras_of_record(record, goal.cameras, goal.template)]
        return sorted(held, key=lambda frame: frame.id)
    found, content = open_file(path, source)
    if isinstance(found, AnnotationFormat) and goal.annotations:
        return parse_annotations(found, content, goal.size)
    if isinstance(found, CameraFormat) and goal.cameras:
        cameras = found.read(path, content.raw, goal.size)
        return [_reduce(path, camera, goal.cameras, goal.template) for camera in cameras]
    if found is RESULT and goal.cameras:
        return _cameras_of_record(read_result(path), goal.cameras, goal.template)
    raise InputError(f"{path}: there is no way from a {found.name} {found.kind} to {goal.name}; {_pairs()}")


def _require_apart(written: Iterable[Path], sources: Sequence[Path]) -> None:
    """No file would be written over one that it is made from.

    Raises
    ------
    InputError
        One would.
    """
    places = {real_path(path) for path in sources}
    over = next((path for path in written if real_path(path) in places), None)
    if over is not None:
        raise InputError(f"{over}: would be written over what it is made from; choose another --out")


def conversion_formats() -> dict[str, AnnotationFormat | CameraFormat]:
    """Formats that :func:`convert` writes, by name."""
    return {**_writable_annotations(), **camera_formats()}


def _writable_annotations() -> dict[str, AnnotationFormat]:
    return {name: found for name, found in annotation_formats().items() if found.write is not None}


def _reduce(path: Path, frame: CameraFrame, target: CameraFormat, template: FieldTemplate) -> CameraFrame:
    """A camera of a file as a format holds it; an error names the file."""
    try:
        shown = frame.with_square_pixels() if target.holds == "centred camera" else frame
        return shown.reduce(target.holds, template)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _cameras_of_record(record: ResultRecord, target: CameraFormat, template: FieldTemplate) -> list[CameraFrame]:
    """The camera of a record as a format holds it; of a refused frame none, or a frame without a camera where the
    format lists these.

    Raises
    ------
    InputError
        The format cannot say the record's own field.
    """
    template, circle = field_of_record(record, template, partial(_load_own, record, template))
    if target.requires is not None:
        try:
            target.requires(template)
        except InputError as error:
            raise InputError(f"{record.id}: {error}") from error
    stored = CalibratedFrame.of(record, template, circle)
    if stored is not None:
        return [replace(stored, image=_picture_name(record)).reduce(target.holds)]
    if record.image is None or not target.lists_refused:
        return []
    return [CameraFrame(record.id, record.width, record.height, image=_picture_name(record))]


def _load_own(record: ResultRecord, usual: FieldTemplate, name: str) -> FieldTemplate:
    """The field that a record names, with its sizes; the usual one where its file is gone."""
    try:
        return load_field(name, None if record.field is None else record.field.sizes)
    except ConfigError:
        return usual


def _number(frames: Sequence[F]) -> list[F]:
    """The frames with ids that no two of them share."""
    ids = distinct_names([frame.id for frame in frames])
    return [replace(frame, id=name) for frame, name in zip(frames, ids, strict=True)]


def _pairs() -> str:
    annotations, cameras = (", ".join(sorted(known)) for known in (_writable_annotations(), camera_formats()))
    return (
        f"annotations go to and from {annotations}, cameras to and from {cameras}, "
        "and pictures or annotations become cameras with circlecal calibrate --to"
    )


def _annotation_files(
    frames: Sequence[AnnotatedFrame], target: AnnotationFormat, folder: Path, tag: str = ""
) -> dict[Path, bytes]:
    """Content by path; ``tag`` follows the id in the names of files of one frame."""
    if target.write is None:
        return {}
    if target.writes_observations:
        frames = [understand(frame, target.name) for frame in frames]
    if not target.per_frame:
        return {folder / target.file_name: target.write(frames)}
    return {_path_of(target, frame.id, folder, tag): target.write([frame]) for frame in frames}


def _list_on_paint(
    frames: Sequence[AnnotatedFrame], contents: Mapping[Path, bytes], target: AnnotationFormat, folder: Path
) -> dict[Path, bytes]:
    """The list of those of a format's files whose points lie on the middle of the paint, where they cannot say it."""
    if target.holds_convention or not target.per_frame:
        return {}
    on_paint = [path for path, frame in zip(contents, frames, strict=True) if frame.on_paint]
    return change_list(folder, list(contents), on_paint)


def _camera_files(frames: Sequence[CameraFrame], target: CameraFormat, folder: Path) -> dict[Path, bytes]:
    """Content by path; says so where the cameras of stretched pictures become others."""
    stretched = next((frame for frame in frames if frame.is_stretched), None)
    if stretched is not None:
        _log.warning(
            "%s: %s cannot say that pixels are not square; the nearest cameras with square ones are written, and only "
            "those for pictures of the shape that is shown (--eval-size of calibrate, batch and track) are the same",
            stretched.id,
            target.name,
        )
    if not target.per_frame:
        return {folder / target.file_name: target.write(frames)}
    return {_path_of(target, frame.id, folder): target.write([frame]) for frame in frames}


def _note_lost_lenses(losses: Iterable[tuple[float, str]], target: str) -> None:
    """Say once of all frames (pixels and id of each) that a format holds no lens, and what that costs."""
    lossy = sorted(loss for loss in losses if loss[0] >= TOLD_LOSS_PX)
    if lossy:
        largest_px, name = lossy[-1]
        of_all = f"; of {len(lossy)} frames {lossy[(len(lossy) - 1) // 2][0]:.1f} in the middle" if lossy[1:] else ""
        _log.warning(
            "%s: %s holds no lens; the homography nearest to it is written, and the field in view lies up to %.1f "
            "pixels beside where the picture shows it%s",
            name,
            target,
            largest_px,
            of_all,
        )


def _tag(target: AnnotationFormat) -> str:
    """What follows the id in the names of annotations beside result files, which are ``<id>.json`` too."""
    return f".{target.name}"


def _path_of(target: AnnotationFormat | CameraFormat, frame_id: str, folder: Path, tag: str = "") -> Path:
    """File of a frame in a format of one file for each; ``tag`` follows the id in its name."""
    return folder / target.file_name.format(id=f"{as_stem(frame_id)}{tag}")


def _files_of(form: AnnotationFormat | CameraFormat, frame_id: str, folder: Path) -> list[Path]:
    """What a format may write of a frame beside its result: the file of its calibration, and of a frame that is refused
    the one of what was measured.
    """
    if not form.per_frame:
        return [folder / form.file_name]
    if isinstance(form, AnnotationFormat):
        return [_path_of(form, frame_id, folder, _tag(form))]
    measured = annotation_formats().get(form.name)
    of_refused = [] if measured is None else [_path_of(measured, frame_id, folder, _tag(measured))]
    return [_path_of(form, frame_id, folder), *of_refused]


def _write(contents: dict[Path, bytes]) -> list[Path]:
    for path, content in contents.items():
        write_atomic(path, content)
    return list(contents)
