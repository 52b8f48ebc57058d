"""Finding a known camera again: pan, tilt and zoom of a picture of which nothing is known but the tripod.

Light thin ridges on the playing surface are gathered in a small picture. Heads on a coarse grid are compared by how
much of the ridges and of what they put into view agrees, all at once; the best are refined by halving steps. What is
found is a proposal: the paint at full size decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.options import RidgeConfig
from circlecal.detection.ridges import find_ridges
from circlecal.field import FieldTemplate
from circlecal.geometry.camera import lens_factor
from circlecal.geometry.camera_parameters import KAPPA_1, POSITION, PRINCIPAL, rotations
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import TripodEstimate
from circlecal.tracking.markings import DrawnTemplate, grow_places

WIDTH_PX = 560
"""Width of the picture that is searched."""
RIDGE_WIDTH_PX, LEAST_CHAIN_PX = 960, 20
"""Width of the picture in which ridges are found, and how many points in a row make one: worn paint in the shadow of a
rendered stand is found there, of which a threshold on the height above the surroundings found nothing.
"""
NO_RIDGE_PX = 50.0
"""Distance from the next ridge where there is none, reduced pixels."""
COARSE_PX, FINE_PX = 7.0, 1.5
"""How near a marking must be to its ridge at first and at last, reduced pixels."""
STEP_PX, STEP_ZOOM = 12.0, 0.13
"""Of the grid: reduced pixels in pan and tilt, and of the logarithm of the focal length."""
ZOOM_BEYOND = 0.3
"""How far beyond the zooms that are known already the grid goes."""
FOLLOWED, KEPT, APART_PX = 24, 6, 4.0
"""Heads that are refined, those that are returned at most, and how far these lie apart, reduced pixels."""
LEVELS = 5
LEAST_RIDGE_PX = 60
"""With less of ridges there is nothing to search, reduced pixels."""
PIECE_M = 2.5
"""Length of the pieces of markings."""
CHUNK = 256
TILT_BEYOND_RAD = 0.08, 0.05
"""How far below and above the known tilts the grid goes."""
NEIGHBOURS = np.stack(np.meshgrid([-1.0, 0, 1], [-1.0, 0, 1], [-1.0, 0, 1]), axis=-1).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class RidgePicture:
    """Distance (h, w) of each reduced pixel from the next ridge, the length of all ridges, and the factor to the whole
    picture.
    """

    distance: NDArray[np.float32]
    length_px: float
    factor: float


def map_ridges(gray: NDArray[np.uint8], grass: NDArray[np.uint8], config: RidgeConfig) -> RidgePicture:
    """Light thin ridges on the playing surface.

    Parameters
    ----------
    gray : (H, W) uint8
        Picture.
    grass : (h, w) uint8
        Playing surface, not 0, at any size.
    config : RidgeConfig
        What counts as a ridge.
    """
    height, width = gray.shape
    factor, finer = width / WIDTH_PX, min(1.0, RIDGE_WIDTH_PX / width)
    size = (round(finer * width), round(finer * height))
    reduced = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8)
    region = np.where(cv2.resize(grass, size, interpolation=cv2.INTER_NEAREST) > 0, 255, 0).astype(np.uint8)
    found = find_ridges(reduced, region, 1.0, config)
    points = found.points[found.chain >= LEAST_CHAIN_PX]
    off = np.ones((round(height / factor), WIDTH_PX), np.uint8)
    column, row = np.round((points + 0.5) / (finer * factor) - 0.5).astype(np.int64).T
    off[np.clip(row, 0, len(off) - 1), np.clip(column, 0, WIDTH_PX - 1)] = 0
    length = np.count_nonzero(off == 0)
    if length == 0:
        return RidgePicture(np.full(off.shape, NO_RIDGE_PX, np.float32), 0.0, factor)
    return RidgePicture(np.asarray(cv2.distanceTransform(off, cv2.DIST_L2, 3), np.float32), float(length), factor)


def search_heads(ridges: RidgePicture, tripod: TripodEstimate, drawn: DrawnTemplate, template: FieldTemplate) -> Array:
    """Heads (N, 3) under which markings and ridges agree best, the best first; they may all be wrong."""
    if ridges.length_px < LEAST_RIDGE_PX:
        return np.zeros((0, 3))
    places = _pieces(drawn, tripod)
    grid = _grid(tripod, template)
    score = _scores(grid, places, ridges, tripod, COARSE_PX)
    heads = grid[np.argsort(-score, kind="stable")[:FOLLOWED]]
    step = np.array([STEP_ZOOM, 1.0, 1.0]) / 2.0
    for level in range(LEVELS):
        reach = max(COARSE_PX * 0.75**level, FINE_PX)
        turn = STEP_PX * ridges.factor / np.exp(heads[:, :1])
        tried = heads[:, None] + NEIGHBOURS * (step * np.column_stack([np.ones(len(heads)), turn, turn]))[:, None]
        score = _scores(tried.reshape(-1, 3), places, ridges, tripod, reach).reshape(len(heads), -1)
        heads = tried[np.arange(len(heads)), np.argmax(score, axis=1)]
        step = step * 0.55
    score = _scores(heads, places, ridges, tripod, FINE_PX)
    return _keep_apart(heads[np.argsort(-score, kind="stable")], tripod.size[0], ridges.factor)


def _keep_apart(heads: Array, width: int, factor: float) -> Array:
    """The first heads (N, 3) of those (M, 3) that show different pictures."""
    kept: list[Array] = []
    for head in heads:
        # by how much the picture moves at its middle, and at its border where only the zoom differs
        focal = float(np.exp(head[0]))
        by_head = np.array([width / 2.0, focal, focal])
        if all((np.abs(head - other) * by_head).max() > APART_PX * factor for other in kept):
            kept.append(head)
        if len(kept) == KEPT:
            break
    return np.asarray(kept)


def _grid(tripod: TripodEstimate, template: FieldTemplate) -> Array:
    """Heads (G, 3) that look at the field, with zooms and tilts near the known ones."""
    low, high = tripod.head_low, tripod.head_high
    zooms = _range(low[0] - ZOOM_BEYOND, high[0] + ZOOM_BEYOND, STEP_ZOOM)
    x, y = tripod.mean[:2]
    half = np.array([template.length_m, template.width_m]) / 2.0
    pans = np.array([np.arctan2(sx * half[0] - x, -(sy * half[1] - y)) for sx in (-1, 1) for sy in (-1, 1)])
    parts = []
    for zoom in zooms:
        step = STEP_PX * tripod.size[0] / WIDTH_PX / np.exp(zoom)
        pan = _range(min(float(pans.min()), low[1]), max(float(pans.max()), high[1]), step)
        tilt = _range(low[2] - TILT_BEYOND_RAD[0], high[2] + TILT_BEYOND_RAD[1], step)
        parts.append(np.stack(np.meshgrid([zoom], pan, tilt, indexing="ij"), axis=-1).reshape(-1, 3))
    return np.concatenate(parts)


def _range(low: float, high: float, step: float) -> Array:
    return np.linspace(low, high, max(2, int(np.ceil((high - low) / step)) + 1))


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Nodes (3, N) along all markings, metres, and which of the N - 1 steps between them lie on one marking."""

    nodes: NDArray[np.float32]
    on_marking: NDArray[np.bool_]


