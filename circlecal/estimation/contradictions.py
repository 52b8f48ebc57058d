"""Marks, keypoints, lines and arcs that are not what they were taken for: everything else says so."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from circlecal.camera.noise import noise_of_misfit
from circlecal.camera.observed import median_sigmas
from circlecal.camera.problem import (
    COARSE,
    Problem,
    State,
    bend_surface,
    evaluate,
    predict_step,
    resume,
    reweight,
    with_priors,
)
from circlecal.camera.residuals import curve_points
from circlecal.estimation.completion import least_sigmas, widen_lens
from circlecal.estimation.task import Fit, Sight, Task, is_dense
from circlecal.geometry.camera_parameters import active_parameters, project
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Mask
from circlecal.observations import MarkingKey

OFF_SIGMAS = 5.0
"""A mark or keypoint further from where the camera puts it is wrong: normal errors go so far once in 270,000."""

WORTH_LEAVING_OUT, LONE_SIGMAS = 4.0, 4.5
"""By how much chi-square must fall without a mark that nothing else checks for it to be left out in earnest, and how
many standard deviations from where the others put it it is something else then. Centre marks of 45 real frames lie 3.4
off at most; a foot that was taken for one in a rendered frame 8.0, marks of pictures that no camera took mostly 6.9 to
7.4.
"""

HARDLY_LONE = 0.5
"""Share of that rise which the linear model must foretell for the fits with and without the mark to be made: in nine
real frames it foretold 0.6 to 7 times what these then found, 11 at most.
"""

LEAST_KNOWN = 1e-4
"""Least precision that all other markings leave the camera in its weakest direction, in parts of that with the marking:
where it is a hundred times less certain, a linear model does not tell how far it would move. Of two circles without any
line one leaves 1e-12.
"""
LEAST_SINGULAR = 1e-3
"""Directions in which a marking tells a thousand times less than in its best one are left out."""

WRONG_SIGMAS, WRONG_PX = 10.0, 10.0
"""A named line or arc whose points mostly lie further off, in both measures (pixels at 1920 px width), is not that."""
LAST_SIGMAS = 5.0
"""As ``WRONG_SIGMAS``, of the last fit, in which nothing bends the camera that is to be left out. Of 120 sets of clicks
of circle, halfway line and a touchline under another name one is calibrated wrongly with ten: the line lies 7.6 off.
"""
LEAVE_ONE_OUT_SIGMAS = 4.75
"""A marking that lies where all others put it less likely than a normal error of so many standard deviations (once in
a million, one way) is not what it was taken for. Of 190 further markings in 43 real frames the least likely one
corresponds to 3.5 (a field of another size), of 130 in 80 rendered ones to 2.5.
"""


def find_straining_marking(problem: Problem, state: State, kept: Collection[str | None]) -> str | None:
    """The marking that changes the answer by most, if by more than all others and its own noise allow.

    A line that few others check bends the camera to itself and leaves no residual, so each is left out: in the linear
    model its rows are taken out of the normal equations. With its own rows J and residuals r, and the covariance C and
    step d of the others alone, the innovation of what it tells, ``z = J^+ r + d`` in its singular directions, has the
    covariance ``(J^T J)^+ + C``; z's square in it is a chi-square (Bar-Shalom et al. 2001, Estimation with
    Applications to Tracking and Navigation, section 5.4).

    Parameters
    ----------
    problem, state : Problem, State
        A fit, of which the first start counts.
    kept : collection of str or None
        Markings that are not left out: the circle, and the line through it where there is one. One without which the
        others do not determine the camera is not left out either.
    """
    active = active_parameters(problem.priors.sd)
    normal = state.normal[0][active[:, None], active]
    size = np.sqrt(np.diag(normal))
    # a residual beyond the loss's scale has no say
    root = 1.0 / (1.0 + state.values[0] ** 2 / problem.loss_scale**2)
    rows, values = root[:, None] * state.jacobian[0][:, active] / size, root * state.values[0]
    names = np.array([key.name for key in problem.curves.keys])
    normal = normal / np.outer(size, size)
    weakest = float(np.linalg.eigvalsh(normal)[0])
    worst, found = LEAVE_ONE_OUT_SIGMAS, None
    for name in sorted(set(names.tolist()) - set(kept)):
        own = np.flatnonzero(names[problem.curves.group] == name)
        own_normal, gradient = rows[own].T @ rows[own], rows[own].T @ values[own]
        others = normal - own_normal
        if np.linalg.eigvalsh(others)[0] < LEAST_KNOWN * weakest:
            continue
        # the singular directions of the rows, from a matrix that does not grow with them
        precision, directions = np.linalg.eigh(own_normal)
        seen = precision > LEAST_SINGULAR**2 * precision[-1]
        precision, directions = precision[seen], directions[:, seen].T
        spread = np.linalg.solve(others, directions.T).T
        innovation = directions @ gradient / precision + spread @ gradient
        covariance = np.diag(1.0 / precision) + spread @ directions.T
        square = float(innovation @ np.linalg.solve(covariance, innovation))
        # of markings that tell hardly anything, rounding leaves a covariance that is none
        sigmas = _normal_deviate(square, len(precision)) if square > 0.0 else 0.0
        if sigmas > worst:
            worst, found = sigmas, name
    return found


def _normal_deviate(square: float, count: int) -> float:
    """The normal deviate that is as likely as a chi-square of so many degrees of freedom (Wilson and Hilferty 1931)."""
    share = 2.0 / (9.0 * count)
    return float(((square / count) ** (1.0 / 3.0) - (1.0 - share)) / np.sqrt(share))


def find_contradicting_points(problem: Problem, state: State) -> Mask:
    """Marks and keypoints (M,) that lie further from where the camera puts them than their sigma can explain."""
    off = state.point_values[0].reshape(len(problem.points.keys), 2)
    return np.asarray(np.linalg.norm(off, axis=-1) > OFF_SIGMAS, dtype=np.bool_)


def find_lone_contradiction(task: Task, problem: Problem, state: State) -> Mask:
    """The one mark or keypoint (M,) that lies elsewhere than where everything else puts it.

    A point that nothing checks bends the camera to itself and leaves no residual. With the noise that all else shows
    when the point is left out, chi-square rises by the square of the distance, in standard deviations, from where the
    others put it, when it is fitted too. The lens may be an unusual one, and the pitch a parabola.
    """
    nothing = np.zeros(len(problem.points.keys), dtype=np.bool_)
    if len(nothing) != 1 or not is_dense(problem.curves):
        return nothing
    best, rule = state.best(), task.rule(COARSE)
    without = replace(problem, points=problem.points.select(nothing))
    start = evaluate(without, best.theta, best.feet)
    if predict_step(without, start).cost[0] > best.cost[0] - WORTH_LEAVING_OUT:
        return nothing
    least = least_sigmas(task, problem.curves) or problem.curves
    lens = widen_lens(problem.priors)
    without, start = reweight(*with_priors(without, start, lens), least.sigma_px)
    without, alone = noise_of_misfit(without, resume(without, start, rule), least.sigma_px)
    together = replace(without, points=problem.points)
    cases = [(without, alone), (together, evaluate(together, alone.theta, alone.feet))]
    ahead = [float(predict_step(*case).cost[0]) for case in cases]
    if ahead[1] - ahead[0] < HARDLY_LONE * LONE_SIGMAS**2:
        return nothing
    if task.config.crown_shape == "auto":
        cases += [bend_surface(*case) for case in cases]
    cost = [float(resume(*case, rule).cost[0]) for case in cases]
    rise = min(cost[1::2]) - min(cost[::2])
    return ~nothing if rise > LONE_SIGMAS**2 else nothing


def find_contradictions(task: Task, fit: Fit, sight: Sight) -> list[MarkingKey]:
    """What was seen by its name, and lies elsewhere than where the last fit puts it; lines that the fit itself gave a
    name are not asked. What a marking leaves counts in the noise that was stated: the fit's own has grown with it.
    """
    problem, seen = fit.problem, task.observations
    points = problem.points.select(find_contradicting_points(problem, fit.state)).keys
    nameless = {line.key for k, line in enumerate(seen.lines) if line.line is None or k in task.names}
    stated = {key: sigma_px for key, sigma_px in median_sigmas(seen).items() if key not in nameless}
    given_px = np.array([np.hypot(stated.get(key, np.inf), task.noise.model_sigma_px) for key in problem.curves.keys])
    sigma_px = LAST_SIGMAS / WRONG_SIGMAS * given_px[problem.curves.group]
    return [*points, *find_contradicting_markings(task, problem, fit.state, sight, sigma_px)]


def find_contradicting_markings(
    task: Task, problem: Problem, state: State, sight: Sight, sigma_px: Array
) -> list[MarkingKey]:
    """Named lines and arcs that lie far from where the camera puts them, or where its lens folds back; never the circle
    that starts came from and the halfway line beside it, which the verdict judges.

    ``sigma_px`` (N,) are the standard deviations of the curve points in which that is far, infinite for those that are
    not asked.
    """
    curves = problem.curves
    off_px = np.abs(state.residuals[0]) * curves.sigma_px
    places, _ = curve_points(curves, state.feet[:1], state.theta[:1])
    is_shown = project(state.theta[:1], places, problem.model).visible[0]
    least_px = WRONG_PX * problem.model.width / 1920.0
    found = set()
    for group, key in enumerate(curves.keys):
        own = curves.group == group
        carrying = key.name in (task.template.halfway_line, task.circle.name)
        far = median_of_rows(off_px[own] / sigma_px[own]) > WRONG_SIGMAS and median_of_rows(off_px[own]) > least_px
        hidden = 2 * np.count_nonzero(is_shown[own]) < np.count_nonzero(own) and np.isfinite(sigma_px[own]).all()
        if (far or hidden) and not (carrying and sight.ellipse is not None):
            found.add(key)
    return sorted(found, key=str)
