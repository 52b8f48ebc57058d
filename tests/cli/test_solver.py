"""``circlecal calibrate --solver``: a published method in place of the camera."""

import json

import cv2
import numpy as np
import pytest

from circlecal.evaluation.bench.reprojection import mean_reprojection_error, reprojection_grid


@pytest.fixture
def frame(tmp_path, frame_image):
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), frame_image)
    return path


def test_case_1_calibrates_without_a_camera(frame, tmp_path, frame_camera, run_circlecal):
    outcome = run_circlecal("calibrate", frame, "--solver", "magera_case1", "--out", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    result = json.loads((tmp_path / "out" / "frame.json").read_text())
    assert result["camera"] is None
    H = np.array(result["H_image_field"])
    grid = reprojection_grid(frame_camera.homography, frame_camera.width, frame_camera.height, 12.0, 12.0)
    assert mean_reprojection_error(frame_camera.homography, H, grid) < 3.0


def test_great_axis_is_refused_since_its_circle_leaves_the_marking(frame, tmp_path, run_circlecal):
    outcome = run_circlecal("calibrate", frame, "--solver", "great_axis", "--out", tmp_path / "out")
    assert outcome.code == 1
    assert json.loads((tmp_path / "out" / "frame.json").read_text())["code"] == "residual_too_large"


def test_unknown_solver_is_one_line(frame, tmp_path, run_circlecal):
    outcome = run_circlecal("calibrate", frame, "--solver", "magic", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "magic" in outcome.err
    assert "magera_case1" in outcome.err
