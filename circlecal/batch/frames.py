"""Calibrating one frame of a run, a picture or an annotation, and writing what belongs to it."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from circlecal import overlay
from circlecal.api.calls import calibrate_annotation, calibrate_picture, suit_annotation
from circlecal.config import Config, config_digest
from circlecal.detection.keypoints import require_keypoint_networks
from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.files import file_size, fingerprint
from circlecal.formats.annotation import Annotation, find_annotation
from circlecal.formats.cameras import Size
from circlecal.formats.exports import Exports
from circlecal.formats.inputs import FrameOfFile, observations_beside
from circlecal.formats.shapes import ObservedFrame
from circlecal.names import picture_name
from circlecal.pictures.files import (
    DEBUG_SUFFIX,
    OVERLAY_SUFFIX,
    RADAR_SUFFIX,
    STAGE_SHEET,
    PictureFile,
    decode_picture,
    path_in_folder,
    read_image,
    require_picture,
    write_image,
)
from circlecal.pictures.limits import LimitsConfig
from circlecal.pictures.masks import find_mask, read_mask
from circlecal.pictures.remote import is_url, read_url
from circlecal.pictures.video import pictures_at
from circlecal.pipeline import Convention, apply_convention, field_of, run_observations
from circlecal.records.json_text import write_result
from circlecal.records.parts import MaskRecord
from circlecal.records.record import ResultRecord
from circlecal.records.sources import is_another
from circlecal.records.writing import result_record
from circlecal.results import FrameCalibration
from circlecal.stages.mask import require_mask_network

_log = logging.getLogger(__name__)


def calibrate_frame(
    frame: PictureFile,
    config: Config,
    mask: Path | None,
    keypoints: Path | None = None,
    format_name: str | None = None,
) -> tuple[NDArray[np.uint8], FrameCalibration]:
    """Picture and calibration of a frame; its mask comes from ``mask`` (file or folder) or from beside the picture.

    Parameters
    ----------
    frame, config : PictureFile, Config
        The picture, and options.
    mask, keypoints : path, optional
        Masks, and keypoints or lines that are used together with the picture: a file, or a folder of files named like
        the frames.
    format_name : str, optional
        Format of the keypoints; recognised by content when None.

    Raises
    ------
    InputError
        The picture, its mask or its keypoints are unusable.
    """
    picture = _picture(frame, config.limits)
    height, width = picture.shape[:2]
    mask_file = find_mask(frame, mask)
    _log.info("%s: %d x %d, mask: %s", frame.path, width, height, mask_file or "from the picture")
    classes = None if mask_file is None else read_mask(mask_file, width, height, config.limits)
    if keypoints is None:
        given = None
    else:
        template, _ = field_of(config)
        given = observations_beside(keypoints, frame, template, config.sources, (width, height), format_name)
    found = calibrate_picture(
        picture, config, mask=classes, given=given, aspect=frame.aspect, frame_id=frame.id, source=frame.source
    )
    return picture, found


def examine_frame(
    frame: PictureFile,
    config: Config,
    mask: Path | None = None,
    keypoints: Path | None = None,
    annotations: Path | None = None,
) -> tuple[NDArray[np.uint8], FrameCalibration]:
    """Picture and calibration of a frame with what each stage found: where a person annotated it, the answer is that of
    the annotation, on its field, beside the mask, the edges and the rays of the picture.

    Parameters
    ----------
    frame, config, mask, keypoints
        As for :func:`calibrate_frame`.
    annotations : path, optional
        Folder of annotations of the workbench.

    Raises
    ------
    InputError
        The picture, its mask, its keypoints or its annotation are unusable.
    """
    stored = find_annotation(annotations, frame.id, frame.path)
    if stored is None:
        return calibrate_frame(frame, config, mask, keypoints)
    suited = suit_annotation(config, stored.annotation)
    picture, found = calibrate_frame(frame, config, mask, keypoints)
    annotation = stored.annotation.resize(picture.shape[1], picture.shape[0])
    seen, by_hand = found.attempt, calibrate_annotation(annotation, suited).attempt
    attempt = replace(by_hand, mask=seen.mask, edges=seen.edges, rays=seen.rays)
    return picture, replace(found, attempt=attempt, template=field_of(suited)[0])


def _picture(frame: PictureFile, limits: LimitsConfig) -> NDArray[np.uint8]:
    if frame.picture is not None:
        return frame.picture
    if frame.time_s is not None:
        raise InputError(f"{frame.path}: the frame at {frame.time_s:.3f} s cannot be decoded; copy or convert it again")
    if frame.url is not None:
        content = read_url(frame.url, limits)
        require_picture(frame.url, content, limits=limits)
        return decode_picture(frame.url, content)
    return read_image(frame.path, limits)


def calibrate_observations(
    frame: ObservedFrame, config: Config, source: Path, convention: Convention = "official"
) -> FrameCalibration:
    """Calibrate a frame of an annotation file; see :func:`circlecal.pipeline.run_observations`."""
    observations = frame.observations
    return run_observations(observations, config, frame_id=frame.id, source=str(source), convention=convention)


@dataclass(frozen=True)
class FrameRun:
    """How the frames of a run are calibrated and what is written of each; picklable where it has no exports.

    Attributes
    ----------
    config : Config
        Options.
    out : path, optional
        Folder of a result file and pictures of each frame; None writes none.
    exports : Exports, optional
        Outside formats that are written too; the caller finishes them.
    mask, keypoints, format_name : optional
        As for :func:`calibrate_frame`.
    size : (int, int), optional
        Size of the pictures where an annotation file has none.
    convention : {"official", "paint"}
        Where annotated points lie, of files that do not say it.
    annotations : path, optional
        Folder of annotations of the workbench: a frame that has one is calibrated from it alone.
    """

    config: Config
    out: Path | None = None
    exports: Exports | None = None
    mask: Path | None = None
    keypoints: Path | None = None
    format_name: str | None = None
    size: Size | None = None
    convention: Convention = "official"
    annotations: Path | None = None

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
        """Twelve hexadecimal digits over everything given for all frames together that can change an answer.

        Those of the configuration, where masks, keypoints and conventions are left to the frames.

        Raises
        ------
        InputError
            Masks or keypoints cannot be read.
        """
        given = {
            "mask": None if self.mask is None else fingerprint(self.mask),
            "keypoints": None if self.keypoints is None else fingerprint(self.keypoints),
            "format": self.format_name,
            "size": self.size,
            "convention": None if self.convention == "official" else self.convention,
        }
        of_config = config_digest(self.config)
        if not any(given.values()):
            return of_config
        return hashlib.sha256(json.dumps([of_config, given], sort_keys=True).encode()).hexdigest()[:12]

    def source(self, frame: PictureFile | FrameOfFile) -> str:
        """File of a frame."""
        return frame.source if isinstance(frame, PictureFile) else str(frame.path)

    def record(self, frame: PictureFile | FrameOfFile) -> ResultRecord:
        """Calibrate a picture or a frame of an annotation file, write what belongs to it, return its record.

        Raises
        ------
        InputError
            The frame is unusable, or a file cannot be written.
        """
        template, circle = field_of(self.config)
        if isinstance(frame, FrameOfFile):
            picture = None if self.out is None else _picture_of(frame, self.config.limits)
            if frame.annotation is None:
                convention: Convention = "paint" if frame.observed.on_paint else self.convention
                calibration = calibrate_observations(frame.observed, self.config, frame.path, convention)
                in_force = apply_convention(template, convention)
            else:
                calibration = self._calibrate_by_hand(frame.annotation, frame.id, str(frame.path))
                in_force = template = calibration.template or template
                circle = template.circle_by_name.get(calibration.circle_name, circle)
            record = result_record(calibration, in_force, digest=self.digest)
            if self.exports is not None:
                self.exports.add(record, in_force, circle, frame.image, frame.observed)
        else:
            picture, record, calibration = self._calibrate_picture(frame, template)
            if self.exports is not None:
                template = calibration.template or template
                circle = template.circle_by_name.get(calibration.circle_name, circle)
                self.exports.add(record, template, circle, picture_name(frame.id, str(frame.path)))
        record = tell_size(record, frame)
        if self.mask is None and isinstance(frame, PictureFile):
            record = tell_mask(record, frame)
        if self.out is not None:
            write_outputs(picture, calibration, record, self.config, self.out)
        return record

    def _calibrate_by_hand(self, annotation: Annotation, frame_id: str, source: str) -> FrameCalibration:
        """From what a person said of a frame in the workbench, alone or beside its picture, on the field of which it
        was said.
        """
        config = suit_annotation(self.config, annotation)
        template, _ = field_of(config)
        return replace(calibrate_annotation(annotation, config), id=frame_id, source=source, template=template)

    def _calibrate_picture(
        self, frame: PictureFile, template: FieldTemplate
    ) -> tuple[NDArray[np.uint8], ResultRecord, FrameCalibration]:
        """From its annotation where a person made one, on the size of the picture, else from what it shows."""
        beside = frame.path if _is_file(frame) else None
        stored = find_annotation(self.annotations, frame.id, beside)
        if stored is None:
            picture, calibration = calibrate_frame(frame, self.config, self.mask, self.keypoints, self.format_name)
            template = calibration.template or template
            return picture, result_record(calibration, template, time_s=frame.time_s, digest=self.digest), calibration
        _log.info("%s: from its annotation", frame.path)
        picture = _picture(frame, self.config.limits)
        annotation = stored.annotation.resize(picture.shape[1], picture.shape[0])
        calibration = self._calibrate_by_hand(annotation, frame.id, frame.source)
        record = result_record(calibration, calibration.template or template, time_s=frame.time_s, digest=self.digest)
        record = record.model_copy(update={"annotation": stored.digest})
        return picture, record, calibration


def _picture_of(frame: FrameOfFile, limits: LimitsConfig) -> NDArray[np.uint8] | None:
    """The picture beside an annotation, where it is of the annotation's size."""
    if frame.picture is None:
        return None
    picture = read_image(frame.picture, limits)
    size = picture.shape[1], picture.shape[0]
    if size == (frame.observed.width, frame.observed.height):
        return picture
    _log.warning("%s: is %d x %d, not the size of %s; no overlay", frame.picture, *size, frame.path)
    return None


