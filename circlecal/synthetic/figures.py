"""Players, their shadows, the ball and the goals, drawn over a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.synthetic.goals import draw_goals
from circlecal.synthetic.rays import Float32
from circlecal.synthetic.scene import Player, RenderConfig, Scene

_SUPERSAMPLING = 3
_SHIFT = 4
_PATCH_MARGIN_PX = 4
_LARGEST_PATCH_PX = 1400
_CREASES = 0.07
_BALL_RADIUS_M = 0.11
_REFEREE_BGR = (40.0, 225.0, 225.0)


@dataclass(frozen=True, slots=True)
class _BodyPart:
    """A convex polygon (K, 2) of a body in metres, right and up from the feet, and its colour."""

    outline_m: Array
    bgr: Array


def draw_shadows(picture: Float32, scene: Scene, light: Float32 | None = None) -> None:
    """Darken a frame (H, W, 3) where the players' shadows fall, in place.

    ``light`` (H, W) is that on the ground: in the shade of the stands nothing casts a shadow.
    """
    config, camera = scene.config, scene.camera
    for index in range(config.shadow_count):
        angle = config.shadow_rad + 2 * np.pi * index / config.shadow_count
        cast = config.shadow_length * np.array([np.cos(angle), np.sin(angle)])
        dark: NDArray[Any] = np.zeros(picture.shape[:2], dtype=np.uint8)
        for player in scene.players:
            _fill_shadow(dark, player, cast, camera, scene.surface)
        if dark.any():
            soft = cv2.GaussianBlur(dark, (0, 0), 1.0 + camera.focal_px[0] / 4000.0)
            depth = np.float32(config.shadow_strength / 255.0) * soft.astype(np.float32)
            if light is not None and config.shade:
                depth *= np.clip((light - np.float32(1.0 - config.shade)) / np.float32(config.shade), 0.0, 1.0)
            picture *= 1.0 - depth[..., None]


def draw_figures(picture: Float32, scene: Scene, rng: np.random.Generator, light: Float32 | None = None) -> Float32:
    """Draw goals, ball and players, far ones first, in place; what they hide comes back as (H, W), 0..1.

    ``light`` (H, W) is that on the ground: who stands in the shade is dark.
    """
    hidden = np.zeros(picture.shape[:2], dtype=np.float32)
    draw_goals(picture, hidden, scene)
    ordered = sorted(scene.players, key=lambda p: -scene.camera.depth(scene.surface.lift(p.position_m)))
    # looks first: what is drawn of a figure, and so how much randomness it takes, depends on the view
    looks = [rng if player.look_seed is None else np.random.default_rng(player.look_seed) for player in ordered]
    bodies = [_body(player, scene.config, look) for player, look in zip(ordered, looks, strict=True)]
    if scene.ball_m is not None:
        outline = _BALL_RADIUS_M * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE) + 1.0], axis=-1)
        ball = [_BodyPart(outline, np.array([225.0, 230.0, 230.0]))]
        _draw_upright(picture, hidden, ball, scene.ball_m, scene.camera, scene.surface, rng)
    for player, parts, look in zip(ordered, bodies, looks, strict=True):
        if light is not None:
            parts = _light(parts, _light_at(light, scene.camera.project(scene.surface.lift(player.position_m))))
        _draw_upright(picture, hidden, parts, player.position_m, scene.camera, scene.surface, look)
    return hidden


def body_extent_px(player: Player, camera: Camera, surface: Surface) -> tuple[Array, Array]:
    """Upper left and lower right corner (2,) of the box around a player."""
    outline = np.array([[-0.4, 0.0], [0.4, 0.0], [0.4, player.height_m], [-0.4, player.height_m]])
    pixels = camera.project(_upright(outline, player.position_m, camera, surface))
    return pixels.min(axis=0), pixels.max(axis=0)


def _light_at(light: Float32, pixel: Array) -> float:
    """Light (H, W) where the feet are, or nearest to them in the picture."""
    if not np.isfinite(pixel).all():
        return 1.0
    row, column = (int(np.clip(v, 0, n - 1)) for v, n in zip(pixel[::-1], light.shape, strict=True))
    return float(light[row, column])


def _light(parts: list[_BodyPart], light: float) -> list[_BodyPart]:
    return [_BodyPart(part.outline_m, part.bgr * light) for part in parts]


_BOOT = np.array([[-0.06, -0.04], [0.13, -0.05], [0.10, 0.03], [-0.05, 0.05]])
_CIRCLE = np.linspace(0, 2 * np.pi, 16, endpoint=False)


def _limb(start: Array, end: Array, thickness: float) -> Array:
    along = end - start
    aside = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-6) * thickness / 2
    return np.array([start + aside, end + 0.75 * aside, end - 0.75 * aside, start - aside])


def _oval(center: Array, half_width: float, half_height: float) -> Array:
    return np.asarray(center + np.stack([half_width * np.cos(_CIRCLE), half_height * np.sin(_CIRCLE)], axis=-1))


def _leg(hip: Array, swing: float, bend: float, colors: dict[str, Array]) -> list[_BodyPart]:
    knee = hip + 0.44 * np.array([np.sin(swing), -np.cos(swing)])
    foot = knee + 0.42 * np.array([np.sin(swing - bend), -np.cos(swing - bend)])
    foot[1] = max(foot[1], 0.06)
    boot = foot + _BOOT
    middle = knee + 0.25 * (foot - knee)
    return [
        _BodyPart(_limb(hip, knee, 0.19), colors["skin"]),
        _BodyPart(_limb(knee, middle, 0.13), colors["skin"]),
        _BodyPart(_limb(middle, foot, 0.12), colors["socks"]),
        _BodyPart(boot, colors["boots"]),
    ]


def _arm(shoulder: Array, swing: float, side: float, colors: dict[str, Array]) -> list[_BodyPart]:
    elbow = shoulder + 0.29 * np.array([side * 0.16 + np.sin(swing) * 0.7, -np.cos(swing)])
    hand = elbow + 0.27 * np.array([np.sin(1.5 * swing) - side * 0.05, -np.cos(1.2 * swing)])
    return [
        _BodyPart(_limb(elbow, hand, 0.085), colors["skin"]),
        _BodyPart(_limb(shoulder, elbow, 0.13), colors["shirt"]),
    ]


def _body(player: Player, config: RenderConfig, rng: np.random.Generator) -> list[_BodyPart]:
    """Parts of a body of the player's height, painted back to front."""
    colors = _colors(player.team, config, rng)
    swing, left, right, lean = player.pose
    hip = np.array([0.0, 0.9])
    neck = hip + 0.62 * np.array([np.sin(lean), np.cos(lean)])
    across = np.array([player.width, 0.0])
    torso = np.array(
        [
            hip - 0.155 * across,
            hip + 0.155 * across,
            neck + 0.205 * across - (0, 0.04),
            neck - 0.205 * across - (0, 0.04),
        ]
    )
    seat = np.array(
        [
            hip - 0.19 * across - (0.0, 0.26),
            hip + 0.19 * across - (0.0, 0.26),
            hip + 0.17 * across + (0, 0.08),
            hip - 0.17 * across + (0, 0.08),
        ]
    )
    head = neck + np.array([np.sin(lean) * 0.1, 0.14])
    shade = np.array([0.86])
    parts = [
        *_arm(neck - 0.18 * across - (0, 0.08), left, -1.0, colors),
        *_leg(hip - 0.09 * across, swing, abs(swing) * 0.9, colors),
        *_leg(hip + 0.09 * across, -swing, abs(swing) * 0.4, colors),
        _BodyPart(seat, colors["shorts"]),
        _BodyPart(torso, colors["shirt"]),
        _BodyPart(
            np.array([torso[1], torso[2], 0.4 * torso[2] + 0.6 * torso[3], 0.4 * torso[1] + 0.6 * torso[0]]),
            colors["shirt"] * shade,
        ),
        *_arm(neck + 0.18 * across - (0, 0.08), right, 1.0, colors),
        _BodyPart(_oval(head, 0.085, 0.12), colors["skin"]),
        _BodyPart(_oval(head + np.array([0.0, 0.045]), 0.085, 0.085), colors["hair"]),
    ]
    scale = player.height_m / 1.8
    facing = np.array([scale if rng.random() < 0.5 else -scale, scale])
    return [_BodyPart(part.outline_m * facing, part.bgr) for part in parts]


