"""Frames without the circle: other parts of the field, close-ups, graphics, other sports. They must be refused unless
their straight lines determine the camera, as those of a penalty area may.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from circlecal.field import FieldTemplate, load_field
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import FLAT, Surface
from circlecal.synthetic.cameras import (
    aim_camera,
    halfway_length_px,
    inside_frame,
    other_markings,
    visible_circle_deg,
)
from circlecal.synthetic.decals import Decal, floor_decals, rink_decals
from circlecal.synthetic.floors import (
    BLACK,
    RED,
    WHITE,
    YELLOW,
    Element,
    basketball_lines,
    handball_lines,
    rink_paint,
    rugby_lines,
    tennis_lines,
    volleyball_lines,
)
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.scene import Color, ExtraPaint, Graphics, Player, RenderConfig, Scene, sample_player

NegativeKind = Literal[
    "penalty_area",
    "corner",
    "goal_mouth",
    "behind_net",
    "crowd",
    "close_up",
    "grass",
    "wipe",
    "board",
    "rugby",
    "tennis",
    "basketball",
    "handball",
    "volleyball",
    "ice_hockey",
]
NEGATIVE_KINDS: tuple[str, ...] = get_args(NegativeKind)

_SHARES = (0.18, 0.05, 0.08, 0.05, 0.08, 0.1, 0.1, 0.07, 0.05, 0.05, 0.05, 0.05, 0.04, 0.02, 0.03)
_TRIES = 400
_LOOKS = ("broadcast", "broadcast", "hard", "shade", "worn", "graphics", "colours", "night", "haze", "blur")
_HALL_FLOORS: tuple[Color, ...] = ((120, 172, 210), (96, 146, 190), (150, 186, 212), (140, 118, 80), (90, 116, 84))
_COURTS: tuple[Color, ...] = ((150, 100, 40), (84, 120, 70), (64, 96, 168), (62, 128, 92))


def negative_scene(
    rng: np.random.Generator, size: tuple[int, int], template: FieldTemplate, kind: NegativeKind | None = None
) -> Scene:
    """A random scene of a kind, or of any: the kinds are drawn by how often a match's video shows them."""
    chosen = kind or NEGATIVE_KINDS[rng.choice(len(NEGATIVE_KINDS), p=np.asarray(_SHARES) / sum(_SHARES))]
    if chosen in _SPORTS:
        return _other_sport(chosen, rng, size)
    radius_m = template.circle_by_name[template.default_circle].radius_m
    surface = Surface("roof", radius_m, float(rng.uniform(0.02, 0.09)))
    shown = chosen if chosen in _AIMS else str(rng.choice(("penalty_area", "crowd", "close_up", "goal_mouth")))
    camera = _view_without_circle(shown, rng, size, template, surface)
    config = sample_config(_LOOKS[rng.integers(len(_LOOKS))], rng, size[0])
    players: tuple[Player, ...] = ()
    if shown == "close_up":
        players = _large_players(camera, surface, rng)
        config = config.model_copy(update={"defocus_px": config.defocus_px * float(rng.uniform(1.0, 3.0))})
    elif shown not in ("crowd", "behind_net") or rng.random() < 0.5:
        players = _players(camera, template, surface, int(rng.integers(0, 14)), rng)
    graphics: dict[str, Any] = {}
    if chosen == "wipe":
        graphics = {"wipe": float(rng.uniform(0.3, 0.8))}
    elif chosen == "board":
        graphics = {"board": True}
    if graphics:
        config = config.model_copy(update={"graphics": Graphics(**graphics)})
    return Scene(camera, template, surface, config, players, kind=chosen)


def _penalty_area(rng: np.random.Generator, half: Array) -> tuple[Array, Array, float]:
    side = rng.choice((-1.0, 1.0))
    target = np.array([side * half[0] * rng.uniform(0.72, 0.95), rng.uniform(-0.5, 0.4) * half[1], 0.0])
    return _main_stand(rng, half), target, rng.uniform(2000, 5500)


def _corner(rng: np.random.Generator, half: Array) -> tuple[Array, Array, float]:
    sides = rng.choice((-1.0, 1.0), 2)
    target = np.array([*(sides * half * rng.uniform(0.85, 1.0, 2)), 0.0])
    return _main_stand(rng, half), target, rng.uniform(3000, 9000)


