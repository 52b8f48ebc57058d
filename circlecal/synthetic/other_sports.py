"""Rinks, courts and robots' fields as hard as broadcasts show them: logos up to the line, glass before the camera,
painted keys, the lines of other sports, robots on the circle.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.synthetic.decals import Decal, half_disc, plain, round_logo, word
from circlecal.synthetic.floors import (
    BLACK,
    BLUE,
    RED,
    WHITE,
    YELLOW,
    Element,
    arc,
    handball_lines,
    line,
    volleyball_lines,
)
from circlecal.synthetic.rays import Float32
from circlecal.synthetic.scene import ExtraPaint, Player, sample_player

GLASS_M, BOARDS_M = 2.9, 1.1
"""Heights of the glass and of the boards below it."""
_STANCHION_M = (1.2, 2.5)
_VEIL = 0.07
_FAR_PX = 2.0**20
_ROBOT_M = (0.4, 0.9)
_KEYS: dict[str, tuple[float, float]] = {"basketball": (5.8, 4.9), "basketball-nba": (5.79, 4.88)}
"""Depth and width of the key, metres."""


def choose_circle(template: FieldTemplate, rng: np.random.Generator) -> FieldTemplate:
    """The field with one of its circles or large arcs as the one that the view is about; a line through its middle is
    known for the centre circle only.
    """
    names = [circle.name for circle in template.circles]
    name = names[int(rng.integers(len(names)))]
    if name == template.default_circle:
        return template
    return template.model_copy(update={"default_circle": name, "halfway_line": None})


def faceoff_paint(template: FieldTemplate) -> tuple[ExtraPaint, ...]:
    """Spots, hash marks and brackets of the face-off circles, creases, and the referee's semicircle."""
    elements: list[Element] = [arc(0.0, template.width_m / 2, 3.0, 180.0, 360.0)]
    for circle in template.circles:
        if circle.name != "centre_circle":
            elements += _faceoff_marks(circle)
    for side in (-1.0, 1.0):
        x = side * (template.length_m / 2 - 3.35)
        elements.append(arc(x, 0.0, 1.83, 90.0 if side > 0 else -90.0, 270.0 if side > 0 else 90.0))
    return (ExtraPaint(tuple(elements), template.marking_width_m, RED, 0.75),)


def _faceoff_marks(circle: Circle) -> list[Element]:
    (x, y), radius = circle.center, circle.radius_m
    hashes = [
        line((x + dx, y + sign * radius), (x + dx, y + sign * (radius + 0.6)))
        for sign in (-1.0, 1.0)
        for dx in (-0.84, 0.84)
    ]
    brackets = [
        line((x + sx * 0.6, y + sy * 0.46), (x + sx * 1.8, y + sy * 0.46)) for sx in (-1.0, 1.0) for sy in (-1.0, 1.0)
    ]
    return [*hashes, *brackets]


def rink_logos(template: FieldTemplate, rng: np.random.Generator) -> tuple[Decal, ...]:
    """A logo that fills the centre circle up to the line, names about it and in the zones, blue creases."""
    middle = template.circle_by_name["centre_circle"]
    size = 2 * (middle.radius_m - template.marking_width_m * rng.uniform(-1.0, 1.0))
    crease, goal = np.array([225.0, 190.0, 130.0]), template.length_m / 2 - 3.35
    names = [
        Decal(
            word(rng),
            (float(rng.choice((-1.0, 1.0)) * rng.uniform(6.0, 22.0)), float(rng.uniform(-11.0, 11.0))),
            (float(rng.uniform(5.0, 9.0)), float(rng.uniform(3.0, 5.0))),
            float(rng.uniform(0.5, 0.9)),
        )
        for _ in range(int(rng.integers(3, 8)))
    ]
    creases = [
        Decal(half_disc(crease, towards_right=side < 0), (side * goal, 0.0), (3.66, 3.66), 0.7) for side in (-1.0, 1.0)
    ]
    return (*creases, Decal(round_logo(rng), (0.0, 0.0), (size, size), float(rng.uniform(0.5, 0.9))), *names)


