"""Where the ray of every pixel meets the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface

Float32 = NDArray[np.float32]

FAR_M = 400.0
CROWN_ENDS_M = (60.0, 45.0)
"""Beyond these |x| and |y|, metres, which the largest field reaches, the ground goes on level."""
_COARSE_PX = 8
_CROWN_ROUNDS = 4
_LEAST_DESCENT = 1e-6


@dataclass(frozen=True, slots=True)
class PixelRays:
    """Rays of all pixels in float32.

    Attributes
    ----------
    directions : (3, H, W) array
        With unit depth, in the field frame.
    x_m, y_m : (H, W) arrays
        Where they meet the ground.
    depth_m : (H, W) array
        Depth there, inf above the horizon.
    footprint_m : (H, W) array
        Metres on the ground per pixel, the geometric mean of both directions.
    """

    directions: Float32
    x_m: Float32
    y_m: Float32
    depth_m: Float32
    footprint_m: Float32


def on_field(x_m: ArrayLike, y_m: ArrayLike) -> tuple[Array, Array]:
    """The nearest places at which the ground still falls."""
    ends_x, ends_y = CROWN_ENDS_M
    return np.clip(x_m, -ends_x, ends_x), np.clip(y_m, -ends_y, ends_y)


def pixel_rays(camera: Camera, surface: Surface) -> PixelRays:
    """Rays of every pixel: exact on a grid of 8 pixels, interpolated between (well below 0.1 px)."""
    size = np.array([camera.height, camera.width])
    blocks = -(-size // _COARSE_PX) + 2
    rows, columns = ((np.arange(n) - 0.5) * _COARSE_PX - 0.5 for n in blocks)
    coarse = camera.rays(np.stack(np.meshgrid(columns, rows), axis=-1))
    along, away, down = np.moveaxis(coarse, -1, 0)
    height = -float(camera.position_m[2])
    # the inverse of the reach is what varies evenly over the picture
    inverse = down / height
    if surface.crown_m:
        descends = inverse > 1.0 / (4 * FAR_M)
        reach = np.where(descends, 1.0 / np.where(descends, inverse, 1.0), 4 * FAR_M)
        for _ in range(_CROWN_ROUNDS):
            x, y = on_field(camera.position_m[0] + reach * along, camera.position_m[1] + reach * away)
            above = reach * down - height - surface.drop(x, y)
            reach = reach - above / np.maximum(down - surface.fall(x, y, along, away), 1e-3)
        inverse = np.where(descends & (reach > 0), 1.0 / np.maximum(reach, 1e-3), inverse)
    descent = np.maximum(down, 1e-3) / np.linalg.norm(coarse, axis=-1)
    spread = 1.0 / (np.mean(camera.focal_px) * np.sqrt(descent))

    def every_pixel(values: NDArray[Any]) -> Float32:
        fine = cv2.resize(values.astype(np.float32), None, fx=_COARSE_PX, fy=_COARSE_PX)
        inside = fine[_COARSE_PX : _COARSE_PX + camera.height, _COARSE_PX : _COARSE_PX + camera.width]
        return np.ascontiguousarray(inside, dtype=np.float32)

    directions = np.stack([every_pixel(coarse[..., axis]) for axis in range(3)])
    w = every_pixel(inverse)
    reach32 = np.float32(1.0) / np.maximum(w, np.float32(1.0 / (4 * FAR_M)))
    ground = [
        np.clip(np.float32(camera.position_m[axis]) + reach32 * directions[axis], -FAR_M, FAR_M) for axis in (0, 1)
    ]
    depth = np.where(w > _LEAST_DESCENT / height, reach32, np.float32(np.inf))
    footprint = every_pixel(spread) * np.minimum(reach32, np.float32(FAR_M))
    return PixelRays(directions, ground[0], ground[1], depth, footprint)
