"""Pinhole camera with radial distortion: angles, projection, lens, SoccerNet keys, homography."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry import camera as pinhole
from circlecal.geometry.homography import turn_homography
from circlecal.geometry.projective import apply_homography

FIELD = np.random.default_rng(21).uniform(-10.0, 10.0, (50, 2))


@st.composite
def cameras(draw, lens=0.06, aspect=1.0):
    """Cameras beside a field that look at its middle."""
    position = np.array([draw(st.floats(-20, 20)), draw(st.floats(30, 90)), draw(st.floats(-40, -6))])
    aim = np.array([draw(st.floats(-5, 5)), draw(st.floats(-5, 5))]) - position[:2]
    angles = [np.arctan2(aim[0], -aim[1]), np.arctan2(np.linalg.norm(aim), -position[2]), draw(st.floats(-0.2, 0.2))]
    focal = draw(st.floats(1500.0, 5000.0)) * np.array([1.0, draw(st.floats(1.0 / aspect, aspect))])
    principal = pinhole.image_center(1920, 1080) + np.array([draw(st.floats(-20, 20)), draw(st.floats(-20, 20))])
    kappa = np.array([draw(st.floats(-lens, lens)), draw(st.floats(-lens / 4, lens / 4))])
    return pinhole.Camera(1920, 1080, focal, principal, np.array(angles), position, kappa)


angles = st.floats(-np.pi, np.pi)


@given(angles, st.one_of(angles, st.sampled_from([0.0, 1e-13, 1e-7, np.pi / 2, np.pi])), angles)
def test_angles_round_trip_through_the_rotation(pan, tilt, roll):
    R = pinhole.rotation_matrix(pan, tilt, roll)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(pinhole.rotation_matrix(*pinhole.pan_tilt_roll(R)), R, atol=1e-9)


@given(st.floats(-3.0, 3.0), st.floats(0.05, 3.0), st.floats(-1.5, 1.5))
def test_angles_with_small_roll_come_back_themselves(pan, tilt, roll):
    np.testing.assert_allclose(
        pinhole.pan_tilt_roll(pinhole.rotation_matrix(pan, tilt, roll)), (pan, tilt, roll), atol=1e-9
    )


def looking_down(width=1920, height=1080, focal_px=1500.0, height_m=10.0, kappa=(0.0, 0.0)):
    """A camera over the middle of the field, straight down."""
    center_px = pinhole.image_center(width, height)
    position_m = np.array([0.0, 0.0, -height_m])
    return pinhole.Camera(width, height, np.full(2, focal_px), center_px, np.zeros(3), position_m, np.array(kappa))


def test_directions_of_the_angles():
    down = looking_down(100, 100, 50.0)
    # straight down: field x to the right, field y (towards the main camera) downwards
    np.testing.assert_allclose(down.project([[1.0, 0.0], [0.0, 1.0]]), [[54.5, 49.5], [49.5, 54.5]])
    horizon = pinhole.rotation_matrix(0.0, np.pi / 2, 0.0)
    np.testing.assert_allclose(horizon[2], (0.0, -1.0, 0.0), atol=1e-12)
    right = pinhole.rotation_matrix(0.1, np.pi / 2, 0.0)
    assert right[2, 0] > 0
    # a camera that is turned clockwise turns its picture the other way: what lies to the right goes up
    to_the_right = pinhole.rotation_matrix(0.0, np.pi / 2, 0.1) @ (1.0, -1.0, 0.0)
    assert to_the_right[1] < 0


@given(cameras(aspect=1.2))
def test_projection_equals_opencv(camera):
    points = np.column_stack([FIELD, np.linspace(-2, 0, len(FIELD))])
    peer, _ = cv2.projectPoints(points, cv2.Rodrigues(camera.R)[0], camera.t, camera.K, camera.dist)
    np.testing.assert_allclose(camera.project(points), peer[:, 0], atol=1e-6)
    np.testing.assert_allclose(camera.project(FIELD), camera.project(np.column_stack([FIELD, np.zeros(len(FIELD))])))


@given(cameras(aspect=1.2))
def test_project_and_back_project_are_inverse(camera):
    pixels = camera.project(FIELD)
    inside = ((pixels > -200) & (pixels < (2120, 1280))).all(axis=1)
    np.testing.assert_allclose(camera.back_project(pixels[inside]), FIELD[inside], atol=1e-6)
    assert (camera.depth(FIELD) > 0).all()


@given(cameras(aspect=1.2))
def test_distort_and_undistort_are_inverse(camera):
    x, y = np.meshgrid(np.linspace(0, 1919, 9), np.linspace(0, 1079, 7))
    pixels = np.stack([x, y], axis=-1)
    np.testing.assert_allclose(camera.distort(camera.undistort(pixels)), pixels, atol=1e-7)
    np.testing.assert_allclose(camera.undistort(camera.distort(pixels)), pixels, atol=1e-7)
    np.testing.assert_allclose(camera.undistort(camera.principal_point_px), camera.principal_point_px)


def test_lens_is_measured_in_half_widths():
    camera = pinhole.Camera(
        2000,
        1000,
        np.full(2, 1500.0),
        np.array([1000.0, 500.0]),
        np.zeros(3),
        np.array([0.0, 0.0, -10.0]),
        np.array([0.05, 0.01]),
    )
    np.testing.assert_allclose(camera.distort([[2000.0, 500.0]]), [[1000.0 + 1000.0 * 1.06, 500.0]])


def test_a_lens_is_taken_back_where_it_leaves_less_than_half_of_the_distance():
    camera = looking_down(kappa=(-0.6, 0.17))
    assert pinhole.lens_fold(*camera.kappa) == np.inf
    away_px = 960.0 * np.linspace(0.1, 2.0, 39)
    points = camera.principal_point_px + away_px[:, None] * [0.8, 0.6]
    seen = camera.distort(points)
    least = np.linalg.norm(seen - camera.principal_point_px, axis=1) / away_px
    assert 4.0 / 9.0 < least.min() < 0.48
    np.testing.assert_allclose(camera.undistort(seen), points, atol=1e-5)


@pytest.mark.parametrize(("depth_m", "is_seen"), [(0.05, False), (0.2, True)])
def test_a_point_counts_as_in_front_from_a_tenth_of_a_metre_on(depth_m, is_seen):
    camera = looking_down(height_m=depth_m)
    assert np.isfinite(camera.project([0.0, 0.0])).all() == is_seen


def test_points_behind_the_camera_and_above_the_horizon_are_nan():
    camera = pinhole.Camera(
        1920,
        1080,
        np.full(2, 1500.0),
        pinhole.image_center(1920, 1080),
        np.radians([0.0, 80.0, 0.0]),
        np.array([0.0, 40.0, -10.0]),
        np.zeros(2),
    )
    assert np.isnan(camera.project([[0.0, 60.0]])).all()
    assert np.isnan(camera.back_project([[960.0, 0.0]])).all()
    assert np.isfinite(camera.back_project([[960.0, 1000.0]])).all()
    assert camera.depth([[0.0, 60.0]])[0] < 0


@given(cameras(aspect=1.2))
def test_soccernet_keys_round_trip(camera):
    record = camera.soccernet()
    back = pinhole.camera_from_soccernet(record, camera.width, camera.height)
    for name in ("focal_px", "principal_point_px", "angles_rad", "position_m", "kappa"):
        np.testing.assert_allclose(getattr(back, name), getattr(camera, name), rtol=1e-12, atol=1e-14)
    assert {len(record[k]) for k in ("radial_distortion", "tangential_distortion", "thin_prism_distortion")} == {
        6,
        2,
        4,
    }
    assert all(isinstance(v, float) for k in record for v in ([record[k]] if np.isscalar(record[k]) else record[k]))


@given(cameras(lens=0.0))
def test_homography_of_the_camera_is_its_projection_of_the_plane(camera):
    np.testing.assert_allclose(
        apply_homography(camera.homography, FIELD), camera.project(FIELD, distort=False), atol=1e-7
    )
    assert np.linalg.det(camera.homography) > 0


@given(cameras(lens=0.0), st.sampled_from([1.0, -1.0, 1e4, -1e-4]))
def test_camera_from_homography_is_exact(camera, scale):
    centred = pinhole.Camera(
        camera.width,
        camera.height,
        camera.focal_px,
        pinhole.image_center(1920, 1080),
        camera.angles_rad,
        camera.position_m,
        np.zeros(2),
    )
    found = pinhole.camera_from_homography(scale * centred.homography, 1920, 1080)
    np.testing.assert_allclose(found.focal_px, centred.focal_px, rtol=1e-6)
    np.testing.assert_allclose(found.position_m, centred.position_m, atol=1e-4)
    np.testing.assert_allclose(found.angles_rad, centred.angles_rad, atol=1e-7)
    np.testing.assert_allclose(found.project(FIELD), centred.project(FIELD), atol=1e-6)


@given(cameras(lens=0.0), st.floats(-1.0, 1.0), st.sampled_from([1.0, -1.0]))
def test_camera_from_the_homography_of_a_view_away_from_the_origin_is_exact(camera, turn, scale):
    away = replace(
        camera,
        focal_px=np.full(2, camera.focal_px[0]),
        principal_point_px=pinhole.image_center(1920, 1080),
        angles_rad=np.array([camera.angles_rad[0] + np.pi + turn, 1.4, camera.angles_rad[2]]),
    )
    assert away.depth(np.zeros(2)) < 0
    found = pinhole.camera_from_homography(scale * away.homography, 1920, 1080)
    np.testing.assert_allclose(found.position_m, away.position_m, atol=1e-4)
    np.testing.assert_allclose(found.R, away.R, atol=1e-7)


def test_homography_that_no_camera_has_gives_none():
    assert pinhole.camera_from_homography(np.diag([1.0, 2.0, 1.0]), 1920, 1080) is None
    assert pinhole.camera_from_homography(np.eye(3), 1920, 1080) is None


@given(cameras(aspect=1.2))
def test_turned_camera_sees_the_turned_field(camera):
    turned = camera.turn_field()
    np.testing.assert_allclose(turned.project(-FIELD), camera.project(FIELD), atol=1e-6)
    np.testing.assert_allclose(turned.homography, turn_homography(camera.homography, np.zeros(2)), rtol=1e-7, atol=1e-6)
    back = turned.turn_field()
    np.testing.assert_allclose(back.R, camera.R, atol=1e-12)
    np.testing.assert_allclose(back.position_m, camera.position_m)
    assert -np.pi <= turned.angles_rad[0] <= np.pi


def test_places_that_no_ray_reaches_through_a_barrel_lens_end_without_warnings():
    middle = np.array([960.0, 540.0])
    place = np.zeros(3), np.array([0.0, 0.0, -10.0])
    barrel = pinhole.Camera(1920, 1080, np.full(2, 900.0), middle, *place, np.array([-2.0, 0.0]))
    far = middle + np.geomspace(1.0, 1e9, 40)[:, None] * np.array([0.6, 0.8]) * barrel.width
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = barrel.undistort(np.vstack([middle + 5.0, far]))
    assert not np.isinf(found).any()
    np.testing.assert_allclose(barrel.distort(found[0]), middle + 5.0, atol=1e-9)
