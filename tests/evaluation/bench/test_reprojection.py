"""Reprojection error, and the field points over which it is a mean."""

import numpy as np
import pytest

from circlecal.evaluation.bench.reprojection import mean_reprojection_error, reprojection_grid
from circlecal.geometry.homography import projects_in_front
from circlecal.geometry.projective import apply_homography, lift
from circlecal.synthetic.cameras import aim_camera

FIELD = np.random.default_rng(11).uniform(-12.0, 12.0, (40, 2))
PLACES = ((4.0, 58.0, -16.0), (-20.0, 45.0, -9.0), (18.0, 88.0, -38.0))
HOMOGRAPHIES = [aim_camera(np.array(place), np.zeros(3), 2400.0, 0.05, 1920, 1080).homography for place in PLACES]


@pytest.mark.parametrize("H", HOMOGRAPHIES)
def test_mean_reprojection_error(H):
    shifted = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 4.0], [0.0, 0.0, 1.0]]) @ H
    assert mean_reprojection_error(H, shifted, FIELD) == pytest.approx(5.0)
    assert mean_reprojection_error(H, 3.0 * H, FIELD) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("scale", [1.0, -2.0])
@pytest.mark.parametrize("H", HOMOGRAPHIES)
def test_reprojection_grid_is_inside_the_image_and_in_front(H, scale):
    grid = reprojection_grid(scale * H, 1920, 1080, 52.5, 34.0)
    pixels = apply_homography(H, grid)
    assert (pixels >= 0).all()
    assert (pixels <= (1919, 1079)).all()
    assert projects_in_front(H, grid)
    assert ((lift(grid) @ H.T)[:, 2] > 0).all()


def test_the_grid_of_a_field_is_that_of_the_field_turned():
    H = np.diag([8.0, 8.0, 1.0])
    H[:2, 2] = 960.0, 540.0
    grid = reprojection_grid(H, 1921, 1081, 45.7, 27.4)
    turned = -grid[np.lexsort((-grid[:, 1], -grid[:, 0]))]
    np.testing.assert_allclose(grid[np.lexsort((grid[:, 1], grid[:, 0]))], turned)
