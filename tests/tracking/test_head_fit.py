"""How far the paint of one frame is off its markings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.tracking.frame_paint import number_parts
from circlecal.tracking.head_fit import HeadFit, LinearPaint, fit_head
from circlecal.tracking.markings import template_curves
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
        start = LinearPaint.of(moved, HEAD, tripod(), template_curves(template()))
        spread += fit_head(moved, start, PRIOR, tripod(), template_curves(template())).spread
    return float(spread[0] / spread[1])


def test_paint_that_is_better_than_it_says_tells_so() -> None:
    clean, noisy = _spread(0.05, 0.0), _spread(0.1, 0.0)
    assert clean < 0.1
    # four times as much, of which a part is told by the noise of neighbours
    assert 2.5 * clean < noisy < 4.0 * clean


def test_what_parts_of_the_field_are_off_alike_counts_with_all_their_places() -> None:
    noise, alike = _spread(0.1, 0.0), _spread(0.1, 0.1)
    assert alike > 3.0 * noise


def test_a_head_is_found_from_far_beside_it_as_from_near() -> None:
    rng, drawn = np.random.default_rng(9), template_curves(template())
    measured, free = measure_ideal(HEAD, np.zeros(2), 0.1, rng), np.eye(3) * 1e-3
    near, far = (
        fit_head(measured, LinearPaint.of(measured, HEAD + away, tripod(), drawn), free, tripod(), drawn)
        for away in (np.zeros(3), np.array([0.01, 0.006, -0.004]))
    )
    # 0.006 are 9 px, where a turn of the camera is no longer linear by far more than this
    assert np.abs((far.head - near.head) * [640.0, 1500.0, 1500.0]).max() < 0.01
    assert far.inlier_share > 0.98
    np.testing.assert_allclose(far.information, near.information, rtol=0.02)


def test_a_head_that_is_known_as_well_as_its_paint_tells_it_lies_half_way_between() -> None:
    drawn, away = template_curves(template()), np.array([2e-4, 1e-4, -1e-4])
    measured = measure_ideal(HEAD, np.zeros(2), 0.05, np.random.default_rng(9))

    def fit(prior: np.ndarray, start: np.ndarray) -> HeadFit:
        return fit_head(measured, LinearPaint.of(measured, start, tripod(), drawn), prior, tripod(), drawn)

    alone = fit(np.zeros((3, 3)), HEAD)
    both = fit(alone.information, alone.head + away)
    np.testing.assert_allclose(both.head - alone.head, away / 2.0, rtol=0.05)


def test_a_fitted_head_follows_what_is_shared_as_it_was_followed_before() -> None:
    """By the share of its information that was known before."""
    rng, drawn, camera = np.random.default_rng(9), template_curves(template()), tripod()
    measured, prior = measure_ideal(HEAD, np.zeros(2), 0.1, rng), np.diag([3e6, 1e6, 2e6])
    start = LinearPaint.of(measured, HEAD, camera, drawn)
    before = rng.normal(size=(3, len(camera.mean)))
    without = fit_head(measured, start, prior, camera, drawn)
    found = fit_head(measured, start, prior, camera, drawn, before)
    share = np.linalg.solve(found.information + prior, prior)
    np.testing.assert_allclose(found.by_common - without.by_common, share @ before, rtol=1e-6, atol=1e-9)
    assert np.abs(share).max() > 0.01
