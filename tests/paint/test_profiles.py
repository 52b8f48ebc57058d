"""Profiles across a curve, and the noise of a picture."""

import cv2
import numpy as np
import pytest

from circlecal.paint.profiles import (
    estimate_noise,
    interpolate,
    sample_profiles,
    smooth_along,
    to_gray,
)
from circlecal.paint.roughness import measure_roughness


def test_gray_is_what_the_standard_weighs():
    image = np.zeros((2, 3, 3), np.uint8)
    image[0] = np.diag([200, 200, 200])
    assert to_gray(image)[0].tolist() == [23, 117, 60]
    assert to_gray(~image)[1].tolist() == [255, 255, 255]


def test_samples_are_bilinear_and_nan_outside():
    rows, columns = np.mgrid[:40, :50].astype(np.float32)
    picture = 2 * columns + 3 * rows
    points, normals = np.array([[10.25, 20.5], [1.0, 20.0], [48.0, 38.0]]), np.array([[1.0, 0.0]] * 3)
    offsets = np.array([-3.0, 0.0, 3.0])
    values = sample_profiles(picture, points, normals, offsets)
    np.testing.assert_allclose(values[0], 2 * (10.25 + offsets) + 3 * 20.5, atol=1e-4)
    assert np.isnan(values[1]).tolist() == [True, False, False]
    assert np.isnan(values[2]).tolist() == [False, False, True]
    beyond = sample_profiles(picture, points, normals, offsets, repeat_border=True)
    np.testing.assert_allclose(beyond[1], [60.0, 62.0, 68.0], atol=1e-4)


def test_any_number_of_places_is_looked_up():
    rows, columns = np.mgrid[:40, :50].astype(np.float32)
    x, y = np.random.default_rng(0).uniform(1.0, 38.0, (2, 2, 70_001)).astype(np.float32)
    np.testing.assert_allclose(interpolate(2 * columns + 3 * rows, x, y), 2 * x + 3 * y, atol=0.2)


def test_smoothing_takes_the_noise_down_and_skips_gaps():
    rng = np.random.default_rng(1)
    clean = 80.0 + 100.0 * np.exp(-0.5 * np.linspace(-7.0, 7.0, 57) ** 2)
    profiles = (clean + rng.normal(0, 5, (400, len(clean)))).astype(np.float32)
    profiles[100] = np.nan
    smooth = smooth_along(profiles, 2.0)
    assert np.isnan(smooth[100]).all()
    assert np.isfinite(np.delete(smooth, 100, axis=0)).all()
    rest = np.delete(smooth, 100, axis=0) - clean
    # a Gaussian of 2 samples takes noise down by sqrt(2 sqrt(pi) 2)
    assert rest.std() == pytest.approx(5 / np.sqrt(4 * np.sqrt(np.pi)), rel=0.1)
    np.testing.assert_array_equal(smooth_along(profiles, 0.0), profiles)


@pytest.mark.parametrize("noise", [1.0, 4.0, 12.0])
def test_noise_of_a_picture(noise):
    rng = np.random.default_rng(2)
    gradient = np.add.outer(np.linspace(60, 90, 240), np.linspace(0, 40, 320))
    picture = (gradient + rng.normal(0, noise, (240, 320))).astype(np.float32)
    cv2.rectangle(picture, (40, 50), (200, 58), 220, -1)
    assert estimate_noise(picture) == pytest.approx(noise, rel=0.1)
    left = np.zeros((240, 320), dtype=bool)
    left[1:-1, 1:120] = True
    picture[:, 160:] += rng.normal(0, 30, (240, 160)).astype(np.float32)
    assert estimate_noise(picture, np.flatnonzero(left)) == pytest.approx(noise, rel=0.15)
    assert estimate_noise(np.full((50, 50), 7.0, np.float32)) == 0.5


def test_roughness_is_the_scatter_around_a_place_and_ends_at_the_border():
    picture = np.random.default_rng(2).integers(0, 255, (60, 1920), dtype=np.uint8)
    places = np.array([[100.4, 30.2], [-5.0, 58.0], [1919.0, 0.0]])
    side = np.arange(-3, 4) * (16.0 / 6.0)
    for place, found in zip(places, measure_roughness(picture, places), strict=True):
        columns = np.clip(np.rint(place[0] + side), 0, 1919).astype(int)
        rows = np.clip(np.rint(place[1] + side), 0, 59).astype(int)
        assert found == pytest.approx(picture[np.ix_(rows, columns)].std(), rel=1e-12)
    assert measure_roughness(picture, np.zeros((0, 2))).shape == (0,)
