"""Folders of annotations and of predicted cameras, whatever program wrote them, ready to be compared."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from circlecal.errors import InputError
from circlecal.evaluation.clip_truth import ClipTruth, parse_clip_truth
from circlecal.evaluation.soccernet_metric import CLASSES, MetricCamera, PlaneHomography, Projector
from circlecal.field import MEET, load_field
from circlecal.field.view import FieldView
from circlecal.files import find_files, is_folder
from circlecal.formats import soccernet, soccernet_camera
from circlecal.formats.cameras import CalibratedFrame, CameraFrame, Size
from circlecal.formats.format import (
    AnnotationFormat,
    Bounded,
    CameraFormat,
    Content,
    FileModel,
    Focal,
    Format,
    Side,
    parse_content,
)
from circlecal.formats.inputs import FramePlaces
from circlecal.formats.registry import RESULT, open_file
from circlecal.formats.soccernet_camera import CameraKeys
from circlecal.formats.worldcup import SUFFIX as MATRIX_SUFFIX
from circlecal.geometry.camera import rotation_matrix
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.pictures.video import frame_id as name_of_frame
from circlecal.records.json_text import read_result
from circlecal.records.log import RESULTS_NAME, is_log, leave_out_copies, read_records
from circlecal.records.record import ResultRecord

SCORED_FIELD = "soccer"
"""The field whose markings and sizes the metrics have."""
USUAL_SIZES: tuple[Size, ...] = ((640, 360), (960, 540), (1280, 720), (1920, 1080), (3840, 2160))
SIZE_TOLERANCE = 0.06
"""Share by which twice the principal point may differ from the size that it is taken for: half a pixel beside the
centre is 0.1 %, a centre that was estimated some per cent, and the next usual size a quarter.
"""
ONE_BY_ONE = "evaluate one folder after the other, or give their frames different names"
"""What helps where the frames of clips are numbered alike."""
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


class _FrameTruth(FileModel):
    """What ``circlecal synth`` writes beside a frame, as far as it is read."""

    id: str
    width: Side
    height: Side
    field: str
    expect: Literal["calibrate", "refuse"]
    camera: CameraKeys
    crown_m: Bounded
    crown_shape: SurfaceShape
    crown_reference_m: Focal


_CLIP_TRUTH = Format(
    name="circlecal synth --video", recognises=lambda c: c.mapping.keys() >= {"shots", "frames", "tripod"}
)
_TRUTH = Format(name="circlecal synth", recognises=lambda c: c.mapping.keys() >= {"expect", "camera", "crown_m"})


def read_annotated_points(folder: Path, size: Size) -> dict[str, Annotated]:
    """Annotated points (N, 2) in pixels at ``size``, by frame and class, without empty classes, marks and meets of
    lines: circlecal writes these beside SoccerNet's classes, and the metric does not have them.

    Raises
    ------
    InputError
        No such folder, no annotation in it, a damaged file or an unknown class, or one frame in two folders.
    """
    files = [path for path in _sources(folder) if path.suffix == ".json"]
    files = [path for path in files if not path.name.startswith(("camera_", "extremities_"))]
    found: dict[str, Annotated] = {}
    places = FramePlaces(ONE_BY_ONE, in_one_folder=True)
    marks = load_field(SCORED_FIELD).mark_by_name
    for path in files:
        known, content = open_file(path)
        if known is not soccernet.FORMAT:
            continue
        classes: dict[str, Array] = {}
        for shape in soccernet.read(path, content.raw, size)[0].shapes:
            if shape.label in marks or MEET in shape.label:
                continue
            if shape.label not in CLASSES:
                raise InputError(f"{path}: {shape.label}: is no class of SoccerNet; correct its spelling")
            earlier = classes.get(shape.label, np.zeros((0, 2)))
            classes[shape.label] = np.concatenate([earlier, shape.points_px])
        places.enter(path, path.stem)
        found[path.stem] = classes
    if not found:
        raise InputError(f"{folder}: holds no line annotation of SoccerNet (<id>.json)")
    return found


def holds_cameras(folder: Path) -> bool:
    """Whether a folder of truth holds cameras, homographies or results, instead of annotations.

    Raises
    ------
    InputError
        No such folder, or a file of no known format.
    """
    sources = _sources(folder)
    files = [path for path in sources if not is_log(path)]
    return bool(sources) and all(not isinstance(_open(path)[0], AnnotationFormat) for path in files)


def read_predictions(folder: Path, size: Size, given_size: Size | None = None) -> dict[str, Prediction]:
    """Cameras of a folder by frame, at ``size``; refused results of circlecal are left out.

    Parameters
    ----------
    folder : path
        ``camera_<id>.json``, results of circlecal (``<id>.json``, ``results.jsonl``), ``<id>.homographyMatrix``,
        or the truth of frames and clips of ``circlecal synth``; also in subfolders. Of a folder with a
        ``results.jsonl`` that alone is read, and nothing beside or below it. Of truth soccer frames are read in which
        enough to calibrate is in view, of a clip those that show the pitch.
    size : (int, int)
        At which is evaluated.
    given_size : (int, int), optional
        For which the cameras were made; read off the principal point where None.

    Raises
    ------
    InputError
        No such folder, no camera of a soccer field in it, a damaged file, or one frame in two folders.
    """
    found: dict[str, Prediction] = {}
    others: set[str] = set()
    places = FramePlaces(ONE_BY_ONE, in_one_folder=True)
    for path in _sources(folder):
        held = _read_source(path, size, given_size)
        for frame_id in held.ids:
            places.enter(path, frame_id)
        found |= held.predictions
        others |= held.other_fields
    if not found and others:
        raise InputError(
            f"{folder}: holds cameras of {' and '.join(sorted(others))}, and the metrics are those of {SCORED_FIELD} "
            "fields; give frames of these"
        )
    if not found:
        raise InputError(
            f"{folder}: holds no camera of a soccer field; camera_<id>.json, results or <id>{MATRIX_SUFFIX} are read"
        )
    return found


def _sources(folder: Path) -> list[Path]:
    """Files of a folder that may hold annotations or cameras, of a run its results alone."""
    if not is_folder(folder):
        raise InputError(f"{folder}: is no folder; give one with a file per frame")
    files = leave_out_copies(find_files(folder, (".json", MATRIX_SUFFIX, ".jsonl")))
    return [path for path in files if path.suffix != ".jsonl" or path.name == RESULTS_NAME or is_log(path)]


@dataclass(frozen=True, slots=True)
class _Held:
    """What a file holds: the frames that it is of, what it predicts of them, and fields of other sports."""

    ids: frozenset[str] = frozenset()
    predictions: Mapping[str, Prediction] = field(default_factory=dict)
    other_fields: frozenset[str] = frozenset()


def _read_source(path: Path, size: Size, given_size: Size | None) -> _Held:
    """What a file holds.

    Raises
    ------
    InputError
        It is damaged, or of no known format.
    """
    if path.suffix == ".jsonl":
        return _of_records(read_records(path), size)
    known, content = _open(path)
    if known is RESULT:
        return _of_records([read_result(path)], size)
    if known is _TRUTH:
        truth = parse_content(_FrameTruth, path, content.raw)
        return _Held(frozenset({truth.id}), _true_camera(path, truth, size), frozenset({truth.field} - {SCORED_FIELD}))
    if known is _CLIP_TRUTH:
        return _of_clip(parse_clip_truth(path, content.raw), size)
    found: dict[str, Prediction] = {}
    if known is soccernet_camera.FORMAT:
        keys = parse_content(CameraKeys, path, content.raw)
        frame_id = path.stem.removeprefix(soccernet_camera.PREFIX)
        found = {frame_id: Prediction(_soccernet(path, keys, size, given_size))}
    elif isinstance(known, CameraFormat):
        found = _further(known.read(path, content.raw, given_size), size)
    return _Held(frozenset(found), found)


def _of_records(records: Iterable[ResultRecord], size: Size) -> _Held:
    """What results hold: a frame that was refused is one that they are of."""
    ids: set[str] = set()
    found: dict[str, Prediction] = {}
    others: set[str] = set()
    for record in records:
        ids.add(record.id)
        found |= _own_result(record, size)
        others |= _other_field(record)
    return _Held(frozenset(ids), found, frozenset(others))


def _open(path: Path) -> tuple[Format, Content]:
    """Format and content of a file, which may be the truth of a frame or clip of ``circlecal synth``.

    Raises
    ------
    InputError
        Unreadable, or of no known format.
    """
    content = Content.of(path)
    known = next((truth for truth in (_TRUTH, _CLIP_TRUTH) if truth.recognises(content)), None)
    return open_file(path) if known is None else (known, content)


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
            found[frame.id] = _predict_by_homography(frame.H_image_field, factor)
    return found


def _predict_by_homography(H_image_field: Array, factor: tuple[float, float]) -> Prediction:
    H = np.diag([*factor, 1.0]) @ H_image_field
    return Prediction(PlaneHomography(H), H)


def _other_field(stored: ResultRecord) -> set[str]:
    """The name of the field of a result where it is another than the one that is scored."""
    return set() if stored.field is None else {stored.field.template} - {SCORED_FIELD}


def _own_result(stored: ResultRecord, size: Size) -> dict[str, Prediction]:
    """A result of circlecal; none where it was refused, or is of another field than the one that is scored."""
    if _other_field(stored):
        return {}
    template = load_field(SCORED_FIELD)
    frame = CalibratedFrame.of(stored, template, template.circle_by_name[template.default_circle])
    if frame is None:
        return {}
    if frame.camera is None:
        return {frame.id: _predict_by_homography(frame.H_image_field, _factor((frame.width, frame.height), size))}
    return _flat(frame, size)


def _of_clip(truth: ClipTruth, size: Size) -> _Held:
    """The cameras of a rendered clip, by the names that its frames get; none of frames in which no pitch is shown."""
    ids = [name_of_frame(truth.id, frame.time_s) for frame in truth.frames]
    if truth.field != SCORED_FIELD:
        return _Held(frozenset(ids), other_fields=frozenset({truth.field}))
    found: dict[str, Prediction] = {}
    for index, identifier in enumerate(ids):
        camera = truth.camera(index)
        if camera is not None:
            found |= _true_view(identifier, FieldView(camera, truth.surface), size)
    return _Held(frozenset(ids), found)


def _true_camera(path: Path, truth: _FrameTruth, size: Size) -> dict[str, Prediction]:
    """The camera of a rendered frame; none of a field or view that is not scored."""
    if truth.field != SCORED_FIELD or truth.expect == "refuse":
        return {}
    camera = truth.camera.camera(path, (truth.width, truth.height))
    surface = Surface(truth.crown_shape, truth.crown_reference_m, truth.crown_m)
    return _true_view(truth.id, FieldView(camera, surface), size)


def _true_view(identifier: str, view: FieldView, size: Size) -> dict[str, Prediction]:
    """A frame of the scored field, as its true camera shows it."""
    template = load_field(SCORED_FIELD)
    circle = template.circle_by_name[template.default_circle]
    return _flat(CalibratedFrame(identifier, view.camera.width, view.camera.height, view, template, circle), size)


def _flat(frame: CalibratedFrame, size: Size) -> dict[str, Prediction]:
    """Where the surface is crowned, the flat camera nearest to what the frame shows."""
    if frame.flat is None:
        return {}
    scaled = MetricCamera.from_camera(frame.flat).resize(_factor((frame.width, frame.height), size))
    return {frame.id: Prediction(scaled)}


def is_central(annotated: Annotated) -> bool:
    """Whether a frame is a central view: the circle is visible, and fewer than three straight lines on the ground."""
    straight = [name for name in annotated if name in soccernet.LINE_CLASSES and not name.startswith("Goal")]
    return CENTRAL_CLASS in annotated and len(straight) <= _MAX_LINES_CENTRAL


def shows_circle_and_halfway(annotated: Annotated) -> bool:
    """Whether circle and halfway line are annotated."""
    return CENTRAL_CLASS in annotated and HALFWAY_CLASS in annotated
