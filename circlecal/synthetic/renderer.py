"""A scene to a picture and its truth."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from circlecal.geometry.camera import Camera
from circlecal.synthetic.alterations import alter
from circlecal.synthetic.backdrop import draw_surroundings
from circlecal.synthetic.decals import draw_decals
from circlecal.synthetic.delivery import deliver, weave
from circlecal.synthetic.figures import draw_figures, draw_shadows
from circlecal.synthetic.graphics import draw_graphics
from circlecal.synthetic.ground import draw_ground, light_on_ground, look_up_at, noise_texture
from circlecal.synthetic.optics import develop
from circlecal.synthetic.other_sports import draw_glass
from circlecal.synthetic.paint import PaintLayer, paint_layers
from circlecal.synthetic.rays import Float32, PixelRays, pixel_rays
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
_GAP_M = 3.0


@dataclass(frozen=True, slots=True)
class Rendering:
    """A frame (H, W, 3) BGR uint8 and its truth."""

    image: NDArray[np.uint8]
    truth: Truth


@dataclass(frozen=True, slots=True)
class Randomness:
    """What random things are drawn from; a clip renews the first two for every frame from the same seeds.

    Attributes
    ----------
    world : Generator
        Texture, wear, crowd and boards, which stay with the field, and the looks of players who have none of their own.
    graphics : Generator
        What is laid over the picture.
    sensor : Generator
        Noise, and rain or snow.
    """

    world: np.random.Generator
    graphics: np.random.Generator
    sensor: np.random.Generator


def render(scene: Scene, rng: np.random.Generator | Randomness) -> Rendering:
    """Draw a scene.

    Paint is composited in the picture's own grey levels, so that the half-way level of an edge lies on the edge.
    ``rng`` draws texture, noise, wear, crowd and the looks of the players; all else is the scene's. The truth of an
    interlaced frame is that of the moment between its two fields.
    """
    chance = Randomness(rng, rng, rng) if isinstance(rng, np.random.Generator) else rng
    pan_px = scene.delivery.interlace_px
    if pan_px == 0.0:
        image, layers, hidden = _expose(scene, chance)
    else:
        again = copy.deepcopy(chance)
        top, _, _ = _expose(replace(scene, camera=_pan(scene.camera, -pan_px / 2)), chance)
        bottom, _, hidden = _expose(replace(scene, camera=_pan(scene.camera, pan_px / 2)), again)
        image, layers = weave(top, bottom), _layers(scene)
    draw_graphics(image, hidden, scene, chance.graphics)
    image, truth = deliver(image, truth_of(scene, layers, hidden), scene.delivery)
    return Rendering(*alter(image, truth, scene.alteration, chance.graphics))


def _expose(scene: Scene, chance: Randomness) -> tuple[NDArray[np.uint8], list[PaintLayer], Float32]:
    """Picture (H, W, 3) of one moment, the paint in it, and what hides that (H, W), 0..1."""
    config, rng = scene.config, chance.world
    rays = pixel_rays(scene.camera, scene.surface)
    layers = _layers(scene)
    light = draw_ground(rays, config, rng)
    draw_decals(light, rays, scene.decals)
    _draw_extras(light, scene)
    _draw_paint(light, layers, rays, config, rng)
    shine = light_on_ground(rays, config, rng)
    if shine is not None:
        light *= shine[..., None]
    draw_surroundings(light, rays, scene, rng)
    if config.haze:
        share = np.float32(config.haze) * np.clip(rays.depth_m / np.float32(_HAZE_REACH_M), 0.0, 1.0)
        light += share[..., None] * (_HAZE_BGR - light)
    draw_shadows(light, scene, shine)
    hidden = draw_figures(light, scene, rng, shine)
    if config.glass:
        draw_glass(light, scene.camera, scene.template, scene.surface, config.glass, rng)
    image = develop(light, config, chance.sensor)
    return image, layers, hidden


def _pan(camera: Camera, shift_px: float) -> Camera:
    turn = shift_px / float(camera.focal_px[0] * max(np.sin(camera.angles_rad[1]), 0.1))
    return replace(camera, angles_rad=camera.angles_rad + np.array([turn, 0.0, 0.0]))


def _layers(scene: Scene) -> list[PaintLayer]:
    mark = center_mark_name(scene.template)
    skipped = frozenset() if scene.center_mark_painted or mark is None else frozenset({mark})
    return paint_layers(
        scene.camera,
        scene.painted or scene.template,
        scene.surface,
        scene.config.marking_width_m,
        skipped,
        widths_m=scene.widths_m,
        elements=None if scene.field_painted else (),
    )


def _draw_extras(light: Float32, scene: Scene) -> None:
    """Lay paint that is no marking of the field over the ground, in place."""
    for extra in scene.extras:
        color = np.asarray(extra.bgr, dtype=np.float32)
        for layer in paint_layers(scene.camera, scene.template, scene.surface, extra.width_m, elements=extra.elements):
            at = (layer.rows, layer.columns)
            light[at] += (extra.opacity * layer.coverage[:, None]).astype(np.float32) * (color - light[at])


def _draw_paint(
    light: Float32, layers: list[PaintLayer], rays: PixelRays, config: RenderConfig, rng: np.random.Generator
) -> None:
    """Lay the paint over the ground, in place; where markings cross, paint lies on paint."""
    worn = noise_texture(rng) if config.wear else None
    gaps = noise_texture(rng) if config.line_gaps else None
    for layer in layers:
        at = (layer.rows, layer.columns)
        alpha = config.paint_opacity * layer.coverage
        x, y = rays.x_m[at], rays.y_m[at]
        if worn is not None:
            loss = look_up_at(worn, x / np.float32(config.wear_scale_m), y / np.float32(config.wear_scale_m))
            alpha = alpha * (1.0 - config.wear * np.clip(0.5 + 0.45 * loss, 0.0, 1.0))
        if gaps is not None:
            level = ndtri(config.line_gaps)
            alpha = alpha * np.clip(0.5 + 3.0 * (look_up_at(gaps, x / _GAP_M, y / _GAP_M) - level), 0.0, 1.0)
        color = np.asarray(_PAINT_BGR.get(layer.color, config.paint_bgr), dtype=np.float32)
        light[at] += alpha[:, None].astype(np.float32) * (color - light[at])
