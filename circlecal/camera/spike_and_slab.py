"""What a field may be like: of the usual size, of its width alone or of any that the rules allow, crowned or flat.

Each hypothesis is a prior of its own. The usual size is a spike, any size a slab: a wide prior alone would give away
what nearly all fields have in common, a narrow one alone would bend the camera where a field is another. What was seen
chooses by the marginal likelihood, in Laplace's approximation (MacKay 2003, Information Theory, Inference, and
Learning Algorithms, ch. 27),

    log Z = -cost / 2 - log det(N) / 2 - sum(log sd) - sum(log s) + log w

with the Gauss-Newton matrix N at the optimum, standard deviations sd of the priors in which hypotheses differ and s of
marks, which lie on even or uneven ground, and the share w of fields that are like this. Hypotheses that name different
lines are compared on all of them: a line that one of them leaves without a name is something else, which lies anywhere
in the picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import erf
from typing import Literal

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.priors import Priors
from circlecal.camera.problem import (
    Problem,
    State,
    bend_surface,
    predict_optimum,
    resume,
    reweight,
    with_priors,
    with_upright,
)
from circlecal.camera.residuals import CurvePoints
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, active_parameters
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array

SIZES_AND_CROWN = LENGTH, BREADTH, CROWN = [INDEX[name] for name in ("length", "breadth", "crown")]
CURVED_SHARE = 0.25
"""Of crowned fields, those whose profile is a parabola and no roof. In real frames of 30 fields the roof explains more
by 0.4 to 38 (logarithm of the evidence) in 27, the parabola by 1.5 at most in the others.
"""
FLAT_SD_M = 0.005
"""Of the drop of a flat field at the circle's radius, metres: artificial turf is laid to a centimetre."""
FLAT_RELIEF_SHARE = 1.0 / 3.0
"""How far the ground at a mark of a flat field lies above or below its profile, over that at a mark of a crowned one:
artificial turf is laid to a centimetre all over.
"""
OTHER_LINE_SHARE, OTHER_END_SHARE = 0.15, 0.3
"""Of the long straight lines and of the ends of lines that are seen on a field, those that are no marking's: banners,
boards, other sports; feet, covers. Assumed; twice as many or half as many change the logarithm of the evidence by 0.8.
"""
STANDING_M, OVERHEAD_SHARE = 2.0, 0.01
"""Cameras that nobody carries, higher than this (metres), are at most by as much higher as they stand off the field's
border: stands rise by less than 45 degrees. The share of those that do not, on cables, cranes and drones. Of 42 cameras
of real frames, the one nearest to that is 4.4 m off.
"""
ANYWHERE_PX = 600.0
"""Where such a line's ends lie, pixels at 1920 px width: anywhere over so much."""
BEYOND_RULES_SHARE, LEAST_SIZE_SD_M = 1e-6, 0.1
"""Of fields, the share whose length or width lies beyond the rules of their sport, and the least standard deviation,
metres, of either: none of some 60 grounds of real frames and clips lies beyond.
"""
RIDGE = 1e-9
"""Of the sum of squares, so little is added to each square: two points of a line tell nothing of its bend."""
OUT_OF_THE_QUESTION = 8.0
"""By how much less the logarithm of a world's evidence may be in the linear model for its optimum to be looked for."""
UNLIKELY_SHARE = 0.01
"""Hypotheses less likely than this after what was seen do not widen the posterior."""


Size = Literal["usual", "other_length", "any"]
"""Of a field: that of the template, its width with any length that the rules allow, or any that they allow."""


@dataclass(frozen=True, slots=True)
class World:
    """What one hypothesis says of the field, and the share of fields that are like that: its size, flat or crowned, and
    where it is crowned, with a curved profile or with that of the problem.
    """

    size: Size
    is_flat: bool
    share: float
    is_curved: bool = False

    @property
    def is_usual_size(self) -> bool:
        """Whether the field is as long and as wide as the template's."""
        return self.size == "usual"

    def priors(self, current: Priors, usual: Priors, template: FieldTemplate) -> Priors:
        """Priors with sizes and crown as in this world, and all else as they are.

        Parameters
        ----------
        current : Priors
            What is kept but for sizes and crown.
        usual : Priors
            Of a crowned field of the usual size.
        template : FieldTemplate
            With the sizes that the rules allow.
        """
        mean, sd = current.mean.copy(), current.sd.copy()
        mean[SIZES_AND_CROWN], sd[SIZES_AND_CROWN] = usual.mean[SIZES_AND_CROWN], usual.sd[SIZES_AND_CROWN]
        is_usual = self.size == "usual", self.size != "any"
        for index, is_known, extent in zip((LENGTH, BREADTH), is_usual, template.extents, strict=True):
            if not is_known and extent.range_m is not None and sd[index] > 0:
                # mean and standard deviation of a uniform distribution
                least, most = extent.range_m
                mean[index], sd[index] = (least + most) / 2.0 - extent.size_m, (most - least) / np.sqrt(12.0)
        if self.is_flat and sd[CROWN] > 0:
            mean[CROWN], sd[CROWN] = 0.0, FLAT_SD_M
        elif self.is_curved:
            # a parabola falls as far as a roof does where the field ends
            share = template.circle_by_name[template.default_circle].radius_m / (0.5 * template.width_m)
            mean[CROWN], sd[CROWN] = share * mean[CROWN], share * sd[CROWN]
        return replace(current, mean=mean, sd=sd)

    def enter(self, problem: Problem, state: State, usual: Priors, template: FieldTemplate) -> tuple[Problem, State]:
        """A problem of a crowned field with what this world says, and its state in it."""
        problem, state = with_priors(problem, state, self.priors(problem.priors, usual, template))
        points = problem.points
        if not self.is_flat or points.upright_px is None:
            return problem, state
        relief_px = FLAT_RELIEF_SHARE * np.sqrt(points.upright_px**2 - points.sigma_px**2)
        return with_upright(problem, state, np.hypot(points.sigma_px, relief_px))

    def curve(self) -> World:
        """This crowned world with a curved profile."""
        return replace(self, share=self.share * CURVED_SHARE / (1.0 - CURVED_SHARE), is_curved=True)


