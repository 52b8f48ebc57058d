"""From the optimum to what is reported: the camera, its covariance, and everything derived from both."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from circlecal.camera.covariance import (
    correlation_factor,
    count_from_seen,
    data_share,
    homography_vectors,
    imaged_points,
    posterior_covariance,
    push_forward,
    spread_cameras,
)
from circlecal.camera.painters import follow_errors, knows_painters_errors, weigh_errors
from circlecal.camera.problem import Problem, State
from circlecal.camera.spike_and_slab import Posterior
from circlecal.camera.valley import widen_valley
from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera_parameters import (
    INDEX,
    KAPPA,
    PARAMETERS,
    Projection,
    ProjectionModel,
    camera_of,
    homographies,
    project,
)
from circlecal.geometry.homography import compass_label
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array
from circlecal.observations import MarkingKey
from circlecal.results import CameraFit, DerivedPoint, FieldSize, HomographyRegion, OtherSize, PaintersFit

T = TypeVar("T")

MOST_CLICKS = 40
"""Points on one marking up to which each has a distance of its own in the result: the detector measures hundreds."""
REACH_RADII = 2.5
"""How far from the circle's centre, or from what is seen instead, the field counts for the largest predicted error."""

POINTS_PER_RADIUS = 9.15
"""Field points on the radius of the circle, at which errors are predicted: on a soccer pitch one each metre."""

STRAY_SHARE, STRAY_MEDIANS = 0.03, 7.5
"""Largest share of a marking's points that the rms of its bulk leaves out, and how many times the median distance of
all of them those lie off: points that were measured on a player's foot instead of the paint. Between 2 and 6 of 200
points did so in four rendered robots' fields; of points on paint, whose scatter is normal, one in two million does.
"""
NO_SAY = 0.01
"""Share of its weight that the loss must leave to the end of a line on another marking for this marking to count as
seen. In 92 real and rendered frames of named fields ends lie within 8 standard deviations of where the camera puts them
(share 0.13 at least); ends that a court taken for another sport's misses, 23 to 4,000 (0.004 at most).
"""
FEWEST_POINTS = 20
"""Field points in view below which four of them lie too close together to tell a homography."""
MOVING = [INDEX[k] for k in ("log_focal", "pan", "tilt", "roll", "x", "y", "z", "pp_x", "pp_y", "log_aspect")]
"""Parameters that move the homography of the tangent plane, with undistorted pixels."""


def camera_fit(
    problem: Problem,
    state: State,
    scale: float,
    rejected: tuple[MarkingKey, ...],
    named: dict[int, str],
    circle: Circle,
    template: FieldTemplate,
    stated_sigma_px: dict[MarkingKey, float],
    posterior: Posterior | None = None,
    growth: float = 1.0,
) -> CameraFit:
    """Everything that is reported of the best start of ``state``.

    ``posterior`` says what else the field may be like, and ``growth`` how many times the variance along the valley of
    zoom and distance is what the linear model says; both widen the covariance. What painters' errors add to it stays
    beside it, so that what is decided about markings is decided by what was seen.
    """
    model, theta = problem.model, state.theta[0]
    linear = posterior_covariance(state.normal[0], problem.priors.sd)
    covariance = widen_valley(linear, growth)
    if posterior is not None:
        covariance = posterior.widen(covariance)
    # what frames of one camera share is told of the camera
    is_own = posterior is not None or problem.priors.shared is None
    is_asked = is_own and problem.priors.sd[[INDEX["length"], INDEX["breadth"]]].any()
    prior = state.prior_jacobian[0]
    reference = problem.priors.center_m
    by_growth = problem.priors.center_by_growth
    seen, derived = _derive(theta, covariance, model, reference, by_growth, circle, template)
    turn = count_from_seen(by_growth)
    prior = prior @ (2.0 * np.eye(len(turn)) - turn)
    painted = follow_errors(problem, state, covariance, template)
    missed = _miss_ends(problem, state, stated_sigma_px.keys())
    return CameraFit(
        **derived,
        parameters=PARAMETERS,
        noise_scale=scale,
        data_share=data_share(seen, turn @ linear @ turn.T, prior.T @ prior),
        residual_correlation=_correlation(problem, state, circle),
        residuals_px=_leave_out(residuals_px(problem, state), missed),
        bulk_residuals_px=_leave_out(bulk_residuals_px(problem, state), missed),
        point_residuals_px=_leave_out(point_residuals_px(problem, state), missed),
        stated_sigma_px=stated_sigma_px,
        rejected=rejected,
        named_lines=tuple(sorted(set(named.values()))),
        names_by_line=named,
        reference_m=reference,
        reference_by_growth=by_growth,
        field_size=_field_size(theta, covariance, template, posterior) if is_asked else None,
        other_size=None if posterior is None else _other_size(seen, posterior, turn),
        painters=_weigh_painters(problem, state, template),
        painted_sigma_px={} if painted is None else painted.residual_px,
        missed_ends_px=missed,
    )


