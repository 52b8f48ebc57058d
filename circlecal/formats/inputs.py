"""Annotations among what the user names, instead of pictures; keypoints and lines beside pictures."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.keypoints import KeypointsConfig, find_keypoints
from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.files import is_file, is_folder, real_path, require_input
from circlecal.formats.annotation import FORMAT as WORKBENCH
from circlecal.formats.annotation import Annotation, is_annotation_file, load_template, parse_annotation
from circlecal.formats.cameras import Size
from circlecal.formats.format import AnnotationFormat, stem_of
from circlecal.formats.meaning import SourcesConfig, observe
from circlecal.formats.picture_paths import path_parts, picture_path, shared_depth, shared_endings
from circlecal.formats.pnlcalib import LABEL
from circlecal.formats.registry import (
    RESULT,
    annotation_suffixes,
    formats,
    names_of_files,
    open_file,
    parse_annotations,
    picture_beside,
    read_annotations,
    require_format,
)
from circlecal.formats.shapes import AnnotatedFrame, ObservedFrame, Shape
from circlecal.formats.soccernet import LINE_CLASSES
from circlecal.observations import Observations
from circlecal.pictures.files import PICTURE_SUFFIXES, PictureFile, distinct_names, walk
from circlecal.records.log import RESULTS_NAME, leave_out_copies, read_records
from circlecal.records.record import ResultRow

BESIDE_SUFFIXES = (".json", ".xml")
"""Of annotations that programs put beside pictures."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class AnnotationFile:
    """A file, its path relative to the folder that was given, and whether it was named itself."""

    path: Path
    relative: Path
    named: bool


@dataclass(frozen=True, slots=True)
class FrameOfFile:
    """A frame of an annotation file, the file, the picture beside it where there is one, and what a person said of the
    frame where the file is the workbench's.
    """

    observed: ObservedFrame
    path: Path
    picture: Path | None
    annotation: Annotation | None = None

    @property
    def id(self) -> str:
        """Unique in a run."""
        return self.observed.id

    @property
    def image(self) -> str | None:
        """Name of the picture, where the file names one or it lies beside the file."""
        return self.observed.image or (None if self.picture is None else self.picture.name)


def split_inputs(
    inputs: Sequence[Path], format_name: str | None = None, exclude: Sequence[Path] = ()
) -> tuple[list[Path], list[AnnotationFile]]:
    """What holds pictures, and the annotation files.

    A file is an annotation by its suffix, or by the user's naming a format. In a folder with pictures these are the
    frames and its other files are left alone, unless the user names a format.

    Raises
    ------
    InputError
        An input does not exist, or is a picture while a format of annotations is named.
    """
    pictures: list[Path] = []
    files: list[AnnotationFile] = []
    for given in inputs:
        require_input(given)
        if is_folder(given):
            found = _files_in(given, exclude)
            held = [path for path in found if path.suffix.lower() in annotation_suffixes()]
            shows = any(path.suffix.lower() in PICTURE_SUFFIXES for path in found)
            if held and (format_name is not None or not shows):
                files += [AnnotationFile(path, path.relative_to(given), named=False) for path in held]
            else:
                pictures.append(given)
        elif format_name is not None and given.suffix.lower() in PICTURE_SUFFIXES:
            raise InputError(f"{given}: is a picture, not a {format_name} file; leave --from out")
        elif given.suffix.lower() in annotation_suffixes() or format_name is not None:
            files.append(AnnotationFile(given, Path(given.name), named=True))
        else:
            pictures.append(given)
    return pictures, files


def _files_in(folder: Path, excluded: Collection[Path]) -> list[Path]:
    left_out = {real_path(path) for path in excluded} - {folder_path := real_path(folder), *folder_path.parents}
    real = ((path, real_path(path)) for path in walk(folder))
    return [path for path, resolved in real if left_out.isdisjoint((resolved, *resolved.parents))]


