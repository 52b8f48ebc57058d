"""A straight marking followed beyond its measured part, piece by piece."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from circlecal.geometry.projective import Array, lift
from circlecal.paint.lines import WIDE_ROUND, measure_lines
from circlecal.paint.profiles import GrayPicture
from circlecal.results import LineCue, Segment

__all__ = ["clip_segment", "follow_line", "widths_at"]

BORDER_PX = 2.0
"""Distance from the picture's border at which segments are cut off, pixels."""
MOST_PIECES = 12
"""Pieces by which the halfway line is followed on each side of the circle: more than a picture holds."""
PIECE_SUPPORT = 0.35
"""Least share of a piece of the halfway line outside the circle on which it is seen."""
LARGEST_GAP = 0.2
"""Pieces of a straight marking lie no further apart than this share of the half chord; it ends at the touchline."""
WIDEST = 1.6
"""What is so many times as wide as the marking inside the circle lets one expect is another thing."""
AHEAD_PX, LARGEST_SHIFT_PX = 250.0, 2.0
"""How far ahead the pieces of a straight marking are measured together, and how far off, where the line turns, a piece
may have been looked for; pixels at 1920 px width.
"""
LARGEST_BEND = 0.03
"""Sine of the angle between neighbouring pieces of a straight marking: lens and crown bend it less than that."""


def follow_line(
    picture: GrayPicture,
    near: LineCue,
    step_px: float,
    growth: Array,
    noise: float,
    search_px: float,
    spacing_px: float,
) -> list[LineCue]:
    """Pieces of a straight marking beyond its measured part, each expected where those before point to.

    Lens and crown bend the line, so the pieces follow it; the first that is not clearly there ends the search on its
    side. Over a short way it is straight enough to measure all pieces on it together.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    near : LineCue
        The measured part.
    step_px : float
        Length of a piece.
    growth : (3,) array
        Width of the paint: coefficients of x, y and 1, px.
    noise : float
        Grey-level noise of the picture.
    search_px, spacing_px : float
        As for :func:`circlecal.paint.lines.measure_lines`.
    """
    unit = picture.shape[1] / 1920.0
    together = max(1, round(AHEAD_PX * unit / step_px))
    # paint may be wider than the template says, and blur adds to it
    usual = float(widths_at(growth, [near.segment]).mean())
    growth = growth * max(1.0, near.width_px / max(usual, 1e-9))
    found: list[LineCue] = []
    sides = [(near.segment.start, near.segment.end), (near.segment.end, near.segment.start)]
    for _ in range(-(-MOST_PIECES // together)):
        ahead = [_pieces_ahead(*side, step_px, together, picture.shape) for side in sides]
        rough = [piece for pieces in ahead for piece in pieces]
        if not rough:
            break
        widths = widths_at(growth, rough)
        measured = measure_lines(picture, rough, noise, search_px, spacing_px, WIDE_ROUND, widths)
        widest = WIDEST * np.maximum(widths.max(axis=1), near.width_px / WIDEST)
        seen = iter(zip(rough, measured, widest.tolist(), strict=True))
        reached = []
        for side, pieces in zip(sides, ahead, strict=True):
            kept, end = _advance(*side, [next(seen) for _ in pieces], step_px, LARGEST_SHIFT_PX * unit)
            found += kept
            reached += [] if end is None else [end]
        sides = reached
    return found


def _pieces_ahead(start: Array, end: Array, step_px: float, most: int, shape: tuple[int, ...]) -> list[Segment]:
    """Pieces in the picture of the line from ``start`` beyond ``end``."""
    direction = (end - start) / np.hypot(*(end - start))
    pieces = []
    for k in range(most):
        ahead = clip_segment(
            end + (1.0 + k * step_px) * direction, end + (k + 1) * step_px * direction, shape[1], shape[0]
        )
        if ahead is None or np.hypot(*(ahead[1] - ahead[0])) < 0.25 * step_px:
            break
        pieces.append(Segment(*ahead))
    return pieces


def _advance(
    start: Array, end: Array, pieces: list[tuple[Segment, LineCue | None, float]], step_px: float, shift_px: float
) -> tuple[list[LineCue], tuple[Array, Array] | None]:
    """The pieces that go on from the line from ``start`` to ``end``, each with where it was looked for and how wide it
    may be; and the last two ends, or None where the line is seen no further.
    """
    kept: list[LineCue] = []
    for rough, piece, widest_px in pieces:
        direction = (end - start) / np.hypot(*(end - start))
        across = np.array([-direction[1], direction[0]])
        if abs(float(across @ (rough.end - end))) > shift_px:
            return kept, (start, end)
        if piece is None or piece.segment.support < PIECE_SUPPORT or piece.width_px > widest_px:
            return kept, None
        ahead_px = (piece.points_px - end) @ direction
        if abs(float(piece.line[:2] @ direction)) > LARGEST_BEND or ahead_px.min() > LARGEST_GAP * step_px:
            return kept, None
        kept.append(piece)
        start, end = end, piece.points_px[np.argmax(ahead_px)]
    return kept, (start, end) if pieces else None


def widths_at(growth: Array, segments: Sequence[Segment]) -> Array:
    """Expected width (K, 2) of the paint at both ends, px."""
    return np.maximum(lift([(segment.start, segment.end) for segment in segments]) @ growth, 0.0)


def clip_segment(start: Array, end: Array, width: int, height: int) -> tuple[Array, Array] | None:
    """The part of a segment at least ``BORDER_PX`` inside the picture, or None."""
    first, last = 0.0, 1.0
    for at, step, size in zip(start.tolist(), (end - start).tolist(), (width, height), strict=True):
        low, high = BORDER_PX - at, size - 1 - BORDER_PX - at
        if step == 0:
            if not low <= 0 <= high:
                return None
        else:
            enter, leave = sorted((low / step, high / step))
            first, last = max(first, enter), min(last, leave)
    if not first < last:
        return None
    return start + first * (end - start), start + last * (end - start)
