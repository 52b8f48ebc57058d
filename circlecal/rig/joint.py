"""Many frames of one standing camera: what they share and what is each frame's own, in one least-squares problem.

Every frame has its focal length, pan, tilt and bloom, and small deviations from what is shared. A frame's own
parameters meet other frames' only through the shared ones, so the normal equations are an arrow: the own blocks are
eliminated one by one (Schur complement), and what is left is as large as the shared part, however many frames there
are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.priors import SHARED, ZOOMED, Priors, SharedPrior
from circlecal.camera.problem import Problem, evaluate
from circlecal.camera.residuals import sample_feet
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS
from circlecal.geometry.least_squares import Step, StoppingRule, minimise
from circlecal.geometry.projective import Array, Indices, Mask

OWN = ("log_focal", "pan", "tilt", "bloom")
"""Parameters that belong to a frame."""
RULE = StoppingRule(1e-9, unit=np.inf)
"""Of a joint fit: frames add up, so what is worth a step is a share of the cost."""
LARGEST_STEP = 0.5
"""Of the logarithm of focal length and of the angles (radians), in one iteration."""
_CAUTIOUS = [INDEX[name] for name in ("log_focal", "pan", "tilt", "roll")]
_POLISHING = 2
"""Steps of the frames' own parameters after each joint one: they follow a moved position along a bent path."""


@dataclass(frozen=True, slots=True)
class JointProblem:
    """F frames of one camera, in one problem of :class:`circlecal.geometry.least_squares.Problem` with a single start.

    Attributes
    ----------
    frames : tuple of Problem
        Their observations; of their priors only those of the own parameters are used.
    priors : Priors
        Of the shared parameters, each counted once.
    own, shared, zoomed, deviating : index arrays
        Estimated parameters by their place in the parameter vector: a frame's own (O), shared (K), of these those that
        change with the zoom (Z), and those from which a frame may deviate (D).
    slope_sd, deviation_sd : (Z,), (D,) arrays
        Priors of the changes with the zoom and of the deviations, about 0.
    log_focal : float
        Logarithm of the focal length at which the shared parameters are quoted.
    """

    frames: tuple[Problem, ...]
    priors: Priors
    own: Indices
    shared: Indices
    zoomed: Indices
    deviating: Indices
    slope_sd: Array
    deviation_sd: Array
    log_focal: float

    @property
    def base(self) -> Array:
        """Values of the parameters that are not estimated (P,)."""
        return np.where(self.priors.sd == 0, self.priors.mean, 0.0)

    def thetas(self, own: Array, common: Array) -> Array:
        """Parameter vectors (F, P) from own (F, O + D) and common (K + Z,) ones."""
        theta = np.tile(self.base, (len(own), 1))
        theta[:, self.own] = own[:, : len(self.own)]
        theta[:, self.shared] = common[: len(self.shared)]
        theta[:, self.zoomed] += (theta[:, :1] - self.log_focal) * common[len(self.shared) :]
        theta[:, self.deviating] += own[:, len(self.own) :]
        return theta

    def mappings(self, theta: Array, common: Array) -> tuple[Array, Array]:
        """Derivatives of parameter vectors (F, P) by the own (F, P, O + D) and by the common ones (F, P, K + Z)."""
        F, P = theta.shape
        K, Z, own, D = len(self.shared), len(self.zoomed), len(self.own), len(self.deviating)
        by_own = np.zeros((F, P, own + D))
        by_own[:, self.own, np.arange(own)] = 1.0
        by_own[:, self.zoomed, list(self.own).index(0)] = common[K:]
        by_own[:, self.deviating, own + np.arange(D)] = 1.0
        by_common = np.zeros((F, P, K + Z))
        by_common[:, self.shared, np.arange(K)] = 1.0
        by_common[:, self.zoomed, K + np.arange(Z)] = theta[:, :1] - self.log_focal
        return by_own, by_common

    def with_loss(self, loss_scale: float) -> JointProblem:
        """The problem under a robust loss of another scale."""
        return replace(self, frames=tuple(replace(frame, loss_scale=loss_scale) for frame in self.frames))

    def step(self, state: JointState, damping: Array) -> Step:
        """One damped step with the frames' own blocks eliminated: the Schur complement of the arrow.

        Of ``[[A, B], [B^T, C]] (x, y) = -(g, h)`` with A in blocks: ``(C - B^T A^-1 B) y = -(h - B^T A^-1 g)`` and
        ``x = -A^-1 (g + B y)``.
        """
        share = float(damping[0])
        diagonal = np.einsum("foo->fo", state.H_oo)
        H_oo = state.H_oo + share * diagonal[:, :, None] * np.eye(state.H_oo.shape[1])
        solved = np.linalg.solve(H_oo, np.concatenate([state.H_oc, state.g_o[..., None]], axis=2))
        whole = state.H_common + state.H_cc.sum(axis=0)
        H_cc = whole + share * np.diag(np.diag(whole))
        reduced = H_cc - np.einsum("foc,fod->cd", state.H_oc, solved[..., :-1])
        g_c = state.g_common + state.g_c.sum(axis=0)
        change = -_inverse(reduced) @ (g_c - np.einsum("foc,fo->c", state.H_oc, solved[..., -1]))
        own_change = -solved[..., -1] - solved[..., :-1] @ change
        moved = self.thetas(state.own + own_change, state.common + change) - state.theta
        shortening = max(1.0, float(np.abs(moved[:, _CAUTIOUS]).max()) / LARGEST_STEP)
        own_change, change = own_change / shortening, change / shortening
        # -(2 g^T d + d^T N d), block by block
        slope = float((state.g_o * own_change).sum() + g_c @ change)
        bend = np.einsum("fo,fop,fp->", own_change, state.H_oo, own_change) + change @ whole @ change
        bend += 2.0 * np.einsum("fo,foc,c->", own_change, state.H_oc, change)
        full = np.concatenate([own_change.ravel(), change])
        now = np.concatenate([state.own.ravel(), state.common])
        return Step((now + full)[None], full[None], np.array([-2.0 * slope - float(bend)]))

    def promise(self, state: JointState, step: Step) -> Array:
        """Of the present step (1,)."""
        return step.promise

    def follow(self, state: JointState, step: Step, index: Indices) -> JointState:
        """The frames where a step has led them, each with its own parameters adjusted to what is shared."""
        own, common = np.split(step.parameters[0], [state.own.size])
        found = evaluate_joint(self, own.reshape(state.own.shape), common, state.feet)
        for _ in range(_POLISHING):
            found = _polish(self, found)
        return found

    def extrapolate(self, state: JointState, step: Step) -> JointState:
        """The state after a step, evaluated: the frames' own parameters follow a moved position along a bent path."""
        return self.follow(state, step, np.zeros(1, dtype=np.int_))


