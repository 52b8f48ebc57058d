"""SoccerNet: pixel mappings, spelling, points outside the picture, camera files at any size."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.formats import extremities, soccernet, soccernet_camera
from circlecal.formats.cameras import CameraFrame, resize_camera
from circlecal.formats.format import json_bytes
from circlecal.formats.shapes import AnnotatedFrame, Shape

MANDATORY = """
    pan_degrees tilt_degrees roll_degrees position_meters x_focal_length y_focal_length principal_point
    radial_distortion tangential_distortion thin_prism_distortion
""".split()  # noqa: SIM905 - shorter to read
FILE = Path("00001.json")


def annotation(**classes):
    return json_bytes({name: [{"x": x, "y": y} for x, y in points] for name, points in classes.items()})


def test_zero_and_one_are_the_centres_of_the_outermost_pixels():
    (frame,) = soccernet.read(FILE, annotation(a=[(0, 0), (1, 1)]), (1920, 1080))
    assert frame.shapes[0].points_px.tolist() == [[0, 0], [1919, 1079]]
    assert frame.id == "00001"


def test_extremities_are_divided_by_the_whole_size():
    content = annotation(a=[(0.5, 0.5), (1, 1)])
    (frame,) = extremities.read(Path("extremities_7.json"), content, (1920, 1080))
    assert frame.shapes[0].points_px.tolist() == [[960, 540], [1920, 1080]]
    assert frame.id == "7"


def test_points_outside_the_picture_are_kept():
    (frame,) = soccernet.read(FILE, annotation(a=[(1.0000078, -0.01), (0.5, 0.5)]), (1921, 1081))
    assert frame.shapes[0].points_px[0] == pytest.approx([1920.015, -10.8], abs=1e-3)


def test_empty_classes_and_the_trailing_blank():
    content = annotation(**{"Middle line": [], "Goal left post left ": [(0, 0), (1, 1)]})
    (frame,) = soccernet.read(FILE, content, (100, 100))
    assert [shape.label for shape in frame.shapes] == ["Goal left post left"]
    assert list(json.loads(soccernet.write([frame]))) == ["Goal left post left "]


@pytest.mark.parametrize("module", [soccernet, extremities])
def test_annotations_come_back_exactly(seen, close, module):
    (again,) = module.read(FILE, module.write([seen]), (960, 540))
    close(again, replace(seen, shapes=tuple(replace(s, kind="line") for s in seen.shapes)))


def test_shapes_of_one_label_are_put_together():
    shapes = tuple(Shape("Middle line", "points", np.array([[x, 2.0]])) for x in (0.0, 10.0))
    record = json.loads(soccernet.write([AnnotatedFrame("a", 11, 11, shapes)]))
    assert record == {"Middle line": [{"x": 0.0, "y": 0.2}, {"x": 1.0, "y": 0.2}]}


def test_the_size_is_asked_for():
    with pytest.raises(InputError, match="--size WIDTHxHEIGHT"):
        soccernet.read(FILE, annotation(a=[(0, 0), (1, 1)]), None)


def camera_record(camera):
    return json.loads(soccernet_camera.write([CameraFrame("a", camera.width, camera.height, camera)]))


def read_camera(path, content, size):
    (frame,) = soccernet_camera.read(path, content, size)
    return frame.id, frame.camera


@pytest.fixture
def lens_camera(frame_camera):
    return replace(
        frame_camera,
        kappa=np.array([0.03, -0.01]),
        focal_px=np.array([2300.0, 2310.0]),
        principal_point_px=np.array([481.25, 266.5]),
    )


def test_every_mandatory_key_is_written(lens_camera):
    record = camera_record(lens_camera)
    assert set(MANDATORY) <= set(record)
    assert [len(record[f"{k}_distortion"]) for k in ("radial", "tangential", "thin_prism")] == [6, 2, 4]
    assert (record["image_width"], record["image_height"]) == (960, 540)


def test_cameras_come_back_exactly(lens_camera):
    name, again = read_camera(Path("camera_00012.json"), json_bytes(camera_record(lens_camera)), None)
    assert name == "00012"
    points = [[0.0, 0.0], [9.0, 3.0], [-20.0, -30.0]]
    assert np.abs(again.project(points) - lens_camera.project(points)).max() < 1e-9


def test_another_size_moves_pixels_as_the_annotation_does(lens_camera):
    points = [[0.0, 0.0], [9.0, 3.0], [-12.0, -8.0]]
    large = resize_camera(lens_camera, (1920, 1080))
    expected = lens_camera.project(points) * [1919 / 959, 1079 / 539]
    assert np.abs(large.project(points) - expected).max() < 1e-9
    assert camera_record(resize_camera(large, (960, 540)))["principal_point"] == pytest.approx([481.25, 266.5])


@pytest.mark.parametrize("center", [(480.0, 270.0), (479.5, 269.5)])
def test_the_size_is_read_off_the_principal_point(frame_camera, center):
    record = {**camera_record(frame_camera), "principal_point": list(center)}
    del record["image_width"], record["image_height"]
    camera = read_camera(Path("camera_1.json"), json_bytes(record), None)[1]
    assert (camera.width, camera.height) == (960, 540)


def test_a_principal_point_off_the_centre_gives_no_size(lens_camera):
    record = camera_record(lens_camera)
    del record["image_width"]
    with pytest.raises(InputError, match="--size"):
        read_camera(Path("camera_1.json"), json_bytes(record), None)
    assert read_camera(Path("camera_1.json"), json_bytes(record), (960, 540))[1].width == 960


def test_distortion_that_the_camera_does_not_have_is_an_error(lens_camera):
    record = {**camera_record(lens_camera), "tangential_distortion": [0.01, 0.0]}
    with pytest.raises(InputError, match="radial_distortion"):
        read_camera(Path("camera_1.json"), json_bytes(record), None)


def test_missing_distortion_is_none(frame_camera):
    record = {k: v for k, v in camera_record(frame_camera).items() if "distortion" not in k}
    camera = read_camera(Path("camera_1.json"), json.dumps(record).encode(), None)[1]
    assert not camera.kappa.any()
