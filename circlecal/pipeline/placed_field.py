"""The whole template laid over the picture, where any of its circles may be the one seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.errors import EstimationError
from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.observations import MarkingKey, Observations
from circlecal.paint.spots import measure_spots
from circlecal.pipeline.attempts import add_checks, estimate, refuse_as_open, take_observations
from circlecal.pipeline.painters import cover_painters
from circlecal.pipeline.refinements import UNCERTAIN_PX, Retry, is_less_uncertain
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.placement import (
    Outlines,
    PlacedField,
    SeenPaint,
    ViewEvidence,
    mean_distance_px,
    refine_placements,
    search_placements,
    see_paint,
    see_surface,
    share_on_surface,
    weigh_view,
)
from circlecal.refusals import Confidence
from circlecal.results import Attempt, CameraFit, Check, MarkingMask, Rival
from circlecal.stages.edges import detect_edges
from circlecal.stages.mask import suit_field
from circlecal.stages.rays import measure_template
from circlecal.stages.verdict_on_picture import needs_confirmation

PLACED_ROUNDS = 3
"""How often the markings of a placed field are measured: where the placement puts them, and where the camera does; the
last one takes in what the second camera put within reach.
"""
MOST_PLACED, LEAST_PLACED = 6, 0.6
"""So many placements lead to cameras, where their evidence is no smaller a share of the largest: of 18 frames of other
sports the right one was among the first four, with 0.91 of it at least.
"""
MOST_OF_SIBLING = 2
"""So many lead to cameras where a field of other sizes of the sport was laid already: this one lies there too, or is
not the one that is seen.
"""
FEWEST_CARRYING = 3
"""Markings that carry a placed field at least: both circles of either end of a rink look alike, and were taken for
those of the other end. Right cameras of eight real rinks and an NBA court have 3 to 6.
"""
LEAST_CIRCLE = 0.15
"""Score that the best candidate of a surface needs where no arc is seen there, without which no field is laid over it,
and the best one along a paint's colour, without which that paint is not followed (in a rendered hall the right one has
0.72): of 14 right cameras of real and rendered rinks and courts 0.38 to 0.93, of a tennis court and two halls without a
circle in view 0.05 to 0.12.
"""
LEAST_PLACED_EXPLAINED = 0.2
"""So much of the paint a placement must explain to lead to a camera, which takes most of the time: those that led to
answers on 13 frames of other sports explained 0.36 to 1, those that were believed beside them 0.27 at least; on a
tennis court and in two halls without a court in view most explain 0.06 to 0.19.
"""
SAME_WIDTHS = 0.0005
"""Two placements on one surface that put the markings within this share of the picture's width on average lead to one
camera."""
LARGEST_MOVE_WIDTHS = 0.05
"""Mean distance, picture widths, by which the camera may move the markings from where they were found: right ones moved
them by 0.001 to 0.038.
"""
LOST_WIDTHS = 0.12
"""Mean distance, picture widths, after any round from which a placement is given up: on seven frames of other sports
those that settled had moved by 0.061 at most.
"""
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
SURFACE_SHARE = 0.68
"""Least share of the markings in the picture that lie on the playing surface: of eight right cameras of rinks and
courts 0.77 to 1; of a rink that was laid into the stands 0.60, of three rendered courts whose other circle with its
line and one more marking were taken for the centre circle and its own 0.05 to 0.30.
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
LARGEST_RESIDUAL_PX = 2.0
"""Root mean square distance of a marking from its place, pixels at 1920 px width, that few may exceed: of 15
right cameras of other sports the second largest was 1.6 at most, of a court 2 m shorter than its template 3.2.
"""
PAINTERS_SIGMAS = 2.0
"""Standard deviations of painters' errors that a residual may have beside that: spots of rendered rinks, 3 cm beside
their place, are 2 to 6 px off in right cameras, which their circles decide.
"""
STRAY_AMONG = 7
"""Among so many markings one may be the edge of a board, or half hidden: of a rendered court with 15 of them two are
off by 9 and 2 px, and its camera by 0.4.
"""
SURE_PX = 0.5
"""Largest standard deviation of a marking, pixels at 1920 px width, of a camera that needs no further markings: courts
that were rendered have 1.9 to 2.5 with a circle and a line or two, 0.1 to 0.5 with all that is painted.
"""
DROPPED_AMONG, FEWEST_LEFT = 4, 5
"""Among so many markings one that lies farther is left out of the fit, and so many markings stay: on rendered courts
the edges of painted keys and of boards moved right cameras by 2 to 5 px.
"""
STRAY_MEDIANS, LEAST_STRAY_PX = 5.0, 0.5
"""In medians of all residuals, and pixels at 1920 px width, what counts as farther: of two real rinks the worst
marking has 1.8 medians, the edge of a painted key on three rendered courts 5 to 20, and errors of 1.4 to 4 px fall
to 0.2 to 1.8 without it.
"""
ALIKE_WIDTHS = 0.02
"""Two cameras that put the markings within this share of the picture's width on average are one."""


