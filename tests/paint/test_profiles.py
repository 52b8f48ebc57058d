"""Where the middle and the edges of a thin band are, from its brightness profile."""

import cv2
import numpy as np
import pytest
from scipy.special import erf

from circlecal.paint.profiles import (
    SIGMA_FLOOR_PX,
    measure_bands,
    picture_noise,
    sample_profiles,
    smooth_along,
    to_gray,
)

OFFSETS = np.arange(-14.0, 14.25, 0.5)


def band(center, width, blur, contrast=100.0, background=80.0, tilt=0.0, offsets=OFFSETS):
    """Exact profile (S,) of a band of some width, as a pixel with Gaussian blur sees it."""
    spread = np.sqrt(2) * blur
    inside = 0.5 * (erf((offsets - center + width / 2) / spread) - erf((offsets - center - width / 2) / spread))
    return background + tilt * offsets + contrast * inside


def picture_of(center_y, width, blur, noise=0.0, seed=0, size=(200, 60)):
    """Picture (H, W) float32 of a horizontal band about ``y = center_y``."""
    columns, rows = size
    profile = band(center_y, width, blur, offsets=np.arange(rows, dtype=float))
    picture = np.repeat(profile[:, None], columns, axis=1)
    return (picture + np.random.default_rng(seed).normal(0, noise, picture.shape)).astype(np.float32)


def across(picture, y, count=100):
    """Profiles down through the band about row ``y``."""
    points = np.stack([np.linspace(40.0, 160.0, count), np.full(count, y)], axis=-1)
    return sample_profiles(picture, points, np.broadcast_to([0.0, 1.0], points.shape), OFFSETS)


@pytest.mark.parametrize("width", [0.8, 1.5, 3.0, 6.0])
@pytest.mark.parametrize("blur", [0.8, 1.3, 2.0])
def test_middle_of_a_band_is_unbiased(width, blur):
    shifts = np.linspace(-1.9, 2.05, 80)
    bands = measure_bands(np.array([band(s, width, blur) for s in shifts]), OFFSETS, 6.0, 1.0)
    assert bands.valid.all()
    error = bands.center - shifts
    # the samples leave a ripple of the period of their spacing
    assert np.abs(error).max() < 0.03
    assert np.abs(error[:40].mean()) < 0.003
    assert np.sqrt(np.mean(error**2)) < 0.02
    np.testing.assert_allclose(0.5 * (bands.left + bands.right), shifts, atol=0.05)


def test_middle_is_unbiased_through_a_picture():
    shifts = np.linspace(-0.45, 0.55, 21)
    measured = [measure_bands(across(picture_of(30.0 + s, 3.0, 1.0, 0.0), 30.0), OFFSETS, 6.0, 1.0) for s in shifts]
    error = np.array([bands.center.mean() for bands in measured]) - shifts
    assert np.abs(error).max() < 0.03
    assert abs(error.mean()) < 0.005


@pytest.mark.parametrize("tilt", [-1.0, 1.0])
def test_a_sloping_background_hardly_pulls(tilt):
    bands = measure_bands(band(0.3, 3.0, 1.0, tilt=tilt)[None], OFFSETS, 6.0, 1.0)
    assert bands.valid.all()
    assert abs(bands.center[0] - 0.3) < 0.05
    assert np.sign(bands.step[0]) == tilt


def test_width_and_contrast():
    bands = measure_bands(band(0.0, 6.0, 0.7)[None], OFFSETS, 6.0, 1.0)
    assert bands.width[0] == pytest.approx(6.0, abs=0.1)
    assert bands.contrast[0] == pytest.approx(100.0, rel=0.02)
    assert -bands.left[0] == pytest.approx(bands.right[0], abs=1e-6)


@pytest.mark.parametrize(
    ("width", "blur", "noise"), [(2.0, 1.0, 8.0), (4.0, 1.0, 10.0), (1.0, 1.5, 5.0), (6.0, 2.0, 8.0)]
)
def test_predicted_sigma_is_the_scatter(width, blur, noise):
    picture = picture_of(30.2, width, blur, noise, size=(4000, 60))
    points = np.stack([np.arange(30.0, 3970.0, 3.0), np.full(1314, 30.0)], axis=-1)
    profiles = sample_profiles(picture, points, np.broadcast_to([0.0, 1.0], points.shape), OFFSETS)
    bands = measure_bands(profiles, OFFSETS, 6.0, noise)
    assert bands.valid.mean() > 0.95
    scatter = bands.center[bands.valid].std()
    ratio = scatter / np.median(bands.sigma[bands.valid])
    assert 1 / 1.5 < ratio < 1.5, (scatter, np.median(bands.sigma))


def test_sigma_has_a_floor():
    bands = measure_bands(band(0.0, 3.0, 1.0, contrast=150.0)[None], OFFSETS, 6.0, 1e-3)
    assert bands.sigma[0] == pytest.approx(SIGMA_FLOOR_PX, rel=0.01)


