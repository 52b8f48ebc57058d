"""Which straight markings were seen where no circle is: hypotheses from two pairs of lines at right angles.

Nearly all straight markings of a field run along it or across it. Two lines along the field meet in one vanishing
point, two across it in another, and both together give the focal length and the rotation of a camera with square pixels
and a known principal point. Each seen line then has an offset on the ground, up to the camera's height and place:

1. ``N = R^T K^T l`` is the plane through a seen line l and the camera, in field coordinates;
2. a line along the field, at ``y = y0``, has ``N_x = 0`` and ``y0 = C_y - h N_z / N_y``, with the camera at C and its
   height ``h = -C_z``; one across it, at ``x = x0``, has ``N_y = 0`` and ``x0 = C_x - h N_z / N_x``.

So a pair of lines along the field under two names gives the height, and a pair across it gives it again: names under
which both heights agree are hypotheses. All other lines, and the lines that should be seen and are not, tell
which of them is right. Nothing but arithmetic on whole arrays: pairs of pairs times pairs of names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import (
    LOG_FOCAL,
    PAN,
    PARAMETERS,
    POSITION,
    ROLL,
    TILT,
    ProjectionModel,
    homographies,
    project,
)
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array, Indices, Mask, lift

__all__ = ["FieldHypothesis", "propose_cameras"]

FEWEST_LINES = 4
"""Two along the field and two across it."""
MOST_LINES = 12
"""The longest that are used: 12 of them have 2,970 pairs of pairs, a picture of a penalty area shows 6 to 12."""
FOCAL_WIDTHS = (0.4, 12.0)
"""Focal lengths in picture widths: phones to the longest lenses of main cameras."""
LARGEST_ROLL_DEG = 12.0
"""Main cameras have less than 2 degrees; a vanishing point of two short lines is off by some degrees."""
TILT_DEG = (45.0, 89.0)
"""Angle between the optical axis and the vertical: from steep views to a camera at the height of the field."""
HEIGHT_M = (1.5, 60.0)
"""Of a camera above the field: from a camera on the ground to the roof of a large stadium."""
REACH_M = 200.0
"""Largest distance of a camera from the middle of the field."""
SAME_HEIGHT = 0.25
"""Largest difference of both heights' logarithms: vanishing points of seen lines are known to a few percent (33 real
frames of penalty areas: within 0.12 for the right names).
"""
DIRECTED_PX, NAMED_PX = 6.0, 14.0
"""Pixels at 1920 px width: how far the ends of a line may lie from the direction of a vanishing point that it runs to,
and from the marking whose name it gets. Lens, crown, and a field of another size move lines by about so much.
"""
DIRECTED_SHARE = 0.7
"""Views with less than this share of the length that runs to the vanishing points of the best view are left out (of the
right views on 33 real frames of penalty areas one has less than 0.8).
"""
LEVEL_FOCAL_WIDTHS, LEVEL_VIEWS = tuple(np.geomspace(0.7, 8.0, 14).tolist()), 60
"""Focal lengths, picture widths, that are tried for level cameras, a fifth apart, which moves a height by less than
:data:`SAME_HEIGHT`; and views of those that are looked at.
"""
BEYOND_M = 3.0
"""How far a seen line may run past the end of its marking, metres on the ground, before the camera is refined."""
MISSING_WEIGHT = 0.35
"""What a pixel of a marking that should be seen and is not costs, against one of a seen line that is explained:
players, shade and faint paint hide a third of what is in view (33 real frames of penalty areas).
"""
NODES = 24
"""Places along each marking at which it is looked whether it is in view and seen."""
KEPT = 120
"""Hypotheses that are scored with the whole template."""


@dataclass(frozen=True, slots=True)
class FieldHypothesis:
    """Names for seen lines, and the camera that they imply.

    Attributes
    ----------
    names : dict
        Template name by index of the seen line.
    theta : (P,) array
        Camera, without lens or crown.
    score : float
        Pixels of seen line that it explains, less what it leaves over or predicts in vain, in picture widths.
    """

    names: dict[int, str]
    theta: Array
    score: float


@dataclass(frozen=True, slots=True)
class _Views:
    """Candidate rotations and focal lengths of V pairs of pairs.

    Attributes
    ----------
    focal : (V,) array
        In half widths of the picture.
    axes : (V, 3, 3) array
        The field's axes before the camera, in columns: the rotation from field to camera.
    along, across : (V, 2) arrays
        Indices of the two lines along the field, and of the two across it.
    """

    focal: Array
    axes: Array
    along: Indices
    across: Indices

    def take(self, index: Indices | Mask) -> _Views:
        return _Views(self.focal[index], self.axes[index], self.along[index], self.across[index])


def propose_cameras(
    segments: Array, template: FieldTemplate, model: ProjectionModel, side: str, most: int
) -> list[FieldHypothesis]:
    """Names and cameras that explain straight markings without any circle, the best first.

    Parameters
    ----------
    segments : (S, 2, 2) array
        Ends of seen lines, pixels.
    template : FieldTemplate
        The field.
    model : ProjectionModel
        Size of the picture.
    side : str
        Side of the field on which the camera stands, as ``correspondences.camera_side``.
    most : int
        How many are returned at most, no two with contained names.
    """
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    used = np.sort(np.argsort(-length, kind="stable")[:MOST_LINES])
    used = used[length[used] > 0]
    if len(used) < FEWEST_LINES:
        return []
    half = model.width / 2.0
    ends = (segments[used] - model.center) / half
    lines = np.cross(lift(ends[:, 0]), lift(ends[:, 1]))
    lines /= np.hypot(lines[:, 0], lines[:, 1])[:, None]
    for views in _all_views(lines, ends):
        if len(views.focal) == 0:
            continue
        directed = _length_to_vanishing_points(views, ends, DIRECTED_PX / 960.0)
        views = views.take(directed >= DIRECTED_SHARE * directed.max())
        theta = _positions(views, lines, template, model, side)
        found = _rank(theta, segments[used], used, template, model, most) if len(theta) else []
        if found:
            return found
    return []


def _all_views(lines: Array, ends: Array) -> Iterator[_Views]:
    """Views from two vanishing points, and where those lead nowhere from one."""
    yield _views(lines)
    yield _level_views(lines, ends)


def _views(lines: Array) -> _Views:
    """Rotations and focal lengths that two pairs of the lines (S, 3) give, where a camera can have them."""
    first, second = np.triu_indices(len(lines), 1)
    meets = np.cross(lines[first], lines[second])
    meets /= np.maximum(np.linalg.norm(meets, axis=-1, keepdims=True), 1e-12)
    p, q = (index.ravel() for index in np.indices((len(first), len(first))))
    pairs = np.stack([first, second], axis=-1)
    apart = (pairs[p][:, :, None] != pairs[q][:, None, :]).all(axis=(1, 2))
    p, q = p[apart], q[apart]
    along, across = meets[p], meets[q]
    # the directions K^-1 v are at right angles: f^2 = -(v_x w_x + v_y w_y) / (v_z w_z)
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
    return _Views(focal, R, pairs[p], pairs[q]).take(upright)


def _level_views(lines: Array, ends: Array) -> _Views:
    """Views of cameras without roll from one vanishing point, across the field, and focal lengths on a grid.

    Lines along the field may be so nearly parallel in the picture that a lens bends them by more than their vanishing
    point tells. Of the lines (S, 3) with their ends (S, 2, 2) those that run to the point along the field which is then
    implied give a pair, the two that are furthest apart.
    """
    across = np.stack(np.triu_indices(len(lines), 1), axis=-1)
    focal = 2.0 * np.tile(LEVEL_FOCAL_WIDTHS, len(across))
    across = np.repeat(across, len(LEVEL_FOCAL_WIDTHS), axis=0)
    meets = np.cross(lines[across[:, 0]], lines[across[:, 1]])
    y_axis = meets * np.stack([1.0 / focal, 1.0 / focal, np.ones(len(focal))], axis=-1)
    y_axis /= np.maximum(np.linalg.norm(y_axis, axis=-1, keepdims=True), 1e-12)
    # level: the vertical has no part along the picture's rows, and points down in it
    down = np.stack([np.zeros(len(focal)), y_axis[:, 2], -y_axis[:, 1]], axis=-1)
    down *= np.sign(down[:, 1:2]) / np.maximum(np.linalg.norm(down, axis=-1, keepdims=True), 1e-12)
    R = np.stack([np.cross(y_axis, down), y_axis, down], axis=-1)
    tilt = np.degrees(np.arccos(np.clip(down[:, 2], -1.0, 1.0)))
    views = _Views(focal, R, across, across).take((tilt > TILT_DEG[0]) & (tilt < TILT_DEG[1]))
    if len(views.focal) == 0:
        return views
    directed = _find_directed(views, ends, DIRECTED_PX / 960.0)
    runs_along = directed[0] & (np.arange(len(lines)) != views.across[:, :1])
    runs_along &= np.arange(len(lines)) != views.across[:, 1:]
    height = ends[..., 1].mean(axis=1)
    highest = np.where(runs_along, height, np.inf).argmin(axis=1)
    lowest = np.where(runs_along, height, -np.inf).argmax(axis=1)
    length = (directed[0] | directed[1]) @ np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    usable = runs_along.sum(axis=1) >= 2
    best = np.argsort(-np.where(usable, length, 0.0), kind="stable")[: min(LEVEL_VIEWS, int(usable.sum()))]
    return replace(views, along=np.stack([highest, lowest], axis=-1)).take(best)


def _length_to_vanishing_points(views: _Views, ends: Array, tolerance: float) -> Array:
    """Summed length (V,) of the seen lines (S, 2, 2) that run to one of the two vanishing points of each view."""
    along, across = _find_directed(views, ends, tolerance)
    return np.asarray((along | across) @ np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1))


def _find_directed(views: _Views, ends: Array, tolerance: float) -> Mask:
    """Which seen lines (S, 2, 2) run to each of the two vanishing points of each view, bool (2, V, S)."""
    middle, half = ends.mean(axis=1), 0.5 * (ends[:, 1] - ends[:, 0])
    directed = np.zeros((2, len(views.focal), len(ends)), np.bool_)
    for axis in (0, 1):
        x, y, z = (views.axes[:, k, axis, None] for k in range(3))
        # from the middle m of a line to the vanishing point v: (v_x, v_y) - v_z m, with K taken back
        toward = views.focal[:, None] * x - z * middle[:, 0], views.focal[:, None] * y - z * middle[:, 1]
        off = np.abs(toward[0] * half[:, 1] - toward[1] * half[:, 0]) / np.maximum(np.hypot(*toward), 1e-12)
        directed[axis] = off < tolerance
    return directed


def _positions(views: _Views, lines: Array, template: FieldTemplate, model: ProjectionModel, side: str) -> Array:
    """Cameras (B, P) of the views under all names of their pairs for which both heights agree."""
    drawn, _ = template.drawn_lines
    lengthwise = np.abs(drawn[:, 1] - drawn[:, 0]).argmax(axis=-1) == 0
    x_offsets = np.unique(np.round(drawn[~lengthwise, 0, 0], 6))
    y_offsets = np.unique(np.round(drawn[lengthwise, 0, 1], 6))
    V = np.arange(len(views.focal))
    # 1: N = R^T K^T l, with K = diag(f, f, 1)
    planes = lines[None] * np.stack([views.focal, views.focal, np.ones(len(V))], axis=-1)[:, None]
    N = planes @ views.axes
    with np.errstate(divide="ignore", invalid="ignore"):
        t = N[..., 2] / N[..., 1]
        u = N[..., 2] / N[..., 0]
    t_pair, u_pair = t[V[:, None], views.along], u[V[:, None], views.across]
    height_y, middle_y = _heights(t_pair, y_offsets)
    height_x, middle_x = _heights(u_pair, x_offsets)
    # pairs of names under which both heights agree: sorted logarithms, and everything within reach of each
    view, ny = np.nonzero(np.isfinite(height_y))
    differs = np.abs(np.log(height_y[view, ny])[:, None] - np.log(height_x[view])) < SAME_HEIGHT
    row, nx = np.nonzero(differs)
    view, ny = view[row], ny[row]
    height = np.sqrt(height_y[view, ny] * height_x[view, nx])
    # 2, at the middle of each pair, where an error of the height moves nothing
    C_y = middle_y[view, ny] + height * t_pair[view].mean(axis=-1)
    C_x = middle_x[view, nx] + height * u_pair[view].mean(axis=-1)
    position = np.stack([C_x, C_y, -height], axis=-1)
    turned = position[:, :2] @ np.array(SIDES[side]) < 0
    R = views.axes[view].copy()
    R[turned, :, :2] *= -1.0
    position[turned, :2] *= -1.0
    near = (np.abs(position[:, :2]) < REACH_M).all(axis=1)
    # what is seen lies before the camera: the middle of both pairs
    return _thetas(views.focal[view][near] * model.width / 2.0, R[near], position[near])


def _heights(slope: Array, offsets: Array) -> tuple[Array, Array]:
    """Heights (V, M) of the camera under all M ordered pairs of offsets of two lines with these slopes (V, 2), nan
    where it has none, and the middle of each pair of offsets (V, M).
    """
    i, j = (index.ravel() for index in np.indices((len(offsets), len(offsets))))
    i, j = i[i != j], j[i != j]
    with np.errstate(divide="ignore", invalid="ignore"):
        height = (offsets[i] - offsets[j]) / (slope[:, 1:] - slope[:, :1])
    height = np.where((height > HEIGHT_M[0]) & (height < HEIGHT_M[1]), height, np.nan)
    return height, np.broadcast_to((offsets[i] + offsets[j]) / 2.0, height.shape)


def _thetas(focal_px: Array, R: Array, position_m: Array) -> Array:
    """Parameter vectors (B, P) of cameras without lens; rotations (B, 3, 3) with less than a right angle of roll."""
    theta = np.zeros((len(R), len(PARAMETERS)))
    pan = np.arctan2(R[:, 2, 0], -R[:, 2, 1])
    c, s = np.cos(pan), np.sin(pan)
    theta[:, LOG_FOCAL], theta[:, PAN] = np.log(focal_px), pan
    theta[:, TILT] = np.arccos(np.clip(R[:, 2, 2], -1.0, 1.0))
    theta[:, ROLL] = np.arctan2(-(c * R[:, 1, 0] + s * R[:, 1, 1]), c * R[:, 0, 0] + s * R[:, 0, 1])
    theta[:, POSITION] = position_m
    return theta


@dataclass(frozen=True, slots=True)
class _Matches:
    """Which marking (B, S) every seen line is under each camera, -1 for none, and from where to where (B, S, 2) on that
    marking it runs, metres from its first end.
    """

    marking: Indices
    along: Array

    def take(self, index: Indices) -> _Matches:
        return _Matches(self.marking[index], self.along[index])


def _rank(
    theta: Array, segments: Array, used: Indices, template: FieldTemplate, model: ProjectionModel, most: int
) -> list[FieldHypothesis]:
    """The cameras (B, P) under which most of the seen lines have a name, and little is missing."""
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    matches = _match(theta, segments, template, model)
    explained = (matches.marking >= 0) @ length
    order = np.argsort(-explained, kind="stable")[:KEPT]
    matches, theta, explained = matches.take(order), theta[order], explained[order]
    score = (explained - MISSING_WEIGHT * _missing_px(theta, matches, template, model)) / model.width
    found: list[FieldHypothesis] = []
    for k in np.argsort(-score, kind="stable").tolist():
        names = {int(used[s]): template.lines[t].name for s, t in enumerate(matches.marking[k].tolist()) if t >= 0}
        if len(set(names.values())) < FEWEST_LINES or any(names.items() <= other.names.items() for other in found):
            continue
        found.append(FieldHypothesis(names, theta[k], float(score[k])))
        if len(found) == most:
            break
    return found


def _match(theta: Array, segments: Array, template: FieldTemplate, model: ProjectionModel) -> _Matches:
    """For every seen line (S, 2, 2) the nearest marking on whose extent it lies."""
    drawn, _ = template.drawn_lines
    span = drawn[:, 1] - drawn[:, 0]
    extent = np.linalg.norm(span, axis=-1)
    direction = span / extent[:, None]
    across = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    markings = np.column_stack([across, -(across * drawn[:, 0]).sum(axis=-1)])
    back = np.linalg.inv(homographies(theta, model))
    ends = lift(segments.reshape(-1, 2))
    seen = markings @ back  # lines go by the inverse transpose
    seen /= np.hypot(seen[..., 0], seen[..., 1])[..., None]
    off = np.abs(seen @ ends.T).reshape(len(theta), len(drawn), -1, 2).max(axis=-1)
    field = ends @ np.swapaxes(back, 1, 2)
    depth = field[..., 2:]
    # a pixel below the horizon has the sign of the picture's lower middle
    below = back[:, 2] @ np.array([model.center[0], 2.0 * model.height, 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        field = np.where(depth * np.sign(below)[:, None, None] > 0, field[..., :2] / depth, np.nan)
    along = direction @ np.swapaxes(field, 1, 2) - (drawn[:, 0] * direction).sum(axis=-1)[:, None]
    along = along.reshape(len(theta), len(drawn), -1, 2)
    on = ((along > -BEYOND_M) & (along < extent[:, None, None] + BEYOND_M)).all(axis=-1)
    off = np.where(on, off, np.inf)
    best = off.argmin(axis=1)
    named = np.take_along_axis(off, best[:, None], axis=1)[:, 0] < NAMED_PX * model.width / 1920.0
    chosen = np.take_along_axis(along, best[:, None, :, None], axis=1)[:, 0]
    return _Matches(np.where(named, best, -1), np.sort(chosen, axis=-1))


def _missing_px(theta: Array, matches: _Matches, template: FieldTemplate, model: ProjectionModel) -> Array:
    """Length (B,) of the markings in view on which no line was seen, pixels."""
    drawn, _ = template.drawn_lines
    share = (np.arange(NODES + 1) / NODES)[:, None]
    places = drawn[:, :1] + share * (drawn[:, 1:] - drawn[:, :1])
    seen = project(theta, places.reshape(1, -1, 2), model)
    shape = (len(theta), len(drawn), NODES + 1)
    pixels, ahead = seen.pixels.reshape(*shape, 2), seen.visible.reshape(shape)
    inside = ahead & ((pixels > 0) & (pixels < (model.width, model.height))).all(axis=-1)
    length = np.linalg.norm(np.diff(pixels, axis=2), axis=-1) * (inside[..., 1:] & inside[..., :-1])
    metres = (share[:-1, 0] + 0.5 / NODES) * np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=-1)[:, None]
    covered = np.zeros(length.shape, np.bool_)
    low, high = matches.along[..., 0], matches.along[..., 1]
    for s in range(matches.marking.shape[1]):
        own = matches.marking[:, s, None, None] == np.arange(len(drawn))[:, None]
        covered |= own & (metres >= low[:, s, None, None]) & (metres <= high[:, s, None, None])
    return np.asarray(np.where(covered, 0.0, length).sum(axis=(1, 2)))
