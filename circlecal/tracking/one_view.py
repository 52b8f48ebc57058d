"""The tripod of a clip that shows one view, from a frame that was calibrated alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.geometry.camera_parameters import INDEX
from circlecal.geometry.projective import Array
from circlecal.results import CameraFit
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate
from circlecal.tracking.tripod_fit import start_tripod

_BESIDE = ("pp_x", "pp_y", "kappa_1", "kappa_2", "log_aspect", "crown", "width", "length", "breadth")
"""What a camera and its tripod both have, as these name it."""
_HEAD = ("log_focal", "pan", "tilt")
_CAMERA = [INDEX[name] for name in (*_HEAD, "roll", "x", "y", "z", *_BESIDE)]
_TOLD = [PLACE[name] for name in ("head_roll", "axis_x", "axis_y", "axis_z", *_BESIDE)]
_UNTOLD = [k for k in range(len(COMMON)) if k not in _TOLD]


def tripod_of_frame(name: str, frame: str, fit: CameraFit, mean: Array, sd: Array) -> TripodEstimate:
    """The tripod of one frame: a camera that it takes exactly, with the frame's own covariance.

    A fit of a tripod to the frame's paint anew would know less: it takes any size of the pitch for as likely, and of a
    rendered frame that is 0.8 px off alone it put the axis at half its distance.

    Parameters
    ----------
    name, frame : str
        Of the tripod, and of the frame.
    fit : CameraFit
        The frame's camera.
    mean, sd : (K,) arrays
        Prior of what frames of a tripod share: of what one frame does not tell, such as the lever arm.
    """
    size = fit.model.width, fit.model.height
    start = start_tripod(name, fit.theta[None], size, fit.model.surface, mean, sd)
    common = start.mean.copy()
    common[[PLACE[k] for k in _BESIDE]] = fit.theta[[INDEX[k] for k in _BESIDE]]
    # the camera changes as D h + D_T t + D_U u with the head, what it tells of the tripod and what it does not
    _, by_head, by_common = start.model.linearise_one(start.head_low, common)
    own = np.column_stack([by_head, by_common[:, _TOLD]])[_CAMERA]
    follows = np.linalg.solve(own, by_common[np.ix_(_CAMERA, _UNTOLD)])[len(_HEAD) :]
    by_camera = np.linalg.inv(own)[len(_HEAD) :]
    untold = np.diag(sd[_UNTOLD] ** 2)
    covariance = np.zeros((len(COMMON), len(COMMON)))
    seen = fit.covariance[np.ix_(_CAMERA, _CAMERA)]
    covariance[np.ix_(_TOLD, _TOLD)] = by_camera @ seen @ by_camera.T + follows @ untold @ follows.T
    covariance[np.ix_(_TOLD, _UNTOLD)] = -follows @ untold
    covariance[np.ix_(_UNTOLD, _TOLD)] = -untold @ follows.T
    covariance[np.ix_(_UNTOLD, _UNTOLD)] = untold
    surface = replace(start.surface, crown_m=float(common[PLACE["crown"]]))
    return replace(start, mean=common, covariance=covariance, surface=surface, used=(frame,))
