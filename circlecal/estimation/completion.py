"""From an optimum to a complete fit: noise as residuals show it, lines that can be named, lens, shape of the pitch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.noise import leave_out_stray_points, rescale_and_reject, rescale_sigmas
from circlecal.camera.observed import curves_from_observations
from circlecal.camera.painters import knows_painters_errors
from circlecal.camera.priors import Priors
from circlecal.camera.problem import (
    COARSE,
    FINAL,
    Problem,
    State,
    bend_surface,
    minimise,
    predict_step,
    resume,
    reweight,
    with_priors,
)
from circlecal.camera.residuals import CurvePoints, ground_feet, join_curves
from circlecal.camera.spike_and_slab import depends_on_size
from circlecal.camera.world import LENS_WIDER
from circlecal.estimation.task import DENSE_POINTS, Fit, Task, is_dense
from circlecal.geometry.camera_parameters import INDEX
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array
from circlecal.line_naming.broad_lines import hide_broad_lines
from circlecal.line_naming.hypotheses import find_nameless_lines, name_lines
from circlecal.line_naming.line_ends import add_line_ends, agree_with_ends
from circlecal.observations import Observations

OVERRULING_LINES = 3
"""So many more different lines that get a name without the seen ends of others show that those are none."""

STRAINING_ENDS = 9.0
"""By how much chi-square must grow with both ends of a line for each to be tried without the other: one of them may be
a player's head before the letters of a board, which look like a line on both sides. In a rendered frame both cost 18,
and without that one three markings get a name instead of one.
"""

LENS_DOUBT, LENS_EVIDENCE = 1.5, 13.0
"""A radial distortion that lies so many standard deviations from what is usual is fitted with a prior as wide as that
of any lens, and believed where that explains the frame so much better (chi-square). Five real frames of one pan are
explained better by 7 to 12.5 with a barrel of -0.015 to -0.032, where all frames of the clip show 0.005: the ground is
uneven. Rendered lenses that are unusual by more than two standard deviations explain 34 to 44.
"""

LENS_MARGIN = 1.0
"""How far from that evidence the linear model may be for the fit to be made: of 30 fits to real frames and samples it
foretold the fall of chi-square to 0.4.
"""

MISFIT_SCALE, CLEARLY_LESS, LENS_ROUNDS = 4.0, 3.0, 3
"""Where noise had to grow so many times around a circle, an unusual lens is tried, by rounds of which each tells the
noise anew, and believed where it leaves so many times less: a lens of -0.1 that was taken for a hollow pitch left 22
times the noise of the measurement, and 1.1 times where it was a lens; uneven ground leaves as much as before.
"""

CROWN_EVIDENCE = 3.0
"""By how much chi-square must fall with a parabolic pitch instead of a roof for it to be believed: about as much as a
parabola is rarer, twice the logarithm of three. With 6 one real frame of 40 is left on a roof that hardly tells how far
away its camera stands, and none of 175 rendered frames has another verdict.
"""

MOST_BESIDE = 1
"""Markings beside the circle and its halfway line with which noise is still told by what they leave: one more line has
its place free, several hold each other by the lens, the surface and painted widths, whose errors the noise then has to
cover. Of 20 rendered courts, which show many, 61 % of the ground lay in the 90 % region with the noise of a close view
and 97 % without; a circle and one touchline come out alike in five profiles of 20 frames.
"""


@dataclass(frozen=True, slots=True)
class Recognised:
    """Straight markings that can be named and ends of lines: a problem with them beside the stated ones, a start (1, P)
    for it, and the names by index of the seen line.
    """

    problem: Problem
    start: Array
    names: dict[int, str]


def complete(task: Task, stated: CurvePoints, fit: Fit) -> tuple[Task, Fit]:
    """The fit with all that can be named, the lens and the shape of the pitch that it shows; ``stated`` are the curves
    with their first sigmas.
    """
    return take_in(task, stated, fit, recognise(task, stated, fit))


def take_in(task: Task, stated: CurvePoints, fit: Fit, more: Recognised | None) -> tuple[Task, Fit]:
    """:func:`complete` with what was recognised."""
    task, fit = _fit_more_lines(task, stated, fit, more)
    return task, _explain_by_lens(task, fit) or _allow_wider_lens(task, _allow_parabola(task, fit))


def settle(task: Task, problem: Problem, state: State, rule: StoppingRule) -> Fit:
    """Optimise once more with the sigmas that the residuals ask for."""
    best, scale, given_px = state.best(), 1.0, problem.curves.sigma_px
    if task.config.noise_from_residuals:
        problem, best, scale = rescale_sigmas(problem, best)
    return Fit(problem, resume(problem, best, task.rule(rule)), scale, given_px=given_px)


def _leave_out_stray_points(task: Task, fit: Fit) -> Fit:
    """The fit to a close view without points that lie on something else: its noise is told by those that are left."""
    if fit.given_px is None or not shows_size_closely(task, fit.problem.curves):
        return fit
    problem, state, kept = leave_out_stray_points(fit.problem, fit.state)
    if len(kept) == len(fit.given_px):
        return fit
    problem, state = reweight(problem, state, fit.given_px[kept])
    return settle(task, problem, resume(problem, state, task.rule(COARSE)), FINAL)


def _fit_more_lines(task: Task, stated: CurvePoints, fit: Fit, more: Recognised | None) -> tuple[Task, Fit]:
    """The fit with the straight markings that can be named and the ends of lines; without any, with the noise that the
    points around the circle show.
    """
    if more is not None:
        problem, start = more.problem, more.start
        state = minimise(problem, start, task.rule(COARSE), ground_feet(problem.curves, start, problem.model))
        return replace(task, names=task.names | more.names), _leave_out_stray_points(
            task, settle(task, problem, state, FINAL)
        )
    problem, state, scale = fit.problem, fit.state, fit.scale
    least = None if task.names else least_sigmas(task, stated)
    if least is not None:
        problem, state, scale, least = rescale_and_reject(problem, state, least)
    return task, Fit(problem, resume(problem, state, task.rule(FINAL)), scale, least)


def recognise(task: Task, stated: CurvePoints, fit: Fit) -> Recognised | None:
    """What can be named beside the markings ``stated``; None where there is nothing more."""
    if not task.config.name_lines:
        return None
    template, noise = task.template, task.coarse_noise
    observations = hide_broad_lines(task.observations, fit.problem, fit.state, template)
    fuller, with_ends, ends = add_line_ends(fit.problem, fit.state, observations, template)
    found = name_lines(fuller, with_ends, observations, template, noise, ends)
    most = len(find_nameless_lines(observations))
    is_strained = len(ends) > 1 and with_ends.cost[0] > fit.state.cost[0] + STRAINING_ENDS
    if is_strained and most > _count_different(found.names):
        for seen in _with_one_end(observations):
            problem, state, end = add_line_ends(fit.problem, fit.state, seen, template)
            others = name_lines(problem, state, seen, template, noise, end)
            if end and _count_different(others.names) > _count_different(found.names):
                ends, found = end, others
    overruling = _count_different(found.names) + OVERRULING_LINES
    if ends and (not found.names or most >= overruling) and _leaves_most(found.names, observations):
        # an end may be a cover's edge: only a whole structure of lines says so
        others = name_lines(fit.problem, fit.state, observations, template, noise)
        overrules = _count_different(others.names) >= overruling
        # and a line that passes through the end tells better where it runs
        if overrules or (not found.names and agree_with_ends(others.names, ends, observations)):
            ends, found = (), others
    if not ends and not found.names:
        return None
    lines = (*ends, *(replace(observations.lines[k], line=name) for k, name in sorted(found.names.items())))
    further = curves_from_observations(replace(observations, circles=(), lines=lines), template, task.noise)
    problem = replace(fit.problem, curves=join_curves(stated, further))
    return Recognised(problem, found.theta[None], found.names)


def _count_different(names: dict[int, str]) -> int:
    """How many different markings lines (names by index) are taken for."""
    return len(set(names.values()))


def _leaves_most(names: dict[int, str], observations: Observations) -> bool:
    """Whether more points lie on the straight lines that have no name, given or found, than on those that have found
    one.
    """
    count = {k: len(line.points_px) for k, line in enumerate(observations.lines) if line.line is None}
    return sum(count.values()) >= 2 * sum(count[k] for k in names)


def _with_one_end(observations: Observations) -> Iterator[Observations]:
    """What was seen, with each of the ends of lines alone."""
    for k, line in enumerate(observations.lines):
        for end in line.ends:
            lines = (replace(other, ends=(end,) if i == k else ()) for i, other in enumerate(observations.lines))
            yield replace(observations, lines=tuple(lines))


def least_sigmas(task: Task, curves: CurvePoints) -> CurvePoints | None:
    """The points with the sigmas of a frame that shows little beside the circle; None where there is more, or they are
    too few to tell their noise.
    """
    if not _is_close(task, curves):
        return None
    noise = replace(task.noise, model_sigma_px=close_sigma_px(task))
    return curves_from_observations(task.observations, task.template, noise)


def _is_close(task: Task, curves: CurvePoints) -> bool:
    """Whether little is seen beside the circle, and enough of it to tell its noise."""
    around = {task.circle.name, task.template.halfway_line}
    beside = {key.name for key in curves.keys} - around
    return len(beside) <= MOST_BESIDE and task.config.noise_from_residuals and is_dense(curves)


def shows_size_closely(task: Task, curves: CurvePoints) -> bool:
    """Whether little is seen beside the circle, and a line of it tells the field's size and its own noise: an end of a
    line is one point, and tells none, nor does a line tell by how much its painters laid it beside its place.
    """
    if knows_painters_errors(task.template):
        return False
    points = np.bincount(curves.group, minlength=len(curves.keys))
    is_line = (points >= DENSE_POINTS)[curves.group]
    return _is_close(task, curves) and depends_on_size(curves.select(np.flatnonzero(is_line)))


def close_sigma_px(task: Task) -> float:
    """What lens, crown and paint leave of an ideal marking in a close view, pixels."""
    return min(task.noise.model_sigma_px, task.config.close_sigma_px * task.observations.width / 1920.0)


def _allow_parabola(task: Task, fit: Fit) -> Fit:
    """The fit with a parabolic pitch where it explains what was seen clearly better, else the one given. A few clicked
    points cannot say so: one that is wrong bends the pitch instead, and the camera with it.
    """
    is_told = task.config.crown_shape != "auto" or task.config.shared is not None
    if is_told or not is_dense(fit.problem.curves):
        return fit
    curved, start = bend_surface(fit.problem, fit.state.best())
    start = predict_step(curved, start)
    if start.cost[0] > fit.state.cost[0]:  # far from enough: the linear model knows it to a fraction of the evidence
        return fit
    bar = float(fit.state.cost[0]) - CROWN_EVIDENCE
    found = minimise(curved, start.theta, task.rule(FINAL, bar), start.feet)
    if found.cost[0] > bar:
        return fit
    if fit.least is None:
        return replace(settle(task, curved, found, FINAL), given_px=fit.given_px)
    # what the roof left of the residuals was no noise
    curved, found, scale, least = rescale_and_reject(curved, found, fit.least)
    return Fit(curved, resume(curved, found, task.rule(FINAL)), scale, least)


def _allow_wider_lens(task: Task, fit: Fit) -> Fit:
    """The fit with little said of the radial distortion before, where what is usual clearly holds it back, else the one
    given. A few clicked points cannot say so.
    """
    priors, kappa = fit.problem.priors, INDEX["kappa_1"]
    off = abs(priors.distortion_off(fit.state.theta[0]))
    if not 0 < priors.sd[kappa] < off / LENS_DOUBT or not is_dense(fit.problem.curves):
        return fit
    free, start = with_priors(fit.problem, fit.state.best(), widen_lens(priors))
    bar = float(fit.state.cost[0]) - LENS_EVIDENCE
    if predict_step(free, start).cost[0] > bar + LENS_MARGIN:
        return fit
    found = resume(free, start, task.rule(FINAL))
    is_lens = found.theta[0, kappa] > strongest_barrel(found.theta[0], free.model.width)
    return replace(fit, problem=free, state=found) if found.cost[0] < bar and is_lens else fit


def _explain_by_lens(task: Task, fit: Fit) -> Fit | None:
    """The fit with an unusual lens, where that explains what was taken for noise; None where it does not.

    Noise that has grown with the residuals hides what another lens would explain, so it is told anew under each.
    """
    if fit.least is None or fit.scale < MISFIT_SCALE or fit.problem.priors.sd[INDEX["kappa_1"]] <= 0:
        return None
    problem, state = with_priors(fit.problem, fit.state.best(), widen_lens(fit.problem.priors))
    scale, least = fit.scale, fit.least
    for _ in range(LENS_ROUNDS):
        state = resume(problem, state, task.rule(COARSE))
        problem, state, scale, least = rescale_and_reject(problem, state, least)
    if scale * CLEARLY_LESS > fit.scale:
        return None
    return Fit(problem, resume(problem, state, task.rule(FINAL)), scale, least)


def strongest_barrel(theta: Array, width: int) -> float:
    """Radial distortion, half-widths, of a fisheye lens with this focal length: other lenses bend lines less.

    Where a rectilinear lens shows f tan(t), an equidistant one shows f t = f tan(t) (1 - tan(t)^2 / 3 + ...), which
    with the focal length F in half-widths is a first coefficient of -1 / (3 F^2).
    """
    focal = 2.0 * float(np.exp(theta[INDEX["log_focal"]])) / width
    return -1.0 / (3.0 * focal**2)


def widen_lens(priors: Priors) -> Priors:
    """Priors that say little of the radial distortion."""
    wider = priors.sd.copy()
    wider[INDEX["kappa_1"]] *= LENS_WIDER
    return replace(priors, sd=wider)
