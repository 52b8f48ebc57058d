"""``circlecal bench track``: rendered clips with truth, every frame tracked and compared."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from circlecal.config import Config, suit_config
from circlecal.errors import InputError
from circlecal.evaluation.bench.detect import CHI2_90, GOOD_PX, WRONG_PX
from circlecal.evaluation.clip_truth import ClipTruth, read_clip_truth
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import ProjectionModel, project
from circlecal.geometry.projective import Array
from circlecal.pictures.video import Sampling, Video, pictures_at
from circlecal.pipeline import field_of
from circlecal.synthetic.clip_files import write_clips
from circlecal.synthetic.dataset import TRUTH_FOLDER
from circlecal.synthetic.video import ClipKind, ClipSpec
from circlecal.tracking.clip import track_frames
from circlecal.tracking.clock import Stage, StageClock
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.records import RecordForm, record_of_track, theta_of_view
from circlecal.tracking.results import TrackedFrame
from circlecal.tracking.survey import survey_clip

GRID_M = 3.0
"""Step of the grid over the pitch on which errors are taken."""
SECOND_DIFFERENCE = float(np.sqrt(6.0))
"""Standard deviation of a second difference of independent values of unit variance: 1 + 4 + 1 under the root."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ClipTime:
    """Where the time of a clip went: the survey in seconds, and milliseconds per frame of the rest; stages are parts
    of tracking.
    """

    survey_s: float
    decoding_ms: float
    tracking_ms: float
    record_ms: float
    stages_ms: Mapping[Stage, float] = field(default_factory=dict)

    @property
    def times_decoding(self) -> float:
        """A frame with everything but the survey, in multiples of decoding it."""
        return (self.decoding_ms + self.tracking_ms + self.record_ms) / self.decoding_ms


@dataclass(frozen=True, slots=True)
class TrackRow:
    """One clip; errors in pixels at 1920 px width.

    Attributes
    ----------
    clip, kind, width : str, str, int
        The clip.
    frames : int
        Frames of its main camera.
    answered, good, wrong : float
        Shares of these that are answered, within 5 px, and beyond 20 px.
    in_cuts, in_replays : int
        Frames that were calibrated where no pitch is shown, and where another camera shows it.
    median_px, p90_px : float
        Of the mean errors of the answered frames of the main camera.
    jitter_median_px, jitter_p90_px : float
        Of the second differences of the error of fixed points, by the root of 6.
    coverage : float
        Share of points whose true place lies in the reported 90 % region.
    tripods : int
        Names that the main camera got.
    found_again : tuple of int
        After each cut, main frames until the first good answer.
    time : ClipTime
        Where the time went.
    """

    clip: str
    kind: str
    width: int
    frames: int
    answered: float
    good: float
    wrong: float
    in_cuts: int
    in_replays: int
    median_px: float
    p90_px: float
    jitter_median_px: float
    jitter_p90_px: float
    coverage: float
    tripods: int
    found_again: tuple[int, ...]
    time: ClipTime


def render_and_track(
    kinds: Sequence[ClipKind],
    count: int,
    seed: int,
    spec: ClipSpec,
    config: Config,
    advance: Callable[[str], None] = lambda _: None,
) -> list[TrackRow]:
    """Render clips into a folder that is removed afterwards, and track each.

    Parameters
    ----------
    kinds, count, seed, spec : sequence, int, int, ClipSpec
        As for :func:`circlecal.synthetic.clip_files.write_clips`; all kinds where there are none.
    config : Config
        Options of tracking.
    advance : callable
        Called after each clip.
    """
    with tempfile.TemporaryDirectory(prefix="circlecal-bench-") as name:
        write_clips(Path(name), count, seed, spec, kinds)
        return track_folder(Path(name), config, advance)


def clips_of(folder: Path) -> list[tuple[Path, ClipTruth]]:
    """The clips of a folder that ``circlecal synth --video`` wrote, with their truth.

    Raises
    ------
    InputError
        There is none, or a truth is damaged.
    """
    found = []
    for path in sorted(folder.glob("*.mp4")):
        found.append((path, read_clip_truth(folder / TRUTH_FOLDER / f"{path.stem}.json")))
    if not found:
        raise InputError(f"{folder}: holds no clip; give a folder of circlecal synth --video")
    return found


