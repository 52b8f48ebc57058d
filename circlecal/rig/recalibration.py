"""One frame again, with what the other frames of its camera say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from circlecal.camera.problem import evaluate
from circlecal.camera.residuals import sample_feet
from circlecal.config import Config
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.results import FrameCalibration
from circlecal.rig.estimation import Rig, config_with_prior, prior_chi_square, problem_of_frame
from circlecal.rig.frames import RigFrame, frame_of_calibration

DECISIVE = 16.0
"""By how much the sums of squared residuals of two cameras must differ before one of them has a frame."""
UNLIKELY = 1e-4
"""A camera that deviates more than this share of frames does from what the others say is another one."""

Calibrate = Callable[[Config], FrameCalibration | None]


@dataclass(frozen=True, slots=True)
class Recalibration:
    """What became of a frame: the calibration and its camera where another one was found, or why not."""

    calibration: FrameCalibration | None
    rig: Rig | None
    reason: str | None


@dataclass(frozen=True, slots=True)
class _Trial:
    """A frame as one camera explains it."""

    rig: Rig
    calibration: FrameCalibration
    cost: float


def recalibrate(
    frame: RigFrame,
    rigs: Sequence[Rig],
    calibrate: Calibrate,
    template: FieldTemplate,
    circle: Circle,
    config: Config,
    camera: str | None = None,
) -> Recalibration:
    """Calibrate a frame as one of the cameras' frames.

    A frame that stands in a group keeps its camera; any other is tried with every camera, and belongs to the one that
    explains it: clearly better than the others and, where it is calibrated alone, hardly worse than alone.

    Parameters
    ----------
    frame : RigFrame
        What was seen, and the frame's own camera.
    rigs : sequence of Rig
        The cameras.
    calibrate : callable
        The whole chain for this frame under a configuration; None where it cannot be run.
    template, circle, config : FieldTemplate, Circle, Config
        As for :func:`circlecal.rig.estimation.estimate_rigs`.
    camera : str, optional
        Name of the camera that took it; any may have where None.
    """
    own = [rig for rig in rigs if frame.id in rig.members and frame.id not in rig.left_out]
    tried = own or [rig for rig in rigs if camera is None or rig.name == camera]
    if not tried:
        return Recalibration(None, None, "no camera is known for it")
    alone = None if frame.theta is None else _cost(frame, frame.theta, template, circle, config, scale_of=frame)
    trials, reasons = [], []
    for rig in tried:
        found = calibrate(config_with_prior(config, rig.prior(frame.id, frame.theta), rig.size[0]))
        reason = find_refusal(found, frame, rig)
        if reason is not None or found is None or found.attempt.camera is None:
            reasons.append(reason or "it cannot be calibrated again")
            continue
        seen = frame_of_calibration(found)
        cost = _cost(seen, found.attempt.camera.theta, template, circle, config, scale_of=frame)
        if frame.id not in rig.used and alone is not None and cost - alone > config.rig.maximum_chi_square_increase:
            reasons.append(f"it fits {rig.name} much worse than a camera of its own")
            continue
        trials.append(_Trial(rig, found, cost))
    if not trials:
        return Recalibration(None, None, reasons[0])
    trials.sort(key=lambda trial: trial.cost)
    if len(trials) > 1 and trials[1].cost - trials[0].cost < DECISIVE:
        return Recalibration(None, None, f"{trials[0].rig.name} and {trials[1].rig.name} explain it equally well")
    return Recalibration(trials[0].calibration, trials[0].rig, None)


def find_refusal(found: FrameCalibration | None, frame: RigFrame, rig: Rig) -> str | None:
    """Why a calibration as a frame of a camera is not taken, or None."""
    if found is None:
        return "it cannot be calibrated again"
    if found.status != "calibrated" or found.attempt.camera is None:
        return found.verdict.reason
    prior = rig.prior(frame.id, found.attempt.camera.theta)
    prior = prior if found.width == rig.size[0] else prior.resize(found.width / rig.size[0])
    if prior_chi_square(prior, found.attempt.camera.theta) > chdtri(len(prior.parameters), UNLIKELY):
        return f"its camera is another one than {rig.name}"
    return None


def _cost(
    frame: RigFrame, theta: Array, template: FieldTemplate, circle: Circle, config: Config, scale_of: RigFrame
) -> float:
    """Sum of squared residuals of what was seen, without any prior, at a camera.

    The standard deviations are those that the frame asks for where it is calibrated alone, so that the cost of two
    cameras can be compared.
    """
    if scale_of.theta is not None:
        problem = problem_of_frame(scale_of, scale_of.theta, template, circle, config)
    else:
        problem = problem_of_frame(frame, theta, template, circle, config, grown=False)
    feet = sample_feet(problem.curves, theta[None], problem.model)
    state = evaluate(problem, theta[None], feet, updates=4)
    priors, _ = problem.priors.residuals(theta[None])
    return float(state.cost[0] - np.sum(priors**2))
