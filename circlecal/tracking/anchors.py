"""Frames of a clip that a person named in the workbench: with them its survey begins."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from circlecal.api.calls import calibrate_annotation, suit_annotation
from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.formats.annotation import read_annotations
from circlecal.pictures.video import Video, frame_id, frame_time, pictures_at
from circlecal.results import CameraFit


@dataclass(frozen=True, slots=True)
class Anchor:
    """A frame whose camera follows from what a person named in it.

    Attributes
    ----------
    time_s : float
        Time of the frame, seconds.
    picture : (H, W, 3) uint8
        BGR picture.
    fit : CameraFit
        Its camera.
    """

    time_s: float
    picture: NDArray[np.uint8]
    fit: CameraFit


def read_anchors(video: Video, folder: Path | None, config: Config) -> tuple[Anchor, ...]:
    """The anchors of a clip, in the order of time; frames that stay refused with what was named in them are none.

    Parameters
    ----------
    video : Video
        The clip.
    folder : path or None
        Of annotations.
    config : Config
        Options.

    Raises
    ------
    InputError
        The video cannot be read, or an annotation was made on another field than the configuration's.
    ConfigError
        The settings of an annotation contradict the configuration.
    """
    fits: dict[float, CameraFit] = {}
    for stored in read_annotations(folder):
        annotation = stored.annotation
        try:
            time_s = frame_time(annotation.id)
        except ValueError:  # a picture
            continue
        if annotation.id != frame_id(video.name, time_s):
            continue
        if suit_annotation(config, annotation) is not config:
            raise InputError(f"{annotation.id}: was annotated on the field {annotation.field}; name it with --field")
        found = calibrate_annotation(annotation, config)
        if found.status == "calibrated" and found.attempt.camera is not None:
            fits[time_s] = found.attempt.camera
    times = sorted(fits)
    pictures = zip(times, pictures_at(video.path, times), strict=True) if times else ()
    return tuple(
        Anchor(time_s, picture, fits[time_s])
        for time_s, picture in pictures
        if picture is not None and picture.shape[1::-1] == (fits[time_s].model.width, fits[time_s].model.height)
    )
