"""One pitch before all tripods of a clip: what one tells of it is known of the others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate
from circlecal.tracking.frame_paint import HeadedFrame
from circlecal.tracking.markings import DrawnTemplate
from circlecal.tracking.pitch import SIZE, TOLD_SD_M, leave_out_false_line
from circlecal.tracking.tripod_fit import TripodFit, count_alike, fit_tripod

PITCH = [*SIZE, PLACE["crown"]]
"""What tripods of one clip share: by how much the pitch is longer and broader than the template's, and its crown."""


@dataclass(frozen=True, slots=True)
class KnownPitch:
    """The pitch of a clip as some of its tripods tell it.

    Attributes
    ----------
    surface : Surface
        Its shape.
    mean, sd : (3,) arrays
        Growth in length and in breadth, and crown, metres.
    is_settled : (3,) array of bool
        Which of these are held: the tripod that knows the pitch best tells them. Another one that shows little of the
        pitch tells its size by what lens and surface leave over: a still camera before the circle of a rendered pitch
        108 m long drew the 107.91 +- 0.22 m of a panning one to 107.01 m, and its frames 22 px off.
    """

    surface: Surface
    mean: Array
    sd: Array
    is_settled: NDArray[np.bool_]

    @classmethod
    def of(cls, tripod: TripodEstimate, is_settled: NDArray[np.bool_] | None = None) -> KnownPitch:
        """As a tripod tells it. Without what is settled, the sizes that it tells are, and with both of them the
        crown.
        """
        sd = np.sqrt(np.diag(tripod.whole_covariance)[PITCH])
        is_told = sd < TOLD_SD_M
        is_told[-1] = is_told[:-1].all()
        return cls(tripod.surface, tripod.mean[PITCH], sd, is_told if is_settled is None else is_settled)

    @property
    def is_held(self) -> NDArray[np.bool_]:
        """Which of the common parameters (K,) are held."""
        held = np.zeros(len(COMMON), np.bool_)
        held[PITCH] = self.is_settled
        return held

    def take(self, tripod: TripodEstimate) -> TripodEstimate:
        """Another tripod, moved before this pitch: where a fit starts."""
        mean = tripod.mean.copy()
        mean[PITCH] = self.mean
        return replace(tripod, surface=self.surface, mean=mean)

    def tell(self, mean: Array, sd: Array) -> tuple[Array, Array]:
        """A prior (K,), (K,) of what the frames of another tripod share, with this pitch."""
        loose_mean, loose_sd = self.tell_loosely(mean, sd)
        return loose_mean, np.where(self.is_held, 0.0, loose_sd)

    def tell_loosely(self, mean: Array, sd: Array) -> tuple[Array, Array]:
        """The prior, with held sizes as uncertain as they were told."""
        mean, sd = mean.copy(), sd.copy()
        # who fixes the surface or the size knows better
        mean[PITCH] = np.where(sd[PITCH] > 0.0, self.mean, mean[PITCH])
        sd[PITCH] = np.minimum(sd[PITCH], self.sd)
        return mean, sd


def size_variance(tripod: TripodEstimate) -> float:
    """How uncertain a tripod leaves the size of its pitch, square metres."""
    return float(np.diag(tripod.whole_covariance)[SIZE].sum())


def fit_before(
    pitch: KnownPitch, frames: list[HeadedFrame], tripod: TripodEstimate, mean: Array, sd: Array, drawn: DrawnTemplate
) -> TripodFit:
    """The fit of a tripod before a pitch that another one tells; all else is as for
    :func:`circlecal.tracking.pitch.choose_pitch`.
    """
    mean, sd = pitch.tell(mean, sd)
    start = replace(tripod, surface=pitch.surface)
    kept, (fit,) = leave_out_false_line(frames, [start], mean, sd, drawn)
    alike = count_alike(fit)
    return fit if alike == 1.0 else fit_tripod(kept, fit.estimate, mean, sd, drawn, alike=alike)


def tell_pitch(tripod: TripodEstimate, last: TripodEstimate) -> TripodEstimate:
    """A tripod after another one, to which its pitch was known, has told more of it: all else follows the pitch as it
    went with it before.

    It is the step back of a smoother: with G the regression of what the tripod holds on its pitch, the mean moves by
    ``G (p' - p)`` and the covariance changes by ``G (C' - C) G^T``.
    """
    known = [k for k in PITCH if tripod.covariance[k, k] > 0.0]
    if not known:
        return tripod
    own = np.ix_(known, known)
    follows = np.linalg.solve(tripod.covariance[own], tripod.covariance[known]).T
    mean = tripod.mean + follows @ (last.mean[known] - tripod.mean[known])
    covariance = tripod.covariance + follows @ (last.covariance[own] - tripod.covariance[own]) @ follows.T
    crown = float(mean[PLACE["crown"]])
    surface = replace(tripod.surface, crown_m=crown)
    return replace(tripod, mean=mean, covariance=(covariance + covariance.T) / 2.0, surface=surface)