@dataclass(frozen=True, slots=True)
class JointState:
    """Where a joint fit stands.

    Attributes
    ----------
    own, common : (F, O + D), (K + Z,) arrays
        Parameters.
    theta : (F, P) array
        The frames' parameter vectors.
    feet : tuple of (1, N) arrays
        Foot parameters of each frame's points.
    costs, common_cost : (F,) array, float
        Cost of each frame, with the priors of what is its own, and that of the shared priors.
    by_own, by_common : arrays
        As :meth:`JointProblem.mappings`.
    H_oo, H_oc, H_cc : (F, O + D, O + D), (F, O + D, K + Z), (F, K + Z, K + Z) arrays
        Gauss-Newton blocks of each frame.
    g_o, g_c : (F, O + D), (F, K + Z) arrays
        Gradients of each frame.
    H_common, g_common : (K + Z, K + Z), (K + Z,) arrays
        Gauss-Newton matrix and gradient of the shared priors.
    """

    own: Array
    common: Array
    theta: Array
    feet: tuple[Array, ...]
    costs: Array
    common_cost: float
    by_own: Array
    by_common: Array
    H_oo: Array
    H_oc: Array
    H_cc: Array
    g_o: Array
    g_c: Array
    H_common: Array
    g_common: Array

    @property
    def cost(self) -> Array:
        """Of everything (1,)."""
        return np.array([self.costs.sum() + self.common_cost])

    def select(self, index: Indices | Mask) -> JointState:
        """The only start."""
        return self

    def put(self, index: Indices, other: JointState) -> JointState:
        """The other state, where the only start is at the index."""
        return other if len(index) else self


