"""Levenberg-Marquardt over a batch of starts, with Gaussian priors and a graduated robust loss."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from circlecal.camera.residuals import (
    CurvePoints,
    FixedPoints,
    curve_residuals,
    first_hidden,
    ground_hidden,
    joined_curves,
)
from circlecal.camera.shared_prior import SharedPrior
from circlecal.camera.viewing_coordinates import LOOK, from_look, look_with_jacobian
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, active_parameters
from circlecal.geometry.projective import Array, Indices, Mask

LARGEST_STEP = 0.7
"""Of the logarithms of focal length and distance and of the angles, in one iteration."""
LOG_FOCAL_RANGE = (np.log(10.0), np.log(1e6))
"""Of the focal length in pixels: nothing outside is a camera."""
LEAST_DAMPING, FIRST_DAMPING, LAST_DAMPING = 1e-10, 1e-4, 1e5
FINAL, COARSE = 3e-5, 0.5
"""Decreases of the cost (chi-square) that are not worth a step: of a result, and of what is only compared."""
LEAST_SHARE = 0.01
"""What a step is taken to leave of its promise at best, however much less it was than the one before it."""
HOPELESS = 100.0
"""A start whose cost is so much worse than the best one's, beyond what its steps promise, is not followed on."""
EXACT = 1e-24
"""Cost at which the residuals are rounding errors."""
KNOWN_POSITION_SD_M = 1.0
"""A position known to this is where the search starts."""
_POSITION = slice(INDEX["x"], INDEX["z"] + 1)
_CAUTIOUS = np.array([[1, 0, 0, 1, 1, 1, 1], [1, 1, 1, 1, 0, 0, 0]], dtype=np.float64)
"""Which of the first parameters the largest step is about: in look coordinates, and in others."""


@dataclass(frozen=True)
class Priors:
    """Gaussian priors of the parameters, and of a camera's usual place.

    Attributes
    ----------
    mean, sd : (P,) arrays
        Per parameter; sd 0 fixes it at its mean, inf leaves it free.
    distance_m, distance_log_sd : float
        Log-normal prior of the distance from ``center_m``; sd inf for none.
    elevation_rad, elevation_sd_rad : float
        Gaussian prior of the angle under which the camera looks down on it; sd inf for none.
    center_m : (2,) array
        What the camera looks at: the circle's centre, or the middle of what was seen instead of the circle.
    shared : SharedPrior or None
        What other frames of the same camera say; the parameters that it covers have no other prior.
    """

    mean: Array
    sd: Array
    distance_m: float
    distance_log_sd: float
    elevation_rad: float
    elevation_sd_rad: float
    center_m: Array
    shared: SharedPrior | None = None

    @property
    def standing_m(self) -> Array | None:
        """Where the camera stands (3,), metres, if that is known well."""
        known = self.shared is not None or (self.sd[_POSITION] <= KNOWN_POSITION_SD_M).all()
        return self.mean[_POSITION] if known else None

    def residuals(self, theta: Array) -> tuple[Array, Array]:
        """Normalised residuals (B, K) and their Jacobian (B, K, P)."""
        values, jacobian = self._of_parameters_and_place(theta)
        if self.shared is None:
            return values, jacobian
        told, by_theta = self.shared.residuals(theta)
        return np.concatenate([values, told], axis=1), np.concatenate([jacobian, by_theta], axis=1)

    @cached_property
    def _linear(self) -> tuple[Indices, Array, Array]:
        """Which parameters have a prior of their own (K,), whether the place has (2,), and the Jacobian (K or more, P)
        without the place's.
        """
        used = np.flatnonzero((self.sd > 0) & np.isfinite(self.sd))
        place = np.isfinite([self.distance_log_sd, self.elevation_sd_rad])
        jacobian = np.zeros((len(used) + int(place.sum()), len(PARAMETERS)))
        jacobian[np.arange(len(used)), used] = 1.0 / self.sd[used]
        return used, place, jacobian

    def _of_parameters_and_place(self, theta: Array) -> tuple[Array, Array]:
        used, place, linear = self._linear
        jacobian = np.repeat(linear[None], len(theta), axis=0)
        values = np.empty(jacobian.shape[:2])
        values[:, : len(used)] = (theta[:, used] - self.mean[used]) / self.sd[used]
        if not place.any():
            return values, jacobian
        offset = theta[:, _POSITION].copy()
        offset[:, :2] -= self.center_m
        level2 = np.maximum(offset[:, 0] ** 2 + offset[:, 1] ** 2, 1e-12)
        distance2 = np.maximum(level2 + offset[:, 2] ** 2, 1e-6)
        row = len(used)
        if place[0]:
            values[:, row] = (0.5 * np.log(distance2) - np.log(self.distance_m)) / self.distance_log_sd
            jacobian[:, row, _POSITION] = offset / (distance2 * self.distance_log_sd)[:, None]
            row += 1
        if place[1]:
            level = np.sqrt(level2)
            values[:, row] = (np.arctan2(-offset[:, 2], level) - self.elevation_rad) / self.elevation_sd_rad
            by_offset = np.column_stack([offset[:, :2] * (offset[:, 2] / level)[:, None], -level])
            jacobian[:, row, _POSITION] = by_offset / (distance2 * self.elevation_sd_rad)[:, None]
        return values, jacobian