def read_frames(
    files: Sequence[AnnotationFile],
    template: FieldTemplate,
    sources: SourcesConfig,
    *,
    painted: FieldTemplate,
    size: Size | None = None,
    format_name: str | None = None,
    taken: Sequence[str] = (),
    on_error: Callable[[InputError], None],
) -> list[FrameOfFile]:
    """Frames of annotation files, their ids unique; files of a folder that are no annotations are passed over.

    Parameters
    ----------
    files : sequence of AnnotationFile
        From :func:`split_inputs`.
    template, sources : FieldTemplate, SourcesConfig
        As for :func:`circlecal.formats.meaning.observe`.
    painted : FieldTemplate
        The field for frames of which their file says that points lie on the middle of the paint.
    size, format_name : optional
        As for :func:`circlecal.formats.registry.read_annotations`.
    taken : sequence of str
        Ids that other frames of the run have.
    on_error : callable
        Called with the error of each file that cannot be read; the others go on.
    """
    found: list[tuple[str, AnnotatedFrame, AnnotationFile, Annotation | None]] = []
    for file in files:
        try:
            known, content = open_file(file.path, format_name)
            if not file.named and not isinstance(known, AnnotationFormat):
                _log.info("%s: is no annotation; passed over", file.path)
                continue
            frames = parse_annotations(known, content, size)
            by_hand = parse_annotation(file.path, content.raw) if known is WORKBENCH else None
        except InputError as error:
            on_error(error)
            continue
        if not frames:
            on_error(InputError(f"{file.path}: none of its pictures is annotated; annotate one and export it again"))
        found += [
            (known.name, replace(frame, id="__".join((*file.relative.parts[:-1], frame.id))), file, by_hand)
            for frame in frames
        ]
    ids = distinct_names([*taken, *(frame.id for _, frame, _, _ in found)])[len(taken) :]
    images: dict[Path, list[str]] = defaultdict(list)
    for _, frame, file, _ in found:
        images[file.path] += [] if frame.image is None else [frame.image]
    shared = {path: shared_endings(names) for path, names in images.items()}
    read = []
    for identifier, (name, frame, file, by_hand) in zip(ids, found, strict=True):
        own = None if by_hand is None else load_template(frame.field)
        field = own or (painted if frame.on_paint else template)
        observed = observe(replace(frame, id=identifier), field, sources, name, str(file.path))
        for warning in observed.warnings:
            _log.warning("%s", warning)
        read.append(
            FrameOfFile(observed, file.path, picture_beside(file.path, observed.image, shared[file.path]), by_hand)
        )
    return read


def find_unused_annotations(frames: Sequence[PictureFile]) -> list[Path]:
    """Annotations of other programs that lie beside pictures as ``x.json`` or ``x.xml``; the first one is opened."""
    pictures = [frame.path for frame in frames if frame.url is None and frame.time_s is None]
    beside = [path for picture in pictures for s in BESIDE_SUFFIXES if is_file(path := picture.with_suffix(s))]
    beside = [path for path in dict.fromkeys(beside) if not is_annotation_file(path)]
    if not beside:
        return []
    try:
        found, _ = open_file(beside[0])
    except InputError:
        return []
    return beside if isinstance(found, AnnotationFormat) else []


def find_convertible(inputs: Sequence[Path], format_name: str | None, out: Path) -> list[Path]:
    """Files to convert among files and folders; in a folder those of known suffix, of a run its results alone: the same
    frames lie beside and below them in the formats in which it wrote them, unless one is named.

    Raises
    ------
    InputError
        An unknown format, a missing input, nothing to convert, or a folder of runs of which two hold a frame.
    """
    if format_name is not None:
        require_format(format_name, {f.name: f for f in formats()}, "--from", "known format")
    files: list[Path] = []
    for given in inputs:
        if is_folder(given):
            found = _files_in(given, [out])
            if format_name is None:
                found = leave_out_copies(found)
                _require_different_frames([path for path in found if path.name == RESULTS_NAME])
            files += [path for path in found if path.suffix.lower() in annotation_suffixes()]
        else:
            files.append(given)
    if not files:
        raise InputError(
            f"{', '.join(map(str, inputs))}: nothing to convert; give {', '.join(annotation_suffixes())} files"
        )
    return files