def test_what_is_no_band_is_not_valid():
    flat = np.full(len(OFFSETS), 80.0)
    step = 80.0 + 100.0 * (OFFSETS > 0)
    missing = band(0.0, 3.0, 1.0)
    missing[3] = np.nan
    faint = band(0.0, 3.0, 1.0, contrast=2.0)
    dark = band(0.0, 3.0, 1.0, contrast=-100.0)
    wide = band(0.0, 60.0, 1.0)
    good = band(0.0, 3.0, 1.0)
    found = measure_bands(np.array([flat, step, missing, faint, dark, wide, good]), OFFSETS, 6.0, 1.0)
    assert found.valid.tolist() == [False] * 6 + [True]


def test_the_search_is_limited_and_takes_the_band_near_the_middle():
    two = band(0.5, 2.0, 0.8) + band(9.0, 2.0, 0.8, contrast=140.0, background=0.0)
    near = measure_bands(two[None], OFFSETS, 4.0, 1.0)
    assert near.center[0] == pytest.approx(0.5, abs=0.1)
    far = measure_bands(band(8.0, 2.0, 0.8)[None], OFFSETS, 4.0, 1.0)
    assert not far.valid[0] or abs(far.center[0]) <= 5.0


def test_samples_are_bilinear_and_nan_outside():
    rows, columns = np.mgrid[:40, :50].astype(np.float32)
    picture = 2 * columns + 3 * rows
    points, normals = np.array([[10.25, 20.5], [1.0, 20.0], [48.0, 38.0]]), np.array([[1.0, 0.0]] * 3)
    offsets = np.array([-3.0, 0.0, 3.0])
    values = sample_profiles(picture, points, normals, offsets)
    np.testing.assert_allclose(values[0], 2 * (10.25 + offsets) + 3 * 20.5, atol=1e-4)
    assert np.isnan(values[1]).tolist() == [True, False, False]
    assert np.isnan(values[2]).tolist() == [False, False, True]


def test_smoothing_takes_the_noise_down_and_skips_gaps():
    rng = np.random.default_rng(1)
    profiles = band(0.0, 3.0, 1.0) + rng.normal(0, 5, (400, len(OFFSETS)))
    profiles[100] = np.nan
    smooth = smooth_along(profiles, 2.0)
    assert np.isnan(smooth[100]).all()
    assert np.isfinite(np.delete(smooth, 100, axis=0)).all()
    rest = np.delete(smooth, 100, axis=0) - band(0.0, 3.0, 1.0)
    # a Gaussian of 2 samples takes noise down by sqrt(2 sqrt(pi) 2)
    assert rest.std() == pytest.approx(5 / np.sqrt(4 * np.sqrt(np.pi)), rel=0.1)
    np.testing.assert_array_equal(smooth_along(profiles, 0.0), profiles)


def test_dark_markings_are_light_ones_of_the_negative():
    image = np.full((20, 30, 3), 200, np.uint8)
    image[8:11] = 40
    dark = ~to_gray(image)
    np.testing.assert_array_equal(dark, to_gray(~image))
    assert dark[9, 5] > dark[2, 5]
    points = np.array([[15.0, 9.0]])
    offsets = np.arange(-8.0, 8.25, 0.5)
    found = measure_bands(sample_profiles(dark, points, np.array([[0.0, 1.0]]), offsets), offsets, 3.0, 1.0)
    assert found.valid[0]
    assert found.center[0] == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("noise", [1.0, 4.0, 12.0])
def test_noise_of_a_picture(noise):
    rng = np.random.default_rng(2)
    gradient = np.add.outer(np.linspace(60, 90, 240), np.linspace(0, 40, 320))
    picture = (gradient + rng.normal(0, noise, (240, 320))).astype(np.float32)
    cv2.rectangle(picture, (40, 50), (200, 58), 220, -1)
    assert picture_noise(picture) == pytest.approx(noise, rel=0.1)
    left = np.zeros((240, 320), dtype=bool)
    left[1:-1, 1:120] = True
    picture[:, 160:] += rng.normal(0, 30, (240, 160)).astype(np.float32)
    assert picture_noise(picture, np.flatnonzero(left)) == pytest.approx(noise, rel=0.15)
    assert picture_noise(np.full((50, 50), 7.0, np.float32)) == 0.5


def test_a_search_narrower_than_the_samples_looks_at_the_nearest_one():
    """On a small picture the search is a fraction of a pixel, and no sample need lie within it."""
    offsets = np.arange(-13.7, 13.9, 1.0)
    profile = band(0.3, 3.0, 1.0, offsets=offsets)
    bands = measure_bands(profile[None], offsets, 0.2, 1.0)
    assert bands.valid.all() and bands.center[0] == pytest.approx(0.3, abs=0.1)
