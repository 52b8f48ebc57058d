"""Random scenes by profile: the view, the ground, the players and the look of the picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.geometry.homogeneous import Array
from circlecal.geometry.pinhole import Camera
from circlecal.synthetic.cameras import (
    CameraProfile,
    aimed_camera,
    halfway_length_px,
    inside_frame,
    other_markings,
    sample_camera,
    soccer,
    visible_circle_deg,
)
from circlecal.synthetic.figures import body_extent_px
from circlecal.synthetic.renderer import Rendering, render
from circlecal.synthetic.scene import Color, Player, RenderConfig, Scene, sample_player
from circlecal.synthetic.surface import Surface, back_project

SceneProfile = Literal["easy", "broadcast", "partial", "hidden_mark", "hard", "negative"]
SCENE_PROFILES: tuple[str, ...] = get_args(SceneProfile)

_NEGATIVE_TRIES = 400
_DEFOCUS_PX = {"easy": (0.4, 0.8), "hard": (0.8, 1.8)}
_TEAMS: tuple[Color, ...] = (
    (235, 235, 235),
    (45, 40, 190),
    (170, 70, 30),
    (225, 175, 110),
    (40, 40, 40),
    (40, 200, 235),
    (60, 150, 60),
    (120, 40, 100),
    (60, 110, 240),
)
_TURFS: tuple[Color, ...] = (
    (38, 112, 70),
    (22, 128, 92),
    (50, 120, 48),
    (44, 92, 58),
    (30, 100, 84),
    (62, 118, 92),
    (28, 84, 42),
    (20, 140, 104),
)


def sample_scene(
    profile: SceneProfile,
    rng: np.random.Generator,
    width: int = 1920,
    height: int = 1080,
    template: FieldTemplate | None = None,
) -> Scene:
    """A random scene.

    Parameters
    ----------
    profile : str
        ``"easy"``: the whole circle, the centre mark in view, little noise. ``"broadcast"``: the whole circle and much
        of the field, players everywhere. ``"partial"``: 40-80 % of the circle. ``"hidden_mark"``: a player in front of
        the centre mark, or no mark painted. ``"hard"``: low or near cameras, worn paint, blur, players on the circle.
        ``"negative"``: no circle in view: penalty area, crowd, or grass only.
    rng : Generator
        Randomness.
    width, height : int
        Picture size, pixels.
    template : FieldTemplate, optional
        Field; soccer if not given.

    Raises
    ------
    ValueError
        Unknown profile.
    """
    if profile not in SCENE_PROFILES:
        raise ValueError(f"unknown scene profile {profile!r}; known: {', '.join(SCENE_PROFILES)}")
    field = template or soccer()
    surface = _sample_surface(profile, field, rng)
    kappa = float(rng.uniform(0.0, 0.03) if profile == "easy" else rng.uniform(0.0, 0.055))
    camera = _sample_view(profile, rng, (width, height), field, kappa, surface)
    config = sample_config(profile, rng, width)
    players = players_in_view(profile, camera, field, surface, rng)
    painted = True
    if profile == "easy":
        players = _clear_of_mark(players, camera, field, surface)
    elif profile == "hidden_mark":
        painted = bool(rng.random() < 0.7)
        players = (*players, _in_front_of_mark(camera, field, rng)) if painted else players
    ball = _sample_ground(camera, field, surface, 1, rng)
    return Scene(
        camera, field, surface, config, players, ball[0] if len(ball) and profile != "hidden_mark" else None, painted
    )


def render_frame(
    profile: SceneProfile,
    rng: np.random.Generator,
    width: int = 1920,
    height: int = 1080,
    template: FieldTemplate | None = None,
) -> Rendering:
    """A random scene of a profile, rendered; the parameters are those of :func:`sample_scene`."""
    return render(sample_scene(profile, rng, width, height, template), rng)


def sample_config(profile: SceneProfile, rng: np.random.Generator, width: int = 1920) -> RenderConfig:
    """A random look: day or night, turf, wear, blur, noise; blur scales with the picture's width."""
    unit = width / 1920.0
    hard = profile == "hard"
    night = bool(rng.random() < 0.5)
    first, second = rng.choice(len(_TEAMS), 2, replace=False)
    turf = np.asarray(_TURFS[rng.integers(len(_TURFS))]) * rng.uniform(0.95, 1.2)
    white = rng.uniform(195, 235)
    return RenderConfig(
        marking_width_m=float(rng.uniform(0.1, 0.12) if profile == "easy" else rng.uniform(0.08, 0.12)),
        paint_bgr=(white - 4.0, white, white - 2.0),
        paint_opacity=float(rng.uniform(0.5, 0.85) if hard else rng.uniform(0.65, 0.95)),
        wear=float(rng.uniform(0.3, 0.8) if hard else rng.uniform(0.0, 0.35)),
        turf_bgr=(float(turf[0]), float(turf[1]), float(turf[2])),
        stripe_width_m=float(rng.uniform(4.5, 7.5)),
        stripe_contrast=float(rng.uniform(0.0, 0.1)),
        cross_stripes=bool(rng.random() < 0.2),
        texture=float(rng.uniform(0.01, 0.035)),
        patchiness=float(rng.uniform(0.01, 0.07)),
        shade=float(rng.uniform(0.25, 0.5)) if not night and rng.random() < 0.35 and profile != "easy" else 0.0,
        shade_edge_m=float(rng.uniform(-25, 20)),
        shade_tilt=float(rng.uniform(-0.4, 0.4)),
        vignette=float(rng.uniform(0.0, 0.2)),
        haze=float(rng.uniform(0.0, 0.2)),
        board_distance_m=float(rng.uniform(3.0, 6.0)),
        crowd_density=float(rng.uniform(0.3, 0.97)),
        stand_light=float(rng.uniform(0.3, 0.6) if night else rng.uniform(0.5, 0.95)),
        team_bgr=(_TEAMS[first], _TEAMS[second]),
        shadow_count=4 if night else 1,
        shadow_strength=float(rng.uniform(0.08, 0.18) if night else rng.uniform(0.2, 0.45)),
        shadow_length=float(rng.uniform(0.9, 1.6) if night else rng.uniform(0.5, 2.0)),
        shadow_rad=float(rng.uniform(0, 2 * np.pi)),
        defocus_px=float(unit * rng.uniform(*_DEFOCUS_PX.get(profile, (0.5, 1.1)))),
        motion_px=float(unit * rng.uniform(2.0, 7.0)) if hard and rng.random() < 0.5 else 0.0,
        motion_rad=float(rng.normal(0.0, 0.15)),
        sharpening=float(rng.uniform(0.0, 0.8)),
        noise=float(rng.uniform(1.5, 4.0) if hard else rng.uniform(0.6, 1.8)),
        jpeg_quality=int(rng.integers(60, 85) if hard else rng.integers(80, 95)),
        scorebug=bool(rng.random() < 0.4),
    )


