"""Many frames of one standing camera: what they share and what is each frame's own, in one least-squares problem.

Every frame has its focal length, pan, tilt and bloom, and small deviations from what is shared. Where the camera turns
on a tripod (:mod:`circlecal.rig.tripod`), pan, tilt and roll are those of the head, the shared position is that of the
pan axis, and the axis's lean and the lever arm of the lens are shared as well. A frame's own parameters meet other
frames' only through the shared ones, so the normal equations are an arrow: the own blocks are eliminated one by one
(Schur complement), and what is left is as large as the shared part, however many frames there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from circlecal.camera.priors import LINEAR, SHARED, ZOOMED, Priors, ZoomLens
from circlecal.camera.problem import Problem, evaluate
from circlecal.camera.residuals import sample_feet
from circlecal.geometry.camera_parameters import ANGLES, INDEX, KAPPA_1, PARAMETERS, POSITION
from circlecal.geometry.least_squares import Arrow, OneStart, Step, StoppingRule, invert_normal, minimise
from circlecal.geometry.projective import Array, Indices
from circlecal.rig.tripod import COMMON, PLACE, TripodModel, unwrap_pan

OWN = ("log_focal", "pan", "tilt", "bloom")
"""Parameters that belong to a frame."""
TURNING = ("lean_x", "lean_y", "lever")
"""Parameters by which a camera on a tripod turns otherwise than about one point: radians, radians, metres."""
RULE = StoppingRule(1e-9, unit=np.inf)
"""Of a joint fit: frames add up, so what is worth a step is a share of the cost."""
LARGEST_STEP = 0.5
"""Of the logarithm of focal length and of the angles (radians), in one iteration."""
_CAUTIOUS = [INDEX[name] for name in ("log_focal", "pan", "tilt", "roll")]
_POLISHING = 2
"""Steps of the frames' own parameters after each joint one: they follow a moved position along a bent path."""


@dataclass(frozen=True, slots=True)
class Turning:
    """What is assumed of how a camera turns, before any frame.

    Attributes
    ----------
    mean, sd : (3,) arrays
        Of the parameters :data:`TURNING`; one with a standard deviation of 0 is not estimated.
    """

    mean: Array
    sd: Array

    @property
    def free(self) -> Indices:
        """Places of those that are estimated (T,)."""
        return np.flatnonzero(self.sd > 0)

    def values(self, estimated: Array) -> Array:
        """All three, from those that are estimated (T,)."""
        found = self.mean.copy()
        found[self.free] = estimated
        return found


