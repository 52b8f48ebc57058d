"""Frames of a run as the rig takes them: what was seen, and the camera where there is one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from circlecal.errors import InputError
from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, camera_of, theta_of
from circlecal.geometry.projective import Array
from circlecal.observations import MarkingKey, Observations
from circlecal.records.record import ResultRecord
from circlecal.results import FrameCalibration


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
    named_lines, rejected : tuples of str and of MarkingKey
        Lines that were recognised, and observations that were left out.
    aspect : float
        Width of a pixel over its height, as it was assumed.
    """

    id: str
    observations: Observations | None
    theta: Array | None
    covariance: Array | None
    named_lines: tuple[str, ...] = ()
    rejected: tuple[MarkingKey, ...] = ()
    aspect: float = 1.0

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture; (0, 0) where they are not known."""
        return (0, 0) if self.observations is None else (self.observations.width, self.observations.height)

    def without_points(self) -> RigFrame:
        """The frame without what was seen; only the picture's size stays."""
        return self if self.observations is None else replace(self, observations=Observations(*self.size))

    def turn_field(self) -> Array:
        """Parameters (P,) of the camera that shows this picture of a field turned by 180 degrees."""
        if self.theta is None:
            raise ValueError(f"{self.id} has no camera that could be turned")
        model = ProjectionModel(*self.size)
        theta = self.theta.copy()
        theta[1:7] = theta_of(camera_of(theta, model).turn_field(), model)[1:7]
        return theta


def frame_of_calibration(found: FrameCalibration) -> RigFrame:
    """A frame straight from the pipeline."""
    fit = found.attempt.camera if found.status == "calibrated" else None
    if fit is None:
        return RigFrame(found.id, found.attempt.observations, None, None, aspect=found.aspect)
    camera = fit.theta, fit.covariance, fit.named_lines, fit.left_out
    return RigFrame(found.id, found.attempt.observations, *camera, found.aspect)


def frame_of_record(record: ResultRecord, source: Path) -> RigFrame:
    """A frame from its record.

    Raises
    ------
    InputError
        Its camera is of another version, with the file and the frame.
    """
    camera, seen = record.camera, record.seen
    aspect = 1.0 if record.image is None else record.image.aspect
    if camera is None or seen is None or record.status != "calibrated":
        return RigFrame(record.id, seen, None, None, aspect=aspect)
    found = camera.covariance
    if found is None or found.parameters != PARAMETERS or len(found.estimate) != len(PARAMETERS):
        raise InputError(f"{source}: the camera of {record.id} has other parameters than this version; calibrate again")
    theta, covariance = (np.array(values, dtype=np.float64) for values in (found.estimate, found.matrix))
    rejected = tuple(map(MarkingKey.parse, camera.rejected_observations))
    return RigFrame(record.id, seen, theta, covariance, tuple(camera.named_lines), rejected, aspect)
