"""What the residuals say of the observations' standard deviations."""

from __future__ import annotations

import numpy as np

from circlecal.camera_fit.curves import CurvePoints
from circlecal.camera_fit.optimise import Problem, State
from circlecal.camera_fit.uncertainty import correlation_factor


def inflated(problem: Problem, state: State) -> tuple[CurvePoints, float]:
    """Curves with sigmas grown by the scatter of their residuals and by how much neighbours repeat each other."""
    curves, values = problem.curves, state.residuals[0]
    factor = np.ones(len(values))
    for group in range(len(curves.names)):
        index = np.flatnonzero(curves.group == group)
        ordered = index[np.argsort(state.hidden[0, index], kind="stable")]
        residual = np.clip(values[ordered], -6, 6)
        if len(residual) < 8:
            continue
        scatter = np.sqrt(np.mean(residual**2) * len(residual) / max(len(residual) - 3.0, 1.0))
        factor[index] = max(1.0, scatter) * np.sqrt(correlation_factor(residual))
    scale = float(np.sqrt(np.mean(factor**2))) if len(factor) else 1.0
    return curves.with_sigma(curves.sigma_px * factor), scale
