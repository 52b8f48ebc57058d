"""What stands around the field: boards, stands, walls; plausible, not measured against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.synthetic.ground import look_up
from circlecal.synthetic.rays import Float32, PixelRays, on_field
from circlecal.synthetic.recall import recall
from circlecal.synthetic.scene import RenderConfig, Scene

_RUN_OFF_M = 1.2
_TEXELS_PER_M = 14.0
_BOARD_STRIP_M = 72.0
_KICK_PLATE_M = 0.16
_GLASS_M = 1.8
_BOARD_WORDS = ("CIRCLECAL", "POLE & POLAR", "CONIC", "HALFWAY", "ELLIPSE FC", "ONE CIRCLE", "VANISHING LINE")


@dataclass(frozen=True, slots=True)
class _Enclosure:
    """Four walls around the field, ``half_m`` (2,) from its middle, rounded where they meet."""

    half_m: NDArray[np.float32]
    corner_m: float

    def outside(self, x: Float32, y: Float32) -> NDArray[np.bool_]:
        """Which ground points (...,) lie beyond the walls."""
        dx, dy = np.abs(x) - self.half_m[0], np.abs(y) - self.half_m[1]
        beyond = (dx > 0) | (dy > 0)
        if self.corner_m:
            radius = np.float32(self.corner_m)
            corner = (dx > -radius) & (dy > -radius)
            beyond |= corner & (np.hypot(dx + radius, dy + radius) > radius)
        return np.asarray(beyond)


def draw_surroundings(picture: Float32, rays: PixelRays, scene: Scene, rng: np.random.Generator) -> None:
    """Draw run-off, boards and stands over a picture (H, W, 3) of the ground, in place."""
    template, config = scene.template, scene.config
    half = np.array([template.length_m / 2, template.width_m / 2])
    if config.ground == "turf":
        beyond = (np.abs(rays.x_m) > half[0] + _RUN_OFF_M) | (np.abs(rays.y_m) > half[1] + _RUN_OFF_M)
        picture[beyond] *= np.float32(rng.uniform(0.72, 0.95))
    distance = config.board_distance_m
    ends = distance if config.ground == "ice" else distance + 2
    enclosure = _Enclosure(np.add(half, (ends, distance)).astype(np.float32), config.corner_m)
    crowd = _crowd(config, rng)
    _draw_near_side(picture, rays, scene, enclosure, crowd, rng)
    behind = enclosure.outside(rays.x_m, rays.y_m) | ~np.isfinite(rays.depth_m)
    rows = np.flatnonzero(behind.any(axis=1))
    if len(rows) == 0:
        return
    part = slice(int(rows[0]), int(rows[-1]) + 1)
    directions = np.ascontiguousarray(rays.directions[:, part])
    reach, along = _meet_walls(directions, scene, enclosure)
    position = scene.camera.position_m.astype(np.float32)
    with np.errstate(invalid="ignore"):
        ground = scene.surface.drop(*on_field(*(position[axis] + reach * directions[axis] for axis in range(2))))
        height = -position[2] - reach * directions[2] + ground.astype(np.float32)
        raised = (height >= 0) & np.isfinite(reach)
    rows = np.flatnonzero(raised.any(axis=1))
    if len(rows) == 0:
        return
    seen = slice(int(rows[0]), int(rows[-1]) + 1)
    wall = _wall(along[seen], np.clip(height[seen], 0.0, 60.0), config, crowd, rng)
    np.copyto(picture[part][seen], wall, where=raised[seen][..., None])


def _meet_walls(directions: Float32, scene: Scene, enclosure: _Enclosure) -> tuple[Float32, Float32]:
    """Reach (h, w) of the rays to the walls that the camera is inside of, and the place along them, metres."""
    position = scene.camera.position_m.astype(np.float32)
    reach = np.full(directions.shape[1:], np.inf, dtype=np.float32)
    along = np.zeros_like(reach)
    for axis in (1, 0):
        for sign in (-1.0, 1.0):
            distance = np.float32(sign * enclosure.half_m[axis]) - position[axis]
            if distance * sign <= 0:
                continue
            with np.errstate(divide="ignore", invalid="ignore"):
                t = distance / directions[axis]
                hit = (t > 0) & (t < reach)
                # text on every wall reads from left to right from within
                place = np.float32(-sign if axis else sign) * (position[1 - axis] + t * directions[1 - axis])
            np.copyto(reach, t, where=hit)
            np.copyto(along, place, where=hit)
    if enclosure.corner_m:
        _round_corners(reach, directions, position, enclosure)
    return reach, along


def _round_corners(reach: Float32, directions: Float32, position: Float32, enclosure: _Enclosure) -> None:
    """Shorten rays (h, w) that end in a corner to the round wall there, in place."""
    x, y = (position[axis] + np.where(np.isfinite(reach), reach, 0) * directions[axis] for axis in (0, 1))
    radius = np.float32(enclosure.corner_m)
    straight = enclosure.half_m - radius
    inside = np.isfinite(reach) & (np.abs(x) > straight[0]) & (np.abs(y) > straight[1])
    center = np.stack([np.sign(x[inside]) * straight[0], np.sign(y[inside]) * straight[1]])
    d = directions[:2, inside]
    offset = position[:2, None] - center
    a, b = np.sum(d * d, axis=0), np.sum(d * offset, axis=0)
    root = b * b - a * (np.sum(offset * offset, axis=0) - radius * radius)
    t = (-b + np.sqrt(np.maximum(root, 0.0))) / np.maximum(a, 1e-9)
    reach[inside] = np.where(root > 0, np.minimum(t, reach[inside]), reach[inside])


def _draw_near_side(
    picture: Float32,
    rays: PixelRays,
    scene: Scene,
    enclosure: _Enclosure,
    crowd: Float32,
    rng: np.random.Generator,
) -> None:
    """Ground behind the walls on the camera's own side, in place: backs of the boards, concrete, spectators."""
    position, config = scene.camera.position_m, scene.config
    concrete = (rng.uniform(30, 90) + rng.normal(0, 5, 3)).astype(np.float32)
    board = rng.uniform(20, 220, 3).astype(np.float32)
    for axis, own, other in ((1, rays.y_m, rays.x_m), (0, rays.x_m, rays.y_m)):
        sign = np.sign(position[axis])
        past = np.float32(sign) * own - enclosure.half_m[axis]
        near = (past > 0) & np.isfinite(rays.depth_m)
        if abs(position[axis]) <= enclosure.half_m[axis] or not near.any():
            continue
        rows = np.flatnonzero(near.any(axis=1))
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        seats = np.tile(concrete, (*past[part].shape, 1))
        if config.near_crowd:
            people = look_up(crowd, other[part] * _TEXELS_PER_M, past[part] * np.float32(0.7 * _TEXELS_PER_M))
            seats = np.where((past[part] > 3.0)[..., None], people * np.float32(0.8 * config.stand_light), seats)
        seats[past[part] < 0.7] = board
        np.copyto(picture[part], seats, where=near[part][..., None])


