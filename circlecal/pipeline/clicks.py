"""Points that somebody clicked or detected, without a picture: what they leave too uncertain by themselves is tried
with what main cameras have in common.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from circlecal.camera.options import CameraConfig
from circlecal.config import Config, load_config
from circlecal.geometry.camera_parameters import INDEX
from circlecal.observations import Observations
from circlecal.pipeline.attempts import add_checks, estimate, take_observations
from circlecal.pipeline.fields import Convention, apply_convention, field_of
from circlecal.pipeline.known_cameras import calibrate_by_cameras
from circlecal.pipeline.painters import cover_painters
from circlecal.pipeline.setting import Setting, frame_generator
from circlecal.results import Attempt, CameraFit, Check, FrameCalibration

PLACE = [INDEX[name] for name in ("x", "y", "z", "roll")]
"""Parameters of the camera that main cameras have in common."""
FARTHEST_PLACE = 3.65
"""How far from main cameras' place and roll the camera that points show by themselves may lie, standard deviations:
99 of 100 main cameras lie within (chi-square of four degrees of freedom). Of 120 rendered central views from anywhere
about the field 42 were too uncertain by themselves. Taken for main cameras' 17 of those were wrong by more than three
standard deviations; 9 of them lie within this limit, 4 of these wrong.
"""


def run_observations(
    observations: Observations,
    config: Config,
    *,
    frame_id: str,
    source: str | None = None,
    convention: Convention = "official",
    earlier: CameraFit | None = None,
    is_placed: bool = False,
) -> FrameCalibration:
    """Calibrate from what somebody else saw: annotated points or detected keypoints, without a picture.

    Parameters
    ----------
    observations : Observations
        Circles, lines, marks and keypoints with their sigmas.
    config : Config
        Options of every stage.
    frame_id, source : str
        As in :func:`circlecal.pipeline.run`.
    convention : {"official", "paint"}
        Where points on a marking lie: ``official`` takes them at the size that the rules name (the official metric's
        model has no paint width, and every field is of its size), ``paint`` on the centreline of the paint.
    earlier : CameraFit, optional
        As for :func:`circlecal.pipeline.attempts.estimate`.
    is_placed : bool
        Whether all that is painted decided what was seen, so that nothing is left out for straining the camera.

    Returns
    -------
    FrameCalibration
        What is too uncertain with default options for camera and verdict is tried with those of the configuration
        ``annotations``, whose digest the answer then has, where the camera may be a main camera as far as the points
        tell; the check ``assumed_place`` then stands among its checks.
    """

    def answer(chosen: Config) -> FrameCalibration:
        return _answer(observations, chosen, frame_id, source, convention, earlier, is_placed)

    first = calibrate_by_cameras(config, answer)
    if first.attempt.code != "too_uncertain" or convention != "official" or not _leaves_choice(config):
        return first
    preset = load_annotation_options()
    place = check_place(first.attempt.camera, preset.camera)
    if place.passed:
        chosen = config.model_copy(update={"camera": preset.camera, "verdict": preset.verdict})
        other = answer(chosen)
        if other.status == "calibrated":
            return replace(other, attempt=add_checks(other.attempt, place))
    return replace(first, attempt=add_checks(first.attempt, place))


def check_place(camera: CameraFit | None, options: CameraConfig) -> Check:
    """How far a camera lies from the place and roll that options expect, in standard deviations of both together.

    Parameters
    ----------
    camera : CameraFit or None
        Told without expecting that place; infinitely far where there is none.
    options : CameraConfig
        With a position and its standard deviations.
    """
    if camera is None or options.position_m is None:
        return Check.of("assumed_place", np.inf, FARTHEST_PLACE)
    away = camera.theta[PLACE] - (*options.position_m, 0.0)
    expected = np.diag(np.square((*options.position_sd_m, np.radians(options.roll_sd_deg))))
    away_squared = away @ np.linalg.solve(camera.covariance[np.ix_(PLACE, PLACE)] + expected, away)
    return Check.of("assumed_place", float(np.sqrt(away_squared)), FARTHEST_PLACE)


def _answer(
    observations: Observations,
    config: Config,
    frame_id: str,
    source: str | None,
    convention: Convention,
    earlier: CameraFit | None,
    is_placed: bool,
) -> FrameCalibration:
    template, circle = field_of(config)
    template = apply_convention(template, convention)
    generator = frame_generator(config.seed)
    setting = Setting(config, template, circle, observations.width, observations.height, generator)
    seen = take_observations(setting, Attempt(), observations)
    attempt = estimate(setting, seen, earlier, is_strain_left_out=not is_placed)
    return setting.calibration(cover_painters(setting, attempt), frame_id, source)


def _leaves_choice(config: Config) -> bool:
    """Whether nothing was said of cameras and limits, so that those for clicked points may be taken."""
    usual = Config()
    is_usual = config.camera == usual.camera and config.verdict == usual.verdict and config.solver is None
    return is_usual and config.field.template == usual.field.template


@lru_cache(maxsize=1)
def load_annotation_options() -> Config:
    """The configuration ``annotations``: few clicks need to know where main cameras stand."""
    return load_config("annotations")
