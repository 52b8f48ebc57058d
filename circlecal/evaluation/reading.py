"""Folders of annotations and of predicted cameras, whatever program wrote them, ready to be compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from circlecal.errors import InputError
from circlecal.evaluation.soccernet_metric import CLASSES, MetricCamera, PlaneHomography, Projector
from circlecal.field import load_field
from circlecal.files import is_file, is_folder
from circlecal.formats import soccernet, soccernet_camera
from circlecal.formats.cameras import CalibratedFrame, CameraFrame, Size
from circlecal.formats.format import CameraFormat, parse_content
from circlecal.formats.registry import RESULT, open_file
from circlecal.formats.soccernet_camera import CameraKeys
from circlecal.formats.worldcup import SUFFIX as MATRIX_SUFFIX
from circlecal.geometry.camera import rotation_matrix
from circlecal.geometry.projective import Array
from circlecal.records.json_text import read_result
from circlecal.records.log import is_log, read_records
from circlecal.records.record import ResultRecord

USUAL_SIZES: tuple[Size, ...] = ((640, 360), (960, 540), (1280, 720), (1920, 1080), (3840, 2160))
SIZE_TOLERANCE = 0.06
CENTRAL_CLASS, HALFWAY_CLASS = "Circle central", "Middle line"
_MAX_LINES_CENTRAL = 2

Annotated = Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class Prediction:
    """A frame's camera at the size of the pictures for which it is evaluated.

    Attributes
    ----------
    camera : Projector
        Where it shows the field.
    H_image_field : (3, 3) array or None
        Field (metres) to pixels, where the file holds a homography rather than a camera.
    """

    camera: Projector
    H_image_field: Array | None = None


def read_annotated_points(folder: Path, size: Size) -> dict[str, Annotated]:
    """Annotated points (N, 2) in pixels at ``size``, by frame and class; empty classes are left out.

    Raises
    ------
    InputError
        No such folder, no annotation in it, a damaged file or an unknown class.
    """
    files = [path for path in _files(folder, (".json",)) if not path.name.startswith(("camera_", "extremities_"))]
    found: dict[str, Annotated] = {}
    for path in files:
        known, content = open_file(path, "soccernet")
        if known is not soccernet.FORMAT:
            continue
        classes: dict[str, Array] = {}
        for shape in soccernet.read(path, content.raw, size)[0].shapes:
            if shape.label not in CLASSES:
                raise InputError(f"{path}: {shape.label}: is no class of SoccerNet; correct its spelling")
            earlier = classes.get(shape.label, np.zeros((0, 2)))
            classes[shape.label] = np.concatenate([earlier, shape.points_px])
        found[path.stem] = classes
    if not found:
        raise InputError(f"{folder}: holds no line annotation of SoccerNet (<id>.json)")
    return found


def holds_homographies(folder: Path) -> bool:
    """Whether a folder of truth holds ``*.homographyMatrix`` files, or cameras, instead of annotations."""
    files = _files(folder, (".json", MATRIX_SUFFIX))
    return bool(files) and all(path.suffix == MATRIX_SUFFIX or path.name.startswith("camera_") for path in files)


def read_predictions(folder: Path, size: Size, given_size: Size | None = None) -> dict[str, Prediction]:
    """Cameras of a folder by frame, at ``size``; refused results of circlecal are left out.

    Parameters
    ----------
    folder : path
        ``camera_<id>.json``, results of circlecal (``<id>.json``, ``results.jsonl``), or
        ``<id>.homographyMatrix``; also in subfolders.
    size : (int, int)
        At which is evaluated.
    given_size : (int, int), optional
        For which the cameras were made; read off the principal point where None.

    Raises
    ------
    InputError
        No such folder, no camera in it, or a damaged file.
    """
    found: dict[str, Prediction] = {}
    for path in _files(folder, (".json", MATRIX_SUFFIX)):
        known, content = open_file(path)
        if known is soccernet_camera.FORMAT:
            keys = parse_content(CameraKeys, path, content.raw)
            found[path.stem.removeprefix(soccernet_camera.PREFIX)] = Prediction(
                _soccernet(path, keys, size, given_size)
            )
        elif isinstance(known, CameraFormat):
            found |= _further(known.read(path, content.raw, given_size), size)
        elif known is RESULT:
            found |= _own_result(read_result(path), size)
    for log in filter(is_log, _files(folder, (".jsonl",))):
        for record in read_records(log):
            found |= _own_result(record, size)
    if not found:
        raise InputError(f"{folder}: holds no camera; camera_<id>.json, results or <id>{MATRIX_SUFFIX} are read")
    return found


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    if not is_folder(folder):
        raise InputError(f"{folder}: is no folder; give one with a file per frame")
    return sorted(path for path in folder.rglob("*") if path.suffix in suffixes and is_file(path))


def _soccernet(path: Path, keys: CameraKeys, size: Size, given: Size | None) -> MetricCamera:
    """A camera with all its coefficients of distortion, more than circlecal's own have."""
    camera = MetricCamera(
        np.array([keys.x_focal_length, keys.y_focal_length]),
        np.array(keys.principal_point),
        rotation_matrix(*np.radians([keys.pan_degrees, keys.tilt_degrees, keys.roll_degrees])),
        np.array(keys.position_meters),
        _pad(keys.radial_distortion, 6),
        _pad(keys.tangential_distortion, 2),
        _pad(keys.thin_prism_distortion, 4),
    )
    return camera.resize(_factor(given or _size_of(path, keys), size))


