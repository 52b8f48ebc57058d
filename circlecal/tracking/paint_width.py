"""How broad the paint is, from how broad it looks: lines of many scales under one blur.

Paint of width w under a Gaussian blur of standard deviation b has at half its peak a full width ``b f(w / b)``, where f
goes from 2.355, that of the blur alone, to ``w / b`` itself. Places where something lies beside the paint, or where the
picture moved, look broader and count little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import erf

from circlecal.config import Config
from circlecal.field import FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import PLACE
from circlecal.tracking.markings import DrawnTemplate, template_curves
from circlecal.tracking.seen_paint import MeasuredFrame
from circlecal.tracking.tripod_fit import common_priors

WIDTH_SD_M = 0.005
"""Of a width from how broad the paint looks, metres: in five rendered clips it is off by 0, 0, -4, 5 and -5 mm."""
LEAST_PLACES, LEAST_PX = 150, 0.9
"""Places that are needed at least, and how broad paint of the usual width is there, pixels: where it is narrower it
looks like the blur alone.
"""
SCATTER_PX = 0.1, 0.3
"""Of the full width at half the peak about its model, pixels, at last and at first."""
WIDTHS_M = 0.05, 0.2
"""Least and greatest width of paint on any field, metres."""


def _half_width_table() -> tuple[Array, Array]:
    """Ratios w / b, and full widths at half the peak over b for them."""
    ratio = np.concatenate([np.linspace(0.0, 8.0, 81)[1:], [50.0]])
    across = np.linspace(0.0, 30.0, 3001)
    root = np.sqrt(2.0)
    profile = erf((across + ratio[:, None] / 2) / root) - erf((across - ratio[:, None] / 2) / root)
    reached = np.count_nonzero(profile >= profile[:, :1] / 2, axis=1)
    return ratio, 2.0 * across[reached - 1]


_RATIO, _HALF_WIDTH = _half_width_table()


def half_peak_width(width_px: Array, blur_px: float) -> Array:
    """Full width at half the peak (N,) of paint of widths (N,) under a blur, pixels."""
    return np.asarray(blur_px * np.interp(width_px / blur_px, _RATIO, _HALF_WIDTH))


def estimate_paint_width(
    frames: Sequence[MeasuredFrame], usual_m: float, drawn: DrawnTemplate
) -> tuple[float, float] | None:
    """Width of the paint and its standard deviation, metres; None where the frames do not show it.

    Parameters
    ----------
    frames : sequence of MeasuredFrame
        Of one camera.
    usual_m : float
        Width by the template.
    drawn : DrawnTemplate
        The field: markings that have a width of their own say nothing of the others'.
    """
    from scipy.optimize import least_squares  # slow to import

    is_usual = [drawn.own_width_m[frame.marking] == 0.0 for frame in frames]
    scale, seen = (
        np.concatenate([getattr(frame, name)[usual] for frame, usual in zip(frames, is_usual, strict=True)] or [[]])
        for name in ("scale_px_m", "width_px")
    )
    broad = scale * usual_m > LEAST_PX
    if np.count_nonzero(broad) < LEAST_PLACES:
        return None
    scale, seen = scale[broad], seen[broad]

    def residuals(parameters: Array) -> Array:
        return half_peak_width(parameters[0] * scale, float(parameters[1])) - seen

    start = np.array([usual_m, max(float(np.percentile(seen, 10)) / _HALF_WIDTH[0], 0.3)])
    bounds = ([WIDTHS_M[0] / 2, 0.1], [2 * WIDTHS_M[1], 5.0])
    for scatter in reversed(SCATTER_PX):
        fit = least_squares(
            residuals, np.clip(start, *bounds), bounds=bounds, loss="cauchy", f_scale=scatter, x_scale=(0.01, 0.1)
        )
        start = fit.x
    width_m = float(start[0])
    if not WIDTHS_M[0] < width_m < WIDTHS_M[1]:
        return None
    weight = 1.0 / (1.0 + (fit.fun / SCATTER_PX[0]) ** 2)
    normal = (fit.jac * 1.0).T @ fit.jac
    formal = SCATTER_PX[0] * float(np.sqrt(np.linalg.pinv(normal)[0, 0]))
    if weight.sum() < LEAST_PLACES or formal > WIDTH_SD_M:
        return None
    return width_m, float(np.hypot(WIDTH_SD_M, formal))


def priors_of_frames(
    config: Config,
    template: FieldTemplate,
    size: tuple[int, int],
    measured: Sequence[MeasuredFrame],
    log_focal: float,
) -> tuple[Array, Array]:
    """Means and standard deviations (K,) of the common parameters, quoted at a logarithm of the focal length, with how
    broad the paint looks in frames.
    """
    mean, sd = common_priors(config.camera, config.rig, template, size, float(np.exp(log_focal)) / size[0])
    seen = estimate_paint_width(measured, template.marking_width_m, template_curves(template))
    if seen is not None:
        # paint is no broader than the rules allow, however it looks
        mean[PLACE["width"]] = min(seen[0] - template.marking_width_m, 0.0)
        sd[PLACE["width"]] = seen[1]
    return mean, sd
