"""How far the paint of one frame is off its markings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.tracking.head_fit import fit_head
from circlecal.tracking.markings import template_curves
from circlecal.tracking.tripod_fit import number_parts
from tests.tracking.scenes import HEAD, measure_ideal, template, tripod

PRIOR = np.eye(3) * 1e2


def _spread(noise_px: float, alike_px: float) -> float:
    """Share of its own variance that the paint of frames has, with noise and with what parts of the field are off."""
    rng = np.random.default_rng(4)
    spread = np.zeros(2)
    for _ in range(30):
        measured = measure_ideal(HEAD, np.zeros(2), noise_px, rng)
        part = np.unique(number_parts(measured), return_inverse=True)[1]
        off = rng.normal(0.0, alike_px, part.max() + 1)[part] if alike_px else np.zeros(len(part))
        moved = replace(measured, points_px=measured.points_px + off[:, None] * measured.normals)
        spread += fit_head(moved, HEAD, PRIOR, tripod(), template_curves(template())).spread
    return float(spread[0] / spread[1])


def test_paint_that_is_better_than_it_says_tells_so() -> None:
    clean, noisy = _spread(0.05, 0.0), _spread(0.1, 0.0)
    assert clean < 0.1
    # four times as much, of which a part is told by the noise of neighbours
    assert 2.5 * clean < noisy < 4.0 * clean


def test_what_parts_of_the_field_are_off_alike_counts_with_all_their_places() -> None:
    noise, alike = _spread(0.1, 0.0), _spread(0.1, 0.1)
    assert alike > 3.0 * noise