def _sample_surface(profile: SceneProfile, template: FieldTemplate, rng: np.random.Generator) -> Surface:
    """Slopes of up to 1 % towards the touchlines, as fields are built; at most about a third of a metre of fall."""
    radius = template.circle_by_name[template.default_circle].radius_m
    if rng.random() < 0.7:
        return Surface(float(rng.uniform(0.0, 0.05) if profile == "easy" else rng.uniform(0.02, 0.09)), "roof", radius)
    return Surface(float(rng.uniform(0.0, 0.025)), "parabola", radius)


def _sample_view(
    profile: SceneProfile,
    rng: np.random.Generator,
    size: tuple[int, int],
    template: FieldTemplate,
    kappa: float,
    surface: Surface,
) -> Camera:
    if profile == "negative":
        return _sample_negative_view(rng, size, template, kappa, surface)
    wide_or_main: CameraProfile = "broadcast" if rng.random() < 0.6 else "main"
    views: dict[str, CameraProfile] = {"broadcast": "broadcast", "partial": "partial", "hard": "hard"}
    return sample_camera(views.get(profile, wide_or_main), rng, *size, template, kappa=kappa, surface=surface)


def _sample_negative_view(
    rng: np.random.Generator, size: tuple[int, int], template: FieldTemplate, kappa: float, surface: Surface
) -> Camera:
    """A view without the circle: 60 % penalty area, 20 % crowd, 20 % grass only."""
    kind = rng.choice(("penalty_area", "crowd", "grass"), p=(0.6, 0.2, 0.2))
    half_length, half_width = template.length_m / 2, template.width_m / 2
    for _ in range(_NEGATIVE_TRIES):
        position = np.array([rng.uniform(-12, 12), half_width + rng.uniform(20, 50), -rng.uniform(10, 25)])
        side = rng.choice((-1.0, 1.0))
        if kind == "penalty_area":
            target = np.array([side * half_length * rng.uniform(0.72, 0.95), rng.uniform(-0.5, 0.4) * half_width, 0.0])
            focal = rng.uniform(2000, 5500)
        elif kind == "crowd":
            target, focal = (
                np.array([rng.uniform(-40, 40), -half_width - 6, -rng.uniform(3, 9)]),
                rng.uniform(3000, 8000),
            )
        else:
            target = np.array([rng.uniform(-0.9, 0.9) * half_length, rng.uniform(-0.9, 0.9) * half_width, 0.0])
            focal = rng.uniform(6000, 18000)
        camera = aimed_camera(position, target, focal * size[0] / 1920.0, float(rng.normal(0, 0.015)), *size, kappa)
        if visible_circle_deg(camera, template, surface, margin_px=-4.0) > 0:
            continue
        if kind != "grass" or not _sees_markings(camera, template, surface):
            return camera
    raise ValueError("no view without the circle was found")