def court_paint(rng: np.random.Generator) -> tuple[ExtraPaint, ...]:
    """The lines of handball and volleyball on a basketball court, each in its colour, or of neither."""
    sports = (handball_lines(), volleyball_lines())
    inks = [(WHITE, YELLOW, RED, BLUE, BLACK)[k] for k in rng.permutation(5)]
    count = int(rng.integers(0, 3))
    return tuple(
        ExtraPaint(sports[k], 0.05, inks[k], float(rng.uniform(0.5, 0.9))) for k in rng.permutation(2)[:count].tolist()
    )


def court_decals(template: FieldTemplate, rng: np.random.Generator) -> tuple[Decal, ...]:
    """Painted keys, a logo in the centre circle, mostly up to its line, names along the sides."""
    depth, width = _KEYS[template.name]
    ink = rng.uniform(20, 200, 3)
    keys = [
        Decal(plain(ink), (side * (template.length_m - depth) / 2, 0.0), (depth, width), float(rng.uniform(0.6, 0.95)))
        for side in (-1.0, 1.0)
    ]
    radius = template.circle_by_name["centre_circle"].radius_m
    size = 2 * radius * float(rng.choice((0.98, 0.98, 1.6)))
    logo = Decal(round_logo(rng), (0.0, 0.0), (size, size), float(rng.uniform(0.5, 0.95)))
    names = [
        Decal(word(rng), (float(rng.uniform(-10, 10)), side * (template.width_m / 2 + 1.0)), (6.0, 1.8), 0.9)
        for side in (-1.0, 1.0)
    ]
    return (*(keys if rng.random() < 0.8 else ()), logo, *names)


def robots(template: FieldTemplate, rng: np.random.Generator) -> tuple[Player, ...]:
    """Robots, some of them on the centre circle: as wide as they are short."""
    circle = template.circle_by_name[template.default_circle]
    turns = rng.uniform(0, 2 * np.pi, int(rng.integers(1, 4)))
    rim = circle.radius_m * rng.uniform(0.8, 1.2, (len(turns), 1)) * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    away = rng.uniform((-0.2, -0.45), (0.48, 0.45), (4, 2)) * (template.length_m, template.width_m)
    return tuple(
        replace(sample_player(place, int(rng.integers(2)), rng), height_m=float(rng.uniform(*_ROBOT_M)), width=1.0)
        for place in (*rim, *away)
    )


def draw_glass(
    light: Float32, camera: Camera, template: FieldTemplate, surface: Surface, strength: float, rng: np.random.Generator
) -> None:
    """Glass above the boards on the near side, with stanchions and a rail, over the picture (H, W, 3), in place.

    Parameters
    ----------
    light : (H, W, 3) float32
        Grey levels.
    camera, template, surface : Camera, FieldTemplate, Surface
        The view and the field.
    strength : float
        How much the stanchions hide, 0 to 1.
    rng : Generator
        Spacing and colour of the stanchions.
    """
    side = template.width_m / 2 + 0.1
    x = np.arange(-template.length_m / 2, template.length_m / 2, float(rng.uniform(*_STANCHION_M)))
    foot, head = (_lift(x, side, height) for height in (BOARDS_M, GLASS_M))
    low, high = camera.project(foot), camera.project(head)
    shown = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
    # the drawing counts in 32 bits, and what nearly lies beside the camera is far out of the picture
    ends = np.stack([low[shown], high[shown]])
    low, high = np.rint(np.clip(ends, -_FAR_PX, _FAR_PX)).astype(np.int32)
    if len(low) < 2:
        return
    pane = np.zeros(light.shape[:2], np.float32)
    cv2.fillPoly(pane, [np.concatenate([low, high[::-1]]).reshape(-1, 1, 2)], _VEIL)
    grey = np.float32(rng.uniform(150, 235))
    light += pane[..., None] * (grey - light)
    posts = np.zeros(light.shape[:2], np.float32)
    thick = max(1, round(camera.width / 640))
    for bottom, top in zip(low.tolist(), high.tolist(), strict=True):
        cv2.line(posts, bottom, top, 1.0, thick, cv2.LINE_AA)
    cv2.polylines(posts, [high.reshape(-1, 1, 2)], False, 1.0, thick, cv2.LINE_AA)
    color = np.float32(rng.choice((60.0, 225.0)))
    light += np.float32(strength) * posts[..., None] * (color - light)


def _lift(x: Array, y: float, height_m: float) -> Array:
    """Points (N, 3) above a line along the field."""
    return np.stack([x, np.full_like(x, y), np.full_like(x, -height_m)], axis=-1)
