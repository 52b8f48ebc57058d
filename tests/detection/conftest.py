"""Pictures of flat fields, painted by formula: bands of known middle and width in perspective, with noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.projective import Array

HALF_WIDTH_M = 0.06
RADIUS_M = 9.09
GRASS = (60, 130, 70)
BLUR_PX = 0.8

Distance = Callable[[Array, Array], tuple[Array, Array]]


def ring(x0: float, radius: float, up_to: float = np.inf) -> Distance:
    """Circle about (x0, 0), or its part with x < ``up_to``: distance from the middle of the paint, and where it is."""
    return lambda x, y: (np.hypot(x - x0, y) - radius, x < up_to)


def upright(x0: float, reach: float = 34.0) -> Distance:
    """Line x = x0 up to |y| = ``reach``."""
    return lambda x, y: (x - x0, np.abs(y) <= reach)


def level(y0: float, first: float = -52.5, last: float = 52.5) -> Distance:
    """Line y = y0 between two x."""
    return lambda x, y: (y - y0, (x >= first) & (x <= last))


HALFWAY_AND_CIRCLE = (ring(0.0, RADIUS_M), upright(0.0), level(-34.0), level(34.0))
PENALTY_AREA = (upright(36.0, 20.16), ring(41.5, RADIUS_M, 36.0), level(-20.16, 36, 52.5), level(20.16, 36, 52.5))


@dataclass(frozen=True)
class Scene:
    """A camera, its picture and the true conic of the centre circle."""

    camera: Camera
    image: NDArray[np.uint8]
    conic: Array = field(repr=False)

    def circle_points(self, count: int = 180) -> Array:
        """Middle of the circle's paint (K, 2) inside the picture, px."""
        angle = np.arange(count) * (2 * np.pi / count)
        points = self.camera.project(RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
        size = np.array([self.camera.width, self.camera.height])
        return points[((points >= 0) & (points <= size - 1)).all(axis=1)]


def paint_scene(
    *,
    pan_deg: float = 0.0,
    width: int = 960,
    height: int = 540,
    focal_px: float = 2000.0,
    markings: tuple[Distance, ...] = HALFWAY_AND_CIRCLE,
    surface: tuple[int, int, int] = GRASS,
    contrast: float = 90.0,
    noise: float = 3.0,
    seed: int = 0,
) -> Scene:
    """Picture of a field from a main camera 60 m away; ``pan_deg`` turns it to the right."""
    camera = Camera(
        width=width,
        height=height,
        focal_px=np.array([focal_px, focal_px]) * (width / 960.0),
        principal_point_px=image_center(width, height),
        angles_rad=np.radians([pan_deg, 75.0, 0.0]),
        position_m=np.array([2.0, 60.0, -16.0]),
        kappa=np.zeros(2),
    )
    x, y, ground = _field_of_pixels(camera)
    cover = np.zeros((height, width))
    for distance in markings:
        d, there = distance(x, y)
        gradient = np.hypot(*np.gradient(d))
        with np.errstate(divide="ignore", invalid="ignore"):
            offset, half = d / gradient, HALF_WIDTH_M / gradient
        band = ndtr((offset + half) / BLUR_PX) - ndtr((offset - half) / BLUR_PX)
        cover = np.maximum(cover, np.where(there & ground, np.nan_to_num(band), 0.0))
    on_field = ground & (np.abs(x) < 58) & (np.abs(y) < 40)
    colour = np.where(on_field[..., None], np.array(surface, float), np.array([90.0, 80.0, 120.0]))
    random = np.random.default_rng(seed)
    values = colour + contrast * cover[..., None] + random.normal(0, noise, colour.shape)
    image = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    conic = transform_conic(camera.homography, circle_conic((0.0, 0.0), RADIUS_M))
    return Scene(camera, image, conic)


def _field_of_pixels(camera: Camera) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Field coordinates of every pixel, and whether it sees the ground."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(float)
    ground = pixels @ np.linalg.inv(camera.homography).T
    centre = camera.homography @ np.array([0.0, 0.0, 1.0])
    visible = ground[..., 2] * np.sign(centre[2]) > 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = ground[..., 0] / ground[..., 2], ground[..., 1] / ground[..., 2]
    return x, y, visible


@pytest.fixture(scope="session")
def main_view() -> Scene:
    """The whole circle and the halfway line."""
    return paint_scene()