@dataclass(frozen=True, slots=True)
class Problem:
    """Everything that the cost of a camera is made of."""

    curves: CurvePoints
    points: FixedPoints
    priors: Priors
    model: ProjectionModel

    def hypotheses(self, index: Indices) -> Problem:
        """Some of the hypotheses about the curves, where there are several."""
        return self if self.curves.sigma_px.ndim == 1 else replace(self, curves=self.curves.hypotheses(index))


@dataclass(frozen=True, slots=True)
class State:
    """Where a batch of B starts stands.

    Attributes
    ----------
    theta, hidden : (B, P), (B, N) arrays
        Parameters, and the hidden parameters of the curve points.
    values, jacobian : (B, N + 2 M), (B, N + 2 M, P) arrays
        Normalised residuals of the curve points, then of the fixed points, and their derivatives.
    prior_values, prior_jacobian : (B, K), (B, K, P) arrays
        Those of the priors.
    cost, gradient, normal : (B,), (B, P), (B, P, P) arrays
        Cost under a robust loss, half its gradient and its Gauss-Newton matrix.
    """

    theta: Array
    hidden: Array
    values: Array
    jacobian: Array
    prior_values: Array
    prior_jacobian: Array
    cost: Array
    gradient: Array
    normal: Array

    @property
    def residuals(self) -> Array:
        """Of the curve points (B, N)."""
        return self.values[:, : self.hidden.shape[1]]

    @property
    def point_values(self) -> Array:
        """Residuals of the fixed points (B, 2 M)."""
        return self.values[:, self.hidden.shape[1] :]

    def select(self, index: Indices | Mask) -> State:
        """The starts at an index or mask."""
        return State(*(getattr(self, name)[index] for name in State.__slots__))


def evaluate(problem: Problem, theta: Array, hidden: Array, loss_scale: float, updates: int = 0) -> State:
    """Cost, gradient and Gauss-Newton matrix of each start under a Geman-McClure loss of scale ``loss_scale`` (in
    sigmas).
    """
    seen = curve_residuals(problem.curves, theta, hidden, problem.model, updates, problem.points)
    seen.values[:, : hidden.shape[1]][seen.behind] = 1e3
    priors = problem.priors.residuals(theta)
    return weighed(theta, seen.hidden, seen.values, seen.jacobian, *priors, loss_scale)


def weighed(
    theta: Array,
    hidden: Array,
    values: Array,
    jacobian: Array,
    prior_values: Array,
    prior_jacobian: Array,
    loss_scale: float,
) -> State:
    """The state with these residuals and derivatives under a Geman-McClure loss."""
    squared = values * values
    share = 1.0 / (1.0 + squared / loss_scale**2)
    weight = share * share
    rows, prior_rows = np.swapaxes(jacobian, 1, 2), np.swapaxes(prior_jacobian, 1, 2)
    gradient = rows @ (weight * values)[..., None] + prior_rows @ prior_values[..., None]
    normal = (rows * weight[:, None]) @ jacobian + prior_rows @ prior_jacobian
    cost = (squared * share).sum(axis=1) + (prior_values * prior_values).sum(axis=1)
    return State(theta, hidden, values, jacobian, prior_values, prior_jacobian, cost, gradient[..., 0], normal)


