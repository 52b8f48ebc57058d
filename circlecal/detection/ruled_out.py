"""Circles, and lines through them, that turned out wrong and are not to be found again."""

from __future__ import annotations

import numpy as np

from circlecal.detection.hypotheses import EllipseBatch
from circlecal.geometry.conics import ellipse_from_conic
from circlecal.geometry.projective import Array, join, lift, normalise_line
from circlecal.results import Assignment

__all__ = ["assigned_alike", "segments_left", "segments_off"]

_ALIKE = 0.05  # shares of the half axes by which centres and axes of one circle may differ
_ON_LINE_PX1920 = 8.0


def assigned_alike(excluded: tuple[Assignment, ...], ellipse: EllipseBatch) -> tuple[Assignment, ...]:
    """Those whose circle is the first ellipse of the batch."""
    axes = np.array([ellipse.great_lengths[0], ellipse.small_lengths[0]])
    alike = []
    for assignment in excluded:
        other = ellipse_from_conic(assignment.conic)
        if other is None:
            continue
        shift = np.abs(other.center - ellipse.centers[0]).max()
        if max(shift, np.abs(np.asarray(other.semi_axes) - axes).max()) <= _ALIKE * float(axes[0]) + 1.0:
            alike.append(assignment)
    return tuple(alike)


def segments_left(segments: Array, alike: tuple[Assignment, ...], width: int) -> Array:
    """Segments (K, 2, 2) of a picture of this width without those on the lines that are ruled out."""
    for assignment in alike:
        if assignment.halfway is None:
            return segments[:0]
        segments = segments_off(segments, join(lift(assignment.halfway.start), lift(assignment.halfway.end)), width)
    return segments


def segments_off(segments: Array, line: Array, width: int) -> Array:
    """Segments (K, 2, 2) of a picture of this width without those on a line (3,)."""
    off = np.abs(lift(segments) @ normalise_line(line)).max(axis=-1)
    return segments[off > _ON_LINE_PX1920 * width / 1920.0]