def _wall(along: Float32, height: Float32, config: RenderConfig, crowd: Float32, rng: np.random.Generator) -> Float32:
    """Colours (h, w, 3) of boards, a dark gap and the stand at wall coordinates in metres."""
    boards = _boards(config, rng)
    rows, columns = boards.shape[:2]
    stand = look_up(crowd, along * np.float32(_TEXELS_PER_M), height * np.float32(-_TEXELS_PER_M))
    stand *= np.float32(config.stand_light)
    stand[(np.abs(along + 400.0) % 14.0) < 0.9] = 70.0 * config.stand_light
    tier = (height % 9.5) < 0.9
    stand[tier] = np.asarray(rng.uniform(20, 110, 3), dtype=np.float32)
    stand[height > config.stand_height_m] = np.asarray(config.sky_bgr, dtype=np.float32)
    gap = height < config.board_height_m + rng.uniform(0.2, 0.9)
    gap_color = np.asarray(rng.uniform(15, 70, 3), dtype=np.float32)
    if config.ground == "ice":
        glass = height < config.board_height_m + _GLASS_M
        stand[glass] = 0.8 * stand[glass] + 35.0
    else:
        stand[gap] = gap_color
    low = height <= config.board_height_m
    shown = np.flatnonzero(low.any(axis=1))
    if len(shown):
        part = slice(int(shown[0]), int(shown[-1]) + 1)
        inside = np.clip(1.0 - height[part] / np.float32(config.board_height_m), 0.0, 1.0) * (rows - 4) + 1.5
        face = look_up(boards, along[part] * np.float32(columns / _BOARD_STRIP_M), inside.astype(np.float32))
        if config.ground == "ice":
            face[height[part] < _KICK_PLATE_M] = (40.0, 200.0, 230.0)
        np.copyto(stand[part], face, where=low[part][..., None])
    return stand


