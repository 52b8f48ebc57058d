"""A scene to a picture and its truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.synthetic.backdrop import (
    Float32,
    PixelRays,
    draw_surroundings,
    draw_turf,
    looked_up_at,
    noise_texture,
    pixel_rays,
)
from circlecal.synthetic.figures import draw_figures, draw_shadows
from circlecal.synthetic.optics import develop
from circlecal.synthetic.paint import PaintLayer, paint_layers
from circlecal.synthetic.scene import RenderConfig, Scene
from circlecal.synthetic.truth import Truth, center_mark_name, truth_of

_PAINT_BGR: dict[str, tuple[float, float, float]] = {
    "dark": (35.0, 32.0, 30.0),
    "red": (40.0, 35.0, 190.0),
    "blue": (180.0, 80.0, 30.0),
    "yellow": (40.0, 200.0, 225.0),
}
_HAZE_BGR = np.array([150.0, 155.0, 150.0], dtype=np.float32)
_HAZE_REACH_M = 120.0


@dataclass(frozen=True, slots=True)
class Rendering:
    """A frame (H, W, 3) BGR uint8 and its truth."""

    image: NDArray[np.uint8]
    truth: Truth


def render(scene: Scene, rng: np.random.Generator) -> Rendering:
    """Draw a scene.

    Paint is composited in the picture's own grey levels, so that the half-way level of an edge lies on the edge.
    ``rng`` draws texture, noise, wear, crowd and the looks of the players; all else is the scene's.
    """
    config = scene.config
    rays = pixel_rays(scene.camera, scene.surface)
    layers = paint_layers(scene.camera, scene.template, scene.surface, config.marking_width_m, _unpainted(scene))
    light = draw_turf(rays, scene.camera, config, rng)
    _draw_paint(light, layers, rays, config, rng)
    draw_surroundings(light, rays, scene, rng)
    if config.haze:
        share = config.haze * np.clip(rays.depth_m / _HAZE_REACH_M, 0.0, 1.0)
        light += share[..., None] * (_HAZE_BGR - light)
    draw_shadows(light, scene)
    hidden = draw_figures(light, scene, rng)
    image = develop(light, config, rng)
    if config.scorebug:
        _draw_scorebug(image, hidden, rng)
    return Rendering(image, truth_of(scene, layers, hidden))


def _unpainted(scene: Scene) -> frozenset[str]:
    mark = center_mark_name(scene.template)
    return frozenset() if scene.center_mark_painted or mark is None else frozenset({mark})


def _draw_paint(
    light: Float32, layers: list[PaintLayer], rays: PixelRays, config: RenderConfig, rng: np.random.Generator
) -> None:
    """Lay the paint over the turf, in place; where markings cross, paint lies on paint."""
    worn = noise_texture(rng) if config.wear else None
    # paint in the shade is as dark as the turf around it
    gain = _shade(rays, config)
    for layer in layers:
        at = (layer.rows, layer.columns)
        alpha = config.paint_opacity * layer.coverage
        if worn is not None:
            x, y = rays.ground_m[at].T / np.float32(config.wear_scale_m)
            loss = looked_up_at(worn, x, y)
            alpha = alpha * (1.0 - config.wear * np.clip(0.5 + 0.45 * loss, 0.0, 1.0))
        color = np.asarray(_PAINT_BGR.get(layer.color, config.paint_bgr), dtype=np.float32) * gain[at][:, None]
        light[at] += alpha[:, None].astype(np.float32) * (color - light[at])


def _shade(rays: PixelRays, config: RenderConfig) -> Float32:
    if not config.shade:
        return np.ones(rays.depth_m.shape, dtype=np.float32)
    inside = (config.shade_edge_m + config.shade_tilt * rays.ground_m[..., 0]) - rays.ground_m[..., 1]
    return np.asarray(1.0 - config.shade * np.clip(inside / 0.4 + 0.5, 0.0, 1.0), dtype=np.float32)


def _draw_scorebug(image: NDArray[np.uint8], hidden: Float32, rng: np.random.Generator) -> None:
    unit = image.shape[1] / 1920.0
    left, top, right, bottom = (round(v * unit) for v in (95, 54, 640, 100))
    canvas: NDArray[Any] = image
    dark = [int(v) for v in rng.integers(20, 110, 3)]
    cv2.rectangle(canvas, (left, top), (right, bottom), dark, -1)
    cv2.rectangle(canvas, (left, top), (left + round(175 * unit), bottom), (240, 240, 240), -1)
    minute, second, home, away = (int(rng.integers(n)) for n in (90, 60, 5, 5))
    for text, x, ink in (
        (f"{minute:02d}:{second:02d}", 20, (30, 30, 30)),
        (f"HOM  {home} - {away}  AWY", 200, (245, 245, 245)),
    ):
        origin = (left + round(x * unit), bottom - round(12 * unit))
        cv2.putText(
            canvas, text, origin, cv2.FONT_HERSHEY_DUPLEX, 1.1 * unit, ink, max(1, round(2 * unit)), cv2.LINE_AA
        )
    hidden[top : bottom + 1, left : right + 1] = 1.0
