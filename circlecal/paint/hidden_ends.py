"""Ends of a straight marking that are those of a player: where two markings meet he stands on both, and what is
followed over him ends on the boards behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from circlecal.geometry.projective import Array, fit_line, meet
from circlecal.paint.ends import piece_beside
from circlecal.results import LineCue

__all__ = ["leave_out_hidden_ends"]

STOP_PX = 20.0
"""Pixels at 1920 px width from the last measured point of a marking within which another one crosses it, for the
marking to stop there.
"""
BEYOND_PX = 24.0
"""Pixels at 1920 px width behind that crossing from which on an end is the boards' above a player: where one stood, a
rendered line was followed 40 px too far. A border that another sport's line runs beside, 10 px before it, is an end.
"""
ASIDE_PX = 30.0
"""Pixels at 1920 px width over which the crossing marking is seen on both sides: more than a far player's width."""
LEAST_SINE = 0.15
"""Sine of the least angle, in the picture, between two markings that cross."""


def leave_out_hidden_ends(line: LineCue, others: Sequence[LineCue], unit: float) -> LineCue:
    """The marking without ends behind another marking at which its measured points stop.

    Parameters
    ----------
    line : LineCue
        The marking, with its ends.
    others : sequence of LineCue
        The other straight markings.
    unit : float
        Width of the picture, in 1920 px.
    """
    ends = tuple(end for end in line.ends if not any(_stops_at(line, other, end.point_px, unit) for other in others))
    return line if len(ends) == len(line.ends) else replace(line, ends=ends)


def _stops_at(line: LineCue, other: LineCue, end_px: Array, unit: float) -> bool:
    """Whether the points of a marking stop where another one crosses it, well before an end (2,)."""
    points = line.points_px
    outward = end_px - points.mean(axis=0)
    outward = outward / max(float(np.linalg.norm(outward)), 1e-9)
    last = points[np.argmax(points @ outward)]
    course = _course_beside(other.points_px, last)
    if abs(float(course[:2] @ outward)) < LEAST_SINE:
        return False
    meeting = meet(course, _course_beside(points, last))
    crossing = meeting[:2] / meeting[2]
    behind, left = float((crossing - last) @ outward), float((end_px - crossing) @ outward)
    aside = (other.points_px - crossing) @ np.array([-course[1], course[0]])
    is_seen = min(-aside.min(), aside.max()) > ASIDE_PX * unit
    return bool(is_seen and abs(behind) < STOP_PX * unit and left > BEYOND_PX * unit)


def _course_beside(points_px: Array, place_px: Array) -> Array:
    """Line (3,) of a marking (N, 2) beside a place (2,), of all of it where it is not seen there."""
    line = fit_line(points_px)
    beside = piece_beside(points_px, place_px, np.array([-line[1], line[0]]), fewest=3)
    return line if len(beside) == len(points_px) else fit_line(beside)
