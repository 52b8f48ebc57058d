"""From the posterior covariance of the camera to that of everything derived from it."""

from __future__ import annotations

import numpy as np

from circlecal.camera.viewing_coordinates import VIEWING, from_viewing, to_viewing, viewing_jacobian
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, Projection, active_parameters
from circlecal.geometry.least_squares import invert_normal
from circlecal.geometry.projective import Array, dehomogenise, lift

MOST_LAG = 40
"""Residuals along a curve are compared with at most so many that follow them."""


def posterior_covariance(normal: Array, sd: Array) -> Array:
    """Covariance (..., P, P) from the Gauss-Newton matrix (..., P, P) with its priors; zero for parameters that are
    fixed.
    """
    active = active_parameters(sd)
    covariance = np.zeros(normal.shape)
    covariance[..., active[:, None], active] = invert_normal(normal[..., active[:, None], active])
    return covariance


def count_from_seen(by_growth: Array) -> Array:
    """Matrix (P, P) that takes deviations of the parameters to those of a camera whose place is counted from what
    was seen instead of from the middle of the field.

    Where only one end of a field is seen, its goal lies half a field from the middle, and so does the camera: how long
    the field is moves both alike, and says nothing of where the seen end is in the picture. With ``by_growth`` (2,),
    how far what was seen moves along x per metre of length and along y per metre of breadth, a place counted from there
    has the deviations dx - by_growth[0] dlength and dy - by_growth[1] dbreadth. Covariances C become T C T^T; a matrix
    of priors L becomes T^-T L T^-1, where T^-1 = 2 I - T.
    """
    turn = np.eye(len(PARAMETERS))
    turn[INDEX["x"], INDEX["length"]] = -by_growth[0]
    turn[INDEX["y"], INDEX["breadth"]] = -by_growth[1]
    return turn


def spread_cameras(theta: Array, covariance: Array, center_m: Array) -> Array:
    """Parameter vectors (2 K, P) at sqrt 3 standard deviations along each principal direction, both ways.

    With weight 1/6 each, squared deviations of any function from its value at ``theta`` add up to its covariance,
    exactly where the function is linear and with the leading term of its bend otherwise (unscented transform, Julier
    and Uhlmann 1997). The directions are taken in viewing coordinates, where zoom against distance is straight.
    """
    viewing = to_viewing(theta[None], center_m)
    change = np.eye(len(theta))
    by_viewing = viewing_jacobian(theta[None], center_m)[0]
    finite = bool(np.isfinite(viewing).all() and np.isfinite(by_viewing).all())
    straight = finite and bool(np.linalg.cond(by_viewing) < VIEWING_CONDITION)
    if straight:
        change[:VIEWING, :VIEWING] = by_viewing
    inverse = np.linalg.inv(change)
    values, vectors = np.linalg.eigh(inverse @ covariance @ inverse.T)
    kept = values > 1e-16 * max(values[-1], 1e-300)
    steps = np.sqrt(3.0 * values[kept]) * vectors[:, kept]
    steps = np.concatenate([steps.T, -steps.T])
    points = theta + (steps if straight else steps @ change.T)
    if straight:
        with np.errstate(over="ignore", invalid="ignore"):
            points[:, :VIEWING] = from_viewing(viewing + steps[:, :VIEWING], center_m)
    return points


def push_forward(center: Array, values: Array) -> Array:
    """Covariance (..., M, M) of a function of the parameters about its value (..., M) at the camera itself, from its
    values (K, ..., M) at :func:`spread_cameras`.
    """
    # a camera that loses sight of the point says nothing; the others stand for it
    with np.errstate(over="ignore", invalid="ignore"):
        deviations = np.moveaxis(values - center, 0, -2)
    finite = np.isfinite(deviations).all(axis=-1, keepdims=True)
    kept = np.where(finite, deviations, 0.0)
    share = len(values) / (6.0 * np.maximum(finite.sum(axis=-2), 1))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.swapaxes(kept, -1, -2) @ kept * share[..., None])


def homography_vectors(homographies: Array) -> Array:
    """Homographies (B, 3, 3) scaled to H[2, 2] = 1, without the last entry (B, 8).

    Not finite for a camera level with the field's origin, in whose homography that entry is 0.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return homographies.reshape(-1, 9)[:, :8] / homographies[:, 2, 2, None]


def imaged_points(homographies: Array, points_m: Array) -> Array:
    """Undistorted pixels (B, N, 2) of field points (N, 2) on the tangent plane."""
    return dehomogenise(lift(points_m) @ np.swapaxes(homographies, 1, 2))


VIEWING_CONDITION = 1e14
"""Of the derivative of the parameters by viewing coordinates: beyond it the centre lies in the camera's own plane."""


def data_share(seen: Projection, covariance: Array, prior_normal: Array) -> float:
    """Share of the predicted precision of the first camera's points that the observations bring, 0 to 1.

    With the posterior precision F + L (data and prior) the predicted variance J S J^T splits exactly into
    J S F S J^T and J S L S J^T; L is the priors' Gauss-Newton matrix ``prior_normal`` (P, P). The ``covariance`` S
    (P, P) is that of the linear model alone, since what is added to it for other models has no such shares.
    """
    by_theta = seen.jacobians()[0][0].reshape(-1, len(covariance))
    total = float(((by_theta @ covariance) * by_theta).sum())
    if not total > 0.0:
        return 1.0
    by_prior = float(((by_theta @ (covariance @ prior_normal @ covariance)) * by_theta).sum())
    return float(np.clip(1.0 - by_prior / total, 0.0, 1.0))


def correlation_factor(values: Array) -> float:
    """By how much neighbouring residuals (N,) repeat each other: the integrated autocorrelation, at least 1."""
    n = len(values)
    if n < 20:
        return 1.0
    centred = values - values.mean()
    power = float(centred @ centred)
    if power <= 0:
        return 1.0
    lags = min(MOST_LAG, n // 4)
    correlation = np.correlate(np.concatenate([centred, np.zeros(lags)]), centred, "valid")[1:] / power
    negative = np.flatnonzero(correlation < 2.0 / np.sqrt(n))
    last = negative[0] if len(negative) else lags
    return float(1.0 + 2.0 * correlation[:last].sum())