def _require_different_frames(logs: Sequence[Path]) -> None:
    """Runs that lie in one folder are of different frames.

    Raises
    ------
    InputError
        Two of them hold a frame.
    """
    places = FramePlaces("give one of the two runs")
    for log in logs if len(logs) > 1 else ():
        for row in read_records(log, ResultRow):
            places.enter(log, row.id)


class FramePlaces:
    """In which files frames were found.

    Parameters
    ----------
    mend : str
        What helps where two files hold a frame.
    in_one_folder : bool
        Whether files of one folder may: only clips whose frames are numbered alike are kept apart.
    """

    def __init__(self, mend: str, *, in_one_folder: bool = False) -> None:
        self._mend, self._in_one_folder = mend, in_one_folder
        self._files: dict[str, Path] = {}

    def enter(self, path: Path, frame_id: str) -> None:
        """Note that a file holds a frame.

        Raises
        ------
        InputError
            Another file holds a frame of that name.
        """
        earlier = self._files.setdefault(frame_id, path)
        are_one = earlier.parent == path.parent if self._in_one_folder else earlier == path
        if not are_one:
            raise InputError(f"{path}: holds the frame {frame_id}, as {earlier} does; {self._mend}")


def refuse_overwriting(frames: Sequence[FrameOfFile], out: Path) -> None:
    """Result files must not take the place of the annotations that they are made from.

    Raises
    ------
    InputError
        One of them would.
    """
    sources = {real_path(frame.path) for frame in frames}
    for frame in frames:
        if real_path(out / f"{frame.observed.id}.json") in sources:
            raise InputError(f"{frame.path}: its result would be written over it; choose another --out")


def observations_beside(
    given: Path,
    frame: PictureFile,
    template: FieldTemplate,
    sources: SourcesConfig,
    size: Size,
    format_name: str | None = None,
) -> Observations:
    """What a file of keypoints or lines says about a picture, in pixels of that picture.

    Parameters
    ----------
    given : path
        A file with this frame or with many, or a folder of files named like the frames.
    frame : PictureFile
        The picture.
    template, sources : FieldTemplate, SourcesConfig
        As for :func:`circlecal.formats.meaning.observe`.
    size : (int, int)
        Width and height of the picture; a file of another size and the same aspect is scaled to it.
    format_name : str, optional
        Format of the file; recognised when None.

    Raises
    ------
    InputError
        Nothing for this frame or more than one, an unusable file, or one of pictures of another aspect.
    """
    path = find_file_beside(given, frame, format_name) if is_folder(given) else given
    if path is None:
        raise InputError(f"{given}: nothing for {frame.label}; looked for {frame.stem}.json")
    known, frames = read_annotations(path, size, format_name)
    chosen = frames[0] if len(frames) == 1 else _choose_frame(path, frames, frame)
    observed = observe(chosen.resize(*size), template, sources, known.name, str(path))
    for warning in observed.warnings:
        _log.warning("%s", warning)
    return observed.observations


