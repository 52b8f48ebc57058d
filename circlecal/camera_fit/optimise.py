"""Levenberg-Marquardt over a batch of starts, with Gaussian priors and a graduated robust loss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.camera_fit.curves import CurvePoints, FixedPoints, curve_residuals, first_hidden, point_residuals
from circlecal.camera_fit.look import LOOK, from_look, look_jacobian, to_look
from circlecal.camera_fit.model import INDEX, PARAMETERS, Frame, active_parameters
from circlecal.geometry.homogeneous import Array, Indices, Mask

LARGEST_STEP = 0.7
"""Of the logarithms of focal length and distance and of the angles, in one iteration."""
LOG_FOCAL_RANGE = (np.log(10.0), np.log(1e6))
"""Of the focal length in pixels: nothing outside is a camera."""
LOOK_CAUTIOUS = (0, 3, 4, 5, 6)
_POSITION = slice(INDEX["x"], INDEX["z"] + 1)


@dataclass(frozen=True, slots=True)
class Priors:
    """Gaussian priors of the parameters, and of a camera's usual place.

    Attributes
    ----------
    mean, sd : (P,) arrays
        Per parameter; sd 0 fixes it at its mean, inf leaves it free.
    distance_m, distance_log_sd : float
        Log-normal prior of the distance from the circle's centre; sd inf for none.
    elevation_rad, elevation_sd_rad : float
        Gaussian prior of the angle under which the camera looks down on the circle's centre; sd inf for none.
    center_m : (2,) array
        The circle's centre.
    """

    mean: Array
    sd: Array
    distance_m: float
    distance_log_sd: float
    elevation_rad: float
    elevation_sd_rad: float
    center_m: Array

    def residuals(self, theta: Array) -> tuple[Array, Array]:
        """Normalised residuals (B, K) and their Jacobian (B, K, P)."""
        used = np.flatnonzero((self.sd > 0) & np.isfinite(self.sd))
        values = [(theta[:, used] - self.mean[used]) / self.sd[used]]
        jacobian = np.zeros((len(theta), len(used), len(PARAMETERS)))
        jacobian[:, np.arange(len(used)), used] = 1.0 / self.sd[used]
        parts = [jacobian]
        offset = theta[:, _POSITION] - np.r_[self.center_m, 0.0]
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-3)
        if np.isfinite(self.distance_log_sd):
            values.append((np.log(distance / self.distance_m) / self.distance_log_sd)[:, None])
            row = np.zeros((len(theta), 1, len(PARAMETERS)))
            row[:, 0, _POSITION] = offset / (distance**2 * self.distance_log_sd)[:, None]
            parts.append(row)
        if np.isfinite(self.elevation_sd_rad):
            sine = np.clip(-offset[:, 2] / distance, -1.0, 1.0)
            cosine = np.maximum(np.sqrt(1 - sine**2), 1e-6)
            values.append(((np.arcsin(sine) - self.elevation_rad) / self.elevation_sd_rad)[:, None])
            row = np.zeros((len(theta), 1, len(PARAMETERS)))
            by_offset = -np.array([0.0, 0.0, 1.0]) / distance[:, None] - sine[:, None] * offset / (distance**2)[:, None]
            row[:, 0, _POSITION] = by_offset / (cosine * self.elevation_sd_rad)[:, None]
            parts.append(row)
        return np.concatenate(values, axis=1), np.concatenate(parts, axis=1)


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


def evaluate(problem: Problem, theta: Array, hidden: Array, loss_scale: float, updates: int = 1) -> State:
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
    gradient = gradient + np.einsum("bk,bkp->bp", prior_values, prior_jacobian)
    normal = normal + np.swapaxes(prior_jacobian, 1, 2) @ prior_jacobian
    cost = cost + np.sum(prior_values**2, axis=1)
    return State(theta, cost, values, curve.hidden, gradient, normal, point_values)


def robust_weights(values: Array, loss_scale: float) -> Array:
    """Weights of iteratively reweighted least squares for the Geman-McClure loss."""
    return 1.0 / (1.0 + (values / loss_scale) ** 2) ** 2


def _weighted(values: Array, jacobian: Array, loss_scale: float) -> tuple[Array, Array, Array]:
    weight = robust_weights(values, loss_scale)
    cost = np.sum(values**2 / (1.0 + (values / loss_scale) ** 2), axis=1)
    weighted = jacobian * weight[..., None]
    swapped = np.swapaxes(jacobian, 1, 2)
    return (swapped @ (weight * values)[..., None])[..., 0], swapped @ weighted, cost


def minimise(
    problem: Problem,
    starts: Array,
    loss_scale: float,
    iterations: int = 60,
    hidden: Array | None = None,
    tolerance: float = 1e-8,
) -> State:
    """Run Levenberg-Marquardt from every start (B, P) at once; each keeps its own damping."""
    active = active_parameters(problem.priors.sd)
    theta = starts.copy()
    fixed = np.setdiff1d(np.arange(theta.shape[1]), active)
    theta[:, fixed] = problem.priors.mean[fixed]
    hidden = first_hidden(problem.curves, theta, problem.frame)[0] if hidden is None else hidden
    state = evaluate(problem, theta, hidden, loss_scale, updates=4)
    damping = np.full(len(theta), 1e-3)
    settled = np.zeros(len(theta), dtype=int)
    straight = bool((problem.priors.sd[:LOOK] > 0).all())
    for _ in range(iterations):
        theta = _stepped(problem, state, damping, active, straight)
        proposal = evaluate(problem, theta, state.hidden, loss_scale)
        better = proposal.cost < state.cost
        gain = np.where(better, (state.cost - proposal.cost) / np.maximum(state.cost, 1e-30), 0.0)
        settled = np.where(
            (better & (gain < tolerance)) | (~better & (damping > 1e6)) | (state.cost < 1e-24), settled + 1, 0
        )
        damping = np.clip(np.where(better, damping * 0.2, damping * 6.0), 1e-12, 1e12)
        state = _merge(state, proposal, better)
        if (settled >= 2).all():
            break
    return state


def _stepped(problem: Problem, state: State, damping: Array, active: Indices, straight: bool) -> Array:
    """Parameters (B, P) after one damped step, taken in the coordinates in which the weak direction is straight."""
    center = problem.priors.center_m
    gradient, normal = state.gradient, state.normal
    look = to_look(state.theta, center) if straight else np.full((len(state.theta), LOOK), np.nan)
    usable = np.isfinite(look).all(axis=1)
    change = np.broadcast_to(np.eye(len(PARAMETERS)), normal.shape).copy()
    change[usable, :LOOK, :LOOK] = look_jacobian(look[usable], center)
    gradient = np.einsum("bpq,bp->bq", change, gradient)
    normal = np.swapaxes(change, 1, 2) @ normal @ change
    block = normal[:, active[:, None], active[None, :]]
    diagonal = np.einsum("bii->bi", block)
    scaled = block + (damping[:, None] * (diagonal + 1e-12))[:, :, None] * np.eye(len(active))
    step = np.zeros_like(state.theta)
    step[:, active] = -_solve(scaled, gradient[:, active])
    largest = np.where(usable, np.abs(step[:, LOOK_CAUTIOUS]).max(axis=1), np.abs(step[:, :4]).max(axis=1))
    step /= np.maximum(largest / LARGEST_STEP, 1.0)[:, None]
    theta = state.theta + step
    theta[usable, :LOOK] = from_look(look[usable] + step[usable, :LOOK], center)
    theta[:, 0] = np.clip(theta[:, 0], *LOG_FOCAL_RANGE)
    return theta


def _solve(matrices: Array, vectors: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(matrices, hermitian=True) @ vectors[..., None])[..., 0], dtype=np.float64)


def _merge(old: State, new: State, better: Mask) -> State:
    def pick(name: str) -> Array:
        a, b = getattr(old, name), getattr(new, name)
        return np.where(better.reshape(-1, *([1] * (a.ndim - 1))), b, a)

    return State(*(pick(name) for name in State.__slots__))


def best_of(state: State, count: int = 1) -> State:
    """The starts with the lowest cost."""
    order = np.argsort(state.cost, kind="stable")[:count]
    return State(*(getattr(state, name)[order] for name in State.__slots__))
