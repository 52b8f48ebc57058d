"""How much of a predicted circle is painted, from many weak samples: worn paint shows in their sum, not in each.

A matched filter (the paint's width against both sides) is averaged over each sector of the circle; where the circle
is painted the average stands out from those of the same curve moved inwards and outwards, which show the surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.camera_fit.model import fitted_frame, view
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.homogeneous import Array
from circlecal.profiles import sample_profiles
from circlecal.results import CameraFit

__all__ = ["painted_all_round", "painted_sectors"]

SECTORS, SAMPLES = 24, 30
"""Of the circle, and places in each."""
LEAST_WIDTH_PX = 2.0
"""Blur makes narrower paint this wide, pixels at 1920 px width."""
TAPS, REACH = 4, 12.0
"""Samples across per width of the paint, and how far the curve is moved, in those widths."""
AT_CURVE, OFF_CURVE = 1.0, 3.0
"""Widths from the curve within which the paint lies, and from which on there is only the surface."""
CLEAR, LEAST_SHARE, LEAST_SECTORS = 3.0, 0.75, 18
"""A sector is painted from so many standard deviations on; a circle with this share of its sectors, if the picture
shows three quarters of them (no arc of another marking is as long, and ellipses stitched from other lines and streaks
have half of them at most).
"""
FLOOR = 0.3
"""Least scatter of an average, grey levels."""
CLIPPED = 4.0
"""Single responses count up to so many times the usual one: players and captions are outliers."""


def painted_all_round(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> bool:
    """Whether paint shows nearly everywhere along the predicted circle; the parameters are those of
    :func:`painted_sectors`.
    """
    sectors = painted_sectors(picture, fit, template, circle)
    return len(sectors) >= LEAST_SECTORS and float(np.mean(sectors > CLEAR)) >= LEAST_SHARE


def painted_sectors(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> Array:
    """By how many standard deviations the paint stands out in each sector of the circle that the picture shows.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    fit : CameraFit
        Says where the circle is.
    template, circle : FieldTemplate, Circle
        The field and the circle.

    Returns
    -------
    (K,) array
        At most :data:`SECTORS` of them, in order.
    """
    frame = fitted_frame(fit, circle)
    angle = (np.arange(SECTORS * SAMPLES) + 0.5) * (2 * np.pi / (SECTORS * SAMPLES))
    outward = np.stack([np.cos(angle), np.sin(angle)])
    x, y = np.asarray(circle.center)[:, None] + template.radius(circle, "center") * outward
    seen = view(fit.theta[None], x[None], y[None], frame)
    along = seen.along(-outward[None, 1], outward[None, 0])[0].T
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    across = np.abs((seen.along(outward[None, 0], outward[None, 1])[0].T * normals).sum(axis=-1))
    width = np.maximum(template.marking_width_m * across, LEAST_WIDTH_PX * frame.width / 1920.0)
    places = np.where(seen.depth[0][:, None] > 0, seen.pixels[0].T, -1.0)
    offsets = np.arange(-REACH, REACH + 0.5 / TAPS, 1.0 / TAPS)
    response = _ridge_response(sample_profiles(picture, places, width[:, None] * normals, offsets))
    shift = offsets[2 * TAPS : -2 * TAPS]
    inside = np.asarray(np.isfinite(response).all(axis=1), np.bool_)
    usual = float(np.median(np.abs(response[inside]))) if inside.any() else 1.0
    response = np.clip(np.where(inside[:, None], response, 0.0), -CLIPPED * usual, CLIPPED * usual)
    count = inside.reshape(SECTORS, SAMPLES).sum(axis=1)
    mean = response.reshape(SECTORS, SAMPLES, -1).sum(axis=1)[2 * count >= SAMPLES]
    mean /= np.maximum(count[2 * count >= SAMPLES], 1)[:, None]
    surface = mean[:, np.abs(shift) >= OFF_CURVE]
    level = np.median(surface, axis=1)
    scatter = 1.4826 * np.median(np.abs(surface - level[:, None]), axis=1) + FLOOR
    return np.asarray((mean[:, np.abs(shift) <= AT_CURVE].max(axis=1) - level) / scatter)


def _ridge_response(profiles: NDArray[np.float32]) -> Array:
    """Mean over the paint's width less the lighter one of both sides (N, S - 4 TAPS), from profiles (N, S)."""
    total = np.cumsum(np.pad(profiles.astype(np.float64), ((0, 0), (1, 0))), axis=1)
    means = (total[:, TAPS:] - total[:, :-TAPS]) / TAPS  # of TAPS samples from each on
    size = profiles.shape[1] - 4 * TAPS
    # half a width of blur lies between the paint and the surface that it is compared with
    left, middle, right = (means[:, start : start + size] for start in (0, 3 * TAPS // 2, 3 * TAPS))
    return np.asarray(middle - np.maximum(left, right))
