"""What a field may be like: of the usual size, of its width alone or of any that the rules allow, crowned or flat.

Each hypothesis is a prior of its own. The usual size is a spike, any size a slab: a wide prior alone would give away
what nearly all fields have in common, a narrow one alone would bend the camera where a field is another. What was seen
chooses by its evidence (:mod:`circlecal.camera.field_evidence`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.field_evidence import log_evidence, log_evidences
from circlecal.camera.priors import Priors, stack_priors
from circlecal.camera.problem import (
    Problem,
    State,
    bend_surface,
    predict_optima,
    resume,
    reweight,
    stack_hypotheses,
)
from circlecal.camera.residuals import CurvePoints
from circlecal.camera.world import BREADTH, CROWN, FLAT_SD_M, LENGTH, USUAL, Size, World
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import parameters_between
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array, Mask

OUT_OF_THE_QUESTION = 8.0
"""By how much less the logarithm of a world's evidence may be in the linear model for its optimum to be looked for."""
UNLIKELY_SHARE = 0.01
"""Hypotheses less likely than this after what was seen do not widen the posterior."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The best camera in one world, as a problem and its optimum (the first start), and the logarithm of its evidence,
    up to what all worlds have in common; ``is_predicted`` where the optimum is that of a linear model.
    """

    world: World
    problem: Problem
    state: State
    evidence: float
    is_predicted: bool = False


def possible_worlds(
    template: FieldTemplate,
    usual: Priors,
    size_shares: Mapping[Size, float],
    flat_share: float,
    curved_share: float = 0.0,
) -> tuple[World, ...]:
    """All hypotheses but those of curved profiles, the usual one first.

    Parameters
    ----------
    template : FieldTemplate
        With the sizes that the rules allow.
    usual : Priors
        Of a crowned field of the usual size; what other frames of the camera say leaves no choice.
    size_shares : mapping
        Shares of fields by their size, which add up to 1 (:func:`shares_of_sizes`).
    flat_share : float
        Share of fields that are flat.
    curved_share : float
        Share of the crowned fields that is left for curved profiles.
    """
    may_differ = any(
        extent.range_m is not None and usual.sd[index] > 0
        for index, extent in zip((LENGTH, BREADTH), template.extents, strict=True)
    )
    sizes: Mapping[Size, float] = size_shares if may_differ else {"usual": 1.0}
    is_free = usual.sd[CROWN] > FLAT_SD_M and np.isfinite(usual.sd[CROWN])
    crowned = (1.0 - flat_share) * (1.0 - curved_share)
    crowns = [(False, crowned), (True, flat_share)] if is_free else [(False, 1.0)]
    worlds = (World(size, flat, p * q) for flat, q in crowns for size, p in sizes.items())
    return (USUAL,) if usual.shared is not None else tuple(world for world in worlds if world.share > 0.0)


def shares_of_sizes(usual_share: float, other_length_share: float, problem: Problem) -> dict[Size, float]:
    """Shares of fields by their size, the usual one first.

    Parameters
    ----------
    usual_share : float
        Share of fields that are of the template's size.
    other_length_share : float
        Of the others, the share that has its width.
    problem : Problem
        What was seen: where nothing of it tells the length of the field, fields that have the usual width are one kind,
        of another length than the usual one where no field has the usual size.
    """
    shares = shares_of_all_sizes(usual_share, other_length_share)
    if not depends_on_length(problem):
        return {"usual" if usual_share > 0.0 else "other_length": 1.0 - shares["any"], "any": shares["any"]}
    return shares


def shares_of_all_sizes(usual_share: float, other_length_share: float) -> dict[Size, float]:
    """Shares of fields by their size, the usual one first, where what is seen tells the length of a field too; the
    parameters are those of :func:`shares_of_sizes`.
    """
    other_length = (1.0 - usual_share) * other_length_share
    return {"usual": usual_share, "other_length": other_length, "any": 1.0 - usual_share - other_length}


def depends_on_length(problem: Problem) -> bool:
    """Whether any of the markings and points moves with the length of the field."""
    shifts = (problem.curves.shift, problem.points.shift)
    return any(shift is not None and bool(np.any(shift[..., 1, :])) for shift in shifts)


