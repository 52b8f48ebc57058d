"""Field points to pixels and back, with lens and crown, and their standard deviation."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, PlaneCamera, image_center
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, camera_of, theta_of
from circlecal.geometry.surface import FLAT, Surface
from tests.folded import projected_without_fold

WIDTH, HEIGHT = 1280, 720
FIELD = np.array([[0.0, 0.0], [9.15, 0.0], [-20.0, -30.0], [12.0, 20.0]])
CAMERA = Camera(
    width=WIDTH,
    height=HEIGHT,
    focal_px=np.array([1500.0, 1500.0]),
    principal_point_px=image_center(WIDTH, HEIGHT) + 3,
    angles_rad=np.radians([3.0, 77.0, 1.0]),
    position_m=np.array([2.0, 60.0, -14.0]),
    kappa=np.array([0.03, 0.002]),
)
PARABOLA, ROOF = Surface(crown_m=0.08), Surface("roof", crown_m=0.08)
PLANE = FieldView(PlaneCamera(WIDTH, HEIGHT, CAMERA.homography))
BARREL = replace(CAMERA, focal_px=np.array([700.0, 735.0]), kappa=np.array([-0.12, 0.01]))
SOCCER = load_field("soccer")


@pytest.mark.parametrize(
    "view",
    [
        FieldView(CAMERA),
        FieldView(CAMERA, PARABOLA),
        FieldView(CAMERA, ROOF),
        FieldView(BARREL, ROOF),
        PLANE,
        FieldView(PlaneCamera(WIDTH, HEIGHT, -2 * CAMERA.homography)),
    ],
)
def test_there_and_back(view):
    pixels, sigma = view.project(FIELD, sigma=True)
    assert np.allclose(view.to_field(pixels), FIELD, atol=1e-9)
    assert sigma is None and view.to_field(pixels, sigma=True).sigma is None
    assert np.array_equal(view.project(FIELD), pixels)
    # one point, and points in any arrangement
    assert np.allclose(view.project(FIELD[0]), pixels[0], atol=1e-9)
    assert np.allclose(view.to_field(pixels.reshape(2, 2, 2)), FIELD.reshape(2, 2, 2), atol=1e-9)


def test_there_and_back_from_a_low_camera_over_a_steep_crown():
    low = replace(CAMERA, position_m=np.array([0.0, 45.0, -3.0]), angles_rad=np.radians([0.0, 86.0, 0.0]))
    view = FieldView(low, Surface(crown_m=0.1))
    field = np.array([[0.0, 0.0], [3.0, 20.0], [-5.0, -10.0]])
    assert np.allclose(view.to_field(view.project(field)), field, atol=1e-6)


def test_lens_and_crown_are_in_the_answer():
    flat = FieldView(CAMERA).project(FIELD)
    assert np.abs(flat - PLANE.project(FIELD)).max() > 1
    crowned = FieldView(CAMERA, PARABOLA).project(FIELD)
    assert np.array_equal(crowned[0], flat[0])
    assert crowned[2, 1] > flat[2, 1] + 1  # the far side lies lower, so lower in the picture


@pytest.mark.parametrize("camera", [CAMERA, BARREL])
@pytest.mark.parametrize("surface", [FLAT, PARABOLA, ROOF])
def test_points_are_seen_where_opencv_projects_them(camera, surface):
    pixels = FieldView(camera, surface).project(FIELD)
    points, rotation = surface.lift(FIELD), cv2.Rodrigues(camera.R)[0]
    peer, _ = cv2.projectPoints(points, rotation, camera.t, camera.K, camera.dist)
    np.testing.assert_allclose(pixels, peer[:, 0], atol=1e-6)
    straight = cv2.undistortPoints(pixels[:, None], camera.K, camera.dist, P=camera.K)[:, 0]
    np.testing.assert_allclose(straight, camera.undistort(pixels), atol=1e-3)


@pytest.mark.parametrize("view", [FieldView(CAMERA), FieldView(CAMERA, ROOF), PLANE])
def test_sky_and_points_behind_the_camera_have_no_answer(view):
    assert np.isnan(view.to_field([[640.0, -2000.0]])).all()
    assert np.isnan(view.project([[0.0, 200.0]])).all()


def test_a_ray_that_passes_over_the_crown_has_no_answer():
    low = replace(CAMERA, position_m=np.array([0.0, 45.0, -2.0]), angles_rad=np.radians([0.0, 86.0, 0.0]))
    steep = FieldView(low, Surface(crown_m=0.4))
    pixels = FieldView(low).project([[0.0, -100.0], [0.0, 20.0]])
    seen = steep.to_field(pixels)
    assert np.isnan(seen[0]).all() and np.isfinite(seen[1]).all()


def test_what_the_lens_would_fold_back_into_the_picture_is_not_seen():
    camera = Camera(
        1920, 1080, np.full(2, 1500.0), image_center(1920, 1080), np.radians([-10.0, 76.0, 0.0]),
        np.array([0.0, 50.0, -15.0]), np.array([-0.12, 0.0]),
    )  # fmt: skip
    far = np.array([-50.0, 30.0])
    view = FieldView(camera)
    assert view.shows(projected_without_fold(camera, far))
    assert np.isnan(view.project(far)).all() and not view.shows(view.project(far))
    assert np.isnan(view.to_field([[-3000.0, 540.0]])).all()  # no point of the field is seen so far out
    visible = {tuple(p) for p in view.visible_field(SOCCER).tolist()}
    assert len(visible) > 100 and tuple(far) not in visible


@given(st.floats(-0.2, 0.2), st.floats(-0.05, 0.05), st.floats(0.9, 1.1))
def test_the_further_out_a_point_is_the_further_out_it_is_seen(k1, k2, aspect):
    camera = replace(CAMERA, focal_px=np.array([800.0, 800.0 * aspect]), kappa=np.array([k1, k2]))
    far = np.geomspace(1.0, 5000.0, 300)[:, None] * [[0.6, 0.8]] + camera.principal_point_px
    seen = np.hypot(*(camera.distort(far) - camera.principal_point_px).T)
    valid = np.isfinite(seen)
    assert valid[0] and not (np.diff(valid.astype(int)) > 0).any()  # once lost, a point never comes back
    assert (np.diff(seen[valid]) > 0).all()
    inner = far[valid][:-3]
    np.testing.assert_allclose(camera.undistort(camera.distort(inner)), inner, rtol=1e-5)


@pytest.mark.parametrize("surface", [FLAT, PARABOLA, ROOF])
def test_sigma_is_the_scatter_of_cameras_drawn_from_the_covariance(surface):
    rng = np.random.default_rng(11)
    size = len(PARAMETERS)
    root = np.diag([2e-3, 4e-4, 4e-4, 4e-4, 0.1, 0.1, 0.05, 1.0, 1.0, 1e-3, 0.0, 1e-3, 5e-3, 0.0, 0.0, 0.0, 0.0])
    root[:7, :7] = root[:7, :7] @ np.linalg.qr(rng.normal(size=(7, 7)))[0] * 0.7 + 0.3 * root[:7, :7]
    view = FieldView(CAMERA, surface, covariance=root @ root.T)
    model = ProjectionModel.of(CAMERA, surface)
    theta = theta_of(CAMERA, model, surface.crown_m)
    pixels, sigma_px = view.project(FIELD, sigma=True)
    points, sigma_m = view.to_field(pixels, sigma=True)
    thetas = theta + rng.standard_normal((3000, size)) @ root.T
    drawn = [FieldView(camera_of(t, model), replace(surface, crown_m=t[INDEX["crown"]])) for t in thetas]
    in_picture = np.array([other.project(FIELD) for other in drawn]) - pixels
    on_ground = np.array([other.to_field(pixels) for other in drawn]) - points
    np.testing.assert_allclose(np.sqrt((in_picture**2).sum(axis=-1).mean(axis=0)), sigma_px, rtol=0.06)
    np.testing.assert_allclose(np.sqrt((on_ground**2).sum(axis=-1).mean(axis=0)), sigma_m, rtol=0.06)


def test_covariances_are_those_of_cameras_drawn_from_the_covariance():
    model = ProjectionModel.of(CAMERA, ROOF)
    theta = theta_of(CAMERA, model, ROOF.crown_m)
    sd = np.zeros(len(PARAMETERS))
    for name, size in (("log_focal", 2e-4), ("pan", 1e-4), ("tilt", 1e-4), ("x", 0.01), ("z", 0.01)):
        sd[INDEX[name]] = size
    view = FieldView(CAMERA, ROOF, covariance=np.diag(sd**2))
    pixels = view.project(FIELD)
    drawn = [
        FieldView(camera_of(theta + sd * draw, model), ROOF)
        for draw in np.random.default_rng(5).normal(size=(3000, len(PARAMETERS)))
    ]
    for places, told in (
        ([one.project(FIELD) for one in drawn], view.image_covariance(FIELD)),
        ([one.to_field(pixels) for one in drawn], view.field_covariance(pixels)),
    ):
        for point, own in enumerate(told):
            scatter = np.cov(np.array(places)[:, point].T)
            assert np.abs(scatter - own).max() < 0.1 * np.trace(own)


def test_a_homography_knows_no_covariance_and_no_space():
    assert np.isnan(PLANE.image_covariance(FIELD)).all()
    space = np.column_stack([FIELD, [0.0, -1.0, -2.0, 0.0]])
    assert np.isfinite(PLANE.project(space)).all(axis=1).tolist() == [True, False, False, True]


def test_sigma_is_not_a_number_where_nothing_is_seen():
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[INDEX["x"], INDEX["x"]] = 0.25  # half a metre along x
    view = FieldView(CAMERA, covariance=covariance)
    pixels, sigma_px = view.project([[0.0, 0.0], [0.0, 200.0]], sigma=True)
    assert np.isfinite(sigma_px[0]) and np.isnan(sigma_px[1])
    sigma_m = view.to_field([pixels[0], [640.0, -2000.0]], sigma=True).sigma
    assert sigma_m[0] == pytest.approx(0.5, rel=1e-6) and np.isnan(sigma_m[1])


def test_a_homography_knows_no_crown():
    with pytest.raises(ValueError, match="crowned"):
        FieldView(PLANE.camera, ROOF).to_field([[640.0, 400.0]])


def test_markings_of_a_grown_field():
    grown = FieldView(CAMERA, growth_m=np.array([4.0, 2.0])).markings(SOCCER)
    plain = FieldView(CAMERA).markings(SOCCER)
    moved = {name: np.abs(grown[name] - plain[name]).max(axis=0).round(3).tolist() for name in plain}
    assert moved["side_line_left"] == pytest.approx([2.0, 1.0], abs=0.01)
    assert moved["halfway_line"] == pytest.approx([0.0, 1.0], abs=0.01)
    assert moved["big_rect_left_main"] == [2.0, 0.0]
    assert moved["centre_circle"] == [0.0, 0.0]


def test_the_visible_field_is_what_lies_in_the_picture():
    view = FieldView(CAMERA, ROOF)
    near = view.visible_field(SOCCER, center_m=(5.0, 0.0), reach_m=12.0)
    assert len(near) > 50 and (np.abs(near - (5.0, 0.0)) <= 12.0).all()
    pixels = view.project(view.visible_field(SOCCER))
    assert ((pixels >= 0) & (pixels <= (WIDTH - 1, HEIGHT - 1))).all()
    assert not view.shows([-0.3, 100.0]) and view.shows([-0.3, 100.0], margin_px=0.5)


def test_a_mirrored_camera_shows_the_mirrored_points_of_the_field():
    centred = replace(CAMERA, principal_point_px=image_center(WIDTH, HEIGHT))
    turned = centred.angles_rad * (-1, 1, -1)
    mirrored = FieldView(replace(centred, position_m=centred.position_m * (-1, 1, 1), angles_rad=turned), ROOF)
    seen = FieldView(centred, ROOF).visible_field(SOCCER, center_m=(5.3, 0.0), reach_m=12.2)
    again = mirrored.visible_field(SOCCER, center_m=(-5.3, 0.0), reach_m=12.2) * (-1, 1)
    assert sorted(map(tuple, again.round(6))) == sorted(map(tuple, seen.round(6)))
