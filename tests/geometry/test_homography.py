"""Homographies from points and lines and from a circle, and their errors."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry import homography as hg
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.projective import apply_homography, join, lift, transform_lines
from circlecal.synthetic.cameras import aim_camera

FIELD = np.random.default_rng(11).uniform(-12.0, 12.0, (40, 2))
RADIUS_M = 9.15


@st.composite
def homographies(draw):
    """Cameras beside a field that look at its middle."""
    position = np.array([draw(st.floats(-20, 20)), draw(st.floats(40, 90)), draw(st.floats(-40, -8))])
    aim = np.array([draw(st.floats(-5, 5)), draw(st.floats(-5, 5))]) - position[:2]
    angles = [np.arctan2(aim[0], -aim[1]), np.arctan2(np.linalg.norm(aim), -position[2]), draw(st.floats(-0.1, 0.1))]
    focal = np.full(2, draw(st.floats(1500.0, 5000.0)))
    return Camera(1920, 1080, focal, image_center(1920, 1080), np.array(angles), position, np.zeros(2)).homography


def _sides():
    corners = lift(np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0], [0.0, -9.0], [0.0, 9.0]]))
    return np.stack([join(corners[i], corners[j]) for i, j in ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (0, 2))])


def _departure(H, true):
    return hg.transfer_errors(H, FIELD, apply_homography(true, FIELD)).max()


@given(homographies(), st.sampled_from([1.0, -1.0, 1e5, -1e-5]))
def test_dlt_is_exact_with_points_lines_and_both(true, scale):
    points, lines = FIELD[:6], _sides()
    image_points, image_lines = apply_homography(true, points), scale * transform_lines(true, lines)
    empty = np.zeros((0, 2))
    for solution in (
        hg.dlt(points, image_points),
        hg.dlt(empty, empty, lines, image_lines),
        hg.dlt(points[:3], image_points[:3], lines[:3], image_lines[:3]),
        hg.dlt(points, image_points, lines, image_lines),
    ):
        assert _departure(solution.H, true) < 1e-8
        assert solution.null_ratio < 1e-9
        assert solution.H[2, 2] == pytest.approx(1.0)


def test_dlt_of_four_points_equals_opencv():
    true = np.array([[20.0, 3.0, 900.0], [-1.0, 8.0, 500.0], [0.0005, 0.01, 1.0]])
    corners = np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]])
    peer = cv2.getPerspectiveTransform(corners.astype(np.float32), apply_homography(true, corners).astype(np.float32))
    np.testing.assert_allclose(hg.dlt(corners, apply_homography(true, corners)).H, peer, rtol=1e-4)


def test_dlt_of_noisy_points_is_as_good_as_opencv():
    rng = np.random.default_rng(12)
    true = np.array([[20.0, 3.0, 900.0], [-1.0, 8.0, 500.0], [0.0005, 0.01, 1.0]])
    noisy = apply_homography(true, FIELD) + rng.normal(0, 0.5, FIELD.shape)
    peer, _ = cv2.findHomography(FIELD, noisy)
    assert _departure(hg.dlt(FIELD, noisy).H, true) < 1.5 * _departure(peer, true) + 0.05


@given(homographies(), st.floats(0.01, 100.0), st.floats(-1000, 1000))
def test_dlt_does_not_depend_on_units_and_origin(true, scale, shift):
    rng = np.random.default_rng(13)
    noisy = apply_homography(true, FIELD) + rng.normal(0, 0.5, FIELD.shape)
    plain = hg.dlt(FIELD, noisy).H
    moved = hg.dlt(scale * FIELD + shift, noisy).H
    there = np.array([[scale, 0.0, shift], [0.0, scale, shift], [0.0, 0.0, 1.0]])
    assert _departure(moved @ there, plain) < 1e-5


def test_undetermined_correspondences_give_none():
    line = np.column_stack([np.arange(6.0), np.arange(6.0)])
    empty = np.zeros((0, 2))
    assert hg.dlt(line, line * (1.0, 2.0)) is None
    assert hg.dlt(FIELD[:3], FIELD[:3]) is None
    assert hg.dlt(empty, empty) is None
    assert hg.dlt(np.zeros((5, 2)), np.zeros((5, 2))) is None
    assert hg.dlt(FIELD[:5], np.full((5, 2), np.nan)) is None
    pencil = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [2.0, 1.0, 0.0]])
    assert hg.dlt(empty, empty, pencil, pencil) is None
    # two points and two lines are eight equations and still not enough (H&Z section 4.1.3)
    assert hg.dlt(FIELD[:2], FIELD[:2], _sides()[:2], _sides()[:2]) is None


def test_numbers_of_correspondences_must_agree():
    with pytest.raises(ValueError, match="its image"):
        hg.dlt(FIELD[:4], FIELD[:3])
    with pytest.raises(ValueError, match="its image"):
        hg.dlt(FIELD[:4], FIELD[:4], _sides(), _sides()[:2])


@given(
    homographies(),
    st.floats(0, np.pi),
    st.floats(-6, 6),
    st.sampled_from([1.0, -1.0, 1e4, -1e-4]),
    st.sampled_from([1.0, -1.0, 1e3]),
)
def test_homography_from_circle_is_exact_up_to_the_turn(true, angle, offset, scale, center_scale):
    center = np.array([3.0, -2.0])
    direction = np.array([np.cos(angle), np.sin(angle)])
    normal = np.array([-direction[1], direction[0]])
    # the line needs not pass through the centre
    line = np.array([normal[0], normal[1], -normal @ center - offset])
    conic = scale * transform_conic(true, circle_conic(center, RADIUS_M))
    imaged = center_scale * lift(apply_homography(true, center))
    H = hg.homography_from_circle(conic, imaged, transform_lines(true, line), center, RADIUS_M, 5.0 * direction)
    turned = hg.turn_homography(H, center)
    assert min(_departure(H, true), _departure(turned, true)) < 1e-7
    assert np.linalg.det(H) > 0
    assert np.linalg.det(turned) > 0


def test_homography_from_circle_is_exact_to_a_hundred_millionth_of_a_pixel():
    camera = Camera(
        1920,
        1080,
        np.full(2, 3000.0),
        image_center(1920, 1080),
        np.radians([3.0, 76.0, 1.0]),
        np.array([3.0, 60.0, -15.0]),
        np.zeros(2),
    )
    true = camera.homography
    conic = transform_conic(true, circle_conic((0, 0), RADIUS_M))
    halfway = transform_lines(true, np.array([1.0, 0.0, 0.0]))
    imaged = lift(apply_homography(true, np.zeros(2)))
    H = hg.homography_from_circle(conic, imaged, halfway, np.zeros(2), RADIUS_M, np.array([0.0, 1.0]))
    assert min(_departure(H, true), _departure(hg.turn_homography(H, np.zeros(2)), true)) < 1e-8


def test_centre_outside_the_ellipse_gives_none():
    conic = circle_conic((100.0, 100.0), 50.0)
    line, direction = np.array([1.0, 0.0, -100.0]), np.array([0.0, 1.0])
    for center in ((100.0, 200.0, 1.0), (300.0, 120.0, 1.0), (150.0, 100.0, 1.0), (np.nan, 0.0, 1.0)):
        assert hg.homography_from_circle(conic, np.array(center), line, np.zeros(2), RADIUS_M, direction) is None


@given(homographies(), st.floats(-40, 40), st.floats(-10, 10))  # the turned field stays in front of the camera
def test_turning_twice_changes_nothing(H, x, y):
    center = np.array([x, y])
    turned = hg.turn_homography(H, center)
    np.testing.assert_allclose(hg.turn_homography(turned, center), H, rtol=1e-6, atol=1e-6 * np.abs(H).max())
    assert hg.transfer_errors(turned, FIELD, apply_homography(H, 2 * center - FIELD)).max() < 1e-4


@given(homographies())
def test_side_of_the_camera(H):
    seen = np.zeros(2)
    assert hg.camera_side_of(H, "main", seen) > 0 > hg.camera_side_of(H, "opposite", seen)
    turned = hg.turn_homography(H, seen)
    assert hg.camera_side_of(turned, "opposite", seen) > 0 > hg.camera_side_of(turned, "main", seen)
    assert hg.camera_side_of(-H, "main", seen) > 0
    assert hg.camera_side_of(H, "left_goal", seen) == -hg.camera_side_of(H, "right_goal", seen)


def test_the_side_of_a_camera_that_has_the_middle_of_the_field_behind_it():
    """It stands between the middle and a circle in the corner of the field, on the middle's side of that circle."""
    camera = aim_camera(np.array([20.0, 10.0, -6.0]), np.array([40.0, 25.0, 0.0]), 1200.0, 0.0, 1920, 1080)
    assert camera.depth(np.zeros((1, 2)))[0] < 0.0
    assert hg.camera_side_of(camera.homography, "opposite", (40.0, 25.0)) > 0.0
    assert hg.camera_side_of(camera.homography, "left_goal", (40.0, 25.0)) > 0.0


