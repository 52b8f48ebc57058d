"""Stage ``keypoints``: points and line ends of the field that a user's networks see in a picture; off by default."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from circlecal.detection.networks import NetworkInput, Peaks, heat_map_peaks, load_network

KEYPOINT_COUNT, LINE_COUNT = 57, 23
"""Heat maps without the background in PnLCalib's layout."""
MODEL_KEY, LINES_KEY = "keypoints.model", "keypoints.lines_model"


class KeypointsConfig(NetworkInput):
    """Options of the stage ``keypoints``: heat maps in PnLCalib's layout."""

    source: Literal["none", "onnx"] = Field(
        "none", description="Whether a network looks for keypoints, which are used together with the marking."
    )
    model: str | None = Field(None, description="ONNX file of the keypoint network: 57 heat maps and the background.")
    lines_model: str | None = Field(
        None, description="ONNX file of the line network: 23 heat maps of line ends and the background; may be missing."
    )


def find_keypoints(image: NDArray[np.uint8], config: KeypointsConfig) -> tuple[Peaks, Peaks | None] | None:
    """Peaks of the 57 keypoints and, with a line network, of the two ends of 23 lines; None without a network.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    config : KeypointsConfig
        Model files and their layout.

    Raises
    ------
    ConfigError, MissingExtraError
        As :func:`circlecal.detection.networks.load_network`.
    """
    if config.source == "none":
        return None
    points = heat_map_peaks(image, config.model, config, MODEL_KEY, channels=KEYPOINT_COUNT, count=1)
    if config.lines_model is None:
        return points, None
    return points, heat_map_peaks(image, config.lines_model, config, LINES_KEY, channels=LINE_COUNT, count=2)


def require_keypoint_networks(config: KeypointsConfig) -> None:
    """Load the networks, so that a run fails before its first frame; as :func:`find_keypoints`."""
    if config.source == "onnx":
        load_network(config.model, config.provider, MODEL_KEY)
        if config.lines_model is not None:
            load_network(config.lines_model, config.provider, LINES_KEY)
