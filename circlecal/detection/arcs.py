"""Parts of circles that are drawn: the arcs of the field, and short parts of the circle itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.circle import CircleHypothesis, MeasuredCircle
from circlecal.detection.options import LikelyConfig
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.projective import Array, join, lift, line_distance

__all__ = ["SAME_ARC", "distinct_arcs", "drawn_arc", "near_conics"]

SAME_ARC = 0.003
"""Picture widths: arcs no further apart follow one marking."""
_MOST_ARCS = 3
_FEWEST = 6  # samples of an arc
_CLEAN_PX1920 = 0.5  # residual of an arc that holds no points of another marking
_LARGEST_GAP = 0.02  # share of the circle: a longer gap ends a drawn part of it
_DENSE = 0.75  # least share of such a part that is drawn
_ARC_RMS_PX1920, _LEAST_BOW = 1.0, 0.004  # how well it follows the ellipse, and its height in picture widths


def drawn_arc(
    circle: MeasuredCircle, hypothesis: CircleHypothesis, width: int, config: LikelyConfig
) -> CircleHypothesis | None:
    """The longest part of a circle that is drawn without a gap, where that is an arc of a marking; its other points
    are left out. Of a penalty arc the picture shows the whole circle, and less than a third of it is drawn.
    """
    on = np.flatnonzero(circle.band.supported)
    if len(on) < _FEWEST:
        return None
    share = circle.angle_share
    middle = np.cumsum(share) - 0.5 * share
    gap = np.diff(middle[on], append=1.0 + middle[on[0]])
    first = (int(np.argmax(gap)) + 1) % len(on)
    on, gap = np.roll(on, -first), np.roll(gap, -first)
    run = np.concatenate([[0], np.cumsum(gap[:-1] > _LARGEST_GAP)])
    drawn = np.bincount(run, share[on])
    longest = int(np.argmax(drawn))
    on = on[run == longest]
    extent = float((middle[on[-1]] - middle[on[0]]) % 1.0)
    if drawn[longest] < max(config.arc_share, _DENSE * extent) or len(on) < _FEWEST:
        return None
    points = circle.points[on] + circle.band.offset[on, None] * circle.normals[on]
    rms = float(np.sqrt(np.mean(circle.band.offset[on] ** 2))) * 1920.0 / width
    bow = float(np.abs(line_distance(join(lift(points[0]), lift(points[-1])), points)).max())
    if rms > _ARC_RMS_PX1920 or bow < _LEAST_BOW * width:
        return None
    return replace(hypothesis, points=points, rms_px=rms)


def distinct_arcs(
    arcs: list[CircleHypothesis], circle: CircleHypothesis | None, apart_px: float, gapless_share: float
) -> tuple[CircleHypothesis, ...]:
    """One of those that follow the same marking, best one without a gap, which may be the circle, then a clean one,
    then the one that shows most of it; none that follows the circle.
    """

    def order(found: CircleHypothesis) -> tuple[bool, bool, int]:
        return found.least_share < gapless_share, found.rms_px > _CLEAN_PX1920, -len(found.points)

    conics = [] if circle is None else [circle.conic]
    kept: list[CircleHypothesis] = []
    for arc in sorted(arcs, key=order):
        if all(np.median(np.abs(sampson_distance(conic, arc.points))) > apart_px for conic in conics):
            kept.append(arc)
            conics.append(arc.conic)
    return tuple(kept[:_MOST_ARCS])


def near_conics(points: Array, conics: list[Array], distance_px: float) -> NDArray[np.bool_]:
    """Which points (N, 2) lie this near to one of the conics."""
    near = np.zeros(len(points), np.bool_)
    for conic in conics:
        near |= np.abs(sampson_distance(conic, points)) < distance_px
    return near