@given(homographies())
def test_transfer_errors(H):
    shifted = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 4.0], [0.0, 0.0, 1.0]]) @ H
    np.testing.assert_allclose(hg.transfer_errors(shifted, FIELD, apply_homography(H, FIELD)), 5.0)


def test_projects_in_front():
    H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.1, 1.0]])
    assert hg.projects_in_front(H, [[0.0, 0.0], [0.0, -9.0]])
    assert hg.projects_in_front(-H, [[0.0, 0.0], [0.0, -9.0]])
    assert not hg.projects_in_front(H, [[0.0, 0.0], [0.0, -11.0]])


def test_names_of_directions():
    labels = [hg.compass_label(np.array([np.cos(a), np.sin(a)])) for a in np.radians(np.arange(0, 360, 45))]
    assert labels == ["right", "bottom_right", "bottom", "bottom_left", "left", "top_left", "top", "top_right"]
    assert hg.compass_label([1.0, -1e-9]) == "right"
    assert hg.compass_label([np.cos(0.5), np.sin(0.5)]) == "deg_29"


def test_homography_that_sends_the_origin_to_infinity_is_scaled_by_its_norm():
    H = np.array([[0.0, 1.0, 5.0], [2.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert np.linalg.norm(hg.scale_homography(H)) == pytest.approx(1.0)
