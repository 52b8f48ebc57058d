"""Frames of a run as the rig takes them: what was seen, and the camera where there is one."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from circlecal.errors import InputError, reading_failure
from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, camera_of, theta_of
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.records.reading import read_records as read_lines
from circlecal.records.record import SCHEMA_VERSION
from circlecal.results import Calibration

RESULTS_NAME = "results.jsonl"


@dataclass(frozen=True, slots=True)
class RigFrame:
    """One frame.

    Attributes
    ----------
    id : str
        Name of the frame.
    observations : Observations or None
        What was seen; None where not even the circle was measured.
    theta, covariance : (P,), (P, P) arrays or None
        The camera's parameters where the frame is calibrated alone.
    named_lines, rejected : tuples of str
        Lines that were recognised, and observations that were left out.
    """

    id: str
    observations: Observations | None
    theta: Array | None
    covariance: Array | None
    named_lines: tuple[str, ...] = ()
    rejected: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture; (0, 0) where they are not known."""
        return (0, 0) if self.observations is None else (self.observations.width, self.observations.height)

    def without_points(self) -> RigFrame:
        """The same without what was seen; only the picture's size stays."""
        return self if self.observations is None else replace(self, observations=Observations(*self.size))

    def turned(self) -> Array:
        """Parameters (P,) of the same picture of the field turned by 180 degrees."""
        assert self.theta is not None
        assert self.observations is not None
        model = ProjectionModel(*self.size)
        theta = self.theta.copy()
        theta[1:7] = theta_of(camera_of(theta, model).turned(), model)[1:7]
        return theta


def frame_of_calibration(found: Calibration) -> RigFrame:
    """A frame straight from the pipeline."""
    fit = found.camera if found.status == "calibrated" else None
    if fit is None:
        return RigFrame(found.id, found.observations, None, None)
    return RigFrame(found.id, found.observations, fit.theta, fit.covariance, fit.named_lines, fit.rejected)


def frame_of_record(record: Mapping[str, Any], source: Path) -> RigFrame:
    """A frame from its result record.

    Raises
    ------
    InputError
        The record is damaged, with the file and the frame.
    """
    try:
        if record["schema_version"] != SCHEMA_VERSION:
            raise InputError(
                f"{source}: has schema_version {record['schema_version']}; this version reads {SCHEMA_VERSION}"
            )
        name, image, seen, camera = record["id"], record["image"], record.get("observations"), record["camera"]
        observations = (
            None if image is None or seen is None else Observations.from_json(seen, image["width"], image["height"])
        )
        if camera is None or observations is None or record["status"] != "calibrated":
            return RigFrame(name, observations, None, None)
        told = camera["covariance"]
        theta, matrix = np.array(told["estimate"], dtype=np.float64), np.array(told["matrix"], dtype=np.float64)
        P = len(PARAMETERS)
        if tuple(told["parameters"]) != PARAMETERS or theta.shape != (P,) or matrix.shape != (P, P):
            raise InputError(f"{source}: the camera of {name} has other parameters than this version; calibrate again")
        return RigFrame(
            name, observations, theta, matrix, tuple(camera["named_lines"]), tuple(camera["rejected_observations"])
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        named = record.get("id") if isinstance(record, Mapping) else None
        raise InputError(
            f"{source}: the record{f' of {named}' if named else ''} is no result of circlecal: "
            f"{type(error).__name__} {error}"
        ) from error


def read_records(path: Path) -> Iterator[dict[str, Any]]:
    """Result records from a folder, a ``results.jsonl`` or a result file, one at a time.

    Raises
    ------
    InputError
        Nothing there, or damaged, with file and line.
    """
    if path.is_dir():
        log = path / RESULTS_NAME
        if log.is_file():
            yield from read_lines(log)
            return
        files = sorted(file for file in path.glob("*.json") if file.name != "rig.json")
        if not files:
            raise InputError(f"{path}: holds no {RESULTS_NAME} and no result files; give the folder of a batch")
        for file in files:
            yield _parsed(_text(file), str(file))
    elif path.suffix == ".jsonl":
        yield from read_lines(path)
    else:
        yield _parsed(_text(path), str(path))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: cannot be read: {reading_failure(error)}; give the folder of a batch, or result files"
        ) from error


def _parsed(text: str, source: str) -> dict[str, Any]:
    try:
        record = json.loads(text)
    except ValueError as error:
        raise InputError(f"{source}: is not JSON: {error}") from error
    if not isinstance(record, dict) or "schema_version" not in record or "id" not in record:
        raise InputError(f"{source}: is no result of circlecal")
    return record
