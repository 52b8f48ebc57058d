"""What is already known of a camera: a venue's camera file, or the result of another frame of the same camera.

A prior file is YAML or JSON with ``position_m`` (three numbers, SoccerNet's frame), and as far as known
``position_sd_m``, ``roll_sd_deg``, ``focal_px``, ``k1_mean`` and others: keys of the configuration's section
``camera``, all in :data:`KEYS`; from ``circlecal rig`` also ``shared``, the
joint distribution of everything that frames of one camera share, which stands before the others. A result file of
``circlecal calibrate`` serves as well: its position with the standard deviation that it carries.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from circlecal.camera.options import CameraConfig
from circlecal.errors import InputError
from circlecal.files import read_file, write_atomic
from circlecal.names import show
from circlecal.records.json_text import GIVE_A_RESULT, RepeatedKeyError, explain_damage, load_json, parse_record
from circlecal.records.record import ResultRow
from circlecal.results.numbers import show_with_sigma
from circlecal.yaml_text import YamlError, dump_yaml, read_yaml

KEYS = (
    "position_m",
    "position_sd_m",
    "roll_sd_deg",
    "focal_px",
    "focal_sd",
    "k1_mean",
    "k1_sd",
    "k2_mean",
    "k2_sd",
    "principal_point_sd_px",
    "crown_m",
    "crown_sd_m",
    "shared",
)
ABOUT_KEYS = ("camera", "frames", "left_out")
"""What a prior file may say about itself."""
LEAST_POSITION_SD_M = 0.05
DEFAULT_POSITION_SD_M = 0.5


def prior_settings(path: Path) -> list[str]:
    """Settings of the section ``camera`` from a prior or result file, as ``camera.key=value``.

    Raises
    ------
    InputError
        With the file, what is wrong and the mend.
    """
    content = _read_mapping(path)
    if "venue_version" in content:
        raise InputError(f"{path}: is a venue, which may have several cameras; --venue takes it")
    known = _from_result(path) if "schema_version" in content else content
    known = {key: value for key, value in known.items() if key not in ABOUT_KEYS}
    unknown = next((key for key in known if key not in KEYS), None)
    if unknown is not None:
        raise InputError(f"{path}: {show(unknown)} is unknown in a camera prior; known: {', '.join(KEYS)}")
    if known.get("position_m") is None:
        raise InputError(f"{path}: position_m is missing; a camera prior needs at least the position")
    settings = {"position_sd_m": [DEFAULT_POSITION_SD_M] * 3, **known}
    try:  # as the configuration is checked: text is never a number, and a date is text
        CameraConfig.model_validate_json(json.dumps(settings, default=str), strict=True)
    except ValidationError as error:
        raise InputError(f"{path}: {explain_damage(error)}; see configs/default.yaml") from error
    return [f"camera.{key}={json.dumps(value)}" for key, value in settings.items()]


def _read_mapping(path: Path) -> dict[str, Any]:
    """The keys of a prior or of a result file, JSON or YAML."""
    raw = read_file(path)
    try:
        content = load_json(raw) if raw.lstrip()[:1] == b"{" else None
    except RepeatedKeyError as error:
        raise InputError(f"{path}: {error}") from error
    except (ValueError, RecursionError):
        content = None  # YAML knows a mapping in braces too
    try:
        content = read_yaml(path) if content is None else content
    except YamlError as error:
        where = f", line {error.line}" if error.line else ""
        raise InputError(f"{path}{where}: is neither YAML nor JSON: {error}") from error
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(f"{path}: a camera prior is a mapping with position_m")
    return content


def write_prior(
    path: Path, settings: dict[str, Any], about: dict[str, Any], values: dict[str, tuple[float, float]]
) -> None:
    """Write a prior file with a summary for its reader on top.

    Parameters
    ----------
    path : path
        The file.
    settings : dict
        Keys of the section ``camera``.
    about : dict
        Name and frames of the camera.
    values : dict
        Mean and standard deviation of what the frames share, by name.

    Raises
    ------
    InputError
        The file cannot be written.
    """

    lines = [f"# {name}: {show_with_sigma(mean, sd)}" for name, (mean, sd) in values.items()]
    header = "\n".join(["# A camera for --camera-prior: what its frames share (radians, metres, pixels).", *lines])
    body = dump_yaml({**about, **settings})
    write_atomic(path, f"{header}\n{body}".encode())


def _from_result(path: Path) -> dict[str, Any]:
    record = parse_record(read_file(path), ResultRow, str(path), GIVE_A_RESULT)
    camera = record.camera
    if record.status != "calibrated" or camera is None:
        raise InputError(f"{path}: holds no calibrated camera; give the result of a calibrated frame")
    sigma = camera.position_sigma_m or (None,) * 3
    return {
        "position_m": list(camera.position_meters),
        "position_sd_m": [max(DEFAULT_POSITION_SD_M if s is None else s, LEAST_POSITION_SD_M) for s in sigma],
    }
