from __future__ import annotations

import cv2
import numpy as np
import pytest

from circlecal.pictures.interlacing import measure_row_motion, remove_combs


def _scene(shift_px: float, noise: float = 0.0) -> np.ndarray:
    """A lawn with markings and players, seen ``shift_px`` columns to the right."""
    rng = np.random.default_rng(3)
    canvas = cv2.GaussianBlur(rng.normal(0, 60, (288, 400)), (0, 0), 6) + 90
    for x, y in rng.uniform((20, 20), (380, 268), (12, 2)):
        cv2.ellipse(canvas, ((x, y), (8, 26), 0), (220.0,), -1)
    cv2.line(canvas, (210, 0), (180, 288), (240.0,), 3)
    cv2.ellipse(canvas, (200, 140), (120, 45), 0, 0, 360, (240.0,), 3)
    move = np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 0.0]])
    moved = cv2.warpAffine(canvas, move, (400, 288), borderMode=cv2.BORDER_REFLECT)
    moved = cv2.GaussianBlur(moved, (0, 0), 0.8) + noise * rng.normal(0, 1, moved.shape)
    return np.clip(moved, 0, 255).astype(np.uint8)


def _woven(shift_px: float, noise: float = 0.0) -> np.ndarray:
    frame = _scene(-shift_px / 2, noise)
    frame[1::2] = _scene(shift_px / 2, noise)[1::2]
    return frame


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_one_picture_has_no_measure_row_motion(noise: float) -> None:
    assert measure_row_motion(_scene(0.0, noise)) is None


@pytest.mark.parametrize("shift_px", [-6.0, 2.5, 5.0])
def test_the_motion_between_both_halves_is_found(shift_px: float) -> None:
    motion = measure_row_motion(_woven(shift_px, 2.0))
    assert motion is not None
    middle = motion @ (200.0, 72.0, 1.0)
    assert middle - (200.0, 72.0) == pytest.approx((shift_px, 0.0), abs=0.2)


@pytest.mark.parametrize("shift_px", [-30.0, 18.0])
def test_a_fast_pan_behind_a_graphic_that_stands_still(shift_px: float) -> None:
    # broad light and shade over a lawn look alike under such motions, and the score has the sharpest edges
    frame = _woven(shift_px, 2.0)
    shade = 60.0 * np.cos(np.linspace(0.0, np.pi, frame.shape[1]))
    frame = np.clip(0.5 * frame + 60.0 + shade, 0, 255).astype(np.uint8)
    score = np.random.default_rng(1).integers(0, 2, (20, 30)) * 255
    frame[10:50, 20:80] = np.kron(score, np.ones((2, 2)))
    motion = measure_row_motion(frame)
    assert motion is not None
    middle = motion @ (200.0, 72.0, 1.0)
    assert middle - (200.0, 72.0) == pytest.approx((shift_px, 0.0), abs=0.6)


def test_a_black_border_that_stands_still_hides_no_motion_of_a_hazy_picture() -> None:
    frame = _woven(7.0, 2.0)
    frame = np.clip(0.06 * frame + 90.0, 0, 255).astype(np.uint8)
    frame[:, :10] = frame[:, -10:] = 0
    motion = measure_row_motion(frame)
    assert motion is not None
    assert (motion @ (200.0, 72.0, 1.0))[0] - 200.0 == pytest.approx(7.0, abs=0.4)


def test_the_whole_picture_shows_the_moment_between_both_halves() -> None:
    woven = _woven(5.0)
    motion = measure_row_motion(woven)
    assert motion is not None
    whole = remove_combs(np.dstack([woven] * 3), motion)[..., 1].astype(float)
    true = _scene(0.0).astype(float)
    inner = np.s_[10:-10, 20:-20]
    assert np.abs(whole - true)[inner].mean() < 0.3 * np.abs(woven - true)[inner].mean()
    assert measure_row_motion(whole.astype(np.uint8)) is None


def test_halves_with_nothing_in_common_are_left_alone() -> None:
    rng = np.random.default_rng(0)
    frame = rng.integers(0, 255, (100, 100), dtype=np.uint8)
    frame[1::2] = 0
    assert measure_row_motion(frame) is None
    assert measure_row_motion(np.zeros((100, 100), np.uint8)) is None
    assert measure_row_motion(frame[:20]) is None
