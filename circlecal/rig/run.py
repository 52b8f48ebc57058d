"""From the results of a run to cameras, prior files, and the results of every frame with them."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import logging
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from circlecal.batch import BatchProgress, run_batch
from circlecal.batch.frames import calibrate_frame, picture_of_record
from circlecal.config import Config, config_digest, suit_pixels
from circlecal.errors import CirclecalError, InputError
from circlecal.field import FieldTemplate
from circlecal.files import is_file, is_folder, read_table, read_text, real_path
from circlecal.formats.annotation import Flag
from circlecal.formats.cameras import THINNEST_PAINT_M
from circlecal.formats.registry import annotation_suffixes
from circlecal.names import from_cell
from circlecal.pictures.limits import LimitsConfig
from circlecal.pictures.remote import is_url
from circlecal.pipeline import Convention, apply_convention, field_of, run_observations
from circlecal.records.camera_prior import prior_settings, write_prior
from circlecal.records.log import ResultLog, read_records
from circlecal.records.parts import AloneRecord, RigRecord
from circlecal.records.record import ResultRecord, ResultRow
from circlecal.records.writing import result_record
from circlecal.results import FrameCalibration
from circlecal.rig.estimation import Rig, config_with_prior, estimate_rigs, summarise_shared
from circlecal.rig.frames import RigFrame, frame_of_record
from circlecal.rig.recalibration import Recalibration, find_refusal, recalibrate
from circlecal.rig.tripod_of_rig import venue_of_rigs
from circlecal.rig.venue import VENUE_NAME, read_venue_file, write_venue

_log = logging.getLogger(__name__)

LARGEST_ARC_RESIDUAL_PX = 1.0
"""Rms distance of a short arc from where the known camera puts the circle, pixels at 1920 px width, beyond which it is
another one.
"""


@dataclass(slots=True)
class RigReport:
    """What a run brought.

    Attributes
    ----------
    rigs : list of Rig
        The cameras.
    frames, calibrated_alone, calibrated : int
        Frames in all, and those calibrated before and after.
    by_camera : dict
        Frames of each camera by name, recalibrated ones.
    gained, kept : list of str
        Frames that were refused alone and succeed now; frames that stay as they were although calibrated.
    missing : list of str
        Files of refused frames that are not there, so that these could not be looked at again.
    """

    rigs: list[Rig] = field(default_factory=list)
    frames: int = 0
    calibrated_alone: int = 0
    calibrated: int = 0
    by_camera: dict[str, list[str]] = field(default_factory=dict)
    gained: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    def count(self, record: ResultRow) -> None:
        """Take a frame's new record into the counts."""
        rig = record.rig
        if rig is None:
            return
        after = record.status == "calibrated"
        before = rig.alone is not None and rig.alone.status == "calibrated"
        self.calibrated += after
        if rig.camera is not None:
            self.by_camera.setdefault(rig.camera, []).append(record.id)
        if after and not before:
            self.gained.append(record.id)
        if before and rig.camera is None:
            self.kept.append(record.id)

    def summary(self) -> dict[str, Any]:
        """Counts, and position, roll and distortion (mean and standard deviation, None where fixed) of each camera."""
        cameras = []
        for rig in self.rigs:
            values = summarise_shared(rig)
            told = {name: list(values[name]) if name in values else None for name in ("x", "y", "z", "kappa_1")}
            roll = values.get("roll")
            cameras.append(
                {
                    "camera": rig.name,
                    "frames": len(self.by_camera.get(rig.name, ())),
                    "used": len(rig.used),
                    "left_out": list(rig.left_out),
                    **told,
                    "roll_deg": None if roll is None else [math.degrees(v) for v in roll],
                }
            )
        return {
            "frames": self.frames,
            "calibrated_alone": self.calibrated_alone,
            "calibrated": self.calibrated,
            "gained": self.gained,
            "kept": self.kept,
            "missing": self.missing,
            "cameras": cameras,
        }


