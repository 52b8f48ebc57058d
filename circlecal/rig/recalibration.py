"""One frame again, with what the other frames of its camera say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from circlecal.camera.problem import Problem, evaluate, minimise
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
    """A frame as one camera explains it: the calibration and its cost, or why it is not taken."""

    rig: Rig
    calibration: FrameCalibration | None
    cost: float
    reason: str | None


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
    explains it: clearly better than the others, and hardly worse than a camera of its own.

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
    tried = _choose_rigs(frame, rigs, camera)
    if not tried:
        return Recalibration(None, None, "no camera is known for it")
    alone = None if frame.theta is None else problem_of_frame(frame, frame.theta, template, circle, config)
    cost_alone = 0.0 if alone is None or frame.theta is None else _cost(alone, frame.theta)

    def excess(found: FrameCalibration, theta: Array) -> float:
        """By how much a calibration costs more than a camera of the frame's own: that which it has alone, or the one
        nearby that explains what was seen of a refused frame best.
        """
        if alone is not None:
            return _cost(alone, theta) - cost_alone
        seen = frame_of_calibration(found)
        free = minimise(problem_of_frame(seen, theta, template, circle, config, grown=False), theta[None]).theta[0]
        own = problem_of_frame(seen, free, template, circle, config)
        return _cost(own, theta) - _cost(own, free)

    def weigh(found: FrameCalibration, theta: Array) -> float:
        """Cost of a calibration, with the standard deviations that the frame asks for where it is calibrated alone, so
        that the costs of two cameras can be compared; with those that were stated where it is not.
        """
        if alone is not None:
            return _cost(alone, theta)
        return _cost(problem_of_frame(frame_of_calibration(found), theta, template, circle, config, grown=False), theta)

    return _choose_trial([_try_rig(frame, rig, calibrate, weigh, excess, config) for rig in tried])


def _choose_rigs(frame: RigFrame, rigs: Sequence[Rig], camera: str | None) -> list[Rig]:
    """The cameras with which a frame is tried: the one in whose group it stands, or else all that may have taken it."""
    own = [rig for rig in rigs if frame.id in rig.members and frame.id not in rig.left_out]
    return own or [rig for rig in rigs if camera is None or rig.name == camera]


def _try_rig(
    frame: RigFrame,
    rig: Rig,
    calibrate: Calibrate,
    weigh: Callable[[FrameCalibration, Array], float],
    excess: Callable[[FrameCalibration, Array], float],
    config: Config,
) -> _Trial:
    """A frame calibrated with what one camera's other frames say; its cost, and by how much that exceeds the cost of a
    camera of its own, are told by functions of the calibration and its parameters (P,).
    """
    found = calibrate(config_with_prior(config, rig.prior(frame.id, frame.theta), rig.size[0]))
    reason = find_refusal(found, frame, rig)
    if reason is not None or found is None or found.attempt.camera is None:
        return _Trial(rig, None, np.inf, reason)
    theta = found.attempt.camera.theta
    cost = weigh(found, theta)
    if frame.id not in rig.used and excess(found, theta) > config.rig.maximum_chi_square_increase:
        return _Trial(rig, None, cost, f"it fits {rig.name} much worse than a camera of its own")
    return _Trial(rig, found, cost, None)


def _choose_trial(trials: Sequence[_Trial]) -> Recalibration:
    """What the camera says that explains a frame clearly better than the others; the first reason where none does."""
    taken = sorted((trial for trial in trials if trial.calibration is not None), key=lambda trial: trial.cost)
    if not taken:
        return Recalibration(None, None, trials[0].reason)
    if len(taken) > 1 and taken[1].cost - taken[0].cost < DECISIVE:
        return Recalibration(None, None, f"{taken[0].rig.name} and {taken[1].rig.name} explain it equally well")
    return Recalibration(taken[0].calibration, taken[0].rig, None)


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


def _cost(problem: Problem, theta: Array) -> float:
    """Sum of squared residuals of what was seen, without any prior, at a camera (P,)."""
    feet = sample_feet(problem.curves, theta[None], problem.model)
    state = evaluate(problem, theta[None], feet, updates=4)
    priors, _ = problem.priors.residuals(theta[None])
    return float(state.cost[0] - np.sum(priors**2))