ABOUT_ONE_POINT = Turning(np.zeros(3), np.zeros(3))
"""An upright camera without a lever arm."""


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
    slope_mean, slope_sd : (Z,), (Z,) arrays
        Prior of the changes with the zoom.
    deviation_sd : (D,) array
        Prior of the deviations, about 0.
    log_focal : float
        Logarithm of the focal length at which the shared parameters are quoted.
    turning : Turning
        How the camera turns: the common parameters end with what is estimated of that (T).
    lens : ZoomLens
        By how much the radial distortion, where it changes with the zoom, bends away from the linear change.
    """

    frames: tuple[Problem, ...]
    priors: Priors
    own: Indices
    shared: Indices
    zoomed: Indices
    deviating: Indices
    slope_mean: Array
    slope_sd: Array
    deviation_sd: Array
    log_focal: float
    turning: Turning = ABOUT_ONE_POINT
    lens: ZoomLens = LINEAR

    @property
    def is_on_tripod(self) -> bool:
        """Whether the camera turns otherwise than about one point."""
        return bool(self.turning.mean.any() or self.turning.sd.any())

    @property
    def base(self) -> Array:
        """Values of the parameters that are not estimated (P,)."""
        return np.where(self.priors.sd == 0, self.priors.mean, 0.0)

    def thetas(self, own: Array, common: Array) -> Array:
        """Parameter vectors (F, P) from own (F, O + D) and common (K + Z + T,) ones."""
        theta = self.on_head(own, common)
        if self.is_on_tripod:
            model, head, shared = self.tripod(theta, common)
            turned = model.thetas(head, shared)
            theta[:, ANGLES], theta[:, POSITION] = turned[:, ANGLES], turned[:, POSITION]
        return theta

    def mappings(self, own: Array, common: Array) -> tuple[Array, Array]:
        """Derivatives of :meth:`thetas` by the own (F, P, O + D) and by the common parameters (F, P, K + Z + T)."""
        F, K, Z, D = len(own), len(self.shared), len(self.zoomed), len(self.deviating)
        first = len(self.own)
        by_own = np.zeros((F, len(PARAMETERS), first + D))
        by_own[:, self.own, np.arange(first)] = 1.0
        zoom = list(self.own).index(0)
        by_own[:, self.zoomed, zoom] = common[K : K + Z]
        if KAPPA_1 in self.zoomed:
            by_own[:, KAPPA_1, zoom] += self.lens.bend(own[:, zoom], self.log_focal)[1]
        by_own[:, self.deviating, first + np.arange(D)] = 1.0
        by_common = np.zeros((F, len(PARAMETERS), K + Z))
        by_common[:, self.shared, np.arange(K)] = 1.0
        theta = self.on_head(own, common)
        by_common[:, self.zoomed, K + np.arange(Z)] = theta[:, :1] - self.log_focal
        if not self.is_on_tripod:
            return by_own, by_common
        by_head, by_turning = self.turn(theta, common)
        return by_head @ by_own, np.concatenate([by_head @ by_common, by_turning], axis=2)

    def turn(self, theta: Array, common: Array) -> tuple[Array, Array]:
        """Derivatives of cameras on the tripod by the parameters (F, P) on its head, (F, P, P), and by what is
        estimated of how it turns, (F, P, T).
        """
        model, head, shared = self.tripod(theta, common)
        by_own, by_shared = model.derivatives(head, shared)
        turned = np.zeros((len(theta), len(PARAMETERS), len(PARAMETERS)))
        turned[:] = np.eye(len(PARAMETERS))
        moved = [INDEX[name] for name in ("pan", "tilt", "roll", "x", "y", "z")]
        turned[:, :, moved] = 0.0
        rows = np.array(moved)[:, None]
        turned[:, rows, [INDEX["pan"], INDEX["tilt"]]] = by_own[:, moved, 1:]
        common_columns = [PLACE[name] for name in ("head_roll", "axis_x", "axis_y", "axis_z")]
        turned[:, rows, moved[2:]] = by_shared[:, rows, common_columns]
        estimated = [PLACE[TURNING[k]] for k in self.turning.free]
        by_turning = np.zeros((len(theta), len(PARAMETERS), len(estimated)))
        by_turning[:, moved] = by_shared[:, rows, estimated]
        return turned, by_turning

    def heads_of(self, theta: Array, common: Array) -> Array:
        """Parameters (F, P) on the head of cameras (F, P), for the common parameters' lean and lever arm; the pans are
        those of :func:`circlecal.rig.tripod.unwrap_pan`.
        """
        found = theta.copy()
        if not self.is_on_tripod:
            found[:, INDEX["pan"]] = unwrap_pan(theta[:, INDEX["pan"]], theta[0, POSITION])
            return found
        model, _, shared = self.tripod(theta, common)
        found[:, ANGLES], found[:, POSITION] = model.head_of(theta, shared[0])
        return found

    def on_head(self, own: Array, common: Array) -> Array:
        """Parameters (F, P) on the head of the tripod; of the camera where it turns about one point."""
        K, Z = len(self.shared), len(self.zoomed)
        theta = np.tile(self.base, (len(own), 1))
        theta[:, self.own] = own[:, : len(self.own)]
        theta[:, self.shared] = common[:K]
        theta[:, self.zoomed] += (theta[:, :1] - self.log_focal) * common[K : K + Z]
        if KAPPA_1 in self.zoomed:
            theta[:, KAPPA_1] += self.lens.bend(theta[:, 0], self.log_focal)[0]
        theta[:, self.deviating] += own[:, len(self.own) :]
        return theta

    def tripod(self, theta: Array, common: Array) -> tuple[TripodModel, Array, Array]:
        """The tripod's map, and its own (F, 3) and common (F, K) parameters, of frames (F, P) on its head."""
        shared = np.zeros((len(theta), len(COMMON)))
        shared[:, :3], shared[:, PLACE["head_roll"]] = theta[:, POSITION], theta[:, INDEX["roll"]]
        estimated = common[len(self.shared) + len(self.zoomed) :]
        shared[:, [PLACE[name] for name in TURNING]] = self.turning.values(estimated)
        head = theta[:, [INDEX["log_focal"], INDEX["pan"], INDEX["tilt"]]]
        return TripodModel(self.frames[0].model, self.log_focal), head, shared

    def with_loss(self, loss_scale: float) -> JointProblem:
        """The problem under a robust loss of another scale."""
        return replace(self, frames=tuple(replace(frame, loss_scale=loss_scale) for frame in self.frames))

    def narrow(self, index: Indices) -> Self:
        """There is a single start."""
        return self

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
        change = -invert_normal(reduced) @ (g_c - np.einsum("foc,fo->c", state.H_oc, solved[..., -1]))
        own_change = -solved[..., -1] - solved[..., :-1] @ change
        moved = self.thetas(state.own + own_change, state.common + change) - state.theta
        shortening = max(1.0, float(np.abs(moved[:, _CAUTIOUS]).max()) / LARGEST_STEP)
        own_change, change = own_change / shortening, change / shortening
        arrow = Arrow(state.H_oo, state.H_oc, whole, state.g_o, g_c)
        return arrow.step(state.own, state.common, own_change, change)

    def follow(self, state: JointState, step: Step) -> JointState:
        """The frames where a step has led them, each with its own parameters adjusted to what is shared."""
        own, common = np.split(step.parameters[0], [state.own.size])
        found = evaluate_joint(self, own.reshape(state.own.shape), common, state.feet)
        for _ in range(_POLISHING):
            found = _polish(self, found)
        return found

    def bend(self, state: JointState, step: Step, proposal: JointState) -> JointState | None:
        """The frames' starts are near: steps are straight."""
        return None

    def extrapolate(self, state: JointState, step: Step) -> JointState:
        """The state after a step, evaluated: the frames' own parameters follow a moved position along a bent path."""
        return self.follow(state, step)


