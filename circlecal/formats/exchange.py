"""Reading and writing every outside format by its name: the one place that knows them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from circlecal.config import SourcesConfig
from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.files import write_atomic
from circlecal.formats import (
    broadtrack,
    coco,
    cvat,
    gamestate,
    labelme,
    labelstudio,
    pnlcalib,
    soccernet,
    tvcalib,
    worldcup,
)
from circlecal.formats.calibrated import CalibratedFrame, calibrated_frame, centred_camera
from circlecal.formats.cameras import CameraFrame
from circlecal.formats.checked import MAX_SHAPES, Size, read_content
from circlecal.formats.meaning import observe
from circlecal.formats.shapes import AnnotatedFrame, ObservedFrame
from circlecal.formats.sniff import ANNOTATION_FORMATS, CAMERA_FORMATS, READ_ONLY, Kind, kind_of, recognise
from circlecal.geometry.camera import Camera, camera_from_homography
from circlecal.pictures.files import PICTURE_SUFFIXES, distinct_names, picture_header
from circlecal.records.reading import is_records, read_records
from circlecal.records.record import StoredResult, read_result, stored_result

TARGETS = tuple(name for name in dict.fromkeys((*CAMERA_FORMATS, *ANNOTATION_FORMATS)) if name not in READ_ONLY)
"""Formats that a calibration can be written in."""
_HEADER_BYTES = 1 << 20


def format_of(path: Path, name: str | None = None) -> tuple[str, Kind, bytes]:
    """Format, kind and content of a file; ``name`` overrides what the content looks like.

    Raises
    ------
    InputError
        Unreadable, or of no known format.
    """
    content = read_content(path)
    if name is None:
        return (*recognise(path, content), content)
    return name, kind_of(path, content, name), content


def read_annotations(path: Path, size: Size | None = None, name: str | None = None) -> tuple[str, list[AnnotatedFrame]]:
    """Format and frames of an annotation file.

    Parameters
    ----------
    path : path
        The file.
    size : (int, int), optional
        Width and height of its pictures where the file has none; else those of a picture of the same name beside it.
    name : str, optional
        Its format; recognised by content when None.

    Raises
    ------
    InputError
        One line with the file, the field and the mend.
    """
    found, kind, content = format_of(path, name)
    if kind != "annotation":
        raise InputError(f"{path}: is a {found} {kind}, not an annotation; nothing to calibrate in it")
    frames = _annotated(path, content, found, size)
    crowded = next((frame for frame in frames if len(frame.shapes) > MAX_SHAPES), None)
    if crowded is not None:
        raise InputError(
            f"{path}: {crowded.id}: has {len(crowded.shapes)} shapes; at most {MAX_SHAPES} are read of one frame"
        )
    return found, frames


def _annotated(path: Path, content: bytes, name: str, size: Size | None) -> list[AnnotatedFrame]:
    match name:
        case "coco":
            return coco.read_dataset(path, content, size)
        case "cvat":
            return cvat.read_annotations(path, content, size)
        case "gamestate":
            return gamestate.read_labels(path, content, size)
        case "labelstudio":
            return labelstudio.read_tasks(path, content, size)
        case "labelme":
            return [labelme.read_file(path, content, size)]
        case "pnlcalib":
            return [pnlcalib.read_prediction(path, content, size or size_beside(path))]
        case _:
            extremities = name == "extremities"
            return [soccernet.read_annotation(path, content, size or size_beside(path), extremities=extremities)]


def read_observations(
    path: Path, template: FieldTemplate, sources: SourcesConfig, size: Size | None = None, name: str | None = None
) -> list[ObservedFrame]:
    """The frames of an annotation file as observations; see :func:`read_annotations`.

    Raises
    ------
    InputError
        One line with the file, the field and the mend.
    """
    found, frames = read_annotations(path, size, name)
    return [observe(frame, template, sources, found, str(path)) for frame in frames]


def picture_beside(path: Path, image: str | None = None) -> Path | None:
    """The picture of an annotation file in the same folder: the one it names, or the one of its own name."""
    names = [image.replace("\\", "/").rpartition("/")[2]] if image else []
    names += [f"{path.stem}{suffix}" for suffix in PICTURE_SUFFIXES]
    return next((path.with_name(name) for name in names if name and path.with_name(name).is_file()), None)


def size_beside(path: Path) -> Size | None:
    """Size of the picture of the same name in the same folder, read off its header."""
    picture = picture_beside(path)
    if picture is None:
        return None
    with picture.open("rb") as file:
        header = picture_header(file.read(_HEADER_BYTES))
    return None if header is None else (header.width, header.height)


def read_cameras(path: Path, size: Size | None = None, name: str | None = None) -> list[CameraFrame]:
    """Cameras of a file; ``size`` as in :func:`read_annotations`.

    Raises
    ------
    InputError
        One line with the file, the field and the mend.
    """
    found, kind, content = format_of(path, name)
    if kind != "camera":
        raise InputError(f"{path}: is a {found} {kind}, not a camera")
    match found:
        case "broadtrack":
            return broadtrack.read_sequence(path, content)
        case "tvcalib":
            return tvcalib.read_samples(path, content, size)
        case "worldcup":
            return [worldcup.read_matrix(path, content)]
        case _:
            identifier, camera = soccernet.read_camera(path, content, size)
            return [CameraFrame(identifier, camera.width, camera.height, camera)]


def annotation_files(frames: Sequence[AnnotatedFrame], name: str, folder: Path, suffix: str = "") -> dict[Path, bytes]:
    """Content by path of annotations: a file per frame (``<id><suffix>.json``), or one of all (``coco.json``, ...)."""
    match name:
        case "coco":
            return {folder / "coco.json": soccernet.json_bytes(coco.dataset_record(frames))}
        case "cvat":
            return {folder / "cvat.xml": cvat.annotations_xml(frames)}
        case "labelstudio":
            return {folder / "labelstudio.json": soccernet.json_bytes(labelstudio.tasks_record(frames))}
    prefix = "extremities_" if name == "extremities" else ""
    return {folder / f"{prefix}{f.id}{suffix}.json": soccernet.json_bytes(_record(f, name)) for f in frames}


def _record(frame: AnnotatedFrame, name: str) -> dict[str, object]:
    if name == "labelme":
        return labelme.file_record(frame)
    if name == "pnlcalib":
        return pnlcalib.prediction_record(frame)
    return {**soccernet.annotation_record(frame, extremities=name == "extremities")}


def camera_files(frames: Sequence[CameraFrame], name: str, folder: Path, size: Size | None = None) -> dict[Path, bytes]:
    """Content by path of cameras; ``size`` is that of the pictures in which they count, where the format has none.

    Raises
    ------
    InputError
        A homography that no camera fits.
    """
    match name:
        case "broadtrack":
            resized = [replace(frame, camera=_camera(frame, size)) for frame in frames]
            return {folder / "broadtrack.json": soccernet.json_bytes(broadtrack.sequence_record(resized))}
        case "tvcalib":
            kept = frames if size is None else [replace(frame, H_image_field=None) for frame in frames]
            resized = [replace(frame, camera=_camera(old, size)) for frame, old in zip(kept, frames, strict=True)]
            return {folder / "per_sample_output.json": tvcalib.samples_bytes(resized)}
        case "worldcup":
            return {folder / f"{frame.id}{worldcup.SUFFIX}": _matrix(frame) for frame in frames}
    return {
        folder / f"camera_{frame.id}.json": soccernet.json_bytes(soccernet.camera_record(_camera(frame, None), size))
        for frame in frames
    }


def _matrix(frame: CameraFrame) -> bytes:
    H = frame.H_image_field if frame.H_image_field is not None else _camera(frame, None).homography
    return worldcup.matrix_bytes(H, (frame.width, frame.height))


def _camera(frame: CameraFrame, size: Size | None) -> Camera:
    camera = frame.camera
    if camera is None and frame.H_image_field is not None:
        camera = camera_from_homography(frame.H_image_field, frame.width, frame.height)
    if camera is None:
        raise InputError(f"{frame.id}: no camera with square pixels fits its homography")
    return soccernet.camera_at_size(camera, size)


def write_calibrations(
    frames: Sequence[CalibratedFrame],
    name: str,
    folder: Path,
    size: Size | None = None,
    refused: Sequence[AnnotatedFrame] = (),
    originals: dict[str, ObservedFrame] | None = None,
) -> list[Path]:
    """Write accepted calibrations in an outside format, beside the result files ``<id>.json``.

    Parameters
    ----------
    frames : sequence of CalibratedFrame
        The accepted ones.
    name : str
        One of :data:`TARGETS`.
    folder : path
        Where.
    size : (int, int), optional
        Size of the pictures in which cameras count; the frame's own when None.
    refused : sequence of AnnotatedFrame
        Refused frames, without shapes: formats that list their pictures list these too, the others leave them out.
    originals : dict, optional
        What was read, by frame id: ``pnlcalib`` hands on what it does not change.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    if name == "pnlcalib":
        known = originals or {}
        records = {f.id: pnlcalib.keypoints_record(f, known[f.id].original if f.id in known else None) for f in frames}
        return _write({folder / f"{key}.pnlcalib.json": soccernet.json_bytes(r) for key, r in records.items()})
    if name in ANNOTATION_FORMATS and name not in CAMERA_FORMATS:
        listed = [frame.annotated() for frame in frames]
        listed += refused if name in ("coco", "cvat", "labelstudio") else []
        return _write(annotation_files(sorted(listed, key=lambda frame: frame.id), name, folder, f".{name}"))
    return _write(camera_files([_camera_frame(frame, name) for frame in frames], name, folder, size))


