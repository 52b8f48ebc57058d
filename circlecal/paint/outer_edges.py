"""Where paint begins along a closed curve that something fills: the outermost edge, coming from the bare ground.

A logo that reaches up to the line of its circle leaves no band: the line shows as one where a gap of the ground is left
between both, as a step where the logo meets it, and not at all where both have one colour. What all three have in
common is the first change of colour that one meets from outside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array, Mask
from circlecal.paint.profiles import estimate_noise, sample_profiles, smooth_along, to_gray

__all__ = ["measure_outer_edges"]

STEP_PX, ALONG_SAMPLES = 0.5, 2.0
"""Between two places of a profile, pixels, and over how many neighbouring profiles (standard deviation) they are
smoothed."""
EDGE_SIGMA_PX = 0.9
"""Standard deviation of the derivative across the curve, pixels at 1920 px width and of the picture at least."""
LEAST_SHARE = 0.3
"""Slope of the outermost edge over that of the steepest one of its profile: the line of a rink's circle, which lets the
ice through, stands out by a third of a dark logo at least; what lies farther out is a shadow, or grain of the ice."""
NOISE_TIMES, LEAST_LEVELS = 5.0, 3.0
"""In standard deviations of the slope's noise, and gray levels per pixel, what is an edge."""


def measure_outer_edges(
    image: NDArray[np.uint8], points: Array, outward: Array, inner_px: Array, outer_px: float
) -> tuple[Array, Mask]:
    """Places of the outermost edges across a curve.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    points, outward : (N, 2) arrays
        Places along the curve, pixels, and unit vectors away from what it surrounds.
    inner_px : (N,) array
        How far inside the curve an edge may be.
    outer_px : float
        How far outside.

    Returns
    -------
    places : (N, 2) array
        Of the edges, pixels.
    found : (N,) array of bool
        Where there is one.
    """
    widest = float(inner_px.max(initial=0.0))
    offsets = np.arange(-widest - 2 * STEP_PX, outer_px + 3 * STEP_PX, STEP_PX)
    slope = _measure_slopes(image, points, outward, offsets)
    slope[:, [0, -1]] = 0.0
    slope[offsets[None] < -inner_px[:, None]] = 0.0
    least = np.maximum(LEAST_SHARE * slope.max(axis=1), _least_slope(image))
    before, here, after = slope[:, :-2], slope[:, 1:-1], slope[:, 2:]
    is_peak = (here >= before) & (here > after) & (here >= least[:, None])
    found = is_peak.any(axis=1)
    k = is_peak.shape[1] - 1 - is_peak[:, ::-1].argmax(axis=1)
    low, peak, high = (part[np.arange(len(points)), k] for part in (before, here, after))
    # vertex of the parabola through the three slopes
    beside = 0.5 * (low - high) / np.minimum(low - 2 * peak + high, -1e-9)
    at = offsets[k + 1] + STEP_PX * np.clip(beside, -0.5, 0.5)
    return points + at[:, None] * outward, np.asarray(found, np.bool_)


def _derivative(image: NDArray[np.uint8]) -> Array:
    """Kernel (K,) of the derivative of a Gaussian, per pixel, over places of a profile."""
    sigma = max(EDGE_SIGMA_PX, EDGE_SIGMA_PX * image.shape[1] / 1920.0)
    reach = int(np.ceil(3.0 * sigma / STEP_PX))
    x = STEP_PX * np.arange(-reach, reach + 1)
    bell = np.exp(-0.5 * (x / sigma) ** 2)
    return np.asarray(-x * bell / sigma**2 / bell.sum())


def _measure_slopes(image: NDArray[np.uint8], points: Array, outward: Array, offsets: Array) -> Array:
    """Slope (N, S) of all colours together along profiles, gray levels per pixel; 0 beyond the picture."""
    kernel = _derivative(image)
    reach = len(kernel) // 2
    longer = offsets[0] + STEP_PX * np.arange(-reach, len(offsets) + reach)
    square = np.zeros((len(points), len(offsets)))
    for channel in range(3):
        colour = np.ascontiguousarray(image[..., channel])
        profiles = smooth_along(sample_profiles(colour, points, outward, longer), ALONG_SAMPLES)
        windows = np.lib.stride_tricks.sliding_window_view(np.asarray(profiles, np.float64), len(kernel), axis=1)
        square += np.nan_to_num(windows @ kernel[::-1]) ** 2
    return np.sqrt(square / 3.0)


def _least_slope(image: NDArray[np.uint8]) -> float:
    """Least slope of an edge, gray levels per pixel."""
    kernel = _derivative(image)
    # neighbouring places of a profile share pixels, and so their noise
    noise = estimate_noise(to_gray(image)) * float(np.sqrt((kernel**2).sum() / STEP_PX))
    return max(LEAST_LEVELS, NOISE_TIMES * noise / np.sqrt(2.0 * ALONG_SAMPLES))
