"""What frames of one camera share, and the configuration for pictures of cameras that are known, from Python."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from circlecal.api import Run
from circlecal.api.calls import Settings, configure
from circlecal.batch.calls import own_field
from circlecal.batch.run import BatchProgress
from circlecal.batch.workers import cpu_count
from circlecal.config import Config, load_config
from circlecal.files import read_file
from circlecal.pipeline import field_of
from circlecal.records.camera_prior import prior_settings
from circlecal.rig.run import read_cameras, run_rig
from circlecal.rig.venue import choose_field, venue_settings

_VENUE_KEY = b"venue_version"
"""What every venue holds, and no prior and no result."""


def load_cameras(
    path: str | Path,
    config: Config | str | Path | None = None,
    *,
    field: str | Path | None = None,
    set: Settings | None = None,
) -> Config:
    """The configuration for pictures of cameras of which it is known where they stand, as ``--venue`` and
    ``--camera-prior`` make it.

    Parameters
    ----------
    path : path
        ``venue.yaml`` of ``circlecal track`` or ``rig``, which names the field where nothing else does; or the prior of
        one camera, such as the ``camera-1.yaml`` of ``rig`` or the result of another picture of it.
    config, field, set : optional
        As for :func:`circlecal.calibrate`; ``set`` goes over what the file says.

    Returns
    -------
    Config
        For :func:`circlecal.calibrate`, :func:`circlecal.calibrate_video` and :func:`circlecal.calibrate_points`.

    Raises
    ------
    InputError
        The file is missing, damaged, or holds no camera.
    ConfigError, TypeError
        As for :func:`circlecal.calibrate`, of the configuration.
    """
    file = Path(path)
    if _VENUE_KEY in read_file(file):
        named = choose_field(file, configure(config, None, set).field, None if field is None else str(field))
        chosen = configure(config, named, set)
        told = venue_settings(file, field_of(chosen)[0])
    else:
        chosen, told = configure(config, field, set), prior_settings(file)
    known = {key: json.loads(value) for key, _, value in (setting.partition("=") for setting in told)}
    return load_config(chosen, known | dict(set or {}))


def calibrate_rig(
    results: str | Path,
    out: str | Path = "circlecal-rig",
    config: Config | str | Path | None = None,
    *,
    field: str | Path | None = None,
    set: Settings | None = None,
    cameras: Mapping[str, str] | str | Path | None = None,
    mask: str | Path | None = None,
    workers: int | None = None,
    restart: bool = False,
    on_progress: Callable[[BatchProgress], None] = lambda progress: None,
) -> Run:
    """Estimate what the frames of each camera share, and calibrate every frame again with it into a folder, as
    ``circlecal rig`` does.

    Parameters
    ----------
    results : path
        Folder of :func:`circlecal.calibrate_batch` or ``circlecal batch``, or of result files.
    out : path
        Folder of ``results.jsonl``, ``summary.csv``, ``venue.yaml`` and one prior for each camera, which
        :func:`circlecal.load_cameras` takes; the last two where a camera was found.
    config, field, set : optional
        As for the run.
    cameras : mapping or path, optional
        Name of the camera by frame, or a CSV with ``id,camera``; by where the cameras stand where it is not given.
    mask : path, optional
        Folder of masks of the run.
    workers, restart, on_progress : optional
        As for :func:`circlecal.calibrate_batch`.

    Returns
    -------
    Run
        The results of the folder, refused frames among them.

    Raises
    ------
    InputError
        The results are missing, damaged or of another field, a frame of ``cameras`` is none of them, or a file cannot
        be written.
    ConfigError, MissingExtraError, TypeError
        As for :func:`circlecal.calibrate`.
    """
    chosen, folder = configure(config, field, set), Path(out)
    run_rig(
        Path(results),
        chosen,
        folder,
        workers=workers or cpu_count(),
        cameras=cameras if cameras is None or isinstance(cameras, Mapping) else read_cameras(Path(cameras)),
        mask=None if mask is None else Path(mask),
        restart=restart,
        on_progress=on_progress,
    )
    return Run(folder, own_field(chosen))
