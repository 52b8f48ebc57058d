"""One frame in, one calibration out: the order in which interpretations of it are tried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config, config_digest
from circlecal.errors import InputError
from circlecal.observations import Observations
from circlecal.paint.brightness import measure_paint
from circlecal.pictures.window import find_window
from circlecal.pipeline.discs import DISCS
from circlecal.pipeline.doubtful_circle import refuse_bare_field, refuse_doubtful
from circlecal.pipeline.field_lines import FIELD_LINES, is_sure, look_for_field_lines
from circlecal.pipeline.fields import field_of
from circlecal.pipeline.other_circles import ARCS, OTHER_CIRCLES, mask_arcs
from circlecal.pipeline.other_fields import refuse_other_field
from circlecal.pipeline.painters import cover_painters
from circlecal.pipeline.placed_field import PLACED_FIELD
from circlecal.pipeline.placed_view import ALL_MARKINGS
from circlecal.pipeline.refinements import calibrate_scene
from circlecal.pipeline.setting import Looks, Scene, Setting, frame_generator, prepare_scene
from circlecal.results import Attempt, FrameCalibration, Verdict

ARC_ALONE = (
    "part of a circle is seen and no line through its middle: what else is seen does not tell well enough how it is "
    "turned, or whether it is a penalty arc"
)
"""Why arcs are not enough."""
OTHER_INTERPRETATIONS = (PLACED_FIELD, OTHER_CIRCLES, ARCS, FIELD_LINES, DISCS)
"""What else in the picture is taken for the circle; in this order."""


def run(
    image: NDArray[np.uint8],
    config: Config,
    *,
    mask: NDArray[np.uint8] | None = None,
    extra: Observations | None = None,
    frame_id: str,
    source: str | None = None,
    looks: Looks | None = None,
    is_brief: bool = False,
) -> FrameCalibration:
    """Calibrate one frame.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    config : Config
        Options of every stage.
    mask : (H, W) uint8, optional
        Marking mask as SoccerNet class ids.
    extra : Observations, optional
        Keypoints, lines and marks from elsewhere, used together with what the picture shows.
    frame_id : str
        Name of the frame, which changes no answer: every frame begins with the draws of the seed.
    source : str, optional
        Path or URL as given, recorded in the result.
    looks : Looks, optional
        What was found in the same picture under other templates.
    is_brief : bool
        Whether only the likeliest circle is tried, and where any of the field's may be seen the whole field laid over
        the picture: nothing else in it is taken for the circle.

    Returns
    -------
    FrameCalibration
        With a refused verdict where a stage could not answer; nothing is raised for a frame.

    Raises
    ------
    ConfigError
        For an unknown field template or circle.
    InputError
        Where the mask is not of the picture's size.
    """
    template, circle = field_of(config)
    height, width = image.shape[:2]
    if mask is not None and mask.shape != (height, width):
        raise InputError(f"{frame_id}: the mask is {mask.shape[1]}x{mask.shape[0]}, the picture {width}x{height}")
    digest, config = config_digest(config), _suit_window(config, image)
    setting = Setting(config, template, circle, width, height, frame_generator(config.seed))
    scene = prepare_scene(setting, image, mask, extra, looks)
    if is_brief and config.field.any_circle:
        attempt = calibrate_scene(setting, scene)
        attempt = PLACED_FIELD.try_out(setting, scene, attempt) or attempt
    else:
        attempt = calibrate_scene(setting, scene) if is_brief else _calibrate_frame(setting, scene)
        attempt = refuse_doubtful(setting, ALL_MARKINGS.try_out(setting, scene, attempt) or attempt)
    attempt = cover_painters(setting, attempt)
    # among several fields what speaks for each is compared afterwards
    attempt = attempt if looks is not None else refuse_other_field(setting, scene, attempt)
    paint_bgr = _measure_paint(setting, scene, attempt)
    return replace(setting.calibration(attempt, frame_id, source), paint_bgr=paint_bgr, config_digest=digest)


def _suit_window(config: Config, image: NDArray[np.uint8]) -> Config:
    """The configuration with the window of a picture that has bars or a plain wall around it."""
    window = find_window(image) if config.camera.window_px is None else None
    if window is None:
        return config
    return config.model_copy(update={"camera": config.camera.model_copy(update={"window_px": window})})


def _calibrate_frame(setting: Setting, scene: Scene) -> Attempt:
    """By the straight markings of a first look where they leave no doubt, else by the circle; by those markings all the
    same where no circle calibrates.
    """
    by_lines = look_for_field_lines(setting, scene)
    if by_lines is not None and is_sure(setting, by_lines):
        return by_lines
    by_circle = _calibrate_circle(setting, scene)
    return by_circle if by_circle.is_calibrated or by_lines is None else by_lines


def _calibrate_circle(setting: Setting, scene: Scene) -> Attempt:
    """By what is likeliest the circle, or by what else it may be."""
    return reconsider(setting, scene, refuse_bare_field(setting, scene, calibrate_scene(setting, scene)))


def _measure_paint(setting: Setting, scene: Scene, attempt: Attempt) -> tuple[float, float, float] | None:
    """Colour of the paint in an accepted picture, where all markings of the field have one."""
    template, camera, mask = setting.template, attempt.camera, attempt.mask
    if not (attempt.is_calibrated and template.is_in_one_paint) or camera is None or mask is None:
        return None
    circle = template.circle_by_name.get(attempt.circle_name or setting.circle.name, setting.circle)
    return measure_paint(scene.image, camera.view, circle, template) if mask.source == "detector" else None


def reconsider(setting: Setting, scene: Scene, first: Attempt) -> Attempt:
    """The first attempt, or another interpretation of the picture where the first one is refused or doubtful."""
    for interpretation in OTHER_INTERPRETATIONS:
        other = interpretation.try_out(setting, scene, first)
        if other is not None:
            return other
    if first.verdict is not None and first.verdict.stage == "mask" and first.code is not None and mask_arcs(first):
        return replace(first, verdict=Verdict("refused", "rotation_free", ARC_ALONE, "camera"))
    return first
