"""One circle and a line through its centre: the imaged centre that an ordinary camera allows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.circle_pose import pinhole_centers
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.projective import apply_homography, dehomogenise, transform_lines
from circlecal.synthetic.cameras import aim_camera

CENTER_PX = image_center(1920, 1080)


@st.composite
def cameras(draw):
    """Cameras beside a field, not in the halfway line's plane, that look at its middle."""
    x = draw(st.floats(4, 25)) * draw(st.sampled_from([1.0, -1.0]))
    position = np.array([x, draw(st.floats(40, 80)), draw(st.floats(-30, -10))])
    aim = np.array([draw(st.floats(-5, 5)), draw(st.floats(-5, 5))]) - position[:2]
    angles = np.array(
        [np.arctan2(aim[0], -aim[1]), np.arctan2(np.linalg.norm(aim), -position[2]), draw(st.floats(-0.05, 0.05))]
    )
    return Camera(1920, 1080, np.full(2, draw(st.floats(1500.0, 4000.0))), CENTER_PX, angles, position, np.zeros(2))


@given(cameras(), st.sampled_from([1.0, -1.0, 1e5]), st.sampled_from([1.0, -1.0, 1e-3]))
def test_the_true_centre_is_among_the_candidates(camera, conic_scale, line_scale):
    H = camera.homography
    conic = conic_scale * transform_conic(H, circle_conic((0, 0), 9.15))
    line = line_scale * transform_lines(H, np.array([1.0, 0.0, 0.0]))
    found = pinhole_centers(conic, line, CENTER_PX, 1920)
    true = apply_homography(H, np.zeros(2))
    assert np.linalg.norm(dehomogenise(found) - true, axis=1).min() < 1e-5


@pytest.mark.parametrize(
    ("focal_px", "position_m", "target_m", "roll_rad"),
    [
        (1051.0, (-18.11, 74.54, -28.67), (-8.28, -7.13, 0.0), 0.059),
        (3849.0, (-23.08, 76.84, -5.2), (-12.52, 5.22, 0.0), -0.001),
        (2262.0, (13.86, 55.14, -22.61), (6.05, -7.38, 0.0), 0.014),
    ],
)
def test_of_two_centres_near_each_other_both_are_found(focal_px, position_m, target_m, roll_rad):
    """Changes of sign at steps of 0.005 half chords showed neither."""
    camera = aim_camera(np.array(position_m), np.array(target_m), focal_px, roll_rad, 1920, 1080)
    conic = transform_conic(camera.homography, circle_conic((0, 0), 9.15))
    line = transform_lines(camera.homography, np.array([1.0, 0.0, 0.0]))
    found = dehomogenise(pinhole_centers(conic, line, CENTER_PX, 1920))
    assert np.linalg.norm(found - apply_homography(camera.homography, np.zeros(2)), axis=1).min() < 1e-4


def test_a_line_that_misses_the_circle_gives_nothing():
    conic = circle_conic((960.0, 540.0), 100.0)
    assert pinhole_centers(conic, np.array([1.0, 0.0, -10.0]), CENTER_PX, 1920).shape == (0, 3)
