"""What every solver takes and returns: one signature, one result, a failure as a value with its reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Protocol

import numpy as np

from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.homography import scale_homography
from circlecal.geometry.projective import Array
from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkPoint, Observations

STAGE = "solver"


@dataclass(frozen=True, slots=True)
class SolverResult:
    """A homography, or why there is none.

    Attributes
    ----------
    H_image_field : (3, 3) array or None
        Field to undistorted pixels; None for a failure.
    code : str
        ``"ok"``, or the machine-readable reason of the failure.
    reason : str
        Reason of the failure in words; empty for a success.
    """

    H_image_field: Array | None
    code: str = "ok"
    reason: str = ""


@dataclass(frozen=True, slots=True)
class IntrinsicsResult:
    """Calibration matrix K (3, 3) of square or general pixels, or why there is none."""

    intrinsics: Array | None
    code: str = "ok"
    reason: str = ""


class Solver(Protocol):
    """The one signature of all solvers."""

    def __call__(
        self, observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator
    ) -> SolverResult:
        """Homography of one frame."""


class IntrinsicsSolver(Protocol):
    """Signature of the methods that find the camera's inner geometry only, from one or more frames of one zoom."""

    def __call__(
        self, views: Sequence[Observations], template: FieldTemplate, circle: Circle, rng: np.random.Generator
    ) -> IntrinsicsResult:
        """Calibration matrix that the views share."""


HomographyMethod = Callable[[Observations, FieldTemplate, Circle, np.random.Generator], Array]
IntrinsicsMethod = Callable[[Sequence[Observations], FieldTemplate, Circle, np.random.Generator], Array]


def failure(code: str, reason: str) -> EstimationError:
    """The error by which a step inside a solver gives up; it never leaves the solver."""
    return EstimationError(STAGE, code, reason)


def _find_damage(observations: Observations) -> tuple[str, str] | None:
    """Code and reason of what no method can use; None where everything may be used."""
    curves: tuple[CirclePoints | LinePoints, ...] = (*observations.circles, *observations.lines)
    points: tuple[MarkPoint | Keypoint, ...] = (*observations.marks, *observations.keypoints)
    pixels = [*(seen.points_px for seen in curves), *(seen.point_px for seen in points)]
    sigmas = [*(seen.sigma_px for seen in curves), *(np.array(seen.sigma_px) for seen in points)]
    if not all(np.isfinite(values).all() for values in (*pixels, *sigmas)):
        return "not_finite", "an observed point is not finite, or its standard deviation"
    if not all((sigma > 0.0).all() for sigma in sigmas):
        return "degenerate", "a standard deviation is not above 0"
    if any(len(line.points_px) > 1 and np.ptp(line.points_px, axis=0).max() == 0.0 for line in observations.lines):
        return "degenerate", "all points of a line are one pixel"
    return None


def solver(method: HomographyMethod) -> Solver:
    """Turn a method that returns a homography or gives up into a solver that returns a result in any case.

    What overflows or is divided by zero on the way is no number, and ends in a homography that is none: nothing is
    raised or warned of.
    """

    @wraps(method)
    def solve(
        observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator
    ) -> SolverResult:
        damage = _find_damage(observations)
        if damage is not None:
            return SolverResult(None, *damage)
        try:
            with np.errstate(all="ignore"):
                H = method(observations, template, circle, rng)
                determinant = np.linalg.det(H)
        except EstimationError as error:
            return SolverResult(None, error.code, error.reason)
        except np.linalg.LinAlgError as error:
            return SolverResult(None, "degenerate", f"a linear system has no solution: {error}")
        if not np.isfinite(H).all() or not abs(determinant) > 1e-300:
            return SolverResult(None, "degenerate", "the homography is singular")
        return SolverResult(scale_homography(H))

    return solve


def intrinsics_solver(method: IntrinsicsMethod) -> IntrinsicsSolver:
    """Turn a method that finds a calibration matrix or gives up into a solver, as :func:`solver` does."""

    @wraps(method)
    def solve(
        views: Sequence[Observations], template: FieldTemplate, circle: Circle, rng: np.random.Generator
    ) -> IntrinsicsResult:
        damage = next(filter(None, map(_find_damage, views)), None)
        if damage is not None:
            return IntrinsicsResult(None, *damage)
        try:
            with np.errstate(all="ignore"):
                K = method(views, template, circle, rng)
        except EstimationError as error:
            return IntrinsicsResult(None, error.code, error.reason)
        except np.linalg.LinAlgError as error:
            return IntrinsicsResult(None, "degenerate", f"a linear system has no solution: {error}")
        if not np.isfinite(K).all():
            return IntrinsicsResult(None, "degenerate", "the calibration matrix is not finite")
        return IntrinsicsResult(K)

    return solve
