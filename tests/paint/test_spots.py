"""Spots that stand alone: measured where a view puts them, and only where they are as large as they should be."""

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.paint import spots
from circlecal.paint.spots import measure_spots

RINK = load_field("ice-hockey-nhl")
SPOT = RINK.mark_by_name["neutral_spot_left_top"]
# 40 px along and 20 px across per metre, the spot in the middle of the picture
H = np.array([[40.0, 0.0, 640 - 40 * SPOT.position[0]], [0.0, 20.0, 360 - 20 * SPOT.position[1]], [0.0, 0.0, 1.0]])
VIEW = FieldView(PlaneCamera(1280, 720, H))


def picture(center, scale=1.0):
    drawn = np.full((720, 1280), 60, np.uint8)
    axes = scale * SPOT.diameter_m / 2 * np.array([40.0, 20.0])
    fixed = [tuple(round(16 * v) for v in pair) for pair in (center, axes)]
    cv2.ellipse(drawn, fixed[0], fixed[1], 0, 0, 360, 160, cv2.FILLED, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(drawn, (0, 0), 1.0)


def measure(gray, *given):
    """Spots of a gray picture."""
    return measure_spots(gray, np.repeat(gray[:, :, None], 3, axis=2), VIEW, [SPOT], 1.5, *given)


def test_the_middle_of_a_spot_beside_its_place():
    (found,) = measure(picture((645.3, 357.6)))
    assert found.mark == SPOT.name
    np.testing.assert_allclose(found.point_px, (645.3, 357.6), atol=0.2)


def test_a_spot_is_as_sure_as_it_is_painted():
    """3 cm beside its place are 1.2 px where a metre is 40 px wide; else the ragged rim alone counts."""
    for placement_sd_m, sigma_px in ((0.0, 0.5 * 1280 / 1920), (0.03, np.hypot(0.5 * 1280 / 1920, 1.2))):
        (found,) = measure(picture((645.3, 357.6)), placement_sd_m)
        assert found.sigma_px == pytest.approx(sigma_px)


@pytest.mark.parametrize("center", [(700.0, 360.0), (640.0, 420.0)])
def test_nothing_is_found_where_there_is_no_spot(center):
    assert measure(picture(center)) == ()


def test_another_blob_is_no_spot():
    assert measure(picture((640.0, 360.0), scale=2.0)) == ()
    assert measure(picture((640.0, 360.0), scale=0.4)) == ()


@pytest.mark.parametrize(("left_px", "is_found"), [(650, True), (632, False)])
def test_a_leg_before_a_spot_does_not_move_it(left_px, is_found):
    """As bright as the spot in gray, of another colour; a third of it hidden leaves its place, most of it does not."""
    image = np.repeat(picture((645.3, 357.6))[:, :, None], 3, axis=2)
    image[300:370, left_px : left_px + 30] = (40, 200, 40)
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    found = measure_spots(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), image, VIEW, [SPOT], 1.5)
    assert bool(found) is is_found
    if is_found:
        np.testing.assert_allclose(found[0].point_px, (645.3, 357.6), atol=1.0)


def test_a_spot_of_which_a_wrong_camera_says_that_it_fills_the_picture_is_not_looked_for(monkeypatch):
    """Else the shape that is looked for would be as large as the memory."""
    near = FieldView(PlaneCamera(1280, 720, np.diag([500.0, 500.0, 1.0]) @ H))
    monkeypatch.setattr(spots, "_draw_kernels", lambda axes: pytest.fail("drawn"))
    image = np.full((720, 1280, 3), 60, np.uint8)
    assert measure_spots(image[..., 0], image, near, [SPOT], 1.5) == ()


def test_spots_on_lines_are_left_out():
    lone = {mark.name for mark in RINK.lone_marks}
    assert "centre_mark" not in lone
    assert {"end_spot_left_top", "neutral_spot_right_bottom"} <= lone
