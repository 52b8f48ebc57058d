"""The measured paint of one frame before a camera: how far it is off the markings, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.geometry.camera_parameters import ProjectionModel, project
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Indices
from circlecal.tracking.markings import CLEAR_PX_M, SPACING_PX, DrawnTemplate, grow_places, rows_of
from circlecal.tracking.seen_paint import FAINT_BIAS_PX, MeasuredFrame

MODEL_SIGMA_PX, CORRELATION_PX = 0.25, 60.0
"""What paint, surface and lens leave of an ideal marking, pixels at 1920 px width, and over which length along it
neighbours repeat that.
"""
LEAST_NOISE_PX = 0.05
"""Of a measured middle, pixels."""
NEIGHBOUR_PX = 40.0
"""Places nearer to each other than this, pixels at 1920 px width, are neighbours."""
NEIGHBOURS_ALIKE = 1.8
"""By how much the smoothing along a marking makes its noise look smaller in the differences of neighbours."""
PART_M, MOST_PARTS = 5.0, 1000
"""Size of a part of the field, metres, within which all paint of a marking may be off alike, in a frame and in all
frames: neighbours are within 3 places of 9 px, and frames by 0.02 to 0.04 px at 1920 px width of 0.11 to 0.16; parts of
10 m make as much of it. And more parts than any field has along a side.
"""
FARTHEST_PX = 6.0
"""Paint further off, pixels at 1920 px width, counts as so far off where frames of a false calibration are told."""
LEAST_CLEAR = 20
"""Places on markings that are not mistaken for what lies beside them, by which a frame is told. The foot of the boards
behind a far touchline was 6 px off in right frames of a real clip, and a pitch 2.6 m too broad the better one with it;
circle and penalty area in one picture are 20 px off where the length is by 1.8 m.
"""


@dataclass(frozen=True, slots=True)
class HeadedFrame:
    """A measured frame with its head.

    Attributes
    ----------
    name : str
        Of the frame.
    head : (3,) array
        Logarithm of the focal length, pan and tilt on the head.
    measured : MeasuredFrame
        Its markings.
    """

    name: str
    head: Array
    measured: MeasuredFrame


def residuals_of(
    measured: MeasuredFrame, drawn: DrawnTemplate, theta: Array, model: ProjectionModel
) -> tuple[Array, Array]:
    """Distances (M,) of the paint from where a camera (P,) puts it, px, and their derivatives (M, P) by it."""
    places = grow_places(drawn, measured.marking, measured.field_m, theta)
    seen = project(theta[None], places[None], model)
    away = ((measured.points_px - seen.pixels[0]) * measured.normals).sum(axis=1)
    return away, -rows_of(drawn, measured.marking, measured.field_m, seen, measured.normals)


def sigmas_of(measured: MeasuredFrame, residuals_px: Array, unit: float, alike: float = 1.0) -> Array:
    """Standard deviations (M,) of a frame's paint along the normals, with what neighbours repeat of the model's error.

    The noise is read off the differences of neighbours, which no camera explains: it is the same for every model. Faint
    paint, which is measured along whole pieces of a line, tells nothing of it. What the models leave does not average
    out over a number of frames that are ``alike`` in it.
    """
    if len(residuals_px) == 0:
        return np.zeros(0)
    step = np.hypot(*np.diff(measured.points_px, axis=0).T)
    is_alone = measured.bias_px < FAINT_BIAS_PX * unit
    near = np.flatnonzero(
        (np.diff(measured.marking) == 0) & (step < NEIGHBOUR_PX * unit) & is_alone[1:] & is_alone[:-1]
    )
    noise, spacing = LEAST_NOISE_PX, SPACING_PX * unit
    if len(near) >= 8:
        spacing = max(float(median_of_rows(step[near])), 1.0)
        change = np.abs(np.diff(residuals_px)[near])
        noise = max(LEAST_NOISE_PX, NEIGHBOURS_ALIKE * 1.4826 / np.sqrt(2.0) * float(median_of_rows(change)))
    repeats = max(CORRELATION_PX * unit / spacing, 1.0)
    model = MODEL_SIGMA_PX * unit * np.sqrt(alike)
    return np.asarray(np.sqrt(noise**2 + (model**2 + measured.bias_px**2) * repeats))


def number_parts(measured: MeasuredFrame, part_m: float = PART_M) -> Indices:
    """Number (M,) of marking and part of the field of each place of a frame: what is off there is off alike."""
    x, y = np.floor(measured.field_m / part_m).astype(np.int_).T
    return np.asarray((measured.marking * MOST_PARTS + x) * MOST_PARTS + y, np.int_)


def add_by_part(at: Indices, count: int, values: Array) -> Array:
    """Sums (count, V) of values (M, V) of places, by the parts (M,) in which they lie."""
    found = np.zeros((count, values.shape[1]))
    np.add.at(found, at, values)
    return found


@dataclass(frozen=True, slots=True)
class FramePaint:
    """The paint of a frame about a camera of its tripod.

    Attributes
    ----------
    away, sigma : (M,) arrays
        Its distances from the markings, pixels, and their standard deviations.
    by_own, by_common : (M, 3), (M, K) arrays
        Derivatives of the distances by the head and by the common parameters.
    """

    away: Array
    sigma: Array
    by_own: Array
    by_common: Array

    def shares(self, loss_scale: float) -> Array:
        """What the Geman-McClure loss leaves of the squares (M,); its own square is the weight of a place."""
        return np.asarray(1.0 / (1.0 + (self.away / self.sigma) ** 2 / loss_scale**2))

    def weights(self, loss_scale: float) -> Array:
        """With which each place (M,) counts, per square pixel."""
        return np.asarray(self.shares(loss_scale) ** 2 / self.sigma**2)

    def cost(self, loss_scale: float) -> float:
        """Of the distances."""
        return float(((self.away / self.sigma) ** 2 * self.shares(loss_scale)).sum())

    def normal_equations(self, loss_scale: float) -> tuple[Array, Array]:
        """Of head and common parameters (3 + K,): matrix and gradient."""
        jacobian = np.concatenate([self.by_own, self.by_common], axis=1) / self.sigma[:, None]
        weighted = jacobian * (self.shares(loss_scale) ** 2)[:, None]
        return weighted.T @ jacobian, weighted.T @ (self.away / self.sigma)

    def add_by_part(self, part: Indices, count: int, loss_scale: float) -> tuple[Array, Array, Array, Array]:
        """Weighted sums over the places in each part of the field, by the number (M,) of its part: of the distances
        (count,), of the weights (count,), and of the derivatives by head (count, 3) and common parameters (count, K).
        """
        weight = self.weights(loss_scale)
        away, size = (np.asarray(np.bincount(part, v, count), np.float64) for v in (weight * self.away, weight))
        by_own, by_common = (add_by_part(part, count, weight[:, None] * rows) for rows in (self.by_own, self.by_common))
        return away, size, by_own, by_common


def rms_distances(measured: MeasuredFrame, away: Array, unit: float) -> tuple[float, float]:
    """Root mean square distances of a frame's paint, pixels: without paint too faint to be expected, and of paint that
    is not mistaken for what lies beside it where that is less.
    """
    is_told = measured.bias_px < FAINT_BIAS_PX * unit
    is_clear = np.asarray(is_told & (measured.scale_px_m > CLEAR_PX_M * unit), np.bool_)
    rms = _rms(away[is_told] if is_told.any() else away, unit)
    return rms, min(rms, _rms(away[is_clear], unit)) if np.count_nonzero(is_clear) >= LEAST_CLEAR else rms


def _rms(away: Array, unit: float) -> float:
    """Root mean square of distances (M,), none of which counts more than the farthest; 0 of none: a frame may show
    nothing but a line that is left out.
    """
    return float(np.sqrt(np.mean(np.minimum(np.abs(away), FARTHEST_PX * unit) ** 2))) if len(away) else 0.0
