"""One hypothesis about the field: its size, and whether it is flat or crowned, as priors of the camera's fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from circlecal.camera.priors import Priors
from circlecal.camera.problem import Problem
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1

SIZES_AND_CROWN = LENGTH, BREADTH, CROWN = [INDEX[name] for name in ("length", "breadth", "crown")]
CURVED_SHARE = 0.25
"""Of crowned fields, those whose profile is a parabola and no roof. In real frames of 30 fields the roof explains more
by 0.4 to 38 (logarithm of the evidence) in 27, the parabola by 1.5 at most in the others.
"""
FLAT_SD_M = 0.005
"""Of the drop of a flat field at the circle's radius, metres: artificial turf is laid to a centimetre."""
FLAT_RELIEF_SHARE = 1.0 / 3.0
"""How far the ground at a mark of a flat field lies above or below its profile, over that at a mark of a crowned one:
artificial turf is laid to a centimetre all over.
"""

LENS_WIDER = 4.0
"""How many times as far from the usual one the radial distortion of any lens may be: action cameras, cinema lenses."""

Size = Literal["usual", "other_length", "any"]
"""Of a field: that of the template, its width with any length that the rules allow, or any that they allow."""


def are_usual(size: Size) -> tuple[bool, bool]:
    """Whether the length, and whether the width, of a field of this kind of size is the template's."""
    return size == "usual", size != "any"


@dataclass(frozen=True, slots=True)
class World:
    """What one hypothesis says of the field, and the share of frames that are like that: its size, flat or crowned, and
    where it is crowned, with a curved profile or with that of the problem; and whether any lens looks at it, or one
    whose radial distortion is about the usual one.
    """

    size: Size
    is_flat: bool
    share: float
    is_curved: bool = False
    is_any_lens: bool = False

    @property
    def is_usual_size(self) -> bool:
        """Whether the field is as long and as wide as the template's."""
        return self.size == "usual"

    def priors(self, current: Priors, usual: Priors, template: FieldTemplate) -> Priors:
        """Priors with sizes and crown as in this world, with its lens where that is any, and all else as they are.

        Parameters
        ----------
        current : Priors
            What is kept but for sizes and crown.
        usual : Priors
            Of a crowned field of the usual size.
        template : FieldTemplate
            With the sizes that the rules allow.
        """
        mean, sd = current.mean.copy(), current.sd.copy()
        mean[SIZES_AND_CROWN], sd[SIZES_AND_CROWN] = usual.mean[SIZES_AND_CROWN], usual.sd[SIZES_AND_CROWN]
        for index, is_known, extent in zip((LENGTH, BREADTH), are_usual(self.size), template.extents, strict=True):
            if not is_known and extent.range_m is not None and sd[index] > 0:
                # mean and standard deviation of a uniform distribution
                least, most = extent.range_m
                mean[index], sd[index] = (least + most) / 2.0 - extent.size_m, (most - least) / np.sqrt(12.0)
        if self.is_flat and sd[CROWN] > 0:
            mean[CROWN], sd[CROWN] = 0.0, FLAT_SD_M
        elif self.is_curved:
            # a parabola falls as far as a roof does where the field ends
            share = template.circle_by_name[template.default_circle].radius_m / (0.5 * template.width_m)
            mean[CROWN], sd[CROWN] = share * mean[CROWN], share * sd[CROWN]
        if self.is_any_lens:
            sd[KAPPA_1] = LENS_WIDER * usual.sd[KAPPA_1]
        return replace(current, mean=mean, sd=sd)

    def describe(self, problem: Problem, usual: Priors, template: FieldTemplate) -> Problem:
        """A problem of a crowned field with what this world says."""
        points = problem.points
        if self.is_flat and points.upright_px is not None:
            relief_px = FLAT_RELIEF_SHARE * np.sqrt(points.upright_px**2 - points.sigma_px**2)
            points = replace(points, upright_px=np.hypot(points.sigma_px, relief_px))
        return replace(problem, priors=self.priors(problem.priors, usual, template), points=points)

    def with_any_lens(self, share: float) -> World:
        """This world before any lens, which a share of all frames have, where its own share is that of the others."""
        return replace(self, share=self.share * share / (1.0 - share), is_any_lens=True)

    def curve(self) -> World:
        """This crowned world with a curved profile."""
        return replace(self, share=self.share * CURVED_SHARE / (1.0 - CURVED_SHARE), is_curved=True)


USUAL = World("usual", False, 1.0)
"""What is assumed where nothing else can be told."""
