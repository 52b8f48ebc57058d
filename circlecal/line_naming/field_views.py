"""Directions of a field's two axes, and the focal length, from straight markings that were seen without a circle.

Nearly all straight markings of a field run along it or across it. A camera with square pixels and a known principal
point, in coordinates of half picture widths from there with K = diag(f, f, 1), sees lines of one direction d meet in
the vanishing point v = K d, so that K^-1 v is that direction. Three ways lead to a rotation and a focal length:

1. two pairs of lines: both directions are at right angles, (K^-1 v) . (K^-1 w) = 0, so f^2 = -(v_x w_x + v_y w_y) /
   (v_z w_z);
2. one pair of lines, a level camera and a focal length that is tried: the vertical is at right angles to K^-1 v and to
   the picture's rows, the other direction to both;
3. one pair of lines, a level camera and one line l of the other direction, whose vanishing point lies on it: with 2 the
   other direction is (-(v_y^2 / f^2 + v_z^2), v_x v_y / f^2, v_x v_z / f^2), hence f^2 = ((l_y v_x v_y + l_z v_x v_z) /
   l_x - v_y^2) / v_z^2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from circlecal.geometry.projective import Array, Indices, Mask

__all__ = ["Views", "length_to_vanishing_points", "level_views", "three_line_views", "two_pair_views"]

FOCAL_WIDTHS = (0.4, 12.0)
"""Focal lengths in picture widths: phones to the longest lenses of main cameras."""
LARGEST_ROLL_DEG = 12.0
"""Main cameras have less than 2 degrees; a vanishing point of two short lines is off by some degrees."""
TILT_DEG = (45.0, 89.0)
"""Angle between the optical axis and the vertical: from steep views to a camera at the height of the field."""
LEVEL_FOCAL_WIDTHS, LEVEL_VIEWS = tuple(np.geomspace(0.7, 8.0, 14).tolist()), 60
"""Focal lengths, picture widths, that are tried for level cameras, a fifth apart, which moves a height by less than
:data:`circlecal.line_naming.two_directions.SAME_HEIGHT`; and views of those that are looked at.
"""
DIRECTED_PX = 6.0
"""Pixels at 1920 px width: how far the ends of a line may lie from the direction of a vanishing point that it runs to.
Lens and crown bend lines by about so much.
"""
THREE_LINE_VIEWS = 80
"""Views from three lines that are looked at: 12 lines have 1,320, of which a few hundred are cameras."""


@dataclass(frozen=True, slots=True)
class Views:
    """Candidate rotations and focal lengths of V cameras.

    Attributes
    ----------
    focal : (V,) array
        In half widths of the picture.
    axes : (V, 3, 3) array
        The field's axes before the camera, in columns: the rotation from field to camera.
    along, across : (V, 2) arrays
        Indices of the two lines along the field, and of the two across it; twice the one where a direction has one.
    """

    focal: Array
    axes: Array
    along: Indices
    across: Indices

    @property
    def directions(self) -> tuple[Mask, Mask]:
        """Whether there are two lines along the field, and two across it, (V,) each."""
        return self.along[:, 0] != self.along[:, 1], self.across[:, 0] != self.across[:, 1]

    def take(self, index: Indices | Mask) -> Views:
        """Some of them."""
        return Views(self.focal[index], self.axes[index], self.along[index], self.across[index])


def two_pair_views(lines: Array) -> Views:
    """Rotations and focal lengths that two pairs of the lines (S, 3) give, where a camera can have them."""
    first, second = np.triu_indices(len(lines), 1)
    meets = np.cross(lines[first], lines[second])
    meets /= np.maximum(np.linalg.norm(meets, axis=-1, keepdims=True), 1e-12)
    p, q = (index.ravel() for index in np.indices((len(first), len(first))))
    pairs = np.stack([first, second], axis=-1)
    apart = (pairs[p][:, :, None] != pairs[q][:, None, :]).all(axis=(1, 2))
    p, q = p[apart], q[apart]
    along, across = meets[p], meets[q]
    # 1
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = -(along[:, 0] * across[:, 0] + along[:, 1] * across[:, 1]) / (along[:, 2] * across[:, 2])
    low, high = (2.0 * width for width in FOCAL_WIDTHS)
    usable = np.isfinite(squared) & (squared > low**2) & (squared < high**2)
    p, q, focal = p[usable], q[usable], np.sqrt(squared[usable])
    scale = np.stack([1.0 / focal, 1.0 / focal, np.ones(len(focal))], axis=-1)
    x_axis, y_axis = meets[p] * scale, meets[q] * scale
    x_axis /= np.linalg.norm(x_axis, axis=-1, keepdims=True)
    y_axis /= np.linalg.norm(y_axis, axis=-1, keepdims=True)
    # the field's z axis points down, and so does the picture's y axis
    down = np.cross(x_axis, y_axis)
    y_axis = np.where(down[:, 1:2] < 0, -y_axis, y_axis)
    down = np.where(down[:, 1:2] < 0, -down, down)
    R = np.stack([x_axis, y_axis, down], axis=-1)
    roll = np.degrees(np.arctan2(np.abs(down[:, 0]), down[:, 1]))
    tilt = np.degrees(np.arccos(np.clip(down[:, 2], -1.0, 1.0)))
    upright = (roll < LARGEST_ROLL_DEG) & (tilt > TILT_DEG[0]) & (tilt < TILT_DEG[1])
    return Views(focal, R, pairs[p], pairs[q]).take(upright)


def level_views(lines: Array, ends: Array) -> Views:
    """Views of cameras without roll from one vanishing point, across the field, and focal lengths on a grid.

    Lines along the field may be so nearly parallel in the picture that a lens bends them by more than their vanishing
    point tells. Of the lines (S, 3) with their ends (S, 2, 2) those that run to the point along the field which is then
    implied give a pair, the two that are furthest apart.
    """
    across = np.stack(np.triu_indices(len(lines), 1), axis=-1)
    focal = 2.0 * np.tile(LEVEL_FOCAL_WIDTHS, len(across))
    across = np.repeat(across, len(LEVEL_FOCAL_WIDTHS), axis=0)
    y_axis, down, is_usable = _level_axes(np.cross(lines[across[:, 0]], lines[across[:, 1]]), focal)
    R = np.stack([np.cross(y_axis, down), y_axis, down], axis=-1)
    views = Views(focal, R, across, across).take(is_usable)
    if len(views.focal) == 0:
        return views
    directed = _find_directed(views, ends)
    runs_along = directed[0] & (np.arange(len(lines)) != views.across[:, :1])
    runs_along &= np.arange(len(lines)) != views.across[:, 1:]
    height = ends[..., 1].mean(axis=1)
    highest = np.where(runs_along, height, np.inf).argmin(axis=1)
    lowest = np.where(runs_along, height, -np.inf).argmax(axis=1)
    length = (directed[0] | directed[1]) @ np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    usable = runs_along.sum(axis=1) >= 2
    best = np.argsort(-np.where(usable, length, 0.0), kind="stable")[: min(LEVEL_VIEWS, int(usable.sum()))]
    return replace(views, along=np.stack([highest, lowest], axis=-1)).take(best)


def three_line_views(lines: Array, ends: Array) -> Views:
    """Views of cameras without roll from a pair of the lines (S, 3) of one direction and one line of the other: nothing
    else is in a picture of one corner of a penalty area. Those to whose vanishing points most of the lines with the
    ends (S, 2, 2) run are kept.
    """
    first, second = np.triu_indices(len(lines), 1)
    k, third = (index.ravel() for index in np.indices((len(first), len(lines))))
    apart = (third != first[k]) & (third != second[k])
    k, third = k[apart], third[apart]
    pair, meets = np.stack([first, second], axis=-1)[k], np.cross(lines[first], lines[second])[k]
    vx, vy, vz = meets.T
    lx, ly, lz = lines[third].T
    # 3
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = ((ly * vx * vy + lz * vx * vz) / lx - vy * vy) / (vz * vz)
    low, high = (2.0 * width for width in FOCAL_WIDTHS)
    usable = np.isfinite(squared) & (squared > low**2) & (squared < high**2)
    focal, pair, alone = np.sqrt(squared[usable]), pair[usable], np.repeat(third[usable, None], 2, axis=1)
    axis, down, is_usable = _level_axes(meets[usable], focal)
    focal, pair, alone, axis, down = (values[is_usable] for values in (focal, pair, alone, axis, down))
    seen_across = np.stack([np.cross(axis, down), axis, down], axis=-1)
    seen_along = np.stack([axis, np.cross(down, axis), down], axis=-1)
    views = Views(
        np.tile(focal, 2),
        np.concatenate([seen_across, seen_along]),
        np.concatenate([alone, pair]),
        np.concatenate([pair, alone]),
    )
    best = np.argsort(-length_to_vanishing_points(views, ends), kind="stable")[:THREE_LINE_VIEWS]
    return views.take(best)


def _level_axes(meets: Array, focal: Array) -> tuple[Array, Array, Mask]:
    """Unit directions (V, 3) of vanishing points (V, 3) before level cameras with these focal lengths (V,), the
    vertical (V, 3) under each, and whether a camera has that tilt (V,).
    """
    axis = meets * np.stack([1.0 / focal, 1.0 / focal, np.ones(len(focal))], axis=-1)
    axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    # 2: level, so the vertical has no part along the picture's rows, and points down in it
    down = np.stack([np.zeros(len(focal)), axis[:, 2], -axis[:, 1]], axis=-1)
    down *= np.sign(down[:, 1:2]) / np.maximum(np.linalg.norm(down, axis=-1, keepdims=True), 1e-12)
    tilt = np.degrees(np.arccos(np.clip(down[:, 2], -1.0, 1.0)))
    return axis, down, (tilt > TILT_DEG[0]) & (tilt < TILT_DEG[1])


def length_to_vanishing_points(views: Views, ends: Array) -> Array:
    """Summed length (V,) of the seen lines (S, 2, 2) that run to one of the two vanishing points of each view."""
    along, across = _find_directed(views, ends)
    return np.asarray((along | across) @ np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1))


def _find_directed(views: Views, ends: Array) -> Mask:
    """Which seen lines (S, 2, 2) run to each of the two vanishing points of each view, bool (2, V, S)."""
    middle, half = ends.mean(axis=1), 0.5 * (ends[:, 1] - ends[:, 0])
    directed = np.zeros((2, len(views.focal), len(ends)), np.bool_)
    for axis in (0, 1):
        x, y, z = (views.axes[:, k, axis, None] for k in range(3))
        # from the middle m of a line to the vanishing point v: (v_x, v_y) - v_z m, with K taken back
        toward = views.focal[:, None] * x - z * middle[:, 0], views.focal[:, None] * y - z * middle[:, 1]
        off = np.abs(toward[0] * half[:, 1] - toward[1] * half[:, 0]) / np.maximum(np.hypot(*toward), 1e-12)
        directed[axis] = off < DIRECTED_PX / 960.0
    return directed
