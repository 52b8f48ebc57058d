"""Parts of circles: the arcs that are drawn, which are those of the field or short parts of the circle itself, and the
nearly straight near and far side of a flat circle, which are found as lines.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.circle import CircleHypothesis, MeasuredCircle, measure_circle
from circlecal.detection.ellipse_batch import adjust_ellipses, ellipse_conic, unit_frame
from circlecal.detection.options import ProfilesConfig
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, join, lift, line_distance

__all__ = ["GAPLESS_SHARE", "SAME_ARC", "find_longest_arc", "lie_near_conics", "move_onto_straight_arcs", "select_arcs"]

SAME_ARC = 0.003
"""Picture widths: arcs no further apart follow one marking."""
GAPLESS_SHARE = 0.65
"""Least share of what is seen of a circle that is drawn, where an arc without a line through its middle has hardly a
gap and may be the circle, if other lines confirm it; an arc that ends inside the picture has less.
"""
MOST_ARCS = 3
"""Of one picture: the circle and two penalty arcs."""
FEWEST_SAMPLES = 6
"""Of an arc: five fix an ellipse."""
CLEAN_PX = 0.5
"""Residual, pixels at 1920 px width, up to which an arc is taken to hold no points of another marking; single samples
of paint scatter by 0.1 to 0.2 in broadcast frames.
"""
LARGEST_GAP = 0.02
"""Share of the circle: a longer gap ends a drawn part of it; the halfway line's crossing hides less."""
ARC_SHARE = 0.12
"""Smallest share of a circle that is drawn without a gap where it is taken for an arc of the field; a penalty arc is
0.29 of its circle.
"""
DENSE_SHARE = 0.75
"""Least share of such a part that is drawn."""
ARC_RMS_PX = 1.0
"""Largest residual of an arc, pixels at 1920 px width."""
LEAST_BOW = 0.004
"""Height of an arc over its chord, picture widths: flatter ones are lines."""

SAMPLES = 33
"""Places along a straight run that are compared with the ellipse, and its points in the fit."""
BESIDE = 0.25
"""Radii from the circle, where the ellipse is the unit circle: no other marking runs along it so near."""
SHORTEST_RAD = 0.25
"""Radians of the circle along which a straight run must lie beside it."""
APART_PX = 4.0
"""Pixels at 1920 px width: lines nearer to the ellipse were followed by it already."""
STEPS = 4
"""Of the fit to the straight run; it moves by up to a quarter of the small half axis."""


def find_longest_arc(circle: MeasuredCircle, hypothesis: CircleHypothesis, width: int) -> CircleHypothesis | None:
    """The longest part of a circle that is drawn without a gap, where that is an arc of a marking; its other points
    are left out. Of a penalty arc the picture shows the whole circle, and less than a third of it is drawn.
    """
    on = np.flatnonzero(circle.curve.supported)
    if len(on) < FEWEST_SAMPLES:
        return None
    share = circle.angle_share
    middle = np.cumsum(share) - 0.5 * share
    gap = np.diff(middle[on], append=1.0 + middle[on[0]])
    first = (int(np.argmax(gap)) + 1) % len(on)
    on, gap = np.roll(on, -first), np.roll(gap, -first)
    run = np.concatenate([[0], np.cumsum(gap[:-1] > LARGEST_GAP)])
    drawn = np.bincount(run, share[on])
    longest = int(np.argmax(drawn))
    on = on[run == longest]
    extent = float((middle[on[-1]] - middle[on[0]]) % 1.0)
    if drawn[longest] < max(ARC_SHARE, DENSE_SHARE * extent) or len(on) < FEWEST_SAMPLES:
        return None
    points = circle.curve.points[on] + circle.curve.offset[on, None] * circle.curve.normals[on]
    rms = float(np.sqrt(np.mean(circle.curve.offset[on] ** 2))) * 1920.0 / width
    bow = float(np.abs(line_distance(join(lift(points[0]), lift(points[-1])), points)).max())
    if rms > ARC_RMS_PX or bow < LEAST_BOW * width:
        return None
    return replace(hypothesis, points=points, rms_px=rms)