def run_rig(
    results: Path,
    config: Config,
    out: Path,
    *,
    workers: int = 1,
    cameras: Mapping[str, str] | None = None,
    mask: Path | None = None,
    convention: Convention = "official",
    restart: bool = False,
    on_progress: Callable[[BatchProgress], None] = lambda progress: None,
) -> RigReport:
    """Estimate the cameras of a run and calibrate every frame again with them.

    Parameters
    ----------
    results : path
        Folder of a batch, ``results.jsonl``, or folder of result files.
    config : Config
        The configuration of the run.
    out : path
        Folder of ``results.jsonl``, ``summary.csv``, ``venue.yaml`` and one prior file per camera, the last two where
        any camera is found; frames that it already holds are skipped.
    workers : int
        Number of processes that calibrate the frames again.
    cameras : mapping, optional
        Name of the camera by frame; otherwise frames are grouped by where their cameras stand.
    mask : path, optional
        Mask folder of the run, for frames that are calibrated again from their pictures.
    convention : {"official", "paint"}
        Where points of annotation files lie, as in the run.
    restart : bool
        Start over: drop what the folder holds.
    on_progress : callable
        As for :func:`circlecal.batch.run_batch`.

    Raises
    ------
    InputError
        The results are damaged or of another field, or a file cannot be written.
    """
    if real_path(out) == real_path(results if is_folder(results) else results.parent):
        raise InputError(f"{out}: holds the results of the run; choose another --out")
    template, circle = field_of(config)
    frames, said, missing, annotated = [], list[tuple[str, str | None]](), list[str](), False
    for record in read_records(results):
        _require_same_field(record, template, results)
        if record.track is not None:
            raise InputError(
                f"{results}: {record.id} is of circlecal track, whose frames share their camera already; its "
                f"{VENUE_NAME} has that camera"
            )
        annotated = annotated or _leaves_convention(record)
        said += [(record.id, record.annotation)] if record.annotation is not None else []
        missing += [] if _is_there(record) else [str(record.path)]
        # what was seen of the frames that are estimated together is read again below: a run may be long
        frames.append(frame_of_record(record, results).without_points())
    unknown = sorted((cameras or {}).keys() - {frame.id for frame in frames})
    if unknown:
        told = f"a camera is named for {unknown[0]}" + f" and {len(unknown) - 1} more" * (len(unknown) > 1)
        raise InputError(f"{results}: {told}, which are no frames of this run")
    seen_as = apply_convention(template, convention) if annotated else template

    def read_frames(wanted: Collection[str]) -> dict[str, RigFrame]:
        return {r.id: frame_of_record(r, results) for r in read_records(results) if r.id in wanted}

    rigs = estimate_rigs(frames, seen_as, circle, config, cameras, read_frames)
    task = RigTask(config, tuple(rigs), cameras, mask, convention, annotated, tuple(said))
    with ResultLog(out, restart) as log:  # a folder of another run stays as it is
        log.take_up(task.digest)
        for old in _find_priors(out):
            old.unlink(missing_ok=True)
        for rig in rigs:
            write_camera(out / f"{rig.name}.yaml", rig, config)
        if rigs:
            write_venue(out / VENUE_NAME, venue_of_rigs(rigs, template.name), template)
        else:
            (out / VENUE_NAME).unlink(missing_ok=True)
    again = (RecordedFrame(record.id, record) for record in read_records(results))
    run_batch(again, task, out, workers=workers, total=len(frames), restart=restart, on_progress=on_progress)
    report = RigReport(rigs, len(frames), sum(f.theta is not None for f in frames), missing=missing)
    for row in read_records(out, ResultRow):
        report.count(row)
    return report


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """A frame by its record."""

    id: str
    record: ResultRecord


@dataclass(frozen=True)
class RigTask:
    """Calibrating the frames of a run again, in any process.

    Attributes
    ----------
    config, rigs, cameras, mask, convention
        As for :func:`run_rig`.
    annotated : bool
        Whether the run's frames come from annotation files.
    said : tuple of (str, str or None)
        Frames of which a person said something, and the digests of that.
    """

    config: Config
    rigs: tuple[Rig, ...]
    cameras: Mapping[str, str] | None
    mask: Path | None
    convention: Convention
    annotated: bool
    said: tuple[tuple[str, str | None], ...] = ()

    @property
    def seed(self) -> int:
        """Seed of the random draws."""
        return self.config.seed

    @property
    def limits(self) -> LimitsConfig:
        """What a frame may take."""
        return self.config.limits

    @cached_property
    def digest(self) -> str:
        """Digest of the configuration, of what was given with it, and of the cameras that were found."""
        told = [
            config_digest(self.config),
            self.config.rig.model_dump(mode="json"),
            sorted((self.cameras or {}).items()),
            [(rig.name, rig.used, np.round(rig.state.common, 6).tolist()) for rig in self.rigs],
            [str(self.mask), self.convention, self.said],
        ]
        return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:12]

    def source(self, frame: RecordedFrame) -> str:
        """File of a frame."""
        return str(frame.record.path)

    def record(self, frame: RecordedFrame) -> ResultRecord:
        """The frame's new record; its old one where nothing better was found."""
        template, circle = field_of(self.config)
        if frame.record.annotation is not None and frame.record.code in get_args(Flag):
            told = Recalibration(None, None, "a person says that it was not taken by one of them")
            return _new_record(frame.record, told, template, self.digest)
        seen_as = apply_convention(template, self.convention) if self.annotated else template
        seen = frame_of_record(frame.record, Path(self.source(frame)))
        again = _Again(frame.record, seen, self.config, self.mask, self.convention)
        # a frame that the list leaves out is of none of them
        known = None if self.cameras is None else self.cameras.get(frame.id, "")
        found = again.confirm(recalibrate(seen, self.rigs, again, seen_as, circle, self.config, known))
        told_as = seen_as if _leaves_convention(frame.record) else template
        return _new_record(frame.record, found, told_as, self.digest)