def _camera_frame(frame: CalibratedFrame, name: str) -> CameraFrame:
    H = frame.picture_homography
    if name == "worldcup":
        return CameraFrame(frame.id, frame.width, frame.height, None, H, frame.image)
    camera = frame.centred if name == "broadtrack" else frame.flat
    return CameraFrame(frame.id, frame.width, frame.height, camera, H, frame.image)


def convert(
    paths: Sequence[Path],
    source: str | None,
    target: str,
    folder: Path,
    template: FieldTemplate,
    size: Size | None = None,
) -> list[Path]:
    """Rewrite files in another format of their kind, and results as cameras; formats of one file get all frames.

    Raises
    ------
    InputError
        Unreadable, there is no way from the one format to the other, or a file would be written over its source.
    """
    annotations: list[AnnotatedFrame] = []
    cameras: list[CameraFrame] = []
    for path in paths:
        if target in CAMERA_FORMATS and is_records(path):
            cameras += [frame for record in read_records(path) for frame in _camera_of_record(record, target, template)]
            continue
        name, kind, _ = format_of(path, source)
        if kind == "annotation" and target in ANNOTATION_FORMATS and target != "gamestate":
            annotations += read_annotations(path, size, name)[1]
        elif kind == "camera" and target in CAMERA_FORMATS:
            cameras += [_converted(path, frame, target, template) for frame in read_cameras(path, size, name)]
        elif kind == "result" and target in CAMERA_FORMATS:
            cameras += _stored_camera(read_result(path), target, template)
        else:
            raise InputError(f"{path}: there is no way from a {name} {kind} to {target}; {_pairs()}")
    if annotations and cameras:
        raise InputError(f"{paths[0]}: annotations and cameras together; convert one kind at a time")
    return _write_new(paths, annotations, cameras, target, folder)