def depends_on_size(curves: CurvePoints) -> bool:
    """Whether any of the markings moves with the length or the breadth of the field."""
    return bool(np.any(curves.shift[..., 1:, :]))


def answers_in(
    worlds: Sequence[World], case: tuple[Problem, State], usual: Priors, template: FieldTemplate, known: int,
    rule: StoppingRule,
) -> list[Answer]:  # fmt: skip
    """The best camera in each world, from the same observations.

    Parameters
    ----------
    worlds : sequence of World
        Hypotheses.
    case : tuple of Problem, State
        What was seen, and the optimum in one of the worlds.
    usual, template : Priors, FieldTemplate
        As for :meth:`World.priors`.
    known : int
        So many of the markings are the same in all answers that are compared.
    rule : StoppingRule
        When an optimum is reached. Where the linear model holds so far, or says already that a world is out of the
        question, it is not looked for.
    """
    problem, state = case
    described = [world.describe(problem, usual, template) for world in worlds]
    stacked, begun = stack_hypotheses(problem, state, described)
    found, is_sure = _foretell(worlds, described, stacked, begun, template, known)
    least = max(answer.evidence for answer in found) - OUT_OF_THE_QUESTION
    reached: dict[Size, State] = {}
    for k, (world, own) in enumerate(zip(worlds, described, strict=True)):
        if is_sure[k] or found[k].evidence < least:
            continue
        # a flat field of any size is like the crowned one of any size
        before = reached.get(world.size)
        start = _take(begun, k) if before is None else stack_hypotheses(problem, before, [own])[1]
        reached[world.size] = end = resume(own, start, rule)
        found[k] = _weigh(world, own, end, template, known)
    return found


def bend_answers(
    answers: Sequence[Answer], usual: Priors, template: FieldTemplate, known: int, rule: StoppingRule, least: float
) -> list[Answer]:
    """The answers on crowned fields whose profile is a parabola and no roof, without those out of the question.

    Parameters
    ----------
    answers : sequence of Answer
        On roofs, from one case of :func:`answers_in`.
    usual, template, known, rule : Priors, FieldTemplate, int, StoppingRule
        As for :func:`answers_in`.
    least : float
        Evidence that the linear model must foretell for the optimum to be looked for.
    """
    if not answers:
        return []
    worlds = [answer.world.curve() for answer in answers]
    described = [world.describe(own.problem, usual, template) for world, own in zip(worlds, answers, strict=True)]
    stacked = replace(described[0], priors=stack_priors([own.priors for own in described]))
    stacked, begun = bend_surface(stacked, answers[0].state.join([answer.state for answer in answers[1:]]))
    described = [replace(own, model=stacked.model) for own in described]
    ahead, is_sure = _foretell(worlds, described, stacked, begun, template, known)
    return [
        answer if sure else _weigh(world, own, resume(own, _take(begun, k), rule), template, known)
        for k, (answer, sure, world, own) in enumerate(zip(ahead, is_sure.tolist(), worlds, described, strict=True))
        if answer.evidence >= least
    ]


def _foretell(
    worlds: Sequence[World], described: Sequence[Problem], stacked: Problem, state: State, template: FieldTemplate,
    known: int,
) -> tuple[list[Answer], Mask]:  # fmt: skip
    """The answers that a linear model foretells from a state nearby in each of the worlds, described by problems that
    are also given as a single one, and whether that model holds so far (W,).
    """
    ahead, is_sure = predict_optima(stacked, state)
    evidence = log_evidences(worlds, described, ahead, template, known).tolist()
    return [
        Answer(world, own, _take(ahead, k), evidence[k], is_predicted=True)
        for k, (world, own) in enumerate(zip(worlds, described, strict=True))
    ], is_sure


def _take(state: State, start: int) -> State:
    """One of the starts alone."""
    return state.select(np.array([start]))


def _weigh(world: World, problem: Problem, state: State, template: FieldTemplate, known: int) -> Answer:
    return Answer(world, problem, state, log_evidence(world, problem, state, template, known))


