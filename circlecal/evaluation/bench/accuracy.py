"""``circlecal bench accuracy``: the camera's error beside the Cramer-Rao bound on the same draws."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtri

from circlecal.errors import EstimationError
from circlecal.evaluation.bench.bounds import bound_covariance, bound_errors
from circlecal.evaluation.bench.joint_conic import joint_conic
from circlecal.evaluation.bench.many_frames import RigScenario, rig_scenarios, run_draw, select_rigs
from circlecal.evaluation.bench.reprojection import grid_in_view, mean_reprojection_error
from circlecal.evaluation.bench.scenarios import Draw, Scenario, row_names, select_rows, soccer
from circlecal.field import Circle
from circlecal.geometry.camera import Camera
from circlecal.geometry.concentric import imaged_center
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.homography import dlt, turn_homography
from circlecal.geometry.projective import Array, apply_homography, fit_line, transform_lines
from circlecal.results import CameraFit, Correspondences
from circlecal.stages.camera import estimate_camera
from circlecal.stages.correspondences import correspondences_from_line, correspondences_from_point
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.markings import circle_points, line_points

WRONG_PX = 20.0
"""Mean error beyond which an answer counts as wrong, pixels at 1920 px width."""
BOUND_DRAWS = 16
"""Errors that are drawn at the bound for each truth."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; errors are mean reprojection errors in pixels at 1920 x 1080.

    ``efficiency`` is the mean error over that of the bound, with its standard error; ``wrong`` is a share of the
    answered frames, ``failed`` of all; ``coverage`` is by what the reported 90 % regions are of; ``by_offset`` are
    medians by how far the camera stands from the plane of the halfway line, metres; ``ms`` is the median time of an
    estimate.
    """

    row: str
    title: str
    draws: int
    median_px: float
    p90_px: float
    bound_median_px: float
    bound_p90_px: float
    efficiency: float
    efficiency_error: float
    wrong: float
    failed: float
    reach_median_px: float
    reach_p90_px: float | None
    coverage: dict[str, float]
    by_offset: dict[str, float]
    ms: float


def run_rows(
    names: Sequence[str], draws: int, seed: int, advance: Callable[[str], None] = lambda _: None
) -> tuple[list[Row], list[tuple[str, float]]]:
    """Run the named rows (all where none is named).

    Returns
    -------
    list of Row
        The camera's rows.
    list of (str, float)
        The closed forms: noise-free maximum (row 1) and the paper's protocol with the true centre (row 2), pixels.
    """
    rows = [run_row(s, draws, seed, advance) for s in select_rows(names)]
    rows += [run_rig_row(s, draws, seed, advance) for s in select_rigs(names)]
    closed = closed_forms(draws, seed) if not names or {"1", "2"} & set(names) else []
    return rows, closed


def all_row_names() -> list[str]:
    """Names of rows that can be asked for."""
    return [*row_names(), *(s.row for s in rig_scenarios())]


def run_row(scenario: Scenario, draws: int, seed: int, advance: Callable[[str], None] = lambda _: None) -> Row:
    """Error, bound and coverage of one scenario over seeded draws."""
    errors, bounds, offsets, times = [], [], [], []
    means: list[float] = []
    inside: dict[str, list[bool]] = {}
    for index in range(draws):
        rng = np.random.default_rng([seed, index])
        draw = scenario.draw(rng)
        grid = grid_in_view(draw.camera, scenario.template)
        covariance = bound_covariance(
            draw.camera, draw.crown_m, draw.observations, scenario.template, scenario.circle, draw.config
        )
        bound = bound_errors(draw.camera, covariance, grid, BOUND_DRAWS, rng)
        bounds.append(bound)
        means.append(float(bound.mean()))
        offsets.append(abs(float(draw.camera.position_m[0])))
        start = time.perf_counter()
        try:
            fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
        except EstimationError:
            errors.append(np.inf)
            continue
        finally:
            times.append(time.perf_counter() - start)
            advance(scenario.row)
        errors.append(mean_reprojection_error(draw.camera.homography, fit.H_image_field, grid))
        for name, value in mahalanobis(draw, fit, scenario.circle).items():
            inside.setdefault(name, []).append(value)
    of_draw = np.array(errors), np.array(means)
    return _row(scenario, draws, errors, bounds, offsets, inside, of_draw, times)


def run_rig_row(scenario: RigScenario, draws: int, seed: int, advance: Callable[[str], None] = lambda _: None) -> Row:
    """Rows for frames of one camera that are calibrated together; each draw is one camera."""
    _, circle = soccer()
    found = []
    inside: dict[str, list[bool]] = {}
    for index in range(draws):
        rng = np.random.default_rng([seed, index])
        drawn = run_draw(scenario, rng, BOUND_DRAWS)
        found.append(drawn)
        for draw, fit in zip(drawn.draws, drawn.fits, strict=True):
            for name, value in mahalanobis(draw, fit, circle).items() if fit is not None else ():
                inside.setdefault(name, []).append(value)
        advance(scenario.row)
    # frames of one camera err together: a draw of the ratio is a camera
    of_camera = np.array([np.mean(d.errors) for d in found]), np.array([np.mean(d.bounds) for d in found])
    return _row(
        scenario,
        draws,
        [e for drawn in found for e in drawn.errors],
        [b for drawn in found for b in drawn.bounds],
        [abs(float(draw.camera.position_m[0])) for drawn in found for draw in drawn.draws],
        inside,
        of_camera,
        [drawn.seconds for drawn in found],
    )


def _row(
    scenario: Scenario | RigScenario,
    draws: int,
    errors: Sequence[float],
    bounds: Sequence[Array],
    offsets: Sequence[float],
    inside: dict[str, list[bool]],
    independent: tuple[Array, Array],
    seconds: Sequence[float],
) -> Row:
    """Figures of all frames; ``independent`` are mean errors and bounds of draws that do not depend on each other."""
    error, pooled = np.array(errors), np.concatenate(bounds)
    answered = np.isfinite(error)
    whole = np.isfinite(independent[0])
    ratio, spread = _ratio(independent[0][whole], independent[1][whole])
    return Row(
        row=scenario.row,
        title=scenario.title,
        draws=draws,
        median_px=float(np.median(error)),
        p90_px=float(np.percentile(error, 90)),
        bound_median_px=float(np.median(pooled)),
        bound_p90_px=float(np.percentile(pooled, 90)),
        efficiency=ratio,
        efficiency_error=spread,
        wrong=float(np.mean(error[answered] > WRONG_PX)) if answered.any() else 0.0,
        failed=float(1.0 - answered.mean()),
        reach_median_px=scenario.reach_px[0],
        reach_p90_px=scenario.reach_px[1],
        coverage={name: float(np.mean(values)) for name, values in inside.items()},
        by_offset=_by_offset(np.array(offsets), error),
        ms=float(np.median(seconds) * 1e3),
    )


def _ratio(errors: Array, bounds: Array) -> tuple[float, float]:
    """Mean error over mean bound and the standard error of it (delta method)."""
    ratio = float(errors.mean() / bounds.mean())
    deviation = errors - ratio * bounds
    return ratio, float(deviation.std() / np.sqrt(len(errors)) / bounds.mean())


def _by_offset(offsets: Array, errors: Array) -> dict[str, float]:
    edges = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 25.0]
    found = {}
    for low, high in pairwise(edges):
        chosen = (offsets >= low) & (offsets < high)
        if chosen.any():
            found[f"{low:g}-{high:g} m"] = float(np.median(errors[chosen]))
    return found


def mahalanobis(draw: Draw, fit: CameraFit, circle: Circle) -> dict[str, bool]:
    """Whether the truth lies inside the reported 90 % region of the homography, the imaged centre, a derived point
    and the position.
    """
    H = draw.camera.homography
    center = np.asarray(circle.center)
    position = slice(4, 7)
    found = {
        "homography": _is_in_region(fit, H),
        "imaged centre": _is_inside(apply_homography(H, center) - fit.imaged_center_px, fit.imaged_center_covariance),
        "position": _is_inside(draw.camera.position_m - fit.camera.position_m, fit.covariance[position, position]),
    }
    surface = replace(fit.surface, crown_m=draw.crown_m)
    for point in fit.derived_points:
        true = draw.camera.project(surface.lift(point.field_m), distort=False)
        found[f"point {point.label}"] = _is_inside(true - point.image_px, point.covariance)
    return found


def _is_in_region(fit: CameraFit, H: Array) -> bool:
    return fit.region is not None and fit.region.distance(H) < chdtri(fit.region.directions, 0.1)


def _is_inside(difference: Array, covariance: Array) -> bool:
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    # what is fixed has no spread
    kept = values > 1e-6 * values[-1]
    projected = vectors[:, kept].T @ (difference / scale)
    return bool(np.sum(projected**2 / values[kept]) < chdtri(int(kept.sum()), 0.1))


def closed_forms(draws: int, seed: int) -> list[tuple[str, float]]:
    """Rows 1 and 2: largest error without noise, and the paper's protocol with the true centre."""
    worst = {"case 1": 0.0, "case 2": 0.0, "case 3": 0.0}
    paper: dict[str, list[float]] = {}
    template, circle = soccer()
    for index in range(draws):
        rng = np.random.default_rng([seed, index])
        camera = sample_camera("main", rng)
        H = camera.homography
        grid = grid_in_view(camera, template)
        o, direction = np.zeros(2), np.array([0.0, 1.0])
        outer = transform_conic(H, circle_conic(o, template.radius(circle, "outer")))
        inner = transform_conic(H, circle_conic(o, template.radius(circle, "inner")))
        line, center = transform_lines(H, [1.0, 0.0, 0.0]), H[:, 2]
        point = np.array([3.0, -5.0])
        found = {
            "case 1": correspondences_from_line(outer, center, line, o, circle.radius_m, direction),
            "case 2": correspondences_from_point(outer, center, apply_homography(H, point), point, o, circle.radius_m),
        }
        concentric = imaged_center(outer, inner)
        if concentric is None:
            raise ValueError("two exact edges have no imaged centre")
        found["case 3"] = correspondences_from_line(outer, concentric.center, line, o, circle.radius_m, direction)
        for name, correspondences in found.items():
            worst[name] = max(worst[name], _error(correspondences, H, grid))
        for name, error in _paper_protocol(camera, H, line, center, grid, rng).items():
            paper.setdefault(name, []).append(error)
    rows = [(f"1: {name}, no noise, largest error", value) for name, value in worst.items()]
    return [
        *rows,
        *((f"2: case 1, true centre, sigma 1, {name}, median", float(np.median(v))) for name, v in paper.items()),
    ]


