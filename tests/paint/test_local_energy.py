"""Lines and edges as light bands."""

import numpy as np
import pytest

from circlecal.paint.local_energy import local_energy


def profile(image):
    """One row across what is upright."""
    return local_energy(image)[20].astype(float)


@pytest.mark.parametrize("level", [60, 140, 220])
def test_a_step_is_one_band_at_its_place(level):
    image = np.full((41, 81, 3), 100, np.uint8)
    image[:, 40:] = level
    row = profile(image)
    assert abs(row[32:48] @ np.arange(32, 48) / row[32:48].sum() - 39.5) < 0.02
    assert np.count_nonzero((row[1:-1] > row[:-2]) & (row[1:-1] >= row[2:])) == 1
    assert row.max() == pytest.approx(abs(level - 100), rel=0.15)


@pytest.mark.parametrize("ink", [(180, 180, 180), (20, 20, 20), (100, 100, 190)])
def test_a_thin_line_is_one_band_in_its_middle(ink):
    image = np.full((41, 81, 3), 100, np.uint8)
    image[:, 39:42] = ink
    row = profile(image)
    assert row[40] > 0.8 * row.max()
    assert abs(row[30:51] @ np.arange(30, 51) / row[30:51].sum() - 40.0) < 0.02


def test_even_ground_shows_nothing():
    assert not local_energy(np.full((41, 81, 3), 130, np.uint8)).any()
