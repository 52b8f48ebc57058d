"""Goals with their nets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array
from circlecal.synthetic.rays import Float32
from circlecal.synthetic.scene import Color, Scene

_SHIFT = 4
_SPARE_PX = 6
_NET_ALPHA = 0.4
_LARGEST_PX = 20000.0


@dataclass(frozen=True, slots=True)
class _Goal:
    """Size in metres: half the width, height, thickness of the posts, depth of the net above and below."""

    half: float
    height: float
    post: float
    depth_top: float
    depth_bottom: float
    mesh: float
    bgr: Color
    from_end: float = 0.0


_GOALS: dict[str, _Goal] = {
    "soccer": _Goal(3.66, 2.44, 0.12, 0.9, 2.0, 0.18, (235, 235, 235)),
    "futsal": _Goal(1.5, 2.0, 0.08, 0.8, 1.0, 0.15, (225, 228, 228)),
    "ice-hockey": _Goal(0.915, 1.22, 0.06, 0.5, 1.1, 0.1, (45, 40, 190), from_end=4.0),
}


def draw_goals(picture: Float32, hidden: Float32, scene: Scene) -> None:
    """Draw both goals of a field over a picture (H, W, 3), in place; posts go into ``hidden`` (H, W)."""
    goal = _GOALS.get(scene.template.name)
    if goal is None or not scene.field_painted:
        return
    for side in (-1.0, 1.0):
        line = side * (scene.template.length_m / 2 - goal.from_end)
        _lay(picture, None, scene, _net(goal, line, side), 1, (215.0, 218.0, 218.0), _NET_ALPHA)
        x = line - side * goal.post / 2
        frame = np.array(
            [[x, -goal.half, 0], [x, -goal.half, -goal.height], [x, goal.half, -goal.height], [x, goal.half, 0]]
        )
        depth = max(float(scene.camera.depth(frame[1])), 1.0)
        thickness = max(1, round(float(goal.post * scene.camera.focal_px[0] / depth)))
        _lay(picture, hidden, scene, frame[None], thickness, goal.bgr, 1.0)


def _net(goal: _Goal, line: float, side: float) -> Array:
    """Strings (N, 2, 3) of the net: roof, back and both sides."""
    top, bottom = line + side * goal.depth_top, line + side * goal.depth_bottom
    w, h = goal.half, -goal.height
    panels = [
        ((line, -w, h), (line, w, h), (top, -w, h), (top, w, h)),
        ((top, -w, h), (top, w, h), (bottom, -w, 0.0), (bottom, w, 0.0)),
        ((line, -w, h), (top, -w, h), (line, -w, 0.0), (bottom, -w, 0.0)),
        ((line, w, h), (top, w, h), (line, w, 0.0), (bottom, w, 0.0)),
    ]
    return np.concatenate([_mesh(np.array(panel), goal.mesh) for panel in panels])


def _mesh(corners: Array, step: float) -> Array:
    """Strings (N, 2, 3) across a panel with corners (4, 3): upper two, lower two."""
    a, b, c, d = corners
    across = np.linspace(0, 1, max(2, int(np.linalg.norm(b - a) / step)))[:, None]
    down = np.linspace(0, 1, max(2, int(np.linalg.norm(c - a) / step)))[:, None]
    upright = np.stack([a + across * (b - a), c + across * (d - c)], axis=1)
    level = np.stack([a + down * (c - a), b + down * (d - b)], axis=1)
    return np.concatenate([upright, level])


def _lay(
    picture: Float32, hidden: Float32 | None, scene: Scene, lines: Array, thickness: int, bgr: Color, opacity: float
) -> None:
    """Draw polylines (N, K, 3) in metres over the picture, in place."""
    pixels = scene.camera.project(lines)
    with np.errstate(invalid="ignore"):
        good = (np.abs(pixels) < _LARGEST_PX).all(axis=(1, 2))
    if not good.any():
        return
    pixels = pixels[good]
    size = np.array([scene.camera.width, scene.camera.height])
    low = np.clip(np.floor(pixels.min(axis=(0, 1))).astype(int) - thickness - _SPARE_PX, 0, size)
    high = np.clip(np.ceil(pixels.max(axis=(0, 1))).astype(int) + thickness + _SPARE_PX, low, size)
    canvas: NDArray[Any] = np.zeros((high - low)[::-1], dtype=np.uint8)
    if not canvas.size:
        return
    points = np.round((pixels - low) * 2**_SHIFT).astype(np.int32)
    cv2.polylines(canvas, list(points[:, :, None]), False, 255.0, thickness, cv2.LINE_AA, _SHIFT)
    alpha = canvas.astype(np.float32) * np.float32(opacity / 255.0)
    window = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
    picture[window] += alpha[..., None] * (np.asarray(bgr, dtype=np.float32) - picture[window])
    if hidden is not None:
        hidden[window] = np.maximum(hidden[window], alpha)
