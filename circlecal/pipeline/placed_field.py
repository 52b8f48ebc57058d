"""The whole template laid over the picture, where any of its circles may be the one seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array
from circlecal.pipeline.attempts import add_checks, refuse_as_open
from circlecal.pipeline.doubtful_circle import CIRCLE_TOLD, is_doubtful, may_be_any_circle
from circlecal.pipeline.field_paint import has_circle, keep_evidence, look_for_paint
from circlecal.pipeline.leagues import keep_search
from circlecal.pipeline.placed_view import (
    FEWEST_CARRYING,
    SURFACE_SHARE,
    count_carrying,
    follow_placement,
    lie_about_alike,
    see_rims,
)
from circlecal.pipeline.refinements import Retry
from circlecal.pipeline.setting import Scene, Setting
from circlecal.placement import (
    PlacedField,
    SeenPaint,
    ViewEvidence,
    add_rims,
    mean_distance_px,
    refine_placements,
    search_placements,
    weigh_view,
)
from circlecal.results import Attempt, CameraFit, Check, MarkingMask, Rival
from circlecal.stages.mask import suit_field
from circlecal.stages.verdict_on_picture import needs_confirmation

MOST_PLACED, LEAST_PLACED = 6, 0.6
"""So many placements lead to cameras, where their evidence is no smaller a share of the largest: of 18 frames of other
sports the right one was among the first four, with 0.91 of it at least.
"""
MOST_OF_SIBLING = 2
"""So many of each surface lead to cameras where a field of other sizes of the sport was laid already: mostly this one
lies there too, or is not the one that is seen.
"""
LEAST_PLACED_EXPLAINED = 0.2
"""So much of the paint a placement must explain to lead to a camera, which takes most of the time: those that led to
answers on 13 frames of other sports explained 0.36 to 1, those that were believed beside them 0.27 at least; on a
tennis court and in two halls without a court in view most explain 0.06 to 0.19.
"""
SAME_WIDTHS = 0.0005
"""Two placements on one surface that put the markings within this share of the picture's width on average lead to one
camera."""
LEAST_EVIDENCE, LEAST_SHARE = 0.3, 0.55
"""Evidence, picture widths, and share of the markings in view that are painted, without which a placed field is not
believed: on 18 frames of other sports right ones had 0.5 to 1.8 and 0.57 to 0.85; where no right one was found, the
best had 0.24 at most.
"""
WANDERED_TIMES, WANDERED_WIDTHS = 2.0, 0.1
"""How many times the evidence of its placement, and picture widths more, a camera may find: right ones of 13 frames
went from 0.07 to 0.17 and from 0.69 to 1.05; a court with the key of another one but of another size from 0.21 to 0.60.
"""
MOST_BARE = 0.12
"""Length in view of a marking that is not painted there, picture widths, with which a camera comes near none that finds
all its markings painted: those that take one end of a rink for the other have a goal line of 0.3 to 0.6 there, right
ones of ten rendered rinks none. On courts the edges of painted keys hide lines of right cameras, too.
"""
EXPLAINED_SHARE, EXPLAINED_EVIDENCE = 0.7, 0.15
"""Share of what was found painted that a placed field explains, with which less evidence is enough: a far half court
behind its players has 0.75 and 0.18; wrong placements of those frames explain 0.51 at most.
"""
PRECISE_MARKINGS, PRECISE_PX, PRECISE_EXPLAINED = 8, 0.5, 0.25
"""Markings of which half lie within so many pixels at 1920 px width of their place, and share of what was found painted
that is explained, with which any evidence is enough: refused right cameras of rendered rinks have 7 to 12 markings,
0.14 to 0.24 px and 0.29 to 0.61, wrong ones at most 7, and 0.24.
"""
LIKELIEST, OTHER_SIGHTING = 2, 2.0
"""First sightings, those of the detector's own answer; and what times the evidence is asked for on any other surface or
of the other polarity: right cameras there have 1.06 and 1.95 on two rendered courts, a wrong one on a real rink 0.55.
"""
RIVAL_RATIO, LISTED_RATIO = 1.3, 2.0
"""By how much the weight of a placed field must exceed that of any other one, and up to which ratio others are
listed. Right ones on those frames have ratios from 1.5, by evidence alone from 1.2.
"""
ALIKE_WIDTHS = 0.02
"""Two cameras that put the markings within this share of the picture's width on average are one."""


@dataclass(frozen=True, slots=True)
class _Answer:
    """An attempt whose camera a placement led to, and what speaks for that camera."""

    weighed: ViewEvidence
    attempt: Attempt

    @property
    def weight(self) -> float:
        """Evidence for the camera, picture widths, times the root of the number of markings that carry it: a circle and
        a line fit a wrong camera as well as the right one, many markings do not.
        """
        return self.weighed.evidence * float(np.sqrt(max(1, count_carrying(self.attempt))))