def _miss_ends(problem: Problem, state: State, stated: Collection[MarkingKey]) -> dict[MarkingKey, float]:
    """Markings of which a single point was seen, the end of another line, that the loss leaves no say, and how many
    pixels off it lies; never one that was ``stated`` in the observations.
    """
    by_marking, share = _residuals_by_marking(problem, state), problem.share_of_loss(state.residuals[0]) ** 2
    curves = problem.curves
    weight = dict(zip([curves.keys[group] for group in curves.group.tolist()], share.tolist(), strict=True))
    return {
        key: _rms(off)
        for key, off in by_marking.items()
        if len(off) == 1 and key not in stated and weight[key] < NO_SAY
    }


def _leave_out(found: dict[MarkingKey, T], keys: Collection[MarkingKey]) -> dict[MarkingKey, T]:
    return {key: value for key, value in found.items() if key not in keys}


def _weigh_painters(problem: Problem, state: State, template: FieldTemplate) -> PaintersFit | None:
    if not knows_painters_errors(template):
        return None
    weighed, covariance = weigh_errors(problem, state, template)
    theta = weighed.theta[0]
    return PaintersFit(theta, covariance, residuals_px(problem, weighed), point_residuals_px(problem, weighed))


def weigh_painters(fit: CameraFit, circle: Circle, template: FieldTemplate) -> CameraFit:
    """The camera that weighs what was seen by painters' errors too, with them in its covariance and in everything that
    follows from both.
    """
    if fit.painters is None:
        return fit
    theta, covariance = fit.painters.theta, fit.covariance + fit.painters.covariance
    _, derived = _derive(theta, covariance, fit.model, fit.reference_m, fit.reference_by_growth, circle, template)
    return replace(
        fit,
        **derived,
        field_size=_renew_size(fit.field_size, theta, covariance, template),
        residuals_px=_leave_out(fit.painters.residuals_px, fit.missed_ends_px),
        point_residuals_px=_leave_out(fit.painters.point_residuals_px, fit.missed_ends_px),
        painters=None,
    )


def _derive(
    theta: Array,
    covariance: Array,
    model: ProjectionModel,
    reference_m: Array,
    by_growth: Array,
    circle: Circle,
    template: FieldTemplate,
) -> tuple[Projection, dict[str, Any]]:
    """The field points in view, and all of a :class:`CameraFit` that follows from its parameters and their covariance.

    Predicted errors count from what was seen, which moves with the field's sizes as ``by_growth`` says; homography,
    points and region count from the middle of the field.
    """
    camera, surface = camera_of(theta, model), replace(model.surface, crown_m=float(theta[INDEX["crown"]]))
    # the camera itself first, then those about it: of one that is hardly known they may lie beyond all numbers, which
    # makes its standard deviations as large
    with np.errstate(over="ignore", invalid="ignore"):
        thetas = np.concatenate([theta[None], spread_cameras(theta, covariance, reference_m)])
        cameras = homographies(thetas, model)
    vectors = homography_vectors(cameras)
    centers_m = template.center_after_growth(circle, thetas[:, [INDEX["length"], INDEX["breadth"]]])
    centers = imaged_points(cameras, centers_m[:, None])[:, 0]
    grid = field_about(FieldView(camera, surface), template, circle, reference_m)
    seen = project(theta[None], grid[None], model)
    turn = count_from_seen(by_growth)
    sigmas = seen.sigma(turn @ covariance @ turn.T) if len(grid) else (np.full(1, np.inf), np.full(1, np.inf))
    return seen, {
        "theta": theta,
        "covariance": covariance,
        "camera": camera,
        "surface": surface,
        "H_covariance": push_forward(vectors[0], vectors[1:]),
        "imaged_center_px": centers[0],
        "imaged_center_covariance": push_forward(centers[0], centers[1:]),
        "max_sigma_px": float(sigmas[0].max()),
        "max_sigma_m": float(sigmas[1].max()),
        "mean_sigma_px": float(sigmas[0].mean()),
        "derived_points": derive_points(thetas, model, circle, centers_m),
        "region": homography_region(cameras, grid, covariance),
    }