def reweighted(problem: Problem, state: State, sigma_px: Array, loss_scale: float) -> tuple[Problem, State]:
    """The problem with other standard deviations (N,) of its curve points, and the state in it under a loss."""
    curves = problem.curves.with_sigma(sigma_px)
    factor = np.ones(state.values.shape[1])
    factor[: len(sigma_px)] = problem.curves.sigma_px / sigma_px
    changed = weighed(
        state.theta, state.hidden, state.values * factor, state.jacobian * factor[:, None],
        state.prior_values, state.prior_jacobian, loss_scale,
    )  # fmt: skip
    return replace(problem, curves=curves), changed


def with_curves(problem: Problem, state: State, curves: CurvePoints, loss_scale: float) -> tuple[Problem, State]:
    """The problem with further markings before the others, and the state in it: only the further ones are looked at."""
    hidden = ground_hidden(curves, state.theta, problem.model)
    seen = curve_residuals(curves, state.theta, hidden, problem.model, updates=0)
    changed = weighed(
        state.theta,
        np.concatenate([seen.hidden, state.hidden], axis=1),
        np.concatenate([seen.values, state.values], axis=1),
        np.concatenate([seen.jacobian, state.jacobian], axis=1),
        state.prior_values,
        state.prior_jacobian,
        loss_scale,
    )
    return replace(problem, curves=joined_curves(curves, problem.curves)), changed


def minimise(
    problem: Problem,
    starts: Array,
    loss_scale: float,
    iterations: int = 60,
    hidden: Array | None = None,
    tolerance: float = FINAL,
    bar: float = np.inf,
) -> State:
    """Run Levenberg-Marquardt from every start (B, P) at once; each keeps its own damping.

    It ends where an undamped step would lower no start's cost by more than ``tolerance``, or by that share of a cost
    below 1.
    """
    theta = starts.copy()
    fixed = problem.priors.sd <= 0
    theta[:, fixed] = problem.priors.mean[fixed]
    told = hidden is not None
    if hidden is None:
        hidden = first_hidden(problem.curves, theta, problem.model)[0]
    state = evaluate(problem, theta, hidden, loss_scale, updates=0 if told else 2)
    return continued(problem, state, loss_scale, iterations, tolerance, bar)


def continued(
    problem: Problem,
    state: State,
    loss_scale: float,
    iterations: int = 60,
    tolerance: float = FINAL,
    bar: float = np.inf,
) -> State:
    """:func:`minimise` from known residuals; starts that promise no cost below ``bar`` are not followed.

    A final result takes the last step in the linear model, which is exact to the order of the next step.
    """
    active = active_parameters(problem.priors.sd)
    damping = np.full(len(state.theta), FIRST_DAMPING)
    trusted: Mask = np.ones(len(damping), dtype=bool)
    before = np.full(len(damping), 1e-100)
    for _ in range(iterations):
        possible = _possible(state, active)
        left = possible * np.clip(possible / before, LEAST_SHARE, 1.0) if tolerance == FINAL else possible
        settled = left <= tolerance * np.minimum(state.cost, 1.0)
        arrived = settled | (damping > LAST_DAMPING) | (state.cost < EXACT)
        beaten = state.cost - 3.0 * possible > min(state.cost.min() + HOPELESS, bar)
        if (arrived | beaten).all():
            if tolerance == FINAL and settled.any():
                advanced = _advanced(state, _stepped(problem, state, damping, active), loss_scale)
                return _replaced(state, np.flatnonzero(settled), advanced.select(settled))
            return state
        # which one is best is not sure before one has settled
        left_alone = arrived | (beaten & settled.any())
        step, going = _stepped(problem, state, damping, active), np.flatnonzero(~left_alone)
        proposal = evaluate(problem.hypotheses(going), step.theta[going], state.hidden[going], loss_scale)
        gain = state.cost[going] - proposal.cost
        better = np.asarray(gain > 0)
        # the nearer the cost falls to what was expected of the step, the less damped is the next one
        share = gain / np.maximum(step.expected[going], 1e-300)
        sure = (share > 0.7) & trusted[going]
        damping[going] *= np.where(sure, 0.1, np.where(share > 0.25, 1.0, np.where(better, 4.0, 8.0)))
        trusted[going], before[going] = better, np.maximum(possible[going], 1e-300)
        state = _replaced(state, going[better], proposal.select(better))
    return state


@dataclass(frozen=True, slots=True)
class _Step:
    """Parameters (B, P) after one damped step, the change (B, P) that it is to first order, and by how much it would
    lower a quadratic cost (B,).
    """

    theta: Array
    change: Array
    expected: Array


