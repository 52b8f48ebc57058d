"""One frame's head from the paint that it shows, with the tripod known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Indices, Mask
from circlecal.rig.tripod import TripodEstimate
from circlecal.tracking.frame_paint import add_by_part, number_parts, residuals_of, sigmas_of
from circlecal.tracking.markings import DrawnTemplate
from circlecal.tracking.seen_paint import MeasuredFrame

ROUNDS = 5
LINEAR_PX = 2.0
"""How far markings may move, pixels at 1920 px width, before the fit is linearised again: what a turn by so much does
beyond its first order is 0.003 px.
"""
LEAST_INFORMATION = 1e-6
"""Of a head that no paint shows, so that its equations can be solved."""
LOSS_SCALE = 3.0
"""Of the Geman-McClure loss, standard deviations."""


@dataclass(frozen=True, slots=True)
class HeadFit:
    """A head as the paint of a frame has it.

    Attributes
    ----------
    head : (3,) array
        Logarithm of the focal length, pan and tilt.
    information : (3, 3) array
        Of the paint alone, for the tripod as it is.
    by_common : (3, K) array
        How the fitted head follows the common parameters, by the paint and by what was known before.
    pull : (3, K) array
        How the paint alone pulls the head along with the common parameters: information times how its head follows.
    rms_px : float
        Root mean square of the weighted residuals.
    by_head : (M, 3) array
        Derivatives of the paint's distances by the head, pixels.
    explained : (M,) bool
        Which of the paint the camera explains.
    spread : (2,) array
        Square of how far the paint is off, in parts of the field, and what it is taken to be: see
        :func:`compare_spread`.
    weight : (M,) array
        With which each place of paint counts, per square pixel.
    """

    head: Array
    information: Array
    by_common: Array
    pull: Array
    rms_px: float
    by_head: Array
    explained: Mask
    spread: Array
    weight: Array

    @property
    def inlier_share(self) -> float:
        """Share of the paint that the camera explains."""
        return float(self.explained.mean()) if len(self.explained) else 0.0


@dataclass(frozen=True, slots=True)
class LinearPaint:
    """How the paint of a frame lies beside its markings while the head is near a place.

    Attributes
    ----------
    head : (3,) array
        There.
    away : (M,) array
        Distances of the paint from where the head puts the markings, pixels.
    by_head, by_common : (M, 3), (M, K) arrays
        Their derivatives by the head, and by the common parameters.
    """

    head: Array
    away: Array
    by_head: Array
    by_common: Array

    @classmethod
    def of(cls, measured: MeasuredFrame, head: Array, tripod: TripodEstimate, drawn: DrawnTemplate) -> LinearPaint:
        """The paint of a frame about a head."""
        theta, by_own, by_all = tripod.model.linearise_one(head, tripod.mean)
        away, rows = residuals_of(measured, drawn, theta, tripod.model.projection)
        return cls(head, away, rows @ by_own, rows @ by_all)


def fit_head(
    measured: MeasuredFrame,
    start: LinearPaint,
    prior: Array,
    tripod: TripodEstimate,
    drawn: DrawnTemplate,
    followed: Array | None = None,
) -> HeadFit:
    """Fit the head to the paint from a start with a prior.

    Parameters
    ----------
    measured : MeasuredFrame
        Paint.
    start, prior : LinearPaint, (3, 3) array
        The paint about the middle of the prior, and the prior's information.
    tripod : TripodEstimate
        The camera.
    drawn : DrawnTemplate
        The field.
    followed : (3, K) array, optional
        How the middle of the prior follows the common parameters; it stays where it is without.
    """
    if len(measured.marking) == 0:
        nothing, unmoved = np.zeros((0, 3)), np.zeros((3, len(tripod.mean)))
        told = np.zeros((3, 3)), unmoved, unmoved, np.inf, nothing, np.zeros(0, np.bool_), np.zeros(2), np.zeros(0)
        return HeadFit(start.head, *told)
    unit = tripod.size[0] / 1920.0
    head, paint, known = start.head, start, prior + LEAST_INFORMATION * np.eye(3)
    sigma = sigmas_of(measured, paint.away, unit)
    for step in range(ROUNDS):
        away = paint.away + paint.by_head @ (head - paint.head)
        if np.abs(away - paint.away).max() > LINEAR_PX * unit:
            paint = LinearPaint.of(measured, head, tripod, drawn)
            away = paint.away
        if step == 2:
            sigma = sigmas_of(measured, away, unit)
        values = away / sigma
        # at first what most of the paint says counts, however far off it is
        scale = max(LOSS_SCALE, 2.0 * float(median_of_rows(np.abs(values)))) if step < 2 else LOSS_SCALE
        weight = 1.0 / (1.0 + values**2 / scale**2) ** 2
        jacobian = paint.by_head / sigma[:, None]
        weighted = (jacobian * weight[:, None]).T
        information = weighted @ jacobian
        change = -np.linalg.solve(information + known, weighted @ values + prior @ (head - start.head))
        head = head + np.clip(change, -0.1, 0.1)
        if step > 1 and np.abs(jacobian @ change).max() < 0.02:
            break
    root = (np.sqrt(weight) / sigma)[:, None]
    seen_own, seen_all = root * paint.by_head, root * paint.by_common
    by_common = follow_common(seen_own, seen_all, prior, followed)
    rms = float(np.sqrt((weight * away**2).sum() / max(weight.sum(), 1e-9)))
    spread = compare_spread(number_parts(measured), away, weight / sigma**2, paint.by_head, information + prior)
    pull, explained = -seen_own.T @ seen_all, np.asarray(np.abs(values) < LOSS_SCALE, np.bool_)
    return HeadFit(head, information, by_common, pull, rms, paint.by_head, explained, spread, weight / sigma**2)


def compare_spread(part: Indices, away: Array, weight: Array, by_own: Array, information: Array) -> Array:
    """How far the paint of a frame is off its markings, and how far it should be (2,): squares of weighted sums.

    Within a part of the field all places may be off alike, so each part counts with its weighted sum ``s = w . r``,
    whose square has the mean ``sum(w) - g^T N^-1 g`` where ``1 / w`` are the variances, with g the weighted sum of the
    derivatives: the head follows the paint.

    Parameters
    ----------
    part, away, weight, by_own : (M,), (M,), (M,), (M, 3) arrays
        Part of the field of each place, its distance, weight, and its derivatives by the head.
    information : (3, 3) array
        N, of the head.
    """
    parts, at = np.unique(part, return_inverse=True)
    off = np.bincount(at, weight * away)
    rows = add_by_part(at, len(parts), weight[:, None] * by_own)
    followed = float((rows * np.linalg.solve(information, rows.T).T).sum())
    return np.array([float(off @ off), max(float(weight.sum()) - followed, 0.0)])


def count_crossing(by_own: Array, normals: Array, from_middle_px: Array) -> float:
    """How far places of paint tell the pan where zoom, tilt and roll are open: the number of places that tell it as
    well and lie on a marking square to the way of the picture while the head pans.

    A line slides along itself under a pan, or tilts a little: it tells nothing. Lines in two directions tell the pan
    even where both are seen nearly along that way, as a penalty area is from far beside it.

    Parameters
    ----------
    by_own : (M, 3) array
        Derivatives of the places along their normals by the head, focal lengths.
    normals, from_middle_px : (M, 2), (M, 2) arrays
        The direction across the marking, and where the place is seen, from the middle of the picture.
    """
    if len(by_own) <= by_own.shape[1] + 1:
        return 0.0
    by_roll = normals[:, 1] * from_middle_px[:, 0] - normals[:, 0] * from_middle_px[:, 1]
    others = np.column_stack([by_own[:, [0, 2]], by_roll])
    others = others / np.maximum(np.linalg.norm(others, axis=0), 1e-9)
    by_pan = by_own[:, 1]
    left = by_pan - others @ np.linalg.lstsq(others, by_pan, rcond=None)[0]
    return float(left @ left)


def follow_common(by_own: Array, by_common: Array, prior: Array | None = None, followed: Array | None = None) -> Array:
    """How a head (3, K) that is fitted to paint follows the common parameters.

    Where these change by c, the least-squares head changes by ``-(J^T J + N)^-1 (J^T C - N B) c``. A camera that is
    followed from frame to frame goes on following them as it did before: with a prior that does not, what the first
    frame knew is forgotten, and frames of a real clip whose paint leaves 2 px open were refused with 12.

    Parameters
    ----------
    by_own, by_common : (M, 3), (M, K) arrays
        J and C: derivatives of the weighted residuals, or of the places, by the head and by the common parameters.
    prior : (3, 3) array, optional
        N, information about the head from elsewhere. Without it fewer than three rows say nothing.
    followed : (3, K) array, optional
        B, how the head that is known from elsewhere follows the common parameters; not at all without.
    """
    if prior is not None:
        known = prior + LEAST_INFORMATION * np.eye(3)
        before = 0.0 if followed is None else known @ followed
        return np.asarray(np.linalg.solve(by_own.T @ by_own + known, before - by_own.T @ by_common))
    if len(by_own) < by_own.shape[1]:
        return np.zeros((by_own.shape[1], by_common.shape[1]))
    return np.asarray(-np.linalg.lstsq(by_own, by_common, rcond=None)[0])
