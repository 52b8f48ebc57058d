"""The whole template laid over the picture, where any of its circles may be the one seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.errors import EstimationError
from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.observations import Observations
from circlecal.paint.spots import measure_spots
from circlecal.pipeline.attempts import estimate, take_observations
from circlecal.pipeline.refinements import Retry
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.refusals import Confidence
from circlecal.results import Attempt, Check, MarkingMask
from circlecal.stages.edges import detect_edges
from circlecal.stages.mask import MaskConfig, Paint, find_placement, look_for_paint, suit_field
from circlecal.stages.rays import measure_template
from circlecal.stages.verdict import needs_confirmation

PLACED_ROUNDS = 2
"""How often the markings of a placed field are measured: where the placement puts them, and where the camera does."""


LARGEST_MOVE_WIDTHS = 0.02
"""Mean distance, picture widths, by which the camera may move the markings from where they were found: the placement
knows no lens, which moves them by 0.001 to 0.013.
"""


def _may_place_field(setting: Setting, first: Attempt) -> bool:
    """Whether any circle of the template may be the one seen, and what is looked for usually did not calibrate."""
    field = setting.config.field
    is_seen = first.mask is not None and first.mask.source == "detector"
    is_open = first.verdict is not None and (not first.is_calibrated or needs_confirmation(first.verdict))
    return field.any_circle and field.circle is None and is_seen and is_open and setting.config.camera.enabled


def _look_for_paint(scene: Scene, mask: MarkingMask, options: MaskConfig) -> Paint | None:
    """What stands out from the playing surface of a mask."""
    key = ("paint", options.model_dump_json(), id(mask))
    # the mask is kept beside, so that no other one takes its identity
    return scene.looks.once(key, lambda: (mask, look_for_paint(scene.image, scene.gray, mask, options)))[1]


def place_template(setting: Setting, scene: Scene, first: Attempt) -> Iterator[Attempt]:
    """The attempt with the field laid over the picture by all that is painted, where that is possible in one way."""
    mask, config, template = first.mask, setting.config, setting.template
    if mask is None:
        return
    with setting.clock("cues"):
        paint = _look_for_paint(scene, mask, suit_field(config.mask, template))
        size, side = (setting.width, setting.height), config.correspondences.camera_side
        placed = find_placement(mask, paint, size, template, side)
    if placed is None:
        return
    told = replace(setting, circle=placed.circle)
    mask = replace(mask, conic=placed.conic, halfway=None, confidence=Confidence.ACCEPTED, band_px=0.0)
    picture = lighten_markings(scene.gray, mask, placed.circle)
    attempt = Attempt(mask=mask, circle_name=placed.circle.name)
    view = FieldView(PlaneCamera(setting.width, setting.height, placed.H_image_field))
    try:
        with setting.clock("edges"):
            attempt = replace(attempt, edges=detect_edges(picture, mask, config.edges))
    except EstimationError:
        return
    for _ in range(PLACED_ROUNDS):
        attempt = _calibrate_view(told, picture, attempt, view)
        if attempt.camera is None:
            return
        view = attempt.camera.view
    if attempt.verdict is None or placed.distance_px(view, template) > LARGEST_MOVE_WIDTHS * setting.width:
        return
    found = Check("found_share", placed.found_share, placed.least_share, True)
    yield replace(attempt, verdict=replace(attempt.verdict, checks=(*attempt.verdict.checks, found)))


def _calibrate_view(setting: Setting, picture: NDArray[np.uint8], attempt: Attempt, view: FieldView) -> Attempt:
    """The attempt with every marking measured where a view puts it."""
    mask, edges, template = attempt.mask, attempt.edges, setting.template
    if mask is None or edges is None:
        return attempt
    with setting.clock("rays"):
        circles, lines = measure_template(picture, view, template, mask.field_region, edges.noise, setting.config.rays)
        spots = measure_spots(picture, view, template.lone_marks, edges.noise)
    observations = Observations(setting.width, setting.height, circles, lines, spots)
    seen = replace(attempt, verdict=None, camera=None, correspondences=None, homography=None)
    return estimate(setting, take_observations(setting, seen, observations))


PLACED_FIELD = Retry(_may_place_field, place_template, lambda setting, first, other: other.is_calibrated)
"""Tried on fields with several large circles, where nothing before calibrated or nothing else confirms it."""
