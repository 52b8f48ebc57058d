"""What tracking says of each frame of a clip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array
from circlecal.results import Check, Status

Carrier = Literal["circle", "lines", "motion"]
"""What carried a frame: a circle or an arc of it, straight markings, or the motion from frames beside it."""


@dataclass(frozen=True, slots=True)
class Head:
    """Where the head of a tripod points, and how far its lens is zoomed in.

    Attributes
    ----------
    pan_rad, tilt_rad : float
        Angles on the head, whose pan axis may lean: not quite those of the camera.
    log_focal : float
        Logarithm of the focal length in pixels.
    covariance : (3, 3) array
        Of the logarithm of the focal length, pan and tilt, in this order, with what the tripod leaves open of them.
    """

    pan_rad: float
    tilt_rad: float
    log_focal: float
    covariance: Array

    @property
    def values(self) -> Array:
        """Logarithm of the focal length, pan and tilt (3,)."""
        return np.array([self.log_focal, self.pan_rad, self.tilt_rad])


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """One frame of a clip.

    Attributes
    ----------
    index, time_s : int, float
        Number of the frame in the video, from 0, and its time from the first frame that is shown.
    size : (int, int)
        Width and height of the picture.
    shot : int
        Number of the shot, from 0: a cut begins a new one.
    tripod : str or None
        Name of the camera that took it, of those that the venue holds.
    status, code, reason : str, str or None, str or None
        Calibrated or refused, and why.
    view : FieldView or None
        Camera, surface, growth of the pitch and covariance.
    head : Head or None
        Where the head of the tripod points.
    carriers : tuple of str
        What the answer rests on, the most important first.
    checks : tuple of Check
        Measured values behind the answer, with their limits.
    sigma_px, sigma_m : float or None
        Largest predicted error over what the picture shows of the pitch: in the picture, and on the ground, each place
        counted from the middle of the pitch or from its nearer end, whichever it is told by better.
    end : int
        The end of the pitch from which places are told best, -1 or 1 by the sign of its x; 0 for its middle.
    """

    index: int
    time_s: float
    size: tuple[int, int]
    shot: int
    tripod: str | None
    status: Status
    code: str | None = None
    reason: str | None = None
    view: FieldView | None = None
    head: Head | None = None
    carriers: tuple[Carrier, ...] = ()
    checks: tuple[Check, ...] = ()
    sigma_px: float | None = None
    sigma_m: float | None = None
    end: int = 0
