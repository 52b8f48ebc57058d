"""Which sport a refused frame looks like: what was found is weighed for each sport as independent evidence, against
there being none of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.field import FieldTemplate, Ground, load_field
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array
from circlecal.results import FieldCandidate, FrameCalibration, LikelySport
from circlecal.stages.mask import tell_paints

UNKNOWN = 1.0
"""Logarithm of the odds of another sport, or of no field at all, against the field of this ground of which nothing was
found: a bare floor or lawn says nothing.
"""
USUAL = 1.0
"""Logarithm of the odds of the first template's sport, the usual one, against others on its ground: that lines were
found, which every sport has, is then no tie.
"""
OTHER_GROUND, ANY_GROUND, SECOND_GROUND = -3.0, -1.0, -0.5
"""Logarithm of the odds of a field on a ground of another colour than its own, of one that is laid on any, and of the
ground that is the less likely one of this colour.
"""
OF_MARKINGS, MOST_MARKINGS = 0.3, 4
"""Logarithm of the odds for each line, arc or circle that was found where the field would show it, and of how many."""
OF_EVIDENCE, LEAST_EXPLAINED = 6.0, 0.3
"""Logarithm of the odds for each picture width of markings that are painted where a camera puts them, times the share
of the paint that they explain; and the share below which it is chance. Courts of other sizes than their templates have
0.2 to 0.4 of such widths, cameras that were laid over other sports' lines explain 0.28 of the paint at most.
"""
WIDTH_SD, BLUR_PX = 0.4, 1.5
"""Standard deviation of the logarithm of the paint's width over the circle's radius, and of the width by blur, pixels:
real circles of soccer have 0.010 to 0.018 (rules: 0.013), of basketball 0.027 to 0.033 (0.028), of robots 0.05 to 0.07
(0.067).
"""
OF_CIRCLE, LEAST_OF_CIRCLE = 1.5, -5.0
"""Logarithm of the odds for a circle whose paint has just the width that the rules say, and for one whose paint has any
other: what is measured may be mistaken.
"""
RINK_PAINT = 1.5
"""Logarithm of the odds of ice where a red, blue or yellow marking is seen on a surface that looks like ice: lines and
the boards' kick plate. Seven of eight real rinks show one, no light hall of two.
"""
LEAST_TINT, LEAST_ADDED = 0.35, 20.0
"""Of such paint: what it adds to the three colours beside their mean, over all that it adds; and grey levels."""
SURE = 0.5
"""Probability from which on a sport is named."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What trying one template showed: its calibration and its evidence as one of the fields."""

    found: FrameCalibration
    candidate: FieldCandidate


def tell_sport(
    image: NDArray[np.uint8], config: Config, grounds: Sequence[Ground], trials: Sequence[Trial]
) -> LikelySport:
    """The sport that a picture looks like.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    config : Config
        Options.
    grounds : sequence of str
        Playing surfaces that it may show, the likeliest first.
    trials : sequence of Trial
        Of every template that was tried.

    Returns
    -------
    LikelySport
        Without a name where none is likelier than :data:`SURE`.
    """
    scores: dict[str, float] = {}
    circles = [_paint_share(trial.found) for trial in trials]
    first = next((circle for circle in circles if circle is not None), None)
    has_rink_paint = grounds[0] == "ice" and shows_rink_paint(image, config)
    usual = load_field(config.field.among[0]).name
    for trial, circle in zip(trials, circles, strict=True):
        template = trial.found.template
        if template is None:
            continue
        score = USUAL if trial.candidate.template == usual else 0.0
        score += _weigh_ground(template.ground, grounds) + _weigh_markings(trial) + _weigh_evidence(trial.candidate)
        score += _weigh_width(template, circle or first)
        score += RINK_PAINT if has_rink_paint and template.ground == "ice" else 0.0
        scores[trial.candidate.sport] = max(score, scores.get(trial.candidate.sport, -np.inf))
    weights = np.exp(np.array([*scores.values(), UNKNOWN]))
    probabilities = weights / weights.sum()
    best = int(np.argmax(probabilities[:-1]))
    if probabilities[best] < SURE:
        return LikelySport(None, float(probabilities[-1]))
    return LikelySport([*scores][best], float(probabilities[best]))


def shows_rink_paint(image: NDArray[np.uint8], config: Config) -> bool:
    """Whether a BGR picture (H, W, 3) shows paint of a colour of rinks."""
    return any(map(is_rink_paint, tell_paints(image, config.mask)))


def is_rink_paint(added_bgr: Array) -> bool:
    """Whether paint is red, blue or yellow: what it adds to blue, green and red (3,) is no grey."""
    strength = float(np.linalg.norm(added_bgr))
    tint = float(np.linalg.norm(added_bgr - added_bgr.mean()))
    return strength >= LEAST_ADDED and tint >= LEAST_TINT * strength


def _weigh_ground(ground: str, grounds: Sequence[Ground]) -> float:
    if ground == "any":
        return ANY_GROUND if grounds[0] != "floor" else 0.0
    if ground not in grounds:
        return OTHER_GROUND
    return 0.0 if ground == grounds[0] else SECOND_GROUND


def _weigh_markings(trial: Trial) -> float:
    mask = trial.found.attempt.mask
    if mask is None:
        return 0.0
    count = len(mask.lines) + len(mask.arcs) + (mask.conic is not None) + (mask.halfway is not None)
    return OF_MARKINGS * min(count, MOST_MARKINGS)


def _weigh_evidence(candidate: FieldCandidate) -> float:
    evidence, share = candidate.evidence or 0.0, candidate.explained_share or 0.0
    return OF_EVIDENCE * max(0.0, evidence) * share if share >= LEAST_EXPLAINED else 0.0


def _paint_share(found: FrameCalibration) -> tuple[float, float] | None:
    """Width of the paint of the circle that was found over its radius, and the standard deviation of its logarithm."""
    mask = found.attempt.mask
    ellipse = None if mask is None or mask.conic is None else ellipse_from_conic(mask.conic)
    if mask is None or ellipse is None or not mask.band_px:
        return None
    sd = float(np.hypot(WIDTH_SD, BLUR_PX / mask.band_px))
    return mask.band_px / float(ellipse.semi_axes[0]), sd


def _weigh_width(template: FieldTemplate, seen: tuple[float, float] | None) -> float:
    """Logarithm of the likelihood of a circle's paint for the likeliest circle of a template; 0 where none was seen."""
    if seen is None:
        return 0.0
    share, sd = seen
    usual = np.log([template.paint_width(c) / template.radius(c, "center") for c in template.circles])
    return max(LEAST_OF_CIRCLE, OF_CIRCLE + float(np.max(-0.5 * ((np.log(share) - usual) / sd) ** 2)))
