"""The colours of the lines on a floor: in a hall those of one sport are in one colour, and others' in others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.field_region import find_field_region
from circlecal.detection.options import FieldRegionConfig, RidgeConfig
from circlecal.detection.picture import reduce_picture
from circlecal.detection.ridges import find_ridges
from circlecal.geometry.projective import Array
from circlecal.paint.colour import measure_added_colours

__all__ = ["find_paints"]

CHANNELS = np.array([[1 / 3, 1 / 3, 1 / 3], [1 / 2, 0, -1 / 2], [-1 / 4, 1 / 2, -1 / 4]])
"""Weights of blue, green and red: brightness, blue against red, green against both; lines that are as light as their
floor show in one of them."""
WIDTH_PX = 960
"""Largest width of the searched picture (does not scale)."""
RIDGES = RidgeConfig(threshold=6.0)
"""A line that tells a colour stands out well: at 4 the grain of wood does too."""
SHORTEST_CHAIN = 0.04
"""Of connected ridge points, picture widths: players have shorter ones."""
SAMPLED = 2000
"""Ridge points whose colours are compared with each other."""
PAINT_PX = 4.0
"""Width beyond which the floor is looked at, pixels of the picture."""
LEAST_COLOUR = 12.0
"""Grey levels that a line must add to its floor for its colour to be told."""
ALIKE, JOINED = np.cos(np.deg2rad(20.0)), np.cos(np.deg2rad(25.0))
"""Cosines between colours of one paint, about one of its points and about its middle: inks of halls (white, yellow,
red, blue, black, green) are mostly 40 degrees apart on their floors, points on one line scatter by 10 to 15.
"""
LEAST_SHARE, MOST_PAINTS = 0.05, 5
"""Least share of the points that a paint has, and most paints: of 16 rendered halls with the lines of five sports the
right paint had 0.08 at least.
"""


def find_paints(image: NDArray[np.uint8], region: FieldRegionConfig) -> tuple[Array, ...]:
    """What each paint on the playing surface adds to its blue, green and red (3,), the one with most lines first.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    region : FieldRegionConfig
        How the playing surface is found.
    """
    points, normals = _find_lines(image, region)
    if len(points) == 0:
        return ()
    step = -(-len(points) // SAMPLED)
    points, normals = points[::step], normals[::step]
    added = measure_added_colours(image, points, normals, np.full(len(points), PAINT_PX))
    strength = np.linalg.norm(added, axis=1)
    added, strength = added[strength > LEAST_COLOUR], strength[strength > LEAST_COLOUR]
    return _group_colours(added, added / strength[:, None])


def _find_lines(image: NDArray[np.uint8], region: FieldRegionConfig) -> tuple[Array, Array]:
    """Points and normals (N, 2) of what is thin and long on the playing surface, lighter or darker in any channel."""
    field = find_field_region(image, region)
    points, normals = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for weights in CHANNELS.astype(np.float32):
        channel, scaling = reduce_picture(_weigh(image, weights), WIDTH_PX, WIDTH_PX)
        hull = field.hull_at(channel.shape[1], channel.shape[0])
        for sign in (1.0, -1.0):
            ridges = find_ridges(channel, hull, sign, RIDGES)
            long = ridges.take(ridges.chain >= SHORTEST_CHAIN * channel.shape[1])
            points.append(scaling.full(long.points))
            normals.append(long.normals)
    return np.concatenate(points), np.concatenate(normals)


def _weigh(image: NDArray[np.uint8], weights: NDArray[np.float32]) -> NDArray[np.uint8]:
    """One channel of a picture, in the middle of 8 bits where it may be negative."""
    middle = 0.0 if weights.min() >= 0.0 else 127.5
    return np.rint(image.astype(np.float32) @ weights + np.float32(middle)).clip(0, 255).astype(np.uint8)


def _group_colours(added: Array, directions: Array) -> tuple[Array, ...]:
    """Median colour (3,) of each group of places (N, 3) whose directions (N, 3) are alike, the largest first."""
    near = directions @ directions.T > ALIKE
    left = np.ones(len(added), np.bool_)
    found: list[Array] = []
    while len(found) < MOST_PAINTS and left.any():
        votes = near[:, left].sum(axis=1) * left
        middle = int(votes.argmax())
        if votes[middle] < LEAST_SHARE * len(added):
            break
        colour = np.median(added[near[middle] & left], axis=0)
        members = left & (directions @ (colour / np.linalg.norm(colour)) > JOINED)
        if members.any():
            found.append(np.median(added[members], axis=0))
        left &= ~members
        left[middle] = False
    return tuple(found)
