"""Prior files of a known camera, and results that serve as one."""

import json

import pytest

from circlecal.errors import InputError
from circlecal.records.camera_prior import LEAST_POSITION_SD_M, prior_settings


def _file(folder, content):
    path = folder / "prior.yaml"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_prior_file_becomes_settings(tmp_path):
    settings = prior_settings(_file(tmp_path, "position_m: [1, 60, -15]\nk1_mean: 0.02\n"))
    assert "camera.position_m=[1, 60, -15]" in settings
    assert "camera.k1_mean=0.02" in settings
    assert any(setting.startswith("camera.position_sd_m=") for setting in settings)


def test_result_gives_position_with_its_sigma(tmp_path):
    angles = {f"{name}_degrees": 1.0 for name in ("pan", "tilt", "roll")}
    lens = {"x_focal_length": 2.0, "y_focal_length": 2.0, "principal_point": [1.0, 1.0], "radial_distortion": [0.0] * 6}
    position = {"position_meters": [1.0, 60.0, -15.0], "position_sigma_m": [0.4, 0.001, 0.3]}
    camera = angles | lens | position
    result = {"schema_version": 1, "id": "a", "status": "calibrated", "camera": camera}
    settings = dict(setting.split("=", 1) for setting in prior_settings(_file(tmp_path, result)))
    assert json.loads(settings["camera.position_m"]) == camera["position_meters"]
    assert json.loads(settings["camera.position_sd_m"]) == [0.4, LEAST_POSITION_SD_M, 0.3]


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("position_m: [1", "neither YAML nor JSON"),
        ("[1, 2]", "mapping"),
        ("k1_mean: 0.02", "position_m is missing"),
        ("position_m: [1, 60, -15]\nfoo: 1", "foo is unknown"),
        ({"schema_version": 1, "id": "a", "status": "refused", "camera": None}, "no calibrated camera"),
        ({"schema_version": 1, "status": "refused"}, "id is missing"),
        ("venue_version: 1\nfield: soccer\ntripods: []", "--venue takes it"),
        ('{"position_m": [1, 60, -15], "k1_mean": 0.02, "k1_mean": 0.2}', 'the key "k1_mean" is given twice'),
    ],
)
def test_wrong_file_is_one_line_that_names_it(tmp_path, content, named):
    path = _file(tmp_path, content)
    with pytest.raises(InputError) as error:
        prior_settings(path)
    assert str(path) in str(error.value)
    assert named in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        prior_settings(tmp_path / "none.yaml")


def test_known_camera_narrows_the_fit(tmp_path, frame_image, run_circlecal):
    import cv2

    cv2.imwrite(str(tmp_path / "frame.png"), frame_image)
    first, second = tmp_path / "first", tmp_path / "second"
    assert run_circlecal("calibrate", tmp_path / "frame.png", "--out", first).code == 0
    prior = _file(tmp_path, "position_m: [3.0, 62.0, -15.5]\nposition_sd_m: [0.1, 0.1, 0.1]\n")
    outcome = run_circlecal("calibrate", tmp_path / "frame.png", "--out", second, "--camera-prior", prior)
    assert outcome.code == 0, outcome.err
    sigma = [json.loads((out / "frame.json").read_text())["camera"]["max_sigma_m"] for out in (first, second)]
    assert sigma[1] < 0.8 * sigma[0]
    assert "another camera" not in outcome.err
    elsewhere = _file(tmp_path, "position_m: [30.0, 20.0, -4.0]\nposition_sd_m: [0.1, 0.1, 0.1]\n")
    outcome = run_circlecal("calibrate", tmp_path / "frame.png", "--out", second, "--camera-prior", elsewhere)
    assert outcome.code == 1, outcome
    assert "leave --camera-prior out for frames that another camera took" in outcome.err