def _pad(values: list[float], count: int) -> Array:
    return np.pad(np.array(values, dtype=np.float64), (0, count - len(values)))


def _size_of(path: Path, keys: CameraKeys) -> Size:
    """The size that a file states, or the usual one with the image centre nearest to the principal point."""
    if keys.image_width is not None and keys.image_height is not None:
        return keys.image_width, keys.image_height
    twice = 2.0 * np.array(keys.principal_point)
    usual = np.array(USUAL_SIZES, dtype=np.float64)
    distance = np.abs(twice / usual - 1.0).max(axis=1)
    if distance.min() > SIZE_TOLERANCE:
        if (twice > 1).all() and (twice == np.round(twice)).all() and (twice % 2 == 0).all():
            return int(twice[0]), int(twice[1])
        raise InputError(
            f"{path}: principal_point does not tell the size of the pictures; give --pred-size WIDTHxHEIGHT"
        )
    return USUAL_SIZES[int(distance.argmin())]


def _factor(old: Size, new: Size) -> tuple[float, float]:
    """Pixels go between sizes as annotations do: the centres of the outermost pixels stay that."""
    return (new[0] - 1) / (old[0] - 1), (new[1] - 1) / (old[1] - 1)


def _further(frames: Sequence[CameraFrame], size: Size) -> dict[str, Prediction]:
    found = {}
    for frame in frames:
        factor = _factor((frame.width, frame.height), size)
        if frame.camera is not None:
            found[frame.id] = Prediction(MetricCamera.from_camera(frame.camera).resize(factor))
        elif frame.H_image_field is not None:
            H = np.diag([*factor, 1.0]) @ frame.H_image_field
            found[frame.id] = Prediction(PlaneHomography(H), H)
    return found


def _own_result(stored: ResultRecord, size: Size) -> dict[str, Prediction]:
    """A result of circlecal; where the surface is crowned, the flat camera nearest to what it shows."""
    template = load_field("soccer")
    frame = CalibratedFrame.of(stored, template, template.circle_by_name[template.default_circle])
    camera = None if frame is None else frame.flat
    if frame is None or camera is None:
        return {}
    scaled = MetricCamera.from_camera(camera).resize(_factor((stored.width, stored.height), size))
    return {stored.id: Prediction(scaled)}


def is_central(annotated: Annotated) -> bool:
    """Whether a frame is a central view: the circle is visible, and fewer than three straight lines on the ground."""
    straight = [name for name in annotated if name in soccernet.LINE_CLASSES and not name.startswith("Goal")]
    return CENTRAL_CLASS in annotated and len(straight) <= _MAX_LINES_CENTRAL


def shows_circle_and_halfway(annotated: Annotated) -> bool:
    """Whether circle and halfway line are annotated."""
    return CENTRAL_CLASS in annotated and HALFWAY_CLASS in annotated
