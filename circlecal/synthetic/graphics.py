"""What a control room lays over the picture: score, captions, logos, an analyst's drawings, wipes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array
from circlecal.synthetic.rays import Float32
from circlecal.synthetic.scene import Color, Scene

Picture = NDArray[np.uint8]

_SHIFT = 4
_FONT = cv2.FONT_HERSHEY_DUPLEX
_HIDING_ALPHA = 0.35
_INKS: tuple[Color, ...] = ((245, 245, 245), (60, 235, 250), (60, 60, 235), (235, 190, 60), (40, 200, 60))
_WORDS = ("LIVE", "SUBSTITUTION", "POSSESSION  54 : 46", "GOAL KICK", "SHOTS ON TARGET", "YELLOW CARD", "SCOUT VIEW")


class _Layer:
    """A transparent sheet (H, W, 3) that is drawn on and then laid over the picture."""

    def __init__(self, image: Picture) -> None:
        self.height, self.width = image.shape[:2]
        self.unit = self.width / 1920.0
        self.ink: NDArray[Any] = np.zeros((self.height, self.width, 3), dtype=np.uint8)
        self.cover: NDArray[Any] = np.zeros((self.height, self.width), dtype=np.uint8)

    def draw(self, call: Callable[[NDArray[Any], Any], object], bgr: Color, opacity: float = 1.0) -> None:
        """Draw with ``call(sheet, value)`` in a colour."""
        call(self.ink, [float(v) for v in bgr])
        call(self.cover, 255.0 * opacity)

    def box(self, box: tuple[float, float, float, float], bgr: Color, opacity: float = 1.0) -> None:
        """Filled rectangle; shares of the width and of the height."""
        x0, y0, x1, y1 = box
        low, high = (round(x0 * self.width), round(y0 * self.height)), (round(x1 * self.width), round(y1 * self.height))
        self.draw(lambda sheet, value: cv2.rectangle(sheet, low, high, value, -1), bgr, opacity)

    def text(self, words: str, x: float, y: float, size: float, bgr: Color, opacity: float = 1.0) -> None:
        """Words from a point, shares of width and height; ``size`` in shares of the height."""
        scale = size * self.height / 22.0
        at, thickness = (round(x * self.width), round(y * self.height)), max(1, round(1.6 * scale))
        self.draw(
            lambda sheet, value: cv2.putText(sheet, words, at, _FONT, scale, value, thickness, cv2.LINE_AA),
            bgr,
            opacity,
        )

    def curve(self, pixels: Array, bgr: Color, thickness: float, opacity: float = 1.0, *, closed: bool = True) -> None:
        """Polyline (N, 2) in pixels."""
        if not np.isfinite(pixels).all() or np.abs(pixels).max() > 20000:
            return
        points = [np.round(pixels * 2**_SHIFT).astype(np.int32).reshape(-1, 1, 2)]
        wide = max(1, round(thickness * self.unit))
        self.draw(
            lambda sheet, value: cv2.polylines(sheet, points, closed, value, wide, cv2.LINE_AA, _SHIFT), bgr, opacity
        )

    def lay(self, image: Picture, hidden: Float32) -> None:
        """Lay the sheet over the picture, in place."""
        rows = np.flatnonzero(self.cover.any(axis=1))
        if len(rows) == 0:
            return
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        alpha = self.cover[part].astype(np.float32) / 255.0
        mixed = image[part] + alpha[..., None] * (self.ink[part].astype(np.float32) - image[part])
        image[part] = np.rint(mixed).astype(np.uint8)
        hidden[part] = np.maximum(hidden[part], alpha > _HIDING_ALPHA)


def draw_graphics(image: Picture, hidden: Float32, scene: Scene, rng: np.random.Generator) -> None:
    """Draw what the look asks for over a picture (H, W, 3), in place; what it hides goes into ``hidden`` (H, W)."""
    config = scene.config
    graphics = config.graphics
    layer = _Layer(image)
    for _ in range(graphics.rings):
        _ring(layer, scene, rng)
    for _ in range(graphics.drawn_lines):
        _draw_line(layer, scene, rng)
    if config.scorebug:
        _scorebug(layer, rng)
    if graphics.logo:
        _logo(layer, rng)
    if graphics.lower_third:
        _lower_third(layer, rng)
    if graphics.watermark:
        _watermark(layer, rng)
    if graphics.ticker:
        _ticker(layer, rng)
    for _ in range(graphics.banners):
        _banner(layer, rng)
    if graphics.wipe:
        _wipe(layer, graphics.wipe, rng)
    if graphics.board:
        _board(layer, rng)
    layer.lay(image, hidden)


def _any(rng: np.random.Generator) -> Color:
    b, g, r = (float(v) for v in rng.integers(15, 240, 3))
    return b, g, r


def _deep(rng: np.random.Generator) -> Color:
    b, g, r = (float(v) for v in rng.integers(10, 130, 3))
    return b, g, r


def _scorebug(layer: _Layer, rng: np.random.Generator) -> None:
    minute, second, home, away = (int(rng.integers(n)) for n in (90, 60, 5, 5))
    x = 0.05 if rng.random() < 0.75 else 0.62
    layer.box((x, 0.05, x + 0.285, 0.093), _deep(rng))
    layer.box((x, 0.05, x + 0.09, 0.093), (240, 240, 240))
    layer.text(f"{minute:02d}:{second:02d}", x + 0.012, 0.083, 0.022, (30, 30, 30))
    layer.text(f"HOM  {home} - {away}  AWY", x + 0.105, 0.083, 0.022, (245, 245, 245))


def _logo(layer: _Layer, rng: np.random.Generator) -> None:
    """A channel's sign in an upper corner, often round."""
    radius = rng.uniform(28, 55) * layer.unit
    x, y = (layer.width * rng.choice((0.9, 0.93, 0.07)), layer.height * rng.uniform(0.08, 0.13))
    opacity = float(rng.uniform(0.5, 1.0))
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    rim = np.array([x, y]) + radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    ink = _INKS[rng.integers(2)]
    if rng.random() < 0.6:
        layer.curve(rim, ink, 6, opacity)
        layer.curve((rim - (x, y)) * 0.6 + (x, y), ink, 4, opacity)
    else:
        layer.box(
            (x / layer.width - 0.035, y / layer.height - 0.03, x / layer.width + 0.035, y / layer.height + 0.03),
            _deep(rng),
            opacity,
        )
    layer.text("CC", (x - 0.5 * radius) / layer.width, (y + 0.2 * radius) / layer.height, 0.02, (245, 245, 245))