@recall(1)
def _boards(config: RenderConfig, rng: np.random.Generator) -> Float32:
    """A strip of advertising boards (48, 3456, 3), 72 m long."""
    strip: NDArray[Any] = np.zeros((48, 3456, 3), dtype=np.uint8)
    palette = rng.integers(0, 2, 3) * rng.integers(150, 235, 3)
    edges = np.cumsum(rng.integers(220, 420, 24))
    for start, end in zip(np.concatenate([[0], edges[:-1]]), edges, strict=True):
        back = np.clip(palette + rng.integers(-30, 30, 3), 5, 240) if rng.random() < 0.6 else rng.integers(5, 240, 3)
        if config.ground == "ice":
            back = 230 + back // 12
        strip[:, start:end] = back
        ink = [245, 245, 245] if back.mean() < 130 else [20, 20, 20]
        if config.ground == "ice":
            ink = [int(v) for v in rng.integers(10, 200, 3)]
        word = _BOARD_WORDS[rng.integers(len(_BOARD_WORDS))]
        cv2.putText(strip, word, (int(start) + 14, 36), cv2.FONT_HERSHEY_DUPLEX, 1.1, ink, 2, cv2.LINE_AA)
        if config.round_logos:
            middle = (int(end) - 26, 24)
            cv2.circle(strip, middle, 19, ink, 3, cv2.LINE_AA)
            cv2.circle(strip, middle, 9, ink, -1 if rng.random() < 0.5 else 2, cv2.LINE_AA)
    return strip.astype(np.float32)


@recall(1)
def _crowd(config: RenderConfig, rng: np.random.Generator) -> Float32:
    """A periodic crowd (448, 1120, 3): rows of seats, people with heads, coats and team colours."""
    rows, seats, tall, wide = 56, 160, 8, 7
    seat = rng.uniform(20, 130, 3)
    fan = np.asarray(config.team_bgr[0])
    dull = rng.uniform(15, 90, (rows, seats, 1)) + rng.normal(0, 14, (rows, seats, 3))
    bright = rng.uniform(120, 230, (rows, seats, 1)) + rng.normal(0, 25, (rows, seats, 3))
    kind = rng.random((rows, seats, 1))
    coat = np.where(kind < 0.55, dull, np.where(kind < 0.8, fan + rng.normal(0, 25, (rows, seats, 3)), bright))
    taken = rng.random((rows, seats, 1)) < config.crowd_density
    skin = np.array([110, 140, 190]) * rng.uniform(0.4, 1.1, (rows, seats, 1))
    people = np.repeat(np.repeat(np.where(taken, coat, seat), tall, axis=0), wide, axis=1).astype(np.float32)
    heads = np.repeat(np.repeat(np.where(taken, skin, seat * 0.7), tall, axis=0), wide, axis=1)
    row, column = np.arange(rows * tall)[:, None], np.arange(seats * wide)[None]
    jitter = np.repeat(np.repeat(rng.integers(-1, 2, (rows, seats)), tall, axis=0), wide, axis=1)
    head = ((row % tall) < 3) & (np.abs(column % wide - 3 + jitter) <= 1)
    people = np.where(head[..., None], heads, people).astype(np.float32)
    people[::tall] *= 0.55
    odd = (np.arange(rows * tall) // tall) % 2 == 1
    people[odd] = np.roll(people[odd], wide // 2, axis=1)
    return np.asarray(cv2.GaussianBlur(np.clip(people, 0, 255), (0, 0), 0.8), dtype=np.float32)