def _sees_markings(camera: Camera, template: FieldTemplate, surface: Surface) -> bool:
    pixels = camera.project(surface.lift(other_markings(template)))
    return (
        bool(inside_frame(pixels, camera.width, camera.height).any())
        or halfway_length_px(camera, template, surface) > 0
    )


def _sample_ground(
    camera: Camera, template: FieldTemplate, surface: Surface, count: int, rng: np.random.Generator
) -> Array:
    """Up to ``count`` field positions (K, 2) in the frame, evenly spread over the picture."""
    pixels = rng.uniform((0, 0), (camera.width, camera.height), (4 * count, 2))
    field = back_project(camera, surface, pixels)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(field) < np.array([template.length_m, template.width_m]) / 2 + 1.0).all(axis=1)
    return np.asarray(field[inside][:count])


def players_in_view(
    profile: SceneProfile, camera: Camera, template: FieldTemplate, surface: Surface, rng: np.random.Generator
) -> tuple[Player, ...]:
    """Players all over the view, some on the circle; the fewer the closer the view, as on a real field."""
    seen_share = min(1.0, (1800.0 * camera.width / 1920.0 / float(camera.focal_px[0])) ** 1.2)
    crowded = 1.6 if profile == "hard" else 1.0
    spread = _sample_ground(camera, template, surface, max(1, round(crowded * (4 + 18 * seen_share))), rng)
    circle = template.circle_by_name[template.default_circle]
    on_circle = int(rng.integers(3, 7) if profile == "hard" else rng.integers(0, 3))
    angles = rng.uniform(0, 2 * np.pi, on_circle)
    rim = np.asarray(circle.center) + (circle.radius_m + rng.normal(0, 0.3, (on_circle, 1))) * np.stack(
        [np.cos(angles), np.sin(angles)], -1
    )
    players = [sample_player(p, int(rng.integers(2)), rng) for p in (*spread, *rim)]
    if len(spread):
        players[0] = replace(players[0], team=2)
    return tuple(players)


def _clear_of_mark(
    players: tuple[Player, ...], camera: Camera, template: FieldTemplate, surface: Surface
) -> tuple[Player, ...]:
    center = camera.project(surface.lift(template.circle_by_name[template.default_circle].center))
    kept = []
    for player in players:
        low, high = body_extent_px(player, camera, surface)
        if not ((center > low - 12) & (center < high + 12)).all():
            kept.append(player)
    return tuple(kept)


def _in_front_of_mark(camera: Camera, template: FieldTemplate, rng: np.random.Generator) -> Player:
    """A player whose shirt or shorts hide the centre mark: as far in front of it as that part of the body is high."""
    center = np.asarray(template.circle_by_name[template.default_circle].center)
    toward = camera.position_m[:2] - center
    slope = float(np.linalg.norm(toward)) / -float(camera.position_m[2])
    position = center + toward / np.linalg.norm(toward) * rng.uniform(0.9, 1.3) * slope * 0.97
    return replace(sample_player(position, int(rng.integers(2)), rng), width=1.0)