def _find_priors(out: Path) -> list[Path]:
    """The prior files of an earlier run in a folder: of unnamed cameras, and of those that its venue lists."""
    venue, listed = out / VENUE_NAME, list[Path]()
    if is_file(venue):
        with contextlib.suppress(InputError):  # of another program, or damaged
            listed = [out / f"{tripod.name}.yaml" for tripod in read_venue_file(venue).tripods]
    return [*out.glob("camera-*.yaml"), *filter(_is_prior, listed)]


def _is_prior(path: Path) -> bool:
    """Whether a file is a prior of a camera, and not something of the user's that has its name."""
    try:
        return bool(prior_settings(path))
    except CirclecalError:
        return False


def read_cameras(path: Path) -> dict[str, str]:
    """Names of cameras by frame from a CSV file with the columns ``id`` and ``camera``.

    Raises
    ------
    InputError
        Unreadable, without these columns, or a name that no file can have.
    """
    found: dict[str, str] = {}
    for number, row in read_table(io.StringIO(read_text(path), newline=""), str(path), ("id", "camera")):
        frame, camera = from_cell(row["id"]), row["camera"]
        if not frame or not camera:
            raise InputError(f"{path}, line {number}: needs the columns id and camera, both filled")
        if not re.fullmatch(r"[\w.-]+", camera) or camera.startswith("."):
            raise InputError(f"{path}, line {number}: camera {camera!r} is no name; use letters, digits, . _ and -")
        if f"{camera}.yaml".casefold() == VENUE_NAME:
            raise InputError(
                f"{path}, line {number}: camera {camera!r} is the name of {VENUE_NAME}; choose another one"
            )
        if found.get(frame, camera) != camera:
            raise InputError(f"{path}, line {number}: {frame} is of {camera} here, and of {found[frame]} before")
        found[frame] = camera
    if not found:
        raise InputError(f"{path}: names no camera; give a CSV file with id,camera")
    return found


@dataclass(slots=True)
class _Again:
    """Calibrates one frame of a run again: from its picture where it was refused, otherwise from what was seen.

    The picture is measured with the first camera that is tried; a further camera takes what was seen of it then, and
    is confirmed in the picture where it is the one that explains the frame.
    """

    record: ResultRecord
    frame: RigFrame
    config: Config
    mask: Path | None
    convention: Convention

    measured: FrameCalibration | None = field(default=None, init=False)

    def __call__(self, config: Config) -> FrameCalibration | None:
        refused, annotated = self.frame.theta is None, _is_annotated(self.record)
        from_picture = refused and not annotated and self.record.annotation is None and _has_picture(self.record)
        if from_picture and self.measured is None:
            self.measured = self._look(config)
            return None if self.measured is None or _leaves_the_arc(self.measured) else self.measured
        seen = self.frame.observations if self.measured is None else self.measured.attempt.observations
        if seen is None:
            return self.measured
        convention: Convention = self.convention if _leaves_convention(self.record) else "paint"
        config = suit_pixels(config, self.frame.aspect)
        found = run_observations(
            seen, config, frame_id=self.frame.id, source=str(Path(self.record.path or "")), convention=convention
        )
        return None if from_picture and _leaves_the_arc(found) else found

    def confirm(self, found: Recalibration) -> Recalibration:
        """The camera that explains a refused frame, if its markings are in the picture: points alone do not tell."""
        if self.measured is None or found.rig is None or found.calibration is self.measured:
            return found
        prior = found.rig.prior(self.frame.id, self.frame.theta)
        config = config_with_prior(self.config, prior, found.rig.size[0])
        looked = self._look(config)
        reason = find_refusal(looked, self.frame, found.rig)
        if reason is None and looked is not None and _leaves_the_arc(looked):
            reason = f"its arc is not where {found.rig.name} sees the circle"
        return replace(found, calibration=looked) if reason is None else Recalibration(None, None, reason)

    def _look(self, config: Config) -> FrameCalibration | None:
        """The whole chain, from the picture; None where it cannot be read."""
        try:
            return calibrate_frame(picture_of_record(self.record), accept_short_arcs(config), self.mask)[1]
        except CirclecalError as error:
            _log.warning("%s", error)
            return None


