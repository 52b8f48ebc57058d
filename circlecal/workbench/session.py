"""What one server holds: the list of frames, the pictures that are open, and what is done to their annotations."""

from __future__ import annotations

import io
import tempfile
import threading
import zipfile
from collections import Counter, OrderedDict, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.files import write_atomic
from circlecal.formats.annotation import FORMAT as WORKBENCH
from circlecal.formats.annotation import Annotation, annotation_bytes, markings_of, parse_annotation
from circlecal.formats.exports import list_losses
from circlecal.formats.format import AnnotationFormat
from circlecal.formats.meaning import observe
from circlecal.formats.paint_list import LIST_NAME, list_bytes
from circlecal.formats.registry import annotation_formats, read_annotations, require_format
from circlecal.formats.shapes import AnnotatedFrame
from circlecal.formats.unpacking import may_be_annotation
from circlecal.geometry.projective import Array
from circlecal.names import as_stem
from circlecal.pictures.archives import MAGIC, unpack
from circlecal.pipeline import field_of
from circlecal.workbench.answers import Answer, WrongName, answer, describe
from circlecal.workbench.doubts import find_wrong_name
from circlecal.workbench.frames import ArchivedAnnotations, ListedFrame, picture_of, tell_pixels
from circlecal.workbench.interpretations import Interpretation, interpret
from circlecal.workbench.measuring import (
    MeasuredPicture,
    Snapped,
    begin_annotation,
    complete_circle,
    exact_clicks,
    follow_path,
    measure_picture,
    snap_click,
)
from circlecal.workbench.store import AnnotationStore, NewerError

HELD = 12
"""Open pictures that are held, so that going back and forth measures nothing again; 1080p takes about 10 MB each."""
HELD_PIXELS = 50_000_000
"""Pixels of the held pictures together, unless it is one alone: twelve of 1080p have half of that, and twelve of 8000 x
6000 would take 3 GB.
"""
JPEG_QUALITY = 93
MOST_PATH_POINTS = 2000
_ORDER = {"refused": 0, "doubtful": 1, "unknown": 2, "calibrated": 3}
"""Of the states of frames in the list: what is worth a look comes first."""
UNKNOWN_SIZE = (1920, 1080)
"""Size in which a file that tells none is read, until it is known which frame it is of, pixels."""


@dataclass(frozen=True, slots=True)
class OpenFrame:
    """A frame that was opened: its picture with what was measured, and the annotation to begin with."""

    measured: MeasuredPicture
    begun: Annotation


@dataclass(slots=True)
class Taken:
    """What was taken of the files of an import.

    Attributes
    ----------
    taken, unknown, kept : int
        Frames that were taken, that are not listed here, and that somebody annotated here and that stay as they are.
    warnings : list of str
        What was left out, a line each.
    """

    taken: int = 0
    unknown: int = 0
    kept: int = 0
    warnings: list[str] = field(default_factory=list)

    def add(self, other: Taken) -> None:
        """Count what was taken of another file, too."""
        self.taken += other.taken
        self.unknown += other.unknown
        self.kept += other.kept
        self.warnings += other.warnings


@dataclass(frozen=True, slots=True)
class Exported:
    """A file for another program: its name, its content, and why annotations are not in it, a line each."""

    name: str
    content: bytes
    left_out: list[str]


