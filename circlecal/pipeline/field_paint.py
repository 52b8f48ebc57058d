"""What is painted on a playing surface, and what speaks for the fields that were laid over it: kept by picture."""

from __future__ import annotations

import numpy as np

from circlecal.config import Config
from circlecal.field import FieldTemplate
from circlecal.pipeline.setting import Scene
from circlecal.placement import Outlines, SeenPaint, ViewEvidence, see_paint, see_surface
from circlecal.results import MarkingMask
from circlecal.stages.mask import suit_field

LEAST_CIRCLE = 0.15
"""Score that the best candidate of a surface needs where no arc is seen there, without which no field is laid over it,
and the best one along a paint's colour, without which that paint is not followed (in a rendered hall the right one has
0.72): of 14 right cameras of real and rendered rinks and courts 0.38 to 0.93, of a tennis court and two halls without a
circle in view 0.05 to 0.12.
"""


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


def has_circle(mask: MarkingMask) -> bool:
    """Whether what was seen on a surface holds anything that may be a circle of a field."""
    scores = (candidate.score for candidate in mask.candidates)
    return mask.conic is not None or bool(mask.arcs) or max(scores, default=0.0) >= LEAST_CIRCLE


def keep_evidence(scene: Scene, template: FieldTemplate, weighed: ViewEvidence) -> None:
    """Keep what speaks for a template that was laid over the picture, believed or not, where nothing spoke more."""
    key, best = ("evidence", template.name), recall_evidence(scene, template.name)
    if best is None or weighed.evidence * weighed.explained_share > best.evidence * best.explained_share:
        scene.looks.keep(key, weighed)


def recall_evidence(scene: Scene, template: str) -> ViewEvidence | None:
    """What speaks most for a template that was laid over the picture; None where it was not."""
    found = scene.looks.recall(("evidence", template))
    return found if isinstance(found, ViewEvidence) else None