def _paper_protocol(
    camera: Camera, H: Array, line: Array, center: Array, grid: Array, rng: np.random.Generator
) -> dict[str, float]:
    """Case 1 with the true centre from 8 noisy points per edge: as the paper has it, and from both edges together."""
    template, circle = soccer()
    phase = float(rng.uniform())
    outer, inner = (
        circle_points(camera, template, e, 8, 1.0, rng, "field", phase=phase).points_px for e in ("outer", "inner")
    )
    ends = fit_line(line_points(camera, template, "halfway_line", 2, 1.0, rng).points_px)
    radii = template.radius(circle, "outer"), template.radius(circle, "inner")
    conics = {"outer edge": fit_conic(outer, "direct"), "both edges": joint_conic(outer, inner, center, *radii)}
    errors = {}
    for name, conic in conics.items():
        for told, image_line in (("line exact", line), ("line noisy", ends)):
            found = (
                None
                if conic is None
                else correspondences_from_line(
                    conic, center, image_line, np.zeros(2), circle.radius_m, np.array([0.0, 1.0])
                )
            )
            errors[f"{name}, {told}"] = np.inf if found is None else _error(found, H, grid)
    return errors


def _error(found: Correspondences, H: Array, grid: Array) -> float:
    solution = dlt(
        [p.field_m for p in found.points],
        [p.image_px for p in found.points],
        [t.field_line for t in found.tangents],
        [t.image_line for t in found.tangents],
    )
    if solution is None:
        return np.inf
    turned = turn_homography(solution.H, np.zeros(2))
    return min(mean_reprojection_error(H, solution.H, grid), mean_reprojection_error(H, turned, grid))


def as_records(rows: Sequence[Row]) -> list[dict[str, object]]:
    """JSON-ready rows."""
    return [asdict(row) for row in rows]
