"""Two runs of the same frames side by side: what got better, what got worse, and how far their cameras lie apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from circlecal.report.drawings import Scene
from circlecal.report.reading import FrameRow

SURER = 0.8
"""A frame is surer where its predicted sigma is below this share of the other run's, and less sure the other way round:
the same command on another processor changes sigma by a few per cent.
"""
MOVED_SIGMAS = 3.0
"""Two cameras differ where they lie further apart than so many of both predicted sigmas together."""
MOVED_PX = 2.0
"""And further than this, pixels at 1920 px width: about the width of a thin line, which nobody sees."""
PLACES = 400
"""Places along the markings at which two cameras are compared."""


class Change(IntEnum):
    """What became of a frame against the other run; the page's script knows the same numbers."""

    ABSENT = 0
    """The other run does not have the frame."""
    GAINED = 1
    """It was refused there."""
    LOST = 2
    """It was calibrated there, and is refused now."""
    MOVED = 3
    """Both are calibrated, by cameras that contradict each other."""
    SURER = 4
    LESS_SURE = 5
    ALIKE = 6
    """Nothing that matters; both refused, too."""


WORDS = {
    Change.GAINED: ("calibrated now, refused there", "better"),
    Change.SURER: (f"sigma below {100 * SURER:.0f} % of what it was", "better"),
    Change.LOST: ("refused now, calibrated there", "worse"),
    Change.LESS_SURE: (f"sigma more than {100 / SURER:.0f} % of what it was", "worse"),
    Change.MOVED: ("cameras further apart than their sigmas allow", "other"),
    Change.ALIKE: ("alike", "other"),
    Change.ABSENT: ("not in the other run", "other"),
}
"""What each change means, and which side it counts for."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """A frame against the other run.

    Attributes
    ----------
    change : Change
        What became of it.
    other : FrameRow or None
        Its row there.
    apart_px : float or None
        Root mean square distance between the markings as both cameras draw them, where this run's camera sees them,
        pixels at 1920 px width; None where one has no camera.
    """

    change: Change
    other: FrameRow | None = None
    apart_px: float | None = None


def compare(row: FrameRow, scene: Scene | None, other: FrameRow | None, other_scene: Scene | None) -> Comparison:
    """Compare a frame's result with that of another run.

    Parameters
    ----------
    row, scene : FrameRow, Scene or None
        Of this run.
    other, other_scene : FrameRow or None, Scene or None
        Of the other run; None where it does not have the frame.
    """
    if other is None:
        return Comparison(Change.ABSENT)
    apart = distance_px(scene, other_scene)
    if row.calibrated != other.calibrated:
        return Comparison(Change.GAINED if row.calibrated else Change.LOST, other, apart)
    if not row.calibrated:
        return Comparison(Change.ALIKE, other, apart)
    own, theirs = row.sigma_px, other.sigma_px
    allowed = max(MOVED_PX, MOVED_SIGMAS * float(np.hypot(own or 0.0, theirs or 0.0)))
    if apart is not None and apart > allowed:
        return Comparison(Change.MOVED, other, apart)
    if own is None or theirs is None or SURER * theirs <= own <= theirs / SURER:
        return Comparison(Change.ALIKE, other, apart)
    return Comparison(Change.SURER if own < theirs else Change.LESS_SURE, other, apart)


def distance_px(one: Scene | None, other: Scene | None) -> float | None:
    """Root mean square distance of the markings drawn by two cameras in the first one's picture, pixels at 1920 px
    width; None without two cameras.
    """
    if one is None or other is None or one.view is None or other.view is None or one.template is None:
        return None
    places = np.concatenate(list(one.template.polylines(1.0).values()))
    drawn = one.view.project(places)
    seen = np.flatnonzero(one.view.shows(np.nan_to_num(drawn, nan=-1.0)))
    seen = seen[:: max(1, len(seen) // PLACES)]
    scale = np.array([one.width / other.width, one.height / other.height])
    off = drawn[seen] - ((other.view.project(places[seen]) + 0.5) * scale - 0.5)
    squares = (off * off).sum(axis=1) * (1920.0 / one.width) ** 2
    return float(np.sqrt(squares.mean())) if len(squares) and np.isfinite(squares).all() else None


def count_changes(found: Sequence[Comparison]) -> list[tuple[Change, str, str, int]]:
    """Change, meaning, side ("better", "worse", "other") and number of frames of the changes that occur."""
    counted = Counter(one.change for one in found)
    return [(change, *words, counted[change]) for change, words in WORDS.items() if counted[change]]