def _colors(team: int, config: RenderConfig, rng: np.random.Generator) -> dict[str, Array]:
    shirt = np.asarray(_REFEREE_BGR if team == 2 else config.team_bgr[team])
    dark = np.array([25.0, 22.0, 22.0])
    other = np.array([225.0, 228.0, 228.0]) if shirt.mean() < 150 else dark + 20.0
    shorts = dark if team == 2 else (other if team == 0 else shirt * 0.92)
    boots = np.array([[230, 230, 230], [30, 30, 30], [30, 90, 240], [60, 230, 190]])[rng.integers(4)].astype(np.float64)
    return {
        "shirt": shirt,
        "shorts": shorts,
        "socks": dark if team == 2 else shirt * 0.92,
        "skin": np.array([95.0, 125.0, 175.0]) * rng.uniform(0.45, 1.1),
        "hair": np.array([20.0, 28.0, 38.0]) * rng.uniform(0.5, 2.5),
        "boots": boots,
    }


def _upright(outline_m: Array, position_m: Array, camera: Camera, surface: Surface) -> Array:
    """Points (K, 3) of a flat figure (K, 2) that stands on the field and faces the camera."""
    toward = camera.position_m[:2] - position_m
    right = np.array([toward[1], -toward[0]]) / np.linalg.norm(toward)
    ground = surface.lift(position_m)
    return np.asarray(
        ground + outline_m[:, :1] * np.array([*right, 0.0]) + outline_m[:, 1:] * np.array([0.0, 0.0, -1.0])
    )


