"""Stage ``camera``: the pinhole camera that explains everything that was seen, with priors and its covariance.

One ellipse brings five constraints and the halfway line two; a camera with square pixels and a known principal point
has seven unknowns. So neither the imaged centre nor the second edge of the marking is needed; lens, principal point,
crown and marking width enter with priors, and so does their uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.multistart import find_optima, leave_local_optimum
from circlecal.camera.observed import median_sigmas
from circlecal.camera.options import CameraConfig, has_position
from circlecal.camera.problem import COARSE
from circlecal.camera.report import camera_fit
from circlecal.estimation.beginnings import begin, choose_sight
from circlecal.estimation.completion import complete, settle
from circlecal.estimation.contradictions import (
    find_contradicting_markings,
    find_contradicting_points,
    find_contradictions,
    find_lone_contradiction,
    find_straining_marking,
)
from circlecal.estimation.optima import choose_optimum, distinct_optima, leave_out_repetitions
from circlecal.estimation.task import Fit, Sight, Task, is_dense
from circlecal.estimation.worlds import choose_world
from circlecal.field import Circle, FieldTemplate
from circlecal.observations import MarkingKey, Observations
from circlecal.refusals import refuse
from circlecal.results import CameraFit, RoughCamera

MOST_ROUNDS = 4
"""So often the camera is estimated without what the last fit before contradicts, and refused where that contradicts it
still. In 842 estimates from simulated clicks, most of them with wrong points or names, two ended after a second one.
"""


def estimate_camera(
    observations: Observations,
    template: FieldTemplate,
    circle: Circle,
    config: CameraConfig,
    camera_side: str = "main",
    earlier: CameraFit | RoughCamera | None = None,
    is_strain_left_out: bool = True,
    is_draft: bool = False,
) -> CameraFit:
    """Maximum a posteriori camera.

    Parameters
    ----------
    observations : Observations
        Everything that was seen, with sigmas.
    template : FieldTemplate
        The field.
    circle : Circle
        The circle from which the starts are taken; where it is not seen, points, lines and other arcs stand for it.
    config : CameraConfig
        Model and priors.
    camera_side : str
        Which of the two solutions of the turned field is returned.
    earlier : CameraFit or RoughCamera, optional
        Of about the same observations: the only start, and its names of the same lines hold.
    is_strain_left_out : bool
        Whether a marking that changes the answer by more than its noise allows is not what it was taken for; else it
        may be painted some centimetres off.
    is_draft : bool
        Whether the circle is measured again along this camera's curve, and the camera estimated anew: then no other
        size or shape of the field is tried, and nothing is left out that strains the answer.

    Raises
    ------
    EstimationError
        ``no_circle`` where nothing else determines a camera, ``no_ellipse``, ``rotation_free``, ``no_camera`` where no
        start leads to a camera above the ground, ``observations_contradict`` where nothing is left of what was seen.
    """
    given = Task(observations, template, circle, config, camera_side, earlier)
    drafted = _estimate(given, choose_sight(given), True) if is_draft else None
    task, fit, rejected = drafted or _estimate_without_contradictions(given)
    # where the camera's place was stated, it may be that which contradicts the lines
    carrying = (circle.name, template.halfway_line)
    is_asked = is_strain_left_out and not is_draft and not has_position(config)
    straining = find_straining_marking(fit.problem, fit.state, carrying) if is_asked else None
    if straining is not None:
        key = MarkingKey(straining)
        points = np.bincount(fit.problem.curves.group, minlength=len(fit.problem.curves.keys))
        by_end = any(k == key and n == 1 for k, n in zip(fit.problem.curves.keys, points.tolist(), strict=True))
        task, fit, more = _estimate_without_contradictions(given.without_marking(straining, task.names, by_end))
        rejected = (key, *more)
    stated = median_sigmas(task.observations)
    return camera_fit(
        fit.problem, fit.state, fit.scale, rejected, task.names, circle, template, stated, fit.posterior, fit.growth
    )


def _estimate_without_contradictions(given: Task) -> tuple[Task, Fit, tuple[MarkingKey, ...]]:
    """:func:`_estimate`, anew without what its last fit contradicts: a wrong point through which the first optimum
    passes may lie far from where the camera ends.
    """
    left_out: tuple[MarkingKey, ...] = ()
    for _ in range(MOST_ROUNDS):
        sight = choose_sight(given)
        task, fit, rejected = _estimate(given, sight)
        wrong = find_contradictions(task, fit, sight)
        if not wrong:
            return task, fit, (*left_out, *rejected)
        left_out, given = (*left_out, *wrong), given.without(wrong)
    raise refuse("camera", "observations_contradict")


def _estimate(task: Task, sight: Sight, is_draft: bool = False) -> tuple[Task, Fit, tuple[MarkingKey, ...]]:
    """The task with the names that were given to lines, the fit, and what contradicts its first optimum."""
    config = task.config
    task, problem, starts = begin(task, sight)
    state = find_optima(problem, starts, config, task.side)
    if not is_dense(problem.curves):
        state = leave_local_optimum(problem, state, config, task.side)
    wrong_points = find_contradicting_points(problem, state) | find_lone_contradiction(task, problem, state)
    wrong_markings = find_contradicting_markings(task, problem, state, sight, problem.curves.sigma_px)
    rejected = (*problem.points.select(wrong_points).keys, *wrong_markings)
    if rejected:
        task = task.without(wrong_markings)
        problem = replace(problem, points=problem.points.select(~wrong_points), curves=task.curves())
        if len(problem.curves.sigma_px) == 0 and len(problem.points.sigma_px) == 0:
            raise refuse("camera", "observations_contradict")
        state = find_optima(problem, starts.continue_from(state), config, task.side)
    if is_draft:
        task, fit = complete(task, problem.curves, settle(task, problem, state, COARSE))
        return task, fit, rejected
    settled = [settle(task, problem, start, COARSE) for start in distinct_optima(problem, state)]
    completed = leave_out_repetitions([(fit, complete(task, problem.curves, fit)) for fit in settled])
    finished = [choose_world(task, problem.curves, fit, usual) for fit, usual in completed]
    task, fit = choose_optimum(finished, len(problem.curves.keys)) if len(finished) > 1 else finished[0]
    return task, fit, rejected
