"""One circle and a line through its centre: the imaged centre that an ordinary camera allows."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.circle_pose import pinhole_centers
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.projective import apply_homography, dehomogenise, transform_lines

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
    distance = [np.linalg.norm(dehomogenise(c.center) - true) for c in found]
    assert min(distance) < 1e-5
    best = found[int(np.argmin(distance))]
    assert abs(best.focal_px / camera.focal_px[0] - 1) < 1e-4


def test_a_line_that_misses_the_circle_gives_nothing():
    conic = circle_conic((960.0, 540.0), 100.0)
    assert pinhole_centers(conic, np.array([1.0, 0.0, -10.0]), CENTER_PX, 1920) == []