def _draw_upright(
    picture: Float32,
    hidden: Float32,
    parts: list[_BodyPart],
    position_m: Array,
    camera: Camera,
    surface: Surface,
    rng: np.random.Generator,
) -> None:
    """Draw a flat figure at three times the resolution, average it down and lay it over the picture, in place."""
    outlines = [camera.project(_upright(part.outline_m, position_m, camera, surface)) for part in parts]
    corners = np.concatenate(outlines)
    if not np.isfinite(corners).all():
        return
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - _PATCH_MARGIN_PX, 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + _PATCH_MARGIN_PX + 1, (camera.width, camera.height))
    size = high - low
    if (size <= 0).any() or (size > _LARGEST_PATCH_PX).any():
        return
    fine = size * _SUPERSAMPLING
    canvas: NDArray[Any] = np.zeros((fine[1], fine[0], 4), dtype=np.uint8)
    for part, outline in zip(parts, outlines, strict=True):
        # pixel centres: the middle of a fine pixel i lies at (i + 0.5) / factor - 0.5
        points = ((outline - low + 0.5) * _SUPERSAMPLING - 0.5) * 2**_SHIFT
        color = [float(v) for v in np.clip(part.bgr, 0, 255)] + [255.0]
        cv2.fillConvexPoly(canvas, _hull(points), color, cv2.LINE_8, _SHIFT)
    small = cv2.resize(canvas.astype(np.float32), (int(size[0]), int(size[1])), interpolation=cv2.INTER_AREA)
    alpha = small[..., 3:] / 255.0
    window = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
    creases = rng.normal(1.0, _CREASES, (max(2, int(size[1]) // 5), max(2, int(size[0]) // 5))).astype(np.float32)
    folds = cv2.resize(creases, (int(size[0]), int(size[1])), interpolation=cv2.INTER_LINEAR)[..., None]
    # colours are zero where nothing was drawn, so the average is premultiplied already
    picture[window] = picture[window] * (1.0 - alpha) + small[..., :3] * folds
    hidden[window] = np.maximum(hidden[window], alpha[..., 0])


def _hull(points: Array) -> NDArray[np.int32]:
    return np.round(points).astype(np.int32).reshape(-1, 1, 2)


def _fill_shadow(dark: NDArray[np.uint8], player: Player, cast: Array, camera: Camera, surface: Surface) -> None:
    """Add one shadow: the body laid on the ground along ``cast`` (2,), metres per metre of height."""
    aside = np.array([-cast[1], cast[0]]) / max(float(np.linalg.norm(cast)), 1e-6)
    h = player.height_m
    stride = player.pose[0] * 0.45
    outlines = (
        np.array([[-0.08 - stride, 0.0], [0.02 - stride, 0.0], [0.1, 0.5], [-0.1, 0.5]]),
        np.array([[-0.02 + stride, 0.0], [0.08 + stride, 0.0], [0.1, 0.5], [-0.1, 0.5]]),
        np.array([[-0.13, 0.45], [0.13, 0.45], [0.24, 0.82], [-0.24, 0.82]]),
        _oval(np.array([0.0, 0.92]), 0.1, 0.08),
    )
    for outline in outlines:
        ground = player.position_m + outline[:, :1] * aside + outline[:, 1:] * h * cast
        pixels = camera.project(surface.lift(ground))
        if np.isfinite(pixels).all() and np.abs(pixels).max() < 20000:
            cv2.fillConvexPoly(dark, _hull(pixels * 2**_SHIFT), 255, cv2.LINE_AA, _SHIFT)
