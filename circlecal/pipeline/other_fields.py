"""Whether another field than the one that was named explains the picture better: of another league, or of another sport
where little was found.

A court fits the picture of another league's with its circle, its border and what else lies alike, each a little beside
its place, while other markings are missing. So every other field is laid where the accepted camera has this one, and
moved onto the paint as this one is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from circlecal.config import TOLD_APART
from circlecal.field import Circle, FieldTemplate, field_names, load_field
from circlecal.pipeline.agreement import count_agreeing, measure_agreement
from circlecal.pipeline.attempts import add_checks, refuse_as_open
from circlecal.pipeline.field_paint import look_for_paint
from circlecal.pipeline.leagues import LEAGUE_SHARE, lay_over_attempt, weigh
from circlecal.pipeline.placed_view import FEWEST_CARRYING, SURFACE_SHARE, count_carrying, lie_about_alike
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.placement import LaidField, SeenPaint, ViewEvidence, weigh_view
from circlecal.results import Attempt, Check, Verdict
from circlecal.stages.confirm import look_for_markings
from circlecal.stages.evidence import bound_paint_width

FIELD_RATIO = 1.2
"""How many times more must speak for another field, evidence times the share of the paint that it explains, for this
one to be refused: of 17 right cameras of real rinks and courts the best other field of another size has 0.9 times as
much, one of nearly these sizes 1.11; of cameras under a wrong league three of four real ones have 1.4 to 2.9, and seven
of eight rendered ones 1.2 to 2.3.
"""
MORE_FOUND = 1.05
"""How many times the length of markings that are painted another field must show. One with fewer markings in view
leaves fewer of them bare, also where a laboratory paints no more than the circle and the line, which both explain alike
(1.00 on a real robots' field); right leagues show 1.09 to 1.3 times as much as wrong ones.
"""
AGREEMENT_RATIO = 1.3
"""How many times more markings, the nearer the more, may lie where another field has them: on rendered rinks that the
paint alone does not tell apart the right league has 1.5 to 3 times as many as the wrong one (four of them), the wrong
one 0.96 to 1.01 times as many as the right one (five); with one circle and a line in view both have as many. The
right one is carried by five markings at least there; three that fit another league by chance decided against a rink
whose own camera was 23 px off.
"""
LEAST_EVIDENCE, LEAST_SHARE = 0.3, 0.55
"""Evidence, picture widths, and share of its markings in view that are painted, without which no other field is
believed: as of a field that is laid over the picture.
"""
OF_ANY_SCALE, LONG_BARE_WIDTHS = 2, 0.12
"""Markings that carry a camera, circle and halfway line, which are those of a field at any scale; and length in view of
another one that is bare, picture widths, which then contradicts the scale: a rendered handball court that was named
futsal was 111 px off with 0.23 of a touchline bare; where nothing else carries right cameras of halls it is 0.
"""
SURE_SHARE = 0.8
"""Share of its markings in view that are painted from which on another field is named: right names of eight rendered
rinks and courts have 0.74 to 0.95, six of them 0.8 at least; wrong names 0.70.
"""
FULL_SHARE = 0.75
"""Share of the paint below which a camera may lie about another circle than its own, so that other fields are laid
about each of its size and colour: four rendered rinks under the other league and a court under an older one have 0.44
to 0.56 with wrong cameras, right cameras of rendered rinks and courts 0.94 to 1. On real rinks, where adverts are
painted, right ones have 0.37 to 0.56, so that what is laid there decides.
"""
LEAST_PAINT_M, LEAST_PAINT_SHARE = 0.038, 0.7
"""Least width of the paint of circles and lines on floors, metres, and share of the template's where that is thin:
halls are painted 5 to 8 cm wide, of which blur and wear leave nine tenths (14 rendered halls: 4.6 to 8 cm; three real
courts 5 to 5.5). Where a pitch of soccer is taken for a field with a smaller circle, its lines of 10 to 12 cm would be
2 to 2.6 cm wide on a court of handball or basketball, and 3.3 to 3.9 on one of futsal (seven rendered: 1.5 to 3.2).
"""
FLOORS = "floor", "any"
"""Grounds of the templates of halls."""
LEAST_LINES_FOUND, THINNEST_LINE = 0.62, 0.05
"""Least share of the straight markings beside a painted disc that is there, and how thin these may be: eight rendered
houses of curling from behind and from beside, with cameras within 3 px, have 0.84 to 0.94; two that were put on the
other side of the house, where its tee line and centre line lie too, but neither the back line nor the hog line, 0.4.
"""
LEAST_OF_LINE, LONG_LINE = 0.3, 0.1
"""Least share of each single one of them that is there, and length in view, picture widths, from which it is asked: of
a house seen from the other side all else may be painted (0.73 and 0.74 of two), but of its back line nothing is; right
cameras of ten rendered houses have 0.66 at least of each.
"""
NOTHING = 0.01
"""Evidence that counts as none, picture widths: no ratio is larger than a hundred times that of another field."""


def refuse_other_field(setting: Setting, scene: Scene, attempt: Attempt) -> Attempt:
    """The attempt, refused where another field explains the picture clearly better than the one that was named, which
    the reason names; or where most of the markings that the camera puts into view are not painted.

    Right cameras of 14 real and 30 rendered rinks, courts and robots' fields have evidence of 0.17 picture widths at
    least; of 26 rendered halls of futsal and handball 0.39 at least, with 0.9 of what they put into view on the floor.
    Halls of the other sport that were calibrated 98 to 236 px off have 0.25 and half of it painted, or 0.54 on the
    floor. Of a painted disc the straight lines decide.
    """
    template, camera, mask = setting.template, attempt.camera, attempt.mask
    if not (attempt.is_calibrated and template.has_leagues) or camera is None or mask is None:
        return attempt
    if mask.source != "detector":
        return attempt
    with setting.clock("verdict"):
        attempt = _refuse_thin_paint(setting, scene, attempt)
        circle = _find_circle(setting, attempt)
        paint = look_for_paint(scene, mask, setting.config, template)
        if paint is None or circle is None or not attempt.is_calibrated:
            return attempt
        seen_there = weigh_view(camera.view, template, paint)
        is_disc = is_dark_disc(circle, template)
        attempt = (
            judge_lines(scene, attempt, template, circle) if is_disc else _judge_alone(setting, attempt, seen_there)
        )
        if not attempt.is_calibrated:
            return attempt
        others = list(_find_others(template, is_sport_told=count_carrying(attempt) > FEWEST_CARRYING))
        laid = lay_over_attempt(attempt, template, circle, paint, (template, *others))
        if not laid:
            return attempt
        own = max(seen_there, laid[0].seen, key=weigh)
        rivals = {other.name: one for other, one in zip(others, laid[1:], strict=True)}
        if own.explained_share < FULL_SHARE:
            rivals = _lay_about_others(attempt, template, circle, paint, rivals)
        attempt = _compare_paint(attempt, template, own, rivals)
        return _compare_places(setting, scene, attempt, own, laid[0], rivals) if attempt.is_calibrated else attempt


def _compare_paint(
    attempt: Attempt, template: FieldTemplate, own: ViewEvidence, rivals: Mapping[str, LaidField]
) -> Attempt:
    """The attempt, refused where more of what another field puts into view is painted."""
    believed = {name: weigh(laid.seen) for name, laid in rivals.items() if _is_believed(laid.seen, own)}
    best = max(believed, key=lambda name: believed[name], default=None)
    ratio = 0.0 if best is None else believed[best] / max(weigh(own), NOTHING)
    check = Check.of("other_field_ratio", ratio, FIELD_RATIO)
    attempt = add_checks(attempt, check)
    if check.passed or best is None:
        return attempt
    likely = best if rivals[best].seen.found_share >= SURE_SHARE else "another field"
    reason = f"the picture looks like {likely}: its markings are painted, and those of {template.name} are not"
    return _refuse(attempt, reason)


def _compare_places(
    setting: Setting,
    scene: Scene,
    attempt: Attempt,
    own: ViewEvidence,
    laid: LaidField,
    rivals: Mapping[str, LaidField],
) -> Attempt:
    """The attempt, refused where the paint lies clearly nearer to the places of another field that covers about as much
    of it: each marking is measured anew where either field has it. A field that has markings which this one's template
    leaves out is not asked: these would count for it, and hold its camera.
    """
    names, least = setting.template.names, LEAGUE_SHARE * weigh(own)
    alike = [name for name, rival in rivals.items() if weigh(rival.seen) >= least and load_field(name).names <= names]
    if not alike or attempt.camera is None:
        return attempt
    agreements = {}
    for name in alike:
        told, rival = replace(setting, template=load_field(name)), rivals[name]
        agreements[name] = measure_agreement(told, scene, attempt, rival.circle, rival.view, FEWEST_CARRYING + 1)
    best = max(agreements, key=lambda name: agreements[name])
    # where no other field has a camera there is nothing to compare with
    of_own = measure_agreement(setting, scene, attempt, laid.circle, laid.view) if agreements[best] > 0.0 else 0.0
    ratio = agreements[best] / max(of_own, count_agreeing(attempt.camera), NOTHING)
    check = Check.of("other_field_agreement", ratio, AGREEMENT_RATIO)
    attempt = add_checks(attempt, check)
    if check.passed:
        return attempt
    reason = f"the picture looks like {best}: its markings lie where that field has them, not {setting.template.name}"
    return _refuse(attempt, reason)


def _refuse_thin_paint(setting: Setting, scene: Scene, attempt: Attempt) -> Attempt:
    """The attempt on a floor with how wide its lines may be, refused where lines are not painted so thin."""
    template, camera, mask = setting.template, attempt.camera, attempt.mask
    if template.ground not in FLOORS or camera is None or mask is None or attempt.verdict is None:
        return attempt
    carriers = frozenset(key.name for key in camera.residuals_px)
    picture = lighten_markings(scene.marked, mask, setting.circle)
    width_m = bound_paint_width(picture, mask, camera, template, carriers) * template.marking_width_m
    least_m = min(LEAST_PAINT_M, LEAST_PAINT_SHARE * template.marking_width_m)
    return _add_check(attempt, Check.of("painted_width_m", width_m, least_m))


def _add_check(attempt: Attempt, check: Check) -> Attempt:
    """An attempt with another check, which refuses it where it fails."""
    return attempt if attempt.verdict is None else replace(attempt, verdict=attempt.verdict.with_checks(check))


def is_dark_disc(circle: Circle, template: FieldTemplate) -> bool:
    """Whether a circle is the rim of a disc beside which dark lines run."""
    return circle.fill == "disc" and template.polarity == "dark"


def judge_lines(scene: Scene, attempt: Attempt, template: FieldTemplate, circle: Circle) -> Attempt:
    """The attempt about a disc, refused where the dark lines that its camera puts into view are not there, most of all
    of them or one alone: lines so thin are found along their places only.
    """
    camera, mask = attempt.camera, attempt.mask
    if camera is None or mask is None:
        return attempt
    dark, seen = ~scene.gray, frozenset({circle.name})
    region = mask.field_region
    agreement = look_for_markings(dark, camera, template, circle, frozenset(), region, seen, THINNEST_LINE)
    is_line = np.isin(agreement.names, [*template.line_by_name])
    length, share = agreement.length_px[is_line], agreement.share[is_line]
    if not length.any():
        return refuse_as_open(attempt, "markings_missing")
    found = float(length @ share) / float(length.sum())
    least = float(share[length >= LONG_LINE * camera.model.width].min(initial=1.0))
    attempt = _add_check(attempt, Check.of("lines_found_share", found, LEAST_LINES_FOUND))
    return _add_check(attempt, Check.of("least_line_share", least, LEAST_OF_LINE))


def _judge_alone(setting: Setting, attempt: Attempt, seen: ViewEvidence) -> Attempt:
    """The attempt, refused where what its camera puts into view is not painted. In a hall, where the camera lies about
    the only circle of the field, also where much of that lies beside the floor, where hardly more is painted than is
    not and most of the paint is no marking, and where nothing but circle and halfway line carries it and a line that
    would tell the scale is not painted.
    """
    field = setting.config.field
    if not field.all_markings:
        return attempt
    is_alone = setting.template.ground in FLOORS and not field.any_circle
    is_poor = seen.evidence < LEAST_EVIDENCE and seen.found_share < LEAST_SHARE and seen.explained_share < FULL_SHARE
    is_bare = count_carrying(attempt) <= OF_ANY_SCALE and seen.bare_widths >= LONG_BARE_WIDTHS
    if seen.evidence < 0.0 or (is_alone and (is_poor or is_bare)):
        return refuse_as_open(attempt, "markings_missing")
    return _add_check(attempt, Check.of("surface_share", seen.surface_share, SURFACE_SHARE)) if is_alone else attempt


def _refuse(attempt: Attempt, reason: str) -> Attempt:
    checks = () if attempt.verdict is None else attempt.verdict.checks
    return replace(attempt, verdict=Verdict("refused", "other_field", reason, "verdict", checks))


def _find_others(template: FieldTemplate, *, is_sport_told: bool) -> Iterator[FieldTemplate]:
    """The other fields of the package that may be seen in a field's place: of its sport; and where a circle and a line
    or two carry the camera, which are those of many sports, the usual ones of other sports on such a ground.
    """
    for name in field_names():
        other = load_field(name)
        if name == template.name or not other.has_leagues:
            continue
        is_on_ground = other.ground == template.ground or "any" in (other.ground, template.ground)
        if other.sport == template.sport or (not is_sport_told and name in TOLD_APART and is_on_ground):
            yield other


def _find_circle(setting: Setting, attempt: Attempt) -> Circle | None:
    """The circle that the camera lies about; None where it was fitted to none."""
    template, camera = setting.template, attempt.camera
    name = attempt.circle_name or setting.circle.name
    is_fitted = camera is not None and any(key.name == name for key in camera.residuals_px)
    return template.circle_by_name.get(name) if is_fitted else None


def _lay_about_others(
    attempt: Attempt, template: FieldTemplate, circle: Circle, paint: SeenPaint, rivals: Mapping[str, LaidField]
) -> dict[str, LaidField]:
    """Each of several other fields, by name, where most speaks for it with the circle that was seen as any of its size
    and colour; ``rivals`` lie about the circle that the attempt takes it for.
    """
    camera, best, others = attempt.camera, dict(rivals), [load_field(name) for name in rivals]
    for alike, moved in () if camera is None else lie_about_alike(camera, circle, template.round_ones):
        laid = lay_over_attempt(replace(attempt, camera=moved), template, alike, paint, others)
        for name, one in zip(rivals, laid, strict=bool(laid)):
            best[name] = max(best[name], one, key=lambda laid: weigh(laid.seen))
    return best


def _is_believed(seen: ViewEvidence, own: ViewEvidence) -> bool:
    """Whether enough of what another field predicts is painted, and more than of what this one predicts."""
    is_painted = seen.evidence >= LEAST_EVIDENCE and seen.found_share >= LEAST_SHARE
    return is_painted and seen.found_widths >= MORE_FOUND * own.found_widths
