"""Medians without the checks of numpy's own."""

import numpy as np
import pytest

from circlecal.geometry.medians import median_of_rows, quantile, upper_median


@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (8, 3), (9, 2, 2)])
def test_medians_are_those_of_numpy(shape):
    rows = np.random.default_rng(1).normal(size=shape)
    np.testing.assert_array_equal(median_of_rows(rows), np.median(rows, axis=0))


def test_of_nothing_there_is_no_median():
    assert np.isnan(median_of_rows(np.zeros(0)))
    assert np.isnan(median_of_rows(np.zeros((0, 3)))).tolist() == [True] * 3


def test_the_upper_median_is_one_of_the_values():
    assert upper_median(np.array([4.0, 1.0, 3.0, 2.0])) == 3.0
    assert upper_median(np.array([4.0, 1.0, 3.0])) == 3.0


@pytest.mark.parametrize("count", [1, 2, 7, 30])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.84, 1.0])
def test_quantiles_are_those_of_numpy(count, share):
    values = np.random.default_rng(2).normal(size=count)
    assert quantile(values, share) == pytest.approx(np.quantile(values, share), rel=1e-13)