@dataclass(frozen=True, slots=True)
class _Followed:
    """A placement that was followed: the paint on which it was found, where it shows the field, and the answer it led
    to; None where it led to none that may be right.
    """

    paint: SeenPaint
    view: FieldView
    answer: _Answer | None


@dataclass(frozen=True, slots=True)
class _Laid:
    """On which paint a field of a sport was laid, and the most evidence that a camera found for it, picture widths."""

    key: tuple[object, ...]
    evidence: float


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a field may be laid: what was seen, its paint, and what times the evidence is asked for there."""

    mask: MarkingMask
    paint: SeenPaint
    factor: float


def _may_place_field(setting: Setting, first: Attempt) -> bool:
    """Whether any circle of the template may be the one seen, and what is looked for usually did not calibrate."""
    if not (may_be_any_circle(setting, first) and setting.config.camera.enabled):
        return False
    is_open = first.verdict is not None and (not first.is_calibrated or needs_confirmation(first.verdict))
    return is_open or is_doubtful(setting, first)


def place_template(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """The attempt with the field laid over the picture by all that is painted.

    The likeliest placements are followed to their cameras, which know the lens, and what is painted where these put the
    markings decides. Where two say alike, the attempt is refused as ``circle_open``. Each surface and polarity is
    searched until one answers.
    """
    followed = list[_Followed]()
    # a field of other sizes of the same sport lies where the first one was laid; on the likeliest other surfaces only
    # where more speaks for it there than for the first one, which may be laid wrongly
    sport = "laid", setting.template.sport_name
    laid = scene.looks.recall(sport)
    laid = laid if isinstance(laid, _Laid) else None
    places = _look_at_surfaces(setting, scene, first.mask)
    most = MOST_PLACED if laid is None else MOST_OF_SIBLING
    for place in places if laid is None else sorted(places, key=lambda place: place.paint.key != laid.key):
        least = 0.0 if laid is None or place.paint.key == laid.key else laid.evidence
        if least > 0.0 and place.factor > 1.0:
            continue
        best = _place_among(setting, scene, place.mask, place.paint, place.factor, most, followed, least)
        if best is not None:
            found = [one.answer.weighed.evidence for one in followed if one.answer is not None]
            scene.looks.keep(sport, _Laid(place.paint.key, max(found, default=0.0)))
            yield best


def _look_at_surfaces(setting: Setting, scene: Scene, mask: MarkingMask | None) -> Iterator[_Place]:
    """Each surface and polarity on which something may be a circle, the detector's own answer first."""
    tried = set[tuple[object, ...]]()
    for rank, seen in enumerate(() if mask is None else (mask, *mask.sightings)):
        if not has_circle(seen):
            continue
        with setting.clock("cues"):
            paint = look_for_paint(scene, seen, setting.config, setting.template)
        if paint is not None and paint.key not in tried:
            tried.add(paint.key)
            yield _Place(seen, paint, 1.0 if rank < LIKELIEST else OTHER_SIGHTING)


def place_about_rims(setting: Setting, scene: Scene, first: Attempt, rims: Sequence[Array]) -> Attempt | None:
    """The attempt with the field laid over the picture's paint about rims (3, 3) of logos; None where the field has no
    circle that a logo may fill, or nothing is believed.
    """
    mask, any_logo = first.mask, any(circle.fill == "logo" for circle in setting.template.circles)
    if mask is None or not (rims and any_logo and _may_place_field(setting, first)):
        return None
    options, tried = suit_field(setting.config.mask, setting.template).detector, set[int]()
    for seen in (mask, *mask.sightings):
        with setting.clock("cues"):
            paint = look_for_paint(scene, seen, setting.config, setting.template)
            if paint is None or id(paint.surface) in tried:
                continue
            tried.add(id(paint.surface))
            paint = add_rims(paint, see_rims(scene), seen, rims, options)
        best = _place_among(setting, scene, seen, paint, 1.0, MOST_PLACED, [])
        if best is not None:
            return best
    return None


def _place_among(
    setting: Setting,
    scene: Scene,
    mask: MarkingMask,
    paint: SeenPaint,
    factor: float,
    most: int,
    followed: list[_Followed],
    least: float = 0.0,
) -> Attempt | None:
    """The answer of the field laid over paint of one polarity on one surface; None where none is believed.

    The ``most`` likeliest placements of more than the ``least`` evidence are followed, but for those that were followed
    before; they are added to ``followed``. An answer needs ``factor`` times the evidence that is usually enough.
    """
    earlier = [other for other in followed if other.paint.surface is paint.surface]
    with setting.clock("cues"):
        placements = [placed for placed in _find_placements(setting, scene, paint) if placed.evidence > least]
    now = _follow_likely(setting, scene, mask, paint, placements[:most], earlier)
    followed += now
    return _choose_answer(setting, now, earlier, factor)


