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
from circlecal.geometry.camera_parameters import KAPPA_1, LOG_ASPECT, POSITION, PRINCIPAL, rotations
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import TripodEstimate, unwrap_pan
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
PIECES_M = 5.0, 2.5
"""Length of the pieces of lines, and of circles, whose chords lie beside them."""
CHUNK = 512
WIDER = 1.25
"""By how much wider than its focal length says a picture is taken to be where markings out of view are left out: a lens
of the tripod's may show more.
"""
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


def search_heads(ridges: RidgePicture, views: GridViews) -> Array:
    """Heads (N, 3) under which markings and ridges agree best, the best first; they may all be wrong."""
    if ridges.length_px < LEAST_RIDGE_PX:
        return np.zeros((0, 3))
    score = views.seen.score(ridges, COARSE_PX)
    heads = views.heads[np.argsort(-score, kind="stable")[:FOLLOWED]]
    step = np.array([STEP_ZOOM, 1.0, 1.0]) / 2.0
    for level in range(LEVELS):
        reach = max(COARSE_PX * 0.75**level, FINE_PX)
        turn = STEP_PX * ridges.factor / np.exp(heads[:, :1])
        tried = heads[:, None] + NEIGHBOURS * (step * np.column_stack([np.ones(len(heads)), turn, turn]))[:, None]
        score = views.see(tried.reshape(-1, 3)).score(ridges, reach).reshape(len(heads), -1)
        heads = tried[np.arange(len(heads)), np.argmax(score, axis=1)]
        step = step * 0.55
    score = views.see(heads).score(ridges, FINE_PX)
    return _keep_apart(heads[np.argsort(-score, kind="stable")], views.tripod.size[0], ridges.factor)


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
    axis_m = tripod.mean[:2]
    half = np.array([template.length_m, template.width_m]) / 2.0
    to_corners = half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) - axis_m
    pans = unwrap_pan(np.arctan2(to_corners[:, 0], -to_corners[:, 1]), axis_m)
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
        count = max(3, round(length / PIECES_M[int(drawn.radius[k] > 0)]) + 1)
        marking += [k] * count
        share.append(np.linspace(0.0, 1.0, count))
    index = np.array(marking)
    places = grow_places(drawn, index, drawn.places(index, np.concatenate(share), theta), theta)
    return _Pieces(tripod.surface.lift(places).T.astype(np.float32), np.diff(index) == 0)


@dataclass(frozen=True, slots=True)
class _SeenPieces:
    """N pieces of markings that B heads put into view, in reduced pictures.

    Attributes
    ----------
    head, at : (N,) int32
        Number of the head, and of the pixel in which the middle of the piece lies.
    length_px : (N,) float32
        Length of the piece.
    drawn_px : (B,) array
        Length of all pieces that a head puts into view.
    """

    head: NDArray[np.int32]
    at: NDArray[np.int32]
    length_px: NDArray[np.float32]
    drawn_px: Array

    def score(self, ridges: RidgePicture, reach_px: float) -> Array:
        """How well the heads (B,) explain the ridges: length that agrees over the length of either."""
        near = np.exp(-0.5 * (ridges.distance / np.float32(reach_px)) ** 2)
        agreed = np.bincount(self.head, self.length_px * near.ravel().take(self.at), len(self.drawn_px))
        return np.asarray(agreed / (self.drawn_px + np.maximum(ridges.length_px - agreed, 0.0) + LEAST_RIDGE_PX))


@dataclass(frozen=True, slots=True)
class GridViews:
    """What a tripod puts into view under all heads of the grid, which are the same for every picture that is searched.

    Attributes
    ----------
    tripod : TripodEstimate
        The camera.
    pieces : _Pieces
        The markings before it.
    heads : (G, 3) array
        The grid.
    seen : _SeenPieces
        What these put into view.
    """

    tripod: TripodEstimate
    pieces: _Pieces
    heads: Array
    seen: _SeenPieces

    @classmethod
    def of(cls, tripod: TripodEstimate, drawn: DrawnTemplate, template: FieldTemplate) -> GridViews:
        """A tripod before a field."""
        pieces, heads = _pieces(drawn, tripod), _grid(tripod, template)
        return cls(tripod, pieces, heads, _see(heads, pieces, tripod))

    def see(self, heads: Array) -> _SeenPieces:
        """What other heads (B, 3) put into view."""
        return _see(heads, self.pieces, self.tripod)


