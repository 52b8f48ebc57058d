"""Stage ``homography``: the normalised DLT on the derived points and tangents and on what was seen beside them.

The derived ones alone are images under one homography, whatever the noise: the system would only solve again what their
closed form did, with the tangents or without. What was seen itself contradicts them by its noise, and a system of
points and lines weighs the circle against it, with the tangents for more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.geometry.homography import dlt, transfer_errors, turn_homography
from circlecal.geometry.projective import Array
from circlecal.refusals import refuse
from circlecal.results import Correspondences, HomographyFit


class HomographyConfig(BaseModel):
    """Options of the stage ``homography``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    use_tangents: bool = Field(
        True,
        description="Whether the eight tangents enter the linear system beside the eight points: the circle then "
        "weighs more against named lines, marks and keypoints. Without any of those it changes nothing.",
    )
    maximum_condition: float = Field(1e4, gt=1, description="Worse conditioned linear systems are refused.")


def estimate_homography(
    correspondences: Correspondences, circle_center: Array, config: HomographyConfig
) -> HomographyFit:
    """Homography of the field plane from the derived points and tangents, and what was seen beside them.

    Parameters
    ----------
    correspondences : Correspondences
        From the stage ``correspondences``.
    circle_center : (2,) array
        Centre of the circle on the field; the other solution is the field turned about it.
    config : HomographyConfig
        Options.

    Raises
    ------
    EstimationError
        ``degenerate`` where the system has no unique solution, ``ill_conditioned`` where it hardly has one.
    """
    points = correspondences.all_points
    lines = (*(correspondences.tangents if config.use_tangents else ()), *correspondences.seen_lines)
    field_points = np.array([p.field_m for p in points]).reshape(-1, 2)
    image_points = np.array([p.image_px for p in points]).reshape(-1, 2)
    field_lines = np.array([line.field_line for line in lines]).reshape(-1, 3)
    image_lines = np.array([line.image_line for line in lines]).reshape(-1, 3)
    solution = dlt(field_points, image_points, field_lines, image_lines)
    if solution is None:
        raise refuse("homography", "degenerate")
    if solution.condition > config.maximum_condition:
        detail = f"condition {solution.condition:.3g}, at most {config.maximum_condition:.3g} is allowed"
        raise refuse("homography", "ill_conditioned", detail)
    return HomographyFit(
        H_image_field=solution.H,
        H_image_field_turned=turn_homography(solution.H, circle_center),
        residuals_px=transfer_errors(solution.H, field_points, image_points),
        condition=solution.condition,
        null_ratio=solution.null_ratio,
        lines=len(lines),
    )


def homography_of_solver(H: Array, circle_center: Array) -> HomographyFit:
    """A published method's homography (3, 3) as the result of this stage; it has no residuals of its own."""
    return HomographyFit(H, turn_homography(H, circle_center), np.zeros(0), float("nan"), float("nan"))


def turn_fit(fit: HomographyFit) -> HomographyFit:
    """The solution of the field turned by 180 degrees, with the first one as the other."""
    return replace(fit, H_image_field=fit.H_image_field_turned, H_image_field_turned=fit.H_image_field)
