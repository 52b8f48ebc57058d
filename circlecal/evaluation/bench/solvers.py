"""``circlecal bench solvers``: every solver on every view, and the paper's statements that the runs do not confirm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from circlecal.evaluation.bench.reprojection import grid_in_view, mean_reprojection_error
from circlecal.evaluation.bench.scenarios import soccer
from circlecal.evaluation.bench.simulation import SimulationPlan, Summary, simulate, summarise
from circlecal.evaluation.bench.solver_scenarios import EDGES, select_scenarios
from circlecal.geometry.camera import Camera
from circlecal.geometry.conics import circle_conic, line_conic_meet, transform_conic
from circlecal.geometry.homography import dlt
from circlecal.geometry.projective import Array, apply_homography, join, lift
from circlecal.observations import Observations
from circlecal.solvers import load_intrinsics_solver, load_solver, solver_names
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.markings import circle_points

MOST_FAILED = 0.5
"""Share of draws without an answer from which on a line of errors is not called linear."""
FIGURE_NOISES_PX = (0.1, 1.0, 5.0, 25.0)
"""Noise levels of the paper's first figure at which its linearity is judged."""
LINEAR_WITHIN = 1.5
"""Largest error per pixel of noise over the smallest up to which errors follow the noise linearly."""
USEFUL_PX, USEFUL_FAILED = 10.0, 0.05
"""Median error, pixels at 1920 px width, and share without answer below which a method solves a view."""
VIEWS = 3
FOCAL_NOISES_PX = (0.0, 0.1, 1.0)


@dataclass(frozen=True, slots=True)
class FocalRow:
    """An intrinsics-only method: relative error of the focal length in per cent, and the share without answer."""

    method: str
    view: str
    noise_px: float
    draws: int
    median_percent: float | None
    failed: float


@dataclass(frozen=True, slots=True)
class Statement:
    """What the paper says, what the runs give, and whether the one confirms the other."""

    where: str
    says: str
    found: str
    confirmed: bool


def run_solvers(
    solvers: Sequence[str],
    scenarios: Sequence[str],
    draws: int,
    seed: int,
    workers: int = 1,
    advance: Callable[[str], None] = lambda _: None,
) -> list[Summary]:
    """Summary of each solver on each scenario at its usual noise; all where none is named.

    Raises
    ------
    ConfigError
        Unknown names.
    """
    for name in solvers:
        load_solver(name)
    names = tuple(s.name for s in select_scenarios(tuple(scenarios)))
    plan = SimulationPlan(tuple(solvers) or solver_names(), names, (None,), draws, seed)
    return summarise(simulate(plan, workers, advance))


def scenario_count(scenarios: Sequence[str]) -> int:
    """How many scenarios a run has."""
    return len(select_scenarios(tuple(scenarios)))


def run_focals(draws: int, seed: int, advance: Callable[[str], None] = lambda _: None) -> list[FocalRow]:
    """Focal length from three views of both edges of the marking, and from one view of them."""
    rows = []
    template, circle = soccer()
    for noise in FOCAL_NOISES_PX:
        errors: dict[tuple[str, str], list[float | None]] = {}
        for index in range(draws):
            rng = np.random.default_rng([seed, index])
            views, focal = _views_of_one_zoom(rng, noise)
            for method, given, label in (
                ("huang_concentric", views, "both edges, three views"),
                ("chen_wu", views[:1], "both edges, one view"),
            ):
                found = load_intrinsics_solver(method)(given, template, circle, rng)
                error = None if found.intrinsics is None else abs(float(found.intrinsics[0, 0]) / focal - 1.0) * 100.0
                errors.setdefault((method, label), []).append(error)
            advance("focal lengths")
        for (method, label), values in errors.items():
            answered = [v for v in values if v is not None]
            median = float(np.median(answered)) if answered else None
            rows.append(FocalRow(method, label, noise, draws, median, 1.0 - len(answered) / draws))
    return rows


def _views_of_one_zoom(rng: np.random.Generator, noise_px: float) -> tuple[list[Observations], float]:
    """Three main cameras with the focal length of the first, 50 points on each edge."""
    template, _ = soccer()
    cameras = [sample_camera("main", rng) for _ in range(VIEWS)]
    focal = cameras[0].focal_px
    views = []
    for camera in cameras:
        same = Camera(
            camera.width, camera.height, focal, camera.principal_point_px, camera.angles_rad, camera.position_m,
            camera.kappa,
        )  # fmt: skip
        edges = tuple(circle_points(same, template, edge, 50, noise_px, rng) for edge in EDGES)
        views.append(Observations(camera.width, camera.height, edges))
    return views, float(focal[0])


def paper_statements(
    draws: int, seed: int, workers: int = 1, advance: Callable[[str], None] = lambda _: None
) -> list[Statement]:
    """The paper's statements that these runs can judge, with the figures of this run."""
    plan = SimulationPlan(
        ("magera_case1", "magera_case3", "circlecal"),
        ("true_centre", "unknown_centre", "centre_noise"),
        FIGURE_NOISES_PX,
        draws,
        seed,
    )
    found = {(s.solver, s.scenario, s.noise_px): s for s in summarise(simulate(plan, workers, advance))}
    return [
        _linear_with(found, "magera_case1", "true_centre", "with the true centre"),
        _linear_with(found, "magera_case3", "unknown_centre", "with the eigenvector centre of an 8 cm marking"),
        _center_noise(found),
        _unknown_center(found),
        _paper_case_two(draws, seed),
    ]