def _lower_third(layer: _Layer, rng: np.random.Generator) -> None:
    top, height = rng.uniform(0.78, 0.86), rng.uniform(0.06, 0.1)
    left, right = rng.uniform(0.06, 0.3), rng.uniform(0.55, 0.94)
    layer.box((left, top, right, top + height), _deep(rng), float(rng.uniform(0.75, 1.0)))
    layer.box((left, top + 0.75 * height, right, top + height), _any(rng))
    layer.text(_WORDS[rng.integers(len(_WORDS))], left + 0.02, top + 0.6 * height, 0.4 * height, (245, 245, 245))


def _ticker(layer: _Layer, rng: np.random.Generator) -> None:
    top = rng.uniform(0.9, 0.94)
    layer.box((0.0, top, 1.0, 1.0), _deep(rng))
    layer.text("  ".join(rng.permutation(_WORDS)), 0.01, top + 0.045, 0.028, (245, 245, 245))


def _banner(layer: _Layer, rng: np.random.Generator) -> None:
    """A level band at any height, mostly as wide as the picture: its edges are straight and stand still."""
    top, height = float(rng.uniform(0.02, 0.93)), float(rng.uniform(0.04, 0.16))
    left, right = (0.0, 1.0) if rng.random() < 0.7 else (float(rng.uniform(0.0, 0.2)), float(rng.uniform(0.6, 1.0)))
    layer.box((left, top, right, top + height), _any(rng) if rng.random() < 0.5 else _deep(rng), 1.0)
    if rng.random() < 0.5:
        layer.box((left, top, right, top + 0.06 * height), (245, 245, 245))
    layer.text(_WORDS[rng.integers(len(_WORDS))], left + 0.1, top + 0.7 * height, 0.4 * height, (245, 245, 245))


def _watermark(layer: _Layer, rng: np.random.Generator) -> None:
    x, y = rng.uniform(0.55, 0.7), rng.choice((0.08, 0.93))
    layer.text("SCOUT VIEW", float(x), float(y), 0.04, (235, 235, 235), float(rng.uniform(0.3, 0.6)))