class Session:
    """Frames, annotations and configuration of one server.

    Parameters
    ----------
    frames : sequence of ListedFrame
        What is listed; refused and doubtful ones come first.
    store : AnnotationStore
        Where annotations are saved.
    config : Config
        Options of every stage.
    """

    def __init__(self, frames: Sequence[ListedFrame], store: AnnotationStore, config: Config) -> None:
        self.store = store
        self.config = config
        self._held: OrderedDict[int, OpenFrame] = OrderedDict()
        self._lock = threading.Lock()
        self._opening: defaultdict[int, threading.Lock] = defaultdict(threading.Lock)
        self._search: object = None
        known = store.known()
        listed = [self._take_up(frame) if store.path(frame.file.id).name in known else frame for frame in frames]
        self.frames = sorted(listed, key=lambda frame: _ORDER[frame.state])
        self._by_run = [(frame.state, frame.code, frame.sigma_px) for frame in self.frames]

    def _take_up(self, frame: ListedFrame) -> ListedFrame:
        """The frame with what its annotation says of it; one whose annotation cannot be used is there to be mended."""
        try:
            annotation = self._read_annotation(frame)
        except InputError:
            return replace(frame, state="refused", code="unusable_annotation", annotated=True)
        return frame if annotation is None else replace(frame, annotated=annotation.touched, flag=annotation.flag)

    def _read_annotation(self, frame: ListedFrame) -> Annotation | None:
        """The saved annotation of a frame.

        Raises
        ------
        InputError
            The file is damaged, or of another picture of the same name.
        """
        saved = self.store.read(frame.file.id)
        if saved is not None and saved.is_of_another(frame.file.path):
            raise InputError(
                f"{self.store.path(saved.id)}: is of {saved.source}, not of {frame.file.path}; give another --out"
            )
        return saved

    @property
    def template(self) -> FieldTemplate:
        """The field."""
        return field_of(self.config)[0]

    def listing(self) -> list[list[Any]]:
        """Rows of the list: id, state, code, sigma, time, annotated, flag."""
        return [self._row(index) for index in range(len(self.frames))]

    def open(self, index: int) -> OpenFrame:
        """A frame, measured if it is not held.

        Raises
        ------
        InputError
            No such frame, or its picture cannot be read.
        """
        frame = self._frame(index)
        with self._opening[index]:  # whoever else asks for it waits, instead of measuring it too
            return self._find_held(index) or self._measure(index, frame)

    def _find_held(self, index: int) -> OpenFrame | None:
        with self._lock:
            held = self._held.get(index)
            if held is not None:
                self._held.move_to_end(index)
            return held

    def _measure(self, index: int, frame: ListedFrame) -> OpenFrame:
        limits = self.config.limits
        file, picture = tell_pixels(frame.file, limits), picture_of(frame.file, limits)
        measured = measure_picture(picture, self.config, file)
        held = OpenFrame(measured, begin_annotation(measured, self.config, file))
        with self._lock:
            self._held[index] = held
            while len(self._held) > 1 and (len(self._held) > HELD or self._count_pixels() > HELD_PIXELS):
                self._held.popitem(last=False)
        return held

    def _count_pixels(self) -> int:
        return sum(held.measured.light.size for held in self._held.values())

    def _frame(self, index: int) -> ListedFrame:
        if not 0 <= index < len(self.frames):
            raise InputError(f"there is no frame {index}")
        return self.frames[index]

    def annotation(self, index: int) -> Annotation:
        """What is known of a frame: its saved annotation, or what was measured.

        Raises
        ------
        InputError
            No such frame, its picture cannot be read, or its annotation is damaged or of another picture.
        """
        saved = self._read_annotation(self._frame(index))
        if saved is None:
            return self.open(index).begun
        size = self.open(index).measured.picture.shape
        if (saved.height, saved.width) != size[:2]:
            name = self.store.path(saved.id)
            raise InputError(
                f"{name}: is of a picture of {saved.width} x {saved.height}, not of this one; move it away"
            )
        return saved

    def picture(self, index: int) -> bytes:
        """The picture as JPEG."""
        return _jpeg(self.open(index).measured.picture)

    def show(self, index: int) -> dict[str, Any]:
        """All that the page shows of a frame."""
        self._search = None
        annotation = self.annotation(index)
        return self._show(index, annotation, answer(annotation, self.config, nameless=True))

    def save(self, index: int, annotation: Annotation, base: int) -> dict[str, Any]:
        """Save a changed annotation and calibrate it by what has a name; :meth:`settle` does the rest.

        A frame counts as annotated where its content is another one than what was measured, or it is confirmed.

        Raises
        ------
        NewerError
            It was changed elsewhere.
        InputError
            It is not of this frame, or cannot be written.
        ConfigError
            Its settings are no settings.
        """
        self._search = None
        own = self.open(index).begun
        if (annotation.id, annotation.width, annotation.height) != (own.id, own.width, own.height):
            raise InputError(f"{annotation.id}: is not the annotation of {own.id}")
        told = answer(annotation, self.config, nameless=False)
        touched = annotation.confirmed or not annotation.says_what(own)
        saved = self.store.save(annotation, base, touched=touched)
        return self._show(index, saved, replace(told, annotation=saved))

    def settle(self, index: int) -> dict[str, Any]:
        """The answer with the lines that nobody named recognised too, as a batch gives it."""
        return self.show(index)

    def _show(self, index: int, annotation: Annotation, told: Answer) -> dict[str, Any]:
        frame, camera = self.frames[index], told.found.attempt.camera
        sigma = None if camera is None else camera.max_sigma_px
        judged = frame.with_verdict(told.found.status, told.found.verdict.code, sigma, annotation.width)
        state, code, sigma = self._by_run[index]
        if not annotation.touched and state != "unknown" and _ORDER[judged.state] < _ORDER[state]:
            judged = replace(judged, state=state, code=code, sigma_px=sigma)  # other frames of the run helped this one
        self.frames[index] = replace(judged, annotated=annotation.touched, flag=annotation.flag)
        return {
            "annotation": annotation.model_dump(mode="json"),
            "answer": describe(told),
            "row": self._row(index),
        }

    def _row(self, index: int) -> list[Any]:
        f = self.frames[index]
        return [f.file.id, f.state, f.code, f.sigma_px, f.file.time_s, f.annotated, f.flag]

    def interpretations(self, index: int) -> list[Interpretation] | list[WrongName]:
        """Of a frame that is not calibrated the name that is wrong, or else the best two ways to name what was
        measured; none where something else is asked of the session meanwhile, since the search takes many seconds of
        the processor.
        """
        mine = self._search = object()
        opened, annotation = self.open(index), self.annotation(index)

        def is_wanted() -> bool:
            return self._search is mine

        wrong = find_wrong_name(annotation, opened.begun, self.config, is_wanted=is_wanted)
        if wrong is not None:
            return [wrong]
        return interpret(annotation, opened.measured, self.config, is_wanted=is_wanted) if is_wanted() else []

    def snap(self, index: int, points: Array, mode: str, name: str | None) -> Snapped:
        """Points on paint for a click, a drag or the clicks on a circle.

        Parameters
        ----------
        index : int
            Which frame.
        points : (N, 2) array
            Pixels.
        mode : {"click", "exact", "path", "circle"}
            What was done.
        name : str or None
            The marking that is meant.

        Raises
        ------
        InputError
            Points outside the picture, too many, or no such mode.
        """
        measured = self.open(index).measured
        if not len(points) or len(points) > MOST_PATH_POINTS or not np.isfinite(points).all():
            raise InputError(f"{len(points)} points are not what one clicks")
        if not measured.shows(points).all():
            raise InputError("a point lies outside the picture")
        if mode == "exact":
            return exact_clicks(measured, points)
        if mode == "click":
            return snap_click(measured, points[0])
        if mode == "path":
            return follow_path(measured, points)
        if mode == "circle":
            found = complete_circle(measured, points)
            return exact_clicks(measured, points) if found is None else found
        raise InputError(f"{mode}: is no way to mark something")

    def export(self, name: str) -> Exported:
        """All annotations that people made in another format: one file, or a ZIP of several.

        Raises
        ------
        InputError
            An unknown format, or nothing is annotated.
        """
        known = {key: f for key, f in annotation_formats().items() if f.write is not None}
        require_format(name, known, "export", "format that can be written")
        target: AnnotationFormat = known[name]
        left_out: list[str] = []
        own = list(self._annotations(left_out))
        if name == WORKBENCH.name:
            return _zip_files(name, {self.store.path(one.id).name: annotation_bytes(one) for one in own}, left_out)
        left_out += [f"{one.id}: is flagged {_say_flag(one)}; left out" for one in own if one.flag is not None]
        frames = [one.frame() for one in own if one.flag is None]
        if not frames or target.write is None:
            raise InputError(left_out[0] if left_out else "nothing is annotated yet")
        if target.per_frame:  # by the names of the annotations' own files
            files = {target.file_name.format(id=self.store.path(f.id).stem): target.write([f]) for f in frames}
        else:
            files = {target.file_name: target.write(frames)}
        contents = {Path(file): content for file, content in files.items()}
        left_out += list_losses(frames, contents, target, self.template)
        if not target.holds_convention:
            files[LIST_NAME] = list_bytes(files)
        return _zip_files(name, files, left_out) if target.per_frame else Exported(*files.popitem(), left_out)

    def _annotations(self, left_out: list[str]) -> Iterator[Annotation]:
        """Annotations of frames that people annotated; why one cannot be used is added to ``left_out``."""
        for frame in self.frames:
            try:
                annotation = self._read_annotation(frame) if frame.annotated else None
            except InputError as error:
                left_out.append(str(error))
                continue
            if annotation is not None:
                yield annotation

    def take_in(self, name: str, content: bytes) -> dict[str, Any]:
        """Take the frames of another program's file, or of a ZIP of such files, into the annotations, by their names.

        What was taken stays in the folder ``imported``; what is refused leaves nothing.

        Returns
        -------
        dict
            How many frames were ``taken``, how many are ``unknown`` here, and ``warnings``, one line each, of what was
            left out.

        Raises
        ------
        InputError
            The file is none of the known formats, or nothing of the frames that are known here can be used.
        """
        name = as_stem(Path(name.replace("\\", "/")).name)
        with tempfile.TemporaryDirectory(prefix="circlecal-import-") as folder:
            place = Path(folder)
            if content.startswith(MAGIC):
                where = place / "unpacked"
                unpacked = unpack(io.BytesIO(content), name, lambda path: where if may_be_annotation(path) else None)
                told = self._take_files(unpacked.files, where, name)
                told.warnings += unpacked.warnings(name)
                others = len(unpacked.others)
            else:
                path = place / name
                path.write_bytes(content)
                told, others = self._take_files([path], place, name), 0
        if others:
            told.warnings.append(
                f"{name}: holds {others} other files, which are left out; give a ZIP of pictures to circlecal annotate"
            )
        if told.taken:
            write_atomic(self.store.folder / "imported" / name, content)
        return {"taken": told.taken, "unknown": told.unknown, "warnings": told.warnings}

    def take_archive(self, archive: ArchivedAnnotations) -> Taken:
        """Take the annotations in a ZIP into the frames that nobody annotated here: the same command may be given again
        and again, and never takes the place of later work.

        Raises
        ------
        InputError
            Nothing in it can be used.
        """
        free = frozenset(index for index, frame in enumerate(self.frames) if not frame.annotated)
        return self._take_files(archive.files, archive.folder, archive.given, free)

    def _take_files(self, files: Sequence[Path], place: Path, name: str, free: Collection[int] | None = None) -> Taken:
        """Take files of a folder, of which those of an archive that cannot be used are told; into the frames ``free``,
        or into all.

        Raises
        ------
        InputError
            Nothing can be used.
        """
        told = Taken()
        for file in (file for file in files if file.name != LIST_NAME):
            try:
                told.add(self._take_file(file, free))
            except InputError as error:
                told.warnings.append(str(error).replace(f"{place}/", ""))
        if not told.taken and not told.kept and (told.warnings or not files):
            raise InputError(told.warnings[0] if told.warnings else f"{name}: holds no file of annotations")
        return told

    def _take_file(self, path: Path, free: Collection[int] | None) -> Taken:
        """Take the frames of one file; into the frames ``free``, or into all.

        Raises
        ------
        InputError
            Nothing in it can be used.
        """
        stems = [(frame.file.path.stem, k) for k, frame in enumerate(self.frames) if frame.file.time_s is None]
        shared = {stem for stem, count in Counter(stem for stem, _ in stems).items() if count > 1}
        # a name that several pictures have in their folders is none of theirs, but for the one whose id it is
        numbers = {stem: k for stem, k in stems if stem not in shared}
        numbers |= {frame.file.id: k for k, frame in enumerate(self.frames)}
        source, frames = self._read(path, numbers)
        known = [(numbers[frame.id], frame) for frame in frames if frame.id in numbers]
        wanted = [(index, frame) for index, frame in known if free is None or index in free]
        whole = parse_annotation(path, path.read_bytes()) if source == WORKBENCH.name else None
        told = Taken(unknown=len(frames) - len(known), kept=len(known) - len(wanted))
        for index, frame in wanted:
            try:
                told.warnings += self._merge(index, frame, source, whole)
                told.taken += 1
            except (InputError, NewerError) as error:
                told.warnings.append(str(error))
        if wanted and not told.taken:
            raise InputError(told.warnings[0])
        return told

    def _read(self, path: Path, numbers: Mapping[str, int]) -> tuple[str, list[AnnotatedFrame]]:
        """Name of the format and frames of a file; those of which it does not say how large they are have the size of
        the frame that they are of.
        """
        try:
            found, frames = read_annotations(path, None)
        except InputError:  # where that is not for want of a size it is raised again
            found, frames = read_annotations(path, UNKNOWN_SIZE)
        else:
            return found.name, frames
        begun = {frame.id: self.open(numbers[frame.id]).begun for frame in frames if frame.id in numbers}
        sizes = {frame_id: (own.width, own.height) for frame_id, own in begun.items()}
        of_size = {size: read_annotations(path, size, found.name)[1] for size in set(sizes.values())}
        placed = [of_size.get(sizes.get(frame.id, UNKNOWN_SIZE), frames)[k] for k, frame in enumerate(frames)]
        return found.name, placed

    def _merge(
        self, index: int, frame: AnnotatedFrame, source: str, whole: Annotation | None = None
    ) -> tuple[str, ...]:
        """The imported markings in the place of those of the same names; what a person should know of it, one line
        each. What somebody clicked stays in the list, not used. The workbench's own annotation, ``whole``, of a frame
        that nobody annotated here is taken as it is, with its note, flag and author.

        Raises
        ------
        InputError
            The file is of a picture of another aspect, or nothing in it is a marking of the field.
        NewerError
            The frame was changed elsewhere meanwhile.
        """
        current = self.annotation(index)
        if whole is not None and not current.touched and whole.field == current.field:
            own = current.model_dump(include={"id", "source", "time_s", "revision"})
            fitted = whole.resize(current.width, current.height).model_copy(update=own)
            self.store.save(fitted, current.revision)
            self.show(index)
            return ()
        fitting = frame.resize(current.width, current.height)
        seen = observe(fitting, self.template, self.config.sources, source, frame.id)
        imported = markings_of(seen.observations, "imported")
        if not imported:
            left_out = f": {seen.warnings[0]}" if seen.warnings else ""
            raise InputError(f"{frame.id}: nothing in it is a marking of this field{left_out}")
        names = {marking.name for marking in imported if marking.name is not None}
        measured = [marking.points_px for marking in self.open(index).begun.markings]
        brought = [marking.points_px for marking in imported]
        kept, clicked = [], []
        for marking in current.markings:
            if marking.name is None and marking.source == "imported" and marking.points_px in brought:
                continue  # it comes again
            if marking.name is None or marking.name not in names or not marking.used:
                kept.append(marking)
            elif marking.source != "imported" and marking.points_px not in measured:
                kept.append(marking.model_copy(update={"used": False}))
                clicked.append(marking.name.replace("_", " "))
        self.store.save(current.model_copy(update={"markings": [*kept, *imported]}), current.revision)
        self.show(index)
        told = [f"{frame.id}: {name}: what was clicked here stays in the list, not used" for name in clicked]
        if current.flag is not None:
            told.append(f"{frame.id}: stays flagged {_say_flag(current)}; take the flag away to use it")
        return (*seen.warnings, *told)


def _say_flag(annotation: Annotation) -> str:
    """What a person said of a frame, in words."""
    return (annotation.flag or "").replace("_", " ")


def _zip_files(name: str, files: Mapping[str, bytes], left_out: list[str]) -> Exported:
    """Files of single frames in one archive.

    Raises
    ------
    InputError
        There is none.
    """
    if not files:
        raise InputError(left_out[0] if left_out else "nothing is annotated yet")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, content in files.items():
            archive.writestr(file, content)
    return Exported(f"{name}.zip", stream.getvalue(), left_out)


def _jpeg(picture: NDArray[np.uint8]) -> bytes:
    done, content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise InputError("the picture cannot be shown")
    return content.tobytes()
