"""Projection of the fitted camera and its derivatives."""

from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry.camera import rotation_matrix
from circlecal.geometry.camera_parameters import (
    INDEX,
    PARAMETERS,
    ProjectionModel,
    active_parameters,
    camera_of,
    parameters_between,
    project,
    rotations,
    theta_of,
)
from circlecal.geometry.surface import Surface, SurfaceShape
from tests.camera.conftest import STEPS, central_differences, random_thetas

SHAPES = get_args(SurfaceShape)
FIELD = np.random.default_rng(4).uniform(-12.0, 12.0, (25, 2))
ANGLE = st.floats(-3.0, 3.0)


@given(ANGLE, ANGLE, ANGLE)
def test_rotations_are_those_of_the_pinhole_camera(pan, tilt, roll):
    theta = np.zeros((1, len(PARAMETERS)))
    theta[0, 1:4] = pan, tilt, roll
    np.testing.assert_allclose(rotations(theta)[0], rotation_matrix(pan, tilt, roll), atol=1e-14)
    np.testing.assert_allclose(rotations(theta.repeat(3, axis=0))[1], rotations(theta)[0], atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_jacobian_equals_central_differences_for_every_parameter(shape):
    model = ProjectionModel(1920, 1080, Surface(shape, 4.0))
    for theta in random_thetas(4, np.random.default_rng(1)):
        found = project(theta[None], FIELD[None], model).jacobians()[0][0]
        numeric = central_differences(lambda t: project(t[None], FIELD[None], model).pixels[0], theta, STEPS)
        for name, k in INDEX.items():
            scale = max(1.0, float(np.abs(numeric[..., k]).max()))
            assert np.abs(found[..., k] - numeric[..., k]).max() < 1e-6 * scale, name


def test_every_parameter_of_the_camera_moves_pixels():
    model = ProjectionModel(1920, 1080, Surface("roof"))
    J = project(random_thetas(1, np.random.default_rng(2)), FIELD[None], model).jacobians()[0][0]
    still = {name for name, k in INDEX.items() if not np.abs(J[..., k]).max() > 0}
    # sizes of the markings move points of the field, not the camera
    assert still == {"width", "bloom", "length", "breadth"}


@pytest.mark.parametrize("shape", SHAPES)
def test_derivative_by_the_field_position(shape):
    model = ProjectionModel(1920, 1080, Surface(shape, 4.0))
    theta = random_thetas(3, np.random.default_rng(3))
    field = np.broadcast_to(FIELD, (3, *FIELD.shape))
    found = project(theta, field, model).jacobians()[1]
    for k, step in enumerate(1e-4 * np.eye(2)):
        numeric = (project(theta, field + step, model).pixels - project(theta, field - step, model).pixels) / 2e-4
        np.testing.assert_allclose(found[..., k], numeric, atol=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_derivative_in_a_direction_and_its_orientation(shape):
    model = ProjectionModel(1920, 1080, Surface(shape, 4.0))
    theta = random_thetas(5, np.random.default_rng(5))
    field = np.broadcast_to(FIELD, (5, *FIELD.shape))
    seen = project(theta, field, model)
    by_field = seen.jacobians()[1]
    direction = np.random.default_rng(6).normal(size=(2, len(FIELD)))
    expected = np.einsum("bnij,jn->bin", by_field, direction)
    np.testing.assert_allclose(seen.along(*direction), expected, atol=1e-9)
    np.testing.assert_array_equal(seen.upward, np.linalg.det(by_field) >= 0)


@pytest.mark.parametrize("shape", SHAPES)
def test_orientation_is_that_of_the_derivative_behind_the_camera_too(shape):
    model = ProjectionModel(1920, 1080, Surface(shape, 4.0))
    theta = random_thetas(4, np.random.default_rng(5))
    theta[1::2, INDEX["pan"]] += np.pi
    theta[:, [INDEX["kappa_1"], INDEX["kappa_2"]]] = 0.0  # a lens may fold what lies far out
    seen = project(theta, np.broadcast_to(FIELD, (4, *FIELD.shape)), model)
    behind = seen.inverse_depth < 0
    assert behind.any() and not behind.all()
    np.testing.assert_array_equal(seen.upward, np.linalg.det(seen.jacobians()[1]) >= 0)


@pytest.mark.parametrize("shape", ["parabola", "roof", "hip"])
def test_projection_equals_the_pinhole_camera_over_the_surface(shape):
    model = ProjectionModel(1280, 720, Surface(shape, 9.15))
    for theta in random_thetas(5, np.random.default_rng(6)):
        camera = camera_of(theta, model)
        lifted = np.column_stack([FIELD, theta[INDEX["crown"]] * model.surface.drop(*FIELD.T)])
        seen = project(theta[None], FIELD[None], model)
        np.testing.assert_allclose(seen.pixels[0], camera.project(lifted), atol=1e-9)
        np.testing.assert_allclose(seen.depth[0], camera.depth(lifted), atol=1e-12)


def test_flat_shape_knows_no_crown():
    model = ProjectionModel(1920, 1080, Surface("flat"))
    theta = random_thetas(1, np.random.default_rng(7))
    np.testing.assert_allclose(
        project(theta, FIELD[None], model).pixels[0], camera_of(theta[0], model).project(FIELD), atol=1e-9
    )


@pytest.mark.parametrize("shape", ["parabola", "roof", "hip"])
def test_crown_is_the_drop_at_its_reference(shape):
    surface, y = Surface(shape, 4.5), np.array([-4.5, 0.0, 4.5])
    np.testing.assert_allclose(surface.drop(0.0, y), [1.0, 0.0, 1.0])
    _, across = surface.slope(0.0, y)
    assert across[2] == -across[0] > 0


def test_camera_and_parameters_are_inverse():
    model = ProjectionModel(1920, 1080)
    theta = random_thetas(1, np.random.default_rng(8))[0]
    theta[INDEX["crown"] :] = 0.0
    np.testing.assert_allclose(theta_of(camera_of(theta, model), model), theta, atol=1e-12)


def test_only_a_zero_standard_deviation_fixes_a_parameter():
    assert active_parameters(np.array([0.0, 1.0, np.inf, 0.0, 1e-9])).tolist() == [1, 2, 4]


def test_a_barrel_lens_folds_what_lies_too_far_out():
    theta = random_thetas(1, np.random.default_rng(1))
    theta[:, INDEX["kappa_1"]], theta[:, INDEX["kappa_2"]] = -0.1, 0.0
    x = np.linspace(-200.0, 200.0, 2001)[None]
    along = np.stack([x, np.zeros_like(x)], axis=-1)
    seen = project(theta, along, ProjectionModel(1920, 1080, Surface("flat")))
    radius = np.sqrt(seen.r2[0])
    np.testing.assert_array_equal(seen.visible[0], radius < np.sqrt(1 / 0.3))
    assert seen.visible.any() and not seen.visible.all()


def test_cameras_on_both_sides_of_a_half_turn_are_near_each_other():
    first, second = np.zeros((2, len(PARAMETERS)))
    first[1], second[1] = np.pi - 0.01, 0.01 - np.pi
    second[4] = 3.0
    between = parameters_between(first, second)
    assert between[1] == pytest.approx(0.02)
    assert between[4] == 3.0
    np.testing.assert_allclose(parameters_between(second, first[None])[0], -between)