def select_arcs(
    arcs: list[CircleHypothesis], circle: CircleHypothesis | None, width: int
) -> tuple[CircleHypothesis, ...]:
    """One of those that follow the same marking in a picture of this width, best one without a gap, which may be the
    circle, then a clean one, then the one that shows most of it; none that follows the circle.
    """

    def order(found: CircleHypothesis) -> tuple[bool, bool, int]:
        return found.least_share < GAPLESS_SHARE, found.rms_px > CLEAN_PX, -len(found.points)

    conics = [] if circle is None else [circle.conic]
    kept: list[CircleHypothesis] = []
    for arc in sorted(arcs, key=order):
        if all(median_of_rows(np.abs(sampson_distance(conic, arc.points))) > SAME_ARC * width for conic in conics):
            kept.append(arc)
            conics.append(arc.conic)
    return tuple(kept[:MOST_ARCS])


def lie_near_conics(points: Array, conics: list[Array], distance_px: float) -> NDArray[np.bool_]:
    """Which points (N, 2) lie this near to one of the conics."""
    near = np.zeros(len(points), np.bool_)
    for conic in conics:
        near |= np.abs(sampson_distance(conic, points)) < distance_px
    return near


def move_onto_straight_arcs(
    gray: NDArray[np.uint8], circle: MeasuredCircle, segments: Array, config: ProfilesConfig
) -> MeasuredCircle:
    """Move an ellipse that runs beside a straight run, on streaks of the surface, onto it.

    The near and the far side of a flat circle are straight over a long way, and found as lines.

    Parameters
    ----------
    gray : (H, W) uint8
        Full picture.
    circle : MeasuredCircle
    segments : (K, 2, 2) array
        Ends of the straight runs, px.
    config : ProfilesConfig

    Returns
    -------
    MeasuredCircle
        The circle that also follows the straight runs beside it, where more of that one is drawn; else the one given.
    """
    if len(segments) == 0:
        return circle
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    points = segments[:, None, 0] + share * (segments[:, None, 1] - segments[:, None, 0])
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))[:2]
    local = lift(points) @ to_unit.T
    near = (np.abs(np.hypot(local[..., 0], local[..., 1]) - 1.0) < BESIDE).all(axis=1)
    if not near.any():
        return circle
    points, local = points[near], local[near]
    angle = np.unwrap(np.arctan2(local[..., 1], local[..., 0]), axis=1)
    turn = np.abs(angle[:, -1] - angle[:, 0])
    beside = turn > SHORTEST_RAD
    conic, apart_px = ellipse_conic(circle.ellipse), APART_PX * gray.shape[1] / 1920.0
    for k in np.flatnonzero(beside):
        beside[k] = median_of_rows(np.abs(sampson_distance(conic, points[k]))) > apart_px
    if not beside.any():
        return circle
    own = lift(circle.curve.marking_points) @ to_unit.T
    own_angle = np.arctan2(own[:, 1], own[:, 0])
    middle, half = angle[beside, SAMPLES // 2], 0.5 * turn[beside]
    away = np.abs((own_angle[:, None] - middle + np.pi) % (2 * np.pi) - np.pi) > half
    together = np.concatenate([circle.curve.marking_points[away.all(axis=1)], points[beside].reshape(-1, 2)])
    if len(together) < SAMPLES + FEWEST_SAMPLES:
        return circle
    ellipse = circle.ellipse
    for _ in range(STEPS):
        ellipse = adjust_ellipses(ellipse, together[None], np.ones((1, len(together))))
    moved = measure_circle(gray, ellipse, circle.sign, config)
    return max(circle, moved, key=lambda found: int(np.count_nonzero(found.curve.supported)))
