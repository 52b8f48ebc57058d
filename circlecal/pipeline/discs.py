"""The circle as the rim of a painted disc, or of a logo: an edge, where no band is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from circlecal.field import Circle, FieldTemplate
from circlecal.paint.local_energy import local_energy
from circlecal.pipeline.other_circles import interpret_otherwise
from circlecal.pipeline.placed_field import PLACED_FIELD
from circlecal.pipeline.refinements import Retry, calibrate_scene
from circlecal.pipeline.setting import Scene, Setting
from circlecal.results import Attempt
from circlecal.stages.verdict_on_picture import is_confirmed


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
    outer edge of its line, that edge. Where any circle of the field may be the one seen and that is a disc, the whole
    field is laid over the rims too.
    """
    told = _tell_rims(setting)
    relief = Scene(scene.image, scene.gray, None, scene.extra, None, relief=local_energy(scene.image))
    attempt = calibrate_scene(told, relief)
    yield attempt
    yield from interpret_otherwise(told, relief, attempt)
    placed = PLACED_FIELD.try_out(told, relief, attempt) if setting.circle.fill == "disc" else None
    if placed is not None:
        yield placed


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
