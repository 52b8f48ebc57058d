"""Levenberg-Marquardt over a batch of starts: the one optimiser of ellipses, cameras, rigs and homographies.

A problem says what a step is and what it costs; this file says how far steps are trusted, and when a start has arrived.
The division is that of PoseLib's ``lm_impl.h`` (Larsson 2020), widened from one start to many side by side; the damping
scales with the diagonal of the normal equations (Marquardt 1963).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from circlecal.geometry.projective import Array, Indices, Mask

FIRST_DAMPING, LEAST_DAMPING, LAST_DAMPING = 1e-4, 1e-10, 1e5
"""Share of the diagonal that is added to it: at first, for a step that is as good as undamped, and the one beyond which
a start is stuck: no step lowers its cost, however short.
"""
LEAST_PROMISE = 1e-100
"""Taken for the fall of the cost of a step that promises none, in order to divide by it: of costs up to 1e200 what is
left is a number.
"""
LARGEST_INVERSE = 1e11
"""Entries of the inverse of a correlation-like matrix beyond which it is taken without its singular directions."""
EXACT = 1e-24
"""Cost (chi-square) at which the residuals are rounding errors."""
HOPELESS = 100.0
"""A start whose cost (chi-square) is so much worse than the best one's, beyond what its steps promise, is given up."""
NEARLY_ALL, SOME = 0.7, 0.25
"""Shares of its promise that a step keeps where the cost is nearly quadratic, and where it still is somewhat."""
ABOUT_RIGHT = 3.0
"""A start may lower its cost by so many times what its undamped step promises, where the cost is far from quadratic."""
BENT_TIMES, BENT_CHANGE = 3.0, 0.2
"""A step that makes the cost so many times as large at most is tried again along the bend of its valley; and by what
the damping changes where that kept its promise. Of 2,200 evaluations on eleven real frames, 1,600 are left: with 1.5 or
10 times 1,740 or 1,610, with a damping that changes by 0.4 or not at all 1,640 or 1,820.
"""


class End(Enum):
    """Why a start was not followed further."""

    SETTLED = "no step promises to lower the cost by what is worth a step"
    STUCK = "no step lowers the cost, however short"
    EXACT = "the residuals are rounding errors"
    BEATEN = "its steps do not promise as low a cost as another start has, or as is asked for"
    LIMIT = "the number of iterations is used up"


@dataclass(frozen=True, slots=True)
class StoppingRule:
    """When a start has arrived.

    Attributes
    ----------
    tolerance : float
        Decrease of the cost that is not worth a step, as a share of the cost, or of ``unit`` where the cost is larger.
    unit : float
        1 for costs that are a chi-square; inf for a mere share of the cost.
    contraction : float
        What a step is taken to leave of its promise at best. With 1 a start has arrived where its next step is not
        worth it, with less where the step after that will not be: it leaves as little as the last one left.
    last_step : bool
        Whether the step that is not worth an evaluation is taken in the linear model, which is exact to the order of
        the next step.
    iterations : int
        Upper limit.
    bar : float
        Starts that promise no cost below it are given up.
    """

    tolerance: float
    unit: float = 1.0
    contraction: float = 1.0
    last_step: bool = False
    iterations: int = 60
    bar: float = np.inf


class Batch:
    """Mix-in of frozen dataclasses whose fields are arrays over the same leading axis of B starts."""

    __slots__ = ()

    def select(self, index: Indices | Mask) -> Self:
        """The starts at an index or mask."""
        if index.dtype == np.bool_ and index.all():
            return self
        return type(self)(*(getattr(self, name)[index] for name in _names(self)))

    def put(self, index: Indices, other: Self) -> Self:
        """The batch with others (K) at an index (K,) of distinct starts."""
        if len(index) == 0:
            return self

        def replace_rows(name: str) -> Array:
            values = getattr(self, name).copy()
            values[index] = getattr(other, name)
            return np.asarray(values)

        names = _names(self)
        return other if len(index) == len(getattr(self, names[0])) else type(self)(*map(replace_rows, names))

    def join(self, others: Sequence[Self]) -> Self:
        """The batch with others behind it."""
        parts = (self, *others)
        return type(self)(*(np.concatenate([getattr(part, name) for part in parts]) for name in _names(self)))


def _names(batch: Batch) -> tuple[str, ...]:
    return tuple(batch.__dataclass_fields__)  # type: ignore[attr-defined]  # every subclass is a dataclass


