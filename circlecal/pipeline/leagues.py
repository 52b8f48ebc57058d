"""Which fields of other sizes of a sport may be the one that is seen, beside one that was tried: each is laid where
that one lies, which takes a twentieth of the time of a whole calibration.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from circlecal.config import Config, suit_config
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.projective import Array
from circlecal.pipeline.field_paint import look_for_paint, recall_evidence
from circlecal.pipeline.setting import Looks, Scene
from circlecal.placement import (
    LaidField,
    RoughPlacements,
    SeenPaint,
    ViewEvidence,
    lay_over_view,
    refine_placements,
    weigh_view,
)
from circlecal.results import Attempt, CameraFit, FrameCalibration

LEAGUE_SHARE = 0.85
"""Share of what speaks for a league (evidence times the share of the paint that it explains) below which another one
that is laid in its place is not calibrated: on 13 real frames of rinks and courts, laid where the right league has its
camera, others have 0.79 at most; laid where a wrong league has its own, the right one has 1.3 to 3 times as much in
nine of ten cases (0.57 on a rink that was laid elsewhere, where the search for the field's place tells it).
"""
LEAST_EVIDENCE = 0.3
"""Evidence, picture widths, that a league needs to stand in the way of others: an NBA court of which three arcs are
seen has 0.14 as an NCAA court, and 0.08 where it is laid.
"""
MOST_LAID = 4
"""So many searches for places of a field are kept, one for each surface and polarity."""
NOTHING_LAID = ViewEvidence(0.0, 0.0, 0.0)
"""What speaks for a field that was laid nowhere."""
ROUND = 72
"""Places round a circle to which a conic is fitted."""


def may_be_league(scene: Scene, config: Config, tried: Sequence[FrameCalibration], template: FieldTemplate) -> bool:
    """Whether a field may be the one that is seen, beside others of its sport that were tried.

    Parameters
    ----------
    scene : Scene
        The picture, with what was found in it.
    config : Config
        Options for a field that nobody named.
    tried : sequence of FrameCalibration
        What fields of the sport led to, calibrated or refused; without any, every field may be seen.
    template : FieldTemplate
        The field.

    Returns
    -------
    bool
        False where it explains clearly less of the paint than one of those, wherever that one was laid.
    """
    own = max((_lay_again(scene, config, found) for found in tried), key=weigh, default=NOTHING_LAID)
    if own.evidence < LEAST_EVIDENCE:
        return True
    other = max(
        (laid for found in tried for laid in _lay_other(scene, config, found, template)), key=weigh, default=None
    )
    return other is None or weigh(other) >= LEAGUE_SHARE * weigh(own)


def weigh(seen: ViewEvidence) -> float:
    """What speaks for a field: evidence, picture widths, times the share of the paint that it explains."""
    return max(0.0, seen.evidence) * seen.explained_share


def keep_search(looks: Looks, template: FieldTemplate, paint: SeenPaint, rough: RoughPlacements | None) -> None:
    """Keep where a search on one surface laid a field, for other leagues of its sport."""
    kept = _recall_searches(looks, template)
    if rough is not None and len(kept) < MOST_LAID and all(paint.key != other.key for other, _ in kept):
        looks.keep(("searches", template.sport_name), (*kept, (paint, rough)))


def _recall_searches(looks: Looks, template: FieldTemplate) -> tuple[tuple[SeenPaint, RoughPlacements], ...]:
    found = looks.recall(("searches", template.sport_name))
    return found if isinstance(found, tuple) else ()


def _lay_again(scene: Scene, config: Config, found: FrameCalibration) -> ViewEvidence:
    """What speaks most for a field that was tried: where searches laid it, or its own camera has it, in its own size
    and in its usual one.
    """
    searched = recall_evidence(scene, found.field_name) or NOTHING_LAID
    seen = [searched, *_lay_over_camera(scene, config, found, found.template)]
    template, paint = found.template, _look_for_own_paint(scene, config, found)
    if template is not None and paint is not None and found.view is not None:
        seen.append(weigh_view(found.view, template, paint))
    return max(seen, key=weigh)


def _lay_other(scene: Scene, config: Config, found: FrameCalibration, template: FieldTemplate) -> list[ViewEvidence]:
    """What speaks for a field where searches for its sport laid one, and where the camera of a field that was tried has
    that one.
    """
    size = found.width, found.height
    searched = [_lay_best(rough, paint, size, template) for paint, rough in _recall_searches(scene.looks, template)]
    return [*searched, *_lay_over_camera(scene, config, found, template)]


def _lay_over_camera(
    scene: Scene, config: Config, found: FrameCalibration, template: FieldTemplate | None
) -> list[ViewEvidence]:
    """What speaks for a field where a calibrated camera of another one has it; nothing without such a camera."""
    tried, paint = found.template, _look_for_own_paint(scene, config, found)
    if tried is None or template is None or paint is None:
        return []
    circle = tried.circle_by_name.get(found.circle_name)
    if circle is None:
        return []
    key = ("laid over", found.field_name, template.name)
    laid = scene.looks.once(key, lambda: lay_over_attempt(found.attempt, tried, circle, paint, (template,)))
    return [one.seen for one in laid]


def _look_for_own_paint(scene: Scene, config: Config, found: FrameCalibration) -> SeenPaint | None:
    """The paint of the surface on which a field was calibrated; None without a camera."""
    template, mask = found.template, found.attempt.mask
    if found.status != "calibrated" or template is None or mask is None:
        return None
    return look_for_paint(scene, mask, suit_config(config, found.field_name), template)


def _lay_best(rough: RoughPlacements, paint: SeenPaint, size: tuple[int, int], template: FieldTemplate) -> ViewEvidence:
    """What speaks for the best place of a field after a search; nothing where there is none."""
    placed = refine_placements(rough, paint, size, template)
    return weigh_view(placed[0].view, template, paint) if placed else NOTHING_LAID


def lay_over_attempt(
    attempt: Attempt, template: FieldTemplate, circle: Circle, paint: SeenPaint, others: Sequence[FieldTemplate]
) -> list[LaidField]:
    """Several fields that are laid where an attempt has one, and moved onto the paint.

    Parameters
    ----------
    attempt : Attempt
        With a camera.
    template, circle : FieldTemplate, Circle
        The attempt's field, and the circle of it about which the others are laid.
    paint : SeenPaint
        What stands out from the playing surface.
    others : sequence of FieldTemplate
        The fields that are laid, of which ``template`` may be one.

    Returns
    -------
    list of LaidField
        One for each; empty without a camera, or where the picture shows nothing of the circle.
    """
    camera, mask = attempt.camera, attempt.mask
    if camera is None or mask is None:
        return []
    conic = mask.conic if mask.conic is not None else _draw_conic(camera, circle, template)
    if conic is None:
        return []
    laid = (lay_over_view(camera.view, circle, conic, template, other, paint) for other in others)
    return [one for one in laid if one is not None]


def _draw_conic(camera: CameraFit, circle: Circle, template: FieldTemplate) -> Array | None:
    """The conic (3, 3) nearest to a circle as a camera shows it; None where the picture does not show it."""
    angle = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    shown = camera.view.project(camera.view.circle_points(circle, "center", angle, template))
    shown = shown[np.isfinite(shown).all(axis=1)]
    return fit_conic(shown) if camera.view.shows(shown).any() else None