def _goal_mouth(rng: np.random.Generator, half: Array) -> tuple[Array, Array, float]:
    side = rng.choice((-1.0, 1.0))
    target = np.array([side * half[0] * rng.uniform(0.93, 1.02), rng.uniform(-6, 6), -1.0])
    return _main_stand(rng, half), target, rng.uniform(5000, 12000)


def _behind_net(rng: np.random.Generator, half: Array) -> tuple[Array, Array, float]:
    side = rng.choice((-1.0, 1.0))
    position = np.array([side * (half[0] + rng.uniform(4, 25)), rng.uniform(-8, 8), -rng.uniform(2.0, 9.0)])
    target = np.array([side * (half[0] - rng.uniform(0, 14)), rng.uniform(-4, 4), 0.0])
    return position, target, rng.uniform(900, 2600)


def _crowd(rng: np.random.Generator, half: Array) -> tuple[Array, Array, float]:
    target = np.array([rng.uniform(-40, 40), -half[1] - 6, -rng.uniform(3, 9)])
    return _main_stand(rng, half), target, rng.uniform(3000, 8000)


def _close_up(rng: np.random.Generator, half: Array) -> tuple[Array, Array, float]:
    target = np.array([*(rng.uniform(-0.9, 0.9, 2) * half), -rng.uniform(0.5, 1.4)])
    position = _main_stand(rng, half)
    if rng.random() < 0.5:
        position[2] = -rng.uniform(1.2, 3.0)
        position[1] = half[1] + rng.uniform(2, 6)
    return position, target, rng.uniform(9000, 22000)


def _grass(rng: np.random.Generator, half: Array) -> tuple[Array, Array, float]:
    target = np.array([*(rng.uniform(-0.9, 0.9, 2) * half), 0.0])
    return _main_stand(rng, half), target, rng.uniform(3500, 18000)


def _main_stand(rng: np.random.Generator, half: Array) -> Array:
    return np.array([rng.uniform(-12, 12), half[1] + rng.uniform(20, 50), -rng.uniform(10, 25)])


_AIMS: dict[str, Callable[[np.random.Generator, Array], tuple[Array, Array, float]]] = {
    "penalty_area": _penalty_area,
    "corner": _corner,
    "goal_mouth": _goal_mouth,
    "behind_net": _behind_net,
    "crowd": _crowd,
    "close_up": _close_up,
    "grass": _grass,
}


def _view_without_circle(
    kind: str, rng: np.random.Generator, size: tuple[int, int], template: FieldTemplate, surface: Surface
) -> Camera:
    half = np.array([template.length_m, template.width_m]) / 2
    kappa = float(rng.uniform(0.0, 0.055))
    for _ in range(_TRIES):
        position, target, focal = _AIMS[kind](rng, half)
        roll = float(rng.normal(0, 0.015))
        camera = aim_camera(position, target, focal * size[0] / 1920.0, roll, *size, kappa)
        if visible_circle_deg(camera, template, surface, margin_px=-4.0) > 0:
            continue
        if kind not in ("grass", "close_up") or not _sees_markings(camera, template, surface):
            return camera
    raise ValueError(f"no view of kind {kind!r} without the circle was found")


def _sees_markings(camera: Camera, template: FieldTemplate, surface: Surface) -> bool:
    pixels = camera.project(surface.lift(other_markings(template)))
    return (
        bool(inside_frame(pixels, camera.width, camera.height).any())
        or halfway_length_px(camera, template, surface) > 0
    )


def _players(
    camera: Camera, template: FieldTemplate, surface: Surface, count: int, rng: np.random.Generator
) -> tuple[Player, ...]:
    pixels = rng.uniform((0, 0), (camera.width, camera.height), (count, 2))
    field = camera.back_project(pixels, surface)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(field) < np.array([template.length_m, template.width_m]) / 2 + 2.0).all(axis=1)
    return tuple(sample_player(p, int(rng.choice(3, p=(0.47, 0.47, 0.06))), rng) for p in field[inside])


def _large_players(camera: Camera, surface: Surface, rng: np.random.Generator) -> tuple[Player, ...]:
    """One to four players whose bodies fill much of the height of the picture."""
    count = int(rng.integers(1, 5))
    pixels = rng.uniform((0.1, 0.6), (0.9, 1.25), (count, 2)) * (camera.width, camera.height)
    field = camera.back_project(pixels, surface)
    seen = np.isfinite(field).all(axis=1)
    return tuple(sample_player(p, int(rng.integers(2)), rng) for p in field[seen])


