"""Stage ``homography``: the normalised DLT on the derived points and tangents together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.field import FieldTemplate
from circlecal.geometry.homography import camera_side_of, dlt, scale_homography, transfer_errors, turn_homography
from circlecal.geometry.projective import Array, join, lift, line_distance
from circlecal.observations import Observations
from circlecal.refusals import refuse
from circlecal.results import Correspondences, HomographyFit

ALIKE_SHARE = 1e-6
"""Of squared distances from what was seen: two homographies that differ by no more differ by rounding errors."""


class HomographyConfig(BaseModel):
    """Options of the stage ``homography``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    use_tangents: bool = Field(
        True, description="Whether the eight tangents enter the linear system beside the eight points."
    )
    maximum_condition: float = Field(1e4, gt=1, description="Worse conditioned linear systems are refused.")


def estimate_homography(
    correspondences: Correspondences, circle_center: Array, config: HomographyConfig
) -> HomographyFit:
    """Homography of the field plane from the derived points and tangents.

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
    points, tangents = correspondences.points, correspondences.tangents if config.use_tangents else ()
    field_points = np.array([p.field_m for p in points]).reshape(-1, 2)
    image_points = np.array([p.image_px for p in points]).reshape(-1, 2)
    field_lines = np.array([t.field_line for t in tangents]).reshape(-1, 3)
    image_lines = np.array([t.image_line for t in tangents]).reshape(-1, 3)
    solution = dlt(field_points, image_points, field_lines, image_lines)
    if solution is None:
        raise refuse("homography", "degenerate")
    if solution.condition > config.maximum_condition:
        detail = f"condition {solution.condition:.3g}, at most {config.maximum_condition:.3g} is allowed"
        raise refuse("homography", "ill_conditioned", detail)
    return HomographyFit(
        H_image_field=solution.H,
        H_field_image=scale_homography(np.linalg.inv(solution.H)),
        H_image_field_turned=turn_homography(solution.H, circle_center),
        residuals_px=transfer_errors(solution.H, field_points, image_points),
        condition=solution.condition,
        null_ratio=solution.null_ratio,
    )


def homography_of_solver(H: Array, circle_center: Array) -> HomographyFit:
    """A published method's homography (3, 3) as the result of this stage; it has no residuals of its own."""
    inverse, turned = scale_homography(np.linalg.inv(H)), turn_homography(H, circle_center)
    return HomographyFit(H, inverse, turned, np.zeros(0), float("nan"), float("nan"))


def choose_turn(
    H: Array, observations: Observations, template: FieldTemplate, circle_center: Array, side: str
) -> Array:
    """A published method's homography (3, 3), or that of the field turned by 180 degrees about the circle's centre.

    Parameters
    ----------
    H : (3, 3) array
        The method's own choice.
    observations : Observations
        What was seen: of two homographies the one is taken that explains named lines, marks and keypoints better.
    template : FieldTemplate
        Says where these are on the field.
    circle_center : (2,) array
        Centre of the circle on the field.
    side : str
        Of :data:`circlecal.geometry.homography.SIDES`: where the camera stands, if both explain all as well.
    """
    turned = turn_homography(H, circle_center)
    kept, other = (_misfit_px2(each, observations, template) for each in (H, turned))
    if abs(kept - other) > ALIKE_SHARE * (kept + other):
        return H if kept < other else turned
    return turned if camera_side_of(H, side, circle_center) < 0 else H


def _misfit_px2(H: Array, observations: Observations, template: FieldTemplate) -> float:
    """Sum of squared distances, square pixels, of lines, marks and keypoints from where a homography puts them."""
    lines = template.line_by_name
    total = 0.0
    for seen in observations.lines:
        if seen.line in lines:
            start, end = lift(template.line_ends(lines[seen.line])) @ H.T
            total += float((line_distance(join(start, end), seen.points_px) ** 2).sum())
    places = [(np.asarray(template.mark_by_name[m.mark].position), m.point_px) for m in observations.marks]
    places += [(k.field_m, k.point_px) for k in observations.keypoints]
    if places:
        field, image = (np.array(each, dtype=np.float64) for each in zip(*places, strict=True))
        total += float((transfer_errors(H, field, image) ** 2).sum())
    return total


def turn_fit(fit: HomographyFit) -> HomographyFit:
    """The solution of the field turned by 180 degrees, with the first one as the other."""
    H = fit.H_image_field_turned
    inverse = scale_homography(np.linalg.inv(H))
    return replace(fit, H_image_field=H, H_field_image=inverse, H_image_field_turned=fit.H_image_field)