@dataclass(frozen=True, slots=True)
class _Followed:
    """A placement that was followed: the paint on which it was found, where it shows the field, and the camera it led
    to with what speaks for it; None where it led to none that may be right.
    """

    paint: SeenPaint
    view: FieldView
    answer: tuple[ViewEvidence, Attempt] | None


def _may_place_field(setting: Setting, first: Attempt) -> bool:
    """Whether any circle of the template may be the one seen, and what is looked for usually did not calibrate."""
    if not (_may_be_any_circle(setting, first) and setting.config.camera.enabled):
        return False
    is_open = first.verdict is not None and (not first.is_calibrated or needs_confirmation(first.verdict))
    return is_open or _is_doubtful(setting, first)


def _may_be_any_circle(setting: Setting, attempt: Attempt) -> bool:
    """Whether the detector looked, and nobody named the circle of a template with several large ones."""
    field, mask = setting.config.field, attempt.mask
    return field.any_circle and field.circle is None and mask is not None and mask.source == "detector"


def _is_doubtful(setting: Setting, attempt: Attempt) -> bool:
    """Whether any circle of the template may be the one seen, and a camera that knows little of the field took one; of
    one that a circle and a line or two carry, painters' errors count, and where it lays the other markings.
    """
    if not (_may_be_any_circle(setting, attempt) and attempt.is_calibrated) or attempt.camera is None:
        return False
    limit_px = UNCERTAIN_PX * setting.width / 1920.0
    if attempt.circle_name is not None or _count_carrying(attempt) > FEWEST_CARRYING:
        return attempt.camera.max_sigma_px > limit_px
    wider = cover_painters(setting, attempt).camera
    is_vague = wider is not None and wider.max_sigma_px > limit_px
    return is_vague or not _lies_on_surface(setting, attempt)


def refuse_doubtful(setting: Setting, attempt: Attempt) -> Attempt:
    """The attempt, refused where a circle and a line may be any of the field's and nothing else was found."""
    return refuse_as_open(attempt, "circle_unconfirmed") if _is_doubtful(setting, attempt) else attempt


def refuse_bare_field(setting: Setting, scene: Scene, attempt: Attempt) -> Attempt:
    """The attempt, refused where any circle of the template may be the one seen, a line or two carry the camera with
    it, and more of the markings that it puts into view is bare than painted.
    """
    mask, camera = attempt.mask, attempt.camera
    is_open = attempt.is_calibrated and _may_be_any_circle(setting, attempt) and attempt.circle_name is None
    if not is_open or mask is None or camera is None or _count_carrying(attempt) > FEWEST_CARRYING:
        return attempt
    with setting.clock("cues"):
        paint = look_for_paint(scene, mask, setting.config, setting.template)
    if paint is None or weigh_view(camera.view, setting.template, paint).evidence > 0.0:
        return attempt
    return refuse_as_open(attempt, "circle_unconfirmed")


def look_for_paint(scene: Scene, mask: MarkingMask, config: Config, template: FieldTemplate) -> SeenPaint | None:
    """What stands out from the playing surface of a mask as paint of its polarity does; what was found on that surface
    before, for another mask or another template, is not looked for again.
    """
    if mask.field_region is None:
        return None
    options, has_colours = suit_field(config.mask, template).detector, Outlines.of(template).has_colours
    surface = np.packbits(mask.field_region).tobytes()
    told = config.mask.paint_bgr, config.mask.other_paint_bgr
    said = options.ridges.model_dump_json(), options.field_region.light, options.detection_width_px, told
    key = ("surface", *said, has_colours, mask.polarity, surface)
    ridges = scene.looks.once(key, lambda: see_surface(scene.image, scene.marked, mask, options, has_colours))
    return None if ridges is None else see_paint(ridges, mask)


