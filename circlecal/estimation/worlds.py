"""Which field it may be: of the usual size or any, flat or crowned; the likeliest is taken, the others widen it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from circlecal.camera.noise import noise_of_misfit
from circlecal.camera.priors import Priors
from circlecal.camera.problem import COARSE, FINAL, Problem, State, resume, reweight, with_priors
from circlecal.camera.residuals import CurvePoints
from circlecal.camera.spike_and_slab import (
    UNLIKELY_SHARE,
    Answer,
    World,
    answers_in,
    depends_on_size,
    mix,
    possible_worlds,
    posterior_shares,
    share_noise,
)
from circlecal.estimation.completion import complete, fit_anew
from circlecal.estimation.task import Fit, Task
from circlecal.field import FieldTemplate

DOUBTED_SHARE = 0.1
"""Posterior probability of another size from which on the lines are named anew for such a field: below it the second
naming costs more time than it mends. Chosen without a measurement of its own.
"""

SEVERAL_LINES = 2
"""So many further markings at their places on a usual field leave little doubt about its size."""

MISFIT_SCALE, SIZE_EVIDENCE = 2.0, 3.0
"""Where noise had to grow so many times for a field of the usual size, it may be the size that does not fit; by how
much (logarithm of the evidence) a field of any size must then be likelier to be believed. Of 30 real frames of fields
of the usual size it reaches 0.3 in one, -2.6 in another and less in all others, whose misfit comes from the lens; of
two frames of a field of another size 2.9 and 4.1; of a rendered part of a circle beside a touchline 78.9 m apart from
the other one, 8.7.
"""

FEWEST_POINTS, NAMELESS_WIDTHS = 8, 0.2
"""Points of a line that is worth a name, and length in picture widths of one that needs one."""


def choose_world(task: Task, stated: CurvePoints, first: Fit, usual: tuple[Task, Fit]) -> tuple[Task, Fit]:
    """The best of the answers in all worlds, widened by the others.

    Parameters
    ----------
    task, stated, first : Task, CurvePoints, Fit
        Before further lines were named.
    usual : tuple of Task, Fit
        With the lines that a field of the usual size has.
    """
    config, template = task.config, task.template
    priors = first.problem.priors
    worlds = possible_worlds(template, priors, config.usual_size_share, config.flat_share)
    if len(worlds) == 1:
        return usual
    cases, known = [usual], len(stated.keys)

    def compare(noise: Callable[[Fit], tuple[Problem, State]]) -> list[tuple[Answer, _Case]]:
        return _compare_worlds(worlds, cases, noise, priors, template, known)

    found = compare(_with_reported_noise)
    any_size = next((world for world in worlds if not world.is_usual_size and not world.is_flat), None)
    if any_size is not None and config.name_lines and _may_be_of_any_size(task, usual, [a for a, _ in found]):
        wide, state = with_priors(first.problem, first.state.best(), any_size.priors(priors, priors, template))
        start = replace(first, problem=wide, state=resume(wide, state, task.rule(COARSE)))
        other = complete(task, stated, start)
        if depends_on_size(other[1].problem.curves) and other[0].names != usual[0].names:
            cases.append(other)
            found = compare(_with_reported_noise)
    if any_size is not None and _may_hide_misfit(usual[1], [a for a, _ in found]):
        named, own = usual
        cases.append((named, fit_anew(named, own, any_size.priors(own.problem.priors, priors, template))))
        told = compare(_with_noise_of_misfit)
        if _prefers_any_size(told):
            found = told
    best, (chosen, fit) = max(found, key=lambda pair: pair[0].evidence)
    problem, state = reweight(best.problem, best.state, fit.problem.curves.sigma_px)
    state = resume(problem, state, task.rule(FINAL))
    posterior = mix([answer for answer, _ in found], best, state.theta[0])
    return chosen, replace(fit, problem=problem, state=state, posterior=posterior)


_Case = tuple[Task, Fit]


def _compare_worlds(
    worlds: tuple[World, ...], cases: list[_Case], noise: Callable[[Fit], tuple[Problem, State]], usual: Priors,
    template: FieldTemplate, known: int,
) -> list[tuple[Answer, _Case]]:  # fmt: skip
    """The best answer in each world under each naming of the lines, and the case that it comes from.

    All are compared with the least noise that any of the cases leaves.
    """
    found: dict[tuple[World, frozenset[tuple[int, str]]], tuple[Answer, _Case]] = {}
    for case, alike in zip(cases, share_noise([noise(fit) for _, fit in cases]), strict=True):
        names = frozenset(case[0].names.items())
        for answer in answers_in(worlds, alike, usual, template, known, case[0].rule(COARSE)):
            key = answer.world, names
            if key not in found or answer.evidence > found[key][0].evidence:
                found[key] = answer, case
    return list(found.values())


def _with_reported_noise(fit: Fit) -> tuple[Problem, State]:
    return fit.problem, fit.state.best()


def _with_noise_of_misfit(fit: Fit) -> tuple[Problem, State]:
    problem, state = _with_reported_noise(fit)
    return (problem, state) if fit.given_px is None else noise_of_misfit(problem, state, fit.given_px)


def _may_hide_misfit(fit: Fit, answers: list[Answer]) -> bool:
    """Whether noise was taken to have grown where it may be the size of the field that does not fit."""
    has_grown = fit.given_px is not None and fit.scale > MISFIT_SCALE
    return has_grown and depends_on_size(fit.problem.curves) and _doubt(answers) > UNLIKELY_SHARE


def _doubt(answers: list[Answer]) -> float:
    """Posterior probability that the field is not of the usual size."""
    shares = posterior_shares(answers)
    return float(sum(q for a, q in zip(answers, shares, strict=True) if not a.world.is_usual_size))


def _prefers_any_size(found: list[tuple[Answer, _Case]]) -> bool:
    """Whether the best answer is one of a field of any size, and clearly."""
    evidence = [max((a.evidence for a, _ in found if a.world.is_usual_size == usual)) for usual in (True, False)]
    return evidence[1] - evidence[0] > SIZE_EVIDENCE


def _may_be_of_any_size(task: Task, usual: tuple[Task, Fit], answers: list[Answer]) -> bool:
    """Whether lines are worth a name on a field of another size: those named on the usual one fit such a field as well,
    or long ones have no name there.
    """
    named, fit = usual
    if depends_on_size(fit.problem.curves) and _doubt(answers) > DOUBTED_SHARE:
        return True
    if len(set(named.names.values())) >= SEVERAL_LINES:
        return False
    least = NAMELESS_WIDTHS * task.observations.width
    return any(
        line.line is None
        and k not in named.names
        and len(line.points_px) >= FEWEST_POINTS
        and np.linalg.norm(np.ptp(line.points_px, axis=0)) > least
        for k, line in enumerate(task.observations.lines)
    )