def track_folder(folder: Path, config: Config, advance: Callable[[str], None] = lambda _: None) -> list[TrackRow]:
    """Track the clips of a folder of ``circlecal synth --video``, on one thread.

    Raises
    ------
    InputError
        As :func:`clips_of`.
    """
    cv2.setNumThreads(1)
    rows = []
    for path, truth in clips_of(folder):
        suited = config if truth.field == config.field.template else suit_config(config, truth.field)
        frames, spent = _track(Video.open(path, path.stem, config.limits), suited)
        rows.append(compare(frames, truth, spent))
        advance(path.stem)
    return rows


def _track(video: Video, config: Config) -> tuple[list[TrackedFrame], ClipTime]:
    start = time.perf_counter()
    venue = survey_clip(
        lambda times: pictures_at(video.path, times, exact=False), video.duration_s, config, period_s=1.0 / video.rate
    )
    survey_s = time.perf_counter() - start
    decoding, tracking = [0.0], [0.0]
    clock = StageClock()
    found = track_frames(_time_steps(_decode(video), decoding), venue, config, clock)
    frames = list(_time_steps(found, tracking))
    start = time.perf_counter()
    form = RecordForm(*field_of(config), config.seed, "")
    for frame in frames:
        record_of_track(frame, str(frame.index), video.name, frame.shot, form)
    record_s = time.perf_counter() - start
    count = max(len(frames), 1)
    both_ms, decoding_ms = 1e3 * tracking[0] / count, 1e3 * decoding[0] / count
    stages_ms = {stage: 1e3 * spent / count for stage, spent in clock.spent_s.items()}
    return frames, ClipTime(survey_s, decoding_ms, both_ms - decoding_ms, 1e3 * record_s / count, stages_ms)


def _time_steps(steps: Iterator[T], spent_s: list[float]) -> Iterator[T]:
    """Hand on steps, and add up the time that they take."""
    while True:
        start = time.perf_counter()
        step = next(steps, None)
        spent_s[0] += time.perf_counter() - start
        if step is None:
            return
        yield step


def _decode(video: Video) -> Iterator[ClipFrame]:
    for frame in video.frames(Sampling(None, 1)):
        if frame.picture is not None and frame.time_s is not None:
            yield ClipFrame(round(frame.time_s * video.rate), frame.time_s, frame.picture)


@dataclass(frozen=True, slots=True)
class _Compared:
    """Errors of one answered frame of the main camera, pixels at 1920 px width."""

    error_px: float
    inside: float


def compare(frames: Sequence[TrackedFrame], truth: ClipTruth, spent: ClipTime) -> TrackRow:
    """Compare the frames of a clip with their truth; a field that is turned by 180 degrees is the same one."""
    answers = {frame.index: frame for frame in frames if frame.status == "calibrated" and frame.view is not None}
    truth = truth.turn_field() if _are_turned(answers, truth) else truth
    main = [k for k, frame in enumerate(truth.frames) if frame.shot == "main"]
    compared = {k: _compare(answers[k], truth, k) for k in main if k in answers}
    errors = np.array([found.error_px for found in compared.values()])
    jitter = np.array([value for k in main if (value := _jitter_px(answers, truth, k)) is not None])
    kinds = [frame.shot for frame in truth.frames]
    return TrackRow(
        clip=truth.id,
        kind=truth.kind,
        width=truth.width,
        frames=len(main),
        answered=len(compared) / max(len(main), 1),
        good=float(np.sum(errors <= GOOD_PX)) / max(len(main), 1),
        wrong=float(np.sum(errors > WRONG_PX)) / max(len(main), 1),
        in_cuts=sum(kinds[k] == "cut" for k in answers if k < len(kinds)),
        in_replays=sum(kinds[k] == "replay" for k in answers if k < len(kinds)),
        median_px=_percentile(errors, 50),
        p90_px=_percentile(errors, 90),
        jitter_median_px=_percentile(jitter, 50),
        jitter_p90_px=_percentile(jitter, 90),
        coverage=float(np.mean([found.inside for found in compared.values()])) if compared else float("nan"),
        tripods=len({answers[k].tripod for k in compared}),
        found_again=tuple(_count_until_good(kinds, compared)),
        time=spent,
    )


