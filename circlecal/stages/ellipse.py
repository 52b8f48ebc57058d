"""Stage ``ellipse``: the conics of the marking's edges and of its centreline.

RANSAC around minimal conics and a closed-form fit (Fitzgibbon's direct fit by default), then geometric refinement; the
inliers are always those of the returned conic.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.geometry.conic_fits import refine_conic
from circlecal.geometry.ellipses import (
    Ellipse,
    arc_coverage_deg,
    conic_from_ellipse,
    ellipse_from_conic,
    orthogonal_distance,
)
from circlecal.geometry.projective import Array, Mask
from circlecal.geometry.ransac import ransac_conic
from circlecal.observations import CircleEdge, Observations
from circlecal.refusals import refuse
from circlecal.results import EllipseFit, EllipseFits, RayPoints

MINIMUM_GIVEN_POINTS = 6
"""Points that a person gives are fitted from one more than an ellipse has parameters."""
Method = Literal["direct", "algebraic", "taubin"]


class EllipseConfig(BaseModel):
    """Options of the stage ``ellipse``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    method: Method = Field(
        "direct",
        description="Closed form inside RANSAC: direct (Fitzgibbon; shrinks on short arcs), algebraic, or taubin.",
    )
    hypotheses: int = Field(1000, ge=10, le=100000, description="Most RANSAC samples per edge.")
    confidence: float = Field(
        0.999,
        gt=0,
        le=1,
        description="RANSAC stops when it has drawn a sample without outliers with this probability; 1 draws all.",
    )
    threshold_px: float = Field(
        3.0,
        gt=0,
        le=100,
        description="Inlier distance, pixels at 1920 px width; lens and crown bend a true circle by 1-3 px.",
    )
    minimum_points: int = Field(24, ge=6, description="Fewer points than this on an edge are no edge.")
    minimum_arc_deg: float = Field(
        60,
        ge=0,
        le=360,
        description="Shorter arcs are refused; beside a halfway line and others it is the camera that tells how long an"
        " arc is.",
    )
    maximum_rms_px: float = Field(2.0, gt=0, description="Larger residuals are refused, pixels at 1920 px width.")


def fit_ellipses(
    rays: RayPoints, width: int, config: EllipseConfig, rng: np.random.Generator, *, has_lines: bool = False
) -> EllipseFits:
    """Fit the outer edge, the inner edge and the centreline.

    Parameters
    ----------
    rays : RayPoints
        From the stage ``rays``.
    width : int
        Width of the picture, to which the thresholds are scaled.
    config : EllipseConfig
        Options.
    rng : numpy.random.Generator
        Source of the RANSAC samples.
    has_lines : bool
        Whether the halfway line and further lines are seen: of a short arc the ellipse hardly tells the size, so that
        90 degrees of the circle may be 15 of a large ellipse, and the lines do.

    Raises
    ------
    EstimationError
        ``no_ellipse`` where no edge gives an ellipse, ``arc_too_short``, ``residual_too_large``.
    """
    unit = width / 1920.0
    center = fit_edge("center", rays.center_line_px, rays.center_line_sigma_px, unit, config, rng, rays.rough)
    start = rays.rough if center is None else center.ellipse
    fits = EllipseFits(
        outer=fit_edge("outer", rays.outer_px, rays.outer_sigma_px, unit, config, rng, start),
        inner=fit_edge("inner", rays.inner_px, rays.inner_sigma_px, unit, config, rng, start),
        center=center,
    )
    if not fits.all():
        raise refuse("ellipse", "no_ellipse", "a hyperbola, or too few points")
    best = fits.primary
    is_short = best.arc_deg < config.minimum_arc_deg
    if is_short and not has_lines:
        detail = f"{best.arc_deg:.0f} degrees, {config.minimum_arc_deg:.0f} are needed"
        raise refuse("ellipse", "arc_too_short", detail)
    if best.rms_px > config.maximum_rms_px * unit:
        limit = config.maximum_rms_px * unit
        detail = f"its points leave an ellipse by {best.rms_px:.2f} px rms, {limit:.2f} are allowed"
        raise refuse("ellipse", "residual_too_large", detail)
    return replace(fits, least_arc_deg=config.minimum_arc_deg) if is_short else fits


def fit_observations(
    observations: Observations, circle: str, width: int, config: EllipseConfig, rng: np.random.Generator
) -> EllipseFits:
    """Fit the edges of a circle from points that somebody else found; a handful of them is enough.

    Raises
    ------
    EstimationError
        ``no_ellipse`` where no edge gives an ellipse.
    """
    few = config.model_copy(update={"minimum_points": MINIMUM_GIVEN_POINTS})
    unit = width / 1920.0
    found: dict[CircleEdge, EllipseFit | None] = {"outer": None, "inner": None, "center": None}
    for edge in found:
        seen = [c for c in observations.circles if c.circle == circle and c.edge == edge]
        if seen:
            points, sigma = (np.concatenate([getattr(c, name) for c in seen]) for name in ("points_px", "sigma_px"))
            found[edge] = fit_edge(edge, points, sigma, unit, few, rng)
    fits = EllipseFits(found["outer"], found["inner"], found["center"])
    if not fits.all():
        raise refuse("ellipse", "no_ellipse", f"at least 6 points of {circle!r} are needed")
    return fits


def fit_edge(
    edge: CircleEdge,
    points_px: Array,
    sigma_px: Array,
    unit: float,
    config: EllipseConfig,
    rng: np.random.Generator,
    similar: Ellipse | None = None,
) -> EllipseFit | None:
    """Robust ellipse through the points (N, 2) of one edge; None where they give none.

    ``similar`` is an ellipse near the edge, if known; where the multiple of it that lies amid the points explains
    nearly all of them, no samples are drawn.
    """
    if len(points_px) < config.minimum_points:
        return None
    threshold = config.threshold_px * unit + 3.0 * sigma_px
    robust = ransac_conic(
        points_px,
        threshold,
        rng,
        hypotheses=config.hypotheses,
        method=config.method,
        confidence=config.confidence,
        start=None if similar is None else _multiple(similar, points_px),
    )
    if robust is None or robust.inliers.sum() < config.minimum_points:
        return None
    conic, inliers = robust.conic, robust.inliers
    for _ in range(3):
        refined = refine_conic(points_px[inliers], conic, sigma_px[inliers])
        found = None if refined is None else ellipse_from_conic(refined[0])
        if refined is None or found is None:
            return None
        ellipse, (conic, covariance) = found, refined
        distance = orthogonal_distance(ellipse, points_px)
        kept: Mask = np.abs(distance) < threshold
        if kept.sum() < config.minimum_points:
            return None
        if np.array_equal(kept, inliers):
            break
        inliers = kept
    return EllipseFit(
        edge=edge,
        conic=conic,
        covariance=covariance,
        ellipse=ellipse,
        method=config.method,
        points_px=points_px,
        sigma_px=sigma_px,
        inliers=kept,
        rms_px=float(np.sqrt(np.mean(distance[kept] ** 2))),
        arc_deg=arc_coverage_deg(ellipse, points_px[kept]),
        hypotheses=robust.hypotheses,
    )


def _multiple(ellipse: Ellipse, points: Array) -> Array:
    """Conic of the ellipse about the same centre that as many of the points (N, 2) lie in as out of."""
    a, b = ellipse.semi_axes
    along, across = ellipse.frame()[:2, :2].T
    away = points - ellipse.center
    scale = float(np.median(np.hypot(away @ (along / (a * a)), away @ (across / (b * b)))))
    return conic_from_ellipse(Ellipse(ellipse.center, (scale * a, scale * b), ellipse.angle_rad))
