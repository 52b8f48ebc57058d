"""Circles, and lines through them, that turned out wrong and are not to be found again."""

from __future__ import annotations

import numpy as np

from circlecal.detection.hypotheses import EllipseBatch
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, join, lift, normalise_line
from circlecal.results import Interpretation

__all__ = ["interpretations_of", "segments_left", "segments_off"]

_ALIKE = 0.05  # shares of the half axes by which centres and axes of one circle may differ
_ON_LINE_PX1920 = 8.0


def interpretations_of(ruled_out: tuple[Interpretation, ...], ellipse: EllipseBatch) -> tuple[Interpretation, ...]:
    """Those whose circle is the first ellipse of the batch."""
    axes = np.array([ellipse.great_lengths[0], ellipse.small_lengths[0]])
    alike = []
    for interpretation in ruled_out:
        other = ellipse_from_conic(interpretation.conic)
        if other is None:
            continue
        shift = np.abs(other.center - ellipse.centers[0]).max()
        if max(shift, np.abs(np.asarray(other.semi_axes) - axes).max()) <= _ALIKE * float(axes[0]) + 1.0:
            alike.append(interpretation)
    return tuple(alike)


def segments_left(segments: Array, alike: tuple[Interpretation, ...], width: int) -> Array:
    """Segments (K, 2, 2) of a picture of this width without those on the lines that are ruled out."""
    for interpretation in alike:
        if interpretation.line is None:
            return segments[:0]
        segments = segments_off(segments, join(lift(interpretation.line.start), lift(interpretation.line.end)), width)
    return segments


def segments_off(segments: Array, line: Array, width: int) -> Array:
    """Segments (K, 2, 2) of a picture of this width without those on a line (3,)."""
    off = np.abs(lift(segments) @ normalise_line(line)).max(axis=-1)
    return segments[off > _ON_LINE_PX1920 * width / 1920.0]