def require_networks(config: Config) -> None:
    """Load the networks that a configuration names, so that a run fails before the first frame and not at each.

    Raises
    ------
    ConfigError
        A model is missing or unusable.
    MissingExtraError
        No onnxruntime.
    """
    require_mask_network(config.mask)
    require_keypoint_networks(config.keypoints)


def write_outputs(
    image: NDArray[np.uint8] | None, calibration: FrameCalibration, record: ResultRecord, config: Config, out: Path
) -> None:
    """Write a result's record as ``<id>.json``, and the pictures that the configuration asks for, into a folder.

    Without a picture there are no pictures.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    template, output = calibration.template or field_of(config)[0], config.output
    write_result(out / f"{calibration.id}.json", record)
    if image is None:
        return
    if output.overlay:
        picture = overlay.draw_readable_overlay(image, calibration, template)
        write_image(out / f"{calibration.id}{OVERLAY_SUFFIX}", picture, output.jpeg_quality)
    if output.radar:
        radar = overlay.draw_radar(image, calibration, template, output.radar_px_per_m)
        if radar is not None:
            write_image(out / f"{calibration.id}{RADAR_SUFFIX}", radar, output.jpeg_quality)
    if output.debug:
        folder = out / f"{calibration.id}{DEBUG_SUFFIX}"
        write_stage_pictures(image, calibration, template, folder, output.jpeg_quality)


def write_stage_pictures(
    image: NDArray[np.uint8],
    calibration: FrameCalibration,
    template: FieldTemplate,
    folder: Path,
    jpeg_quality: int = 90,
) -> list[Path]:
    """Write one numbered picture per stage and a contact sheet of them all; return the files.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    pictures = overlay.stage_pictures(image, calibration, template)
    verdict = calibration.verdict
    title = f"{calibration.id}: {verdict.status}{f' ({verdict.reason})' if verdict.reason else ''}"
    written: list[Path] = []
    for name, picture in {**pictures, STAGE_SHEET: overlay.contact_sheet(pictures, title)}.items():
        path = folder / f"{name}.jpg"
        write_image(path, picture, jpeg_quality)
        written.append(path)
    return written


