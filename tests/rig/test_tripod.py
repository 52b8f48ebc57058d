"""The camera on its tripod against the renderer's, its derivatives against differences, and its change of size."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, camera_of
from circlecal.geometry.surface import Surface
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate, TripodModel, unwrap_pan
from circlecal.synthetic.tripod import Tripod, sample_tripod

MODEL = TripodModel(ProjectionModel(1280, 720), float(np.log(1.5 * 1280)))


def common_of(tripod: Tripod) -> np.ndarray:
    common = np.zeros(len(COMMON))
    common[:8] = [*tripod.position_m, *tripod.lean_rad, tripod.roll_rad, tripod.lever_m, tripod.lever_per_zoom_m]
    slope = 2.0 * tripod.kappa_by_focal / tripod.reference_focal**2
    common[PLACE["kappa_1"]], common[PLACE["kappa_1_by_zoom"]] = tripod.kappa, slope
    common[PLACE["kappa_1_by_focal"]] = tripod.kappa_by_focal
    return common


@pytest.mark.parametrize("focal", [0.9, 2.1])
@pytest.mark.parametrize("seed", range(5))
def test_cameras_are_those_of_the_rendered_tripod(seed: int, focal: float) -> None:
    tripod = sample_tripod(68.0, np.random.default_rng(seed))
    pan, tilt = 0.4, 1.7
    theta = MODEL.thetas(np.array([[np.log(focal * 1280), pan, tilt, 0.0]]), common_of(tripod))[0]
    found, wanted = camera_of(theta, MODEL.projection), tripod.camera(pan, tilt, focal, 1280, 720)
    np.testing.assert_allclose(found.R, wanted.R, atol=1e-12)
    np.testing.assert_allclose(found.position_m, wanted.position_m, atol=1e-12)
    np.testing.assert_allclose(found.kappa, wanted.kappa, atol=1e-12)


def random_parameters(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    own = np.column_stack(
        [rng.normal(7.5, 0.3, 4), rng.uniform(-0.7, 0.7, 4), rng.uniform(1.6, 1.9, 4), rng.normal(size=4)]
    )
    common = rng.normal(0.0, 0.02, len(COMMON))
    common[:3], common[PLACE["lever"]] = [1.0, 80.0, -15.0], 0.8
    return own, common


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_those_of_differences(seed: int) -> None:
    own, common = random_parameters(seed)
    by_own, by_common = MODEL.derivatives(own, common)
    for k in range(own.shape[1]):
        step = 1e-6 * np.eye(4)[k]
        difference = (MODEL.thetas(own + step, common) - MODEL.thetas(own - step, common)) / 2e-6
        np.testing.assert_allclose(by_own[..., k], difference, atol=1e-7)
    for k, name in enumerate(COMMON):
        step = 1e-6 * np.eye(len(COMMON))[k]
        difference = (MODEL.thetas(own, common + step) - MODEL.thetas(own, common - step)) / 2e-6
        np.testing.assert_allclose(by_common[..., k], difference, atol=1e-7, err_msg=name)


def test_own_parameters_come_back_from_cameras() -> None:
    own, common = random_parameters(7)
    np.testing.assert_allclose(MODEL.own_of(MODEL.thetas(own, common), common), own, atol=1e-9)


@pytest.mark.parametrize("x_m", [3.0, 0.01, -0.01, -3.0])
def test_pans_of_a_camera_beyond_the_far_touchline_do_not_jump(x_m: float) -> None:
    own, common = random_parameters(7)
    common[:2], own[:, 1] = [x_m, -80.0], np.pi + np.array([-0.2, -0.001, 0.001, 0.2])
    found = MODEL.own_of(MODEL.thetas(own, common), common)
    np.testing.assert_allclose(found[:, 1], own[:, 1], atol=1e-9)


@pytest.mark.parametrize("side", range(8))
def test_pans_are_told_about_the_direction_to_the_middle_of_the_field(side: int) -> None:
    angle = side * np.pi / 4
    axis_m = 60.0 * np.array([-np.sin(angle), np.cos(angle)])
    pans = unwrap_pan(angle + np.linspace(-0.7, 0.7, 9) + 2 * np.pi * np.arange(-4, 5), axis_m)
    np.testing.assert_allclose(np.diff(pans), 1.4 / 8, atol=1e-12)


def test_pictures_of_another_size_show_the_same() -> None:
    own, common = random_parameters(9)
    estimate = TripodEstimate(
        "camera-1", (1280, 720), MODEL.log_focal, Surface("roof", crown_m=0.05), common, np.eye(len(COMMON)) * 1e-6,
        own[:, :3].min(axis=0), own[:, :3].max(axis=0),
    )  # fmt: skip
    points = np.array([[0.0, 0.0], [9.15, 0.0], [0.0, -9.15]])
    small = estimate.view(own[0, :3], np.zeros((3, 3)))
    own[0, 0] += np.log(1.5)
    large = estimate.resize((1920, 1080)).view(own[0, :3], np.zeros((3, 3)))
    np.testing.assert_allclose((small.project(points) + 0.5) * 1.5 - 0.5, large.project(points), atol=1e-6)
    # the same head, whose focal lengths count in the larger pictures' pixels
    resized = estimate.resize((1920, 1080))
    zoom_by = np.array([np.log(1.5), 0.0, 0.0])
    np.testing.assert_allclose(resized.head_low, estimate.head_low + zoom_by)
    np.testing.assert_allclose(resized.head_high, estimate.head_high + zoom_by)


def test_views_are_as_uncertain_as_the_tripod_and_the_head() -> None:
    own, common = random_parameters(3)
    covariance = np.zeros((len(COMMON), len(COMMON)))
    covariance[0, 0] = 0.04
    estimate = TripodEstimate(
        "camera-1", (1280, 720), MODEL.log_focal, Surface(), common, covariance, own[0, :3], own[0, :3]
    )
    head = np.diag([0.0, 1e-6, 0.0])
    found = estimate.view(own[0, :3], head).covariance
    assert found is not None
    assert found[INDEX["x"], INDEX["x"]] == pytest.approx(0.04, rel=0.01)
    assert found[INDEX["pan"], INDEX["pan"]] == pytest.approx(1e-6, rel=0.05)
    # a head that follows the axis so that the circle stays where it is seen
    cross = np.zeros((3, len(COMMON)))
    cross[1, 0] = 0.01
    assert estimate.view(own[0, :3], head, cross).covariance[INDEX["pan"], INDEX["x"]] > 0.0003  # type: ignore[index]


def test_rays_about_a_camera_are_its_own() -> None:
    """With a lens, pixels that are not square and a principal point beside the middle: to a tenth of a pixel."""
    own, common = random_parameters(4)
    for name, value in (("kappa_1", 0.06), ("kappa_2", -0.01), ("log_aspect", 0.03)):
        common[PLACE[name]] = value
    x, y = np.meshgrid(np.linspace(0, 1279, 7), np.linspace(0, 719, 5))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    camera = camera_of(MODEL.thetas(own[:1], common)[0], MODEL.projection)
    position, rays = MODEL.rays_about(own[0], common, pixels)
    np.testing.assert_allclose(position, camera.position_m, atol=1e-12)
    off_px = np.linalg.norm((rays - camera.rays(pixels)) @ camera.R.T, axis=1) * camera.focal_px[0]
    away_px = np.linalg.norm(pixels - camera.principal_point_px, axis=1)
    assert off_px.max() < 2.0
    assert off_px[away_px < 450.0].max() < 0.1


def test_points_of_the_world_are_projected_as_those_of_the_field() -> None:
    own, common = random_parameters(2)
    points = np.array([[0.0, 0.0], [9.15, 3.0], [-20.0, -9.15]])
    world = np.column_stack([points, np.zeros(3)])
    found = MODEL.project_world(own[:, :3], common, world)
    for theta, pixels in zip(MODEL.thetas(own, common), found, strict=True):
        np.testing.assert_allclose(pixels, camera_of(theta, MODEL.projection).project(points), atol=1e-9)


def test_the_shift_of_the_axis_counts_in_rows_as_tall_as_they_are() -> None:
    own = np.array([[7.5, 0.1, 1.7, 0.0], [7.5, 0.12, 1.72, 0.0]])
    common = np.zeros(len(COMMON))
    common[:3], common[PLACE["log_aspect"]] = [1.0, 80.0, -15.0], 0.3
    before, after = (camera_of(theta, MODEL.projection) for theta in MODEL.thetas(own, common))
    ahead = before.position_m + 1e7 * before.R[2]
    moved = after.project(ahead) - after.principal_point_px
    np.testing.assert_allclose(MODEL.shift_of_axis(own, common), moved, atol=0.01)


def test_pictures_of_other_pixels_show_the_same() -> None:
    own, common = random_parameters(9)
    common[PLACE["log_aspect"]] = 0.0
    covariance = np.zeros((len(COMMON), len(COMMON)))
    covariance[0, 0] = 0.04
    square = TripodEstimate(
        "camera-1", (1280, 720), MODEL.log_focal, Surface("roof", crown_m=0.05), common, covariance, own[0, :3],
        own[0, :3],
    )  # fmt: skip
    points = np.array([[0.0, 0.0], [9.15, 0.0], [0.0, -9.15]])
    seen = square.view(own[0, :3], np.zeros((3, 3))).project(points)
    stored = square.suit_pixels((960, 720), 4 / 3)
    wide = stored.view(own[0, :3] + np.array([np.log(0.75), 0.0, 0.0]), np.zeros((3, 3)))
    np.testing.assert_allclose((wide.project(points) + 0.5) / (0.75, 1.0) - 0.5, seen, atol=1e-6)
    back = stored.suit_pixels((1280, 720), 1.0).view(own[0, :3], np.zeros((3, 3)))
    np.testing.assert_allclose(back.project(points), seen, atol=1e-6)
    # pictures that are cut are not stretched, nor are those of a camera that tells the shape of its pixels itself
    assert square.suit_pixels((960, 720), 1.0) is square
    covariance[PLACE["log_aspect"], PLACE["log_aspect"]] = 1e-4
    assert square.suit_pixels((960, 720), 4 / 3) is square


def test_pictures_of_another_cut_are_refused_and_those_of_another_size_or_other_pixels_are_not() -> None:
    own, common = random_parameters(9)
    common[PLACE["log_aspect"]] = 0.0
    square = TripodEstimate(
        "camera-1", (1280, 720), MODEL.log_focal, Surface("roof", crown_m=0.05), common, np.zeros((len(COMMON),) * 2),
        own[0, :3], own[0, :3],
    )  # fmt: skip
    points = np.array([[0.0, 0.0], [9.15, 0.0], [0.0, -9.15]])
    seen = square.view(own[0, :3], np.zeros((3, 3))).project(points)
    for size, aspect, factor in (((2560, 1440), 1.0, (2.0, 2.0)), ((480, 360), 4 / 3, (0.375, 0.5))):
        suited = square.suit_pictures(size, aspect)
        found = suited.view(own[0, :3] + np.array([np.log(factor[0]), 0.0, 0.0]), np.zeros((3, 3))).project(points)
        np.testing.assert_allclose((found + 0.5) / factor - 0.5, seen, atol=1e-6)
    assert square.suit_pictures((1280, 720), 1.0) is square
    with pytest.raises(
        InputError, match=r"camera-1: picture_px \[1280, 720\] of the venue is 1.78 .* 640 x 480 .* 1.33"
    ):
        square.suit_pictures((640, 480), 1.0)
