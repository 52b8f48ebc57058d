"""What a rig tells of its tripod: cameras that share a position stand on one, of unknown lever arm and lean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, camera_of
from circlecal.rig.estimation import Rig
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate, Venue

LEVER_SD_M, LEAN_SD_RAD = 0.7, float(np.radians(0.5))
"""Standard deviation of lever arm and lean of the axis about 0: on real broadcasts the pupil lies 0.1 to 1.3 m before
the axis, and roll changes by -0.8 to 0.7 degrees per unit of the sine of pan.
"""
_SAME_NAME = {"x": "axis_x", "y": "axis_y", "z": "axis_z", "roll": "head_roll"}


def venue_of_rigs(rigs: list[Rig], field: str) -> Venue:
    """The cameras of a run as a venue, for frames of the same match."""
    return Venue(field, tuple(tripod_of_rig(rig) for rig in rigs))


def tripod_of_rig(rig: Rig) -> TripodEstimate:
    """The tripod of a rig.

    The rig knows where the entrance pupil stands, ``C = A + l e`` with the lever arm l along the optical axis e. With l
    taken as 0 the axis A is put there, and what is open of l is in the covariance of both, along the mean of e.
    """
    prior, thetas, model = rig.prior(), rig.state.theta, rig.problem.frames[0].model
    names = [_SAME_NAME.get(name, name) for name in prior.parameters]
    slopes = [f"{name}_by_zoom" for name in prior.zoomed]
    at = [PLACE[name] for name in (*names, *slopes)]
    mean, covariance = np.zeros(len(COMMON)), np.zeros((len(COMMON), len(COMMON)))
    typical = thetas.mean(axis=0)
    for name in (*_SAME_NAME, *(n for n in PARAMETERS if n in PLACE)):
        mean[PLACE[_SAME_NAME.get(name, name)]] = typical[INDEX[name]]
    mean[at] = prior.mean
    covariance[np.ix_(at, at)] = prior.covariance
    deviating = [PLACE[name] for name in names]
    covariance[deviating, deviating] += prior.deviation_sd**2
    axis = np.zeros(len(COMMON))
    axis[:3] = -np.mean([camera_of(theta, model).R[2] for theta in thetas], axis=0)
    axis[PLACE["lever"]] = 1.0
    covariance += LEVER_SD_M**2 * np.outer(axis, axis)
    lean = [PLACE["lean_x"], PLACE["lean_y"]]
    covariance[lean, lean] = LEAN_SD_RAD**2
    heads = thetas[:, [INDEX["log_focal"], INDEX["pan"], INDEX["tilt"]]]
    return TripodEstimate(
        name=rig.name,
        size=rig.size,
        log_focal=float(prior.log_focal),
        surface=replace(model.surface, crown_m=float(mean[PLACE["crown"]])),
        mean=mean,
        covariance=covariance,
        head_low=heads.min(axis=0),
        head_high=heads.max(axis=0),
        used=rig.used,
        left_out=rig.left_out,
    )