def _find_placements(setting: Setting, scene: Scene, paint: SeenPaint) -> list[PlacedField]:
    """The likeliest ways to lay the field over paint of one polarity on one surface, the one with most evidence first,
    without those for which much less speaks.
    """
    template, side, size = setting.template, setting.config.correspondences.camera_side, (setting.width, setting.height)
    # a field of other sizes of the same sport lies where the first one does
    key = ("placements", template.sport_name, side, *paint.key)
    rough = scene.looks.once(key, lambda: search_placements(paint, size, template, side))
    keep_search(scene.looks, template, paint, rough)
    placements = [] if rough is None else refine_placements(rough, paint, size, template)
    if not placements:
        return []
    keep_evidence(scene, template, weigh_view(placements[0].view, template, paint))
    least = max(0.0, LEAST_PLACED * placements[0].evidence)
    return [placed for placed in placements if placed.evidence > least]


def _follow_likely(
    setting: Setting,
    scene: Scene,
    mask: MarkingMask,
    paint: SeenPaint,
    placements: Sequence[PlacedField],
    earlier: Sequence[_Followed],
) -> list[_Followed]:
    """Placements that explain some of the paint, followed, but for those that were followed on this surface before."""
    followed = []
    views = [other.view for other in earlier]
    for placed in placements:
        if not _is_worth_following(setting, placed, paint, views):
            continue
        attempt = follow_placement(setting, scene, mask, placed)
        answer = None
        if attempt is not None and attempt.camera is not None:
            weighed = weigh_view(attempt.camera.view, setting.template, paint)
            answer = _Answer(weighed, attempt) if _may_be_right(setting, weighed, attempt, placed) else None
        followed.append(_Followed(paint, placed.view, answer))
    return followed


def _may_be_right(setting: Setting, weighed: ViewEvidence, attempt: Attempt, placed: PlacedField) -> bool:
    """Whether a camera that a placement led to lays the field on the playing surface and on the placement's paint; on
    other paint only where many markings lie so exactly there that chance does not do it.
    """
    is_there = not _has_wandered(weighed, placed) or _is_precise(setting, weighed, attempt)
    return weighed.surface_share >= SURFACE_SHARE and is_there


def _choose_answer(
    setting: Setting, followed: Sequence[_Followed], earlier: Sequence[_Followed], factor: float
) -> Attempt | None:
    """The answer of most weight; None where it is not believed, or where one that was not believed on this surface
    before weighs more.

    It needs ``factor`` times the evidence that is usually enough, and is refused as open where another one comes near.
    """
    answers, before = _sort_answers(followed), _sort_answers(earlier)
    if not answers:
        return None
    chosen = answers[0]
    if not (_is_believed(chosen.weighed, factor) or _is_precise(setting, chosen.weighed, chosen.attempt)):
        return None
    is_told = _count_telling(chosen.attempt, setting.template) >= FEWEST_CARRYING
    if not is_told and not _is_circle_told(setting, followed[0].paint, chosen.weighed, chosen.attempt):
        return None
    if before and before[0].weight > chosen.weight:
        return None
    best = chosen.attempt if is_told else add_checks(chosen.attempt, Check(CIRCLE_TOLD, 1.0, 1.0, True))
    return _judge_beside(best, chosen.weighed, _find_rivals(setting, chosen, [*answers[1:], *before]))


def _sort_answers(followed: Sequence[_Followed]) -> list[_Answer]:
    """The answers that placements led to, the one of most weight first."""
    return sorted((one.answer for one in followed if one.answer is not None), key=lambda answer: -answer.weight)


def _find_rivals(setting: Setting, chosen: _Answer, others: Sequence[_Answer]) -> list[tuple[float, Rival]]:
    """Other answers that come near the chosen one, the nearest first, and how many times as much the chosen one weighs.

    One that finds a marking without its paint comes near none that finds all of them painted.
    """
    camera = chosen.attempt.camera
    most_bare = MOST_BARE if chosen.weighed.bare_widths <= MOST_BARE else np.inf
    found = []
    for other in sorted(others, key=lambda answer: -answer.weight):
        seen = other.attempt.camera
        is_near = other.weight * LISTED_RATIO > chosen.weight and other.weighed.bare_widths <= most_bare
        if is_near and camera is not None and seen is not None and not _are_alike(setting, camera, seen):
            rival = Rival(other.attempt.circle_name or "", seen, other.weighed.evidence)
            found.append((chosen.weight / other.weight, rival))
    return found


