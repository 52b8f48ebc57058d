"""A camera over a flat field that shows it where another one, over a crowned field, does."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.flat import flat_camera
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.surface import Surface

CAMERA = Camera(
    1920,
    1080,
    np.full(2, 3600.0),
    image_center(1920, 1080) + np.array([4.0, -3.0]),
    np.radians([3.0, 76.0, 0.5]),
    np.array([4.0, 60.0, -15.0]),
    np.array([0.03, 0.002]),
)


def shown(crown_m):
    grid = np.stack(np.meshgrid(np.linspace(-15, 15, 25), np.linspace(-12, 12, 25)), axis=-1).reshape(-1, 2)
    return grid, CAMERA.project(Surface("roof", 9.15, crown_m).lift(grid))


def values(camera):
    return np.concatenate([camera.focal_px, camera.angles_rad, camera.position_m, camera.kappa[:1]])


@pytest.mark.parametrize("centred", [False, True])
def test_the_nearest_one_is_nearer_than_the_camera_itself(centred):
    field, pixels = shown(0.08)
    found = flat_camera(CAMERA, field, pixels, centred=centred)
    before, after = (np.sqrt(np.mean((c.project(field) - pixels) ** 2)) for c in (CAMERA, found))
    assert after < 0.6 * before
    if centred:
        np.testing.assert_allclose(found.principal_point_px, image_center(1920, 1080))
        assert found.kappa[1] == 0.0
    else:
        np.testing.assert_array_equal(found.principal_point_px, CAMERA.principal_point_px)


def test_over_a_flat_field_it_is_the_camera():
    found = flat_camera(CAMERA, *shown(0.0))
    np.testing.assert_allclose(values(found), values(CAMERA), rtol=1e-9)


@pytest.mark.parametrize("centred", [False, True])
def test_rounding_of_what_is_given_does_not_show(centred):
    """A result that was written to a file and read back is exported as it was before."""
    field, pixels = shown(0.08)
    found = values(flat_camera(CAMERA, field, pixels, centred=centred))
    for seed in range(8):
        rng = np.random.default_rng(seed)

        def rounded(given, rng=rng):
            return given * (1.0 + 2e-16 * rng.integers(-1, 2, given.shape))

        near = replace(CAMERA, angles_rad=rounded(CAMERA.angles_rad), kappa=rounded(CAMERA.kappa))
        again = values(flat_camera(near, field, rounded(pixels), centred=centred))
        np.testing.assert_allclose(again, found, rtol=1e-10)


def test_few_points_change_nothing():
    field, pixels = shown(0.08)
    assert flat_camera(CAMERA, field[:7], pixels[:7]) is CAMERA