@dataclass(frozen=True, slots=True)
class JointState(OneStart):
    """Where a joint fit stands.

    Attributes
    ----------
    own, common : (F, O + D), (C,) arrays
        Parameters; of the common ones there are C = K + Z + T.
    theta : (F, P) array
        The frames' parameter vectors.
    feet : tuple of (1, N) arrays
        Foot parameters of each frame's points.
    costs, common_cost : (F,) array, float
        Cost of each frame, with the priors of what is its own, and that of the priors of the common parameters.
    by_own, by_common : arrays
        As :meth:`JointProblem.mappings`.
    H_oo, H_oc, H_cc : (F, O + D, O + D), (F, O + D, C), (F, C, C) arrays
        Gauss-Newton blocks of each frame.
    g_o, g_c : (F, O + D), (F, C) arrays
        Gradients of each frame.
    H_common, g_common : (C, C), (C,) arrays
        Gauss-Newton matrix and gradient of the priors of the common parameters.
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


def joint_problem(
    problems: Sequence[Problem],
    slope_sd: Mapping[str, float],
    deviation_sd: Mapping[str, float],
    log_focal: float,
    turning: Turning = ABOUT_ONE_POINT,
) -> JointProblem:
    """Frames with the same priors as one problem.

    Parameters
    ----------
    problems : sequence of Problem
        The frames; the first one's priors are those of the shared parameters.
    slope_sd : mapping
        Prior of the change of a parameter per unit of log focal length, by name; only for ``ZOOMED`` ones. About 0, and
        that of a lens which follows the focal length about what it does there; away from there it bends as the lens.
    deviation_sd : mapping
        How far a frame may deviate from a shared parameter, by name; 0 or missing for not at all.
    log_focal : float
        At which the shared parameters are quoted.
    turning : Turning
        What is assumed of how the camera turns.
    """
    lens, priors = problems[0].priors.lens, problems[0].priors.at_focal(log_focal)
    by_zoom = {} if lens is None else {"kappa_1": float(lens.slope(np.array(log_focal)))}
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
        slope_mean=np.array([by_zoom.get(name, 0.0) for name in zoomed]),
        slope_sd=np.array([slope_sd[name] for name in zoomed]),
        deviation_sd=np.array([deviation_sd[name] for name in deviating]),
        log_focal=log_focal,
        turning=turning,
        lens=LINEAR if lens is None else lens,
    )


def start_state(problem: JointProblem, theta: Array, turning: Array | None = None) -> JointState:
    """State at parameter vectors (F, P) of the frames: what is shared starts at their median, and how the camera turns
    at its parameters :data:`TURNING` (3,), usual ones when None.
    """
    turning = (problem.turning.mean if turning is None else turning)[problem.turning.free]
    common = np.concatenate([np.zeros(len(problem.shared)), problem.slope_mean, turning])
    theta = problem.heads_of(theta, common)
    common[: len(problem.shared)] = np.median(theta[:, problem.shared], axis=0)
    own = np.concatenate([theta[:, problem.own], np.zeros((len(theta), len(problem.deviating)))], axis=1)
    start = problem.thetas(own, common)
    feet = tuple(sample_feet(f.curves, t[None], f.model) for f, t in zip(problem.frames, start, strict=True))
    return evaluate_joint(problem, own, common, feet, updates=4)


def evaluate_joint(
    problem: JointProblem, own: Array, common: Array, feet: Sequence[Array], updates: int = 1
) -> JointState:
    """Costs, gradients and Gauss-Newton blocks at own (F, O + D) and common (K + Z + T,) parameters."""
    theta = problem.thetas(own, common)
    states = [evaluate(f, t[None], h, updates) for f, t, h in zip(problem.frames, theta, feet, strict=True)]
    normal = np.stack([s.normal[0] for s in states])
    gradient = np.stack([s.gradient[0] for s in states])
    by_own, by_common = problem.mappings(own, common)
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
    turning, free = problem.turning, problem.turning.free
    sd = np.concatenate([problem.slope_sd, turning.sd[free]])
    usual = np.concatenate([problem.slope_mean, turning.mean[free]])
    others = (common[K:] - usual) / sd
    normal = np.zeros((len(common), len(common)))
    normal[:K, :K] = jacobian.T @ jacobian
    normal[K:, K:] = np.diag(sd**-2.0)
    gradient = np.concatenate([jacobian.T @ values[0], others / sd])
    return normal, gradient, float(values[0] @ values[0] + others @ others)


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
