"""The circle as the rim of a painted disc, or of a logo: an edge, where no band is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.pipeline.attempts import measure
from circlecal.pipeline.other_circles import interpret_otherwise
from circlecal.pipeline.other_fields import is_dark_disc, judge_lines
from circlecal.pipeline.placed_field import PLACED_FIELD, place_about_rims
from circlecal.pipeline.placed_view import see_rims
from circlecal.pipeline.refinements import Retry, calibrate_scene
from circlecal.pipeline.setting import Scene, Setting
from circlecal.placement import distinct_circles
from circlecal.results import Attempt, Interpretation
from circlecal.stages.verdict_on_picture import is_confirmed

MOST_LOOKS, RIMS_OF_LOOK = 3, 2
"""How often rims are looked for, each time without those that were taken for the circle before, and how many of each
look may be the rim of a logo.
"""


def _may_be_a_disc(setting: Setting, attempt: Attempt) -> bool:
    """Whether the detector looked for a band in vain, and the circle may have none; not again for every paint, since
    edges of all colours count.
    """
    is_detected = attempt.mask is not None and attempt.mask.source == "detector"
    wanted = setting.config.mask.detector.rims
    is_possible = setting.circle.fill != "none" if wanted is None else wanted
    is_first = setting.config.mask.paint_bgr is None
    return is_detected and is_possible and is_first and not attempt.is_calibrated


def take_rims(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """Attempts with the rim of a disc as the circle, in a picture where edges show as bands; of a logo that reaches the
    outer edge of its line, that edge. Where any circle of the field may be the one seen, the whole field is laid over
    the rims too, if that is a disc, or over all that is painted about the rims, if it is a logo.
    """
    told = _tell_rims(setting)
    relief = Scene(scene.image, scene.gray, None, scene.extra, None, relief=see_rims(scene), covered=scene.covered)
    attempt = _refuse_other_side(setting, scene, calibrate_scene(told, relief))
    yield attempt
    yield from interpret_otherwise(told, relief, attempt)
    if setting.circle.fill == "disc":
        placed = PLACED_FIELD.try_out(told, relief, attempt)
    else:
        placed = place_about_rims(setting, scene, first, _find_rims(told, relief, attempt))
    if placed is not None:
        yield placed


def _refuse_other_side(setting: Setting, scene: Scene, attempt: Attempt) -> Attempt:
    """The attempt, refused where the lines beside a disc are not there as its camera has them: a disc, and two lines
    through its middle, look alike from both sides.
    """
    if not (attempt.is_calibrated and is_dark_disc(setting.circle, setting.template)):
        return attempt
    judged = judge_lines(scene, attempt, setting.template, setting.circle)
    return attempt if judged.is_calibrated else judged


def _find_rims(setting: Setting, relief: Scene, attempt: Attempt) -> list[Array]:
    """What may be the rim of a logo: what the attempt found, and what is found without that; a logo holds other rims,
    too.
    """
    masks, ruled_out = [attempt.mask], list[Interpretation]()
    while len(masks) < MOST_LOOKS and masks[-1] is not None and masks[-1].conic is not None:
        ruled_out.append(Interpretation(masks[-1].conic, None))
        masks.append(measure(setting, relief, tuple(ruled_out)).mask)
    return [conic for mask in masks if mask is not None for conic in distinct_circles(mask)[:RIMS_OF_LOOK]]


def _is_believed(setting: Setting, first: Attempt, other: Attempt) -> bool:
    """Whether a rim is believed: of a disc as any circle, of a logo, which holds other rims, where other markings
    confirm it.
    """
    if not other.is_calibrated or setting.circle.fill == "disc":
        return other.is_calibrated
    template, circle = other_field(setting)
    near_px = setting.config.verdict.max_mark_distance_px * setting.width / 1920.0
    return is_confirmed(other, template, circle, near_px)


def other_field(setting: Setting) -> tuple[FieldTemplate, Circle]:
    """The field, and the circle that is looked for, with every circle that may be filled as the rim of a disc."""
    wanted = setting.circle.name

    def fill(circle: Circle) -> Circle:
        if circle.fill == "none" and circle.name != wanted:
            return circle
        radius = setting.template.radius(circle, "outer")
        return circle.model_copy(update={"fill": "disc", "radius_m": radius})

    template = setting.template.model_copy(update={"circles": tuple(fill(c) for c in setting.template.circles)})
    return template, template.circle_by_name.get(wanted, setting.circle)


def _tell_rims(setting: Setting) -> Setting:
    """What stays the same over the attempts at rims: light bands as wide everywhere, in whatever paint."""
    template, circle = other_field(setting)
    mask = setting.config.mask
    acceptance = mask.detector.acceptance.model_copy(update={"even_width": True})
    told = {"marking": "light", "one_paint": False, "acceptance": acceptance}
    detector = mask.detector.model_copy(update=told)
    config = setting.config.model_copy(update={"mask": mask.model_copy(update={"detector": detector})})
    return replace(setting, config=config, template=template, circle=circle)


DISCS = Retry(_may_be_a_disc, take_rims, _is_believed)
"""Tried where nothing before calibrated and the field's circle may be a disc or a logo."""
