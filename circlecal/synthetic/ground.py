"""The playing surface without its markings, and the light on it: turf, ice or a wooden floor."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.synthetic.rays import FAR_M, Float32, PixelRays
from circlecal.synthetic.recall import recall
from circlecal.synthetic.scene import RenderConfig

_LIST_COLUMNS = 1024  # OpenCV's remap takes no picture wider than 32767
_TURF_OCTAVES_M = ((0.12, 0.8), (0.5, 0.45), (2.5, 0.25))
_PATCH_M = 9.0
_ICE_OCTAVES_M = ((0.35, 0.6), (3.0, 1.0))
_PLANK_M = (2.2, 0.09)
_POOL_M = 26.0
_SUN_PATCH_M = (7.0, 2.5)
_COARSE_STRIDE = 4


@recall(16)
def noise_texture(rng: np.random.Generator) -> Float32:
    """Periodic smooth noise (256, 256), mean 0 and standard deviation 1."""
    size = 256
    white = rng.standard_normal((size, size), dtype=np.float32)
    tiled = cv2.GaussianBlur(np.tile(white, (3, 3)), (0, 0), 1.0)[size : 2 * size, size : 2 * size]
    return np.asarray((tiled - tiled.mean()) / tiled.std(), dtype=np.float32)


def look_up(texture: NDArray[Any], u: Float32, v: Float32) -> Float32:
    """A periodic texture at texel coordinates."""
    return np.asarray(cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP), dtype=np.float32)


def look_up_at(texture: Float32, u: Float32, v: Float32) -> Float32:
    """A periodic texture at a list of texel coordinates (N,), of any length."""
    spare = -len(u) % _LIST_COLUMNS
    u_grid, v_grid = (np.pad(c, (0, spare)).reshape(-1, _LIST_COLUMNS).astype(np.float32) for c in (u, v))
    return look_up(texture, u_grid, v_grid).reshape(-1)[: len(u)]


def draw_ground(rays: PixelRays, config: RenderConfig, rng: np.random.Generator) -> Float32:
    """Surface (H, W, 3) of the whole plane in even light."""
    if config.ground == "ice":
        return _ice(rays, config, rng)
    if config.ground == "wood":
        return _wood(rays, config, rng)
    return _turf(rays, config, rng)


def light_on_ground(rays: PixelRays, config: RenderConfig, rng: np.random.Generator) -> Float32 | None:
    """Light (H, W) on the ground, 1 where nothing takes it away: shade of the stands, pools of floodlights."""
    light: Float32 | None = None
    if config.shade:
        light = 1.0 - np.float32(config.shade) * _shade(rays, config, rng)
    if config.light_pools:
        pools = _coarsely(noise_texture(rng), rays, (_POOL_M, _POOL_M))
        dimmed = 1.0 - np.float32(config.light_pools) * np.clip(0.5 + 0.5 * pools, 0.0, 1.0)
        light = dimmed if light is None else light * dimmed
    return light


def _shade(rays: PixelRays, config: RenderConfig, rng: np.random.Generator) -> Float32:
    inside = np.float32(config.shade_edge_m) + np.float32(config.shade_tilt) * rays.x_m - rays.y_m
    share = np.clip(inside / np.float32(config.shade_soft_m) + 0.5, 0.0, 1.0)
    if config.shade_depth_m < FAR_M:
        share *= np.clip((np.float32(config.shade_depth_m) - inside) / np.float32(config.shade_soft_m) + 0.5, 0.0, 1.0)
    if config.sun_patches:
        gaps = _coarsely(noise_texture(rng), rays, _SUN_PATCH_M)
        level = np.float32(1.6 - 1.4 * config.sun_patches)
        share *= 1.0 - np.clip(4.0 * (gaps - level), 0.0, 1.0)
    return np.asarray(share, dtype=np.float32)


def _coarsely(texture: Float32, rays: PixelRays, size_m: tuple[float, float]) -> Float32:
    """A texture of wide features, looked up at every fourth pixel."""
    part = (slice(None, None, _COARSE_STRIDE), slice(None, None, _COARSE_STRIDE))
    u, v = (np.ascontiguousarray(c[part]) / np.float32(s) for c, s in zip((rays.x_m, rays.y_m), size_m, strict=True))
    height, width = rays.depth_m.shape
    return np.asarray(cv2.resize(look_up(texture, u, v), (width, height)), dtype=np.float32)


def _turf(rays: PixelRays, config: RenderConfig, rng: np.random.Generator) -> Float32:
    light = 1.0 + np.float32(config.stripe_contrast) * _mowing_pattern(rays, config)
    if config.texture:
        _add_octaves(light, rays, _TURF_OCTAVES_M, config.texture, rng)
    dry = None
    if config.patchiness:
        dry = np.float32(config.patchiness) * _coarsely(noise_texture(rng), rays, (_PATCH_M, _PATCH_M))
    return _tint(light, config.turf_bgr, dry, (-0.6, 0.5, 1.4))


def _ice(rays: PixelRays, config: RenderConfig, rng: np.random.Generator) -> Float32:
    """Ice: nearly even, scratched, with the lamps of the hall blurred in it."""
    light = np.ones(rays.depth_m.shape, dtype=np.float32)
    _add_octaves(light, rays, _ICE_OCTAVES_M, 0.5 * config.texture, rng)
    scratches = look_up(noise_texture(rng), rays.x_m / np.float32(1.1), rays.y_m / np.float32(0.16))
    light += np.float32(0.5 * config.texture) * scratches * np.clip(np.float32(0.16) / rays.footprint_m, 0.0, 1.0)
    light += np.float32(config.gloss) * _lamps(rays, config, rng, blur_m=1.6)
    return _tint(light, config.turf_bgr, None, (0.0, 0.0, 0.0))


def _wood(rays: PixelRays, config: RenderConfig, rng: np.random.Generator) -> Float32:
    """Planks along the field, each of its own tone, and the lamps mirrored in the varnish."""
    light = np.ones(rays.depth_m.shape, dtype=np.float32)
    along, across = (np.float32(v) for v in _PLANK_M)
    planks = look_up(noise_texture(rng), rays.x_m / along, rays.y_m / across)
    light += np.float32(2.2 * config.texture) * planks * np.clip(across / rays.footprint_m, 0.05, 1.0)
    warm = np.float32(config.patchiness) * _coarsely(noise_texture(rng), rays, (3.0, 0.8))
    light += np.float32(config.gloss) * _lamps(rays, config, rng, blur_m=0.5)
    return _tint(light, config.turf_bgr, warm, (1.2, 0.3, -0.6))


def _lamps(rays: PixelRays, config: RenderConfig, rng: np.random.Generator, blur_m: float) -> Float32:
    """Mirror image (H, W), 0..1, of rows of lamps under the roof."""
    lamps: NDArray[Any] = np.zeros((128, 128), dtype=np.float32)
    lamps[4::20, 4::12] = lamps[4::20, 5::12] = lamps[4::20, 3::12] = 1.0
    lamps = cv2.GaussianBlur(np.tile(lamps, (3, 3)), (0, 0), 0.6 + blur_m)[128:256, 128:256]
    lamps = lamps / float(lamps.max())
    part = (slice(None, None, _COARSE_STRIDE), slice(None, None, _COARSE_STRIDE))
    down = np.maximum(rays.directions[2][part], np.float32(0.02))
    roof = np.float32(config.roof_m) / down
    shift = rng.uniform(0, 64, 2).astype(np.float32)
    u = rays.x_m[part] + roof * rays.directions[0][part] + shift[0]
    v = rays.y_m[part] + roof * rays.directions[1][part] + shift[1]
    seen = look_up(lamps, u, v)
    height, width = rays.depth_m.shape
    return np.asarray(cv2.resize(seen, (width, height)), dtype=np.float32)


def _add_octaves(
    light: Float32,
    rays: PixelRays,
    octaves_m: tuple[tuple[float, float], ...],
    strength: float,
    rng: np.random.Generator,
) -> None:
    """Add noise of several sizes, in place; what is smaller than a pixel fades."""
    for size, weight in octaves_m:
        texture = noise_texture(rng)
        if size > 1.0:
            light += np.float32(strength * weight) * _coarsely(texture, rays, (size, size))
            continue
        # rows so far away that less than a tenth is left are not looked at
        rows = np.flatnonzero(rays.footprint_m.min(axis=1) < 10.0 * size)
        if len(rows) == 0:
            continue
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        inverse = np.float32(1.0 / size)
        grain = look_up(texture, rays.x_m[part] * inverse, rays.y_m[part] * inverse)
        grain *= np.minimum(np.float32(size) / rays.footprint_m[part], np.float32(1.0))
        light[part] += np.float32(strength * weight) * grain


def _tint(
    light: Float32, bgr: tuple[float, float, float], change: Float32 | None, tint: tuple[float, float, float]
) -> Float32:
    """Surface (H, W, 3) from its brightness and a change (H, W) that goes into each channel as much as ``tint``."""
    planes = [light * np.float32(c) for c in bgr]
    if change is not None:
        for plane, share in zip(planes, tint, strict=True):
            plane *= 1.0 + np.float32(share) * change
    return np.asarray(cv2.merge(planes), dtype=np.float32)


def _mowing_pattern(rays: PixelRays, config: RenderConfig) -> Float32:
    if config.stripe_contrast == 0.0:
        return np.zeros(rays.depth_m.shape, dtype=np.float32)
    step = np.float32(np.pi / config.stripe_width_m)

    def wave(coordinate: Float32) -> Float32:
        return np.asarray(np.tanh(np.float32(6.0) * np.sin(step * coordinate)), dtype=np.float32)

    if config.mown_rings:
        return wave(np.hypot(rays.x_m, rays.y_m))
    c, s = np.float32(np.cos(config.stripe_rad)), np.float32(np.sin(config.stripe_rad))
    x, y = (rays.x_m, rays.y_m) if s == 0 else (c * rays.x_m + s * rays.y_m, c * rays.y_m - s * rays.x_m)
    return wave(x) * wave(y) if config.cross_stripes else wave(x)