def joint_problem(
    problems: Sequence[Problem], slope_sd: Mapping[str, float], deviation_sd: Mapping[str, float], log_focal: float
) -> JointProblem:
    """Frames with the same priors as one problem.

    Parameters
    ----------
    problems : sequence of Problem
        The frames; the first one's priors are those of the shared parameters.
    slope_sd : mapping
        Prior of the change of a parameter per unit of log focal length, by name; only for ``ZOOMED`` ones.
    deviation_sd : mapping
        How far a frame may deviate from a shared parameter, by name; 0 or missing for not at all.
    log_focal : float
        At which the shared parameters are quoted.
    """
    priors = problems[0].priors
    free = {name for name, sd in zip(PARAMETERS, priors.sd, strict=True) if sd > 0}
    own = [INDEX[name] for name in OWN if name in free]
    shared = [INDEX[name] for name in SHARED if name in free]
    zoomed = [name for name in ZOOMED if name in free and slope_sd.get(name, 0.0) > 0]
    deviating = [name for name in SHARED if name in free and deviation_sd.get(name, 0.0) > 0]
    of_frames = np.where(np.isin(np.arange(len(PARAMETERS)), own), priors.sd, np.inf)
    of_common = np.where(np.isin(np.arange(len(PARAMETERS)), shared), priors.sd, np.inf)
    own_priors = replace(priors, sd=of_frames, distance_log_sd=np.inf, elevation_sd_rad=np.inf, shared=None)
    return JointProblem(
        frames=tuple(replace(problem, priors=own_priors) for problem in problems),
        priors=replace(priors, sd=np.where(priors.sd == 0, 0.0, of_common)),
        own=np.array(own, dtype=np.int_),
        shared=np.array(shared, dtype=np.int_),
        zoomed=np.array([INDEX[name] for name in zoomed], dtype=np.int_),
        deviating=np.array([INDEX[name] for name in deviating], dtype=np.int_),
        slope_sd=np.array([slope_sd[name] for name in zoomed]),
        deviation_sd=np.array([deviation_sd[name] for name in deviating]),
        log_focal=log_focal,
    )


def start_state(problem: JointProblem, theta: Array) -> JointState:
    """State at parameter vectors (F, P) of the frames: what is shared starts at their median."""
    shared = np.median(theta[:, problem.shared], axis=0)
    common = np.concatenate([shared, np.zeros(len(problem.zoomed))])
    own = np.concatenate([theta[:, problem.own], np.zeros((len(theta), len(problem.deviating)))], axis=1)
    start = problem.thetas(own, common)
    feet = tuple(sample_feet(f.curves, t[None], f.model) for f, t in zip(problem.frames, start, strict=True))
    return evaluate_joint(problem, own, common, feet, updates=4)


def evaluate_joint(
    problem: JointProblem, own: Array, common: Array, feet: Sequence[Array], updates: int = 1
) -> JointState:
    """Costs, gradients and Gauss-Newton blocks at own (F, O + D) and common (K + Z,) parameters."""
    theta = problem.thetas(own, common)
    states = [evaluate(f, t[None], h, updates) for f, t, h in zip(problem.frames, theta, feet, strict=True)]
    normal = np.stack([s.normal[0] for s in states])
    gradient = np.stack([s.gradient[0] for s in states])
    by_own, by_common = problem.mappings(theta, common)
    deviation = own[:, len(problem.own) :] / problem.deviation_sd
    first = len(problem.own)
    left = np.swapaxes(by_own, 1, 2) @ normal
    H_oo = left @ by_own
    H_oo[:, first:, first:] += np.diag(problem.deviation_sd**-2.0)
    g_o = np.einsum("fpo,fp->fo", by_own, gradient)
    g_o[:, first:] += deviation / problem.deviation_sd
    H_common, g_common, prior_cost = _common_priors(problem, common)
    return JointState(
        own=own,
        common=common,
        theta=theta,
        feet=tuple(s.feet for s in states),
        costs=np.array([float(s.cost[0]) for s in states]) + np.sum(deviation**2, axis=1),
        common_cost=prior_cost,
        by_own=by_own,
        by_common=by_common,
        H_oo=H_oo,
        H_oc=left @ by_common,
        H_cc=np.swapaxes(by_common, 1, 2) @ normal @ by_common,
        g_o=g_o,
        g_c=np.einsum("fpc,fp->fc", by_common, gradient),
        H_common=H_common,
        g_common=g_common,
    )


