"""What a rig tells of its tripod."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.options import BEND_SD
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1, PARAMETERS
from circlecal.rig.estimation import Rig
from circlecal.rig.information import estimate_common
from circlecal.rig.joint import TURNING
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate, Venue

_SAME_NAME = {"x": "axis_x", "y": "axis_y", "z": "axis_z", "roll": "head_roll"}


def venue_of_rigs(rigs: list[Rig], field: str) -> Venue:
    """The cameras of a run as a venue, for frames of the same match."""
    return Venue(field, tuple(tripod_of_rig(rig) for rig in rigs))


def tripod_of_rig(rig: Rig) -> TripodEstimate:
    """The tripod of a rig; what single frames may deviate counts as uncertainty of what they share."""
    problem, state = rig.problem, rig.state
    found, spread = estimate_common(state)
    shared = [_SAME_NAME.get(PARAMETERS[k], PARAMETERS[k]) for k in problem.shared]
    slopes = [f"{PARAMETERS[k]}_by_zoom" for k in problem.zoomed]
    at = [PLACE[name] for name in (*shared, *slopes, *(TURNING[k] for k in problem.turning.free))]
    mean, covariance = np.zeros(len(COMMON)), np.zeros((len(COMMON), len(COMMON)))
    for name, value in zip(PARAMETERS, problem.base, strict=True):
        place = PLACE.get(_SAME_NAME.get(name, name))
        if place is not None:
            mean[place] = value
    mean[[PLACE[name] for name in TURNING]] = problem.turning.mean
    bend = PLACE["kappa_1_by_focal"]
    mean[bend] = problem.lens.by_focal if KAPPA_1 in problem.zoomed else 0.0
    mean[at] = found
    covariance[np.ix_(at, at)] = spread
    if mean[bend] > 0.0:
        covariance[bend, bend] = BEND_SD**2
    deviating = [PLACE[_SAME_NAME.get(PARAMETERS[k], PARAMETERS[k])] for k in problem.deviating]
    covariance[deviating, deviating] += problem.deviation_sd**2
    heads = problem.heads_of(state.theta, found)[:, [INDEX["log_focal"], INDEX["pan"], INDEX["tilt"]]]
    surface = problem.frames[0].model.surface
    return TripodEstimate(
        name=rig.name,
        size=rig.size,
        log_focal=problem.log_focal,
        surface=replace(surface, crown_m=float(mean[PLACE["crown"]])),
        mean=mean,
        covariance=covariance,
        head_low=heads.min(axis=0),
        head_high=heads.max(axis=0),
        used=rig.used,
        left_out=rig.left_out,
    )
