"""What a user's keypoint network sees in a picture, as observations: PnLCalib's layout, sub-pixel."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from circlecal.config import SourcesConfig
from circlecal.detection.keypoints import KeypointsConfig, find_keypoints
from circlecal.field import FieldTemplate
from circlecal.formats.meaning import observe
from circlecal.formats.pnlcalib import LABEL
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.formats.soccernet import LINE_CLASSES
from circlecal.observations import Observations

_log = logging.getLogger(__name__)


def network_keypoints(
    image: NDArray[np.uint8], config: KeypointsConfig, template: FieldTemplate, sources: SourcesConfig
) -> Observations | None:
    """Keypoints and lines that the networks of a configuration find in a picture; None where there are no networks.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    config : KeypointsConfig
        Model files and their layout.
    template, sources : FieldTemplate, SourcesConfig
        As for :func:`circlecal.formats.meaning.observe`; the sources hold the least confidence.

    Raises
    ------
    ConfigError
        A network is missing or unusable.
    InputError
        The template is no soccer pitch.
    """
    found = find_keypoints(image, config)
    if found is None:
        return None
    points, ends = found
    shapes = [
        Shape(f"{LABEL}{number}", "points", place, _capped(confidence))
        for number, (place, confidence) in enumerate(zip(points.points_px, points.confidence, strict=True), start=1)
    ]
    if ends is not None:
        shapes += [
            Shape(name, "line", place, _capped(confidence))
            for name, place, confidence in zip(LINE_CLASSES, ends.points_px, ends.confidence, strict=True)
        ]
    height, width = image.shape[:2]
    frame = AnnotatedFrame("network", width, height, tuple(shapes), None)
    observed = observe(frame, template, sources, "pnlcalib", str(config.model))
    for warning in observed.warnings:
        _log.debug("%s", warning)
    return observed.observations


def _capped(confidence: NDArray[np.float64]) -> tuple[float, ...]:
    """Heights as confidences; below 1, which in keypoint files marks what was computed from lines."""
    return tuple(np.clip(confidence, 0.0, 0.9999).tolist())
