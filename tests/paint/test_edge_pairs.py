"""The middle of wide paint by its two edges."""

import numpy as np

from circlecal.paint.bands import measure_bands
from circlecal.paint.edge_pairs import measure_edge_pairs
from circlecal.paint.profiles import sample_profiles

MIDDLE, WIDTH = 60.3, 24.0
PLACES = np.stack([np.linspace(20.0, 280.0, 131), np.full(131, 60.0)], axis=-1)
DOWN = np.tile([0.0, 1.0], (131, 1))


def worn_band(shade=0.0, seed=3):
    """Paint along the rows whose lower half is worn to a third, and a shadow that ends within it."""
    rows = np.mgrid[0:120, 0:300][0].astype(np.float64)
    share = np.clip(WIDTH / 2 - np.abs(rows - MIDDLE) + 0.5, 0.0, 1.0)
    worn = np.where(rows > MIDDLE, 0.35, 1.0)
    picture = 60.0 + 80.0 * share * worn - shade * (rows > MIDDLE + 4.0)
    picture[:, 140:160] = 30.0  # a leg
    return (picture + np.random.default_rng(seed).normal(0.0, 2.0, picture.shape)).clip(0, 255).astype(np.uint8)


def measured(picture):
    return measure_edge_pairs(picture, PLACES, DOWN, np.full(131, WIDTH), 12.0)


def test_paint_that_is_worn_on_one_side_lies_between_its_edges():
    picture = worn_band()
    offset, found = measured(picture)
    clear = np.abs(PLACES[:, 0] - 150.0) > 20.0
    assert found[clear].mean() > 0.95
    assert abs(np.median(offset[found & clear]) - 0.3) < 0.15
    offsets = np.arange(-30.0, 30.25, 0.5)
    by_flux = measure_bands(sample_profiles(picture, PLACES[clear], DOWN[clear], offsets), offsets, 12.0).center
    assert np.median(by_flux) < -3.0


def test_a_shadow_within_the_paint_does_not_move_it():
    offset, found = measured(worn_band(shade=15.0))
    assert abs(np.median(offset[found]) - 0.3) < 0.3


def test_bare_ground_and_a_single_step_hold_no_paint():
    rng = np.random.default_rng(1)
    bare = rng.normal(80.0, 3.0, (120, 300)).clip(0, 255).astype(np.uint8)
    assert measured(bare)[1].mean() < 0.3
    step = (80.0 + 60.0 * (np.mgrid[0:120, 0:300][0] > 60) + rng.normal(0, 2.0, (120, 300))).astype(np.uint8)
    assert measured(step)[1].mean() < 0.3
