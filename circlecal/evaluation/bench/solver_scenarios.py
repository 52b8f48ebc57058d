"""The views on which the solvers are compared: the paper's synthetic study, and those that it leaves out.

``noise_px`` is the standard deviation of the points of the circle's edges, of the lines and of the marks, except where
the view says otherwise. Every view is drawn with the paper's marking of 8 cm and radii to the outer edge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from circlecal.camera.options import CameraConfig
from circlecal.errors import ConfigError
from circlecal.evaluation.bench.scenarios import FACEOFF_PAIR, KNOWN, faceoff_camera, hockey, soccer
from circlecal.field import Circle, FieldTemplate, unit_circle
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.observations import CircleEdge, Keypoint, LinePoints, MarkPoint, Observations
from circlecal.synthetic.cameras import aim_camera, inside_frame, sample_camera
from circlecal.synthetic.markings import (
    MIN_SIGMA_PX,
    Spacing,
    add_outliers,
    circle_points,
    line_points,
    mark_point,
)
from circlecal.synthetic.views import CameraProfile

EDGES: tuple[CircleEdge, ...] = ("outer", "inner")
PAPER_POINTS, DENSE_POINTS = 8, 200
"""On each edge: in the paper's study, and as many as a detector gives."""
TRUE_WIDTH_M = 0.12
"""Of the paint in the view whose solvers are told the paper's 8 cm: the most that the Laws allow."""
LENS_KAPPA = 0.0038
"""Of half the width; 0.005 of half the diagonal."""
PRINCIPAL_POINT_SD_PX = 10.0
OUTLIERS = 0.3
LEAST_SIGMA_PX = 0.01
"""Told at least where no line is seen: the camera's fit then starts far from its end."""
_ATTEMPTS = 5000


@dataclass(frozen=True, slots=True)
class Seen:
    """What the solvers get, and what of it the Cramer-Rao bound counts (outliers bring no information)."""

    observations: Observations
    informative: Observations


@dataclass(frozen=True, slots=True)
class SolverScenario:
    """One kind of view.

    Attributes
    ----------
    name, title : str
        For options and tables.
    template, circle : FieldTemplate, Circle
        What the solvers are told of the field.
    camera : callable
        Draws a camera.
    observe : callable
        Draws what it sees under a noise in pixels.
    told : CameraConfig
        Model and priors of the bound: what is known of the optics.
    usual_noise_px : float
        Noise in the table of ``circlecal bench solvers``.
    """

    name: str
    title: str
    template: FieldTemplate
    circle: Circle
    camera: Callable[[np.random.Generator], Camera]
    observe: Callable[[Camera, float, np.random.Generator], Seen]
    told: CameraConfig = KNOWN
    usual_noise_px: float = 1.0


def _plain(observations: Observations) -> Seen:
    return Seen(observations, observations)


def _raise_sigmas(observations: Observations, least_px: float) -> Observations:
    """Observations with sigmas of at least ``least_px``."""
    return replace(
        observations,
        circles=tuple(replace(c, sigma_px=np.maximum(c.sigma_px, least_px)) for c in observations.circles),
    )


def _exact_mark(camera: Camera, noise_px: float, rng: np.random.Generator) -> MarkPoint:
    pixel = camera.project(np.zeros(2)) + noise_px * rng.standard_normal(2)
    return MarkPoint("centre_mark", pixel, max(noise_px, MIN_SIGMA_PX))


def _paper_view(
    camera: Camera,
    noise_px: float,
    rng: np.random.Generator,
    *,
    mark: bool,
    edges_noisy: bool = True,
    mark_noisy: bool = False,
) -> Seen:
    """Eight points per edge at equal angles of the field, the halfway line exact."""
    template, _ = soccer()
    phase = float(rng.random())
    noise = noise_px if edges_noisy else 0.0
    circles = tuple(
        circle_points(camera, template, edge, PAPER_POINTS, noise, rng, "field", phase=phase) for edge in EDGES
    )
    line = line_points(camera, template, "halfway_line", 2, 0.0, rng)
    marks = (_exact_mark(camera, noise_px if mark_noisy else 0.0, rng),) if mark else ()
    return _plain(Observations(camera.width, camera.height, circles, (line,), marks))


