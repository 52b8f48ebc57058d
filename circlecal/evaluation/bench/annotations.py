"""``circlecal bench annotations``: annotated real frames, the published peers first, then circlecal on the same frames.

A folder of data holds one folder per set, each with ``ground_truth`` (SoccerNet line annotations) and, where there are
any, ``<peer>_camera`` (SoccerNet cameras) and ``pnlcalib_keypoints`` (detections). Nothing of it is part of circlecal.

Each set is scored on its frames with circle and halfway line, on the central views among them, and on every frame,
with the circle or without; a frame without an answer counts 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.evaluation.aggregate import compare_frames, summarise_method
from circlecal.evaluation.bench import other_frames
from circlecal.evaluation.bootstrap import Interval, bootstrap_mean
from circlecal.evaluation.reading import (
    CENTRAL_CLASS,
    HALFWAY_CLASS,
    Annotated,
    Prediction,
    is_central,
    read_annotated_points,
    read_predictions,
    shows_circle_and_halfway,
)
from circlecal.evaluation.soccernet_metric import MetricCamera, PlaneHomography, Projector
from circlecal.field import Circle, FieldTemplate
from circlecal.formats.cameras import CalibratedFrame, Size
from circlecal.formats.meaning import read_observations
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.pipeline import field_of, run_observations
from circlecal.solvers.great_axis import solve as solve_great_axis

SIZE: Size = (1920, 1080)
THRESHOLDS_PX = (5.0, 10.0)
INPUTS = ("circle and halfway line", "the same, ends unused", "all lines", "detections of PnLCalib")
PUBLISHED = "picture (published)"
KINDS = ("circle and halfway line", "central views", "all")
_TRUTH, _DETECTIONS, _CAMERAS = "ground_truth", "pnlcalib_keypoints", "_camera"
Solve = Callable[[str, Observations], Projector | None]


@dataclass(frozen=True, slots=True)
class AnnotationRow:
    """One method with one input on one set; JaC at 5 and 10 px of 1920 x 1080, misses as 0.

    ``frames_kind`` says which frames count: one of ``KINDS``;
    ``held_out_px`` is the median distance of the elements other than circle and halfway line, which the inputs of all
    lines and of detections do not keep from circlecal; ``ahead`` the paired difference to the first peer's JaC at 5 px.
    """

    set_name: str
    frames_kind: str
    method: str
    input_name: str
    frames: int
    answered: int
    jac_5: float
    jac_10: float
    held_out_px: float
    ahead: Interval | None


@dataclass(frozen=True, slots=True)
class _Set:
    """Frames of one set: its name, which frames they are, their annotations, and its folder."""

    name: str
    kind: str
    annotated: Mapping[str, Annotated]
    folder: Path


def set_names(path: Path) -> list[str]:
    """Names of the sets in a folder of data.

    Raises
    ------
    InputError
        There is none.
    """
    found = sorted(folder.parent.name for folder in path.glob(f"*/{_TRUTH}") if folder.is_dir())
    if not found:
        raise InputError(f"{path}: holds no set; give a folder of <set>/{_TRUTH}/<id>.json")
    return found


def run_annotations(
    path: Path, config: Config, names: Sequence[str] = (), advance: Callable[[str], None] = lambda _: None
) -> list[AnnotationRow]:
    """Score peers and circlecal.

    Parameters
    ----------
    path : path
        Folder of data.
    config : Config
        Of circlecal.
    names : sequence of str
        Sets; all where empty.
    advance : callable
        Told the name of each set that is done.

    Raises
    ------
    InputError
        A set that is not there, or damaged files.
    """
    rows = []
    for name in names or set_names(path):
        folder = path / name
        rows += _set_rows(_Set(name, KINDS[2], read_annotated_points(folder / _TRUTH, SIZE), folder), config)
        advance(name)
    return rows


def _set_rows(data: _Set, config: Config) -> list[AnnotationRow]:
    methods = _peers(data)
    template, circle = field_of(config)
    official = template.model_copy(update={"marking_width_m": 1e-9, "marking_width_sd_m": 0.0})
    clicked = _observe(data, _TRUTH, template, config)
    both = {frame: classes for frame, classes in data.annotated.items() if shows_circle_and_halfway(classes)}
    alone = {frame: only_circle_and_halfway(clicked[frame], template, circle) for frame in both}
    great_axis = _great_axis(official, circle)
    methods["great axis", INPUTS[0]] = _solve(alone, great_axis)
    own = _own(config, template, circle)
    methods["circlecal", INPUTS[0]] = _solve(alone, own)
    if any(seen.keypoints for seen in alone.values()):
        methods["circlecal", INPUTS[1]] = _solve({k: replace(v, keypoints=()) for k, v in alone.items()}, own)
    methods["circlecal", INPUTS[2]] = _solve(clicked, own)
    runs = other_frames.matches(_positions(data, methods))
    if runs:
        methods["circlecal", other_frames.INPUT] = other_frames.calibrate_with_other_frames(
            alone, clicked, runs, template, circle, config
        )
    if (data.folder / _DETECTIONS).is_dir():
        methods["circlecal", INPUTS[3]] = _solve(_observe(data, _DETECTIONS, template, config), own)
    central = {frame: classes for frame, classes in both.items() if is_central(classes)}
    few = {(method, name) for method, name in methods if name in (INPUTS[0], INPUTS[1], other_frames.INPUT)}
    rows = _rows(replace(data, kind=KINDS[0], annotated=both), methods) if both else []
    rows += _rows(replace(data, kind=KINDS[1], annotated=central), methods) if central else []
    return rows + _rows(data, {key: found for key, found in methods.items() if key not in few})


_Methods = dict[tuple[str, str], Mapping[str, Prediction]]


def _peers(data: _Set) -> _Methods:
    folders = sorted(folder for folder in data.folder.glob(f"*{_CAMERAS}") if folder.is_dir())
    folders.sort(key=lambda folder: not folder.name.startswith("pnlcalib"))
    return {(f.name.removesuffix(_CAMERAS), PUBLISHED): read_predictions(f, SIZE) for f in folders}


def _positions(data: _Set, methods: _Methods) -> dict[str, Array]:
    """Positions (K, 3) of each frame's camera by the peers, in the order of the frames."""
    peers = [cameras for (_, name), cameras in methods.items() if name == PUBLISHED]
    found = {}
    for frame in sorted(data.annotated, key=lambda name: (len(name), name)):
        cameras = [p[frame].camera for p in peers if frame in p]
        positions = [camera.position_m for camera in cameras if isinstance(camera, MetricCamera)]
        found[frame] = np.array(positions).reshape(-1, 3)
    return found


