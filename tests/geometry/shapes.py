"""Ellipses for property tests."""

import numpy as np
from hypothesis import strategies as st

from circlecal.geometry.ellipses import Ellipse


@st.composite
def ellipses(draw, smallest_ratio=0.05):
    """Ellipses as a frame of up to 4K may show them."""
    major = draw(st.floats(20.0, 2000.0))
    ratio = draw(st.floats(smallest_ratio, 1.0))
    center = np.array([draw(st.floats(-500.0, 4000.0)), draw(st.floats(-500.0, 2500.0))])
    return Ellipse(center, (major, major * ratio), draw(st.floats(0.0, np.pi)))