class State(Protocol):
    """Where a batch of B starts stands."""

    @property
    def cost(self) -> Array:
        """Sum of squared residuals (B,), robust or not."""

    def select(self, index: Indices | Mask) -> Self:
        """The starts at an index or mask."""

    def put(self, index: Indices, other: Self) -> Self:
        """The batch with others at an index."""

    def join(self, others: Sequence[Self]) -> Self:
        """The batch with others behind it."""


@dataclass(frozen=True, slots=True)
class Step(Batch):
    """One damped step of each start.

    Attributes
    ----------
    parameters : (B, P) array
        After the step, in whatever coordinates the problem takes it.
    change : (B, P) array
        What the step changes of the parameters, to first order.
    promise : (B,) array
        By how much it lowers the cost if that is quadratic.
    full_promise : (B,) array
        By how much the undamped step would: the present one may be short. It tells whether a start has arrived.
    """

    parameters: Array
    change: Array
    promise: Array
    full_promise: Array


S = TypeVar("S", bound=State)


class Problem(Protocol[S]):
    """What is minimised: B least-squares problems of one shape."""

    def narrow(self, index: Indices) -> Problem[S]:
        """The problem of the starts at an index alone."""

    def step(self, state: S, damping: Array) -> Step:
        """The step with a share ``damping`` (B,) of the diagonal added to the normal equations."""

    def follow(self, state: S, step: Step) -> S:
        """The starts where a step has led them: residuals and normal equations anew."""

    def bend(self, state: S, step: Step, proposal: S) -> S | None:
        """States whose steps take in by how much the residuals that a step led to differ from the linear model; None
        where residuals are not kept.
        """

    def extrapolate(self, state: S, step: Step) -> S:
        """All starts after a step in the linear model: nothing is evaluated."""


class OneStart:
    """Mix-in of states that stand for a single start."""

    __slots__ = ()

    def select(self, index: Indices | Mask) -> Self:
        """The only start."""
        return self

    def put(self, index: Indices, other: Self) -> Self:
        """The other state, where the only start is at the index."""
        return other if len(index) else self

    def join(self, others: Sequence[Self]) -> Self:
        """The only start: there are no others."""
        return self


@dataclass(frozen=True, slots=True)
class Arrow:
    """Normal equations of F frames that share parameters: no frame's own ones meet another's.

    Attributes
    ----------
    H_oo, H_oc, H_cc : (F, O, O), (F, O, K), (K, K) arrays
        Gauss-Newton blocks of the frames' own parameters, of these with the common ones, and of the common ones.
    g_o, g_c : (F, O), (K,) arrays
        Half the gradient of the cost.
    """

    H_oo: Array
    H_oc: Array
    H_cc: Array
    g_o: Array
    g_c: Array

    def step(self, own: Array, common: Array, own_change: Array, change: Array) -> Step:
        """The step of a single start from own (F, O) and common parameters (K,), one after the other, by changes of
        both; it promises ``-(2 g^T d + d^T N d)``, block by block.
        """
        slope = float((self.g_o * own_change).sum() + self.g_c @ change)
        bend = np.einsum("fo,fop,fp->", own_change, self.H_oo, own_change) + change @ self.H_cc @ change
        bend += 2.0 * np.einsum("fo,foc,c->", own_change, self.H_oc, change)
        full = np.concatenate([own_change.ravel(), change])
        promise = np.array([-2.0 * slope - float(bend)])
        return Step((np.concatenate([own.ravel(), common]) + full)[None], full[None], promise, promise)


@dataclass(frozen=True, slots=True)
class NormalState(Batch):
    """Parameters (B, P), costs (B,), half their gradients (B, Q) and Gauss-Newton matrices (B, Q, Q) of B starts.

    Q differs from P where steps are taken in other coordinates than the parameters.
    """

    parameters: Array
    cost: Array
    gradient: Array
    normal: Array


