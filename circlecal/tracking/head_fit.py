"""One frame's head from the paint that it shows, with the tripod known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.geometry.projective import Array, Indices
from circlecal.paint.profiles import median_of_rows
from circlecal.rig.tripod import TripodEstimate
from circlecal.tracking.markings import DrawnTemplate, MeasuredFrame
from circlecal.tracking.tripod_fit import add_by_part, number_parts, residuals_of, sigmas_of

ROUNDS = 5
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
    inlier_share : float
        Share of the paint that the camera explains.
    crossing : float
        How far the explained paint tells the pan, as a number of places: see :func:`count_crossing`.
    spread : (2,) array
        Square of how far the paint is off, in parts of the field, and what it is taken to be: see
        :func:`compare_spread`.
    """

    head: Array
    information: Array
    by_common: Array
    pull: Array
    rms_px: float
    inlier_share: float
    crossing: float
    spread: Array


def fit_head(
    measured: MeasuredFrame,
    head: Array,
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
    head, prior : (3,), (3, 3) arrays
        Where the prior is, and its information.
    tripod : TripodEstimate
        The camera.
    drawn : DrawnTemplate
        The field.
    followed : (3, K) array, optional
        How the middle of the prior follows the common parameters; it stays where it is without.
    """
    model, common, unit = tripod.model, tripod.mean, tripod.size[0] / 1920.0
    start = head
    sigma = np.zeros(0)
    information, by_common, pull = np.zeros((3, 3)), *np.zeros((2, 3, len(common)))
    rms, share, crossing, spread = np.inf, 0.0, 0.0, np.zeros(2)
    for step in range(ROUNDS):
        theta, by_own, by_all = model.linearise_one(head, common)
        away, rows = residuals_of(measured, drawn, theta, model.projection)
        if len(away) == 0:
            break
        if step in (0, 2):
            sigma = sigmas_of(measured, away, unit)
        values = away / sigma
        # at first what most of the paint says counts, however far off it is
        scale = max(LOSS_SCALE, 2.0 * float(median_of_rows(np.abs(values)))) if step < 2 else LOSS_SCALE
        weight = 1.0 / (1.0 + values**2 / scale**2) ** 2
        jacobian = (rows @ by_own) / sigma[:, None]
        information = (jacobian * weight[:, None]).T @ jacobian
        gradient = (jacobian * weight[:, None]).T @ values + prior @ (head - start)
        change = -np.linalg.solve(information + prior + LEAST_INFORMATION * np.eye(3), gradient)
        head = head + np.clip(change, -0.1, 0.1)
        if step == ROUNDS - 1 or (step > 1 and np.abs(jacobian @ change).max() < 0.02):
            root = (np.sqrt(weight) / sigma)[:, None]
            seen_own, seen_all = root * (rows @ by_own), root * (rows @ by_all)
            by_common, pull = follow_common(seen_own, seen_all, prior, followed), -seen_own.T @ seen_all
            rms = float(np.sqrt((weight * away**2).sum() / max(weight.sum(), 1e-9)))
            explained = np.abs(values) < LOSS_SCALE
            share = float(explained.mean())
            by_angle = rows @ by_own / np.exp(head[0])
            from_middle = measured.points_px - model.projection.center
            crossing = count_crossing(by_angle[explained], measured.normals[explained], from_middle[explained])
            spread = compare_spread(number_parts(measured), away, weight / sigma**2, rows @ by_own, information + prior)
            break
    return HeadFit(head, information, by_common, pull, rms, share, crossing, spread)


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
        root = np.linalg.cholesky(prior + LEAST_INFORMATION * np.eye(3)).T
        before = np.zeros((3, by_common.shape[1])) if followed is None else -root @ followed
        by_own, by_common = np.vstack([by_own, root]), np.vstack([by_common, before])
    if len(by_own) < by_own.shape[1]:
        return np.zeros((by_own.shape[1], by_common.shape[1]))
    return np.asarray(-np.linalg.lstsq(by_own, by_common, rcond=None)[0])
