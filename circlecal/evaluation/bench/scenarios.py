"""The scenarios of ``circlecal bench accuracy``: what is drawn, what is known, and what is to be reached."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from circlecal.camera.options import CameraConfig, usual_kappa
from circlecal.field import Circle, FieldTemplate, load_field
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.surface import FLAT, Surface
from circlecal.observations import CircleEdge, CirclePoints, Observations
from circlecal.solvers.circlecal import KNOWN_OPTICS
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.markings import Spacing, circle_points, line_points
from circlecal.synthetic.views import CameraProfile

KNOWN = KNOWN_OPTICS
"""Principal point, lens and surface known: the bound is one number."""

BROADCAST = KNOWN.model_copy(
    update={"position_m": (0.0, 62.0, -16.0), "position_sd_m": (8.0, 13.0, 5.0), "roll_sd_deg": 1.0}
)
"""Where main cameras stand, as a broadcaster would state it: on the halfway line, in the main stand."""

PRIORS = KNOWN.model_copy(
    update={
        "principal_point_sd_px": 5.0,
        "distortion": "radial",
        "crown_shape": "roof",
        "distance_log_sd": None,
        "elevation_sd_deg": None,
    }
)
"""The default priors of principal point, lens and crown; none on the camera's place."""


@dataclass(frozen=True, slots=True)
class Draw:
    """One truth with its noisy observations, and what the estimator is told of the position (mean, sd) where that is
    known.
    """

    camera: Camera
    observations: Observations
    config: CameraConfig
    crown_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """One row: number, title, how a draw is made, the figures to reach (median, 90th percentile, px; infinite and None
    where none is set), and the field and circle that the estimator is told.
    """

    row: str
    title: str
    draw: Callable[[np.random.Generator], Draw]
    reach_px: tuple[float, float | None]
    template: FieldTemplate
    circle: Circle


@cache
def soccer() -> tuple[FieldTemplate, Circle]:
    """Soccer with a marking of 8 cm, the paper's."""
    template = load_field("soccer", {"marking": 0.08})
    return template, template.circle_by_name["centre_circle"]


@cache
def hockey() -> tuple[FieldTemplate, Circle]:
    """Ice hockey and one of its face-off circles, painted without error: the rows are about noise in the picture."""
    template = load_field("ice-hockey").model_copy(update={"placement_sd_m": 0.0})
    return template, template.circle_by_name["faceoff_left_top"]


def _soccer_draw(
    profile: CameraProfile,
    count: int,
    sigma_px: float,
    *,
    edges: tuple[CircleEdge, ...] = ("outer", "inner"),
    line_count: int | None = None,
    arc_deg: float | None = None,
    config: CameraConfig = KNOWN,
    position_sd_m: float | None = None,
    principal_point_sd_px: float = 0.0,
    kappa: float = 0.0,
    spacing: Spacing = "image",
    from_priors: bool = False,
) -> Callable[[np.random.Generator], Draw]:
    template, _ = soccer()

    def draw(rng: np.random.Generator) -> Draw:
        camera = sample_camera(profile, rng, arc_deg=arc_deg, kappa=kappa)
        surface = FLAT
        if from_priors:
            usual = usual_kappa(config, float(camera.focal_px[0]) / camera.width)
            camera = replace(camera, kappa=np.array([rng.normal(usual, config.k1_sd), 0.0]))
            surface = Surface("roof", crown_m=float(rng.normal(config.crown_m, config.crown_sd_m)))
        if principal_point_sd_px:
            shift = rng.normal(0.0, principal_point_sd_px, 2)
            camera = replace(camera, principal_point_px=camera.principal_point_px + shift)
        phase = float(rng.uniform(0.0, 1.0))
        circles: tuple[CirclePoints, ...] = tuple(
            circle_points(camera, template, edge, count, sigma_px, rng, spacing, surface=surface, phase=phase)
            for edge in edges
        )
        lines = (
            ()
            if line_count == 0
            else (line_points(camera, template, "halfway_line", line_count or count, sigma_px, rng, surface=surface),)
        )
        told = config
        if position_sd_m is not None:
            mean = camera.position_m + rng.normal(0.0, position_sd_m, 3)
            told = config.model_copy(update={"position_m": tuple(mean), "position_sd_m": (position_sd_m,) * 3})
        return Draw(camera, Observations(camera.width, camera.height, circles, lines), told, surface.crown_m)

    return draw


FACEOFF_PAIR = ("faceoff_left_top", "faceoff_left_bottom")


def faceoff_camera(rng: np.random.Generator) -> Camera:
    """A camera that shows the two face-off circles of one end."""
    template, _ = hockey()
    middle = np.mean([template.circle_by_name[name].center for name in FACEOFF_PAIR], axis=0)
    distance, height = rng.uniform(30, 60), rng.uniform(8, 20)
    azimuth = rng.uniform(-0.6, 0.6)
    ground = np.sqrt(distance**2 - height**2)
    position = np.r_[middle + ground * np.array([np.sin(azimuth), np.cos(azimuth)]), -height]
    look = np.r_[middle, 0.0] - position
    look = look / np.linalg.norm(look)
    angles = np.array([np.arctan2(look[0], -look[1]), np.arccos(look[2]), np.radians(rng.normal())])
    focal = rng.uniform(0.6, 0.8) * 540.0 / ((7.0 + 4.5) * height / distance) * distance
    focal = min(focal, 900.0 / 5.5 * distance)
    return Camera(1920, 1080, np.array([focal, focal]), image_center(1920, 1080), angles, position, np.zeros(2))