def field_about(view: FieldView, template: FieldTemplate, circle: Circle, center_m: ArrayLike) -> Array:
    """Field points (N, 2) in view, within some radii of the circle from one (2,), at which errors are predicted."""
    return view.visible_field(template, center_m, REACH_RADII * circle.radius_m, circle.radius_m / POINTS_PER_RADIUS)


def homography_region(cameras: Array, grid_m: Array, covariance: Array) -> HomographyRegion | None:
    """Region of the true homography; None where hardly any of the field is in view.

    Parameters
    ----------
    cameras : (1 + K, 3, 3) array
        Homography of the camera, and those of the cameras about it that
        :func:`circlecal.camera.covariance.spread_cameras` gives.
    grid_m : (N, 2) array
        Field points in view; four that are seen far from each other are taken.
    covariance : (P, P) array
        Of the camera's parameters, 0 for those that are fixed.
    """
    if len(grid_m) < FEWEST_POINTS:
        return None
    points = grid_m[spread_quadrilateral(imaged_points(cameras[:1], grid_m)[0])]
    with np.errstate(over="ignore", invalid="ignore"):
        pixels = imaged_points(cameras, points).reshape(len(cameras), -1)
        spread = push_forward(pixels[0], pixels[1:])
    if not np.isfinite(spread).all():
        return None
    free = int(np.count_nonzero(np.diag(covariance)[MOVING] > 0))
    return HomographyRegion(points, pixels[0].reshape(-1, 2), spread, min(free, pixels.shape[1]))


def _field_size(theta: Array, covariance: Array, template: FieldTemplate, posterior: Posterior | None) -> FieldSize:
    """How long and broad the field is: about as its template says where no other kind of size was compared."""
    size = FieldSize(*_measure_field(theta, covariance, template), is_usual=True, usual_share=1.0)
    if posterior is None:
        return size
    return replace(size, is_usual=posterior.world.is_usual_size, usual_share=posterior.usual_share)


def _measure_field(theta: Array, covariance: Array, template: FieldTemplate) -> tuple[float, float, float, float]:
    """Length and width of the field, and their standard deviations, metres."""
    sizes = [INDEX["length"], INDEX["breadth"]]
    length, width = theta[sizes].tolist()
    length_sd, width_sd = np.sqrt(np.maximum(np.diag(covariance)[sizes], 0.0)).tolist()
    return template.length_m + length, template.width_m + width, length_sd, width_sd


def _renew_size(size: FieldSize | None, theta: Array, covariance: Array, template: FieldTemplate) -> FieldSize | None:
    """A field's size by another camera of it; None where it was not asked."""
    if size is None:
        return None
    return FieldSize(*_measure_field(theta, covariance, template), size.is_usual, size.usual_share)


def _other_size(seen: Projection, posterior: Posterior, turn: Array) -> OtherSize | None:
    """What it would change if the field were of another kind of size, at the field points in view, which count from
    what was seen by ``turn`` (P, P): an area that lies elsewhere on a longer field is drawn where it was.
    """
    if posterior.resized is None or seen.pixels.shape[1] == 0:
        return None
    away_px, _ = seen.sigma(turn @ posterior.resized @ turn.T)
    return OtherSize(posterior.resized_share, float(away_px.mean()))


def _correlation(problem: Problem, state: State, circle: Circle) -> float:
    """How many neighbouring residuals along the circle repeat each other: 1 where they are white."""
    circles = [k for k, key in enumerate(problem.curves.keys) if key.name == circle.name]
    factors = [1.0]
    for group in circles:
        index = np.flatnonzero(problem.curves.group == group)
        factors.append(correlation_factor(state.residuals[0, index[np.argsort(state.feet[0, index])]]))
    return max(factors)