USUAL = World("usual", False, 1.0)
"""What is assumed where nothing else can be told."""


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
        What was seen: where nothing of it tells the length of the field, fields that have the usual width are one kind.
    """
    other_length = (1.0 - usual_share) * other_length_share
    any_size = 1.0 - usual_share - other_length
    if not depends_on_length(problem):
        return {"usual": 1.0 - any_size, "any": any_size}
    return {"usual": usual_share, "other_length": other_length, "any": any_size}


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
    begun = [world.enter(problem, state, usual, template) for world in worlds]
    ahead = [
        (_weigh(world, changed, here, template, known), True)
        if _has_priors(changed, problem)
        else _predict_answer(world, changed, here, template, known)
        for world, (changed, here) in zip(worlds, begun, strict=True)
    ]
    least = max(answer.evidence for answer, _ in ahead) - OUT_OF_THE_QUESTION
    found: list[Answer] = []
    reached: dict[Size, State] = {}
    for (answer, is_sure), (changed, here) in zip(ahead, begun, strict=True):
        if is_sure or answer.evidence < least:
            found.append(answer)
            continue
        # a flat field of any size is like the crowned one of any size
        size = answer.world.size
        start = answer.world.enter(problem, reached[size], usual, template)[1] if size in reached else here
        reached[size] = end = resume(changed, start, rule)
        found.append(_weigh(answer.world, changed, end, template, known))
    return found


def bend_answer(
    answer: Answer, usual: Priors, template: FieldTemplate, known: int, rule: StoppingRule
) -> Answer | None:
    """The answer on a crowned field whose profile is a parabola and no roof; None where it is out of the question.

    Parameters are those of :func:`answers_in`.
    """
    world = answer.world.curve()
    problem, state = bend_surface(answer.problem, answer.state)
    problem, state = with_priors(problem, state, world.priors(problem.priors, usual, template))
    ahead, is_sure = _predict_answer(world, problem, state, template, known)
    if ahead.evidence < answer.evidence - OUT_OF_THE_QUESTION:
        return None
    return ahead if is_sure else _weigh(world, problem, resume(problem, state, rule), template, known)


def _predict_answer(
    world: World, problem: Problem, state: State, template: FieldTemplate, known: int
) -> tuple[Answer, bool]:
    """The answer that a linear model foretells from a state nearby, and whether that model holds so far."""
    ahead, is_sure = predict_optimum(problem, state)
    return replace(_weigh(world, problem, ahead, template, known), is_predicted=True), is_sure


def _weigh(world: World, problem: Problem, state: State, template: FieldTemplate, known: int) -> Answer:
    return Answer(world, problem, state, log_evidence(world, problem, state, template, known))


def _has_priors(one: Problem, other: Problem) -> bool:
    return bool((one.priors.mean == other.priors.mean).all() and (one.priors.sd == other.priors.sd).all())


def log_evidence(world: World, problem: Problem, state: State, template: FieldTemplate, known: int) -> float:
    """Logarithm of the evidence of an optimum, the first start, up to what all worlds have in common.

    ``known`` markings are the same in all answers that are compared; the evidence that the others are none is taken
    off. A camera high over the field of the template, or steeply above its border, is a rare one.
    """
    active = active_parameters(problem.priors.sd)
    block = state.normal[0][active[:, None], active]
    scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
    _, determinant = np.linalg.slogdet(block / np.outer(scale, scale))
    sd = problem.priors.sd[SIZES_AND_CROWN]
    proper = (sd > 0) & np.isfinite(sd)
    volume = 0.5 * determinant + np.log(scale).sum() + np.log(sd[proper]).sum()
    upright_px = problem.points.upright_px
    noise = 0.0 if upright_px is None else float(np.log(upright_px).sum())
    evidence = -0.5 * float(state.cost[0]) - volume - noise + np.log(world.share)
    theta, covariance = state.theta[0], posterior_covariance(state.normal[0], problem.priors.sd)
    place = _log_share_of_places(theta, covariance, template)
    size = 0.0 if world.is_usual_size else _log_share_of_sizes(theta, covariance, template)
    return float(evidence) + place + size - _log_evidence_of_others(problem, state, known)


def _log_share_of_sizes(theta: Array, covariance: Array, template: FieldTemplate) -> float:
    """Logarithm of the probability that a field has a length and a width that its rules allow: the normal prior of any
    size has tails beyond them.
    """
    share = 1.0
    for index, extent in zip((LENGTH, BREADTH), template.extents, strict=True):
        if extent.range_m is not None:
            sd_m = max(float(np.sqrt(covariance[index, index])), LEAST_SIZE_SD_M)
            low, high = ((limit - extent.size_m - theta[index]) / (sd_m * np.sqrt(2.0)) for limit in extent.range_m)
            share *= 0.5 * (erf(high) - erf(low))
    return float(np.log(max(share, BEYOND_RULES_SHARE)))


def _log_share_of_places(theta: Array, covariance: Array, template: FieldTemplate) -> float:
    """Logarithm of the probability that a camera stands where this one does, beside the field or over it.

    By how much further off the border it stands than it is high above a person's head is linear enough about the
    optimum: the prior's step is averaged over a normal distribution.
    """
    x, y, z = (INDEX[name] for name in ("x", "y", "z"))
    half = 0.5 * np.array([template.length_m + theta[LENGTH], template.width_m + theta[BREADTH]])
    beyond = np.abs(theta[[x, y]]) - half
    side = int(np.argmax(beyond))
    high_m = -theta[z] - STANDING_M
    if high_m <= 0.0:
        return 0.0
    slope = np.zeros(len(theta))
    slope[(x, y)[side]], slope[(LENGTH, BREADTH)[side]] = np.sign(theta[(x, y)[side]]), -0.5
    slope[z] = 1.0
    sd = max(float(np.sqrt(slope @ covariance @ slope)), 1e-3)
    outside = 0.5 * (1.0 + erf((beyond[side] - high_m) / (sd * np.sqrt(2.0))))
    return float(np.log(OVERHEAD_SHARE + (1.0 - OVERHEAD_SHARE) * outside))


def _log_evidence_of_others(problem: Problem, state: State, known: int) -> float:
    """Logarithm of the evidence that all markings but the first ``known`` are anything else: each line lies anywhere.

    With the places u = (u_0, u_1) of a line's ends across it, uniform over the range R, points at the share t along it
    with standard deviation s give the integral of exp(-chi2 / 2) du / R^2, which is
    ``exp(-chi2_min / 2) 2 pi / (R^2 sqrt det A)``, ``A = sum a a^T / s^2``, ``a = (1 - t, t)``. What a camera leaves of
    its bend, t (1 - t), counts for no camera: anything else may be bent as it is seen.
    """
    curves = problem.curves
    own = np.flatnonzero(curves.group >= known)
    if len(own) == 0:
        return 0.0
    own = own[np.argsort(curves.group[own], kind="stable")]
    _, first, count = np.unique(curves.group[own], return_index=True, return_counts=True)
    is_line = count > 1
    range_px = ANYWHERE_PX * problem.model.width / 1920.0
    values, sigma, t = state.residuals[0, own], curves.sigma_px[own], state.feet[0, own]
    # a residual beyond the loss's scale costs no more
    robust = values / np.sqrt(1.0 + values**2 / problem.loss_scale**2)
    low, high = np.minimum.reduceat(t, first), np.maximum.reduceat(t, first)
    t = (t - np.repeat(low, count)) / np.repeat(np.maximum(high - low, 1e-9), count)
    near, far = (1.0 - t) / sigma, t / sigma
    basis = np.stack([near, far, t * near])
    gram = np.add.reduceat(basis[:, None] * basis, first, axis=-1)[..., is_line]
    along = np.add.reduceat(basis * robust, first, axis=-1)[..., is_line].T
    total = np.add.reduceat(robust * robust, first)[is_line]
    (aa, ab, _), (_, bb, _), _ = gram
    determinant = aa * bb - ab * ab
    gram = np.moveaxis(gram, -1, 0)
    ridge = RIDGE * np.trace(gram, axis1=-2, axis2=-1)[:, None, None] * np.eye(3)
    least = total - (along * np.linalg.solve(gram + ridge, along[..., None])[..., 0]).sum(axis=-1)
    lines = np.log(OTHER_LINE_SHARE / (1.0 - OTHER_LINE_SHARE)) + np.log(2.0 * np.pi) - 2.0 * np.log(range_px)
    lines = lines - 0.5 * least - 0.5 * np.log(determinant)
    ends = np.log(OTHER_END_SHARE / (1.0 - OTHER_END_SHARE)) + 0.5 * np.log(2.0 * np.pi) - np.log(range_px)
    ends = ends + np.log(sigma[first[~is_line]])
    return float(lines.sum() + ends.sum())


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
        away = answer.state.theta[0] - theta
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
