"""Other circles, lines and arcs of the picture that are tried in the place of the circle."""

from __future__ import annotations

from collections.abc import Iterator

from circlecal.geometry.ellipses import encloses
from circlecal.pipeline.attempts import find_marking_once
from circlecal.pipeline.doubtful_circle import may_be_any_circle
from circlecal.pipeline.refinements import Retry, calibrate_scene
from circlecal.pipeline.setting import Scene, Setting
from circlecal.refusals import REFUSALS
from circlecal.results import Attempt, Interpretation, MarkingMask
from circlecal.stages.mask import replace_circle_by_arc
from circlecal.stages.verdict_on_picture import is_confirmed, needs_confirmation

MOST_INTERPRETATIONS = 3
"""How many other circles or lines of a picture are tried; rendered rinks, the fields with most circles, need two."""


def _may_be_another_circle(setting: Setting, attempt: Attempt) -> bool:
    """Whether another circle or line may be the right one: this one is refused for it, or nothing else confirms it."""
    if attempt.verdict is None:
        return False
    refusal = REFUSALS.get(attempt.code or "")
    return needs_confirmation(attempt.verdict) or (refusal is not None and refusal.another_interpretation)


def interpret_otherwise(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """Attempts with other circles or lines, each without those that came before."""
    attempt = first
    ruled_out: tuple[Interpretation, ...] = ()
    while _may_be_another_circle(setting, attempt) and len(ruled_out) < MOST_INTERPRETATIONS:
        mask = attempt.mask
        if mask is None or mask.source != "detector" or mask.conic is None:
            return
        ruled_out = (*ruled_out, Interpretation(mask.conic, mask.halfway))
        attempt = calibrate_scene(setting, scene, ruled_out)
        yield attempt


def masks_without_circle(setting: Setting, scene: Scene, first: Attempt) -> Iterator[MarkingMask]:
    """What the picture shows where nothing is taken for the circle: of a refused one, lines and arcs are the detector's
    own again. None where it finds one circle after the other.
    """
    mask = first.mask
    if mask is None or mask.conic is None or not _may_be_another_circle(setting, first):
        return
    ruled_out: tuple[Interpretation, ...] = ()
    while mask.conic is not None and len(ruled_out) < MOST_INTERPRETATIONS:
        ruled_out = (*ruled_out, Interpretation(mask.conic, mask.halfway))
        mask, _ = find_marking_once(setting, scene, ruled_out)
    if mask.conic is None:
        yield mask


def _is_better_circle(setting: Setting, first: Attempt, other: Attempt) -> bool:
    """Whether another circle is believed: other markings confirm it, or it lies about one that was too small."""
    if not other.is_calibrated:
        return False
    near_px = setting.config.verdict.max_mark_distance_px * setting.width / 1920.0
    if is_confirmed(other, setting.template, setting.circle, near_px):
        return True
    small = None if first.mask is None else first.mask.conic
    large = None if other.mask is None else other.mask.conic
    has_lines = other.camera is not None and bool(other.camera.named_lines)
    is_about = small is not None and large is not None and encloses(large, small)
    return first.code == "line_beyond_field" and has_lines and is_about


def _is_circle_open(setting: Setting, first: Attempt) -> bool:
    """Whether another circle or line may be the right one, and the field was not laid over the picture by any of its
    circles: on about 70 rendered rinks and courts and 16 real ones no other circle was believed after that, and looking
    for them took up to 2.4 s.
    """
    is_laid = may_be_any_circle(setting, first) and setting.config.camera.enabled
    return not is_laid and _may_be_another_circle(setting, first)


OTHER_CIRCLES = Retry(_is_circle_open, interpret_otherwise, _is_better_circle)
"""Tried where the circle is refused for itself, or nothing else confirms it."""


def mask_arcs(attempt: Attempt) -> tuple[MarkingMask, ...]:
    """The markings with each nearly gapless arc in the place of the circle."""
    mask = attempt.mask
    return () if mask is None else tuple(replace_circle_by_arc(mask, arc) for arc in mask.arcs if arc.gapless)


def take_arcs(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """Attempts with a nearly gapless arc as the circle."""
    for marking in mask_arcs(first):
        yield calibrate_scene(setting, scene, marking=marking)


ARCS = Retry(
    lambda setting, first: not first.is_calibrated, take_arcs, lambda setting, first, other: other.is_calibrated
)
"""Tried where nothing before calibrated."""