@dataclass(frozen=True, slots=True)
class _Sport:
    """A sport's floor: ``size_m`` of the place, its lines, where cameras stand and look, in metres."""

    size_m: tuple[float, float]
    lines: Callable[[], tuple[Element, ...]]
    distance_m: tuple[float, float]
    height_m: tuple[float, float]
    target_x: tuple[float, float]
    focal_px: tuple[float, float]
    line_m: float = 0.05
    from_end: bool = False


_SPORTS: dict[str, _Sport] = {
    "rugby": _Sport((110, 74), lambda: rugby_lines(100, 68), (55, 90), (10, 25), (0.0, 45.0), (1600, 4500), 0.1),
    "tennis": _Sport((34, 18), tennis_lines, (24, 36), (6, 12), (-2.0, 6.0), (1800, 3200), 0.05, from_end=True),
    "basketball": _Sport((32, 19), basketball_lines, (17, 28), (4, 11), (9.0, 13.0), (1500, 3600)),
    "handball": _Sport((44, 24), handball_lines, (20, 34), (4, 12), (11.0, 17.0), (1300, 3200)),
    "volleyball": _Sport((26, 17), volleyball_lines, (15, 26), (4, 9), (-3.0, 3.0), (1200, 2600)),
    "ice_hockey": _Sport((60, 30), lambda: (), (30, 48), (9, 18), (17.0, 24.0), (2200, 5200)),
}


def _other_sport(kind: str, rng: np.random.Generator, size: tuple[int, int]) -> Scene:
    sport = _SPORTS[kind]
    template = load_field("ice-hockey" if kind == "ice_hockey" else "futsal")
    template = template.model_copy(update={"length_m": sport.size_m[0], "width_m": sport.size_m[1]})
    for _ in range(_TRIES):
        side = rng.choice((-1.0, 1.0))
        target = np.array([side * rng.uniform(*sport.target_x), rng.uniform(-0.2, 0.2) * sport.size_m[1], 0.0])
        distance = rng.uniform(*sport.distance_m)
        position = np.array([rng.uniform(-0.2, 0.2) * sport.size_m[0], distance, -rng.uniform(*sport.height_m)])
        if sport.from_end:
            position = np.array([side * distance, rng.uniform(-1, 1), position[2]])
        focal = rng.uniform(*sport.focal_px) * size[0] / 1920.0
        camera = aim_camera(position, target, focal, float(rng.normal(0, 0.01)), *size, float(rng.uniform(-0.03, 0.03)))
        if kind in ("rugby", "tennis", "volleyball") or visible_circle_deg(camera, template, FLAT, -4.0) == 0:
            break
    else:
        raise ValueError(f"no view of {kind} without the circle was found")
    config = _floor_look(kind, sport, rng, size[0])
    lines = rink_paint(template, rng) if kind == "ice_hockey" else ()
    if kind != "ice_hockey":
        ink = WHITE if kind in ("rugby", "tennis") else (WHITE, WHITE, BLACK, YELLOW, RED)[rng.integers(5)]
        lines = (ExtraPaint(sport.lines(), sport.line_m, ink, float(rng.uniform(0.75, 0.95))),)
    players = _players(camera, template, FLAT, int(rng.integers(2, 12)), rng)
    return Scene(
        camera,
        template,
        FLAT,
        config,
        players,
        kind=kind,
        extras=lines,
        decals=_floor_decals(kind, template, rng),
        field_painted=kind == "ice_hockey",
    )


def _floor_decals(kind: str, template: FieldTemplate, rng: np.random.Generator) -> tuple[Decal, ...]:
    if kind == "ice_hockey":
        return rink_decals(template.length_m, rng)
    return floor_decals(rng) if kind in ("basketball", "handball", "volleyball") else ()


def _floor_look(kind: str, sport: _Sport, rng: np.random.Generator, width: int) -> RenderConfig:
    base = {"rugby": "broadcast", "tennis": "broadcast", "ice_hockey": "ice"}.get(kind, "wood")
    config = sample_config(base, rng, width)
    if kind == "tennis":
        court = _COURTS[rng.integers(len(_COURTS))]
        return config.model_copy(
            update={
                "turf_bgr": court,
                "stripe_contrast": 0.0,
                "board_distance_m": 0.5,
                "patchiness": 0.01,
                "shade": 0.0,
            }
        )
    if base == "wood":
        return config.model_copy(update={"turf_bgr": _HALL_FLOORS[rng.integers(len(_HALL_FLOORS))]})
    return config
