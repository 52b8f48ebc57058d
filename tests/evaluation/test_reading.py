"""What is read as a prediction."""

import json

import numpy as np
import pytest

import circlecal
from circlecal.errors import InputError
from circlecal.evaluation.reading import read_predictions
from circlecal.evaluation.soccernet_metric import PlaneHomography
from circlecal.geometry.projective import apply_homography
from evaluation.scenes import SIZE, look_at_circle

HALF = (SIZE[0] // 2, SIZE[1] // 2)


@pytest.fixture(scope="module")
def by_homography():
    """A result of a solver that knows no camera."""
    camera, angle = look_at_circle(), np.linspace(0.0, 2.0 * np.pi, 60)
    return circlecal.calibrate_points(
        size=SIZE,
        circle=camera.project(9.15 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)),
        lines={"halfway_line": camera.project(np.stack([np.zeros(20), np.linspace(-12.0, 12.0, 20)], axis=-1))},
        keypoints={"centre_mark": camera.project(np.zeros(2))},
        set={"solver": "magera_case1"},
        id="by-homography",
    )


def test_a_result_without_a_camera_is_scored_by_its_homography(by_homography, tmp_path):
    by_homography.save(tmp_path / "a.json")
    (found,) = read_predictions(tmp_path, HALF).values()
    assert isinstance(found.camera, PlaneHomography)
    factor = (np.array(HALF) - 1.0) / (np.array(SIZE) - 1.0)
    places = np.array([[0.0, 0.0], [9.0, 3.0]])
    np.testing.assert_allclose(apply_homography(found.H_image_field, places), by_homography.to_image(places) * factor)


def test_results_of_other_fields_are_no_predictions(by_homography, tmp_path):
    by_homography.save(tmp_path / "a.json")
    record = json.loads((tmp_path / "a.json").read_text())
    record["field"]["template"] = "basketball-nba"
    (tmp_path / "a.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="holds cameras of basketball-nba, and the metrics are those of soccer fields"):
        read_predictions(tmp_path, HALF)
