"""The crowned surface and the rays that meet it."""

import numpy as np
import pytest

from circlecal.geometry.surface import FLAT, Surface
from circlecal.synthetic.cameras import sample_camera, soccer

SURFACES = [
    FLAT,
    Surface(crown_m=0.09),
    Surface("roof", crown_m=0.05),
    Surface("hip", crown_m=0.09),
    Surface(crown_m=-0.03),
]


@pytest.mark.parametrize("surface", SURFACES)
def test_back_projection_inverts_projection(surface):
    camera = sample_camera("broadcast", np.random.default_rng(3), kappa=0.05, surface=surface)
    field = np.random.default_rng(4).uniform(-1, 1, (500, 2)) * (40, 30)
    pixels = camera.project(surface.lift(field))
    seen = np.isfinite(pixels).all(axis=1) & (np.abs(pixels - (960, 540)) < (960, 540)).all(axis=1)
    assert seen.sum() > 50
    np.testing.assert_allclose(camera.back_project(pixels[seen], surface), field[seen], atol=1e-8)


@pytest.mark.parametrize("surface", SURFACES)
def test_slope_is_the_derivative_of_the_drop(surface):
    x, y = np.random.default_rng(2).uniform(-1, 1, (2, 400)) * [[52.5], [34.0]]
    by_x, by_y = surface.slope(x, y)
    along = (surface.drop(x + 1e-5, y) - surface.drop(x - 1e-5, y)) / 2e-5
    across = (surface.drop(x, y + 1e-5) - surface.drop(x, y - 1e-5)) / 2e-5
    np.testing.assert_allclose(np.zeros_like(x) if by_x is None else by_x, along, atol=1e-6)
    np.testing.assert_allclose(by_y, across, atol=1e-6)
    np.testing.assert_allclose(surface.fall(x, y, 2.0, -3.0), 2.0 * along - 3.0 * across, atol=1e-5)


def test_drop_at_the_circle():
    assert Surface(crown_m=0.05).drop(3.0, 9.15) == pytest.approx(0.05)
    assert Surface("roof", crown_m=0.05).drop(3.0, -9.15) == pytest.approx(0.05)
    assert Surface("hip", crown_m=0.05).drop(3.0, -9.15) == pytest.approx(0.05)
    assert FLAT.lift([3.0, 4.0]).tolist() == [3.0, 4.0, 0.0]


def test_the_ends_of_a_hipped_roof_fall_as_its_sides_do():
    """Half a ridge of 18.3 m; from a goal to the touchline there is no fall but beyond the hips."""
    hip, roof = Surface("hip", crown_m=0.05), Surface("roof", crown_m=0.05)
    x, y = np.array([0.0, 18.3, 30.0]), np.array([-20.0, 5.0, 12.0])
    np.testing.assert_allclose(hip.drop(x, y), roof.drop(x, y))
    np.testing.assert_allclose(hip.drop([-18.3 - 9.15, 18.3 + 18.3], [4.0, -17.0]), [0.05, 0.10])


def test_rays_above_the_horizon_meet_nothing():
    camera = sample_camera("broadcast", np.random.default_rng(3))
    assert np.isnan(camera.back_project([[960.0, -9000.0]], Surface(crown_m=0.05))).all()


def test_what_a_ray_leaves_behind_is_not_seen():
    """From below the rim of a hollow, outwards: the ray meets the surface only where it comes from."""
    hollow = Surface("parabola", 9.15, -0.2)
    camera_m = np.array([0.0, 60.0, -5.0])
    assert hollow.drop(0.0, 60.0) < camera_m[2]
    assert np.isnan(hollow.meet(camera_m, np.array([0.0, 1.0, 0.1]))).all()
    assert np.isfinite(hollow.meet(np.array([0.0, 20.0, -5.0]), np.array([0.0, -1.0, 0.1]))).all()


def test_without_crown_the_camera_back_projects_the_same():
    camera = sample_camera("main", np.random.default_rng(9), kappa=-0.01)
    pixels = np.random.default_rng(1).uniform((0, 0), (1919, 1079), (50, 2))
    np.testing.assert_allclose(camera.back_project(pixels, FLAT), camera.back_project(pixels), atol=1e-9)
    assert soccer() is soccer()
