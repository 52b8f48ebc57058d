"""Whether any circle of a field with several may be the one seen, and what a circle with a line or two leaves open."""

from __future__ import annotations

from circlecal.pipeline.attempts import add_checks, refuse_as_open
from circlecal.pipeline.field_paint import look_for_paint
from circlecal.pipeline.painters import cover_painters
from circlecal.pipeline.placed_view import FEWEST_CARRYING, count_carrying, lies_on_surface
from circlecal.pipeline.refinements import UNCERTAIN_PX
from circlecal.pipeline.setting import Scene, Setting
from circlecal.placement import weigh_view
from circlecal.results import Attempt, Check

CIRCLE_TOLD = "circle_told"
"""Check of a camera of which the paint tells which circle it lies about, though a circle and a line carry it: no other
circle of the field may be the one seen, so that what it leaves open on average counts, not at the worst place.
"""


def may_be_any_circle(setting: Setting, attempt: Attempt) -> bool:
    """Whether the detector looked, and nobody named the circle of a template with several large ones."""
    field, mask = setting.config.field, attempt.mask
    return field.any_circle and field.circle is None and mask is not None and mask.source == "detector"


def is_doubtful(setting: Setting, attempt: Attempt) -> bool:
    """Whether any circle of the template may be the one seen, and a camera that knows little of the field took one; of
    one that a circle and a line or two carry, painters' errors count, and where it lays the other markings.
    """
    if not (may_be_any_circle(setting, attempt) and attempt.is_calibrated) or attempt.camera is None:
        return False
    limit_px = UNCERTAIN_PX * setting.width / 1920.0
    if attempt.verdict is not None and attempt.verdict.check(CIRCLE_TOLD) is not None:
        return attempt.camera.mean_sigma_px > limit_px
    if attempt.circle_name is not None or count_carrying(attempt) > FEWEST_CARRYING:
        return attempt.camera.max_sigma_px > limit_px
    wider = cover_painters(setting, attempt).camera
    is_vague = wider is not None and wider.max_sigma_px > limit_px
    return is_vague or not lies_on_surface(setting, attempt)


def refuse_doubtful(setting: Setting, attempt: Attempt) -> Attempt:
    """The attempt, refused where a circle and a line may be any of the field's and nothing else was found."""
    return refuse_as_open(attempt, "circle_unconfirmed") if is_doubtful(setting, attempt) else attempt


def refuse_bare_field(setting: Setting, scene: Scene, attempt: Attempt) -> Attempt:
    """The attempt, refused where any circle of the template may be the one seen, a line or two carry the camera with
    it, and more of the markings that it puts into view is bare than painted.
    """
    mask, camera = attempt.mask, attempt.camera
    is_open = attempt.is_calibrated and may_be_any_circle(setting, attempt) and attempt.circle_name is None
    if not is_open or mask is None or camera is None or count_carrying(attempt) > FEWEST_CARRYING:
        return attempt
    with setting.clock("cues"):
        paint = look_for_paint(scene, mask, setting.config, setting.template)
    if paint is None:
        return attempt
    evidence = weigh_view(camera.view, setting.template, paint).evidence
    attempt = add_checks(attempt, Check("paint_of_view", evidence, 0.0, evidence > 0.0))
    return attempt if evidence > 0.0 else refuse_as_open(attempt, "circle_unconfirmed")
