"""From the posterior covariance of the camera to that of everything derived from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.camera.parameters import INDEX, PARAMETERS, ProjectionModel, active_parameters, project
from circlecal.camera.viewing_coordinates import LOOK, from_look, look_jacobian, to_look
from circlecal.geometry.projective import Array, dehomogenise, lift

LARGEST_INVERSE = 1e11
"""Entries of an inverse beyond which it is taken without its singular directions."""


def posterior_covariance(normal: Array, sd: Array) -> Array:
    """Covariance (P, P) from the Gauss-Newton matrix (P, P) with its priors; zero for parameters that are fixed."""
    active = active_parameters(sd)
    block = normal[np.ix_(active, active)]
    size = np.sqrt(np.maximum(np.diag(block), 1e-300))
    scale = np.outer(size, size)
    inverse = _inverse(block / scale) / scale
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[np.ix_(active, active)] = inverse
    return covariance


def _inverse(correlation: Array) -> Array:
    """Inverse of a correlation-like matrix, without the directions in which it is singular."""
    try:
        inverse = np.linalg.inv(correlation)
    except np.linalg.LinAlgError:
        inverse = np.full_like(correlation, np.inf)
    if np.abs(inverse).max() < LARGEST_INVERSE:
        return np.asarray(0.5 * (inverse + inverse.T))
    return np.asarray(np.linalg.pinv(correlation, rcond=1e-13, hermitian=True))


def spread_cameras(theta: Array, covariance: Array, center_m: Array) -> Array:
    """Parameter vectors (2 K, P) at sqrt 3 standard deviations along each principal direction, both ways.

    With weight 1/6 each, squared deviations of any function from its value at ``theta`` add up to its covariance,
    exactly where the
    function is linear and with the leading term of its bend otherwise (unscented transform, Julier and Uhlmann 1997).
    The directions are
    taken in look coordinates, where zoom against distance is straight.
    """
    look = to_look(theta[None], center_m)
    change = np.eye(len(theta))
    by_look = look_jacobian(theta[None], center_m)[0]
    straight = bool(np.isfinite(look).all() and np.isfinite(by_look).all() and np.linalg.cond(by_look) < LOOK_CONDITION)
    if straight:
        change[:LOOK, :LOOK] = by_look
    inverse = np.linalg.inv(change)
    values, vectors = np.linalg.eigh(inverse @ covariance @ inverse.T)
    kept = values > 1e-16 * max(values[-1], 1e-300)
    steps = np.sqrt(3.0 * values[kept]) * vectors[:, kept]
    steps = np.concatenate([steps.T, -steps.T])
    points = theta + (steps if straight else steps @ change.T)
    if straight:
        with np.errstate(over="ignore", invalid="ignore"):
            points[:, :LOOK] = from_look(look + steps[:, :LOOK], center_m)
    return points


def push_forward(center: Array, values: Array) -> Array:
    """Covariance (..., M, M) of a function of the parameters about its value (..., M) at the camera itself, from its
    values (K, ..., M) at :func:`spread_cameras`.
    """
    deviations = np.moveaxis(values - center, 0, -2)
    # a camera that loses sight of the point says nothing; the others stand for it
    finite = np.isfinite(deviations).all(axis=-1, keepdims=True)
    kept = np.where(finite, deviations, 0.0)
    share = len(values) / (6.0 * np.maximum(finite.sum(axis=-2), 1))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.swapaxes(kept, -1, -2) @ kept * share[..., None])


def homography_vectors(homographies: Array) -> Array:
    """Homographies (B, 3, 3) scaled to H[2, 2] = 1, without the last entry (B, 8)."""
    return homographies.reshape(-1, 9)[:, :8] / homographies[:, 2, 2, None]


def imaged_points(homographies: Array, points_m: Array) -> Array:
    """Undistorted pixels (B, N, 2) of field points (N, 2) on the tangent plane."""
    return dehomogenise(lift(points_m) @ np.swapaxes(homographies, 1, 2))


LOOK_CONDITION = 1e14
"""Of the derivative of the parameters by the look coordinates: beyond it the centre lies in the camera's own plane."""


@dataclass(frozen=True, slots=True)
class FieldUncertainty:
    """Standard deviations of field points: in the picture (N,) pixels, and on the ground (N,) metres, both of the
    length of the error; and the share of the precision there that the observations bring, the priors the rest.
    """

    picture_px: Array
    ground_m: Array
    data_share: float


def field_uncertainty(
    theta: Array, covariance: Array, points_m: Array, model: ProjectionModel, prior_normal: Array | None = None
) -> FieldUncertainty:
    """What the covariance (P, P) of a camera (P,) means for field points (N, 2).

    With the posterior precision F + L (data and prior), the predicted variance J S J^T splits exactly into J S F S
    J^T and J S L S J^T; without the priors' Gauss-Newton matrix L (P, P) the data are taken to bring everything.
    """
    seen = project(theta[None], points_m[None], model)
    toward = np.zeros((2, 1, 2, len(points_m)))
    toward[0, :, 0] = toward[1, :, 1] = 1.0
    (by_x, field_x), (by_y, field_y) = (seen.gradient(axis) for axis in toward)
    # the sizes of the markings, which come last, move no point
    own = slice(0, INDEX["width"])
    by_x, by_y = by_x[0, own], by_y[0, own]
    pushed_x, pushed_y = covariance[own, own] @ by_x, covariance[own, own] @ by_y
    xx, xy, yy = ((a * b).sum(axis=0) for a, b in ((pushed_x, by_x), (pushed_x, by_y), (pushed_y, by_y)))
    (a, b), (c, d) = field_x[0], field_y[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        # of the inverse of the derivative by the field position
        ground = ((d * d + c * c) * xx - 2.0 * (b * d + a * c) * xy + (a * a + b * b) * yy) / (a * d - b * c) ** 2
    share = 1.0
    if prior_normal is not None and (total := float((xx + yy).sum())) > 0:
        told = (covariance @ prior_normal @ covariance)[own, own]
        brought = (told * (by_x @ by_x.T + by_y @ by_y.T)).sum()
        share = float(np.clip(1.0 - brought / total, 0.0, 1.0))
    return FieldUncertainty(np.sqrt(xx + yy), np.sqrt(np.maximum(ground, 0.0)), share)


def field_sigma(theta: Array, covariance: Array, points_m: Array, model: ProjectionModel) -> tuple[Array, Array]:
    """Standard deviations of field points (N, 2): in the picture (N,) pixels, and on the ground (N,) metres.

    Both are root mean squares over the two axes times sqrt 2, i.e. of the length of the error.
    """
    found = field_uncertainty(theta, covariance, points_m, model)
    return found.picture_px, found.ground_m


def correlation_factor(values: Array, maximum_lag: int = 40) -> float:
    """By how much neighbouring residuals (N,) repeat each other: the integrated autocorrelation, at least 1."""
    n = len(values)
    if n < 20:
        return 1.0
    centred = values - values.mean()
    power = float(centred @ centred)
    if power <= 0:
        return 1.0
    lags = min(maximum_lag, n // 4)
    correlation = np.correlate(np.concatenate([centred, np.zeros(lags)]), centred, "valid")[1:] / power
    negative = np.flatnonzero(correlation < 2.0 / np.sqrt(n))
    last = negative[0] if len(negative) else lags
    return float(1.0 + 2.0 * correlation[:last].sum())