def _dense_view(
    camera: Camera,
    noise_px: float,
    rng: np.random.Generator,
    *,
    mark: bool = True,
    count: int = DENSE_POINTS,
    spacing: Spacing = "image",
    width_m: float | None = None,
    outliers: float = 0.0,
) -> Seen:
    """Many points on both edges and on the halfway line, and the centre mark where the frame shows it."""
    template, _ = soccer()
    clean = [circle_points(camera, template, edge, count, noise_px, rng, spacing, width_m) for edge in EDGES]
    lines: tuple[LinePoints, ...] = (line_points(camera, template, "halfway_line", count, noise_px, rng),)
    lines = tuple(line for line in lines if len(line.points_px) >= 2)
    seen_mark = mark_point(camera, template, "centre_mark", noise_px, rng) if mark else None
    marks = () if seen_mark is None else (seen_mark,)
    trusted = Observations(camera.width, camera.height, tuple(clean), lines, marks)
    if outliers == 0.0:
        return _plain(trusted)
    given, kept = [], []
    for points in clean:
        spoilt, inliers = add_outliers(points, outliers, rng)
        given.append(spoilt)
        kept.append(replace(spoilt, points_px=spoilt.points_px[inliers], sigma_px=spoilt.sigma_px[inliers]))
    return Seen(replace(trusted, circles=tuple(given)), replace(trusted, circles=tuple(kept)))


def _view_with_keypoints(camera: Camera, noise_px: float, rng: np.random.Generator, field_m: Array) -> Seen:
    seen = _paper_view(camera, noise_px, rng, mark=False).observations
    sigma = max(noise_px, MIN_SIGMA_PX)
    pixels = camera.project(field_m) + noise_px * rng.standard_normal((len(field_m), 2))
    found = tuple(
        Keypoint(f"point_{k}", point, pixel, sigma)
        for k, (point, pixel) in enumerate(zip(field_m, pixels, strict=True))
    )
    return _plain(replace(seen, keypoints=found))


def _known_point_view(camera: Camera, noise_px: float, rng: np.random.Generator) -> Seen:
    """The centre and one further point inside the circle, off the halfway line."""
    angle, distance = rng.uniform(0.0, 2 * np.pi), rng.uniform(3.0, 8.0)
    point = distance * np.array([np.cos(angle), np.sin(angle)])
    return _view_with_keypoints(camera, noise_px, rng, np.stack([np.zeros(2), point]))


def _keypoints_view(camera: Camera, noise_px: float, rng: np.random.Generator) -> Seen:
    """What a keypoint detector gives: the centre and eight points of the circle by name."""
    template, circle = soccer()
    angles = np.arange(8) * np.pi / 4
    rim = template.radius(circle, "outer") * unit_circle(angles)
    return _view_with_keypoints(camera, noise_px, rng, np.concatenate([np.zeros((1, 2)), rim]))


def _faceoff_view(camera: Camera, noise_px: float, rng: np.random.Generator) -> Seen:
    template, _ = hockey()
    circles = tuple(circle_points(camera, template, "outer", 50, noise_px, rng, circle=name) for name in FACEOFF_PAIR)
    return _plain(_raise_sigmas(Observations(camera.width, camera.height, circles), LEAST_SIGMA_PX))


def _wide_camera(rng: np.random.Generator) -> Camera:
    """A camera that shows the whole centre circle and the right penalty arc."""
    template, circle = soccer()
    arc = template.circle_by_name["penalty_arc_right"]
    angles = np.concatenate([np.linspace(0, 2 * np.pi, 60), np.radians(np.linspace(126.95, 233.05, 20))])
    centers = np.concatenate([np.tile(circle.center, (60, 1)), np.tile(arc.center, (20, 1))])
    rim = centers + 9.15 * unit_circle(angles)
    for _ in range(_ATTEMPTS):
        distance, height, x = rng.uniform(45, 90), rng.uniform(8, 25), rng.uniform(-12, 12)
        position = np.array([x, np.sqrt(distance**2 - height**2 - x**2), -height])
        target = np.array([rng.uniform(10, 26), rng.uniform(-6, 8), 0.0])
        camera = aim_camera(
            position, target, rng.uniform(1000, 2600), np.radians(np.clip(rng.normal(), -2.5, 2.5)), 1920, 1080
        )
        if inside_frame(camera.project(rim), 1920, 1080, 8.0).all():
            return camera
    raise RuntimeError("no camera shows circle and penalty arc")


def _circle_and_arc_view(camera: Camera, noise_px: float, rng: np.random.Generator) -> Seen:
    template, _ = soccer()
    angles = np.radians(np.linspace(126.95, 233.05, 50))
    arc = template.circle_by_name["penalty_arc_right"]
    points = np.asarray(arc.center) + arc.radius_m * unit_circle(angles)
    pixels = camera.project(points) + noise_px * rng.standard_normal((50, 2))
    circle = circle_points(camera, template, "outer", 200, noise_px, rng)
    second = replace(
        circle, circle=arc.name, points_px=pixels, sigma_px=np.full(len(pixels), max(noise_px, MIN_SIGMA_PX))
    )
    return _plain(_raise_sigmas(Observations(camera.width, camera.height, (circle, second)), LEAST_SIGMA_PX))


