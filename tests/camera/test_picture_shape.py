"""What the shape of a picture tells of its principal point."""

import cv2
import numpy as np
import pytest

from circlecal.api.calls import calibrate_picture
from circlecal.camera.picture_shape import (
    is_cut,
    list_aspects,
    square_of_width_left,
    usual_log_aspect,
    usual_point_sd,
)
from circlecal.config import load_config
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import sample_scene


@pytest.mark.parametrize("size", [(1920, 1080), (854, 480), (398, 224), (720, 576), (1080, 1920), (3840, 2160)])
def test_whole_pictures_point_at_their_middle(size):
    assert not is_cut(*size)
    assert usual_point_sd(*size) == pytest.approx((15.0 * size[0] / 1920.0,) * 2)


@pytest.mark.parametrize("size", [(599, 307), (1180, 707), (1080, 1350)])
def test_pictures_of_no_usual_shape_point_anywhere(size):
    assert is_cut(*size)
    assert usual_point_sd(*size) == pytest.approx((250.0 * size[0] / 1920.0,) * 2)


def test_a_side_that_was_kept_whole_still_points_at_its_middle():
    # a screen without its bar, a picture of the cinema, and a square and an upright part of a video
    assert usual_point_sd(2560, 1250) == pytest.approx((20.0, np.hypot(20.0, 190.0 / np.sqrt(12.0))))
    assert usual_point_sd(4096, 2160) == pytest.approx((32.0, np.hypot(32.0, 144.0 / np.sqrt(12.0))))
    for width in (1080, 608):
        along, upright = usual_point_sd(width, 1080)
        assert upright == pytest.approx(15.0 * width / 1920.0)
        assert along == pytest.approx(np.hypot(upright, (1920.0 - width) / np.sqrt(12.0)))


def test_how_much_is_left_of_the_width_is_known_where_a_side_was_kept_whole():
    assert {square_of_width_left(*size) for size in ((1920, 1080), (720, 576), (1080, 1920), (2560, 1250))} == {1.0}
    assert square_of_width_left(1080, 1080) == pytest.approx((1080 / 1920) ** 2)
    left = np.random.default_rng(1).uniform(0.55, 1.0, 100000)
    assert square_of_width_left(1180, 707) == pytest.approx(np.mean(left**2), abs=0.005)


def test_a_picture_that_was_cut_out_of_a_larger_one_is_calibrated_as_such():
    rng = np.random.default_rng([10, 11])
    scene = sample_scene("world_whole", rng, 1920, 1080)
    x, y, width, height = 0, 260, 1210, 820
    picture = np.ascontiguousarray(render(scene, rng).image[y : y + height, x : x + width])
    points = np.stack(np.meshgrid(np.linspace(-15, 15, 7), np.linspace(-12, 12, 7)), axis=-1).reshape(-1, 2)
    there = scene.camera.project(scene.surface.lift(points)) - (x, y)
    seen = ((there > 0) & (there < (width, height))).all(axis=1)
    found = calibrate_picture(picture, load_config(), frame_id="cut")
    assert found.status == "calibrated"

    def farthest_px(calibration):
        return np.linalg.norm(calibration.view.project(points[seen]) - there[seen], axis=1).max()

    assert farthest_px(found) < 5.0
    middle_px = scene.camera.principal_point_px - (x, y)
    camera = found.attempt.camera
    sd = np.sqrt(np.diag(camera.covariance)[7:9])
    assert (np.abs(camera.camera.principal_point_px - middle_px) < 4.0 * sd).all()
    whole = calibrate_picture(picture, load_config(None, ["camera.principal_point_sd_px=15"]), frame_id="cut")
    assert whole.status == "refused" or farthest_px(whole) > 4.0 * farthest_px(found)


def test_pixels_of_televisions_sizes_are_those_of_16_to_9_or_4_to_3():
    assert list_aspects(720, 576) == pytest.approx((1.4222, 1.0667), abs=1e-4)
    assert list_aspects(720, 480) == pytest.approx((1.1852, 0.8889), abs=1e-4)
    assert not is_cut(352, 240)
    mean, sd = usual_log_aspect(704, 576)
    assert np.exp([mean - sd, mean + sd]) * 704 / 576 == pytest.approx([4 / 3, 16 / 9])
    for size in ((1920, 1080), (960, 720), (768, 576), (480, 720)):
        assert list_aspects(*size) == (1.0,)
        assert usual_log_aspect(*size) == (0.0, 0.0)


@pytest.mark.parametrize("size", [(720, 576), (704, 480)])
def test_the_camera_of_a_picture_in_a_size_of_television_is_known_no_better_than_its_pixels(size):
    rng = np.random.default_rng([0, 4])
    scene = sample_scene("broadcast", rng, 1280, 720)
    picture = np.asarray(cv2.resize(render(scene, rng).image, size, interpolation=cv2.INTER_AREA), np.uint8)

    def sigmas_off(*settings):
        camera = calibrate_picture(picture, load_config(None, settings), frame_id="pal").attempt.camera
        off = camera.camera.position_m - scene.camera.position_m
        sd = np.sqrt(np.diag(camera.covariance)[4:7])
        return float(np.abs(off / sd).max()), float(camera.camera.focal_px[1] / camera.camera.focal_px[0])

    wide = (16 / 9) * size[1] / size[0]
    estimated, aspect = sigmas_off()
    assert estimated < 3.0
    assert aspect == pytest.approx(wide, rel=0.15)
    told, aspect = sigmas_off(f"camera.aspect={wide:.6f}")
    assert told < 3.0
    assert aspect == pytest.approx(wide, rel=1e-5)
    assert sigmas_off("camera.aspect=1")[0] > 6.0
