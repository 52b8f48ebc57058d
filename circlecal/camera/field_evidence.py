"""How well a hypothesis about the field explains what was seen: the marginal likelihood of an optimum, in Laplace's
approximation (MacKay 2003, Information Theory, Inference, and Learning Algorithms, ch. 27),

    log Z = -cost / 2 - log det(N) / 2 - sum(log sd) - sum(log s) + log w

with the Gauss-Newton matrix N at the optimum, standard deviations sd of the priors in which hypotheses differ and s of
marks, which lie on even or uneven ground, and the share w of fields that are like this. Hypotheses that name different
lines are compared on all of them: a line that one of them leaves without a name is something else, which lies anywhere
in the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import erf

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.problem import Problem, State
from circlecal.camera.world import BREADTH, LENGTH, SIZES_AND_CROWN, World
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1, active_parameters, project
from circlecal.geometry.projective import Array
from circlecal.observations import MarkingKey

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
STRAY_SHARE, END_SHARE, END_PX, ON_LINE = 0.02, 0.03, 1.5, 2.5
"""Of halfway lines, those along which something else is followed beyond their end (assumed), the share of the points
that may lie there, pixels at 1920 px width to which blur lets an end be told, and the normalised residual from which on
a point lies on no line.
"""
BEYOND_RULES_SHARE, LEAST_SIZE_SD_M = 1e-6, 0.1
"""Of fields, the share whose length or width lies beyond the rules of their sport, and the least standard deviation,
metres, of either: none of some 60 grounds of real frames and clips lies beyond.
"""
RIDGE = 1e-9
"""Of the sum of squares, so little is added to each square: two points of a line tell nothing of its bend."""


def log_evidence(world: World, problem: Problem, state: State, template: FieldTemplate, known: int) -> float:
    """Logarithm of the evidence of a single optimum, the first start, as :func:`log_evidences` has it."""
    return float(log_evidences([world], [problem], state.select(np.array([0])), template, known)[0])


def log_evidences(
    worlds: Sequence[World], problems: Sequence[Problem], state: State, template: FieldTemplate, known: int
) -> Array:
    """Logarithms of the evidence of the optima in B worlds, up to what all worlds have in common.

    Parameters
    ----------
    worlds, problems : sequences of World, Problem
        The worlds, and their problems, which differ in priors and in the sigmas of marks alone.
    state : State
        The optimum in each of them.
    template : FieldTemplate
        A camera high over its field, or steeply above its border, is a rare one.
    known : int
        So many markings are the same in all answers that are compared; the evidence that the others are none is taken
        off.
    """
    first, sd = problems[0], np.array([problem.priors.sd for problem in problems])
    active = active_parameters(sd[0])
    told = sd[:, [*SIZES_AND_CROWN, KAPPA_1]]
    proper = (told > 0) & np.isfinite(told)
    volume = half_log_determinant(state.normal[:, active[:, None], active])
    volume = volume + np.log(np.where(proper, told, 1.0)).sum(axis=1)
    noise = np.array([0.0 if (px := problem.points.upright_px) is None else np.log(px).sum() for problem in problems])
    shares = np.array([world.share for world in worlds])
    evidence = -0.5 * state.cost - volume - noise + np.log(shares) - _log_evidence_of_others(first, state, known)
    covariances = posterior_covariance(state.normal, sd[0])
    for k, (world, theta, covariance) in enumerate(zip(worlds, state.theta, covariances, strict=True)):
        evidence[k] += _log_share_of_places(theta, covariance, template)
        evidence[k] += 0.0 if world.is_usual_size else _log_share_of_sizes(theta, covariance, template)
        evidence[k] += _log_agreement_with_reach(first, state, k, covariance, template)
    return np.asarray(evidence)


def half_log_determinant(matrix: Array) -> Array:
    """Half the logarithm of the determinant (...) of normal matrices (..., P, P) of quantities of very different
    size.
    """
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 1e-300))
    _, determinant = np.linalg.slogdet(matrix / (scale[..., :, None] * scale[..., None, :]))
    return np.asarray(0.5 * determinant + np.log(scale).sum(axis=-1))


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


def _log_agreement_with_reach(
    problem: Problem, state: State, start: int, covariance: Array, template: FieldTemplate
) -> float:
    """Logarithm of how well it agrees with a field that its halfway line is seen so far by one of the starts: a field
    may be too small for a camera.

    A place p along the line, seen at a pixel q, moves by ``dp = -(t . dq) / (t . t)`` with the camera, where t is the
    picture of a metre along the line; by how much it lies beyond the end is averaged over a normal distribution. A line
    that is seen right to its end lies beyond it in half of the cameras: that half speaks against no field.
    """
    curves, line = problem.curves, template.line_by_name.get(template.halfway_line or "")
    if line is None or MarkingKey(line.name) not in curves.keys:
        return 0.0
    own = np.flatnonzero(curves.group == curves.keys.index(MarkingKey(line.name)))
    own = own[np.abs(state.residuals[start, own]) < ON_LINE]
    drawn = template.line_ends(line)
    axis = int(np.argmax(np.abs(drawn[1] - drawn[0])))
    half_m, size = 0.5 * template.extents[axis].size_m, (LENGTH, BREADTH)[axis]
    few = 1 + int(END_SHARE * len(own))
    if len(own) < 2 * few or np.abs(np.abs(drawn[:, axis]) - half_m).max() > template.marking_width_m:
        return 0.0
    theta, sides = state.theta[start], np.array([-1.0, 1.0])
    places = curves.origin[own] + state.feet[start, own, None] * curves.direction[own]
    order = np.argsort(places[:, axis])
    ends = places[order[[few - 1, -few]]]
    beyond = sides * ends[:, axis] - half_m - 0.5 * theta[size]
    if (beyond <= 0.0).all():
        return 0.0
    by_theta, by_field = (rows[0] for rows in project(theta[None], ends[None], problem.model).jacobians())
    tangent = by_field[:, :, axis]
    length2 = np.maximum((tangent * tangent).sum(axis=-1), 1e-12)
    slope = -(sides / length2)[:, None] * (tangent[:, None] @ by_theta)[:, 0]
    slope[:, size] -= 0.5
    blur_m = END_PX * problem.model.width / 1920.0 / np.sqrt(length2)
    sd = np.sqrt(np.maximum(np.einsum("np,pq,nq->n", slope, covariance, slope), 0.0) + blur_m**2)
    agrees = np.minimum(1.0 - np.array([erf(z) for z in beyond / (sd * np.sqrt(2.0))]), 1.0)
    return float(np.log(STRAY_SHARE + (1.0 - STRAY_SHARE) * agrees).sum())


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


def _log_evidence_of_others(problem: Problem, state: State, known: int) -> Array:
    """Logarithm of the evidence (B,) that all markings but the first ``known`` are anything else: each line lies
    anywhere.

    With the places u = (u_0, u_1) of a line's ends across it, uniform over the range R, points at the share t along it
    with standard deviation s give the integral of exp(-chi2 / 2) du / R^2, which is
    ``exp(-chi2_min / 2) 2 pi / (R^2 sqrt det A)``, ``A = sum a a^T / s^2``, ``a = (1 - t, t)``. What a camera leaves of
    its bend, t (1 - t), counts for no camera: anything else may be bent as it is seen.
    """
    curves = problem.curves
    own = np.flatnonzero(curves.group >= known)
    if len(own) == 0:
        return np.zeros(len(state.feet))
    own = own[np.argsort(curves.group[own], kind="stable")]
    group = curves.group[own]
    first = np.append(0, np.flatnonzero(group[1:] != group[:-1]) + 1)
    count = np.append(first[1:], len(own)) - first
    is_line = count > 1
    range_px = ANYWHERE_PX * problem.model.width / 1920.0
    values, sigma, t = state.residuals[:, own], curves.sigma_px[own], state.feet[:, own]
    # a residual beyond the loss's scale costs no more
    robust = values / np.sqrt(1.0 + values**2 / problem.loss_scale**2)
    low, high = np.minimum.reduceat(t, first, axis=1), np.maximum.reduceat(t, first, axis=1)
    t = (t - np.repeat(low, count, axis=1)) / np.repeat(np.maximum(high - low, 1e-9), count, axis=1)
    near, far = (1.0 - t) / sigma, t / sigma
    basis = np.array([near, far, t * near])
    gram = np.add.reduceat(basis[:, None] * basis, first, axis=-1)[..., is_line]
    along = np.add.reduceat(basis * robust, first, axis=-1)[..., is_line].transpose(1, 2, 0)
    total = np.add.reduceat(robust * robust, first, axis=1)[:, is_line]
    (aa, ab, _), (_, bb, _), _ = gram
    determinant = aa * bb - ab * ab
    gram = gram.transpose(2, 3, 0, 1)
    ridge = RIDGE * np.trace(gram, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)
    least = total - (along * np.linalg.solve(gram + ridge, along[..., None])[..., 0]).sum(axis=-1)
    lines = np.log(OTHER_LINE_SHARE / (1.0 - OTHER_LINE_SHARE)) + np.log(2.0 * np.pi) - 2.0 * np.log(range_px)
    lines = lines - 0.5 * least - 0.5 * np.log(determinant)
    ends = np.log(OTHER_END_SHARE / (1.0 - OTHER_END_SHARE)) + 0.5 * np.log(2.0 * np.pi) - np.log(range_px)
    ends = ends + np.log(sigma[first[~is_line]])
    return np.asarray(lines.sum(axis=1) + ends.sum())
