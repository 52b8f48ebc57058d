"""Random scenes by profile: the view, the ground, the players and the look of the picture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from circlecal.field import FieldTemplate, load_field
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.paint.along_curve import WIDTH_RATIO
from circlecal.synthetic.alterations import ALTERATIONS
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.decals import Decal, floor_decals, grass_decals, rink_decals
from circlecal.synthetic.delivery import cut_out, stretch
from circlecal.synthetic.figures import body_extent_px
from circlecal.synthetic.floors import hall_paint, old_circle_paint, rink_paint, rugby_paint, second_sport_paint
from circlecal.synthetic.looks import archive_format, sample_config, sample_delivery
from circlecal.synthetic.negatives import negative_scene
from circlecal.synthetic.other_sports import choose_circle, court_decals, court_paint, faceoff_paint, rink_logos, robots
from circlecal.synthetic.painters import displace_markings
from circlecal.synthetic.renderer import Rendering, render
from circlecal.synthetic.scene import ExtraPaint, Player, RenderConfig, Scene, sample_player
from circlecal.synthetic.views import CameraProfile

SceneProfile = Literal[
    "easy",
    "broadcast",
    "partial",
    "hidden_mark",
    "hard",
    "negative",
    "shade",
    "worn",
    "graphics",
    "low_camera",
    "lens",
    "archive",
    "colours",
    "night",
    "haze",
    "blur",
    "letterbox",
    "uhd",
    "behind_goal",
    "oblique",
    "short_arc",
    "no_halfway",
    "ice",
    "wood",
    "world_whole",
    "world_part",
    "world_banners",
    "world_ends",
    "world_paint",
    "altered",
    "rink",
    "court",
    "robots",
    "cut",
    "kick_off",
]
SCENE_PROFILES: tuple[SceneProfile, ...] = get_args(SceneProfile)
PROFILE_BY_NAME: dict[str, SceneProfile] = {profile: profile for profile in SCENE_PROFILES}


@dataclass(frozen=True, slots=True)
class _Setting:
    """What sets a profile apart besides its look: the views it draws from, the field, the lens.

    ``kappa`` and ``crown_m`` are (lowest, highest); ``scale`` the picture's size in sizes asked for; ``is_any_size``
    says whether the field is as large as the Laws allow, and as often flat as crowned.
    """

    views: tuple[CameraProfile, ...] = ("broadcast", "broadcast", "main", "partial")
    field: str = "soccer"
    kappa: tuple[float, float] = (0.0, 0.055)
    crown_m: tuple[float, float] = (0.02, 0.09)
    scale: int = 1
    is_any_size: bool = False


_USUAL: tuple[CameraProfile, ...] = ("broadcast", "broadcast", "broadcast", "main", "main")


def _world(*views: CameraProfile) -> _Setting:
    """Fields of any size, flat or crowned, through any broadcast lens."""
    return _Setting(views, kappa=(-0.03, 0.08), crown_m=(0.0, 0.09), is_any_size=True)


_SETTINGS: dict[str, _Setting] = {
    "easy": _Setting(_USUAL, kappa=(0.0, 0.03), crown_m=(0.0, 0.05)),
    "broadcast": _Setting(("broadcast",)),
    "partial": _Setting(("partial",)),
    "hidden_mark": _Setting(_USUAL),
    "kick_off": _Setting(("broadcast", "main", "partial", "partial")),
    "hard": _Setting(("hard",)),
    "graphics": _Setting(("broadcast", "broadcast", "main")),
    "low_camera": _Setting(("pitchside",)),
    "lens": _Setting(("tactical", "broadcast", "main", "pitchside"), kappa=(-0.1, 0.1), crown_m=(-0.03, 0.14)),
    "archive": _Setting(("broadcast", "broadcast", "main")),
    "uhd": _Setting(("broadcast", "main"), scale=2),
    "behind_goal": _Setting(("side",)),
    "oblique": _Setting(("oblique",)),
    "short_arc": _Setting(("short_arc",)),
    "no_halfway": _Setting(("no_halfway",)),
    "ice": _Setting(("rink",), "ice-hockey", (-0.03, 0.05), (0.0, 0.0)),
    "wood": _Setting(("hall",), "futsal", (-0.08, 0.04), (0.0, 0.0)),
    "rink": _Setting(("rink_zone",), "ice-hockey-nhl", (-0.02, 0.07), (0.0, 0.0)),
    "court": _Setting(("court",), "basketball-nba", (-0.02, 0.06), (0.0, 0.0)),
    "robots": _Setting(("robot",), "robocup", (-0.09, 0.08), (0.0, 0.0)),
    "world_whole": _world("broadcast", "broadcast", "main"),
    "world_part": _world("partial", "short_arc"),
    "world_banners": _world("broadcast", "broadcast", "main", "partial"),
    "world_ends": _world("broadcast"),
    "world_paint": _world("broadcast", "broadcast", "main", "partial"),
    "cut": _Setting(("broadcast", "broadcast", "main")),
    "altered": _Setting(("broadcast", "broadcast", "main", "partial", "tactical")),
}
LENGTH_M, WIDTH_M = (90.0, 120.0), (45.0, 90.0)
"""What the Laws of the Game (Law 1) allow."""
_FLAT_SHARE = 0.5
"""Of the fields of any size: artificial turf is laid flat."""
_RUGBY_SHARE = 0.5
_KEPT_SHARE = (0.55, 0.85)
"""Of the width and of the height, each by itself, of a picture that is cut."""
_BESIDE_MARK_M, _KICKERS_M = 0.02, (0.7, 3.0)
"""How far from the centre mark the ball lies at a kick-off (standard deviation), and how far two players stand."""
_MOST_PLAYERS = {"ice-hockey": 12, "ice-hockey-nhl": 12, "basketball-nba": 12, "futsal": 9}


_WIDE_LINES_M = {"centre_line": 0.3, "blue_line_left": 0.3, "blue_line_right": 0.3}


def profile_field(profile: str) -> str:
    """Name of the field template that a profile's frames show unless another one is asked for."""
    return _SETTINGS.get(profile, _Setting()).field


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
        ``"negative"``: no circle that can be calibrated, see :mod:`circlecal.synthetic.negatives`.
        ``"shade"``: hard shade of the stands across the circle. ``"worn"``: paint that is thin, patchy or gone in
        places. ``"graphics"``: captions, logos, an analyst's rings and lines. ``"low_camera"``: 3-7 m above the field.
        ``"lens"``: pincushion and barrel, wide angles, strong crowns. ``"archive"``: old video of 398x224 to 848x478,
        PAL and NTSC with oblong pixels, fields, blocks and little colour. ``"colours"``: brown, yellow, grey, dark,
        blue and red ground, all mowing patterns, rugby lines. ``"night"``, ``"haze"``, ``"blur"``: little light, mist
        and rain, motion. ``"letterbox"``: bars around the picture. ``"uhd"``: twice the size asked for.
        ``"behind_goal"`` and ``"oblique"``: cameras on the other sides and in the corners. ``"short_arc"``: 60-140
        degrees of the circle, with the halfway line and others. ``"no_halfway"``: a part of the circle and other lines.
        ``"ice"``: a hockey rink with all its circles. ``"wood"``: futsal on a hall's floor with the lines of others.
        ``"rink"``, ``"court"`` and ``"robots"``: as hard as broadcasts (:mod:`circlecal.synthetic.other_sports`).
        ``"world_..."``: fields of any size that the Laws allow, flat or crowned, with the whole circle, a part of it,
        with banners over the picture, with players at the ends of lines, with the lines of a second sport and a circle
        that was painted anew. ``"altered"``: pictures that no camera took (:mod:`circlecal.synthetic.alterations`).
        ``"cut"``: a part of a picture of the size asked for. ``"kick_off"``: the ball on the centre mark and players
        beside it, near enough for a part of the circle only in every other frame.
    rng : Generator
        Randomness.
    width, height : int
        Picture size, pixels; ``"archive"`` has sizes of its own.
    template : FieldTemplate, optional
        Field; that of the profile if not given.

    Raises
    ------
    ValueError
        Unknown profile.
    """
    if profile not in SCENE_PROFILES:
        raise ValueError(f"unknown scene profile {profile!r}; known: {', '.join(SCENE_PROFILES)}")
    setting = _SETTINGS.get(profile, _Setting())
    field = template or _sample_field(setting, rng)
    if profile == "negative":
        return negative_scene(rng, (width, height), field)
    stored = size = (width * setting.scale, height * setting.scale)
    if profile == "archive":
        size, stored = archive_format(rng)
    delivery = sample_delivery(profile, rng, stored)
    left, top, right, bottom = delivery.bars_px
    if left or top or bottom:
        size = stored = (size[0] - left - right, size[1] - top - bottom)
    surface = _sample_surface(setting, field, rng)
    kappa = float(rng.uniform(*setting.kappa))
    view = setting.views[int(rng.random() * len(setting.views))]
    camera = sample_camera(view, rng, *size, field, kappa=kappa, surface=surface)
    camera = camera if stored == size else stretch(camera, *stored)
    if profile == "cut":
        camera = _cut(camera, rng)
        stored = camera.width, camera.height
    config = _suit_paint(sample_config(profile, rng, stored[0]), field)
    players = robots(field, rng) if profile == "robots" else players_in_view(profile, camera, field, surface, rng)
    if profile == "world_ends":
        players = (*players, *_at_line_ends(field, rng))
    painted = True
    if profile == "easy":
        players = _clear_of_mark(players, camera, field, surface)
    elif profile == "hidden_mark":
        painted = bool(rng.random() < 0.7)
        players = (*players, _in_front_of_mark(camera, field, rng)) if painted else players
    ball = _sample_ground(camera, field, surface, 1, rng)
    if profile == "kick_off":
        ball = rng.normal(field.circle_by_name[field.default_circle].center, _BESIDE_MARK_M, (1, 2))
        players = (*players, *_at_kick_off(field, rng))
    return Scene(
        camera,
        field,
        surface,
        config,
        players,
        ball[0] if len(ball) and profile != "hidden_mark" and field.name == "soccer" else None,
        painted,
        delivery,
        extras=_extras(profile, field, rng),
        decals=_decals(profile, field, rng),
        widths_m=_WIDE_LINES_M if profile in ("ice", "rink") and _is_rink(field) else {},
        alteration=ALTERATIONS[rng.integers(len(ALTERATIONS))] if profile == "altered" else "",
        painted=displace_markings(field, rng),
    )


def _cut(camera: Camera, rng: np.random.Generator) -> Camera:
    whole = np.array([camera.width, camera.height])
    width, height = np.round(rng.uniform(*_KEPT_SHARE, 2) * whole).astype(int).tolist()
    x, y = np.floor(rng.random(2) * (whole - (width, height) + 1)).astype(int).tolist()
    return cut_out(camera, (x, y), width, height)


def render_frame(
    profile: SceneProfile,
    rng: np.random.Generator,
    width: int = 1920,
    height: int = 1080,
    template: FieldTemplate | None = None,
) -> Rendering:
    """A random scene of a profile, rendered; the parameters are those of :func:`sample_scene`."""
    return render(sample_scene(profile, rng, width, height, template), rng)


def _suit_paint(config: RenderConfig, template: FieldTemplate) -> RenderConfig:
    """The look with paint as wide as the field's where the profile's is none of it: a curling sheet has lines of half
    an inch, not those of a rink.
    """
    low, high = WIDTH_RATIO
    if low < config.marking_width_m / template.marking_width_m < high:
        return config
    return config.model_copy(update={"marking_width_m": template.marking_width_m})


def _is_rink(template: FieldTemplate) -> bool:
    """Whether a field on ice has what only hockey paints."""
    return template.sport == "ice hockey"


def _extras(profile: str, template: FieldTemplate, rng: np.random.Generator) -> tuple[ExtraPaint, ...]:
    if profile in ("ice", "rink") and not _is_rink(template):
        return ()
    if profile == "ice":
        return rink_paint(template, rng)
    if profile == "wood":
        return hall_paint(template, rng)
    if profile == "rink":
        return faceoff_paint(template)
    if profile == "court":
        return court_paint(rng)
    if profile == "world_paint":
        return (*second_sport_paint(template, rng), *old_circle_paint(template, rng))
    return rugby_paint(template, rng) if profile == "colours" and rng.random() < _RUGBY_SHARE else ()


def _decals(profile: str, template: FieldTemplate, rng: np.random.Generator) -> tuple[Decal, ...]:
    if profile in ("ice", "rink") and not _is_rink(template):
        return ()
    if profile == "ice":
        return rink_decals(template.length_m, rng)
    if profile == "wood":
        return floor_decals(rng)
    if profile == "rink":
        return rink_logos(template, rng)
    if profile == "court":
        return court_decals(template, rng)
    return grass_decals(template.length_m, rng) if profile == "graphics" else ()


def _sample_field(setting: _Setting, rng: np.random.Generator) -> FieldTemplate:
    if not setting.is_any_size:
        field = load_field(setting.field)
        return choose_circle(field, rng) if setting.field in ("ice-hockey-nhl", "basketball-nba") else field
    sizes = {"length": float(rng.uniform(*LENGTH_M)), "width": float(rng.uniform(*WIDTH_M))}
    return load_field(setting.field, sizes)


def _sample_surface(setting: _Setting, template: FieldTemplate, rng: np.random.Generator) -> Surface:
    """Slopes of up to 1 % towards the touchlines, as fields are built; at most about a third of a metre of fall."""
    radius = template.circle_by_name[template.default_circle].radius_m
    if setting.crown_m == (0.0, 0.0):
        return Surface("roof", radius, 0.0)
    if setting.is_any_size and rng.random() < _FLAT_SHARE:
        return Surface("flat", radius, 0.0)
    if rng.random() < 0.7:
        return Surface("roof", radius, float(rng.uniform(*setting.crown_m)))
    return Surface("parabola", radius, float(rng.uniform(0.0, 0.025)))


def _sample_ground(
    camera: Camera, template: FieldTemplate, surface: Surface, count: int, rng: np.random.Generator
) -> Array:
    """Up to ``count`` field positions (K, 2) in the frame, evenly spread over the picture."""
    pixels = rng.uniform((0, 0), (camera.width, camera.height), (4 * count, 2))
    field = camera.back_project(pixels, surface)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(field) < np.array([template.length_m, template.width_m]) / 2 + 1.0).all(axis=1)
    return np.asarray(field[inside][:count])


def players_in_view(
    profile: SceneProfile, camera: Camera, template: FieldTemplate, surface: Surface, rng: np.random.Generator
) -> tuple[Player, ...]:
    """Players all over the view, some on the circle; the fewer the closer the view, as on a real field."""
    seen_share = min(1.0, (1800.0 * camera.width / 1920.0 / float(camera.focal_px[0])) ** 1.2)
    crowded = 1.6 if profile == "hard" else 1.0
    count = min(round(crowded * (4 + 18 * seen_share)), _MOST_PLAYERS.get(template.name, 99))
    spread = _sample_ground(camera, template, surface, max(1, count), rng)
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


def _at_line_ends(template: FieldTemplate, rng: np.random.Generator) -> tuple[Player, ...]:
    """Players who stand on or a little inside the ends of the halfway line and of the penalty areas' lines."""
    names = (template.halfway_line, "big_rect_left_main", "big_rect_right_main")
    ends = np.concatenate([template.line_ends(template.line_by_name[name]) for name in names if name is not None])
    inward = -np.sign(ends[:, 1]) * rng.exponential(1.0, len(ends))
    places = ends + np.stack([rng.normal(0.0, 0.3, len(ends)), inward], axis=-1)
    return tuple(sample_player(place, int(rng.integers(2)), rng) for place in places)


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


def _at_kick_off(template: FieldTemplate, rng: np.random.Generator) -> Iterator[Player]:
    """Two players beside the centre mark, one of each team."""
    center = np.asarray(template.circle_by_name[template.default_circle].center)
    for team in (0, 1):
        angle, distance_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_KICKERS_M)
        yield sample_player(center + distance_m * np.array([np.cos(angle), np.sin(angle)]), team, rng)


def _in_front_of_mark(camera: Camera, template: FieldTemplate, rng: np.random.Generator) -> Player:
    """A player whose shirt or shorts hide the centre mark: as far in front of it as that part of the body is high."""
    center = np.asarray(template.circle_by_name[template.default_circle].center)
    toward = camera.position_m[:2] - center
    slope = float(np.linalg.norm(toward)) / -float(camera.position_m[2])
    position = center + toward / np.linalg.norm(toward) * rng.uniform(0.9, 1.3) * slope * 0.97
    return replace(sample_player(position, int(rng.integers(2)), rng), width=1.0)
