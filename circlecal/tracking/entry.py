"""What is kept of a frame between its picture and its answer."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array
from circlecal.tracking.looking import Look, Place
from circlecal.tracking.motion import HeadMotion
from circlecal.tracking.results import Carrier

EXPECTED_PLACES, BARE_SHARE = 60, 0.2
"""A picture that should show so many places of paint and shows less than this share of them contradicts its camera."""


@dataclass(frozen=True, slots=True)
class ClipFrame:
    """A decoded frame: its number from 0, its time in seconds, and its picture (H, W, 3), BGR."""

    index: int
    time_s: float
    picture: NDArray[np.uint8]


@dataclass(slots=True)
class Entry:
    """A frame until its shot is smoothed."""

    index: int
    time_s: float
    size: tuple[int, int]
    shot: int
    place: Place | None = None
    head: Array = field(default_factory=lambda: np.zeros(3))
    information: Array = field(default_factory=lambda: np.zeros((3, 3)))
    toward: Array = field(default_factory=lambda: np.zeros(3))
    by_common: Array | None = None
    motion: HeadMotion | None = None
    """From the frame before."""
    is_confirmed: bool = False
    is_in_place: bool = False
    """Whether nearly all paint is where the camera puts it, though it may not tell the camera."""
    is_contradicted: bool = False
    missing: int = 0
    """Number of markings that must be seen broadly and are not seen where the camera puts them."""
    expected: int = 0
    painted: int = 0
    rms_px: float = np.inf
    carriers: tuple[Carrier, ...] = ()
    spread: Array = field(default_factory=lambda: np.zeros(2))
    """How far the paint is off its markings, and how far it should be (2,), as a fit to it has them."""
    pull: Array | None = None
    """How the paint pulls the head along with the common parameters (3, K); None where it says nothing."""
    pull_by_errors: Array | None = None
    """How it pulls the head along with painters' errors (3, E); None where it says nothing."""

    def forget(self, shot: int) -> None:
        """Take back where the camera was thought to be: the frame begins another shot, and is lost so far."""
        self.shot, self.place, self.motion = shot, None, None
        self.information, self.toward, self.by_common = np.zeros((3, 3)), np.zeros(3), None
        self.pull, self.pull_by_errors, self.spread = None, None, np.zeros(2)
        self.is_confirmed, self.is_in_place, self.is_contradicted, self.missing = False, False, False, 0

    def take(self, look: Look, expected: Array, covariance: Array | None = None) -> None:
        """Keep what a look brought: of the paint alone, without the head (3,) that was expected with a covariance
        (3, 3); None where the camera was searched for, and the paint alone tells the head.
        """
        fit, measured = look.fit, look.measured
        self.head = fit.head
        self.expected, self.painted = int(measured.expected.sum()), int(measured.painted.sum())
        self.is_confirmed, self.missing = look.is_confirmed, measured.missing
        self.is_in_place = look.is_in_place
        self.is_contradicted = self.expected >= EXPECTED_PLACES and measured.painted_share < BARE_SHARE
        self.rms_px = fit.rms_px
        if len(measured.marking) >= 8 and fit.inlier_share > 0.5 and not self.is_contradicted:
            self.information = fit.information
            self.toward = np.zeros(3)
            if covariance is not None:
                self.toward = np.asarray(np.linalg.solve(covariance, fit.head - expected))
            self.by_common, self.pull, self.spread = fit.by_common, fit.pull, fit.spread
            if self.place is not None:
                self.pull_by_errors, left = self.place.follow_errors(look)
                self.spread = self.spread + np.array([0.0, left])
        else:
            self.head = expected
        on_circles = 0 if self.place is None else int(measured.painted[self.place.drawn.is_circle].sum())
        carriers: list[Carrier] = []
        if on_circles >= 8:
            carriers.append("circle")
        if self.painted - on_circles >= 8:
            carriers.append("lines")
        self.carriers = tuple(carriers) if covariance is None else (*carriers, "motion")
