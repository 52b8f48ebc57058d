"""Tracking a clip from Python."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

from circlecal.api import Calibration
from circlecal.api.calls import Settings, configure, open_video
from circlecal.config import Config
from circlecal.field import FieldTemplate
from circlecal.formats.annotation import require_annotations
from circlecal.pictures.video import Sampling, Video
from circlecal.pipeline import field_of
from circlecal.rig.venue import choose_field, read_venue
from circlecal.tracking.field_of_clip import name_field
from circlecal.tracking.stretches import DEFAULT_EVERY, ClipRun, track_video

_log = logging.getLogger(__name__)


def track(
    path: str | Path,
    config: Config | str | Path | None = None,
    *,
    every: str | int = DEFAULT_EVERY,
    start: str | float | None = None,
    end: str | float | None = None,
    venue: str | Path | None = None,
    annotations: str | Path | None = None,
    field: str | Path | None = None,
    set: Settings | None = None,
) -> Iterator[Calibration]:
    """Find the camera of every frame of a clip, in the order of time.

    The first frame comes after the survey of the clip, the others a few seconds of the clip behind what is decoded.

    Parameters
    ----------
    path : path
        The video.
    config, field, set : optional
        As for :func:`circlecal.calibrate`. With ``field="auto"`` some frames of the clip are looked at first to find
        the sport.
    every : str or int
        A number of frames, or a time such as ``"200ms"``; every frame by default. Those between are followed too.
    start, end : str or float, optional
        Times in the video: seconds, ``"1:30"`` or ``"0:01:30.5"``; a frame at ``end`` itself is left out.
    venue : path, optional
        Cameras and pitch that are known: the ``venue.yaml`` of an earlier run. It names the field, where nothing else
        does.
    annotations : path, optional
        Folder of what was named in the workbench.

    Yields
    ------
    Calibration
        With ``time_s``. Its picture is read from the video again when it is asked for.

    Raises
    ------
    InputError
        The file is missing, is a picture, or no video; a time that is none; a damaged venue or annotation, or no such
        folder of annotations.
    ConfigError, MissingExtraError, TypeError
        As for :func:`circlecal.calibrate`.
    """
    chosen = configure(config, field, set)
    sampling = Sampling.parse(every, start, end)
    video = open_video(path, chosen)
    if venue is None:
        chosen = name_field([video], sampling, chosen)
    else:
        unnamed = configure(config, None, set).field
        chosen = configure(config, choose_field(Path(venue), unnamed, None if field is None else str(field)), set)
    template, _ = field_of(chosen)
    known = None if venue is None else read_venue(Path(venue), template)
    named = None if annotations is None else Path(annotations)
    if named is not None:
        require_annotations(named)
    return _calibrations(video, ClipRun(chosen, sampling, known, annotations=named), template)


def _calibrations(video: Video, run: ClipRun, template: FieldTemplate) -> Iterator[Calibration]:
    return (Calibration(record, template) for record in track_video(run, video, _log.warning))