def _judge_beside(best: Attempt, weighed: ViewEvidence, rivals: Sequence[tuple[float, Rival]]) -> Attempt:
    """An attempt with its rivals and the checks of a placed field, refused as open where the first of them comes
    near it by the ratio of their weights.
    """
    least = LEAST_SHARE if weighed.found_share >= LEAST_SHARE else 0.0
    best = replace(best, rivals=tuple(rival for _, rival in rivals))
    best = add_checks(best, Check("found_share", weighed.found_share, least, True))
    if not rivals:
        return best
    check = Check.of("rival_ratio", rivals[0][0], RIVAL_RATIO)
    best = add_checks(best, check)
    return best if check.passed else refuse_as_open(best, "circle_open")


def _are_alike(setting: Setting, camera: CameraFit, other: CameraFit) -> bool:
    """Whether two cameras show the markings in one place, also where one of them has the field turned by half: no
    marking tells one from the other, and of a camera behind an end both may stand on its side.
    """
    turned = replace(other.view, camera=other.camera.turn_field())
    off_px = [mean_distance_px(camera.view, view, setting.template) for view in (other.view, turned)]
    return min(off_px) <= ALIKE_WIDTHS * setting.width


def _is_worth_following(setting: Setting, placed: PlacedField, paint: SeenPaint, earlier: Sequence[FieldView]) -> bool:
    """Whether a placement explains some of the paint, and was not followed on this surface before."""
    if weigh_view(placed.view, setting.template, paint).explained_share < LEAST_PLACED_EXPLAINED:
        return False
    limit = SAME_WIDTHS * setting.width
    return all(mean_distance_px(placed.view, view, setting.template) > limit for view in earlier)


def _has_wandered(weighed: ViewEvidence, placed: PlacedField) -> bool:
    """Whether a camera found so much more paint than the placement that it comes from that it lies on other paint."""
    return weighed.evidence > WANDERED_TIMES * max(0.0, placed.evidence) + WANDERED_WIDTHS


def _is_circle_told(setting: Setting, paint: SeenPaint, weighed: ViewEvidence, attempt: Attempt) -> bool:
    """Whether the paint contradicts the same camera about every other circle that looks alike: there lines end
    elsewhere, or lie beside the playing surface.
    """
    template, camera = setting.template, attempt.camera
    own = template.circle_by_name.get(attempt.circle_name or "")
    if own is None or camera is None or count_carrying(attempt) < FEWEST_CARRYING:
        return False
    for _, moved in lie_about_alike(camera, own, template.circles):
        there = weigh_view(moved.view, template, paint)
        is_possible = there.surface_share >= SURFACE_SHARE and there.bare_widths <= MOST_BARE
        if is_possible and there.evidence * RIVAL_RATIO > weighed.evidence:
            return False
    return True


def _count_telling(attempt: Attempt, template: FieldTemplate) -> int:
    """How many markings carry the camera of an attempt, without spots in the middle of a circle: they lie there
    whichever circle it is.
    """
    centers = np.array([circle.center for circle in template.round_ones], np.float64)
    middles = {
        mark.name for mark in template.marks if np.linalg.norm(centers - mark.position, axis=1).min() < mark.diameter_m
    }
    keys = () if attempt.camera is None else attempt.camera.residuals_px
    return sum(key.name not in middles for key in keys)


def _is_believed(weighed: ViewEvidence, factor: float = 1.0) -> bool:
    """Whether enough of what a placed field predicts is painted, or it explains nearly all that is painted; with
    ``factor`` times the evidence that is usually enough.
    """
    evidence = weighed.evidence / factor
    is_painted = evidence >= LEAST_EVIDENCE and weighed.found_share >= LEAST_SHARE
    return is_painted or (weighed.explained_share >= EXPLAINED_SHARE and evidence >= EXPLAINED_EVIDENCE)


def _is_precise(setting: Setting, weighed: ViewEvidence, attempt: Attempt) -> bool:
    """Whether so many markings lie so exactly where the camera puts them that chance does not do it."""
    residuals = [] if attempt.camera is None else list(attempt.camera.residuals_px.values())
    is_exact = len(residuals) >= PRECISE_MARKINGS and np.median(residuals) <= PRECISE_PX * setting.width / 1920.0
    return bool(is_exact and weighed.evidence > 0.0 and weighed.explained_share >= PRECISE_EXPLAINED)


PLACED_FIELD = Retry(
    _may_place_field, place_template, lambda setting, first, other: other.is_calibrated or other.code == "circle_open"
)
"""Tried on fields with several large circles, where nothing before calibrated or nothing else confirms it."""
