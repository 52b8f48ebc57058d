"""Concentric circles: the imaged centre from two conics, and every other circle from one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.concentric import imaged_center, vanishing_line
from circlecal.geometry.conics import circle_conic, normalise_conic, transform_conic
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import apply_homography, dehomogenise

OUTER_M, INNER_M = 9.15, 9.03


@st.composite
def cameras(draw):
    """Cameras beside a field that look at its middle."""
    position = np.array([draw(st.floats(-20, 20)), draw(st.floats(40, 90)), draw(st.floats(-40, -8))])
    aim = np.array([draw(st.floats(-5, 5)), draw(st.floats(-5, 5))]) - position[:2]
    pan = np.arctan2(aim[0], -aim[1])
    tilt = np.arctan2(np.linalg.norm(aim), -position[2])
    focal = draw(st.floats(1500.0, 5000.0))
    angles = np.array([pan, tilt, draw(st.floats(-0.1, 0.1))])
    return Camera(1920, 1080, np.full(2, focal), image_center(1920, 1080), angles, position, np.zeros(2))


def _edges(H, center=(0.0, 0.0), outer=OUTER_M, inner=INNER_M):
    return tuple(transform_conic(H, circle_conic(center, r)) for r in (outer, inner))


@given(cameras(), st.floats(-30, 30), st.sampled_from([1.0, -1.0, 1e6, -1e-6]))
def test_centre_and_vanishing_line_are_exact(camera, x, scale):
    H = camera.homography
    center = np.array([0.05 * x, 0.02 * x])
    outer, inner = _edges(H, center)
    found = imaged_center(scale * outer, inner / scale)
    assert np.abs(dehomogenise(found.center) - apply_homography(H, center)).max() < 1e-8 * 1e2
    true_line = np.linalg.inv(H)[2]
    line = vanishing_line(outer, found.center)
    cross = np.cross(line / np.linalg.norm(line), true_line / np.linalg.norm(true_line))
    assert np.abs(cross).max() < 1e-8


def test_centre_is_exact_to_a_hundred_millionth_of_a_pixel():
    camera = Camera(
        1920,
        1080,
        np.full(2, 3000.0),
        image_center(1920, 1080),
        np.radians([3.0, 76.0, 1.0]),
        np.array([3.0, 60.0, -15.0]),
        np.zeros(2),
    )
    for inner in (INNER_M, 5.0):
        found = imaged_center(*_edges(camera.homography, inner=inner))
        assert np.abs(dehomogenise(found.center) - apply_homography(camera.homography, np.zeros(2))).max() < 1e-8


@given(cameras(), st.floats(0.3, 0.98))
def test_eigenvalues_are_powers_of_the_ratio_of_the_radii(camera, ratio):
    found = imaged_center(*_edges(camera.homography, inner=ratio * OUTER_M))
    k = 1.0 / ratio
    isolated, double = k ** (-4 / 3), k ** (2 / 3)
    assert found.gap == pytest.approx((double - isolated) / np.mean([isolated, double, double]), rel=1e-4)
    assert found.gap > 10 * found.pair_split


@given(cameras())
def test_difference_of_scaled_concentric_conics_has_rank_one(camera):
    H = camera.homography
    scale_back = np.linalg.inv(H)
    outer, inner = (scale_back.T @ circle_conic((0, 0), r) @ scale_back for r in (OUTER_M, INNER_M))
    singular = np.linalg.svd(outer - inner, compute_uv=False)
    assert singular[1] < 1e-9 * np.linalg.svd(outer, compute_uv=False)[0]


@given(cameras())
def test_edges_in_the_wrong_order_give_none(camera):
    outer, inner = _edges(camera.homography)
    assert imaged_center(inner, outer) is None


def test_edges_that_are_no_concentric_circles_give_none_or_a_wide_split():
    circle = circle_conic((0, 0), 2.0)
    assert imaged_center(circle, np.diag([1.0, -1.0, -1.0])) is None
    assert imaged_center(np.diag([1.0, -1.0, -1.0]), circle) is None
    assert imaged_center(circle, np.full((3, 3), np.nan)) is None
    assert imaged_center(circle, np.zeros((3, 3))) is None
    crossing = imaged_center(circle, circle_conic((1.5, 0), 1.9))
    assert crossing is None or crossing.pair_split > 0.1 * crossing.gap
    # longer one way and shorter the other: the centre has the middle one of three eigenvalues
    assert imaged_center(circle_conic((0, 0), 1.0), np.diag([4.0, 0.25, -1.0])) is None
    far = imaged_center(circle, circle_conic((50.0, 0), 1.9))
    assert far is None or far.pair_split > 0.1 * far.gap


def test_equal_edges_have_no_gap():
    conic = normalise_conic(circle_conic((100.0, 50.0), 40.0))
    found = imaged_center(conic, conic)
    assert found is None or found.gap < 1e-9
    assert ellipse_from_conic(conic).axis_ratio == pytest.approx(1.0)
