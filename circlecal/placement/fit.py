"""Cameras moved so that their circle stays where it is seen and the other markings come to lie on ridges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from circlecal.geometry.projective import Array, Mask, lift
from circlecal.placement.camera_batch import LENS, CameraBatch
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
STEP, LARGEST_STEP = 1e-5, 0.3
"""Of the numerical derivatives, and largest of a round: radians, logarithm of the focal length, shares of the distance.
"""
DAMPING = 1e-4
"""Share of the normal matrix' mean diagonal that is added to it (Levenberg)."""


@dataclass(frozen=True, slots=True)
class _Targets:
    """Ridges (B, K, N, 2) that markings are drawn to, across them (B, K, N, 2), and weights (B, K, N)."""

    places: Array
    normals: Array
    weights: Array


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
    for reach in reaches.tolist():
        pixels, ahead = cameras.project(outlines.nodes)
        targets = _choose_targets(pixels, ahead, outlines, maps, reach)
        base = _residuals(cameras, pixels, conic, outlines, targets)
        moved = [cameras.move(step) for step in np.eye(8) * STEP]
        changed = [_residuals(other, other.project(outlines.nodes)[0], conic, outlines, targets) for other in moved]
        J = np.stack([(values - base) / STEP for values in changed], axis=-1)
        J = np.where(np.isfinite(J), J, 0.0)
        normal = J.swapaxes(1, 2) @ J
        normal += DAMPING * np.eye(8) * np.trace(normal, axis1=1, axis2=2)[:, None, None] / 8 + 1e-9 * np.eye(8)
        step = -np.linalg.solve(normal, J.swapaxes(1, 2) @ base[..., None])[..., 0]
        cameras = cameras.move(np.clip(step, -LARGEST_STEP, LARGEST_STEP))
    return cameras


def _choose_targets(pixels: Array, ahead: Mask, outlines: Outlines, maps: RidgeMaps, reach: float) -> _Targets:
    """The nearest ridges of markings (B, K, N, 2) within reach, pixels; the nearer, the more they count."""
    samples = sample_outlines(pixels, ahead, outlines.colours, maps.region)
    distance = maps.distance[samples.cell]
    trust = np.where(distance < reach, (1 - (distance / reach) ** 2), 0.0) * np.sqrt(samples.length / FULL_LENGTH_PX)
    weights = trust / (RIDGE_PX + REACH_SHARE * reach)
    return _Targets(maps.places[maps.label[samples.cell]], samples.normals, weights)


def _residuals(cameras: CameraBatch, pixels: Array, conic: Array, outlines: Outlines, targets: _Targets) -> Array:
    """Residuals (B, R): the circle beside the seen one, markings (B, K, N, 2) beside their ridges, roll and lens."""
    rim = lift(outlines.rims[cameras.own]) @ cameras.homographies.swapaxes(1, 2)
    rim /= np.where(np.abs(rim[..., 2:]) > 1e-9, rim[..., 2:], 1e-9)
    rim[..., :2] = cameras.bend(rim[..., :2])
    polar = rim @ conic
    # Sampson's distance
    off = np.sum(rim * polar, axis=-1) / np.maximum(2 * np.hypot(polar[..., 0], polar[..., 1]), 1e-12)
    beside = np.sum((targets.places - pixels) * targets.normals, axis=-1) * targets.weights
    roll = np.degrees(np.arctan2(cameras.rotation[:, 0, 2], cameras.rotation[:, 1, 2])) / ROLL_SD_DEG
    prior = np.stack([roll, (cameras.lens - LENS) / LENS_SD], axis=-1)
    return np.nan_to_num(np.concatenate([off / OWN_PX, beside.reshape(len(cameras), -1), prior], axis=1))