def _are_turned(answers: Mapping[int, TrackedFrame], truth: ClipTruth) -> bool:
    """Whether the first answered frame of the main camera has it on the other side of the middle of the field."""
    for index, frame in sorted(answers.items()):
        camera = truth.camera(index) if index < len(truth.frames) and truth.frames[index].shot == "main" else None
        if camera is not None and frame.view is not None and isinstance(frame.view.camera, Camera):
            found = frame.view.camera.position_m
            away, turned = (np.linalg.norm(found - c.position_m) for c in (camera, camera.turn_field()))
            return bool(turned < away)
    return False


def _compare(frame: TrackedFrame, truth: ClipTruth, index: int) -> _Compared:
    camera, view = truth.camera(index), frame.view
    if camera is None or view is None:
        raise ValueError(f"frame {index} of {truth.id} has no camera to compare")
    grid = _grid_in_view(camera, truth)
    off = view.project(grid) - FieldView(camera, truth.surface).project(grid)
    seen = np.isfinite(off).all(axis=-1)
    if not seen.any():
        return _Compared(float("inf"), 0.0)
    inside = 0.0
    if view.covariance is not None and isinstance(view.camera, Camera):
        model, theta = ProjectionModel.of(view.camera, view.surface), theta_of_view(view)
        by_theta = project(theta[None], grid[None, seen], model).jacobians()[0][0]
        spread = np.einsum("nip,pq,njq->nij", by_theta, view.covariance, by_theta)
        distance = np.einsum("ni,nij,nj->n", off[seen], np.linalg.pinv(spread, hermitian=True), off[seen])
        inside = float(np.mean(distance < CHI2_90))
    return _Compared(float(np.linalg.norm(off[seen], axis=-1).mean()) * 1920.0 / truth.width, inside)


def _grid_in_view(camera: Camera, truth: ClipTruth) -> Array:
    """Points (N, 2) of the true pitch that the true camera shows."""
    axes = (np.arange(-half, half + 1e-9, GRID_M) for half in (truth.pitch.length_m / 2, truth.pitch.width_m / 2))
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    view = FieldView(camera, truth.surface)
    return np.asarray(grid[view.shows(view.project(grid))])


def _jitter_px(answers: dict[int, TrackedFrame], truth: ClipTruth, index: int) -> float | None:
    """Second difference of the errors of fixed points about a frame; None where a neighbour has no answer."""
    around = [index - 1, index, index + 1]
    views = [answers[k].view for k in around if k in answers and k < len(truth.frames)]
    cameras = [truth.camera(k) for k in around if 0 <= k < len(truth.frames) and truth.frames[k].shot == "main"]
    middle = truth.camera(index)
    if len(views) < 3 or len(cameras) < 3 or middle is None:
        return None
    grid = _grid_in_view(middle, truth)
    errors = [
        view.project(grid) - FieldView(camera, truth.surface).project(grid)
        for view, camera in zip(views, cameras, strict=True)
        if view is not None and camera is not None
    ]
    second = errors[0] - 2.0 * errors[1] + errors[2]
    sizes = np.linalg.norm(second[np.isfinite(second).all(axis=-1)], axis=-1)
    return float(sizes.mean()) / SECOND_DIFFERENCE * 1920.0 / truth.width if len(sizes) else None


def _count_until_good(kinds: Sequence[str], compared: dict[int, _Compared]) -> Iterator[int]:
    """After each cut back to the main camera, how many of its frames pass before the first good one."""
    for k, (before, kind) in enumerate(itertools.pairwise(kinds), start=1):
        if kind != "main" or before == "main":
            continue
        until = next((j for j in range(k, len(kinds)) if kinds[j] != "main"), len(kinds))
        good = (j for j in range(k, until) if j in compared and compared[j].error_px <= GOOD_PX)
        yield next(good, until) - k


def _percentile(values: Array, share: float) -> float:
    return float(np.percentile(values, share)) if len(values) else float("nan")


def spec_of(width: int, seconds: float, rate: float, look: str) -> ClipSpec:
    """What clips of a width, 16:9, a length, a rate and a look are to show; all else is that of :class:`ClipSpec`."""
    height = round(width * 9 / 32) * 2
    return replace(ClipSpec(), width=width, height=height, seconds=seconds, rate=rate, look=look)