def _converted(path: Path, frame: CameraFrame, target: str, template: FieldTemplate) -> CameraFrame:
    if target == "worldcup":
        return frame
    try:
        camera = _camera(frame, None)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return replace(frame, camera=centred_camera(camera, template) if target == "broadtrack" else camera)


def _stored_camera(result: StoredResult, target: str, template: FieldTemplate) -> list[CameraFrame]:
    stored = calibrated_frame(result, template, template.circle_by_name[template.default_circle])
    return [] if stored is None else [_camera_frame(stored, target)]


def _camera_of_record(record: dict[str, Any], target: str, template: FieldTemplate) -> list[CameraFrame]:
    if record.get("image") is None:  # never read
        return []
    return _stored_camera(stored_result(record, str(record["id"])), target, template)


def _write_new(
    paths: Sequence[Path],
    annotations: Sequence[AnnotatedFrame],
    cameras: Sequence[CameraFrame],
    target: str,
    folder: Path,
) -> list[Path]:
    """Write what was converted, with distinct names and never over what it was read from."""
    if not annotations and not cameras:
        raise InputError(f"{paths[0]}: holds no accepted frame; nothing to convert")
    sources = {path.resolve() for path in paths}
    contents: dict[Path, bytes] = {}
    if annotations:
        ids = distinct_names([frame.id for frame in annotations])
        contents = annotation_files([replace(f, id=i) for f, i in zip(annotations, ids, strict=True)], target, folder)
    else:
        ids = distinct_names([frame.id for frame in cameras])
        contents = camera_files([replace(f, id=i) for f, i in zip(cameras, ids, strict=True)], target, folder)
    over = next((path for path in contents if path.resolve() in sources), None)
    if over is not None:
        raise InputError(f"{over}: would be written over what it is made from; choose another --out")
    return _write(contents)


def _pairs() -> str:
    annotations = ", ".join(name for name in ANNOTATION_FORMATS if name != "gamestate")
    return (
        f"annotations go to and from {annotations}, cameras to and from {', '.join(CAMERA_FORMATS)}, "
        "and pictures or annotations become cameras with circlecal calibrate --to"
    )


def _write(contents: dict[Path, bytes]) -> list[Path]:
    for path, content in contents.items():
        write_atomic(path, content)
    return list(contents)