def tell_size(record: ResultRecord, frame: PictureFile | FrameOfFile) -> ResultRecord:
    """The record with the size of the picture's or video's file, by which a later start knows that it has changed."""
    if not isinstance(frame, PictureFile) or record.source is None:
        return record
    size = file_size(frame.path) if _is_file(frame) else frame.bytes
    if size is None:
        return record
    return record.model_copy(update={"source": record.source.model_copy(update={"bytes": size})})


def tell_mask(record: ResultRecord, frame: PictureFile) -> ResultRecord:
    """The record with the mask that lies beside the picture, by which a later start knows whether it changed;
    as it is where a person's annotation counts in its place.
    """
    if record.source is None or record.annotation is not None or not _is_file(frame):
        return record
    return record.model_copy(update={"source": record.source.model_copy(update={"mask": _describe_mask(frame)})})


def label_masks(frames: Iterable[PictureFile | FrameOfFile]) -> dict[str, str]:
    """The mask that lies beside each picture with its size, by the frame's id; nothing where there is none."""
    pictures = [frame for frame in frames if isinstance(frame, PictureFile) and _is_file(frame)]
    found = {frame.id: _describe_mask(frame) for frame in pictures}
    return {name: "" if mask is None else mask.label for name, mask in found.items()}


def _describe_mask(frame: PictureFile) -> MaskRecord | None:
    file = find_mask(frame, None)
    if file is None:
        return None
    return MaskRecord(path=file.relative_to(frame.path.parent).as_posix(), bytes=file_size(file))


def _is_file(frame: PictureFile) -> bool:
    """Whether a frame is a picture of its own, neither of a video nor fetched."""
    return frame.time_s is None and frame.url is None


def picture_of_record(record: ResultRecord) -> PictureFile:
    """The picture of a frame that was calibrated before, where its record says; that of a video is decoded.

    Raises
    ------
    InputError
        The video cannot be read, or is not the one of which the record is.
    """
    path, time_s = record.path or "", None if record.source is None else record.source.time_s
    if is_url(path):
        return PictureFile(record.id, Path(record.id), record.id, url=path)
    file = Path(path)
    if time_s is None:
        return PictureFile(record.id, file, path_in_folder(record.id, file))
    size = None if record.source is None else record.source.bytes
    if record.source is not None and is_another(record.source, file):
        raise InputError(f"{file}: has changed since its frames were calibrated; put the video back, or start over")
    aspect = None if record.image is None else record.image.aspect
    picture = next(pictures_at(file, [time_s]), None)
    return PictureFile(record.id, file, record.id, time_s, picture, aspect, bytes=size)