def _common_priors(problem: JointProblem, common: Array) -> tuple[Array, Array, float]:
    """Gauss-Newton matrix, gradient and cost of the priors of what is shared."""
    K = len(problem.shared)
    theta = problem.base
    theta[problem.shared] = common[:K]
    values, jacobian = problem.priors.residuals(theta[None])
    jacobian = jacobian[0][:, problem.shared]
    slopes = common[K:] / problem.slope_sd
    normal = np.zeros((len(common), len(common)))
    normal[:K, :K] = jacobian.T @ jacobian
    normal[K:, K:] = np.diag(problem.slope_sd**-2.0)
    gradient = np.concatenate([jacobian.T @ values[0], slopes / problem.slope_sd])
    return normal, gradient, float(values[0] @ values[0] + slopes @ slopes)


def minimise_joint(problem: JointProblem, state: JointState, iterations: int = RULE.iterations) -> JointState:
    """The joint optimum from a start."""
    return minimise(problem, state, replace(RULE, iterations=iterations)).state


def _polish(problem: JointProblem, state: JointState) -> JointState:
    """One step of the own parameters of each frame; taken by those that gain from it."""
    step = -np.linalg.solve(state.H_oo, state.g_o[..., None])[..., 0]
    largest = np.abs(step[:, : len(problem.own)]).max(axis=1)
    step = step / np.maximum(largest / LARGEST_STEP, 1.0)[:, None]
    moved = evaluate_joint(problem, state.own + step, state.common, state.feet)
    gains = moved.costs < state.costs
    return replace(
        moved,
        **{
            name: np.where(
                gains.reshape(-1, *([1] * (getattr(moved, name).ndim - 1))), getattr(moved, name), getattr(state, name)
            )
            for name in ("own", "theta", "costs", "by_own", "by_common", "H_oo", "H_oc", "H_cc", "g_o", "g_c")
        },
        feet=tuple(a if g else b for a, b, g in zip(moved.feet, state.feet, gains, strict=True)),
    )


def _inverse(matrix: Array) -> Array:
    """Inverse of a normal matrix of quantities of very different size."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size))


def frame_information(state: JointState) -> tuple[Array, Array]:
    """What each frame says of the common parameters: precisions (F, K + Z, K + Z) and gradients (F, K + Z) after its
    own parameters are eliminated.
    """
    solved = np.linalg.solve(state.H_oo, np.concatenate([state.H_oc, state.g_o[..., None]], axis=2))
    precision = state.H_cc - np.swapaxes(state.H_oc, 1, 2) @ solved[..., :-1]
    gradient = state.g_c - (np.swapaxes(state.H_oc, 1, 2) @ solved[..., -1:])[..., 0]
    return precision, gradient


def shared_prior(problem: JointProblem, state: JointState, without: int | None = None) -> SharedPrior:
    """What the frames say of the camera; of all frames, or of all but one.

    A frame that is fitted under what the others say, linearised at the joint optimum, is fitted as in the joint
    problem: the others' gradient at the optimum is what balances its own.
    """
    precision, gradient = frame_information(state)
    kept = np.arange(len(state.costs)) != (-1 if without is None else without)
    covariance = _inverse(state.H_common + precision[kept].sum(axis=0))
    mean = state.common - covariance @ (state.g_common + gradient[kept].sum(axis=0))
    deviation = np.zeros(len(PARAMETERS))
    deviation[problem.deviating] = problem.deviation_sd
    return SharedPrior(
        parameters=tuple(PARAMETERS[k] for k in problem.shared),
        zoomed=tuple(PARAMETERS[k] for k in problem.zoomed),
        log_focal=problem.log_focal,
        mean=mean,
        covariance=(covariance + covariance.T) / 2,
        deviation_sd=deviation[problem.shared],
    )


def deletion_gains(state: JointState) -> Array:
    """By how much the cost of all the others falls, to first order, where one frame is left out (F,)."""
    precision, gradient = frame_information(state)
    total = state.H_common + precision.sum(axis=0)
    return np.array([g @ _inverse(total - own) @ g for own, g in zip(precision, gradient, strict=True)])


def joint_covariances(problem: JointProblem, state: JointState) -> Array:
    """Covariances (F, P, P) of the frames' parameter vectors, with what all the others bring."""
    precision, _ = frame_information(state)
    common = _inverse(state.H_common + precision.sum(axis=0))
    inverse = np.stack([_inverse(block) for block in state.H_oo])
    gain = inverse @ state.H_oc
    by_common = state.by_common - state.by_own @ gain
    return np.asarray(
        state.by_own @ inverse @ np.swapaxes(state.by_own, 1, 2) + by_common @ common @ np.swapaxes(by_common, 1, 2)
    )
