"""Values with their standard deviations, as people read them."""

import math

import pytest

from circlecal.results.numbers import show_with_sigma


@pytest.mark.parametrize(
    ("mean", "sd", "told"),
    [
        (105.2617, 0.2123, "105.26 +- 0.21"),
        (105.0, 1.04, "105.0 +- 1.0"),
        (105.0, 0.0996, "105.00 +- 0.10"),
        (1995.31, 132.2, "1995 +- 132"),
        (1995.31, 99.7, "1995 +- 100"),
        (0.00512, 0.00093, "0.00512 +- 0.00093"),
        (105.0, 0.0, "105.00 +- 0"),
        (105.0, 1e-9, "105.00 +- 0"),
        (105.0, math.inf, "105.00 +- inf"),
        (-0.02, 1.3, "0.0 +- 1.3"),
        (-0.001, 0.0, "0.00 +- 0"),
    ],
)
def test_a_value_has_as_many_decimals_as_the_two_figures_of_its_sigma(mean, sd, told):
    assert show_with_sigma(mean, sd) == told
    assert show_with_sigma(mean, sd, "±") == told.replace("+-", "±")
