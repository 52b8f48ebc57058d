"""The circle measured without what is left of an old one beside it, and of two that are alike, which is the old one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from circlecal.paint.old_coat import find_old_coats, remove_old_coat, sample_coats
from circlecal.pipeline.attempts import estimate
from circlecal.pipeline.curves import SETTLED_PX, distance_widths, measure_curves, replace_curves
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.results import Attempt

__all__ = ["leave_out_old_coat", "may_have_old_coat"]

MOST_COAT_ROUNDS, QUIET_NOISE, MORE_NOISE = 3, 1.2, 1.1
"""How often the circle is measured again without an old coat; noise of a camera, in units of what was measured, that
leaves nothing to be explained; and by which factor a further round may raise it: a camera that the old coat had led
astray came down from 5.8 to 5.2, 4.5 and 1.1 in three rounds, and its error from 42 to 3 px.
"""
UNEXPLAINED_NOISE, LESS_NOISE, CLEARLY_LESS_NOISE = 5.0, 0.7, 0.8
"""Noise of a camera, in units of what was measured, from which on two coats that are alike are looked for; the factor
to which it comes down at most where they are there; and the factor to which it does without the old one compared with
the new one. Measured along both of them the circle of ten rendered frames leaves 5.1 to 29, and 0.07 to 0.62 of that
without the old one, which is 0.03 to 0.5 of what it leaves without the new one on nine; on one it is 1.05, and the
centre mark tells. Real circles without an old coat leave 1.9 to 5.6, 36 of 40 less than 5.0, and 0.95 or more of that
on the three where two alike coats explain the paint better.
"""


def may_have_old_coat(setting: Setting, attempt: Attempt) -> bool:
    """Whether much of a circle was measured by the middle of its paint, which an old coat beside it would move."""
    if attempt.fitted is None or setting.circle.fill == "disc" or attempt.camera is None:
        return False
    is_measured = attempt.observations is not None and attempt.observations.circle(setting.circle.name, "center")
    return bool(is_measured)


def leave_out_old_coat(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt with the circle measured without the light of what is left of an old one beside it. Two coats that
    are alike are looked for where the camera leaves much unexplained, and believed where it does not without one.
    """
    cleaned = _clean_in_rounds(setting, scene, attempt, may_be_alike=False)
    if cleaned is None and _noise(attempt) > UNEXPLAINED_NOISE:
        cleaned = _clean_in_rounds(setting, scene, attempt, may_be_alike=True)
        if cleaned is None or _noise(cleaned) > LESS_NOISE * _noise(attempt):
            return
        cleaned = estimate(setting, replace(cleaned, verdict=None))
    if cleaned is not None:
        yield cleaned


def _clean_in_rounds(setting: Setting, scene: Scene, attempt: Attempt, may_be_alike: bool) -> Attempt | None:
    """The attempt with the circle measured without an old coat, again along the camera that this leads to while that
    explains what was seen as well; None where no coat is told. Of coats that may be alike the cameras are drafts: few
    are believed.
    """
    last = None
    for _ in range(MOST_COAT_ROUNDS):
        before = last or attempt
        again = _clean_circle(setting, scene, before, may_be_alike)
        if again is None or (last is not None and _noise(again) > MORE_NOISE * _noise(last)):
            break
        last = again
        if _noise(again) < QUIET_NOISE or before.camera is None or again.camera is None:
            break
        if distance_widths(setting, before.camera, again.camera) <= SETTLED_PX / 1920.0:
            break
    return last


def _clean_circle(setting: Setting, scene: Scene, attempt: Attempt, may_be_alike: bool) -> Attempt | None:
    """The attempt with the circle measured without an old coat; None where none is told, or of two that are alike it
    is not clear which is the old one.
    """
    fitted = attempt.fitted
    if fitted is None:
        return None
    camera = fitted.camera
    circle, template, noise = setting.circle, setting.template, fitted.edges.noise
    picture = lighten_markings(scene.marked, fitted.mask, circle)
    with setting.clock("rays"):
        profiles = sample_coats(picture, camera.view, circle, template)
        coats = () if profiles is None else find_old_coats(profiles, template.marking_width_m, may_be_alike)
        radius_m = template.radius(circle, "center")
        cleaned = [remove_old_coat(picture, camera.view, circle, radius_m, coat) for coat in coats]
    found = [measure_curves(setting, clean, camera, (circle,), noise, scene.covered) for clean in cleaned]
    tried = [
        estimate(
            setting,
            replace(attempt, observations=replace_curves(fitted.observations, curves), verdict=None),
            is_draft=may_be_alike,
        )
        for curves in found
        if curves
    ]
    return _choose_coat(tried)


def _choose_coat(tried: Sequence[Attempt]) -> Attempt | None:
    """That one of attempts without one coat each whose camera leaves out fewer of its cues, or else leaves less noise;
    None where that is not clear.
    """
    ranked = sorted(tried, key=lambda attempt: (_count_rejected(attempt), _noise(attempt)))
    if len(ranked) < 2 or _count_rejected(ranked[0]) < _count_rejected(ranked[1]):
        return next(iter(ranked), None)
    return ranked[0] if _noise(ranked[0]) < CLEARLY_LESS_NOISE * _noise(ranked[1]) else None


def _count_rejected(attempt: Attempt) -> float:
    """How many cues a camera leaves out; infinite without one."""
    return np.inf if attempt.camera is None else len(attempt.camera.rejected)


def _noise(attempt: Attempt | None) -> float:
    """The noise that an attempt's camera leaves unexplained, in units of what was measured; infinite without one."""
    return np.inf if attempt is None or attempt.camera is None else attempt.camera.noise_scale