def accept_short_arcs(config: Config) -> Config:
    """The configuration with a detector that measures arcs that only a known camera can tell from others."""
    rig, acceptance = config.rig, config.mask.detector.acceptance
    update = {
        "whole_share": min(acceptance.whole_share, rig.whole_share),
        "whole_share_with_line": min(acceptance.whole_share_with_line, rig.whole_share),
        "share_of_lone_arc": min(acceptance.share_of_lone_arc, rig.share_of_lone_arc),
    }
    detector = config.mask.detector.model_copy(update={"acceptance": acceptance.model_copy(update=update)})
    return config.model_copy(update={"mask": config.mask.model_copy(update={"detector": detector})})


def _leaves_the_arc(found: FrameCalibration) -> bool:
    """Whether the circle of an accepted camera leaves what was measured: then the arc was another one."""
    if found.attempt.camera is None:
        return False
    limit = LARGEST_ARC_RESIDUAL_PX * found.width / 1920.0
    return any(rms > limit for key, rms in found.attempt.camera.residuals_px.items() if key.name == found.circle_name)


def _is_annotated(record: ResultRow) -> bool:
    return record.path is not None and Path(record.path).suffix.lower() in annotation_suffixes()


def _leaves_convention(record: ResultRecord) -> bool:
    """Whether a frame is of an annotation file, and nothing tells that its points lie on the middle of the paint."""
    marking_m = None if record.field is None else (record.field.sizes or {}).get("marking")
    return _is_annotated(record) and (marking_m is None or marking_m < THINNEST_PAINT_M)


def _has_picture(record: ResultRow) -> bool:
    """Whether the picture of a frame, or its video, is where the record says."""
    return is_url(record.path or "") or is_file(Path(record.path or ""))


def _is_there(record: ResultRow) -> bool:
    """Whether what a refused frame is to be looked at in again is there; others are not looked at."""
    is_looked_at = record.status == "refused" and record.annotation is None and not _is_annotated(record)
    return not is_looked_at or record.path is None or _has_picture(record)


def _require_same_field(record: ResultRow, template: FieldTemplate, results: Path) -> None:
    if record.field is not None and record.field.template != template.name:
        raise InputError(
            f"{results}: {record.id} is of the field {record.field.template}, not {template.name}; give its --field"
        )


def _new_record(record: ResultRecord, found: Recalibration, template: FieldTemplate, digest: str) -> ResultRecord:
    """The new record of a frame; the old one where nothing better was found."""
    written = record if found.calibration is None else result_record(found.calibration, template)
    rig = RigRecord(
        camera=None if found.rig is None else found.rig.name,
        reason=found.reason,
        alone=AloneRecord(status=record.status, code=record.code, reason=record.reason),
    )
    kept = {} if record.annotation is None else {"annotation": record.annotation}
    return written.model_copy(update={"source": record.source, "config_digest": digest, "rig": rig, **kept})


def write_camera(path: Path, rig: Rig, config: Config) -> None:
    """Write a camera as a prior file that ``--camera-prior`` reads.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    camera = config_with_prior(config, rig.prior(), rig.size[0]).camera
    if camera.shared is None or camera.position_m is None:
        raise ValueError(f"{rig.name} has no prior")
    values = summarise_shared(rig)
    about = {"camera": rig.name, "frames": list(rig.used), "left_out": list(rig.left_out)}
    settings: dict[str, Any] = {
        "position_m": list(camera.position_m),
        "position_sd_m": list(camera.position_sd_m),
        "shared": camera.shared.model_dump(mode="json"),
    }
    write_prior(path, settings, about, values)