def place_template(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """The attempt with the field laid over the picture by all that is painted.

    The likeliest placements are followed to their cameras, which know the lens, and what is painted where these put the
    markings decides. Where two say alike, the attempt is refused as ``circle_open``. Each surface and polarity is
    searched until one answers.
    """
    mask, tried, followed = first.mask, set[tuple[object, ...]](), list[_Followed]()
    # a field of other sizes of the same sport lies where the first one does
    sport = "laid", setting.template.sport or setting.template.name
    laid = scene.looks.recall(sport)
    for rank, seen in enumerate(() if mask is None else (mask, *mask.sightings)):
        if not has_circle(seen):
            continue
        with setting.clock("cues"):
            paint = look_for_paint(scene, seen, setting.config, setting.template)
        if paint is None or paint.key in tried or laid not in (None, paint.key):
            continue
        tried.add(paint.key)
        most = MOST_PLACED if laid is None else MOST_OF_SIBLING
        factor = 1.0 if rank < LIKELIEST else OTHER_SIGHTING
        best = _place_among(setting, scene, seen, paint, factor, most, followed)
        if best is not None:
            scene.looks.keep(sport, paint.key)
            yield best


def _place_among(
    setting: Setting,
    scene: Scene,
    mask: MarkingMask,
    paint: SeenPaint,
    factor: float,
    most: int,
    followed: list[_Followed],
) -> Attempt | None:
    """The field laid over paint of one polarity on one surface by one of so many placements at most, but for those that
    were followed before, to which the others are added; None where none is believed with the evidence that is usually
    enough, times a factor.
    """
    earlier = [other for other in followed if other.paint.surface is paint.surface]
    with setting.clock("cues"):
        placements = _find_placements(setting, scene, paint)
    now = _follow_likely(setting, scene, mask, paint, placements[:most], earlier)
    followed += now
    return _choose_answer(setting, now, earlier, factor)


def _find_placements(setting: Setting, scene: Scene, paint: SeenPaint) -> list[PlacedField]:
    """The likeliest ways to lay the field over paint of one polarity on one surface, the one with most evidence first;
    none of which much less speaks.
    """
    template, side, size = setting.template, setting.config.correspondences.camera_side, (setting.width, setting.height)
    # a field of other sizes of the same sport lies where the first one does
    key = ("placements", template.sport or template.name, side, *paint.key)
    rough = scene.looks.once(key, lambda: search_placements(paint, size, template, side))
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
        attempt = _follow_placement(setting, scene, mask, placed)
        answer = None
        if attempt is not None and attempt.camera is not None:
            weighed = weigh_view(attempt.camera.view, setting.template, paint)
            answer = (weighed, attempt) if _may_be_right(weighed, placed) else None
        followed.append(_Followed(paint, placed.view, answer))
    return followed


def _may_be_right(weighed: ViewEvidence, placed: PlacedField) -> bool:
    """Whether a camera that a placement led to lays the field on the playing surface and on the placement's paint."""
    return weighed.surface_share >= SURFACE_SHARE and not _has_wandered(weighed, placed)


def _choose_answer(
    setting: Setting, followed: Sequence[_Followed], earlier: Sequence[_Followed], factor: float
) -> Attempt | None:
    """The answer for which most speaks, refused as open where another one comes near it, also one that was not believed
    on this surface before; None where such a one outweighs it, and where none is believed with the evidence that is
    usually enough, times a factor.
    """
    template = setting.template
    answers = [other.answer for other in followed if other.answer is not None]
    answers.sort(key=lambda answer: -_weigh_answer(*answer))
    if not answers or not (_is_believed(answers[0][0], factor) or _is_precise(setting, *answers[0])):
        return None
    if _count_telling(answers[0][1], template) < FEWEST_CARRYING:
        return None
    (weighed, best), others = answers[0], answers[1:]
    before = [other.answer for other in earlier if other.answer is not None]
    if any(_weigh_answer(*other) > _weigh_answer(weighed, best) for other in before):
        return None
    others += before
    if weighed.bare_widths <= MOST_BARE:
        others = [other for other in others if other[0].bare_widths <= MOST_BARE]
    others.sort(key=lambda answer: -_weigh_answer(*answer))
    weight = _weigh_answer(weighed, best)
    found = [
        (weight / _weigh_answer(other, attempt), Rival(attempt.circle_name or "", attempt.camera, other.evidence))
        for other, attempt in others
        if attempt.camera is not None
        and _weigh_answer(other, attempt) * LISTED_RATIO > weight
        and best.camera is not None
        and mean_distance_px(best.camera.view, attempt.camera.view, template) > ALIKE_WIDTHS * setting.width
    ]
    ratios, rivals = tuple(ratio for ratio, _ in found), tuple(rival for _, rival in found)
    least = LEAST_SHARE if weighed.found_share >= LEAST_SHARE else 0.0
    best = add_checks(replace(best, rivals=rivals), Check("found_share", weighed.found_share, least, True))
    if rivals:
        check = Check("rival_ratio", ratios[0], RIVAL_RATIO, ratios[0] >= RIVAL_RATIO)
        best = add_checks(best, check)
        if not check.passed:
            best = refuse_as_open(best, "circle_open")
    return best


def has_circle(mask: MarkingMask) -> bool:
    """Whether what was seen on a surface holds anything that may be a circle of a field."""
    scores = (candidate.score for candidate in mask.candidates)
    return mask.conic is not None or bool(mask.arcs) or max(scores, default=0.0) >= LEAST_CIRCLE


def _is_worth_following(setting: Setting, placed: PlacedField, paint: SeenPaint, earlier: Sequence[FieldView]) -> bool:
    """Whether a placement explains some of the paint, and was not followed on this surface before."""
    if weigh_view(placed.view, setting.template, paint).explained_share < LEAST_PLACED_EXPLAINED:
        return False
    limit = SAME_WIDTHS * setting.width
    return all(mean_distance_px(placed.view, view, setting.template) > limit for view in earlier)


def keep_evidence(scene: Scene, template: FieldTemplate, weighed: ViewEvidence) -> None:
    """Keep what speaks for a template that was laid over the picture, believed or not, where nothing spoke more."""
    key, best = ("evidence", template.name), recall_evidence(scene, template.name)
    if best is None or weighed.evidence * weighed.explained_share > best.evidence * best.explained_share:
        scene.looks.keep(key, weighed)


def recall_evidence(scene: Scene, template: str) -> ViewEvidence | None:
    """What speaks most for a template that was laid over the picture; None where it was not."""
    found = scene.looks.recall(("evidence", template))
    return found if isinstance(found, ViewEvidence) else None


def _has_wandered(weighed: ViewEvidence, placed: PlacedField) -> bool:
    """Whether a camera found so much more paint than the placement that it comes from that it lies on other paint."""
    return weighed.evidence > WANDERED_TIMES * max(0.0, placed.evidence) + WANDERED_WIDTHS


def _weigh_answer(weighed: ViewEvidence, attempt: Attempt) -> float:
    """Evidence for a camera, picture widths, times the root of the number of markings that carry it: a circle and a
    line fit a wrong camera as well as the right one, many markings do not.
    """
    return weighed.evidence * float(np.sqrt(max(1, _count_carrying(attempt))))


def _count_carrying(attempt: Attempt) -> int:
    """How many markings carry the camera of an attempt."""
    return 0 if attempt.camera is None else len(attempt.camera.residuals_px)


def _count_telling(attempt: Attempt, template: FieldTemplate) -> int:
    """How many markings carry the camera of an attempt, without spots in the middle of a circle: they lie there
    whichever circle it is.
    """
    centers = np.array([circle.center for circle in (*template.circles, *template.arcs)], np.float64)
    middles = {
        mark.name for mark in template.marks if np.linalg.norm(centers - mark.position, axis=1).min() < mark.diameter_m
    }
    keys = () if attempt.camera is None else attempt.camera.residuals_px
    return sum(key.name not in middles for key in keys)


def _is_believed(weighed: ViewEvidence, factor: float = 1.0) -> bool:
    """Whether enough of what a placed field predicts is painted, or it explains nearly all that is painted."""
    evidence = weighed.evidence / factor
    is_painted = evidence >= LEAST_EVIDENCE and weighed.found_share >= LEAST_SHARE
    return is_painted or (weighed.explained_share >= EXPLAINED_SHARE and evidence >= EXPLAINED_EVIDENCE)


def _is_precise(setting: Setting, weighed: ViewEvidence, attempt: Attempt) -> bool:
    """Whether so many markings lie so exactly where the camera puts them that chance does not do it."""
    residuals = [] if attempt.camera is None else list(attempt.camera.residuals_px.values())
    is_exact = len(residuals) >= PRECISE_MARKINGS and np.median(residuals) <= PRECISE_PX * setting.width / 1920.0
    return bool(is_exact and weighed.evidence > 0.0 and weighed.explained_share >= PRECISE_EXPLAINED)


def _follow_placement(setting: Setting, scene: Scene, mask: MarkingMask, placed: PlacedField) -> Attempt | None:
    """The calibrated attempt that a placement leads to; None where there is none, or it leads far away."""
    told = replace(setting, circle=placed.circle)
    mask = replace(mask, conic=placed.conic, halfway=None, confidence=Confidence.ACCEPTED, band_px=0.0)
    picture = lighten_markings(scene.marked, mask, placed.circle)
    attempt = Attempt(mask=mask, circle_name=placed.circle.name)
    try:
        with setting.clock("edges"):
            attempt = replace(attempt, edges=detect_edges(picture, mask, setting.config.edges))
    except EstimationError:
        return None
    settled = _settle_view(told, picture, attempt, placed.view)
    if settled is None or settled.camera is None:
        return None
    attempt = settled
    is_near = (
        mean_distance_px(placed.view, settled.camera.view, setting.template) <= LARGEST_MOVE_WIDTHS * setting.width
    )
    is_good = is_near and attempt.is_calibrated and _is_of_this_size(setting, attempt)
    return attempt if is_good else None


def _is_of_this_size(setting: Setting, attempt: Attempt) -> bool:
    """Whether the markings lie where the camera puts them, but for one, or one of several, which may be a line of
    something else: on a field of another size more of them do not.
    """
    camera = attempt.camera
    if camera is None:
        return True
    limit_px = LARGEST_RESIDUAL_PX * setting.width / 1920.0
    off = sum(rms > _allow_painters(camera, key, limit_px) for key, rms in camera.residuals_px.items())
    return off <= max(1, len(camera.residuals_px) // STRAY_AMONG)


def _allow_painters(camera: CameraFit, key: MarkingKey, limit_px: float) -> float:
    """Largest residual of a marking, pixels, where painters' errors come on top of a limit without them."""
    return float(np.hypot(limit_px, PAINTERS_SIGMAS * camera.painted_sigma_px.get(key, 0.0)))


def _settle_view(setting: Setting, picture: NDArray[np.uint8], attempt: Attempt, view: FieldView) -> Attempt | None:
    """The attempt with every marking measured where a view puts it, and again where the camera that follows does; None
    where there is no camera, or one that leads far away.
    """
    there = view
    for _ in range(PLACED_ROUNDS):
        attempt = _calibrate_view(setting, picture, attempt, there)
        if attempt.camera is None:
            return None
        there = attempt.camera.view
        if mean_distance_px(view, there, setting.template) > LOST_WIDTHS * setting.width:
            return None
    return attempt


def _calibrate_view(setting: Setting, picture: NDArray[np.uint8], attempt: Attempt, view: FieldView) -> Attempt:
    """The attempt with every marking measured where a view puts it."""
    mask, edges, template = attempt.mask, attempt.edges, setting.template
    if mask is None or edges is None:
        return attempt
    with setting.clock("rays"):
        circles, lines = measure_template(picture, view, template, mask.field_region, edges.noise, setting.config.rays)
        spots = measure_spots(picture, view, template.lone_marks, edges.noise, template.placement_sd_m)
    observations = Observations(setting.width, setting.height, circles, lines, spots)
    seen = replace(attempt, verdict=None, camera=None, correspondences=None, homography=None)
    found = _calibrate_observations(setting, seen, observations)
    return _leave_out_strays(setting, seen, _leave_out_mark(setting, seen, found))


def _calibrate_observations(setting: Setting, seen: Attempt, observations: Observations) -> Attempt:
    """The attempt with given observations. What they are was decided by all that is painted, so that none is left out
    for the few centimetres by which real circles and lines are painted off their places: without the second circle of
    two end zones of rinks cameras were wrong by 11 and 17 px, with it by 5 and 4 px.
    """
    return estimate(setting, take_observations(setting, seen, observations), is_strain_left_out=False)


def _leave_out_mark(setting: Setting, seen: Attempt, attempt: Attempt) -> Attempt:
    """The attempt without the circle's mark where the camera contradicts it and other markings than the circle and a
    line decide: spots are painted centimetres off, and skates are taken for them.
    """
    camera, cues, observations = attempt.camera, attempt.cues, attempt.observations
    if attempt.code != "mark_contradicts_circle" or camera is None or cues is None or observations is None:
        return attempt
    if cues.mark is None or _count_carrying(attempt) < FEWEST_CARRYING:
        return attempt
    return _calibrate_observations(setting, seen, observations.without({MarkingKey(cues.mark.name)}))


def _leave_out_strays(setting: Setting, seen: Attempt, attempt: Attempt) -> Attempt:
    """The attempt without the few markings that lie farthest from where its camera puts them, one after another: the
    edge of a board or of a painted key may have been followed in their place.
    """
    camera, observations, unit = attempt.camera, attempt.observations, setting.width / 1920.0
    left = 0 if camera is None else max(1, len(camera.residuals_px) // DROPPED_AMONG)
    while left > 0 and camera is not None and observations is not None and len(camera.residuals_px) > FEWEST_LEFT:
        usual = STRAY_MEDIANS * float(np.median(list(camera.residuals_px.values())))
        limit_px = float(np.clip(usual, LEAST_STRAY_PX * unit, LARGEST_RESIDUAL_PX * unit))
        limits = {key: _allow_painters(camera, key, limit_px) for key in camera.residuals_px}
        beyond = {key: camera.residuals_px[key] / limit for key, limit in limits.items()}
        worst = max(beyond, key=lambda key: beyond[key])
        if beyond[worst] <= 1.0 and attempt.code != "residual_too_large":
            break
        observations = observations.without({worst})
        attempt = _calibrate_observations(setting, seen, observations)
        camera, left = attempt.camera, left - 1
    return attempt


PLACED_FIELD = Retry(
    _may_place_field, place_template, lambda setting, first, other: other.is_calibrated or other.code == "circle_open"
)
"""Tried on fields with several large circles, where nothing before calibrated or nothing else confirms it."""


def _may_show_more_markings(setting: Setting, attempt: Attempt) -> bool:
    """Whether a circle with few lines was calibrated where the field has many more markings."""
    field, camera = setting.config.field, attempt.camera
    is_seen = attempt.mask is not None and attempt.mask.source == "detector" and attempt.edges is not None
    if not (attempt.is_calibrated and field.any_circle and is_seen) or camera is None:
        return False
    return attempt.circle_name is None and camera.max_sigma_px > SURE_PX * setting.width / 1920.0


def take_in_markings(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt with every marking that lies where its camera puts it, and with the checks that it passed."""
    if attempt.mask is None or attempt.camera is None or attempt.verdict is None:
        return
    picture = lighten_markings(scene.marked, attempt.mask, setting.circle)
    fuller = _settle_view(setting, picture, attempt, attempt.camera.view)
    if fuller is None or not _lies_on_surface(setting, fuller):
        return
    told = set() if fuller.verdict is None else {check.name for check in fuller.verdict.checks}
    yield add_checks(fuller, *(check for check in attempt.verdict.checks if check.name not in told))


def _lies_on_surface(setting: Setting, attempt: Attempt) -> bool:
    """Whether a camera leaves the markings in the picture on the playing surface: a circle and a line of the field, or
    one marking more that fits by chance, make a wrong camera look sure, but it lays the rest of the field into the
    stands.
    """
    region = None if attempt.mask is None else attempt.mask.field_region
    if region is None or attempt.camera is None:
        return True
    return share_on_surface(attempt.camera.view, setting.template, region) >= SURFACE_SHARE


def _is_fuller(setting: Setting, attempt: Attempt, fuller: Attempt) -> bool:
    """Whether more markings agree with a surer camera, which stays within what the first one said of itself."""
    if attempt.camera is None or fuller.camera is None or not is_less_uncertain(setting, attempt, fuller):
        return False
    moved = mean_distance_px(attempt.camera.view, fuller.camera.view, setting.template)
    is_more = len(fuller.camera.residuals_px) > len(attempt.camera.residuals_px)
    return is_more and moved <= LARGEST_MOVE_WIDTHS * setting.width and _is_of_this_size(setting, fuller)


ALL_MARKINGS = Retry(_may_show_more_markings, take_in_markings, _is_fuller)
"""Tried on fields with several large circles, where few of the markings carry a camera."""