def _observe(data: _Set, folder: str, template: FieldTemplate, config: Config) -> dict[str, Observations]:
    files = {frame: data.folder / folder / f"{frame}.json" for frame in data.annotated}
    return {
        frame: read_observations(file, template, config.sources, SIZE)[0].observations
        for frame, file in files.items()
        if file.is_file()
    }


def only_circle_and_halfway(seen: Observations, template: FieldTemplate, circle: Circle) -> Observations:
    """What was seen of one circle and the halfway line, its ends on the touchlines included."""
    name = template.halfway_line
    return replace(
        seen,
        circles=tuple(c for c in seen.circles if c.circle == circle.name),
        lines=tuple(line for line in seen.lines if line.line == name),
        marks=(),
        keypoints=tuple(k for k in seen.keypoints if k.name.startswith(f"{name} end")),
    )


def _solve(observed: Mapping[str, Observations], solve: Solve) -> dict[str, Prediction]:
    cameras = {frame: solve(frame, seen) for frame, seen in observed.items()}
    return {frame: Prediction(camera) for frame, camera in cameras.items() if camera is not None}


def _own(config: Config, template: FieldTemplate, circle: Circle) -> Solve:
    def solve(frame: str, seen: Observations) -> Projector | None:
        found = CalibratedFrame.of(run_observations(seen, config, frame_id=frame), template, circle)
        camera = None if found is None else found.flat
        return None if camera is None else MetricCamera.from_camera(camera)

    return solve


def _great_axis(template: FieldTemplate, circle: Circle) -> Solve:
    def solve(frame: str, seen: Observations) -> Projector | None:
        H = solve_great_axis(seen, template, circle, np.random.default_rng(0)).H_image_field
        return None if H is None else PlaneHomography(H)

    return solve


def _is_held_out(name: str) -> bool:
    return name not in (CENTRAL_CLASS, HALFWAY_CLASS)


def _rows(data: _Set, methods: _Methods) -> list[AnnotationRow]:
    rows: list[AnnotationRow] = []
    first: Array | None = None
    for (method, input_name), predictions in methods.items():
        compared = compare_frames(data.annotated, predictions, *SIZE)
        summary = summarise_method(compared, THRESHOLDS_PX, _is_held_out)
        scores = compared.per_frame(THRESHOLDS_PX[0])
        ahead = None if first is None else bootstrap_mean(scores - first, np.random.default_rng(0))
        first = scores if first is None else first
        jac_5, jac_10 = (accuracy.final for accuracy in summary.accuracies)
        rows.append(
            AnnotationRow(
                data.name,
                data.kind,
                method,
                input_name,
                summary.frames,
                summary.answered,
                jac_5,
                jac_10,
                summary.held_out_px,
                ahead,
            )
        )
    return rows
