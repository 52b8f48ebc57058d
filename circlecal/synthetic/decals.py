"""Pictures lying on the ground: logos, advertising, filled areas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array
from circlecal.synthetic.rays import Float32, PixelRays

_TEXELS = 256
_WORDS = ("CIRCLECAL", "CONIC", "POLE", "ELLIPSE FC", "HALFWAY")


@dataclass(frozen=True, slots=True)
class Decal:
    """A picture (h, w, 4) BGRA, 0..255, on the ground: middle, size along x and y, metres."""

    texture: NDArray[np.float32]
    center_m: tuple[float, float]
    size_m: tuple[float, float]
    opacity: float


def draw_decals(light: Float32, rays: PixelRays, decals: tuple[Decal, ...]) -> None:
    """Lay decals over the ground (H, W, 3), in place."""
    for decal in decals:
        u = (rays.x_m - np.float32(decal.center_m[0])) / np.float32(decal.size_m[0]) + np.float32(0.5)
        v = (rays.y_m - np.float32(decal.center_m[1])) / np.float32(decal.size_m[1]) + np.float32(0.5)
        inside = (np.abs(u - np.float32(0.5)) < 0.5) & (np.abs(v - np.float32(0.5)) < 0.5) & np.isfinite(rays.depth_m)
        rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            continue
        part = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
        # texels no finer than pixels
        coarse = float(np.median(rays.footprint_m[part][inside[part]]))
        shape = [int(np.clip(size / coarse, 8, _TEXELS)) for size in decal.size_m]
        texture = cv2.resize(decal.texture, shape, interpolation=cv2.INTER_AREA)
        seen = cv2.remap(
            texture,
            np.ascontiguousarray(u[part]) * np.float32(shape[0]) - np.float32(0.5),
            np.ascontiguousarray(v[part]) * np.float32(shape[1]) - np.float32(0.5),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        )
        alpha = seen[..., 3:] * (np.float32(decal.opacity / 255.0) * inside[part][..., None])
        light[part] += alpha * (seen[..., :3] - light[part])


def _blank() -> NDArray[Any]:
    return np.zeros((_TEXELS, _TEXELS, 4), dtype=np.uint8)


def round_logo(rng: np.random.Generator) -> NDArray[np.float32]:
    """A club's sign: discs, a band and letters."""
    canvas = _blank()
    inks = [[float(v) for v in (*rng.integers(10, 240, 3), 255)] for _ in range(3)]
    middle = (_TEXELS // 2, _TEXELS // 2)
    cv2.circle(canvas, middle, 124, inks[0], -1, cv2.LINE_AA)
    cv2.circle(canvas, middle, int(rng.integers(60, 110)), inks[1], int(rng.choice((-1, 8))), cv2.LINE_AA)
    corners = np.array(middle) + rng.uniform(-80, 80, (3, 2))
    cv2.fillConvexPoly(canvas, cv2.convexHull(corners.astype(np.int32)), inks[2], cv2.LINE_AA)
    cv2.putText(canvas, "FC", (60, 165), cv2.FONT_HERSHEY_DUPLEX, 3.4, [245.0, 245.0, 245.0, 255.0], 12, cv2.LINE_AA)
    return canvas.astype(np.float32)


def word(rng: np.random.Generator) -> NDArray[np.float32]:
    """A name in one colour without ground."""
    canvas = _blank()
    ink = [float(v) for v in (*rng.integers(10, 200, 3), 255)]
    canvas[..., :3] = np.array(ink[:3], dtype=np.uint8)
    text = _WORDS[rng.integers(len(_WORDS))]
    size, _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 1.0, 3)
    scale = 0.95 * _TEXELS / size[0]
    cv2.putText(canvas, text, (6, 150), cv2.FONT_HERSHEY_DUPLEX, scale, ink, 4, cv2.LINE_AA)
    return canvas.astype(np.float32)


def plain(bgr: Array) -> NDArray[np.float32]:
    """A filled rectangle."""
    canvas = _blank()
    canvas[...] = (*np.clip(bgr, 0, 255), 255)
    return canvas.astype(np.float32)


def disc(bgr: Array, right_bgr: Array | None = None) -> NDArray[np.float32]:
    """A disc that touches the sides of its square, its right half in another colour where one is given."""
    canvas = _blank()
    middle = _TEXELS // 2
    cv2.circle(canvas, (middle, middle), middle, [*(float(v) for v in np.clip(bgr, 0, 255)), 255.0], -1, cv2.LINE_AA)
    if right_bgr is not None:
        canvas[:, middle:, :3] = np.clip(right_bgr, 0, 255)
    return canvas.astype(np.float32)


def half_disc(bgr: Array, *, towards_right: bool) -> NDArray[np.float32]:
    """The half of a disc that lies to the right or left of its straight side, which is in the middle."""
    canvas = _blank()
    middle = _TEXELS // 2
    cv2.circle(canvas, (middle, middle), middle - 2, [*(float(v) for v in np.clip(bgr, 0, 255)), 255.0], -1)
    canvas[:, slice(None, middle) if towards_right else slice(middle, None)] = 0
    return canvas.astype(np.float32)


def rink_decals(length_m: float, rng: np.random.Generator) -> tuple[Decal, ...]:
    """Logo in the centre circle, names in the neutral zone, blue creases."""
    crease = np.array([225.0, 190.0, 130.0])
    goal = length_m / 2 - 4.0
    decals = [
        Decal(half_disc(crease, towards_right=side < 0), (side * goal, 0.0), (3.6, 3.6), 0.7) for side in (-1.0, 1.0)
    ]
    if rng.random() < 0.6:
        size = float(rng.uniform(4.0, 8.2))
        decals.append(Decal(round_logo(rng), (0.0, 0.0), (size, size), float(rng.uniform(0.4, 0.85))))
    for _ in range(int(rng.integers(0, 5))):
        x, y = rng.choice((-1.0, 1.0)) * rng.uniform(9.5, 20.0), rng.uniform(-10.0, 10.0)
        decals.append(Decal(word(rng), (float(x), float(y)), (6.0, 4.0), float(rng.uniform(0.4, 0.8))))
    return tuple(decals)


def floor_decals(rng: np.random.Generator) -> tuple[Decal, ...]:
    """Logo in the middle of a hall's floor, painted lanes of basketball."""
    decals = []
    if rng.random() < 0.3:
        ink = rng.uniform(30, 200, 3)
        decals += [Decal(plain(ink), (side * 11.1, 0.0), (5.8, 4.9), float(rng.uniform(0.5, 0.9))) for side in (-1, 1)]
    if rng.random() < 0.35:
        size = float(rng.uniform(1.6, 4.6))
        decals.append(Decal(round_logo(rng), (0.0, 0.0), (size, size), float(rng.uniform(0.5, 0.9))))
    for _ in range(int(rng.integers(0, 3))):
        x, y = rng.uniform(-15.0, 15.0), rng.choice((-1.0, 1.0)) * rng.uniform(5.0, 8.0)
        decals.append(Decal(word(rng), (float(x), float(y)), (5.0, 3.0), float(rng.uniform(0.5, 0.9))))
    return tuple(decals)


def grass_decals(length_m: float, rng: np.random.Generator) -> tuple[Decal, ...]:
    """Advertising carpets beside the goals."""
    return tuple(
        Decal(word(rng), (side * (length_m / 2 + 1.5), sign * 8.5), (3.0, 7.0), 0.9)
        for side in (-1.0, 1.0)
        for sign in (-1.0, 1.0)
    )
