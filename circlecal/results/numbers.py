"""Numbers with their standard deviations, as people read them."""

from __future__ import annotations

import math

_MOST_DECIMALS = 6
"""A smaller standard deviation is told as 0: none of what is estimated is known to a millionth of its unit."""


def show_with_sigma(mean: float, sd: float, sign: str = "+-") -> str:
    """A value and its standard deviation, which has two figures; both have as many decimals.

    What rounds to nothing has no sign.

    Examples
    --------
    >>> show_with_sigma(105.26, 0.2123), show_with_sigma(105.0, 1.04), show_with_sigma(1995.3, 132.0)
    ('105.26 +- 0.21', '105.0 +- 1.0', '1995 +- 132')
    >>> show_with_sigma(-0.02, 1.3)
    '0.0 +- 1.3'
    """
    if not (math.isfinite(sd) and round(sd, _MOST_DECIMALS) > 0):
        return f"{mean:z.2f} {sign} {sd:.0f}"
    exponent = int(f"{sd:.1e}".partition("e")[2])  # of the rounded one: 0.0996 has the two figures of 0.10
    decimals = min(max(1 - exponent, 0), _MOST_DECIMALS)
    return f"{mean:z.{decimals}f} {sign} {sd:.{decimals}f}"