def _hockey_draw(count: int, sigma_px: float) -> Callable[[np.random.Generator], Draw]:
    template, _ = hockey()

    def draw(rng: np.random.Generator) -> Draw:
        camera = faceoff_camera(rng)
        circles = tuple(
            circle_points(camera, template, "outer", count, sigma_px, rng, circle=name) for name in FACEOFF_PAIR
        )
        return Draw(camera, Observations(1920, 1080, circles), KNOWN)

    return draw


def scenarios() -> list[Scenario]:
    """All rows, in order."""
    template, circle = soccer()
    rink, faceoff = hockey()
    default = KNOWN.model_copy(
        update={
            "principal_point_sd_px": 5.0,
            "distortion": "radial",
            "k1_mean": 0.0,
            "crown_shape": "roof",
            "crown_m": 0.0,
        }
    )
    eight = partial(_soccer_draw, "main", 8, line_count=2, spacing="field")

    def row(
        number: str, title: str, draw: Callable[[np.random.Generator], Draw], median: float, p90: float | None = None
    ) -> Scenario:
        return Scenario(number, title, draw, (median, p90), template, circle)

    return [
        row("3", "8 points per edge, unknown centre, sigma 1", eight(1.0), 5.5),
        row("4a", "the same, sigma 5, broadcast priors", eight(5.0, config=BROADCAST), 12.0),
        row("4b", "the same, sigma 25, broadcast priors", eight(25.0, config=BROADCAST), 30.0),
        row("5", "full circle, 200 points per edge, sigma 0.5", _soccer_draw("main", 200, 0.5), 0.5, 3.0),
        row(
            "5d",
            "the same, lens and crown of the defaults, principal point to 5 px",
            _soccer_draw("main", 200, 0.5, config=default),
            np.inf,
        ),
        row("6", "the same as 5, one edge only", _soccer_draw("main", 200, 0.5, edges=("outer",)), 0.65, 4.5),
        row("7", "40-80 % of the circle, sigma 0.5", _soccer_draw("partial", 200, 0.5), 1.5, 7.0),
        row("8a", "arc of 120 degrees, sigma 0.3", _soccer_draw("arc", 200, 0.3, arc_deg=120.0), 2.5),
        row("8b", "arc of 90 degrees, sigma 0.3", _soccer_draw("arc", 200, 0.3, arc_deg=90.0), 2.7),
        row("8c", "arc of 60 degrees, sigma 0.3", _soccer_draw("arc", 200, 0.3, arc_deg=60.0), 2.75),
        row(
            "9a",
            "position known to 0.5 m, full circle, sigma 1",
            _soccer_draw("main", 200, 1.0, position_sd_m=0.5),
            0.5,
            1.2,
        ),
        row(
            "9b",
            "position known to 0.5 m, 120 degrees, sigma 1",
            _soccer_draw("arc", 200, 1.0, arc_deg=120.0, position_sd_m=0.5),
            1.3,
            3.3,
        ),
        row(
            "13a",
            "principal point off by 10 px, estimated",
            _soccer_draw(
                "main",
                200,
                0.5,
                principal_point_sd_px=10.0,
                config=KNOWN.model_copy(update={"principal_point_sd_px": 10.0}),
            ),
            1.45,
        ),
        row(
            "13b",
            "radial k1 = 0.005 (half diagonals), estimated",
            _soccer_draw("main", 200, 0.5, kappa=0.0038, config=_radial(0.0038)),
            1.3,
        ),
        row(
            "13c",
            "radial kappa = 0.03 (half-widths), estimated",
            _soccer_draw("main", 200, 0.5, kappa=0.03, config=_radial(0.0038, 0.03)),
            1.3,
        ),
        row(
            "12",
            "lens, crown and principal point drawn from their priors",
            _soccer_draw("main", 200, 0.5, config=PRIORS, principal_point_sd_px=5.0, from_priors=True),
            np.inf,
        ),
        row("g", "cameras 25-40 m high, sigma 0.5", _soccer_draw("high", 200, 0.5), np.inf),
        row("w", "cameras within 25 m of the halfway line, sigma 0.5", _soccer_draw("wide", 200, 0.5), np.inf),
        row("h", "low and near cameras, roll 3 degrees, sigma 0.5", _soccer_draw("hard", 200, 0.5), np.inf),
        Scenario(
            "17",
            "two hockey face-off circles, 50 points, sigma 0.3",
            _hockey_draw(50, 0.3),
            (0.225 * 1.05, None),
            rink,
            faceoff,
        ),
    ]


def _radial(sd: float, mean: float = 0.0) -> CameraConfig:
    return KNOWN.model_copy(update={"distortion": "radial", "k1_mean": mean, "k1_sd": sd})


def select_rows(names: Sequence[str]) -> list[Scenario]:
    """The scenarios of the named rows (``8`` stands for 8a, 8b and 8c); all where none is named."""
    return [s for s in scenarios() if not names or s.row in names or s.row.rstrip("abcd") in names]


def row_names() -> list[str]:
    """Names that can be asked for: every scenario, and the closed forms of rows 1 and 2."""
    return ["1", "2", *dict.fromkeys(name for s in scenarios() for name in (s.row.rstrip("abcd"), s.row))]