class DenseProblem(ABC):
    """A problem whose normal equations are solved as they are; it says what it costs, and what a change does."""

    __slots__ = ()

    @abstractmethod
    def evaluate(self, parameters: Array) -> NormalState:
        """State at parameters (B, P); a cost of inf where they mean nothing."""

    def move(self, parameters: Array, change: Array) -> Array:
        """Parameters (B, P) after a change (B, Q)."""
        return parameters + change

    def narrow(self, index: Indices) -> Self:
        """All starts have one problem."""
        return self

    def gauge(self, state: NormalState) -> Array | float:
        """Term (B, Q, Q) of the normal equations that holds what no residual depends on; it is not damped."""
        return 0.0

    def step(self, state: NormalState, damping: Array) -> Step:
        """Levenberg-Marquardt step ``d = -(N + damping diag N)^-1 g`` of every start; what it promises stands for
        the undamped one.
        """
        change = -solve_damped(state.normal, state.gradient, damping, self.gauge(state))
        promise = predict_decrease(state.normal, state.gradient, change)
        return Step(self.move(state.parameters, change), change, promise, promise)

    def follow(self, state: NormalState, step: Step) -> NormalState:
        """States where a step has led, evaluated anew."""
        return self.evaluate(step.parameters)

    def bend(self, state: NormalState, step: Step, proposal: NormalState) -> NormalState | None:
        """Residuals are not kept."""
        return None

    def extrapolate(self, state: NormalState, step: Step) -> NormalState:
        """All starts after a step, at the cost that was promised: nothing is evaluated."""
        return replace(state, parameters=step.parameters, cost=np.maximum(state.cost - step.promise, 0.0))


@dataclass(frozen=True, slots=True)
class Solution(Generic[S]):
    """Where the starts ended, after how many iterations, and why each of them did."""

    state: S
    iterations: int
    ends: tuple[End, ...]


def minimise(problem: Problem[S], state: S, rule: StoppingRule) -> Solution[S]:
    """Levenberg-Marquardt from every start at once; each keeps its own damping.

    A step that raises the cost is tried once more with what it told of the second derivative of the residuals along it,
    before a shorter one is: in a narrow valley that bends, straight steps are short (Transtrum and Sethna 2012,
    *Improvements to the Levenberg-Marquardt algorithm for nonlinear least-squares minimization*, section 3).

    Parameters
    ----------
    problem : Problem
        The residuals, behind steps.
    state : State
        The starts, evaluated.
    rule : StoppingRule
        When each of them has arrived.
    """
    live: Indices = np.arange(len(state.cost))
    gone: list[_Gone[S]] = []
    damping = np.full(len(live), FIRST_DAMPING)
    before = np.full(len(live), LEAST_PROMISE)
    trusted: Mask = np.ones(len(live), dtype=bool)
    bent = beaten = np.zeros(len(live), dtype=bool)
    least, has_settled = np.inf, False
    aim, straight = state, None
    for iteration in range(rule.iterations):
        step = problem.step(aim, damping)
        if straight is not None:
            step = _keep_promise(step, straight, bent)
        promise = step.full_promise
        left = promise
        if rule.contraction < 1.0:
            left = promise * np.minimum(np.maximum(promise / before, rule.contraction), 1.0)
        settled = left <= rule.tolerance * np.minimum(state.cost, rule.unit)
        arrived = settled | (damping > LAST_DAMPING) | (state.cost < EXACT)
        least, has_settled = min(least, float(state.cost.min())), has_settled or bool(settled.any())
        beaten = state.cost - ABOUT_RIGHT * promise > min(least + HOPELESS, rule.bar)
        # which one is best is not sure before one has settled
        over = arrived | beaten
        is_last = bool(over.all())
        over = over if is_last or has_settled else arrived
        if over.any():
            end = state
            if rule.last_step and settled.any():
                end = state.put(np.flatnonzero(settled), problem.extrapolate(state, step).select(settled))
            flags = (flag[over] for flag in (state.cost < EXACT, settled, arrived, beaten))
            gone.append(_Gone(live[over], end.select(over), _tell_ends(*flags)))
            if is_last:
                return _gather(gone, iteration)
            going = np.flatnonzero(~over)
            problem, state, step = problem.narrow(going), state.select(going), step.select(going)
            live, damping, before = live[going], damping[going], before[going]
            trusted, bent, beaten = trusted[going], bent[going], beaten[going]
        proposal = problem.follow(state, step)
        gain = state.cost - proposal.cost
        better = np.asarray(gain > 0)
        kept = gain / np.maximum(step.promise, LEAST_PROMISE)
        change = _change_damping(kept, better, trusted, bent)
        again = ~better & ~bent & (proposal.cost < BENT_TIMES * state.cost)
        index = np.flatnonzero(again)
        turned = problem.bend(state.select(index), step.select(index), proposal.select(index)) if len(index) else None
        bent = np.zeros(len(live), dtype=bool)
        if turned is not None:
            bent[index], change[index] = True, 1.0
        damping = np.maximum(damping * change, LEAST_DAMPING)
        trusted, before = better, np.maximum(step.full_promise, LEAST_PROMISE)
        state = state.put(np.flatnonzero(better), proposal.select(better))
        aim, straight = (state, None) if turned is None else (state.put(index, turned), step)
    nothing = np.zeros(len(live), dtype=bool)
    gone.append(_Gone(live, state, _tell_ends(state.cost < EXACT, nothing, nothing, beaten)))
    return _gather(gone, rule.iterations)


