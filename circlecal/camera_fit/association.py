"""Which marking of the template is which straight line of the picture.

After a first camera from circle and halfway line every other line is predicted with a covariance that is long in one
or two directions (focal length against distance
and height). Each plausible pair of a seen and a template's line is tried as a seed: it updates the camera linearly,
as a Kalman filter would, and the others are matched under the updated
camera, nearest first. The seed that explains most seen length at the least cost wins; where another seed explains
about as much in another way, nothing is named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.camera_fit.curves import CurvePoints, curve_residuals, first_hidden, line_curve, stack_curves
from circlecal.camera_fit.model import Frame
from circlecal.field import FieldTemplate, Line
from circlecal.geometry.homogeneous import Array, Mask

SAMPLES = 4
"""Points of a seen line that stand for it."""


@dataclass(frozen=True, slots=True)
class Association:
    """Names by index of the seen line, the summed length in pixels that they explain, and the squared Mahalanobis
    cost.
    """

    names: dict[int, str]
    length_px: float
    cost: float

    @property
    def score(self) -> float:
        """Explained length less the surprise."""
        return self.length_px - 12.0 * self.cost

    def contradicts(self, other: Association) -> bool:
        """Whether the two name one seen line differently, or give one name to different lines only."""
        if any(other.names.get(k, name) != name for k, name in self.names.items()):
            return True
        shared = set(self.names.items()) & set(other.names.items())
        return any(name in other.names.values() and (k, name) not in shared for k, name in self.names.items())


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Residuals (S, T, K) of S seen lines against T template lines, Jacobians (S, T, K, P), and which pairs lie on
    the marking's extent.
    """

    residuals: Array
    jacobians: Array
    on_marking: Mask


def associate_lines(
    segments: Array,
    template: FieldTemplate,
    excluded: tuple[str, ...],
    theta: Array,
    covariance: Array,
    frame: Frame,
    sigma_px: float,
    count: int = 6,
) -> list[Association]:
    """Name seen lines in the most plausible ways.

    Parameters
    ----------
    segments : (S, 2, 2) array
        Ends of the seen lines, pixels as stored.
    template : FieldTemplate
        The field.
    excluded : tuple of str
        Template lines that are known already.
    theta, covariance : (P,), (P, P) arrays
        Camera so far.
    frame : Frame
        Picture size.
    sigma_px : float
        How well a seen line follows the straight line between its ends (lens, measuring).
    count : int
        How many different hypotheses are returned.

    Returns
    -------
    list of Association
        Best first; empty where nothing fits.
    """
    lines = [line for line in template.lines if line.name not in excluded]
    if len(segments) == 0 or not lines:
        return []
    names = [line.name for line in lines]
    pairs = _pairs(segments, template, lines, theta, frame)
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    cost = _mahalanobis(pairs.residuals, pairs.jacobians, covariance, sigma_px)
    seeds = np.argwhere(pairs.on_marking & (cost < 9.0 * SAMPLES) & np.isfinite(cost))
    seeds = seeds[np.argsort(-lengths[seeds[:, 0]], kind="stable")][:40]
    found = [_grow((int(s), int(t)), pairs, lengths, names, covariance, sigma_px) for s, t in seeds]
    found.sort(key=lambda a: a.score, reverse=True)
    different = {frozenset(a.names.items()): a for a in reversed(found)}
    return sorted(different.values(), key=lambda a: a.score, reverse=True)[:count]


def _pairs(segments: Array, template: FieldTemplate, lines: list[Line], theta: Array, frame: Frame) -> _Pairs:
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    samples = segments[:, None, 0] * (1 - share) + segments[:, None, 1] * share
    flat = samples.reshape(-1, 2)
    parts = [
        line_curve(line.name, flat, np.ones(len(flat)), template.line_ends(line), template.line_shift(line))
        for line in lines
    ]
    curves: CurvePoints = stack_curves(parts)
    start, _ = first_hidden(curves, theta[None], frame, samples=48)
    seen = curve_residuals(curves, theta[None], start, frame, updates=4)
    shape = (len(lines), len(segments), SAMPLES)
    lengths = np.array([np.linalg.norm(np.subtract(*template.line_ends(line))) for line in lines])
    hidden = seen.hidden[0].reshape(shape)
    # uncertain cameras slide along a line too, so its ends are taken generously
    slack = 0.15 * lengths[:, None, None] + 3.0
    on_marking = ((hidden > -slack) & (hidden < lengths[:, None, None] + slack)).all(axis=-1)
    on_marking &= ~seen.behind[0].reshape(shape).any(axis=-1)
    return _Pairs(
        np.swapaxes(seen.values[0].reshape(shape), 0, 1),
        np.swapaxes(seen.jacobian[0].reshape(*shape, -1), 0, 1),
        on_marking.T,
    )


def _mahalanobis(residuals: Array, jacobians: Array, covariance: Array, sigma_px: float) -> Array:
    """Squared Mahalanobis length (...) of residuals (..., K) with Jacobians (..., K, P)."""
    spread = jacobians @ covariance @ np.swapaxes(jacobians, -1, -2) + sigma_px**2 * np.eye(residuals.shape[-1])
    solved = np.linalg.solve(spread, residuals[..., None])[..., 0]
    return np.asarray(np.sum(residuals * solved, axis=-1))


def _grow(
    seed: tuple[int, int], pairs: _Pairs, lengths: Array, names: list[str], covariance: Array, sigma_px: float
) -> Association:
    """Match further lines under the camera that the matches so far imply."""
    chosen: dict[int, int] = {}
    total, length = 0.0, 0.0
    residuals, spread = pairs.residuals.copy(), covariance.copy()
    pair: tuple[int, int] | None = seed
    while pair is not None:
        s, t = pair
        J, r = pairs.jacobians[s, t], residuals[s, t]
        inner = J @ spread @ J.T + sigma_px**2 * np.eye(len(r))
        gain = np.linalg.solve(inner, J @ spread).T
        total += float(r @ np.linalg.solve(inner, r))
        length += float(lengths[s])
        chosen[s] = t
        step = -gain @ r
        residuals = residuals + pairs.jacobians @ step
        spread = spread - gain @ J @ spread
        pair = _next(pairs, residuals, spread, chosen, lengths, sigma_px)
    return Association({s: names[t] for s, t in chosen.items()}, length, total)


def _next(
    pairs: _Pairs, residuals: Array, spread: Array, chosen: dict[int, int], lengths: Array, sigma_px: float
) -> tuple[int, int] | None:
    cost = _mahalanobis(residuals, pairs.jacobians, spread, sigma_px)
    offset = np.sqrt(np.mean(residuals**2, axis=-1))
    fits = pairs.on_marking & (cost < 4.0 * SAMPLES) & (offset < 25.0 * sigma_px)
    # a second piece of a known line must lie on it, a new line must be the only one that fits
    for s, t in chosen.items():
        fits[s] = False
        fits[:, t] &= offset[:, t] < 4.0 * sigma_px
    fits &= fits.sum(axis=1, keepdims=True) == 1
    candidates = np.argwhere(fits)
    if len(candidates) == 0:
        return None
    return tuple(candidates[np.argmax(lengths[candidates[:, 0]] - 4.0 * cost[tuple(candidates.T)])])