def spread_quadrilateral(points: Array) -> Array:
    """Indices (4,) of points (N, 2) far from each other, no three of them near a line."""
    first = np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1))
    second = np.argmax(np.linalg.norm(points - points[first], axis=1))
    chosen = [first, second]
    for _ in range(2):
        ends = points[chosen]
        # twice the areas of the triangles that a point forms with each pair of those chosen before
        areas = [
            np.abs((b - a)[0] * (points - a)[:, 1] - (b - a)[1] * (points - a)[:, 0])
            for a, b in itertools.combinations(ends, 2)
        ]
        chosen.append(np.argmax(np.min(areas, axis=0)))
    return np.array(chosen)


def derive_points(thetas: Array, model: ProjectionModel, circle: Circle, centers_m: Array) -> tuple[DerivedPoint, ...]:
    """The circle's eight points on the crowned surface, those in front of the camera, with the covariance that the
    camera's implies.

    Parameters
    ----------
    thetas : (1 + K, P) array
        Parameters of the camera, and those of the cameras about it that
        :func:`circlecal.camera.covariance.spread_cameras` gives.
    model : ProjectionModel
        Picture size and surface of all of them.
    circle : Circle
        The circle.
    centers_m : (1 + K, 2) or (1, 2) array
        Its centre on the field as each of these cameras has it, or all of them, metres.
    """
    angle = np.radians(np.arange(0.0, 360.0, 45.0))
    outward = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = centers_m[:, None] + circle.radius_m * outward
    without_lens = thetas.copy()
    without_lens[:, KAPPA] = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        seen = project(without_lens, points, model)
        pixels = seen.pixels
    ahead = seen.depth[0] > 0
    outward, points, pixels = outward[ahead], points[0, ahead], pixels[:, ahead]
    covariances = push_forward(pixels[0], pixels[1:])
    return tuple(
        DerivedPoint(compass_label(toward), point, pixel, covariance)
        for toward, point, pixel, covariance in zip(outward, points, pixels[0], covariances, strict=True)
    )


def point_residuals_px(problem: Problem, state: State) -> dict[MarkingKey, Array]:
    """Signed distance (N,) of each point from its marking, pixels, in the order in which they were given; of markings
    with few points, as people click them.
    """
    curves, values = problem.curves, state.residuals[0] * problem.curves.sigma_px
    found: dict[MarkingKey, Array] = {}
    for group, key in enumerate(curves.keys):
        own = np.flatnonzero(curves.group == group)
        if 0 < len(own) <= MOST_CLICKS:
            found[key] = np.concatenate([found.get(key, np.zeros(0)), values[own]])
    return found


def residuals_px(problem: Problem, state: State) -> dict[MarkingKey, float]:
    """Root mean square residual of each observed marking, pixels; nothing is left out.

    Pieces of a marking, and the point where another one ends on it, count together.
    """
    found = {key: _rms(values) for key, values in _residuals_by_marking(problem, state).items()}
    away_px = state.point_values[0].reshape(-1, 2) * problem.points.sigmas_px
    found.update(zip(problem.points.keys, np.linalg.norm(away_px, axis=1).tolist(), strict=True))
    return found


def bulk_residuals_px(problem: Problem, state: State) -> dict[MarkingKey, float]:
    """Root mean square residual of each observed line and curve, pixels, without the few points that lie far off all
    others, since they were measured on something in front of the paint.
    """
    return {key: _rms(_bulk(values)) for key, values in _residuals_by_marking(problem, state).items()}


def _residuals_by_marking(problem: Problem, state: State) -> dict[MarkingKey, Array]:
    """Signed distances (N,) of each line's and curve's points, pixels; all pieces of it together."""
    curves, values = problem.curves, state.residuals[0] * problem.curves.sigma_px
    first = np.array([curves.keys.index(key) for key in curves.keys], dtype=np.int_)
    marking = first[curves.group]
    return {curves.keys[k]: values[marking == k] for k in dict.fromkeys(first.tolist())}


def _bulk(values: Array) -> Array:
    """Residuals (M,) of those given (N,) without the largest ones that stand apart, M at least 97 % of N."""
    off = np.abs(values)
    kept = np.argsort(off)[: len(off) - int(STRAY_SHARE * len(off))]
    near = off <= STRAY_MEDIANS * float(median_of_rows(off))
    near[kept] = True
    return values[near]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