def _see(heads: Array, pieces: _Pieces, tripod: TripodEstimate) -> _SeenPieces:
    # heads that look to the same side see the same few markings
    order = np.argsort(heads[:, 1], kind="stable")
    parts = []
    for first in range(0, len(heads), CHUNK):
        chunk = order[first : first + CHUNK]
        head, at, length = _see_some(heads[chunk], pieces, tripod)
        parts.append((chunk[head], at, length))
    head, at, length = (np.concatenate(values) for values in zip(*parts, strict=True))
    drawn = np.asarray(np.bincount(head, length, len(heads)), np.float64)
    return _SeenPieces(head.astype(np.int32), at.astype(np.int32), length, drawn)


def _nodes_in_view(pieces: _Pieces, rotation: NDArray[np.float32], theta: Array, tripod: TripodEstimate) -> _Pieces:
    """The nodes that lie between the leftmost and the rightmost direction that any of the cameras (B, P) shows."""
    width, height = tripod.size
    corners = np.array([[-1, -1, 1, 1], [-1, 1, -1, 1]]) * np.array([[width], [height]]) / 2.0 * WIDER
    focal = np.exp(theta[:, 0, None] + np.stack([np.zeros(len(theta)), theta[:, LOG_ASPECT]], axis=1))
    rays = np.concatenate([corners[None] / focal[:, :, None], np.ones((len(theta), 1, 4))], axis=1)
    seen = np.swapaxes(rotation, 1, 2) @ rays
    middle = rotation[:, 2].mean(axis=0)

    def bearing(x: Array, y: Array) -> Array:
        """Angles from where the cameras look on average, to the right."""
        return np.arctan2(x * middle[1] - y * middle[0], x * middle[0] + y * middle[1])

    within = bearing(seen[:, 0], seen[:, 1])
    x, y = theta[:, POSITION][:, :2].mean(axis=0)
    of_nodes = bearing(pieces.nodes[0] - x, pieces.nodes[1] - y)
    kept = np.flatnonzero((of_nodes >= within.min()) & (of_nodes <= within.max()))
    return _Pieces(pieces.nodes[:, kept], pieces.on_marking[kept[:-1]] & (np.diff(kept) == 1))


def _see_some(
    heads: Array, pieces: _Pieces, tripod: TripodEstimate
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Of the pieces that heads (B, 3) put into view the number of the head, the pixel, and the length."""
    width, height = tripod.size
    factor = width / WIDTH_PX
    rows, columns = round(height / factor), WIDTH_PX
    theta = tripod.model.thetas(heads, tripod.mean)
    rotation = rotations(theta).astype(np.float32)
    pieces = _nodes_in_view(pieces, rotation, theta, tripod)
    if len(pieces.on_marking) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0, np.float32)
    local = rotation @ pieces.nodes
    local -= rotation @ theta[:, POSITION, None].astype(np.float32)
    ahead = local[:, 2] > 1.0
    local[:, :2] /= np.maximum(local[:, 2:], np.float32(1.0))
    x, y = local[:, 0], local[:, 1]
    focal = np.exp(theta[:, :1])
    bend = (theta[:, KAPPA_1, None] * (2.0 / tripod.size[0] * focal) ** 2).astype(np.float32)
    scale_px = np.clip(np.float32(1.0) + bend * (x * x + y * y), np.float32(0.7), np.float32(1.5))
    scale_px *= (focal / factor).astype(np.float32)
    center = ((tripod.model.projection.center + theta[:, PRINCIPAL] + 0.5) / factor - 0.5).astype(np.float32)
    tall = np.exp(theta[:, LOG_ASPECT, None]).astype(np.float32)
    x, y = x * scale_px + center[:, :1], y * scale_px * tall + center[:, 1:]
    # the middle of each piece stands for it
    mx, my = (x[:, 1:] + x[:, :-1]) * np.float32(0.5), (y[:, 1:] + y[:, :-1]) * np.float32(0.5)
    inside = ahead[:, 1:] & ahead[:, :-1] & (mx >= 0) & (my >= 0) & (mx < columns - 1) & (my < rows - 1)
    head, piece = np.nonzero(inside & pieces.on_marking)
    own = head * x.shape[1] + piece
    across, down = (v.ravel().take(own + 1) - v.ravel().take(own) for v in (x, y))
    length = np.minimum(np.sqrt(across * across + down * down), np.float32(60.0))
    own -= head  # there is one piece less than nodes
    at = my.ravel().take(own).astype(np.int32) * columns + mx.ravel().take(own).astype(np.int32)
    return head, at, length
