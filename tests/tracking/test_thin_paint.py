"""Thin paint beside which the ground changes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from circlecal.paint.bands import measure_curve
from circlecal.tracking.thin_paint import measure_thin


@pytest.mark.parametrize("reach_px", [7.0, 7.5])
def test_a_dark_run_off_behind_a_line_does_not_move_it(reach_px: float) -> None:
    fine = np.full((400 * 8, 40), 120.0, np.float32)
    fine[: 196 * 8] = 84.0
    # 0.4 px of paint, 4.5 px before the run-off
    fine[1604:1607] += 160.0
    rows = cv2.GaussianBlur(fine, (0, 0), sigmaX=1.0, sigmaY=7.0).reshape(400, 8, 40).mean(axis=1)[:, :1]
    noise = np.random.default_rng(1).normal(0.0, 1.5, (400, 640))
    picture = np.clip(rows + noise, 0, 255).astype(np.uint8)
    middle = 1605.5 / 8.0 - 0.5
    points = np.column_stack([np.arange(20.0, 620.0, 6.0), np.full(100, middle + 0.8)])
    pieces = np.arange(100) // 24
    found = measure_curve(picture, points, np.tile([0.0, 1.0], (100, 1)), np.full(100, reach_px), pieces)
    again = measure_thin(picture, found, np.ones(100, np.bool_), pieces, 2 / 3)
    off = points[:, 1] + again.offset - middle
    assert found.supported.sum() > 90
    assert abs(float(np.median(off[again.supported]))) < 0.1
    first = points[:, 1] + found.offset - middle
    assert abs(float(np.median(first[found.supported]))) > 0.15
    untouched = measure_thin(picture, found, np.zeros(100, np.bool_), pieces, 2 / 3)
    np.testing.assert_array_equal(untouched.offset, found.offset)
