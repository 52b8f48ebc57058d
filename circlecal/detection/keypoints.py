"""Points and line ends of the field that a user's networks see in a picture; off by default."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from circlecal.detection.networks import MAPS_AXES, NetworkInput, load_network, run_network
from circlecal.errors import ConfigError
from circlecal.geometry.projective import Array

KEYPOINT_COUNT, LINE_COUNT = 57, 23
"""Heat maps without the background in PnLCalib's layout."""
MODEL_KEY, LINES_KEY = "keypoints.model", "keypoints.lines_model"

PEAK_DISTANCE = 10
"""Cells around a peak in which no second one is looked for."""


class KeypointsConfig(NetworkInput):
    """Options of the keypoint networks: heat maps in PnLCalib's layout."""

    source: Literal["none", "onnx"] = Field(
        "none", description="Whether a network looks for keypoints, which are used together with the marking."
    )
    model: str | None = Field(None, description="ONNX file of the keypoint network: 57 heat maps and the background.")
    lines_model: str | None = Field(
        None, description="ONNX file of the line network: 23 heat maps of line ends and the background; may be missing."
    )


@dataclass(frozen=True, slots=True)
class Peaks:
    """Highest places of heat maps.

    Attributes
    ----------
    points_px : (C, K, 2) array
        Per channel and rank, in pixels of the picture (``x W``: column 0 of the map is x = 0).
    confidence : (C, K) array
        Height of each.
    """

    points_px: Array
    confidence: Array


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
    points = find_peaks(image, config.model, config, MODEL_KEY, channels=KEYPOINT_COUNT, count=1)
    if config.lines_model is None:
        return points, None
    return points, find_peaks(image, config.lines_model, config, LINES_KEY, channels=LINE_COUNT, count=2)


def require_keypoint_networks(config: KeypointsConfig) -> None:
    """Load the networks, so that a run fails before its first frame; as :func:`find_keypoints`."""
    if config.source == "onnx":
        load_network(config.model, config.provider, MODEL_KEY)
        if config.lines_model is not None:
            load_network(config.lines_model, config.provider, LINES_KEY)


def find_peaks(
    image: NDArray[np.uint8], model: str | None, network: NetworkInput, key: str, *, channels: int, count: int
) -> Peaks:
    """The highest places of each heat map but the last, which is the background.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    model, network, key : str, NetworkInput, str
        As for :func:`circlecal.detection.networks.run_network`.
    channels : int
        Number of heat maps without the background.
    count : int
        Places per map.

    Raises
    ------
    ConfigError
        As :func:`circlecal.detection.networks.load_network`, or the output is not ``channels`` + 1 maps.
    """
    output = run_network(image, model, network, key)
    if output.ndim != MAPS_AXES or output.shape[1] != channels + 1:
        raise ConfigError(f"{key}: {model}: its output has the axes {list(output.shape)}; "
                          f"wanted are 1, {channels + 1}, height, width")  # fmt: skip
    maps = output[0, :-1].astype(np.float64)
    cells, confidence = _locate_peaks(maps, count)
    scale = np.array([image.shape[1] / maps.shape[2], image.shape[0] / maps.shape[1]])
    return Peaks(cells * scale, confidence)


def _locate_peaks(maps: Array, count: int) -> tuple[Array, Array]:
    """Places (C, K, 2) in cells and heights (C, K), highest first, refined to parts of a cell."""
    channels, height, width = maps.shape
    rows, columns = np.arange(height), np.arange(width)
    left = maps.copy()
    places, heights = np.empty((channels, count, 2)), np.empty((channels, count))
    for rank in range(count):
        flat = left.reshape(channels, -1).argmax(axis=1)
        y, x = np.divmod(flat, width)
        heights[:, rank] = np.maximum(left[np.arange(channels), y, x], 0.0)
        places[:, rank] = _refine_peaks(maps, x, y)
        near = (np.abs(rows - y[:, None]) <= PEAK_DISTANCE)[:, :, None]
        left[near & (np.abs(columns - x[:, None]) <= PEAK_DISTANCE)[:, None, :]] = -np.inf
    return places, heights


def _refine_peaks(maps: Array, x: NDArray[np.intp], y: NDArray[np.intp]) -> Array:
    """Tops (C, 2) of the Gaussians through a peak and its neighbours along each axis."""
    channel = np.arange(len(maps))
    logs = np.pad(np.log(np.maximum(maps, 1e-9)), ((0, 0), (1, 1), (1, 1)))
    places = []
    for step, position, size in (((0, 1), x, maps.shape[2]), ((1, 0), y, maps.shape[1])):
        inside = (position > 0) & (position < size - 1)
        before, top, after = (logs[channel, y + k * step[0] + 1, x + k * step[1] + 1] for k in (-1, 0, 1))
        curvature = before - 2 * top + after
        usable = inside & (curvature < -1e-9)
        offset = np.where(usable, 0.5 * (before - after) / np.where(usable, curvature, 1.0), 0.0)
        places.append(position + np.clip(offset, -0.5, 0.5))
    return np.stack(places, axis=-1)
