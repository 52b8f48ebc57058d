"""Two bands of paint, their derivatives, and where an old coat is foretold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from circlecal.geometry.least_squares import StoppingRule, minimise
from circlecal.paint.coat_bands import CoatBands, CoatProfiles, draw_old_band, exchange_bands, harmonics
from circlecal.paint.coat_places import find_pairs, foretell_coats

WIDTH_M = 0.12
ANGLE = 2.0 * np.pi * (np.arange(30) + 0.5) / 30
SCALE = 20.0 + 8.0 * np.cos(ANGLE)


def make_profiles(strength, coat=(0.06, -0.08, 0.16), noise=1.0):
    """Profiles of a circle with an old coat of a growth and shift, whose light is 60 gray levels."""
    offset_px = (0.52 * SCALE + 4.0)[:, None] * np.linspace(-1.0, 1.0, 35)
    beside = (harmonics(ANGLE, 1) @ np.array(coat) * SCALE)[:, None]
    width = (WIDTH_M * SCALE)[:, None]
    new = ndtr((offset_px + 0.5 * width) / 0.9) - ndtr((offset_px - 0.5 * width) / 0.9)
    light = new + strength * draw_old_band(offset_px, width, width, beside, 0.9)
    level = 90.0 + 60.0 * light + np.random.default_rng(1).normal(0.0, noise, light.shape)
    turn = np.stack([np.cos(ANGLE) ** 2, np.sin(ANGLE) ** 2], axis=-1)
    return CoatProfiles(ANGLE, SCALE, offset_px, level, turn, noise)


def foretell(profiles):
    one = CoatBands(profiles, WIDTH_M, has_old=False)
    alone = minimise(one, one.evaluate(one.expected[None]), StoppingRule(1e-3, unit=np.inf, iterations=3)).state
    return foretell_coats(profiles, one, alone)


@pytest.mark.parametrize("has_old", [False, True])
def test_derivatives_are_those_of_the_residuals(has_old):
    bands = CoatBands(make_profiles(0.3), WIDTH_M, has_old=has_old)
    parameters = np.random.default_rng(0).normal(0.0, 0.05, (2, len(bands.expected)))
    _, slope = bands.linearise(parameters)
    for k, step in enumerate(1e-4 * np.eye(len(bands.expected))):
        apart = bands.linearise(parameters + step)[0] - bands.linearise(parameters - step)[0]
        assert np.abs(apart / 2e-4 - slope[:, k]).max() < 2e-3 * np.abs(slope[:, k]).max()


def test_a_hint_is_what_a_faint_coat_changes():
    one, two = (CoatBands(make_profiles(0.3), WIDTH_M, has_old=has_old) for has_old in (False, True))
    alone = one.expected
    faint = np.concatenate([alone, [np.log(0.001 / 0.3), 0.0, 0.1, 0.0, 0.0]])
    change = (two.linearise(faint[None])[0][0] - one.linearise(alone[None])[0][0]) / 0.001
    # the light is fitted anew: what it does there is small to first order
    off = change - one.hint(alone, np.array([0.1]))[0]
    assert np.abs(off).mean() < 0.15 * np.abs(change).mean()


def test_exchanged_bands_lie_at_each_others_place():
    two = CoatBands(make_profiles(0.3), WIDTH_M, has_old=True)
    parameters = np.random.default_rng(3).normal(0.0, 0.1, (1, len(two.expected)))
    before, after = (two.read(p) for p in (parameters, exchange_bands(parameters)))
    assert after.place == pytest.approx(before.place + before.beside)
    assert after.place + after.beside == pytest.approx(before.place)
    assert after.strength == pytest.approx(1.0 / before.strength)


def test_what_the_new_paint_covers_is_hidden():
    x = np.linspace(-6.0, 6.0, 49)
    assert draw_old_band(x, 3.0, 3.0, 0.0, 0.8) == pytest.approx(
        0.2 * draw_old_band(x - 20.0, 3.0, 3.0, -20.0, 0.8), abs=1e-4
    )


@pytest.mark.parametrize("strength", [0.2, 0.5])
def test_a_coat_is_foretold_near_its_place(strength):
    places = foretell(make_profiles(strength))
    assert len(places) == 3
    assert np.linalg.norm(places[0] - (0.06, -0.08, 0.16)) < 0.12


def test_of_paint_without_a_coat_none_is_foretold():
    assert len(foretell(make_profiles(0.0))) == 0


def test_misfit_all_round_that_is_no_circle_is_none():
    profiles = make_profiles(0.0)
    profiles.level[...] += 1.5 * np.sin(profiles.offset_px * 0.9)
    assert len(foretell(profiles)) == 0


def test_pairs_are_both_circles_wherever_the_camera_lies_between_them():
    coat = np.array([0.0, -0.16, 0.16])
    profiles = make_profiles(1.0, coat=coat)
    away = harmonics(ANGLE, 1) @ coat * SCALE
    between = replace(profiles, offset_px=profiles.offset_px - 0.5 * away[:, None])
    pairs = find_pairs(between, CoatBands(between, WIDTH_M, has_old=False))
    assert 0 < len(pairs) <= 6
    expected = np.concatenate([-0.5 * coat, coat])
    off = [np.abs(pairs[0] - sign * expected).max() for sign in (1.0, -1.0)]
    assert min(off) < 0.09  # the grid is 0.08 m wide