def _choose_frame(path: Path, frames: Sequence[AnnotatedFrame], picture: PictureFile) -> AnnotatedFrame:
    """The frame of a file that is of a picture: the one whose path agrees with the picture's most.

    Raises
    ------
    InputError
        None is, or several may be.
    """
    likeness = [_compare_paths(frame, picture) for frame in frames]
    most = max(likeness, default=(0, False))
    alike = [frame for frame, value in zip(frames, likeness, strict=True) if value == most]
    if most[0] == 0:
        others = [frame.image for frame in frames if frame.image and stem_of(frame.image) == stem_of(picture.path.name)]
        told = f", but {others[0]}; give the folder in which its paths begin" if others else ""
        raise InputError(f"{path}: has {len(frames)} frames, none of them {picture.mask_stem}{told}")
    if len(alike) > 1:
        named = ", ".join(frame.image or frame.id for frame in alike[:3])
        told = f"has {len(alike)} frames that may be {picture.mask_stem} ({named})"
        raise InputError(f"{path}: {told}; keep one, or name pictures by their folders in it")
    return alike[0]


def _compare_paths(frame: AnnotatedFrame, picture: PictureFile) -> tuple[int, bool]:
    """How many parts of its path a frame of a file shares with a picture, and whether their suffixes are equal; 0 where
    they name different folders.
    """
    below = path_parts(picture.mask_stem)
    is_file_itself = picture.time_s is None and picture.url is None
    whole = path_parts(str(picture.path.absolute().with_suffix(""))) if is_file_itself else below
    best = (0, False)
    for name in (picture_path(frame.image), frame.image) if frame.image else (frame.id,):
        *folders, base = path_parts(name) or ("",)
        named = Path(base)
        depth = shared_depth((*folders, named.stem), whole)
        depth = depth if depth >= min(len(folders) + 1, len(below)) else 0
        if named.stem == picture.id:
            depth = max(depth, len(below))
        best = max(best, (depth, depth > 0 and named.suffix.lower() == picture.path.suffix.lower()))
    return best


def find_file_beside(given: Path, frame: PictureFile, format_name: str | None) -> Path | None:
    """The file of a picture in a folder, None where there is none; a result of circlecal only where nothing else has
    its name.
    """
    stems = dict.fromkeys((frame.mask_stem, frame.id, frame.stem))
    names = [(Path(stem).parent, name) for stem in stems for name in names_of_files(Path(stem).name, format_name)]
    found = [path for folder, name in names if is_file(path := given / folder / name)]
    if len(found) <= 1:
        return found[0] if found else None
    return next((path for path in found if not _is_result(path)), found[0])


def _is_result(path: Path) -> bool:
    try:
        return open_file(path)[0] is RESULT
    except InputError:  # told when it is read
        return False


def observe_network(
    image: NDArray[np.uint8], config: KeypointsConfig, template: FieldTemplate, sources: SourcesConfig
) -> Observations | None:
    """Keypoints and lines that the networks of a configuration find in a picture, in PnLCalib's layout, sub-pixel.

    None where there are no networks.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    config : KeypointsConfig
        Model files and their layout.
    template, sources : FieldTemplate, SourcesConfig
        As for :func:`circlecal.formats.meaning.observe`; the sources hold the least confidence.

    Raises
    ------
    ConfigError
        A network is missing or unusable.
    InputError
        The template is no soccer pitch.
    """
    found = find_keypoints(image, config)
    if found is None:
        return None
    points, ends = found
    shapes = [
        Shape(f"{LABEL}{number}", "points", place, _cap(confidence))
        for number, (place, confidence) in enumerate(zip(points.points_px, points.confidence, strict=True), start=1)
    ]
    if ends is not None:
        shapes += [
            Shape(name, "line", place, _cap(confidence))
            for name, place, confidence in zip(LINE_CLASSES, ends.points_px, ends.confidence, strict=True)
        ]
    height, width = image.shape[:2]
    frame = AnnotatedFrame("network", width, height, tuple(shapes), None)
    observed = observe(frame, template, sources, "pnlcalib", str(config.model))
    for warning in observed.warnings:
        _log.debug("%s", warning)
    return observed.observations


def _cap(confidence: NDArray[np.float64]) -> tuple[float, ...]:
    """Heights as confidences; below 1, which in keypoint files marks what was computed from lines."""
    return tuple(np.clip(confidence, 0.0, 0.9999).tolist())
