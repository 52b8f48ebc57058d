"""Turf and stadium behind the markings: plausible, not measured against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.pinhole import Camera
from circlecal.synthetic.scene import RenderConfig, Scene
from circlecal.synthetic.surface import Surface, ray_directions

Float32 = NDArray[np.float32]

_COARSE_PX = 8
_FAR_M = 400.0
_LIST_COLUMNS = 1024  # OpenCV's remap takes no picture wider than 32767
_TURF_OCTAVES_M = ((0.12, 0.8), (0.5, 0.45), (2.5, 0.25))
_PATCH_M = 9.0
_RUN_OFF_M = 1.2
_CROWN_ROUNDS = 4
_CROWN_ENDS_M = 45.0
_TEXELS_PER_M = 14.0
_BOARD_WORDS = ("CIRCLECAL", "POLE & POLAR", "CONIC", "HALFWAY", "ELLIPSE FC", "ONE CIRCLE", "VANISHING LINE")


@dataclass(frozen=True, slots=True)
class PixelRays:
    """Rays of all pixels in float32.

    ``directions`` (H, W, 3) with unit depth; ``ground_m`` (H, W, 2) where they meet the ground; ``depth_m`` (H, W)
    there, inf above the horizon.
    """

    directions: Float32
    ground_m: Float32
    depth_m: Float32


def pixel_rays(camera: Camera, surface: Surface) -> PixelRays:
    """Rays of every pixel: exact on a grid of 8 pixels, interpolated between (well below 0.1 px)."""
    columns = np.arange(0, camera.width + 2 * _COARSE_PX, _COARSE_PX)
    rows = np.arange(0, camera.height + 2 * _COARSE_PX, _COARSE_PX)
    coarse = ray_directions(camera, np.stack(np.meshgrid(columns, rows), axis=-1).astype(np.float64)).astype(np.float32)
    x, y = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
    directions = np.asarray(cv2.remap(coarse, x / _COARSE_PX, y / _COARSE_PX, cv2.INTER_LINEAR), dtype=np.float32)
    down, away = directions[..., 2], directions[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(down > 1e-6, np.float32(-camera.position_m[2]) / down, np.inf)
    depth = depth.astype(np.float32)
    reach = np.minimum(depth, _FAR_M * 4)
    for _ in range(_CROWN_ROUNDS if surface.crown_m else 0):
        y_m = np.clip(np.float32(camera.position_m[1]) + reach * away, -_CROWN_ENDS_M, _CROWN_ENDS_M)
        above = np.float32(camera.position_m[2]) + reach * down - _drop(surface, y_m)
        reach = np.where(
            np.isfinite(depth), reach - above / np.maximum(down - _slope(surface, y_m) * away, 1e-3), reach
        )
    ground = camera.position_m[:2].astype(np.float32) + reach[..., None] * directions[..., :2]
    return PixelRays(directions, np.clip(ground, -_FAR_M, _FAR_M).astype(np.float32), depth)


def _drop(surface: Surface, y_m: Float32) -> Float32:
    ratio = np.abs(y_m) / np.float32(surface.reference_m)
    return np.asarray(np.float32(surface.crown_m) * (ratio * ratio if surface.shape == "parabola" else ratio))


def _slope(surface: Surface, y_m: Float32) -> Float32:
    unit = np.float32(surface.crown_m / surface.reference_m)
    return np.asarray(
        unit * (2 * y_m / np.float32(surface.reference_m) if surface.shape == "parabola" else np.sign(y_m))
    )


def noise_texture(rng: np.random.Generator, size: int = 256) -> Float32:
    """Periodic smooth noise (size, size), mean 0 and standard deviation 1."""
    white = rng.standard_normal((size, size), dtype=np.float32)
    tiled = cv2.GaussianBlur(np.tile(white, (3, 3)), (0, 0), 1.0)[size : 2 * size, size : 2 * size]
    return np.asarray((tiled - tiled.mean()) / tiled.std(), dtype=np.float32)


def looked_up(texture: NDArray[Any], u: Float32, v: Float32) -> Float32:
    """A periodic texture at texel coordinates."""
    return np.asarray(cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP), dtype=np.float32)


def looked_up_at(texture: Float32, u: Float32, v: Float32) -> Float32:
    """The same for a list of coordinates (N,), of any length."""
    spare = -len(u) % _LIST_COLUMNS
    u_grid, v_grid = (np.pad(c, (0, spare)).reshape(-1, _LIST_COLUMNS).astype(np.float32) for c in (u, v))
    return looked_up(texture, u_grid, v_grid).reshape(-1)[: len(u)]


def draw_turf(rays: PixelRays, camera: Camera, config: RenderConfig, rng: np.random.Generator) -> Float32:
    """Turf (H, W, 3) of the whole plane: stripes, blades, patches, shade of the stand."""
    x, y = rays.ground_m[..., 0], rays.ground_m[..., 1]
    light = 1.0 + config.stripe_contrast * _stripes(x, y, config)
    if config.texture:
        # metres on the ground per pixel, the mean of both directions
        descent = np.maximum(rays.directions[..., 2], 1e-3) / np.linalg.norm(rays.directions, axis=-1)
        footprint = np.minimum(rays.depth_m, _FAR_M) / np.float32(camera.focal_px[0]) / np.sqrt(descent)
        for size, weight in _TURF_OCTAVES_M:
            blades = looked_up(noise_texture(rng), x / size, y / size)
            light += config.texture * weight * blades * np.clip(size / footprint, 0.0, 1.0)
    if config.shade:
        inside = (config.shade_edge_m + config.shade_tilt * x) - y
        light *= 1.0 - config.shade * np.clip(inside / 0.4 + 0.5, 0.0, 1.0)
    turf = light[..., None] * np.asarray(config.turf_bgr, dtype=np.float32)
    if config.patchiness:
        dry = config.patchiness * looked_up(noise_texture(rng), x / _PATCH_M, y / _PATCH_M)
        turf *= 1.0 + dry[..., None] * np.array([-0.6, 0.5, 1.4], dtype=np.float32)
    return np.asarray(turf, dtype=np.float32)


def draw_surroundings(picture: Float32, rays: PixelRays, scene: Scene, rng: np.random.Generator) -> None:
    """Draw run-off, boards and stands over a picture (H, W, 3) of turf, in place."""
    camera, template, surface, config = scene.camera, scene.template, scene.surface, scene.config
    half_length, half_width = template.length_m / 2, template.width_m / 2
    x, y = rays.ground_m[..., 0], rays.ground_m[..., 1]
    beyond = (np.abs(x) > half_length + _RUN_OFF_M) | (np.abs(y) > half_width + _RUN_OFF_M)
    picture[beyond] *= rng.uniform(0.72, 0.95)
    near = y > half_width + config.board_distance_m
    concrete = rng.uniform(30, 90) + rng.normal(0, 5, 3)
    picture[near] = picture[near] * 0.15 + np.asarray(concrete, dtype=np.float32)
    distance = config.board_distance_m
    # axis, position, and the sign that makes the text on it read from left to right
    ends = half_length + distance + 2
    walls = ((1, -half_width - distance, 1.0), (0, -ends, -1.0), (0, ends, 1.0))
    reach = np.full(rays.depth_m.shape, np.inf, dtype=np.float32)
    along = np.zeros_like(reach)
    for axis, position, sense in walls:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.float32(position - camera.position_m[axis]) / rays.directions[..., axis]
        hit = (t > 0) & (t < reach)
        reach[hit] = t[hit]
        along[hit] = sense * (np.float32(camera.position_m[1 - axis]) + t * rays.directions[..., 1 - axis])[hit]
    with np.errstate(invalid="ignore"):
        foot = np.clip(
            np.float32(camera.position_m[1]) + reach * rays.directions[..., 1], -_CROWN_ENDS_M, _CROWN_ENDS_M
        )
        height = np.float32(-camera.position_m[2]) - reach * rays.directions[..., 2] + _drop(surface, foot)
    raised = (height >= 0) & np.isfinite(reach)
    if not raised.any():
        return
    top, bottom = np.flatnonzero(raised.any(axis=1))[[0, -1]]
    part = slice(int(top), int(bottom) + 1)
    wall = _wall(along[part], np.clip(height[part], 0.0, 40.0), config, rng)
    picture[part][raised[part]] = wall[raised[part]]


def _stripes(x: Float32, y: Float32, config: RenderConfig) -> Float32:
    def wave(coordinate: Float32) -> Float32:
        return np.asarray(np.tanh(6.0 * np.sin(np.pi * coordinate / config.stripe_width_m)), dtype=np.float32)

    return wave(x) * wave(y) if config.cross_stripes else wave(x)


def _wall(along: Float32, height: Float32, config: RenderConfig, rng: np.random.Generator) -> Float32:
    """Colours (h, w, 3) of boards, a dark gap and the stand at wall coordinates in metres."""
    boards = _boards(rng)
    rows, columns = boards.shape[:2]
    inside = np.clip(1.0 - height / config.board_height_m, 0.0, 1.0) * (rows - 4) + 1.5
    picture = looked_up(boards, along * (columns / 72.0), inside.astype(np.float32))
    crowd = _crowd(config, rng)
    stand = looked_up(crowd, along * _TEXELS_PER_M, -height * _TEXELS_PER_M) * config.stand_light
    stand[(np.abs(along + 400.0) % 14.0) < 0.9] = 70.0 * config.stand_light
    tier = (height % 9.5) < 0.9
    stand[tier] = np.asarray(rng.uniform(20, 110, 3), dtype=np.float32)
    stand[height > 21.0] = 28.0
    above = height > config.board_height_m
    picture[above] = stand[above]
    gap = above & (height < config.board_height_m + rng.uniform(0.2, 0.9))
    picture[gap] = np.asarray(rng.uniform(15, 70, 3), dtype=np.float32)
    return picture


def _boards(rng: np.random.Generator) -> Float32:
    """A strip of advertising boards (48, 3456, 3), 72 m long."""
    strip: NDArray[Any] = np.zeros((48, 3456, 3), dtype=np.uint8)
    palette = rng.integers(0, 2, 3) * rng.integers(150, 235, 3)
    edges = np.cumsum(rng.integers(220, 420, 24))
    for start, end in zip(np.concatenate([[0], edges[:-1]]), edges, strict=True):
        back = np.clip(palette + rng.integers(-30, 30, 3), 5, 240) if rng.random() < 0.6 else rng.integers(5, 240, 3)
        strip[:, start:end] = back
        ink = (245, 245, 245) if back.mean() < 130 else (20, 20, 20)
        word = _BOARD_WORDS[rng.integers(len(_BOARD_WORDS))]
        cv2.putText(strip, word, (int(start) + 14, 36), cv2.FONT_HERSHEY_DUPLEX, 1.1, ink, 2, cv2.LINE_AA)
    return strip.astype(np.float32)


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
    people = np.repeat(np.repeat(np.where(taken, coat, seat), tall, axis=0), wide, axis=1)
    heads = np.repeat(np.repeat(np.where(taken, skin, seat * 0.7), tall, axis=0), wide, axis=1)
    row, column = np.indices(people.shape[:2])
    jitter = np.repeat(np.repeat(rng.integers(-1, 2, (rows, seats)), tall, axis=0), wide, axis=1)
    head = ((row % tall) < 3) & (np.abs(column % wide - 3 + jitter) <= 1)
    people = np.where(head[..., None], heads, people)
    people[(row % tall) == 0] *= 0.55
    odd = (np.arange(rows * tall) // tall) % 2 == 1
    people[odd] = np.roll(people[odd], wide // 2, axis=1)
    return np.asarray(cv2.GaussianBlur(np.clip(people, 0, 255).astype(np.float32), (0, 0), 0.8), dtype=np.float32)
