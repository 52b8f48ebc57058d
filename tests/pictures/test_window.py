"""Where a picture has bars or a plain wall around what the camera took, and that its middle is the camera's then."""

import cv2
import numpy as np
import pytest

from circlecal.api.calls import calibrate_picture
from circlecal.camera.options import CameraConfig, priors_of, zoom_lens
from circlecal.config import load_config
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import KAPPA_1, ProjectionModel
from circlecal.geometry.surface import Surface
from circlecal.geometry.window import Window
from circlecal.pictures.window import cover_outside, find_window
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import sample_scene


def noise(height, width):
    return np.random.default_rng(3).integers(40, 200, (height, width, 3)).astype(np.uint8)


@pytest.mark.parametrize(
    ("bars", "window"),
    [
        ((60, 60, 0, 0), (0.0, 60.0, 640.0, 360.0)),
        ((0, 0, 100, 100), (100.0, 0.0, 640.0, 360.0)),
        ((0, 0, 0, 180), (0.0, 0.0, 640.0, 360.0)),
        ((30, 90, 200, 80), (200.0, 30.0, 640.0, 360.0)),
    ],
)
@pytest.mark.parametrize("colour", [(0, 0, 0), (120, 60, 20)])
def test_bars_and_walls_are_found_through_compression(bars, window, colour):
    top, bottom, left, right = bars
    seen = cv2.GaussianBlur(noise(360, 640), (0, 0), 2.0)
    picture = cv2.copyMakeBorder(seen, top, bottom, left, right, cv2.BORDER_CONSTANT, value=colour)
    assert find_window(picture) == window
    stored = cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 75])[1], cv2.IMREAD_COLOR)
    found = find_window(stored)
    assert found is not None
    ends, expected = (np.r_[box[:2], np.add(box[:2], box[2:])] for box in (found, window))
    assert np.abs(ends - expected).max() <= 16.0  # blocks that hold some of both are no bar any more


def test_pictures_without_bars_have_no_window():
    picture = noise(360, 640)
    assert find_window(picture) is None
    assert find_window(np.zeros((360, 640, 3), np.uint8)) is None
    padded = picture.copy()
    padded[-4:] = 0
    assert find_window(padded) is None
    sky = picture.copy()
    for column in range(640):  # a roof before a white sky
        sky[: 60 + column // 8, column] = 255
    assert find_window(sky) is None
    roof = cv2.copyMakeBorder(noise(340, 640), 20, 0, 0, 0, cv2.BORDER_CONSTANT, value=(24, 24, 24))
    for column in range(640):  # bent by the lens
        roof[: 20 + round(15 * (1.0 - (column / 320 - 1.0) ** 2)), column] = 24
    assert find_window(roof) is None
    small = np.zeros((360, 640, 3), np.uint8)
    small[100:180, 100:240] = picture[:80, :140]
    assert find_window(small) is None


def test_what_lies_outside_is_covered():
    outside = cover_outside((8, 10, 3), Window(2.0, 1.0, 6.0, 4.0))
    assert outside.sum() == 80 - 24
    assert not outside[1:5, 2:8].any()


def test_priors_are_those_of_the_window():
    config = CameraConfig(window_px=Window(200.0, 0.0, 1280.0, 720.0))
    assert config.principal_point_sd(1680, 720) == pytest.approx((10.0, 10.0))
    assert config.principal_point_shift(1680, 720) == pytest.approx([0.0, 0.0])
    assert config.principal_point_shift(1480, 720) == pytest.approx([100.0, 0.0])
    template = load_field("soccer")
    grown = (1680 / 1280) ** 2
    alone, within = (
        priors_of(c, template, template.circles[0], ProjectionModel(width, 720, Surface("roof")))
        for c, width in ((CameraConfig(), 1280), (config, 1680))
    )
    assert within.sd[KAPPA_1] == pytest.approx(grown * alone.sd[KAPPA_1])
    logs = np.log([900.0, 2000.0, 9000.0])
    assert zoom_lens(config, (1680, 720)).kappa(logs) == pytest.approx(
        grown * zoom_lens(CameraConfig(), (1280, 720)).kappa(logs)
    )


@pytest.mark.parametrize("place", [(0, 0, 0, 400), (0, 300, 40, 600)])
def test_the_camera_of_a_window_points_at_its_middle(place):
    rng = np.random.default_rng([0, 0])
    scene = sample_scene("broadcast", rng, 1280, 720)
    left, top, bottom, right = place
    picture = cv2.copyMakeBorder(
        render(scene, rng).image, top, bottom, left, right, cv2.BORDER_CONSTANT, value=(120, 60, 20)
    )
    points = np.stack(np.meshgrid(np.linspace(-20, 20, 9), np.linspace(-20, 20, 9)), axis=-1).reshape(-1, 2)
    there = scene.camera.project(scene.surface.lift(points))
    seen = ((there > 0) & (there < (1280, 720))).all(axis=1)

    def farthest_px(*settings):
        found = calibrate_picture(picture, load_config(None, settings), frame_id="window")
        if found.status != "calibrated":
            return None
        return float(np.linalg.norm(found.view.project(points[seen]) - there[seen] - (left, top), axis=1).max())

    assert farthest_px() < 6.0
    whole = f"camera.window_px=[0, 0, {picture.shape[1]}, {picture.shape[0]}]"
    assert (farthest_px(whole) or np.inf) > 8.0
