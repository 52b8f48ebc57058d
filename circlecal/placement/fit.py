"""Cameras moved so that their circle stays where it is seen and the other markings come to lie on ridges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from circlecal.geometry.projective import Array, lift
from circlecal.placement.camera_batch import LENS, CameraBatch, Pixels, Projection
from circlecal.placement.evidence import Outlines, sample_outlines
from circlecal.placement.paint_maps import RidgeMaps

OWN_PX, RIDGE_PX, REACH_SHARE = 1.0, 1.5, 0.2
"""Standard deviations of the circle and of ridges, pixels of the searched picture; by this share of the reach more."""
FULL_LENGTH_PX = 10.0
"""Between two nodes of an outline, pixels of the searched picture: its residual counts once."""
ROLL_SD_DEG = 2.0
"""Of a broadcast's camera."""
LENS_SD = 0.03
"""Standard deviation of the radial distortion, half widths."""
LARGEST_STEP = 0.3
"""Of a round: radians, logarithm of the focal length, shares of the distance."""
DAMPING = 1e-4
"""Share of the normal matrix' mean diagonal that is added to it (Levenberg)."""


def fit_cameras(
    cameras: CameraBatch, conics: Sequence[Array], outlines: Outlines, maps: RidgeMaps, reaches: Array
) -> CameraBatch:
    """Gauss-Newton steps, after each of which markings are drawn to the ridges that are nearest then.

    Parameters
    ----------
    cameras : CameraBatch
        Where they start.
    conics : sequence of (3, 3) arrays
        Circles that were seen, pixels of the searched picture.
    outlines : Outlines
        What the field shows.
    maps : RidgeMaps
        Ridges of the searched picture.
    reaches : array
        Distance up to which a ridge draws a marking, pixels, for each step.
    """
    conic = np.array(conics)[cameras.seen]
    shape = outlines.nodes.shape[:2]
    for reach in reaches.tolist():
        seen = cameras.project(outlines.nodes.reshape(-1, 2))
        parts = (
            _compare_rims(cameras, conic, outlines),
            _compare_markings(cameras, seen, shape, outlines, maps, reach),
            _compare_priors(cameras),
        )
        residuals, J = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        J = J.transpose(1, 0, 2)
        normal = (J @ J.swapaxes(1, 2)).astype(np.float64)
        normal += DAMPING * np.eye(8) * np.trace(normal, axis1=1, axis2=2)[:, None, None] / 8 + 1e-9 * np.eye(8)
        step = -np.linalg.solve(normal, (J @ residuals[..., None]).astype(np.float64))[..., 0]
        cameras = cameras.move(np.clip(step, -LARGEST_STEP, LARGEST_STEP))
    return cameras


def _compare_markings(
    cameras: CameraBatch, seen: Projection, shape: tuple[int, ...], outlines: Outlines, maps: RidgeMaps, reach: float
) -> tuple[Pixels, Pixels]:
    """Residuals (B, P) of markings (K, N) beside the nearest ridges within reach, pixels, of which the nearer count
    more, and their derivatives (8, B, P).
    """
    count = len(cameras)
    outlined = seen.pixels.reshape(2, count, *shape)
    samples = sample_outlines(outlined, seen.ahead.reshape(count, *shape), outlines.colours, maps.region)
    distance = maps.distance(samples.cell)
    trust = np.where(distance < reach, (1 - (distance / np.float32(reach)) ** 2), np.float32(0.0))
    weights = trust * np.sqrt(samples.length / np.float32(FULL_LENGTH_PX)) / np.float32(RIDGE_PX + REACH_SHARE * reach)
    normals = (samples.normals * weights).reshape(2, count, -1)
    places = np.moveaxis(maps.nearest(samples.cell), -1, 0).reshape(2, count, -1)
    beside = np.einsum("xbp,xbp->bp", places - seen.pixels, normals)
    return beside, -seen.derive(cameras, normals)


def _compare_rims(cameras: CameraBatch, conic: Array, outlines: Outlines) -> tuple[Pixels, Pixels]:
    """Residuals (B, M) of the circle beside the seen one (B, 3, 3), and their derivatives (8, B, M)."""
    rim = cameras.project(outlines.rims[cameras.own])
    points = lift(np.moveaxis(rim.pixels, 0, -1).astype(np.float64))
    polar = points @ conic
    slope = np.maximum(np.hypot(polar[..., 0], polar[..., 1]), 1e-12)
    # Sampson's distance, whose gradient beside the curve is the curve's normal
    off = np.where(rim.ahead, np.sum(points * polar, axis=-1) / (2 * slope * OWN_PX), 0.0)
    normals = np.where(rim.ahead[..., None], polar[..., :2] / (slope * OWN_PX)[..., None], 0.0)
    return off.astype(np.float32), rim.derive(cameras, np.moveaxis(normals, -1, 0).astype(np.float32))


def _compare_priors(cameras: CameraBatch) -> tuple[Pixels, Pixels]:
    """Residuals (B, 2) of roll and lens, and their derivatives (8, B, 2)."""
    x, y, z = cameras.rotation[:, :, 2].T
    level = np.maximum(x * x + y * y, 1e-12)
    roll = np.degrees(np.arctan2(x, y))
    J = np.zeros((8, len(cameras), 2), np.float32)
    # of arctan2(x, y) by a turn w, which moves the axis (x, y, z) by its cross product with w
    J[:3, :, 0] = np.degrees(np.stack([x * z / level, y * z / level, -np.ones_like(x)])) / ROLL_SD_DEG
    J[7, :, 1] = 1 / LENS_SD
    return np.stack([roll / ROLL_SD_DEG, (cameras.lens - LENS) / LENS_SD], axis=-1).astype(np.float32), J
