"""``circlecal.calibrate`` from Python."""

import cv2
import numpy as np
import pytest

import circlecal
from circlecal.errors import ConfigError, InputError


def test_array_and_file_give_the_same_answer(frame_image, frame_file):
    from_array = circlecal.calibrate(frame_image, id="good")
    from_file = circlecal.calibrate(frame_file)
    assert isinstance(from_array, circlecal.Calibration)
    assert from_array.status == "calibrated"
    assert (from_array.source, from_file.source) == (None, str(frame_file))
    assert from_file.id == "good"
    assert np.array_equal(from_array.H_image_field, from_file.H_image_field)


def test_the_answer_is_right(frame_image, frame_camera):
    found = circlecal.calibrate(frame_image).camera
    field = np.array([[0.0, 0.0], [9.15, 0.0], [-9.15, 0.0], [0.0, 9.15], [0.0, -9.15]])
    assert np.abs(found.project(field) - frame_camera.project(field)).max() < 1.5


def test_16_bit_and_transparent_arrays(frame_image):
    transparent = np.dstack([frame_image, np.full(frame_image.shape[:2], 255, np.uint8)])
    wanted = circlecal.calibrate(frame_image).H_image_field
    for image in (transparent, frame_image.astype(np.uint16) * 257):
        assert np.array_equal(circlecal.calibrate(image).H_image_field, wanted)


def test_a_mask_as_an_array_of_any_kind(frame_image, frame_camera, tmp_path):
    angle = np.linspace(0, 2 * np.pi, 400)
    circle = frame_camera.project(9.09 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    ids = np.zeros((540, 960), np.uint8)
    cv2.polylines(ids, [np.round(circle).astype(np.int32)], True, 7, 5)
    half = cv2.resize(ids, (480, 270), interpolation=cv2.INTER_NEAREST)
    path = tmp_path / "mask.png"
    cv2.imwrite(str(path), ids)
    for mask in (ids, ids > 0, (ids > 0).astype(np.uint16) * 65535, half, path, str(path)):
        calibration = circlecal.calibrate(frame_image, mask=mask)
        assert calibration.attempt.mask.source == "file"
        assert calibration.attempt.ellipses is not None


def test_configuration_and_seed(frame_image):
    config = circlecal.load_config("broadcast", ["seed=4"])
    calibration = circlecal.calibrate(frame_image, config=config)
    assert calibration.to_dict()["seed"] == 4
    again = circlecal.calibrate(frame_image, config=config)
    assert np.array_equal(calibration.H_image_field, again.H_image_field)


def test_a_frame_without_a_circle_is_refused_and_raises_nothing():
    noise = np.random.default_rng(0).integers(0, 255, (200, 300, 3)).astype(np.uint8)
    for image in (noise, np.zeros((64, 64), np.uint8), np.full((100, 100, 3), 255, np.uint8)):
        calibration = circlecal.calibrate(image)
        assert calibration.status == "refused"
        assert calibration.code
        assert calibration.H_image_field is None


@pytest.mark.parametrize(
    ("image", "part"),
    [
        (np.zeros((1, 1, 3), np.uint8), "1 x 1"),
        (np.zeros((100, 100, 2), np.uint8), "shape"),
        (np.zeros((100, 100, 3), np.float32), "float32"),
        (np.zeros(100, np.uint8), "shape"),
    ],
)
def test_arrays_that_are_no_pictures(image, part):
    with pytest.raises(InputError, match=part):
        circlecal.calibrate(image)


def test_masks_that_are_none(frame_image):
    for kind in (np.uint8, np.bool_):
        empty = circlecal.calibrate(frame_image, mask=np.zeros((540, 960), kind))
        assert empty.code == "no_circle_found" and "all black" in empty.reason
    with pytest.raises(InputError, match="no such file"):
        circlecal.calibrate(frame_image, mask="none.png")
    with pytest.raises(InputError, match="float32"):
        circlecal.calibrate(frame_image, mask=np.zeros((540, 960), np.float32))


def test_an_unknown_field(frame_image):
    with pytest.raises(ConfigError, match="quidditch"):
        circlecal.calibrate(frame_image, config=circlecal.load_config(None, ["field.template=quidditch"]))


def test_videos_and_pictures_in_each_others_place_are_told(frame_file, tmp_path):
    for read in (circlecal.calibrate_video, circlecal.track):
        with pytest.raises(InputError, match=r"good\.png: is a picture; circlecal\.calibrate takes it"):
            read(frame_file)
    video = tmp_path / "match.mp4"
    video.write_bytes(b"anything")
    with pytest.raises(InputError, match=r"match\.mp4: is a video; circlecal\.calibrate_video takes it"):
        circlecal.calibrate(video)
    with pytest.raises(TypeError, match=r"cv2\.imread returns None where it cannot read the file"):
        circlecal.calibrate(None)


@pytest.mark.parametrize(
    ("named", "told"),
    [
        ({"every": "3x"}, "every 3x: must be"),
        ({"start": "x"}, "start x: must"),
        ({"start": 2, "end": 1}, "end 1: is not"),
    ],
)
def test_times_are_named_as_arguments_not_as_options(named, told, tmp_path):
    for read in (circlecal.calibrate_video, circlecal.track):
        with pytest.raises(InputError, match=f"^{told}"):
            read(tmp_path / "match.mp4", **named)


def test_where_a_result_cannot_be_saved_no_option_is_named(frame_image, tmp_path):
    (tmp_path / "file").write_text("")
    found = circlecal.calibrate_points(size=(960, 540), keypoints={"centre_mark": [480, 270]})
    with pytest.raises(InputError, match="choose another folder") as told:
        found.save(tmp_path / "file" / "x.json")
    assert "--" not in str(told.value)


def test_points_tell_no_field(tmp_path):
    (tmp_path / "auto.yaml").write_text("field:\n  template: auto\n")
    for given in ({"field": "auto"}, {"set": {"field.template": "auto"}}, {"config": tmp_path / "auto.yaml"}):
        with pytest.raises(ConfigError, match=r"^field: auto is for pictures"):
            circlecal.calibrate_points(size=(960, 540), circle=[[100.0, 100.0]], **given)


def test_a_camera_that_must_be_there(frame_image):
    frame = circlecal.calibrate(frame_image)
    assert frame.require_camera() == frame.camera and frame.camera is not None
    refused = circlecal.calibrate(np.zeros((100, 100), np.uint8), id="black")
    with pytest.raises(InputError, match=rf"^black: has no camera, since it was refused: {refused.reason}"):
        refused.require_camera()
    flat = circlecal.calibrate(frame_image, set={"camera.enabled": False})
    with pytest.raises(InputError, match=r"^image: has no camera, since only a homography was asked for"):
        flat.require_camera()


def test_what_is_missing_may_have_been_meant_as_a_file_or_as_a_run(tmp_path):
    with pytest.raises(
        InputError, match=r"circlecal-rum: no such file or folder; .*result file.*, or the folder of a run"
    ):
        circlecal.load(tmp_path / "circlecal-rum")