def posterior_shares(answers: Sequence[Answer]) -> Array:
    """Posterior probabilities (K,) of answers."""
    evidence = np.array([answer.evidence for answer in answers])
    weight = np.exp(evidence - evidence.max())
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True, slots=True)
class Posterior:
    """What is assumed of the field after what was seen, and what else it may be like.

    Attributes
    ----------
    world : World
        The most likely one.
    share : float
        Its posterior probability.
    others : (P, P) array
        Second moment of all other answers about the reported one, ``sum w_k (C_k + d_k d_k^T)``: with the answer's own
        covariance C the mixture's is ``share C + others``.
    size_shares : mapping
        Posterior probability of each kind of size that was compared.
    resized : (P, P) array or None
        Second moment about the reported answer of those alone on fields of another kind of size; None where there
        are none.
    """

    world: World
    share: float
    others: Array
    size_shares: Mapping[Size, float]
    resized: Array | None = None

    @property
    def usual_share(self) -> float:
        """Posterior probability that the field is of the usual size."""
        return self.size_shares.get("usual", 0.0)

    @property
    def resized_share(self) -> float:
        """Posterior probability that the field is of another kind of size than that of the reported answer."""
        return 1.0 - self.size_shares[self.world.size]

    def widen(self, covariance: Array) -> Array:
        """The mixture's second moment (P, P) about the answer with this covariance."""
        return self.share * covariance + self.others


def mix(answers: Sequence[Answer], best: Answer, theta: Array) -> Posterior:
    """The mixture of all answers, of which one is reported, with the parameters (P,)."""
    shares = posterior_shares(answers)
    kept = [(a, q) for a, q in zip(answers, shares.tolist(), strict=True) if a is best or q >= UNLIKELY_SHARE]
    total = sum(q for _, q in kept)
    others, share = np.zeros((len(theta), len(theta))), 0.0
    resized, kept_share = np.zeros_like(others), 0.0
    for answer, q in kept:
        if answer is best:
            share = q / total
            continue
        away = parameters_between(theta, answer.state.theta[0])
        covariance = posterior_covariance(answer.state.normal[0], answer.problem.priors.sd)
        moment = q / total * (covariance + np.outer(away, away))
        others += moment
        if answer.world.size != best.world.size:
            resized, kept_share = resized + moment, kept_share + q / total
    size_shares: dict[Size, float] = {}
    for answer, q in zip(answers, shares.tolist(), strict=True):
        size_shares[answer.world.size] = size_shares.get(answer.world.size, 0.0) + q
    return Posterior(best.world, share, others, size_shares, resized / kept_share if kept_share > 0.0 else None)


UNSHARED_SIGMA_PX = 1e5
"""Standard deviation of points that another answer has left out of a marking: they count for nothing in comparisons."""


def share_noise(cases: Sequence[tuple[Problem, State]]) -> list[tuple[Problem, State]]:
    """The problems with the least standard deviation that any of them gives each point, and without the points that
    some of those that have a marking have left out of it.

    Standard deviations grow with the residuals, so a camera that explains a marking badly calls it noise; only with the
    same noise, and on the same points, can costs be compared.
    """
    if len(cases) == 1:
        return list(cases)
    keys = list(dict.fromkeys(key for problem, _ in cases for key in problem.curves.keys))
    marking = [np.array([keys.index(key) for key in problem.curves.keys], dtype=np.int_) for problem, _ in cases]
    rows = [
        np.column_stack([own[problem.curves.group], problem.curves.points_px])
        for own, (problem, _) in zip(marking, cases, strict=True)
    ]
    _, point = np.unique(np.concatenate(rows), axis=0, return_inverse=True)
    of_case = np.split(point.reshape(-1), np.cumsum([len(row) for row in rows])[:-1])
    times = np.bincount(point.reshape(-1))
    least = np.full(len(times), np.inf)
    np.minimum.at(least, point.reshape(-1), np.concatenate([problem.curves.sigma_px for problem, _ in cases]))
    shared = []
    for own, (problem, state) in zip(of_case, cases, strict=True):
        most = np.zeros(len(problem.curves.keys), dtype=np.int_)
        np.maximum.at(most, problem.curves.group, times[own])
        is_common = times[own] == most[problem.curves.group]
        shared.append(reweight(problem, state, np.where(is_common, least[own], UNSHARED_SIGMA_PX)))
    return shared
