"""Finding a known camera again in one picture, of square pixels and of others."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.detection.options import RidgeConfig
from circlecal.rig.tripod import PLACE
from circlecal.tracking.markings import template_curves
from circlecal.tracking.search import GridViews, map_ridges, search_heads

from . import scenes


@pytest.mark.parametrize("columns", [1280, 960])
def test_a_head_is_found_in_pictures_of_any_pixels(columns):
    """A picture that is stored with fewer columns has pixels that are wider than tall."""
    drawn = scenes.draw(scenes.HEAD, np.random.default_rng(1))
    picture = cv2.resize(drawn, (columns, 720), interpolation=cv2.INTER_AREA)
    square = scenes.tripod()
    mean, shift = square.mean.copy(), np.log(columns / 1280)
    mean[PLACE["log_aspect"]] = -shift
    low, high = (head + np.array([shift, 0.0, 0.0]) for head in (square.head_low, square.head_high))
    tripod = replace(
        square, size=(columns, 720), log_focal=square.log_focal + shift, mean=mean, head_low=low, head_high=high
    )
    template = scenes.template()
    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    ridges = map_ridges(gray, np.full((90, 160), 255, np.uint8), RidgeConfig())
    best = search_heads(ridges, GridViews.of(tripod, template_curves(template), template))[0]
    away = np.abs(best - (scenes.HEAD + np.array([shift, 0.0, 0.0])))
    assert away[0] < 0.02 and away[1:].max() * np.exp(best[0]) < 6.0 * ridges.factor