def _linear_with(found: dict[tuple[str, str, float], Summary], solver: str, scenario: str, described: str) -> Statement:
    rows = [found[solver, scenario, noise] for noise in FIGURE_NOISES_PX]
    medians = [row.median_px for row in rows]
    text = ", ".join(
        f"{row.noise_px:g} px: {'none' if row.median_px is None else f'{row.median_px:.3g} px'}"
        + (f" ({row.failed:.0%} without answer)" if row.failed else "")
        for row in rows
    )
    per_px = [m / n for m, n in zip(medians, FIGURE_NOISES_PX, strict=True) if m is not None]
    linear = len(per_px) == len(rows) and max(per_px) < LINEAR_WITHIN * min(per_px)
    answered = all(row.failed < MOST_FAILED for row in rows)
    return Statement(
        "section 4.4, first figure",
        f"the error follows the noise on the ellipse points linearly, 0 to 25 px ({described})",
        text,
        linear and answered,
    )


def _center_noise(found: dict[tuple[str, str, float], Summary]) -> Statement:
    center, edges = found["magera_case1", "centre_noise", 1.0], found["magera_case1", "true_centre", 1.0]
    camera = found["circlecal", "centre_noise", 1.0]
    text = (
        f"1 px on the centre: {_px(center)} in case 1 (1 px on the edges: {_px(edges)}); "
        f"with a pinhole camera {_px(camera)}"
    )
    confirmed = center.median_px is not None and edges.median_px is not None and center.median_px > edges.median_px
    return Statement("section 4.4, second figure", "the error rises rapidly with noise on the centre", text, confirmed)


def _unknown_center(found: dict[tuple[str, str, float], Summary]) -> Statement:
    eigen, ours = found["magera_case3", "unknown_centre", 1.0], found["circlecal", "unknown_centre", 1.0]
    text = f"1 px: eigenvector {_px(eigen)} and {eigen.failed:.0%} without answer; pinhole camera {_px(ours)}"
    useful = ours.median_px is not None and ours.median_px < USEFUL_PX and ours.failed < USEFUL_FAILED
    return Statement(
        "sections 4.4 and 6",
        "views whose centre is not seen remain unsolved",
        text,
        not useful,
    )


def _paper_case_two(draws: int, seed: int) -> Statement:
    printed: list[float] = []
    corrected: list[float] = []
    template, circle = soccer()
    for index in range(draws):
        rng = np.random.default_rng([seed, index])
        camera = sample_camera("main", rng)
        H = camera.homography
        grid = grid_in_view(camera, template)
        conic = transform_conic(H, circle_conic(np.zeros(2), template.radius(circle, "outer")))
        point = np.array([3.0, -5.0])
        for matrix, errors in ((conic, printed), (np.asarray(np.linalg.inv(conic)), corrected)):
            estimate = _case_two(H, conic, matrix, point, template.radius(circle, "outer"))
            errors.append(np.inf if estimate is None else mean_reprojection_error(H, estimate, grid))
    lost = float(np.mean(~np.isfinite(printed)))
    finite = [e for e in printed if np.isfinite(e)]
    text = (
        f"without noise: as printed {f'{np.median(finite):.3g} px' if finite else 'no answer'} "
        f"({lost:.0%} without answer), with the inverse {max(corrected):.1g} px at most"
    )
    return Statement(
        "section 3.2", "v = E l1 is the vanishing point of the tangents", text, not lost and max(finite) < 1
    )


def _case_two(H: Array, conic: Array, matrix: Array, point: Array, radius: float) -> Array | None:
    """Case 2 with a given matrix in ``v = matrix l1``: four points by the DLT, the right order taken from the truth."""
    center = H[:, 2] / H[2, 2]
    line = join(lift(apply_homography(H, point)), center)
    second = line_conic_meet(conic, join(matrix @ line, center))
    first = line_conic_meet(conic, line)
    if first is None or second is None:
        return None
    along = point / np.linalg.norm(point)
    across = np.array([-along[1], along[0]])
    field, image = [], []
    for pair, direction in ((first, along), (second, across)):
        expected = apply_homography(H, radius * direction)
        nearer = int(np.argmin(np.linalg.norm(pair[:, :2] - expected, axis=1)))
        field += [radius * direction, -radius * direction]
        image += [pair[nearer, :2], pair[1 - nearer, :2]]
    solution = dlt(field, image)
    return None if solution is None else solution.H


def _px(summary: Summary) -> str:
    return "none" if summary.median_px is None else f"{summary.median_px:.3g} px"


def as_records(
    summaries: Sequence[Summary], focals: Sequence[FocalRow], statements: Sequence[Statement]
) -> dict[str, list[dict[str, object]]]:
    """JSON-ready tables."""
    return {
        "solvers": [asdict(s) for s in summaries],
        "focal_lengths": [asdict(f) for f in focals],
        "statements": [asdict(s) for s in statements],
    }
