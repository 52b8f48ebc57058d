"""Width of the paint from how broad it looks, and how far a middle may be off where it looks too broad."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from circlecal.field import load_field
from circlecal.tracking.markings import template_curves
from circlecal.tracking.paint_width import estimate_paint_width, half_peak_width
from circlecal.tracking.seen_paint import MeasuredFrame, _bias_sigmas

SOCCER, RINK = template_curves(load_field("soccer")), template_curves(load_field("ice-hockey-nhl"))


def frame(scale: np.ndarray, width_px: np.ndarray) -> MeasuredFrame:
    count = len(scale)
    points, none = np.zeros((count, 2)), np.zeros(0, dtype=np.int_)
    return MeasuredFrame(
        np.zeros(count, dtype=np.int_), points, points, points, width_px, scale, np.zeros(count), none, none
    )


@pytest.mark.parametrize("width_px", [0.5, 1.5, 4.0])
def test_half_peak_width_is_that_of_a_blurred_band(width_px: float) -> None:
    step, blur = 0.01, 0.8
    across = np.arange(-8.0, 8.0, step)
    profile = gaussian_filter1d((np.abs(across) < width_px / 2) * 1.0, blur / step)
    assert half_peak_width(np.array([width_px]), blur)[0] == pytest.approx(
        step * np.count_nonzero(profile > profile.max() / 2), abs=0.03
    )


def test_the_width_is_found_under_an_unknown_blur_and_beside_other_things() -> None:
    rng = np.random.default_rng(1)
    scale = rng.uniform(3.0, 30.0, 600)
    seen = half_peak_width(0.102 * scale, 0.85) + rng.normal(0.0, 0.1, 600)
    seen[rng.random(600) < 0.25] += 1.5
    found = estimate_paint_width([frame(scale, seen)], 0.12, SOCCER)
    assert found is not None
    assert found[0] == pytest.approx(0.102, abs=0.003)
    assert found[1] >= 0.005


def test_paint_narrower_than_the_blur_says_nothing_of_its_width() -> None:
    scale = np.full(600, 4.0)
    assert estimate_paint_width([frame(scale, half_peak_width(0.12 * scale, 0.85))], 0.12, SOCCER) is None
    assert estimate_paint_width([], 0.12, SOCCER) is None


def test_lines_with_a_width_of_their_own_say_nothing_of_the_others() -> None:
    rng = np.random.default_rng(2)
    scale = rng.uniform(20.0, 60.0, 900)
    marking = rng.choice(
        [RINK.names.index(name) for name in ("blue_line_left", "centre_circle", "goal_line_left")], 900
    )
    seen = half_peak_width(RINK.widths_m(marking, 0.055) * scale, 1.2) + rng.normal(0.0, 0.1, 900)
    found = estimate_paint_width([replace(frame(scale, seen), marking=marking)], 0.05, RINK)
    assert found is not None
    assert found[0] == pytest.approx(0.055, abs=0.004)


def test_a_middle_may_be_off_where_paint_looks_broader_than_elsewhere() -> None:
    paint = np.full(50, 1.0)
    seen = np.hypot(paint, 2.0)
    moved = np.zeros(50)
    seen[:5], moved[:5] = np.hypot(seen[:5], 4.0), 4.0
    seen[5:7] = np.hypot(1.0, [2.5, 5.0])
    sigmas = _bias_sigmas(seen, paint, moved)
    assert sigmas[:5] == pytest.approx(0.0, abs=1e-9)
    assert sigmas[7:] == pytest.approx(0.0, abs=1e-9)
    assert sigmas[5:7] == pytest.approx([0.15, 0.9])
