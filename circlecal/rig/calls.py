"""The configuration for pictures of cameras that are known, from Python."""

from __future__ import annotations

import json
from pathlib import Path

from circlecal.api.calls import Settings, configure
from circlecal.config import Config, load_config
from circlecal.files import read_file
from circlecal.pipeline import field_of
from circlecal.records.camera_prior import prior_settings
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