def _pieces(drawn: DrawnTemplate, tripod: TripodEstimate) -> _Pieces:
    theta = tripod.model.thetas(tripod.head_low[None], tripod.mean)[0]
    marking, share = [], []
    for k in range(len(drawn.names)):
        length = float(np.hypot(*np.diff(drawn.nodes[k], axis=0).T).sum())
        count = max(3, round(length / PIECE_M) + 1)
        marking += [k] * count
        share.append(np.linspace(0.0, 1.0, count))
    index = np.array(marking)
    places = grow_places(drawn, index, drawn.places(index, np.concatenate(share)), theta)
    return _Pieces(tripod.surface.lift(places).T.astype(np.float32), np.diff(index) == 0)


def _scores(heads: Array, pieces: _Pieces, ridges: RidgePicture, tripod: TripodEstimate, reach_px: float) -> Array:
    """How well heads (B, 3) explain the ridges: length that agrees over the length of either."""
    near = np.exp(-0.5 * (ridges.distance / np.float32(reach_px)) ** 2)
    found = np.empty(len(heads))
    for first in range(0, len(heads), CHUNK):
        found[first : first + CHUNK] = _score_some(heads[first : first + CHUNK], pieces, near, ridges, tripod)
    return found


def _score_some(
    heads: Array, pieces: _Pieces, near: NDArray[np.float32], ridges: RidgePicture, tripod: TripodEstimate
) -> Array:
    theta = tripod.model.thetas(heads, tripod.mean)
    rows, columns = near.shape
    rotation = rotations(theta).astype(np.float32)
    offset = rotation @ theta[:, POSITION, None].astype(np.float32)
    local = rotation @ pieces.nodes - offset
    depth = local[:, 2]
    ahead = depth > 1.0
    scale = np.float32(1.0) / np.where(ahead, depth, np.float32(1.0))
    x, y = local[:, 0] * scale, local[:, 1] * scale
    focal = np.exp(theta[:, :1]).astype(np.float32)
    half_widths = (2.0 / tripod.size[0]) * focal
    lens, _ = lens_factor((x * x + y * y) * half_widths**2, theta[:, KAPPA_1, None], 0.0)
    scale_px = np.clip(lens, 0.7, 1.5).astype(np.float32) * focal / np.float32(ridges.factor)
    center = ((tripod.model.projection.center + theta[:, PRINCIPAL] + 0.5) / ridges.factor - 0.5).astype(np.float32)
    x, y = x * scale_px + center[:, :1], y * scale_px + center[:, 1:]
    # the middle of each piece stands for it
    mx, my = (x[:, 1:] + x[:, :-1]) * np.float32(0.5), (y[:, 1:] + y[:, :-1]) * np.float32(0.5)
    inside = ahead[:, 1:] & ahead[:, :-1] & (mx >= 0) & (my >= 0) & (mx < columns - 1) & (my < rows - 1)
    inside &= pieces.on_marking
    length = np.where(inside, np.minimum(np.hypot(np.diff(x), np.diff(y)), np.float32(60.0)), np.float32(0.0))
    at = np.where(inside, my, 0.0).astype(np.int32) * columns + np.where(inside, mx, 0.0).astype(np.int32)
    agreed, drawn = (length * near.ravel().take(at)).sum(axis=1), length.sum(axis=1)
    return np.asarray(agreed / (drawn + np.maximum(ridges.length_px - agreed, 0.0) + LEAST_RIDGE_PX))
