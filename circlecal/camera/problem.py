"""What the cost of a camera is made of, and its steps: residuals and priors behind the one Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.priors import Priors, stack_priors
from circlecal.camera.residuals import (
    CurvePoints,
    FixedPoints,
    curve_points,
    curve_residuals,
    ground_feet,
    join_curves,
    sample_feet,
)
from circlecal.camera.viewing_coordinates import VIEWING, from_viewing, to_viewing_with_jacobian
from circlecal.geometry import least_squares
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import INDEX, LOG_FOCAL, PARAMETERS, ProjectionModel, camera_of
from circlecal.geometry.least_squares import (
    LEAST_DAMPING,
    Batch,
    Step,
    StoppingRule,
    predict_decrease,
    solve_damped,
)
from circlecal.geometry.projective import Array, Indices, Mask

FINAL = StoppingRule(3e-5, contraction=0.01, last_step=True)
"""For a result: what is left of the cost (chi-square) when it stops is that of 0.005 standard deviations."""
COARSE = StoppingRule(0.5)
"""For what is only compared: hypotheses differ by tens of chi-square where they differ at all."""
WIDE_LOSS, FAR_LOSS = 10.0, 100.0
"""By how much wider the loss is while hypotheses are compared, since a line that does not fit pulls, and then tells;
and for starts that lie hundreds of pixels from what they are to explain.
"""
LARGEST_STEP = 0.7
"""Of the logarithms of focal length and distance and of the angles (radians), in one iteration."""
LOG_FOCAL_RANGE = (np.log(10.0), np.log(1e6))
"""Of the focal length in pixels: nothing outside is a camera."""
BEHIND = 1e3
"""Residual, standard deviations, of a point whose place the camera does not show: more than any loss looks at."""
HARDLY_ZOOMED, HARDLY_ROBUST = 0.04, 1.0
"""A linear model foretells the optimum of a camera whose focal length changes by less than this (logarithm) on the way,
where the loss there differs by no more (chi-square) from what the step promises. In 882 fits to real and rendered
frames the logarithm of the evidence that it foretold was off by 0.08 (90 %), 0.21 (99 %) and 0.75 at most; in 591 that
zoom by more or meet the bend of the loss by 0.2 (half of them) and 7 (90 %).
"""
_CAUTIOUS = np.array([[1, 0, 0, 1, 1, 1, 1], [1, 1, 1, 1, 0, 0, 0]], dtype=np.float64)
"""Which of the first parameters the largest step is about: in viewing coordinates, and in others."""
_IDENTITY = np.eye(len(PARAMETERS))
_PLACE, _GROWTH = [INDEX["x"], INDEX["y"]], [INDEX["length"], INDEX["breadth"]]


@dataclass(frozen=True, slots=True)
class State(Batch):
    """Where a batch of B starts stands.

    Attributes
    ----------
    theta, feet : (B, P), (B, N) arrays
        Parameters, and the foot parameters of the curve points.
    values, jacobian : (B, N + 2 M), (B, N + 2 M, P) arrays
        Normalised residuals of the curve points, then of the fixed points, and their derivatives.
    prior_values, prior_jacobian : (B, K), (B, K, P) arrays
        Those of the priors.
    cost, gradient, normal : (B,), (B, P), (B, P, P) arrays
        Cost under a robust loss, half its gradient and its Gauss-Newton matrix.
    """

    theta: Array
    feet: Array
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
        return self.values[:, : self.feet.shape[1]]

    @property
    def point_values(self) -> Array:
        """Residuals of the fixed points (B, 2 M)."""
        return self.values[:, self.feet.shape[1] :]

    def best(self, count: int = 1) -> State:
        """The starts with the lowest cost."""
        return self.select(np.argsort(self.cost, kind="stable")[:count])


@dataclass(frozen=True, slots=True)
class Problem:
    """Observations and priors of a camera, and the scale of the Geman-McClure loss, standard deviations.

    Implements :class:`circlecal.geometry.least_squares.Problem`. The foot parameters follow the camera: they are moved
    in each evaluation and never enter the normal equations.
    """

    curves: CurvePoints
    points: FixedPoints
    priors: Priors
    model: ProjectionModel
    loss_scale: float = np.inf

    @property
    def usual_lens(self) -> Camera:
        """A camera with the lens that the priors expect, to start from undistorted pixels."""
        theta = np.where(np.isfinite(self.priors.mean), self.priors.mean, 0.0).copy()
        theta[0] = np.log(self.model.width * 2.0)
        return camera_of(theta, self.model)

    def share_of_loss(self, values: Array) -> Array:
        """By how much the loss takes residuals down, ``1 / (1 + r^2 / s^2)``; its square is their weight."""
        return np.asarray(1.0 / (1.0 + values * values / self.loss_scale**2))

    def narrow(self, index: Indices) -> Problem:
        """Some of the hypotheses about the curves, in their order, where there are several."""
        is_all = self.curves.sigma_px.ndim == 1 or len(index) == len(self.curves.sigma_px)
        return self if is_all else replace(self, curves=self.curves.hypotheses(index))

    def step(self, state: State, damping: Array) -> Step:
        """One damped step, taken in the coordinates in which the weak direction is straight."""
        priors, active, theta = self.priors, self.priors.active, state.theta
        gradient, normal = state.gradient[..., None], state.normal
        usable: Mask = np.zeros(len(damping), dtype=bool)
        viewing, by_straight = theta[:, :VIEWING], _IDENTITY
        if priors.is_camera_free:
            viewing, by_viewing, usable = to_viewing_with_jacobian(theta, priors.center_of(theta))
            by_straight = np.empty(normal.shape)
            by_straight[:] = _IDENTITY
            by_straight[:, :VIEWING, :VIEWING] = by_viewing
            by_straight[:, _PLACE, _GROWTH] = priors.center_by_growth
            if not usable.all():
                by_straight[~usable] = _IDENTITY
            # by the chain rule the gradient becomes T^T g and the matrix T^T N T
            transposed = by_straight.swapaxes(1, 2)
            gradient, normal = transposed @ gradient, transposed @ normal @ by_straight
        are_all_usable = bool(usable.all())
        block, slope = normal[:, active[:, None], active], gradient[:, active, 0]
        change, undamped = _solve_both(block, slope, damping)
        full = np.zeros(theta.shape)
        full[:, active] = change
        cautious = _CAUTIOUS[0] if are_all_usable else _CAUTIOUS[np.where(usable, 0, 1)]
        largest = (np.abs(full[:, :VIEWING]) * cautious).max(axis=1)
        if not (largest <= LARGEST_STEP).all():
            shortening = np.maximum(largest / LARGEST_STEP, 1.0)[:, None]
            change, full = change / shortening, full / shortening
        there = theta + full
        if are_all_usable or usable.any():
            seen_there = viewing + full[:, :VIEWING]
            seen_there[~usable] = 0.0  # there x, in metres, would be the logarithm of a distance
            seen = from_viewing(seen_there, priors.center_of(there))
            there[:, :VIEWING] = seen if are_all_usable else np.where(usable[:, None], seen, there[:, :VIEWING])
        there[:, 0] = np.minimum(np.maximum(there[:, 0], LOG_FOCAL_RANGE[0]), LOG_FOCAL_RANGE[1])
        full = (by_straight @ full[..., None])[..., 0]
        # what an undamped step promises is the same in all coordinates
        return Step(there, full, predict_decrease(block, slope, change), -(undamped * slope).sum(axis=1))

    def follow(self, state: State, step: Step) -> State:
        """The starts where a step has led them."""
        return evaluate(self, step.parameters, state.feet)

    def bend(self, state: State, step: Step, proposal: State) -> State:
        """States whose gradient holds by how much the residuals that a step led to differ from the linear model, with
        the weights that they had before it.
        """
        change = step.change[..., None]
        off = proposal.values - state.values - (state.jacobian @ change)[..., 0]
        prior_off = proposal.prior_values - state.prior_values - (state.prior_jacobian @ change)[..., 0]
        share = self.share_of_loss(state.values)
        more = (np.swapaxes(state.jacobian, 1, 2) @ (share * share * off)[..., None])[..., 0]
        more += (np.swapaxes(state.prior_jacobian, 1, 2) @ prior_off[..., None])[..., 0]
        return replace(state, gradient=state.gradient + more)

    def extrapolate(self, state: State, step: Step) -> State:
        """All starts after a step in the linear model."""
        values, prior_values = (
            now + (jacobian @ step.change[..., None])[..., 0]
            for now, jacobian in ((state.values, state.jacobian), (state.prior_values, state.prior_jacobian))
        )
        return apply_loss(self, step.parameters, state.feet, values, state.jacobian, prior_values, state.prior_jacobian)


def _solve_both(block: Array, slope: Array, damping: Array) -> tuple[Array, Array]:
    """Changes (B, Q) by steps of some damping (B,), and by those as good as undamped."""
    if (damping == LEAST_DAMPING).all():
        change = -solve_damped(block, slope, damping)
        return change, change
    both = np.full((2, len(damping)), LEAST_DAMPING)
    both[0] = damping
    change, undamped = -solve_damped(block, slope, both)
    return change, undamped


def evaluate(problem: Problem, theta: Array, feet: Array, updates: int = 0) -> State:
    """Cost, gradient and Gauss-Newton matrix of each start (B, P), the feet (B, N) moved ``updates`` times before."""
    seen = curve_residuals(problem.curves, theta, feet, problem.model, updates, problem.points)
    if seen.behind.any():
        seen.values[seen.behind] = BEHIND
        # a fixed point that is not shown tells nothing of the camera: from there pixels run the wrong way
        seen.jacobian[:, feet.shape[1] :][seen.behind[:, feet.shape[1] :]] = 0.0
    return apply_loss(problem, theta, seen.feet, seen.values, seen.jacobian, *problem.priors.residuals(theta))


def apply_loss(
    problem: Problem,
    theta: Array,
    feet: Array,
    values: Array,
    jacobian: Array,
    prior_values: Array,
    prior_jacobian: Array,
) -> State:
    """The state with these residuals and derivatives under the problem's loss.

    A residual r costs ``r^2 / (1 + r^2 / s^2)`` (Geman and McClure 1985); the derivative of that by r is ``2 r w`` with
    the weight ``w = 1 / (1 + r^2 / s^2)^2`` that the Gauss-Newton matrix has too. Priors are not robust.
    """
    squared = values * values
    share = 1.0 / (1.0 + squared / problem.loss_scale**2)
    weight = share * share
    rows, prior_rows = jacobian.swapaxes(1, 2), prior_jacobian.swapaxes(1, 2)
    gradient = rows @ (weight * values)[..., None] + prior_rows @ prior_values[..., None]
    normal = (rows * weight[:, None]) @ jacobian + prior_rows @ prior_jacobian
    cost = (squared * share).sum(axis=1) + (prior_values * prior_values).sum(axis=1)
    return State(theta, feet, values, jacobian, prior_values, prior_jacobian, cost, gradient[..., 0], normal)


def reweight(problem: Problem, state: State, sigma_px: Array) -> tuple[Problem, State]:
    """The problem with other standard deviations (N,) of its curve points, and the state in it."""
    factor = np.ones(state.values.shape[1])
    factor[: len(sigma_px)] = problem.curves.sigma_px / sigma_px
    changed = replace(problem, curves=problem.curves.with_sigma(sigma_px))
    return changed, apply_loss(
        changed, state.theta, state.feet, state.values * factor, state.jacobian * factor[:, None],
        state.prior_values, state.prior_jacobian,
    )  # fmt: skip


def with_loss(problem: Problem, state: State, loss_scale: float) -> tuple[Problem, State]:
    """The problem under a loss of another scale, and the state in it: nothing that was seen is evaluated again."""
    changed = replace(problem, loss_scale=loss_scale)
    return changed, apply_loss(
        changed, state.theta, state.feet, state.values, state.jacobian, state.prior_values, state.prior_jacobian
    )


def with_priors(problem: Problem, state: State, priors: Priors) -> tuple[Problem, State]:
    """The problem with other priors, and the state in it: nothing that was seen is evaluated again."""
    changed = replace(problem, priors=priors)
    return changed, apply_loss(
        changed, state.theta, state.feet, state.values, state.jacobian, *priors.residuals(state.theta)
    )


def stack_hypotheses(problem: Problem, state: State, others: Sequence[Problem]) -> tuple[Problem, State]:
    """Problems that differ from one in priors and in sigmas of fixed points alone as a single one, and the first start
    of a state in each of them: nothing that was seen is evaluated again.
    """
    stacked = replace(problem, priors=stack_priors([other.priors for other in others]))
    factor = np.ones((len(others), state.values.shape[1]))
    sigmas_px = problem.points.sigmas_px
    factor[:, state.feet.shape[1] :] = [(sigmas_px / other.points.sigmas_px).ravel() for other in others]
    theta, feet = (np.repeat(rows[:1], len(others), axis=0) for rows in (state.theta, state.feet))
    values, jacobian = state.values[:1] * factor, state.jacobian[:1] * factor[..., None]
    return stacked, apply_loss(stacked, theta, feet, values, jacobian, *stacked.priors.residuals(theta))


def add_curves(problem: Problem, state: State, curves: CurvePoints) -> tuple[Problem, State]:
    """The problem with further markings before the others, and the state in it: only the further ones are evaluated."""
    feet = ground_feet(curves, state.theta, problem.model)
    seen = curve_residuals(curves, state.theta, feet, problem.model, updates=0)
    changed = apply_loss(
        problem,
        state.theta,
        np.concatenate([seen.feet, state.feet], axis=1),
        np.concatenate([seen.values, state.values], axis=1),
        np.concatenate([seen.jacobian, state.jacobian], axis=1),
        state.prior_values,
        state.prior_jacobian,
    )
    return replace(problem, curves=join_curves(curves, problem.curves)), changed


def bend_surface(problem: Problem, state: State) -> tuple[Problem, State]:
    """The problem with a parabolic pitch instead of a roof, and the state in it to first order of the surface's height.

    The parabola falls about as the roof does where points were seen; no marking is looked at again.
    """
    index, count = INDEX["crown"], state.feet.shape[1]
    y = np.empty_like(state.values)
    y[:, :count] = curve_points(problem.curves, state.feet, state.theta)[0][..., 1]
    y[:, count:] = problem.points.twice[0][1]
    # so many times as far as the roof with the same crown has the parabola fallen there: t^2 / |t|
    further = problem.model.surface.drop(0.0, y)
    surface = replace(problem.model.surface, shape="parabola")
    by_crown, crown = state.jacobian[..., index], state.theta[:, index, None]
    like = crown * (further**3).sum(axis=1, keepdims=True) / np.maximum((further**4).sum(axis=1, keepdims=True), 1e-12)
    theta, jacobian = state.theta.copy(), state.jacobian.copy()
    theta[:, index], jacobian[..., index] = like[:, 0], by_crown * further
    values = state.values + by_crown * (like * further - crown)
    curved = replace(problem, model=replace(problem.model, surface=surface))
    return curved, apply_loss(curved, theta, state.feet, values, jacobian, *problem.priors.residuals(theta))


def minimise(problem: Problem, starts: Array, rule: StoppingRule = FINAL, feet: Array | None = None) -> State:
    """Follow every start (B, P) at once to an optimum.

    Parameters
    ----------
    problem : Problem
        Observations, priors and loss.
    starts : (B, P) array
        Parameter vectors; what the priors fix is set to their mean.
    rule : StoppingRule
        When a start has arrived.
    feet : (B, N) array, optional
        Foot parameters near the true ones; without them they are searched for along all markings.
    """
    theta = starts.copy()
    fixed = problem.priors.sd <= 0
    theta[:, fixed] = problem.priors.mean[fixed]
    updates = 0
    if feet is None:
        feet, updates = sample_feet(problem.curves, theta, problem.model), 2
    return resume(problem, evaluate(problem, theta, feet, updates), rule)


def resume(problem: Problem, state: State, rule: StoppingRule = FINAL) -> State:
    """Follow starts that are evaluated already."""
    return least_squares.minimise(problem, state, rule).state


def predict_step(problem: Problem, state: State) -> State:
    """Where an undamped step leads in the linear model: nothing is evaluated."""
    return problem.extrapolate(state, problem.step(state, np.full(len(state.theta), LEAST_DAMPING)))


def predict_optima(problem: Problem, state: State) -> tuple[State, Mask]:
    """:func:`predict_step`, and whether the linear model of each start (B,) holds so far."""
    step = problem.step(state, np.full(len(state.theta), LEAST_DAMPING))
    ahead = problem.extrapolate(state, step)
    zoomed, surprise = np.abs(step.change[:, LOG_FOCAL]), np.abs(state.cost - step.promise - ahead.cost)
    return ahead, np.asarray((zoomed < HARDLY_ZOOMED) & (surprise < HARDLY_ROBUST))