def _ring(layer: _Layer, scene: Scene, rng: np.random.Generator) -> None:
    """A ring on the ground around one player or a group, as analysts draw it."""
    if not scene.players:
        return
    spot = scene.players[rng.integers(len(scene.players))].position_m
    radius = rng.uniform(0.9, 1.6) if rng.random() < 0.6 else rng.uniform(2.5, 7.0)
    turn = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    oval = np.stack([np.cos(turn), rng.uniform(0.6, 1.0) * np.sin(turn)], axis=-1)
    pixels = scene.camera.project(scene.surface.lift(spot + radius * oval))
    layer.curve(pixels, _INKS[rng.integers(len(_INKS))], rng.uniform(4, 9), float(rng.uniform(0.6, 1.0)))


def _draw_line(layer: _Layer, scene: Scene, rng: np.random.Generator) -> None:
    """A line across the field for offside, or an arrow between two players."""
    ink = _INKS[rng.integers(len(_INKS))]
    thick, opacity = rng.uniform(3, 8), float(rng.uniform(0.6, 1.0))
    half = scene.template.width_m / 2
    if rng.random() < 0.5 or len(scene.players) < 2:
        x = rng.uniform(-0.4, 0.4) * scene.template.length_m
        y = np.linspace(-half, half, 60)
        pixels = scene.camera.project(scene.surface.lift(np.stack([np.full(60, x), y], axis=-1)))
        pixels = pixels[(np.abs(pixels) < 20000).all(axis=1)]
        if len(pixels) > 1:
            layer.curve(pixels, ink, thick, opacity, closed=False)
        return
    first, second = rng.choice(len(scene.players), 2, replace=False)
    ends = np.array([scene.players[first].position_m, scene.players[second].position_m])
    start, end = scene.camera.project(scene.surface.lift(ends))
    along = end - start
    aside = np.array([-along[1], along[0]])
    tip = np.array([end - 0.1 * along + 0.05 * aside, end, end - 0.1 * along - 0.05 * aside])
    layer.curve(np.array([start, end]), ink, thick, opacity, closed=False)
    layer.curve(tip, ink, thick, opacity, closed=False)


def _wipe(layer: _Layer, share: float, rng: np.random.Generator) -> None:
    """The moving sign between live picture and replay: a slanted sheet with rings and words on it."""
    width = share * 1.3
    left = rng.uniform(-0.1, max(0.0, 1.05 - width))
    slant = rng.uniform(-0.25, 0.25)
    corners = np.array([[left + slant, 0], [left + width + slant, 0], [left + width - slant, 1], [left - slant, 1]])
    sheet = np.round(corners * (layer.width, layer.height)).astype(np.int32)
    layer.draw(lambda canvas, value: cv2.fillConvexPoly(canvas, sheet, value, cv2.LINE_AA), _any(rng))
    middle = np.array([(left + width / 2) * layer.width, 0.5 * layer.height])
    turn = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    oval = np.stack([np.cos(turn), rng.uniform(0.3, 1.0) * np.sin(turn)], axis=-1) * 0.3 * layer.height
    ink = _INKS[rng.integers(len(_INKS))]
    for size in rng.uniform(0.5, 1.1, rng.integers(1, 4)):
        layer.curve(middle + size * oval, ink, rng.uniform(5, 30))
    layer.text("REPLAY", float(middle[0]) / layer.width - 0.08, 0.52, 0.06, (250, 250, 250))


def _board(layer: _Layer, rng: np.random.Generator) -> None:
    """A full screen of names or figures over the dimmed picture."""
    left, right = rng.uniform(0.1, 0.3), rng.uniform(0.7, 0.9)
    layer.box((0.0, 0.0, 1.0, 1.0), _deep(rng), float(rng.uniform(0.5, 0.9)))
    layer.box((left, 0.12, right, 0.9), _deep(rng), 0.95)
    rows = int(rng.integers(6, 12))
    step = 0.72 / rows
    for row in range(rows):
        y = 0.16 + row * step
        if row % 2 == 0:
            layer.box((left, y, right, y + step), _deep(rng), 0.95)
        words = f"{int(rng.integers(1, 40)):>2}  " + str(rng.choice(_WORDS))
        layer.text(words, left + 0.03, y + 0.7 * step, 0.4 * step, (240, 240, 240))
    turn = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    center = np.array([rng.uniform(0.3, 0.7) * layer.width, rng.uniform(0.1, 0.3) * layer.height])
    crest = center + rng.uniform(40, 110) * layer.unit * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    layer.curve(crest, _INKS[rng.integers(2)], 8)
