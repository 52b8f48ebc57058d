"""Levenberg-Marquardt over a batch of starts, with Gaussian priors and a graduated robust loss."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from circlecal.camera_fit.curves import CurvePoints, FixedPoints, curve_residuals, first_hidden, point_residuals
from circlecal.camera_fit.look import LOOK, from_look, look_with_jacobian
from circlecal.camera_fit.model import INDEX, PARAMETERS, Frame, active_parameters
from circlecal.camera_fit.shared_prior import SharedPrior
from circlecal.geometry.homogeneous import Array, Indices, Mask

LARGEST_STEP = 0.7
"""Of the logarithms of focal length and distance and of the angles, in one iteration."""
LOG_FOCAL_RANGE = (np.log(10.0), np.log(1e6))
"""Of the focal length in pixels: nothing outside is a camera."""
LEAST_DAMPING, FIRST_DAMPING, LAST_DAMPING = 1e-10, 1e-4, 1e5
FINAL, COARSE = 1e-4, 0.5
"""Decreases of the cost (chi-square) that are not worth a step: of a result, and of what is only compared."""
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
    frame: Frame


@dataclass(frozen=True, slots=True)
class State:
    """Where a batch of B starts stands: parameters (B, P), cost (B,), residuals and hidden parameters of the curve
    points (B, N).
    """

    theta: Array
    cost: Array
    residuals: Array
    hidden: Array
    gradient: Array
    normal: Array
    point_values: Array


def evaluate(problem: Problem, theta: Array, hidden: Array, loss_scale: float, updates: int = 0) -> State:
    """Cost, gradient and Gauss-Newton matrix of each start under a Geman-McClure loss of scale ``loss_scale`` (in
    sigmas).
    """
    curve = curve_residuals(problem.curves, theta, hidden, problem.frame, updates)
    values = np.where(curve.behind, 1e3, curve.values)
    gradient, normal, cost = _weighted(values, curve.jacobian, loss_scale)
    point_values, point_jacobian = point_residuals(problem.points, theta, problem.frame)
    if point_values.shape[1]:
        g, n, c = _weighted(point_values, point_jacobian, loss_scale)
        gradient, normal, cost = gradient + g, normal + n, cost + c
    prior_values, prior_jacobian = problem.priors.residuals(theta)
    swapped = np.swapaxes(prior_jacobian, 1, 2)
    gradient = gradient + (swapped @ prior_values[..., None])[..., 0]
    normal = normal + swapped @ prior_jacobian
    cost = cost + np.sum(prior_values**2, axis=1)
    return State(theta, cost, values, curve.hidden, gradient, normal, point_values)


def robust_weights(values: Array, loss_scale: float) -> Array:
    """Weights of iteratively reweighted least squares for the Geman-McClure loss."""
    return 1.0 / (1.0 + (values / loss_scale) ** 2) ** 2


def _weighted(values: Array, jacobian: Array, loss_scale: float) -> tuple[Array, Array, Array]:
    squared = values * values
    share = 1.0 / (1.0 + squared / loss_scale**2)
    weight = share * share
    rows = np.swapaxes(jacobian, 1, 2)
    gradient = (rows @ (weight * values)[..., None])[..., 0]
    return gradient, (rows * weight[:, None]) @ jacobian, (squared * share).sum(axis=1)


def minimise(
    problem: Problem,
    starts: Array,
    loss_scale: float,
    iterations: int = 60,
    hidden: Array | None = None,
    tolerance: float = FINAL,
) -> State:
    """Run Levenberg-Marquardt from every start (B, P) at once; each keeps its own damping.

    It ends where an undamped step would lower no start's cost by more than ``tolerance``, or by that share of a cost
    below 1.
    """
    active = active_parameters(problem.priors.sd)
    theta = starts.copy()
    fixed = problem.priors.sd <= 0
    theta[:, fixed] = problem.priors.mean[fixed]
    if hidden is None:
        hidden = first_hidden(problem.curves, theta, problem.frame)[0]
        hidden = curve_residuals(problem.curves, theta, hidden, problem.frame, updates=1).hidden
    state = evaluate(problem, theta, hidden, loss_scale, updates=1)
    damping = np.full(len(theta), FIRST_DAMPING)
    straight = bool((problem.priors.sd[:LOOK] > 0).all())
    trusted: Mask = np.ones(len(theta), dtype=bool)
    for _ in range(iterations):
        theta, expected, possible = _stepped(problem, state, damping, active, straight)
        settled = (possible <= tolerance * np.minimum(state.cost, 1.0)) | (damping > LAST_DAMPING)
        beaten = state.cost - 3.0 * possible > state.cost.min() + HOPELESS
        if (settled | beaten | (state.cost < EXACT)).all():
            break
        proposal = evaluate(problem, theta, state.hidden, loss_scale)
        better = np.asarray(proposal.cost < state.cost)
        # the nearer the cost falls to what was expected of the step, the less damped is the next one
        share = (state.cost - proposal.cost) / np.maximum(expected, 1e-300)
        damping *= np.where((share > 0.7) & trusted, 0.1, np.where(share > 0.25, 1.0, np.where(better, 4.0, 8.0)))
        trusted = better
        state = _merge(state, proposal, better)
    return state


def _stepped(
    problem: Problem, state: State, damping: Array, active: Indices, straight: bool
) -> tuple[Array, Array, Array]:
    """Parameters (B, P) after one damped step, taken in the coordinates in which the weak direction is straight; by how
    much it and an undamped one would lower a quadratic cost, each (B,).
    """
    center = problem.priors.center_m
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
    step, undamped = _damped(block, slope, damping)
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
    change_of_cost = ((2.0 * slope + (block @ step[..., None])[..., 0]) * step).sum(axis=1)
    return theta, -change_of_cost, -(undamped * slope).sum(axis=1)


def _damped(normal: Array, gradient: Array, damping: Array) -> tuple[Array, Array]:
    """Damped and undamped step, each (B, A)."""
    index = np.arange(normal.shape[-1])
    diagonal = normal[:, index, index] + 1e-12
    both = np.stack([normal, normal])
    both[0, :, index, index] += (damping[:, None] * diagonal).T
    both[1, :, index, index] += (LEAST_DAMPING * diagonal).T
    damped, undamped = -_solve(both, np.broadcast_to(gradient, (2, *gradient.shape)))
    return damped, undamped


def _solve(matrices: Array, vectors: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(matrices, hermitian=True) @ vectors[..., None])[..., 0], dtype=np.float64)


def _merge(old: State, new: State, better: Mask) -> State:
    if better.all():
        return new
    if not better.any():
        return old

    def pick(name: str) -> Array:
        a, b = getattr(old, name), getattr(new, name)
        return np.where(better.reshape(-1, *([1] * (a.ndim - 1))), b, a)

    return State(*(pick(name) for name in State.__slots__))


def best_of(state: State, count: int = 1) -> State:
    """The starts with the lowest cost."""
    order = np.argsort(state.cost, kind="stable")[:count]
    return State(*(getattr(state, name)[order] for name in State.__slots__))
