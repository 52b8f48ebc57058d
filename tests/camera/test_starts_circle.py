"""Starts of the optimiser."""

import numpy as np
import pytest

from circlecal.camera.starts_circle import closed_form_starts, fixed_position_start, grid_starts
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import ProjectionModel, camera_of, project
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import transform_lines
from circlecal.geometry.surface import Surface
from circlecal.synthetic.cameras import aim_camera, sample_camera
from circlecal.synthetic.markings import circle_points

from .conftest import random_thetas

MODEL = ProjectionModel(1920, 1080, Surface("flat"))
UP = np.array([0.0, 1.0])


def seen_by(camera, center=(0.0, 0.0), radius=9.15):
    H = camera.homography
    return (
        transform_conic(H, circle_conic(center, radius)),
        H @ np.r_[center, 1.0],
        transform_lines(H, [1.0, 0.0, -center[0]]),
    )


@pytest.mark.parametrize("with_mark", [True, False])
def test_closed_forms_hold_the_true_camera(with_mark):
    for seed in range(8):
        theta = random_thetas(1, np.random.default_rng(seed))[0]
        theta[7:] = 0.0
        conic, center, line = seen_by(camera_of(theta, MODEL))
        starts = closed_form_starts(conic, center if with_mark else None, line, UP, np.zeros(2), 9.15, MODEL, "main")
        field = np.array([[[0.0, 0.0], [8.0, 3.0], [-5.0, -7.0]]])
        pixels = project(starts, np.repeat(field, len(starts), axis=0), MODEL).pixels
        departure = np.abs(pixels - project(theta[None], field, MODEL).pixels).max(axis=(1, 2))
        assert departure.min() < 1e-4
        assert (starts[:, 6] < 0).all()
        assert (np.sin(starts[:, 2]) > 0).all()


def test_closed_forms_hold_a_camera_that_has_the_middle_of_the_field_behind_it():
    center, position = np.array([41.5, 0.0]), np.array([20.0, 8.0, -9.0])
    camera = aim_camera(position, np.r_[center, 0.0], 1500.0, 0.0, 1920, 1080)
    assert camera.depth(np.zeros(2)) < 0
    starts = closed_form_starts(*seen_by(camera, center), UP, center, 9.15, MODEL, "main")
    assert np.abs(starts[:, 4:7] - position).max(axis=1).min() < 1e-3


def test_without_a_line_there_is_no_closed_form():
    theta = random_thetas(1, np.random.default_rng(1))[0]
    theta[7:] = 0.0
    conic, center, _ = seen_by(camera_of(theta, MODEL))
    assert closed_form_starts(conic, center, None, UP, np.zeros(2), 9.15, MODEL, "main").shape == (0, len(theta))


@pytest.mark.parametrize("side", sorted(SIDES))
def test_grid_stands_on_the_stated_side_and_sees_the_circle(side):
    direction = np.array(SIDES[side])
    position = np.r_[60.0 * direction + 5.0 * direction[::-1], -16.0]
    camera = aim_camera(position, np.array([1.0, -1.0, 0.0]), 2600.0, 0.0, 1920, 1080)
    conic, _, _ = seen_by(camera)
    ellipse = ellipse_from_conic(conic)
    starts = grid_starts(ellipse, np.zeros(2), 9.15, MODEL, side)
    assert len(starts) > 50
    assert (starts[:, 4:6] @ direction > -1e-6).all()
    assert (starts[:, 6] < 0).all()
    for theta in starts[:: len(starts) // 10]:
        other = ellipse_from_conic(seen_by(camera_of(theta, MODEL))[0])
        assert np.linalg.norm(other.center - ellipse.center) < 0.25 * ellipse.semi_axes[0]
        assert 0.6 < other.semi_axes[0] / ellipse.semi_axes[0] < 1.7


def test_grid_is_about_the_circle_that_is_seen():
    center = np.array([-20.0, 7.0])
    camera = aim_camera(np.array([-15.0, 45.0, -12.0]), np.r_[center, 0.0], 2000.0, 0.0, 1920, 1080)
    ellipse = ellipse_from_conic(seen_by(camera, center, 4.5)[0])
    starts = grid_starts(ellipse, center, 4.5, MODEL, "main")
    distance = np.linalg.norm(starts[:, 4:7] - np.r_[center, 0.0], axis=1) / 4.5
    np.testing.assert_allclose(np.unique(np.round(distance, 6)), [4.0, 7.0, 11.0])


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_known_position_finds_focal_length_and_aim(share):
    rng = np.random.default_rng(4)
    camera = sample_camera("main", rng)
    points = circle_points(camera, load_field("soccer"), "center", 200, 0.3, rng).points_px
    points = points[: int(share * len(points))]
    model = ProjectionModel(camera.width, camera.height)
    theta = fixed_position_start(points, np.zeros(2), 9.1, camera.position_m, camera.angles_rad[2], model)[0]
    assert theta[0] == pytest.approx(np.log(camera.focal_px[0]), abs=0.15)
    assert theta[1:4] == pytest.approx(camera.angles_rad, abs=0.02)
    assert len(fixed_position_start(points[:2], np.zeros(2), 9.1, camera.position_m, 0.0, model)) == 0
    below = camera.position_m * np.array([1, 1, -1])
    assert len(fixed_position_start(points, np.zeros(2), 9.1, below, 0.0, model)) == 0
