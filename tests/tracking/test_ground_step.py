"""Thin paint between two grounds of different brightness."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.geometry.projective import Array
from circlecal.paint.bands import measure_curve
from circlecal.tracking.ground_step import find_middles
from circlecal.tracking.thin_paint import measure_thin

FINE = 8
"""Rows of the drawing per pixel."""
MIDDLE_PX = 200.25
PIECES = np.arange(100) // 24


def _draw(before: float, beyond: float, step_px: float) -> NDArray[np.uint8]:
    """A line 0.75 px broad upon two grounds that meet so far below its middle, under a blur, with noise."""
    fine = np.full((400 * FINE, 40), before, np.float32)
    fine[round((MIDDLE_PX + 0.5 + step_px) * FINE) :] = beyond
    first = round((MIDDLE_PX + 0.5 - 0.375) * FINE)
    fine[first : first + 6] = 160.0
    rows = cv2.GaussianBlur(fine, (0, 0), sigmaX=1.0, sigmaY=FINE * 1.0).reshape(400, FINE, 40).mean(axis=1)[:, :1]
    noise = np.random.default_rng(1).normal(0.0, 1.0, (400, 640))
    return np.clip(rows + noise, 0, 255).astype(np.uint8)


def _curve(off_px: float = 0.0) -> tuple[Array, Array]:
    points = np.column_stack([np.arange(20.0, 620.0, 6.0), np.full(100, MIDDLE_PX + off_px)])
    return points, np.tile([0.0, 1.0], (100, 1))


@pytest.mark.parametrize("levels", [(100.0, 92.0), (92.0, 100.0)])
def test_a_line_between_two_grounds_is_not_drawn_to_the_brighter_one(levels: tuple[float, float]) -> None:
    picture = _draw(*levels, 0.0)
    points, normals = _curve(0.4)
    found = measure_curve(picture, points, normals, np.full(100, 6.0), PIECES)
    again = measure_thin(picture, found, np.ones(100, np.bool_), PIECES, 2 / 3)
    off = points[:, 1] + again.offset - MIDDLE_PX
    assert again.supported.sum() > 90
    assert abs(float(np.median(off[again.supported]))) < 0.05


@pytest.mark.parametrize("off_px", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize("step_px", [-2.5, 0.0, 2.5])
def test_the_step_may_lie_under_the_line_or_beside_it(off_px: float, step_px: float) -> None:
    points, normals = _curve(off_px)
    away = find_middles(_draw(100.0, 92.0, step_px), points, normals, PIECES, 2 / 3)
    np.testing.assert_allclose(away[:96], -off_px, atol=0.12)
    assert (away[96:] == 0.0).all()  # a piece of four places is too short to tell


def test_without_a_step_the_paint_stays_where_it_was_found() -> None:
    points, normals = _curve(0.3)
    assert (find_middles(_draw(90.0, 90.0, 0.0), points, normals, PIECES, 2 / 3) == 0.0).all()
    assert find_middles(_draw(90.0, 90.0, 0.0), points[:0], normals[:0], PIECES[:0], 2 / 3).shape == (0,)