def foreseen(problem: Problem, state: State, loss_scale: float) -> State:
    """Where an undamped step leads, in the linear model: nothing is looked at again."""
    damping = np.full(len(state.theta), LEAST_DAMPING)
    return _advanced(state, _stepped(problem, state, damping, active_parameters(problem.priors.sd)), loss_scale)


def _advanced(state: State, step: _Step, loss_scale: float) -> State:
    """The state after a step, in the linear model."""
    values, prior_values = (
        now + (jacobian @ step.change[..., None])[..., 0]
        for now, jacobian in ((state.values, state.jacobian), (state.prior_values, state.prior_jacobian))
    )
    return weighed(step.theta, state.hidden, values, state.jacobian, prior_values, state.prior_jacobian, loss_scale)


def _possible(state: State, active: Indices) -> Array:
    """By how much an undamped step would lower a quadratic cost (B,)."""
    slope = state.gradient[:, active]
    step = _solved(state.normal[:, active[:, None], active], slope, np.full(len(slope), LEAST_DAMPING))
    return np.asarray((step * slope).sum(axis=1))


def _stepped(problem: Problem, state: State, damping: Array, active: Indices) -> _Step:
    """One damped step, taken in the coordinates in which the weak direction is straight."""
    center = problem.priors.center_m
    straight = bool((problem.priors.sd[:LOOK] > 0).all())
    gradient, normal = state.gradient, state.normal
    usable: Mask = np.zeros(len(damping), dtype=bool)
    look = state.theta[:, :LOOK]
    if straight:
        look, by_look = look_with_jacobian(state.theta, center)
        usable = np.isfinite(look.sum(axis=1) + by_look.sum(axis=(1, 2)))
        if not usable.all():
            by_look[~usable] = np.eye(LOOK)
        turned = np.swapaxes(by_look, 1, 2)
        gradient, normal = gradient.copy(), normal.copy()
        gradient[:, :LOOK] = (turned @ gradient[:, :LOOK, None])[..., 0]
        normal[:, :LOOK] = turned @ normal[:, :LOOK]
        normal[:, :, :LOOK] = normal[:, :, :LOOK] @ by_look
    block, slope = normal[:, active[:, None], active], gradient[:, active]
    step = -_solved(block, slope, damping)
    full = np.zeros_like(state.theta)
    full[:, active] = step
    size = np.abs(full[:, :LOOK])
    largest = np.where(usable[:, None], size * _CAUTIOUS[0], size * _CAUTIOUS[1]).max(axis=1)
    shortened = np.maximum(largest / LARGEST_STEP, 1.0)[:, None]
    step, full = step / shortened, full / shortened
    theta = state.theta + full
    if usable.all():
        theta[:, :LOOK] = from_look(look + full[:, :LOOK], center)
    elif usable.any():
        theta[usable, :LOOK] = from_look(look[usable] + full[usable, :LOOK], center)
    theta[:, 0] = np.minimum(np.maximum(theta[:, 0], LOG_FOCAL_RANGE[0]), LOG_FOCAL_RANGE[1])
    if straight:
        full[:, :LOOK] = (by_look @ full[:, :LOOK, None])[..., 0]
    change_of_cost = ((2.0 * slope + (block @ step[..., None])[..., 0]) * step).sum(axis=1)
    return _Step(theta, full, -change_of_cost)


def _solved(normal: Array, gradient: Array, damping: Array) -> Array:
    """Solutions (B, A) of the damped normal equations."""
    index = np.arange(normal.shape[-1])
    damped = normal.copy()
    damped[:, index, index] += damping[:, None] * (normal[:, index, index] + 1e-12)
    try:
        found = np.linalg.solve(damped, gradient[..., None])
    except np.linalg.LinAlgError:
        found = np.linalg.pinv(damped, hermitian=True) @ gradient[..., None]
    return np.asarray(found[..., 0], dtype=np.float64)


def _replaced(state: State, index: Indices, new: State) -> State:
    """The state with other starts at an index."""
    if len(index) == len(state.cost):
        return new

    def put(name: str) -> Array:
        found = getattr(state, name).copy()
        found[index] = getattr(new, name)
        return np.asarray(found)

    return State(*(put(name) for name in State.__slots__)) if len(index) else state


def best_of(state: State, count: int = 1) -> State:
    """The starts with the lowest cost."""
    return state.select(np.argsort(state.cost, kind="stable")[:count])