@dataclass(frozen=True, slots=True)
class _Gone(Generic[S]):
    """Starts that are not followed further, by their numbers: where they ended, and why each of them did."""

    numbers: Indices
    state: S
    ends: tuple[End, ...]


def _gather(gone: list[_Gone[S]], iterations: int) -> Solution[S]:
    """All starts in the order in which they were given."""
    if len(gone) == 1:
        return Solution(gone[0].state, iterations, gone[0].ends)
    order = np.argsort(np.concatenate([part.numbers for part in gone]))
    ends = [end for part in gone for end in part.ends]
    state = gone[0].state.join([part.state for part in gone[1:]]).select(order)
    return Solution(state, iterations, tuple(ends[k] for k in order))


def _change_damping(kept: Array, better: Mask, trusted: Mask, bent: Mask) -> Array:
    """By what the damping of each start changes: the nearer its cost falls to what was promised, the less damped is the
    next step.
    """
    sure = (kept > NEARLY_ALL) & (trusted | bent)
    less = np.where(bent, BENT_CHANGE, 0.1)
    return np.where(sure, less, np.where(kept > SOME, 1.0, np.where(better, 4.0, 8.0)))


def _keep_promise(step: Step, straight: Step, bent: Mask) -> Step:
    """The steps, of which those along a bend promise what the straight ones before them did."""
    promise, full = (
        np.where(bent, before, now)
        for before, now in ((straight.promise, step.promise), (straight.full_promise, step.full_promise))
    )
    return replace(step, promise=promise, full_promise=full)


def _tell_ends(exact: Mask, settled: Mask, arrived: Mask, beaten: Mask) -> tuple[End, ...]:
    return tuple(
        End.EXACT if e else End.SETTLED if s else End.STUCK if a else End.BEATEN if b else End.LIMIT
        for e, s, a, b in zip(exact, settled, arrived, beaten, strict=True)
    )


def solve_damped(normal: Array, gradient: Array, damping: Array, gauge: Array | float = 0.0) -> Array:
    """Solutions (..., B, P) of normal equations (B, P, P) with shares (..., B) of their diagonal added to it
    (Marquardt).
    """
    index = np.arange(normal.shape[-1])
    damped = np.empty((*damping.shape, *normal.shape[1:]))
    damped[:] = normal + gauge
    damped[..., index, index] += damping[..., None] * (normal[:, index, index] + 1e-12)
    right = gradient[..., None]
    try:
        found = np.linalg.solve(damped, right)
    except np.linalg.LinAlgError:
        found = np.linalg.pinv(damped, hermitian=True) @ right
    return np.asarray(found[..., 0], dtype=np.float64)


def predict_decrease(normal: Array, gradient: Array, change: Array) -> Array:
    """By how much a change (B, P) lowers the quadratic model ``cost + 2 g^T d + d^T N d`` of the cost (B,)."""
    return -np.asarray(((2.0 * gradient + (normal @ change[..., None])[..., 0]) * change).sum(axis=1))


def invert_normal(matrices: Array) -> Array:
    """Inverses of normal matrices (..., P, P) of quantities of very different size, without the directions in which
    each of them is singular.
    """
    size = np.sqrt(np.maximum(np.diagonal(matrices, axis1=-2, axis2=-1), 1e-300))
    scale = size[..., :, None] * size[..., None, :]
    return np.asarray(_invert_correlation(matrices / scale) / scale)


def _invert_correlation(correlation: Array) -> Array:
    try:
        inverse = np.linalg.inv(correlation)
    except np.linalg.LinAlgError:
        inverse = np.full_like(correlation, np.inf)
    if np.abs(inverse).max(initial=0.0) < LARGEST_INVERSE:
        return np.asarray(0.5 * (inverse + inverse.swapaxes(-1, -2)))
    if correlation.ndim > 2:
        return np.array([_invert_correlation(own) for own in correlation])
    return np.asarray(np.linalg.pinv(correlation, rcond=1e-13, hermitian=True))
