"""Which straight markings were seen: hypotheses from the predicted picture, each tried by a full fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera_fit.association import Association, associate_lines
from circlecal.camera_fit.observed import Realism, observed_curves
from circlecal.camera_fit.optimise import Problem, State, minimise
from circlecal.camera_fit.uncertainty import posterior_covariance
from circlecal.field import FieldTemplate
from circlecal.geometry.homogeneous import Array, Mask, fit_line
from circlecal.observations import Observations

ROUNDS = 3
"""Fits of one hypothesis; after each the lines are matched anew."""
MARGIN_WIDTHS = 0.12
"""A hypothesis must explain this many picture widths of line more than any that contradicts it."""


@dataclass(frozen=True, slots=True)
class _Trial:
    """A fitted hypothesis: its names, the length that it explains within the tolerance, and its score."""

    association: Association
    explained_px: float
    score: float


def name_lines(
    problem: Problem,
    state: State,
    observations: Observations,
    template: FieldTemplate,
    realism: Realism,
    loss_scale: float,
) -> dict[int, str]:
    """Names for straight markings that were seen without one.

    Parameters
    ----------
    problem, state : Problem, State
        The fit without them.
    observations : Observations
        Everything that was seen.
    template : FieldTemplate
        The field.
    realism : Realism
        How points are thinned and trusted while hypotheses are compared.
    loss_scale : float
        Scale of the robust loss, standard deviations.

    Returns
    -------
    dict
        Template names by index into ``observations.lines``; empty where nothing is certain.
    """
    unnamed = [k for k, line in enumerate(observations.lines) if line.line is None and len(line.points_px) >= 8]
    if not unnamed:
        return {}
    segments = np.array([_ends(observations.lines[k].points_px) for k in unnamed])
    known = tuple(line.line for line in observations.lines if line.line is not None)
    unit = observations.width / 1920.0

    def hypotheses(theta: Array, normal: Array, count: int) -> list[Association]:
        covariance = posterior_covariance(normal, problem.priors.sd)
        return associate_lines(segments, template, known, theta, covariance, problem.frame, 1.5 * unit, count)

    trials = []
    for first in hypotheses(state.theta[0], state.normal[0], 6):
        association, explained, score = first, 0.0, -np.inf
        for _ in range(ROUNDS):
            fitted, fitted_state = _fit(
                association, unnamed, problem, state, observations, template, realism, loss_scale
            )
            explained, score = _judged(
                fitted, fitted_state, problem, state, association, segments, unnamed, observations, unit
            )
            again = hypotheses(fitted_state.theta[0], fitted_state.normal[0], 1)
            if not again or again[0].names == association.names or again[0].length_px < association.length_px:
                break
            association = again[0]
        trials.append(_Trial(association, explained, score))
    return _certain(trials, unnamed, observations.width)


def _fit(
    association: Association,
    unnamed: list[int],
    problem: Problem,
    state: State,
    observations: Observations,
    template: FieldTemplate,
    realism: Realism,
    loss_scale: float,
) -> tuple[Problem, State]:
    names = {unnamed[k]: name for k, name in association.names.items()}
    lines = tuple(replace(line, line=names.get(k, line.line)) for k, line in enumerate(observations.lines))
    fuller = replace(problem, curves=observed_curves(replace(observations, lines=lines), template, realism))
    wide = minimise(fuller, state.theta[:1], 30.0 * loss_scale, 20)
    return fuller, minimise(fuller, wide.theta, loss_scale, 15, wide.hidden)


def _judged(
    fitted: Problem,
    state: State,
    before: Problem,
    old: State,
    association: Association,
    segments: Array,
    unnamed: list[int],
    observations: Observations,
    unit: float,
) -> tuple[float, float]:
    """Length of the lines that the fit really passes through, and the score: less what circle, line and priors had to
    give for it.
    """
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    residuals = np.abs(state.residuals[0] * fitted.curves.sigma_px)
    explained = 0.0
    for k in association.names:
        points = observations.lines[unnamed[k]].points_px
        of_line = _belongs(fitted.curves.points_px, points)
        if of_line.any() and np.sqrt(np.mean(residuals[of_line] ** 2)) < 2.5 * unit:
            explained += lengths[k]
    missed = association.length_px - explained
    worse = 0.0
    for group, name in enumerate(before.curves.names):
        old_rms = np.sqrt(np.mean((old.residuals[0] * before.curves.sigma_px)[before.curves.group == group] ** 2))
        new_group = fitted.curves.names.index(name)
        new_rms = np.sqrt(np.mean(residuals[fitted.curves.group == new_group] ** 2))
        worse += max(0.0, new_rms - old_rms - 0.3 * unit) / unit
    prior = float(np.sum(fitted.priors.residuals(state.theta[:1])[0] ** 2))
    return explained, explained - 2.0 * missed - unit * (400.0 * worse + 15.0 * prior)


def _belongs(points: Array, line_points: Array) -> Mask:
    """Which points (N,) lie between the ends of a seen line and on it."""
    ends = _ends(line_points)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    offset = points - ends[0]
    position = offset @ along
    across = np.abs(offset @ np.array([-along[1], along[0]]))
    return (position >= 0) & (position <= np.linalg.norm(ends[1] - ends[0])) & (across < 6.0)


def _certain(trials: list[_Trial], unnamed: list[int], width: int) -> dict[int, str]:
    if not trials:
        return {}
    best = max(trials, key=lambda t: t.score)
    rival = max((t.score for t in trials if t.association.contradicts(best.association)), default=-np.inf)
    if best.explained_px < 0.15 * width or best.score < 0.1 * width or best.score < rival + MARGIN_WIDTHS * width:
        return {}
    return {unnamed[k]: name for k, name in best.association.names.items()}


def _ends(points: Array) -> Array:
    """First and last point (2, 2) along a straight marking."""
    normal = fit_line(points)[:2]
    position = points @ np.array([normal[1], -normal[0]])
    return points[[np.argmin(position), np.argmax(position)]]
