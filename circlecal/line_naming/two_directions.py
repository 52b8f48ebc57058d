"""Which straight markings and arcs were seen where no circle is: hypotheses from few lines, judged by all.

Lines along the field and lines across it give the focal length and the rotation of a camera (see
:mod:`circlecal.line_naming.field_views`). Each seen line then has an offset on the ground, up to the camera's height
and place:

1. ``N = R^T K^T l`` is the plane through a seen line l and the camera, in field coordinates;
2. a line along the field, at ``y = y0``, has ``N_x = 0`` and ``y0 = C_y - h N_z / N_y``, with the camera at C and its
   height ``h = -C_z``; one across it, at ``x = x0``, has ``N_y = 0`` and ``x0 = C_x - h N_z / N_x``.

So a pair of lines along the field under two names gives the height, and a pair across it gives it again: names under
which both heights agree are hypotheses. Of a pair and one line the pair gives the height, and any name of the line is a
hypothesis. All other lines, the arcs that were seen, and the lines that should be seen and are not, tell which of them
is right. The best cameras are moved onto all that has a name under them (:mod:`circlecal.line_naming.view_refinement`),
and then the centre circle counts as the arcs do. Nothing but arithmetic on whole arrays: pairs of pairs times pairs of
names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.geometry.camera import NEAREST_M
from circlecal.geometry.camera_parameters import (
    LOG_FOCAL,
    PAN,
    PARAMETERS,
    POSITION,
    ROLL,
    TILT,
    ProjectionModel,
    homographies,
)
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array, Indices, Mask, extent, lift
from circlecal.line_naming.field_views import (
    Views,
    length_to_vanishing_points,
    level_views,
    three_line_views,
    two_pair_views,
)
from circlecal.line_naming.view_refinement import (
    SeenMarkings,
    circle_conics,
    distances_from_circles,
    refine_views,
)

__all__ = ["FieldHypothesis", "find_arc", "propose_cameras"]

NAMED_PX = 14.0
"""Pixels at 1920 px width: how far the ends of a line may lie from the marking whose name it gets. Lens, crown, and a
field of another size move lines by about so much.
"""
FEWEST_LINES, FEWEST_NAMED = 3, 4
"""Lines that must be seen, two of one direction and one of the other, and different lines and arcs that must be named:
a camera without roll is determined by three lines, and nothing tells whether they are the right ones.
"""
MOST_LINES = 12
"""The longest that are used: 12 of them have 2,970 pairs of pairs, a picture of a penalty area shows 6 to 12."""
HEIGHT_M = (1.5, 60.0)
"""Of a camera above the field: from a camera on the ground to the roof of a large stadium."""
REACH_M = 200.0
"""Largest distance of a camera from the middle of the field."""
SAME_HEIGHT = 0.25
"""Largest difference of both heights' logarithms: vanishing points of seen lines are known to a few percent (33 real
frames of penalty areas: within 0.12 for the right names).
"""
DIRECTED_SHARE = 0.7
"""Views with less than this share of the length that runs to the vanishing points of the best view are left out (of the
right views on 33 real frames of penalty areas one has less than 0.8).
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
EXPLAINED_SHARE = 0.8
"""Share of the length of all seen lines and arcs that the score of the best hypothesis must have for views of the next
kind not to be looked at: most pictures of penalty areas show boards and creases too, so that all kinds are looked at.
"""
ON_ARC_PX, ON_ARC_SHARE = 20.0, 0.8
"""Pixels at 1920 px width from the place of an arc under the rough camera, and the share of a seen curve's points that
lies within it, for the curve to be that arc. Under a camera from three lines of a real frame that was taken in a fast
pan the right penalty arc lies 5 to 20 px off; of 120 rendered pictures, of all of which 12 px gave the answer, 20 give
that verdict too.
"""
REFINED_SHARE = 0.5
"""Of both distances, within which lines and curves lie under a camera that was moved onto them. A goal area with a part
of the centre circle looks like a penalty area with its arc, 20 px off; what the lens leaves of it is 3 to 6 px.
"""
ARC_POINTS = 24
"""Of a seen curve, from which its distance from an arc is measured."""


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
        Pixels of seen lines and arcs that it explains, less what it leaves over or predicts in vain, in picture widths.
    """

    names: dict[int, str]
    theta: Array
    score: float


def propose_cameras(
    segments: Array,
    arcs: Sequence[Array],
    template: FieldTemplate,
    model: ProjectionModel,
    side: str,
    most: int,
) -> list[FieldHypothesis]:
    """Names and cameras that explain straight markings and arcs without any circle, the best first.

    Parameters
    ----------
    segments : (S, 2, 2) array
        Ends of seen lines, pixels.
    arcs : sequence of (N, 2) arrays
        Points of seen curves, pixels.
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
    curves = [points[:: -(-len(points) // ARC_POINTS)] for points in arcs if len(points) > 1]
    enough = EXPLAINED_SHARE * (length[used].sum() + sum(extent(points) for points in curves)) / model.width
    best: list[FieldHypothesis] = []
    for views in _all_views(lines, ends):
        if len(views.focal) == 0:
            continue
        directed = length_to_vanishing_points(views, ends)
        views = views.take(directed >= DIRECTED_SHARE * directed.max())
        theta = _positions(views, lines, template, model, side)
        found = _rank(theta, segments[used], used, curves, template, model, most) if len(theta) else []
        best = sorted((*best, *found), key=lambda hypothesis: -hypothesis.score)
        if best and best[0].score >= enough:
            break
    return _drop_subsets(best)[:most]


def _all_views(lines: Array, ends: Array) -> Iterator[Views]:
    """Views from two vanishing points, and where those leave much unexplained from one and a level camera."""
    yield two_pair_views(lines)
    yield level_views(lines, ends)
    yield three_line_views(lines, ends)


def _drop_subsets(found: list[FieldHypothesis]) -> list[FieldHypothesis]:
    """Hypotheses, the best first, without those whose names a better one has too."""
    kept: list[FieldHypothesis] = []
    for one in found:
        if _has_more(one.names, kept):
            kept.append(one)
    return kept


def _has_more(names: dict[int, str], found: Sequence[FieldHypothesis]) -> bool:
    """Whether names say something that none of some hypotheses says."""
    return not any(names.items() <= other.names.items() for other in found)


def _positions(views: Views, lines: Array, template: FieldTemplate, model: ProjectionModel, side: str) -> Array:
    """Cameras (B, P) of the views under all names of their lines for which the heights of both pairs agree."""
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
    is_pair_along, is_pair_across = views.directions
    height_y, middle_y = _name_lines(t_pair, is_pair_along, y_offsets)
    height_x, middle_x = _name_lines(u_pair, is_pair_across, x_offsets)
    # names under which both heights agree, and any name of a single line, which tells none
    view, ny = np.nonzero(np.isfinite(height_y) | ~is_pair_along[:, None] & np.isfinite(middle_y))
    agree = np.abs(np.log(height_y[view, ny])[:, None] - np.log(height_x[view])) < SAME_HEIGHT
    agree |= ~is_pair_along[view][:, None] & np.isfinite(height_x[view])
    agree |= ~is_pair_across[view][:, None] & np.isfinite(middle_x[view])
    row, nx = np.nonzero(agree)
    view, ny = view[row], ny[row]
    heights = np.stack([height_y[view, ny], height_x[view, nx]])
    height = np.exp(np.nanmean(np.log(heights), axis=0))
    # 2, at the middle of each pair, where an error of the height moves nothing
    C_y = middle_y[view, ny] + height * t_pair[view].mean(axis=-1)
    C_x = middle_x[view, nx] + height * u_pair[view].mean(axis=-1)
    position = np.stack([C_x, C_y, -height], axis=-1)
    turned = position[:, :2] @ np.array(SIDES[side]) < 0
    R = views.axes[view].copy()
    R[turned, :, :2] *= -1.0
    position[turned, :2] *= -1.0
    near = (np.abs(position[:, :2]) < REACH_M).all(axis=1)
    return _thetas(views.focal[view][near] * model.width / 2.0, R[near], position[near])


def _name_lines(slope: Array, is_pair: Mask, offsets: Array) -> tuple[Array, Array]:
    """Heights (V, M) of the camera under all M ordered pairs of offsets of two lines with these slopes (V, 2),
    nan where it has none, and the middle of each pair of offsets (V, M).

    Where there is one line only it has the first names, all heights are nan, and so are the middles that are left.
    """
    height, middle = _heights(slope, offsets)
    alone = np.full(middle.shape[1], np.nan)
    alone[: len(offsets)] = offsets
    return np.where(is_pair[:, None], height, np.nan), np.where(is_pair[:, None], middle, alone)


def _heights(slope: Array, offsets: Array) -> tuple[Array, Array]:
    """Heights (V, M) of the camera under all M ordered pairs of offsets of two lines with these slopes (V, 2), nan
    where it has none, and the middle of each pair of offsets (V, M).
    """
    i, j = (index.ravel() for index in np.indices((len(offsets), len(offsets))))
    if len(offsets) > 1:
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

    def join(self, others: _Matches) -> _Matches:
        return _Matches(np.concatenate([self.marking, others.marking]), np.concatenate([self.along, others.along]))


def _rank(
    theta: Array,
    segments: Array,
    used: Indices,
    curves: Sequence[Array],
    template: FieldTemplate,
    model: ProjectionModel,
    most: int,
) -> list[FieldHypothesis]:
    """The cameras (B, P) under which most of the seen lines and curves have a name, and little is missing."""
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    matches = _match(theta, segments, template, model)
    explained = (matches.marking >= 0) @ length
    order = np.argsort(-explained, kind="stable")[:KEPT]
    matches, theta = matches.take(order), theta[order]
    shares = [share for share, _ in _lie_near_rings(theta, curves, template, model)]
    refined = _refine(theta, matches, segments, curves, shares, template, model)
    matches = matches.join(_match(refined, segments, template, model, REFINED_SHARE))
    # the circles count under the moved cameras alone
    first = len(template.circles)
    within = [share for share, _ in _lie_near_rings(refined, curves, template, model, REFINED_SHARE)]
    arcs = _weigh_curves(curves, [s[:, first:] for s in shares], len(theta)), _weigh_curves(curves, within, len(theta))
    arc_px, arc_count = (np.concatenate(pair) for pair in zip(*arcs, strict=True))
    theta, explained = np.concatenate([theta, refined]), (matches.marking >= 0) @ length
    score = (explained + arc_px - MISSING_WEIGHT * _missing_px(theta, matches, template, model)) / model.width
    found: list[FieldHypothesis] = []
    for k in np.argsort(-score, kind="stable").tolist():
        names = {int(used[s]): template.lines[t].name for s, t in enumerate(matches.marking[k].tolist()) if t >= 0}
        is_enough = len(set(names.values())) >= FEWEST_LINES and len(set(names.values())) + arc_count[k] >= FEWEST_NAMED
        if not is_enough or not _has_more(names, found):
            continue
        found.append(FieldHypothesis(names, theta[k], float(score[k])))
        if len(found) == most:
            break
    return found


def _refine(
    theta: Array,
    matches: _Matches,
    segments: Array,
    curves: Sequence[Array],
    shares: Sequence[Array],
    template: FieldTemplate,
    model: ProjectionModel,
) -> Array:
    """The cameras (B, P), moved onto the lines and curves that have a name under them, of which the ``shares`` (B, A)
    lie near each circle and arc.
    """
    rings = np.full((len(theta), len(curves)), -1)
    points = np.zeros((len(curves), ARC_POINTS, 2))
    for k, share in enumerate(shares):
        rings[:, k] = np.where(share.max(axis=1, initial=0.0) >= ON_ARC_SHARE, share.argmax(axis=1), -1)
        points[k] = curves[k][np.linspace(0, len(curves[k]) - 1, ARC_POINTS).round().astype(int)]
    seen = SeenMarkings(segments, matches.marking, points, rings)
    return refine_views(theta, seen, template, template.round_ones, model)


def _match(
    theta: Array, segments: Array, template: FieldTemplate, model: ProjectionModel, share: float = 1.0
) -> _Matches:
    """For every seen line (S, 2, 2) the nearest marking on whose extent it lies, within a share of NAMED_PX."""
    drawn, _ = template.drawn_lines
    span = drawn[:, 1] - drawn[:, 0]
    extent = np.linalg.norm(span, axis=-1)
    direction = span / extent[:, None]
    back = np.asarray(np.linalg.inv(homographies(theta, model)), np.float64)
    # the first ends of all lines, then their last ones
    count, ends = len(segments), lift(np.concatenate([segments[:, 0], segments[:, 1]])).T
    seen = (template.line_rows @ back).reshape(-1, 3)  # lines go by the inverse transpose
    seen /= np.sqrt(seen[:, :1] * seen[:, :1] + seen[:, 1:2] * seen[:, 1:2])
    off_ends = seen @ ends
    np.abs(off_ends, out=off_ends)
    off = np.maximum(off_ends[:, :count], off_ends[:, count:]).reshape(len(theta), len(drawn), count)
    # few lines lie near a marking: whether they lie on its extent is asked of these alone
    camera, marking, line = np.nonzero(off < share * NAMED_PX * model.width / 1920.0)
    places, toward = _meet_ground(back, ends, model), direction[marking]
    start = (drawn[:, 0] * direction).sum(axis=-1)[marking]
    along = [(places[camera, :, end] * toward).sum(axis=-1) - start for end in (line, line + count)]
    low, high = np.minimum(*along), np.maximum(*along)
    on = (low > -BEYOND_M) & (high < extent[marking] + BEYOND_M)
    # of several markings the nearest comes last, and is kept
    order = np.flatnonzero(on)[np.lexsort((-marking[on], -off[camera, marking, line][on]))]
    camera, line = camera[order], line[order]
    nearest, reaches = np.full((len(theta), count), -1), np.zeros((len(theta), count, 2))
    nearest[camera, line] = marking[order]
    reaches[camera, line] = np.stack([low[order], high[order]], axis=-1)
    return _Matches(nearest, reaches)


def _meet_ground(back: Array, pixels: Array, model: ProjectionModel) -> Array:
    """Places (B, 2, N) of the field that pixels (3, N), homogeneous, show under cameras by their inverse homographies
    (B, 3, 3); nan above the horizon.
    """
    field = back @ pixels
    depth = field[:, 2:]
    # a pixel below the horizon has the sign of the picture's lower middle
    below = back[:, 2] @ np.array([model.center[0], 2.0 * model.height, 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(depth * np.sign(below)[:, None, None] > 0, field[:, :2] / depth, np.nan)


def _see_places(theta: Array, places: Array, model: ProjectionModel) -> tuple[Array, Array]:
    """Columns and rows (B, ...), pixels, of places of the field (..., 2) under cameras (B, P) without lens or crown;
    nan behind these.
    """
    seen = homographies(theta, model) @ lift(places.reshape(-1, 2)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.where(seen[:, 2:] > NEAREST_M, seen[:, :2] / seen[:, 2:], np.nan)
    x, y = (pixels[:, k].reshape(len(theta), *places.shape[:-1]) for k in range(2))
    return x, y


def _missing_px(theta: Array, matches: _Matches, template: FieldTemplate, model: ProjectionModel) -> Array:
    """Length (B,) of the markings in view on which no line was seen, pixels."""
    drawn, _ = template.drawn_lines
    share = (np.arange(NODES + 1) / NODES)[:, None]
    places = drawn[:, :1] + share * (drawn[:, 1:] - drawn[:, :1])
    x, y = _see_places(theta, places, model)
    inside = (x > 0) & (x < model.width) & (y > 0) & (y < model.height)
    by_x, by_y = np.diff(x, axis=2), np.diff(y, axis=2)
    length = np.where(inside[..., 1:] & inside[..., :-1], np.sqrt(by_x * by_x + by_y * by_y), 0.0)
    metres = (share[:-1, 0] + 0.5 / NODES) * np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=-1)[:, None]
    covered = np.zeros(length.shape, np.bool_)
    for s in range(matches.marking.shape[1]):
        camera = np.flatnonzero(matches.marking[:, s] >= 0)
        marking, along = matches.marking[camera, s], matches.along[camera, s]
        covered[camera, marking] |= (metres[marking] >= along[:, :1]) & (metres[marking] <= along[:, 1:])
    return np.asarray(np.where(covered, 0.0, length).sum(axis=(1, 2)))


def _weigh_curves(curves: Sequence[Array], shares: Sequence[Array], count: int) -> tuple[Array, Indices]:
    """Length (B,), pixels, of the seen curves that lie on a circle or an arc of the field under each of ``count``
    cameras, by the ``shares`` (B, A) of each that do, and on how many of these circles and arcs (B,) one was seen.
    """
    length, seen = np.zeros(count), np.zeros(count, np.int_)
    for points, share in zip(curves, shares, strict=True):
        length += (share >= ON_ARC_SHARE).any(axis=1) * extent(points)
    if shares:
        seen = (np.stack(shares) >= ON_ARC_SHARE).any(axis=0).sum(axis=1)
    return length, seen


def _lie_near_rings(
    theta: Array, curves: Sequence[Array], template: FieldTemplate, model: ProjectionModel, reach: float = 1.0
) -> Iterator[tuple[Array, Array]]:
    """For each seen curve, pixels (N, 2), the share (B, A) of it that lies near where each camera (B, P) puts each
    circle and each arc of the field, within a share of the usual distance, and its mean distance from there (B, A).
    """
    circle_count, count = len(template.circles), len(template.round_ones)
    rings = template.outlines[1][circle_count:count]
    x, y = _see_places(theta, rings, model)
    # nearest place, and half a step between two places at most beside it
    step = np.nan_to_num(np.sqrt(np.diff(x, axis=2) ** 2 + np.diff(y, axis=2) ** 2)).max(axis=2, initial=0.0)
    x, y = (np.where(np.isfinite(values), values, np.inf) for values in (x, y))
    reach_px = np.full((len(theta), count, 1), reach * ON_ARC_PX * model.width / 1920.0)
    reach_px[:, circle_count:] += step[..., None] / 2
    back = np.asarray(np.linalg.inv(homographies(theta, model)), np.float64)[:, None]
    circles = circle_conics(template.circles, template)
    for points in curves:
        of_arcs = _distances_from_arcs(points, x, y, reach_px[:, circle_count:, 0])
        of_circles = np.abs(distances_from_circles(back, circles, points))
        nearest = np.concatenate([of_circles, of_arcs], axis=1)
        yield np.asarray((nearest < reach_px).mean(axis=2)), np.asarray(nearest.mean(axis=2))


def _distances_from_arcs(points: Array, x: Array, y: Array, reach_px: Array) -> Array:
    """Distances (B, A, N) of pixels (N, 2) from the nearest places (B, A, M) of arcs; inf where all of them lie further
    away than the reach (B, A).
    """
    middle = points.mean(axis=0)
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    away = np.sqrt(((middle[0] - x) ** 2 + (middle[1] - y) ** 2).min(axis=2, initial=np.inf))
    near = away < reach_px + radius + 1.0
    found = np.full((*near.shape, len(points)), np.inf)
    aside, above = points[:, :1] - x[near][:, None], points[:, 1:] - y[near][:, None]
    found[near] = np.sqrt((aside * aside + above * above).min(axis=2, initial=np.inf))
    return found


def find_arc(points: Array, theta: Array, template: FieldTemplate, model: ProjectionModel) -> str | None:
    """Name of the circle or arc that nearly all pixels (N, 2) of a seen curve lie near under a camera (P,), the nearest
    one; None where there is none.
    """
    curves = template.round_ones
    if not curves or len(points) < 2:
        return None
    share, off = next(_lie_near_rings(theta[None], [points], template, model))
    off = np.where(share[0] >= ON_ARC_SHARE, off[0], np.inf)
    return curves[int(off.argmin())].name if np.isfinite(off).any() else None