def _sample_shifted_camera(rng: np.random.Generator) -> Camera:
    camera = sample_camera("main", rng)
    return replace(camera, principal_point_px=camera.principal_point_px + rng.normal(0.0, PRINCIPAL_POINT_SD_PX, 2))


def _sampler(profile: CameraProfile, arc_deg: float | None = None, kappa: float = 0.0) -> Callable[..., Camera]:
    return partial(_sample, profile=profile, arc_deg=arc_deg, kappa=kappa)


def _sample(rng: np.random.Generator, profile: CameraProfile, arc_deg: float | None, kappa: float) -> Camera:
    return sample_camera(profile, rng, arc_deg=arc_deg, kappa=kappa)


PAPER_SCENARIOS = ("true_centre", "unknown_centre", "centre_noise")
"""The paper's first figure with either centre, and its second."""


@cache
def solver_scenarios() -> dict[str, SolverScenario]:
    """All of them by name."""
    template, circle = soccer()
    rink, faceoff = hockey()
    main = _sampler("main")

    def view(
        name: str,
        title: str,
        camera: Callable[[np.random.Generator], Camera],
        observe: Callable[..., Seen],
        noise_px: float = 1.0,
        told: CameraConfig = KNOWN,
    ) -> SolverScenario:
        return SolverScenario(name, title, template, circle, camera, observe, told, noise_px)

    lens = KNOWN.model_copy(update={"distortion": "radial", "k1_mean": 0.0, "k1_sd": LENS_KAPPA})
    optics = KNOWN.model_copy(update={"principal_point_sd_px": PRINCIPAL_POINT_SD_PX})
    found = [
        view("true_centre", "paper: 8 points per edge, true centre", main, partial(_paper_view, mark=True)),
        view("unknown_centre", "paper: 8 points per edge, unknown centre", main, partial(_paper_view, mark=False)),
        view(
            "centre_noise",
            "paper: exact edges, noise on the centre",
            main,
            partial(_paper_view, mark=True, edges_noisy=False, mark_noisy=True),
        ),
        view("known_point", "8 points per edge, centre and one point inside the circle", main, _known_point_view),
        view("keypoints", "8 points per edge, centre and 8 named points of the circle", main, _keypoints_view),
        view("dense", "200 points per edge, unknown centre", main, partial(_dense_view, mark=False), 0.5),
        view("dense_mark", "200 points per edge and centre mark", main, _dense_view, 0.5),
        view("partial", "40-80 % of the circle", _sampler("partial"), _dense_view, 0.5),
        view("arc_120", "arc of 120 degrees", _sampler("arc", 120.0), _dense_view, 0.3),
        view("arc_90", "arc of 90 degrees", _sampler("arc", 90.0), _dense_view, 0.3),
        view("arc_60", "arc of 60 degrees", _sampler("arc", 60.0), _dense_view, 0.3),
        view("low", "low and near cameras, roll 3 degrees", _sampler("hard"), _dense_view, 0.5),
        view(
            "wrong_width", "marking of 12 cm taken for 8 cm", main, partial(_dense_view, width_m=TRUE_WIDTH_M), 0.5
        ),
        view("lens", "radial distortion 0.0038", _sampler("main", kappa=LENS_KAPPA), _dense_view, 0.5, lens),
        view("principal_point", "principal point off by 10 px sd", _sample_shifted_camera, _dense_view, 0.5, optics),
        view("outliers", "30 % outliers", main, partial(_dense_view, outliers=OUTLIERS), 0.5),
        SolverScenario(
            "hockey_pair", "two hockey face-off circles, 50 points each", rink, faceoff, faceoff_camera, _faceoff_view,
            KNOWN, 0.3,
        ),
        view("circle_and_arc", "soccer's circle and penalty arc", _wide_camera, _circle_and_arc_view, 0.3),
    ]  # fmt: skip
    return {scenario.name: scenario for scenario in found}


def select_scenarios(names: tuple[str, ...]) -> list[SolverScenario]:
    """Scenarios by name; all where none is named.

    Raises
    ------
    ConfigError
        Unknown name.
    """
    known = solver_scenarios()
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ConfigError(f"--scenario: {', '.join(unknown)} is unknown; known: {', '.join(known)}")
    return [known[name] for name in names or known]
