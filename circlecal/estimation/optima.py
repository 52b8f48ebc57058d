"""Two cameras that explain a frame alike: both are followed, and the likelier one is widened by the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.field_evidence import log_evidence
from circlecal.camera.problem import Problem, State
from circlecal.camera.spike_and_slab import UNLIKELY_SHARE, Posterior, share_noise
from circlecal.camera.world import USUAL
from circlecal.estimation.task import Fit, Task
from circlecal.geometry.camera_parameters import parameters_between
from circlecal.geometry.projective import Array

ALIKE_COST, DISTINCT_COST = 6.0, 30.0
"""Two optima are both followed where their chi-square differs by less than the first, and would differ by more than the
second if they lay in one valley: odds of 20 : 1, and five standard deviations. In a rendered hall cameras 12 m and 29 m
from the circle differ by 0.2.
"""

SAME_COST = 0.01
"""Two optima are one where chi-square would differ by less than this, a tenth of a standard deviation, once all lines
have their names and the points their noise: of seven pairs in 110 real and rendered frames the noise that was grown or
the lines took all to one place, and left 0.0006 at most.
"""

DECIDING_LINES = 2
"""By so many further markings that it names one optimum is better than the other, whatever noise each leaves: they hold
each other. In a rendered hall the rim of a logo is fitted twice as well by a camera that names no line as by the true
one, which names both touchlines.
"""


def distinct_optima(problem: Problem, state: State) -> list[State]:
    """The best optimum, and one that explains what was seen as well with quite another camera: a circle that is seen
    nearly edge-on has two. The camera of the turned field does not count.
    """
    best = state.best()
    away, place = parameters_between(best.theta, state.theta), state.theta[:, 4:6] - problem.priors.center_m
    own = best.theta[:, 4:6] - problem.priors.center_m
    is_turned = np.linalg.norm(place + own, axis=1) < np.linalg.norm(place - own, axis=1)
    is_distinct = ((away @ best.normal[0]) * away).sum(axis=1) > DISTINCT_COST
    rivals = np.flatnonzero(is_distinct & ~is_turned & (state.cost < best.cost + ALIKE_COST))
    return [best, state.select(rivals).best()] if len(rivals) else [best]


def leave_out_repetitions(completed: list[tuple[Fit, tuple[Task, Fit]]]) -> list[tuple[Fit, tuple[Task, Fit]]]:
    """Optima, each before and after it was completed, without a second one that has come to where the first one is:
    the two then differ in nothing that is asked of them later.
    """
    (_, (task, fit)), *others = completed
    return [completed[0], *(other for other in others if not _is_same(task, fit, *other[1]))]


def _is_same(task: Task, fit: Fit, other_task: Task, other: Fit) -> bool:
    """Whether two completed fits name the same lines, and have the same camera before the same kind of surface."""
    if task.names != other_task.names or fit.problem.model != other.problem.model:
        return False
    away = parameters_between(fit.state.theta[0], other.state.theta[0])
    return float(away @ fit.state.normal[0] @ away) < SAME_COST


def choose_optimum(finished: list[tuple[Task, Fit]], known: int) -> tuple[Task, Fit]:
    """The likelier of two cameras, each with the lines that it names, widened by the other; that which names several
    more.
    """
    named = [len(set(task.names.values())) for task, _ in finished]
    if max(named) - min(named) >= DECIDING_LINES:
        return finished[int(np.argmax(named))]
    alike = share_noise([(fit.problem, fit.state) for _, fit in finished])
    worlds = [USUAL if fit.posterior is None else fit.posterior.world for _, fit in finished]
    evidence = [
        log_evidence(world, *own, finished[0][0].template, known) for world, own in zip(worlds, alike, strict=True)
    ]
    (task, fit), (_, other) = (finished[k] for k in np.argsort(evidence)[::-1])
    share = 1.0 / (1.0 + float(np.exp(-abs(evidence[0] - evidence[1]))))
    if share > 1.0 - UNLIKELY_SHARE:
        return task, fit
    mine, its = (
        f.posterior or Posterior(USUAL, 1.0, np.zeros_like(f.state.normal[0]), {"usual": 1.0}) for f in (fit, other)
    )
    away = parameters_between(fit.state.theta[0], other.state.theta[0])
    covariance = its.widen(posterior_covariance(other.state.normal[0], other.problem.priors.sd))
    others = share * mine.others + (1.0 - share) * (covariance + np.outer(away, away))
    resized = _resize(share, mine, its, covariance, away)
    sizes = {
        size: share * mine.size_shares.get(size, 0.0) + (1.0 - share) * its.size_shares.get(size, 0.0)
        for size in {*mine.size_shares, *its.size_shares}
    }
    posterior = Posterior(mine.world, share * mine.share, others, sizes, resized)
    return task, replace(fit, posterior=posterior)


def _resize(share: float, mine: Posterior, its: Posterior, covariance: Array, away: Array) -> Array | None:
    """Second moment (P, P) about the likelier camera, which has this share, of all answers of both on fields of another
    kind of size than its own; None where there are none.

    The other camera lies ``away`` (P,) and has this covariance (P, P) with all its answers: where it stands on a field
    of another kind itself, this is taken for that of its answers on such fields, which lie about it as the rest do.
    """
    about_it = its.resized if its.world.size == mine.world.size else covariance
    its_share = 1.0 - its.size_shares.get(mine.world.size, 0.0)
    weighed = [
        (share * mine.resized_share, mine.resized),
        ((1.0 - share) * its_share, None if about_it is None else about_it + np.outer(away, away)),
    ]
    kept = [(q, moment) for q, moment in weighed if moment is not None and q > 0.0]
    moments = np.array([q * moment for q, moment in kept])
    return moments.sum(axis=0) / sum(q for q, _ in kept) if kept else None
