"""Frames of several cameras that are known: each is tried as one camera's after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from circlecal.camera.options import KnownCamera
from circlecal.config import Config
from circlecal.results import FrameCalibration


def calibrate_by_cameras(config: Config, calibrate: Callable[[Config], FrameCalibration]) -> FrameCalibration:
    """The answer of a frame as that of the first known camera that explains it; refused as the first camera's where
    none does.

    Parameters
    ----------
    config : Config
        Options, with what is known of each camera.
    calibrate : callable
        Calibrates the frame under a configuration with one camera.
    """
    first = replace(calibrate(config), camera_name=config.camera.name)
    if first.status == "calibrated":
        return first
    for other in config.camera.others:
        found = calibrate(_for_camera(config, other))
        if found.status == "calibrated":
            return replace(found, camera_name=other.name, config_digest=first.config_digest)
    return replace(first, camera_name=None)


def _for_camera(config: Config, known: KnownCamera) -> Config:
    """The configuration for a frame of one of the further cameras."""
    told = {name: getattr(known, name) for name in ("name", "position_m", "position_sd_m", "shared", "crown_shape")}
    camera = config.camera.model_copy(update={**told, "others": ()})
    sides = config.correspondences.model_copy(update={"camera_side": known.camera_side})
    return config.model_copy(update={"camera": camera, "correspondences": sides})
