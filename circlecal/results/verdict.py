"""What the answer was checked against, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from circlecal.checks import CHECKS, words_of_check, words_of_value
from circlecal.geometry.projective import Array
from circlecal.refusals import explain

Status = Literal["calibrated", "refused"]

SIDEWAYS_DEG = 45.0
"""Roll of a camera, degrees, from which on its picture is told to be turned, not the camera to lean: of 18 pictures
that were turned by a quarter the cameras have 84 to 90, and cameras that lean have 20 at most.
"""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Stage ``agreement``: markings that must be in view and that the camera was not fitted to.

    Attributes
    ----------
    names : tuple of str
        The template's.
    length_px : (K,) array
        How much of each lies where the picture shows the field and its place is known.
    share : (K,) array
        Share of that on which the picture shows a marking.
    certain : bool
        Whether their places are known well; otherwise they were looked for in a wider strip.
    """

    names: tuple[str, ...]
    length_px: Array
    share: Array
    certain: bool = True

    @property
    def expected_px(self) -> float:
        """Length of all of them."""
        return float(self.length_px.sum())

    @property
    def found_share(self) -> float:
        """Share of that which is drawn; 1 where nothing is expected."""
        return float(self.length_px @ self.share) / self.expected_px if len(self.names) else 1.0


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the ground in the picture says against a camera.

    Attributes
    ----------
    rough_share : float
        Share of the field that must be in view which is no playing surface but as rough as a crowd.
    above_share, beyond_share : float
        Shares of the picture that are playing surface above the horizon, and surely far beyond the field's border.
    near_share : float
        Share of the picture that is no playing surface and lies before the field, on the camera's side; 0 where it is
        as plain as a parapet.
    seam_share : float
        Share of the picture's width or height along which two rows or columns meet as no lens lets them.
    """

    rough_share: float
    above_share: float
    beyond_share: float
    near_share: float
    seam_share: float


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the paint in the picture says against a camera.

    Attributes
    ----------
    oblique_widths, alone_widths : float
        Length of lines like the carriers' paint that lie surely on the field, where no marking is, picture widths: of
        those that run along neither axis of the field, and of one that runs along an axis where it is the only one.
        Several that do may be the field of another sport.
    painted_share : float
        Share of the carriers that is painted where they must be in view.
    bare_widths : float
        By how much the paint of the halfway line ends too early, where nothing hides it, picture widths.
    worn_widths : float
        Longest stretch between the paint of a circle that is bare where nothing hides it, picture widths; told where
        the halfway line ends too early.
    reversal : float
        By how much (half a chi-square) the width of the paint is better explained by a camera that has near and far
        exchanged; far below zero where the paint confirms the camera.
    parallel_widths : float
        Length of all such lines that run along an axis of the field, picture widths; far lines, which blur makes
        fainter, are among them.
    """

    oblique_widths: float
    alone_widths: float
    painted_share: float
    bare_widths: float
    worn_widths: float
    reversal: float
    parallel_widths: float = 0.0


@dataclass(frozen=True, slots=True)
class Check:
    """One gate of the verdict: name, measured value, limit, passed or not.

    Whether its value must be at most or at least the limit is told by :data:`circlecal.checks.CHECKS`.
    """

    name: str
    value: float
    limit: float
    passed: bool

    @property
    def measures(self) -> str:
        """What the value is, with its unit; empty for a check that this version does not know."""
        gate = CHECKS.get(self.name)
        return "" if gate is None else gate.measures

    @classmethod
    def of(cls, name: str, value: float, limit: float) -> Check:
        """The check of a value, which must be finite, against the largest accepted one, or the least."""
        passed = math.isfinite(value) and (value >= limit if CHECKS[name].at_least else value <= limit)
        return cls(name, float(value), float(limit), bool(passed))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Stage ``verdict``: calibrated, or refused with a code, a reason in words and the stage that refused."""

    status: Status
    code: str | None
    reason: str | None
    stage: str | None
    checks: tuple[Check, ...] = ()

    @classmethod
    def refusal_by(cls, check: Check, checks: tuple[Check, ...], marking: str = "") -> Verdict:
        """The refusal of a frame by a failed check, with all checks, in words that name the marking; of a camera that
        is implausible also the check's value, its limit and the option that sets it.
        """
        code, words = CHECKS[check.name].code, words_of_check(check.name, marking)
        if check.name == "roll_deg" and check.value > SIDEWAYS_DEG:
            words = "the picture lies on its side or upside down: turn it upright"
        if code == "implausible_camera":
            words = f"{words} ({words_of_value(check.name, check.value, check.limit)})"
        return cls("refused", code, words, "verdict", checks)

    def with_checks(self, *further: Check) -> Verdict:
        """This verdict with further checks, refused by the first of them that failed."""
        checks = (*self.checks, *further)
        failed = next((check for check in further if not check.passed), None)
        return replace(self, checks=checks) if failed is None else Verdict.refusal_by(failed, checks)

    @property
    def help(self) -> str | None:
        """What helps against a refusal; None where there is none."""
        return None if self.code is None else explain(self.code, self.stage).help

    def check(self, name: str) -> Check | None:
        """The check of this name, where it was made."""
        return next((check for check in self.checks if check.name == name), None)
