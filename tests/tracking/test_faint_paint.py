"""Lines so thin in the picture that no single place shows their paint."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.paint.bands import MeasuredCurve, measure_curve
from circlecal.tracking.faint_paint import PaintStrength, measure_faint
from circlecal.tracking.thin_paint import measure_thin

UNIT, MIDDLE, COUNT = 2 / 3, 1605.0 / 8.0 - 0.5, 96
POINTS = np.column_stack([np.linspace(20.0, 620.0, COUNT), np.full(COUNT, MIDDLE + 0.8)])
NORMALS, PIECES = np.tile([0.0, 1.0], (COUNT, 1)), np.arange(COUNT) // 24
PAINT = PaintStrength(levels_m=3.0, blur_px=2.0)
SCALE = np.full(COUNT, 2.0)


def _draw_line(levels: float) -> NDArray[np.uint8]:
    """A picture of grass before a dark run-off, with a line of an eighth of a pixel between them, under noise."""
    fine = np.full((400 * 8, 40), 104.0, np.float32)
    fine[:1585] = 90.0
    fine[1605] += levels * 2.0 * 8
    rows = cv2.GaussianBlur(fine, (0, 0), sigmaX=1.0, sigmaY=7.0).reshape(400, 8, 40).mean(axis=1)[:, :1]
    noise = np.random.default_rng(1).normal(0.0, 2.5, (400, 640))
    return np.clip(rows + noise, 0, 255).astype(np.uint8)


def _measure(picture: NDArray[np.uint8]) -> tuple[MeasuredCurve, MeasuredCurve]:
    """The line's paint by single places, and along its pieces."""
    reach = np.full(COUNT, 7.0)
    found = measure_curve(picture, POINTS, NORMALS, reach, PIECES)
    found = measure_thin(picture, found, np.ones(COUNT, np.bool_), PIECES, UNIT)
    height, width = PAINT.ridges(SCALE, 0.08 * SCALE)
    return found, measure_faint(picture, found, ~found.supported, PIECES, height, width, reach, UNIT)


def test_a_line_of_an_eighth_of_a_pixel_is_measured_along_its_length() -> None:
    alone, found = _measure(_draw_line(3.0))
    assert alone.supported.mean() < 0.3
    assert found.supported.mean() > 0.9
    off = POINTS[:, 1] + found.offset - MIDDLE
    assert np.abs(off[found.supported & ~alone.supported]).max() < 0.6


@pytest.mark.parametrize("levels", [0.0, 25.0])
def test_what_is_no_line_of_this_paint_is_not_measured(levels: float) -> None:
    picture = _draw_line(levels)
    nothing = measure_curve(picture, POINTS, NORMALS, np.full(COUNT, 7.0), PIECES)
    nothing.supported[:] = False
    height, width = PAINT.ridges(SCALE, 0.08 * SCALE)
    found = measure_faint(picture, nothing, ~nothing.supported, PIECES, height, width, np.full(COUNT, 7.0), UNIT)
    assert not found.supported.any()


def test_clear_markings_tell_the_strength_of_the_paint() -> None:
    scale = np.array([30.0] * 20 + [4.0] * 10)
    paint_px = 0.1 * scale
    contrast, width = PaintStrength(5.0, 2.0).ridges(scale, paint_px)
    told = PaintStrength.of(contrast, width, scale, scale > 10.0)
    assert told is not None
    assert told.levels_m == pytest.approx(5.0)
    assert told.blur_px == pytest.approx(2.04, abs=0.03)
    assert PaintStrength.of(contrast, width, scale, scale > 100.0) is None
